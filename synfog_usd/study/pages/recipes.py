"""Pictures of recipes before and after a change, pair by pair on one sheet.

    python -m synfog_usd.study.pages.recipes docs/images/recipes.jpg BEFORE AFTER

Each folder holds a picture a recipe, `bridge.png` and so on, as a bake leaves them in
`sky/clear/srgb.png`; docs/develop.md has the commands.
"""

from __future__ import annotations

import sys
from pathlib import Path

from synfog_usd import files
from synfog_usd.errors import ParameterError

WIDTH_PX, CAPTION_PX, GAP_PX = 640, 18, 4


def sheet(target: Path, before: Path, after: Path) -> None:
    """A JPEG with a row a recipe: its picture in `before` on the left, in `after` on the right.

    Raises:
        ParameterError: no picture lies in both folders.
    """
    from PIL import Image, ImageDraw, ImageFont

    names = sorted(path.name for path in after.glob("*.png") if (before / path.name).is_file())
    if not names:
        raise ParameterError(f"{before} and {after} have no picture of one name, as bridge.png")
    rows = []
    for name in names:
        pair = [Image.open(folder / name).convert("RGB") for folder in (before, after)]
        height = round(WIDTH_PX * pair[1].height / pair[1].width)
        row = Image.new("RGB", (2 * WIDTH_PX + GAP_PX, height + CAPTION_PX), (24, 24, 26))
        for k, picture in enumerate(pair):
            row.paste(picture.resize((WIDTH_PX, height), Image.Resampling.LANCZOS), (k * (WIDTH_PX + GAP_PX), 0))
        caption = f"{Path(name).stem}: before on the left, after on the right"
        ImageDraw.Draw(row).text((6, height + 2), caption, (225, 225, 225), ImageFont.load_default(12))
        rows.append(row)
    whole = Image.new("RGB", (rows[0].width, sum(row.height for row in rows)))
    top = 0
    for row in rows:
        whole.paste(row, (0, top))
        top += row.height
    files.write_whole(target, lambda path: whole.save(path, format="JPEG", quality=88, optimize=True))


if __name__ == "__main__":
    sheet(*(Path(argument) for argument in sys.argv[1:4]))
