"""One picture of each scene of a set on one sheet.

python -m docs.studies.scenes OUT docs/images/scenes.jpg

OUT is a set as `synfog-usd dataset run` leaves it; docs/develop.md has that of the docs.
"""

from __future__ import annotations

import sys
from pathlib import Path

from synfog_usd.base import files
from synfog_usd.dataset.sets import index

TILE_PX, CAPTION_PX, GAP_PX, COLUMNS = (240, 135), 16, 4, 5


def sheet(out: Path, target: Path) -> int:
    """A JPEG with the last picture of each scene, by number: recipe, lighting and visibility under it.

    Returns:
        how many scenes it shows.

    Raises:
        ParameterError, OutputError: no set lies there, or its index cannot be read.
    """
    from PIL import Image, ImageDraw, ImageFont

    last = {picture.scene: picture for picture in index.pictures(out)}
    step = (TILE_PX[0] + GAP_PX, TILE_PX[1] + CAPTION_PX + GAP_PX)
    down = -(-len(last) // COLUMNS)
    whole = Image.new("RGB", (GAP_PX + step[0] * COLUMNS, GAP_PX + step[1] * down), (24, 24, 26))
    pen, font = ImageDraw.Draw(whole), ImageFont.load_default(size=11)
    for place, picture in enumerate(last[number] for number in sorted(last)):
        left, top = GAP_PX + step[0] * (place % COLUMNS), GAP_PX + step[1] * (place // COLUMNS)
        with Image.open(picture.files["srgb.png"]) as shown:
            whole.paste(shown.convert("RGB").resize(TILE_PX, Image.Resampling.LANCZOS), (left, top))
        air = f"MOR {picture.mor_m:.0f} m" if picture.mor_m else "clear air"
        pen.text(
            (left + 2, top + TILE_PX[1] + 1), f"{picture.source}, {picture.lighting}, {air}", (225, 225, 225), font
        )
    files.write_whole(target, lambda path: whole.save(path, format="JPEG", quality=86, optimize=True))
    return len(last)


if __name__ == "__main__":
    print(sheet(Path(sys.argv[1]), Path(sys.argv[2])), "scenes")
