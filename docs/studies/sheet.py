"""A sheet of small previews of what recipes draw, for choosing seeds.

From a shell: `python -m docs.studies.sheet stages/recipes -o sheet.png --seeds 0-15`.  Every seed is composed, baked
small in clear air and in fog, and put in its place; a folder's recipes take turns.
"""

from __future__ import annotations

import io
import tempfile
from pathlib import Path
from typing import Annotated

import typer
from PIL import Image, ImageDraw, ImageFont

from docs.studies import command
from synfog_usd.base import files, resources
from synfog_usd.dataset.bake import bake
from synfog_usd.dataset.plan import BakePlan
from synfog_usd.dataset.sets.run import numbers_of
from synfog_usd.world.compose import compose

GAP_PX, CAPTION_PX = 4, 16
BACKGROUND, INK = (24, 24, 26), (225, 225, 225)
MOST = 64
"""Seeds of one sheet."""

FOGS, SIZE_PX = ("clear", "mor300"), (320, 180)
"""Of each preview."""


def sheet(
    recipe: Path,
    out: Annotated[Path, typer.Option("--out", "-o")],
    seeds: str = "0-15",
    lighting: str = "sky",
) -> None:
    """Compose and bake all previews and write the sheet.

    Raises:
        SynfogError: with place and fix.
    """
    recipes = sorted(recipe.glob("*.yaml")) if recipe.is_dir() else [resources.named(recipe, "recipe")]
    numbers = numbers_of(seeds, MOST)
    across = max(1, round((len(numbers) / len(FOGS)) ** 0.5))
    step = (SIZE_PX[0] * len(FOGS) + GAP_PX, SIZE_PX[1] + CAPTION_PX + GAP_PX)
    size = (GAP_PX + step[0] * across, GAP_PX + step[1] * -(-len(numbers) // across))
    picture = Image.new("RGB", size, BACKGROUND)
    pen, font = ImageDraw.Draw(picture), ImageFont.load_default(size=11)
    for index, seed in enumerate(numbers):
        drawn = recipes[index % len(recipes)]
        x, y = (GAP_PX + length * place for length, place in zip(step, (index % across, index // across), strict=True))
        for fog, preview in enumerate(previews(drawn, seed, lighting)):
            picture.paste(preview, (x + fog * SIZE_PX[0], y))
        pen.text((x + 2, y + SIZE_PX[1] + 1), f"{drawn.stem} {seed}: {', '.join(FOGS)}", fill=INK, font=font)
    data = io.BytesIO()
    picture.save(data, format="PNG")
    files.write_bytes(out, data.getvalue())


def previews(recipe: Path, seed: int, lighting: str) -> list[Image.Image]:
    """What a seed of a recipe draws, in each of FOGS."""
    with tempfile.TemporaryDirectory(prefix="synfog-usd-") as scratch:
        stage, out = Path(scratch) / "stage.usda", Path(scratch) / "out"
        compose(recipe, stage, seed=seed)
        bake(BakePlan(stage, out, lighting=(lighting,), fog=FOGS, size=SIZE_PX))
        return [Image.open(out / lighting / fog / "srgb.png").convert("RGB") for fog in FOGS]


if __name__ == "__main__":
    command.run(sheet)
