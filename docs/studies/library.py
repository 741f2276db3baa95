"""The model library on one sheet: every model from three sides, in clear air under an overcast sky.

    python -m docs.studies.library docs/images/library.png [name ...]
    python -m docs.studies.library --thumbnails assets/models [name ...]

All models stand on one plain, seen from far away, each scaled to the same room,
and are rendered in one picture by the project's own renderer.  The thumbnails, which
the models name, are cut from another such picture, of one view each.
"""

from __future__ import annotations

import functools
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from docs.studies.model_sheet import CELL_PX, VIEWS_DEG, ordered, write_stage
from synfog_usd.base import files, resources
from synfog_usd.base.colour import srgb_encode
from synfog_usd.dataset.bake import bake
from synfog_usd.dataset.plan import BakePlan, Sampling, StageReading
from synfog_usd.world.components import thumbnail_file
from synfog_usd.world.library import library, origin
from synfog_usd.world.library import model as find

if TYPE_CHECKING:
    from PIL import Image

    from synfog_usd.world.library import LibraryModel

WHITE_NITS = 2700.0
THUMBNAIL_PX = 128
THUMBNAIL_COLOURS = 64


def draw(target: Path, models: Sequence[LibraryModel], *, columns: int = 4, samples: int = 24, scale: int = 1) -> None:
    """Render the sheet to `target`, with a caption under each model."""
    from PIL import Image, ImageDraw, ImageFont

    sheet = _rendered(models, samples, scale, lambda stage: write_stage(stage, models, columns))
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=11 * scale)
    for k, model in enumerate(models):
        row, column = divmod(k, columns)
        text = f"{model.name}  {model.length:.2f} x {model.width:.2f} x {model.height:.2f} m"
        corner = (column * len(VIEWS_DEG) * CELL_PX[0] + 6, (row + 1) * CELL_PX[1] - 14)
        pen.text((corner[0] * scale, corner[1] * scale), text, fill=(28, 28, 30), font=font)
    files.write_whole(
        target,
        lambda path: sheet.quantize(256, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.FLOYDSTEINBERG).save(
            path, optimize=True
        ),
    )


def draw_thumbnails(folder: Path, names: Sequence[str] = (), *, columns: int = 10, samples: int = 24) -> list[Path]:
    """Render every model of a library folder, or those named, once, from its front quarter, and cut the picture up;
    gives the files, about 5 kB each.

    The command line above remakes those that ship.
    """
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    models = [model for model in library(folder).values() if not names or model.name in names]
    cell = (THUMBNAIL_PX, THUMBNAIL_PX)
    sheet = _rendered(
        models,
        samples,
        1,
        lambda stage: write_stage(stage, models, columns, views_deg=VIEWS_DEG[:1], cell_px=cell, varied=False),
    )
    made = []
    for k, model in enumerate(models):
        left, top = k % columns * THUMBNAIL_PX, k // columns * THUMBNAIL_PX
        picture = sheet.crop((left, top, left + THUMBNAIL_PX, top + THUMBNAIL_PX)).quantize(
            THUMBNAIL_COLOURS, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE
        )
        made.append(model.path.parent / thumbnail_file(model.name))
        said = PngInfo()
        said.add_text("Description", origin(model))
        files.write_whole(made[-1], functools.partial(picture.save, optimize=True, pnginfo=said))
    return made


def _rendered(
    models: Sequence[LibraryModel], samples: int, scale: int, write: Callable[[Path], tuple[int, int]]
) -> Image.Image:
    """The picture of a sheet's stage, which `write` writes."""
    with tempfile.TemporaryDirectory(prefix="synfog-library-") as folder:
        stage = Path(folder) / "sheet.usda"
        size = write(stage)
        allow = tuple(sorted({resources.folder("assets"), *(m.path.resolve().parents[2] for m in models)}))
        plan = BakePlan(
            stage,
            Path(folder) / "out",
            size=(size[0] * scale, size[1] * scale),
            sampling=Sampling(samples=samples, model="path"),
            reads=StageReading(allow=allow),
        )
        bake(plan)
        return _developed(next((Path(folder) / "out").rglob("radiance.exr")))


def _developed(radiance: Path) -> Image.Image:
    """The picture at an exposure under which a white wall is nearly white; no lens and no sensor, whose errors would
    not be the models'.
    """
    from OpenImageIO import ImageBuf
    from PIL import Image

    nits = np.asarray(ImageBuf(str(radiance)).get_pixels())[..., :3]
    return Image.fromarray(np.round(255 * srgb_encode(nits / WHITE_NITS)).astype(np.uint8))


def main(arguments: Sequence[str]) -> None:
    """`TARGET [name ...]`: all models, or those named, larger; `--thumbnails FOLDER [name ...]`: a small picture beside
    each.
    """
    if arguments[0] == "--thumbnails":
        draw_thumbnails(Path(arguments[1]), arguments[2:])
        return
    target, names = Path(arguments[0]), arguments[1:]
    if names:
        draw(target, [find(name) for name in names], columns=1 if len(names) < 3 else 2, scale=2, samples=32)
    else:
        draw(target, ordered(list(library().values())))


if __name__ == "__main__":
    main(sys.argv[1:])
