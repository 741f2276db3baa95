"""Pictures of recipes side by side on one sheet.

    python -m docs.studies.recipes docs/images/recipes.jpg FOLDER

The folder holds a picture a recipe, `bridge.png` and so on, as a bake leaves them in
`sky/clear/srgb.png`; docs/develop.md has the commands.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path

from synfog_usd.base import files
from synfog_usd.base.errors import ParameterError

COLUMNS, WIDTH_PX, CAPTION_PX, GAP_PX = 2, 800, 18, 4


def sheet(target: Path, files_by_caption: Mapping[str, Path], width: int = WIDTH_PX, quality: int = 86) -> None:
    """A JPEG of pictures with their captions, in rows of two, each of a width [pixel].

    Raises:
        ParameterError: there is none.
    """
    from PIL import Image, ImageDraw, ImageFont

    captions = list(files_by_caption)
    if not captions:
        raise ParameterError(f"{target}: no picture, as bridge.png, to put on it")
    pictures = [Image.open(path).convert("RGB") for path in files_by_caption.values()]
    height = max(round(width * picture.height / picture.width) for picture in pictures)
    step = height + CAPTION_PX
    rows = -(-len(pictures) // COLUMNS)
    whole = Image.new("RGB", (COLUMNS * (width + GAP_PX) - GAP_PX, rows * step), (24, 24, 26))
    for k, (caption, picture) in enumerate(zip(captions, pictures, strict=True)):
        left, top = k % COLUMNS * (width + GAP_PX), k // COLUMNS * step
        small = picture.resize((width, round(width * picture.height / picture.width)), Image.Resampling.LANCZOS)
        whole.paste(small, (left, top))
        ImageDraw.Draw(whole).text((left + 6, top + height + 2), caption, (225, 225, 225), ImageFont.load_default(12))
    files.write_whole(target, lambda path: whole.save(path, format="JPEG", quality=quality, optimize=True))


if __name__ == "__main__":
    sheet(Path(sys.argv[1]), {path.stem: path for path in sorted(Path(sys.argv[2]).glob("*.png"))})
