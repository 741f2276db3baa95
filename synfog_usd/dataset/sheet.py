"""A sheet of small previews of what recipes draw, for choosing seeds.

Every seed is composed, baked small in each fog of one lighting, and put in its
place: seeds across and down, fogs side by side under one caption.
"""

from __future__ import annotations

import io
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from synfog_usd.base import files, resources
from synfog_usd.base.errors import ParameterError
from synfog_usd.base.progress import Progress, silent
from synfog_usd.dataset.bake import bake
from synfog_usd.dataset.plan import BakePlan, Sampling
from synfog_usd.world.compose import compose

GAP_PX, CAPTION_PX = 4, 16
BACKGROUND, INK = (24, 24, 26), (225, 225, 225)
MOST = 64
"""Seeds of one sheet."""


@dataclass(frozen=True)
class SheetPlan:
    """What a sheet shows.

    Attributes:
        recipes: files; seed k is drawn from the k-th of them, round and round.
        seeds: which.
        out: the PNG.
        lighting, fogs: variants of the stages, or mor<metres>.
        size: of one preview [px]; columns: previews of a row, 0 for as many as make the sheet wide.
        samples, model, variant: see `BakePlan`.
        changes: 'section.key=value' each, over what stands in the recipes.
    """

    recipes: tuple[Path, ...]
    seeds: tuple[int, ...]
    out: Path
    lighting: str = "sky"
    fogs: tuple[str, ...] = ("clear", "mor300")
    size: tuple[int, int] = (320, 180)
    columns: int = 0
    samples: int = 16
    model: str = "auto"
    variant: str = "auto"
    changes: tuple[str, ...] = ()


def write(plan: SheetPlan, *, progress: Progress = silent, log: Callable[[str], None] = lambda text: None) -> Path:
    """Compose and bake all previews and write the sheet.

    Raises:
        SynfogError: with place and fix.
    """
    from PIL import Image, ImageDraw, ImageFont

    if not plan.seeds or len(plan.seeds) > MOST:
        raise ParameterError(f"--seeds: {len(plan.seeds)} of them; a sheet takes 1 to {MOST}")
    if plan.out.suffix != ".png":
        raise ParameterError(f"-o {plan.out}: not a PNG by its name; it ends in .png")
    if plan.lighting not in ("sky", "active"):
        raise ParameterError(f"--lighting {plan.lighting}: composed stages have sky and active")
    across = plan.columns or max(1, round(len(plan.seeds) ** 0.5 / len(plan.fogs) ** 0.5))
    across = min(across, len(plan.seeds))
    down = -(-len(plan.seeds) // across)
    step = (plan.size[0] * len(plan.fogs) + GAP_PX, plan.size[1] + CAPTION_PX + GAP_PX)
    sheet = Image.new("RGB", (GAP_PX + step[0] * across, GAP_PX + step[1] * down), BACKGROUND)
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=11)
    with tempfile.TemporaryDirectory(prefix="synfog-usd-") as scratch:
        for index, seed in enumerate(plan.seeds):
            recipe = plan.recipes[index % len(plan.recipes)]
            stage, folder = Path(scratch) / "stage.usda", Path(scratch) / f"{index}"
            compose(recipe, stage, seed=seed, change=plan.changes)

            def report(what: str, fraction: float, index: int = index, seed: int = seed) -> None:
                progress(f"seed {seed}: {what}", (index + fraction) / len(plan.seeds))

            baked = bake(
                BakePlan(
                    stage,
                    folder,
                    lighting=(plan.lighting,),
                    fog=plan.fogs,
                    size=plan.size,
                    sampling=Sampling(samples=plan.samples, model=plan.model, variant=plan.variant),
                ),
                progress=report,
            )
            corner = (GAP_PX + step[0] * (index % across), GAP_PX + step[1] * (index // across))
            for k, shot in enumerate(baked.manifest["shots"]):
                names = [name for name in shot["files"] if name.endswith(".png")]
                with Image.open(folder / shot["folder"] / names[0]) as picture:
                    sheet.paste(picture.convert("RGB"), (corner[0] + k * plan.size[0], corner[1]))
            pen.text(
                (corner[0] + 2, corner[1] + plan.size[1] + 1),
                f"{recipe.stem} {seed}: {', '.join(plan.fogs)}",
                fill=INK,
                font=font,
            )
            log(f"seed {seed} of {recipe.stem} is done")
    data = io.BytesIO()
    sheet.save(data, format="PNG")
    files.write_bytes(plan.out, data.getvalue())
    return plan.out


def recipes_of(path: Path) -> tuple[Path, ...]:
    """A recipe by its path or its name, or all of a folder."""
    if not path.is_dir():
        return (resources.named(path, "recipe"),)
    paths: Sequence[Path] = sorted(path.glob("*.yaml"))
    if not paths:
        raise ParameterError(f"{path}: no recipe (.yaml) in this folder")
    return tuple(paths)


def seeds_of(text: str) -> tuple[int, ...]:
    """Seeds from text: single ones and ranges, comma-separated, as '3,9-11'."""
    seeds: list[int] = []
    for piece in text.split(","):
        low, dash, high = piece.strip().partition("-")
        if not low.isdecimal() or (dash and not high.isdecimal()) or len(low) > 9 or len(high) > 9:
            raise ParameterError(f"--seeds {text}: takes whole numbers and ranges, as in 0-15 or 3,7,9-11")
        end = int(high) if dash else int(low)
        if end < int(low) or end - int(low) >= MOST:
            raise ParameterError(f"--seeds {text}: {piece.strip()} is not 1 to {MOST} seeds in rising order")
        seeds += range(int(low), end + 1)
    return tuple(seeds)
