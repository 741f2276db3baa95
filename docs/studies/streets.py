"""Real streets, ours beside Mitsuba's `volpath` and Blender Cycles: what a shot of a shipped street costs with each.

Every figure is the variance of one sample, relative to the pixel's light, times the
processor seconds that the sample takes: how long a renderer works for a given noise.
Processor seconds bear other work on the machine; ratios in one run are what counts.

    python -m docs.studies.streets volpath                       # the streets as they are
    python -m docs.studies.streets cycles --bpy BLENDER_ENV/bin/python -o out/streets    # the same streets, matt
    python -m docs.studies.streets volpath --only crossing --samples 64
    python -m docs.studies.streets even --only patches           # patchy fog beside even fog of the same mean
    python -m docs.studies.streets denoised --bpy BLENDER_ENV/bin/python --size 192x108 --samples 16 --only crossroads

Cycles gets what `cycles_scene.py` exports: the same triangles, lamps, sky, fog and
camera, each material's mean colour without gloss, masks or texture; lamps with a table
of their light become spots of the same flux that shine down.  Ours draws that too.

`denoised` asks how many processor seconds Cycles and its denoiser take for the error that ours leaves at so many
samples, denoised.  Each is judged by its own renderer's mean of many samples, so that what the two mean by a scene
does not count.

Variance is measured between renders of several seeds and pooled over blocks of 4 x 4
pixels, since that of one pixel from six seeds is hardly known; 'all' leaves the worst
hundredth of the blocks out.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from docs.studies.cycles_scene import export, simplified
from synfog_usd import stage as usd
from synfog_usd.base.arrays import Array
from synfog_usd.fog import Fog
from synfog_usd.fog.grid import DensityGrid
from synfog_usd.fog.patchy import patchy
from synfog_usd.render import models, shot
from synfog_usd.render.lights import photometric
from synfog_usd.scene import SceneDict
from synfog_usd.scene.testing import box
from synfog_usd.translate import translate
from synfog_usd.world.compose import compose

ROOT = Path(__file__).parents[2]
BLOCK_PX = 4
SPOT_CUTOFF_DEG = 75.0
"""Of a spot that stands for a street lamp's table."""


@dataclass(frozen=True)
class Street:
    """One shot.

    Attributes:
        source: a stage, or a recipe that is drawn with seed 3; below `stages/`.
        lighting: variant of the stage.
        mor_m: visibility [m], or None for clear air.
        patch_m: outer scale [m] of patchy fog, whose deviation is half of its mean; None for even fog.
    """

    source: str
    lighting: str
    mor_m: float | None
    patch_m: float | None = None

    @property
    def name(self) -> str:
        """As in 'crossroads dusk MOR 150'."""
        return (
            f"{Path(self.source).stem} {'dusk' if self.lighting == 'active' else 'noon'} "
            f"{'clear' if self.mor_m is None else f'MOR {self.mor_m:g}'}"
            f"{'' if self.patch_m is None else f', patches of {self.patch_m:g} m'}"
        )


STREETS = (
    Street("crossroads.usda", "sky", None),
    Street("crossroads.usda", "sky", 300.0),
    Street("crossroads.usda", "sky", 150.0),
    Street("crossroads.usda", "sky", 150.0, patch_m=8.0),
    Street("crossroads.usda", "active", None),
    Street("crossroads.usda", "active", 300.0),
    Street("crossroads.usda", "active", 150.0),
    Street("recipes/residential.yaml", "active", 300.0),
    Street("recipes/arterial.yaml", "active", 300.0),
    Street("recipes/motorway.yaml", "active", 300.0),
    Street("recipes/tunnel.yaml", "active", 300.0),
    Street("recipes/car_park.yaml", "active", 300.0),
)


def scene_of(street: Street, size: tuple[int, int], folder: Path) -> SceneDict:
    """The street's shot, translated."""
    path = ROOT / "stages" / street.source
    if path.suffix == ".yaml":
        drawn = folder / f"{path.stem}.usda"
        if not drawn.exists():
            compose(path, drawn, seed=3)
        path = drawn
    stage = usd.open_stage(path, allow=(ROOT / "assets",))
    fogs = usd.variants(stage)["fog"]
    foggy = next(name for name in fogs if name != "clear")
    usd.select(stage, fog="clear" if street.mor_m is None else foggy, lighting=street.lighting)
    scene = translate(stage, resolution=size, fog=street.mor_m and Fog(street.mor_m))
    return scene if street.patch_m is None else in_patches(scene, patchy(street.patch_m, 0.5))


def in_patches(scene: SceneDict, grid: DensityGrid | None) -> SceneDict:
    """The scene in fog of as much extinction in the mean, patchy or even, in a box of 300 m that `volpath` can hold."""
    (fog,) = scene.fog
    around = box((150.0, 150.0, 60.0), scene.camera.to_world[:3, 3] + (0.0, 110.0, 38.0))
    profile = "uniform" if grid is None else "grid"
    return replace(scene, fog=(replace(fog, boundary=around, medium=replace(fog.medium, profile=profile, grid=grid)),))


def matt(scene: SceneDict) -> SceneDict:
    """What Cycles can be given of it, see `cycles_scene.simplified`; lamps with a table become spots of their flux."""
    world = dict(scene.world)
    for key, part in scene.world.items():
        if isinstance(part, dict) and part.get("type") == photometric.TYPE:
            table = photometric.table_of(part).mean(axis=(1, 2))
            flux = float(photometric.ring_weights(len(table)) @ table)
            solid_angle = 2.0 * np.pi * (1.0 - np.cos(np.radians(SPOT_CUTOFF_DEG - 5.0)))
            intensity = np.asarray(part["intensity"]["value"], dtype=np.float64) * flux / solid_angle
            place = np.array([[1.0, 0, 0, 0], [0, -1.0, 0, 0], [0, 0, -1.0, 0], [0, 0, 0, 1.0]])
            place[:3, 3] = np.asarray(part["to_world"], dtype=np.float64)[:3, 3]
            world[key] = {
                "type": "spot",
                "intensity": {"type": "rgb", "value": intensity.tolist()},
                "to_world": place,
                "cutoff_angle": SPOT_CUTOFF_DEG,
                "beam_width": SPOT_CUTOFF_DEG - 10.0,
            }
    return simplified(replace(scene, world=world))


def cost(images: Array, seconds_per_sample: float, samples: int) -> tuple[float, float]:
    """Relative variance of one sample x seconds of it, median and mean over blocks.

    Args:
        images: (S, H, W) luminance of renders with seeds of their own.
        seconds_per_sample: processor seconds of one sample of every pixel.
        samples: a pixel of each render.
    """
    height, width = (side // BLOCK_PX * BLOCK_PX for side in images.shape[1:])
    variance, mean = images.var(axis=0, ddof=1)[:height, :width], images.mean(axis=0)[:height, :width]
    blocks = [
        x.reshape(height // BLOCK_PX, BLOCK_PX, width // BLOCK_PX, BLOCK_PX).mean(axis=(1, 3)).ravel()
        for x in (variance, mean)
    ]
    lit = blocks[1] > 1e-3 * blocks[1].mean()
    relative = np.sort(blocks[0][lit] / blocks[1][lit] ** 2) * samples * seconds_per_sample
    return float(np.median(relative)), float(relative[: int(0.99 * len(relative)) or 1].mean())


def ours(scene: SceneDict, model: str, samples: int, seeds: int) -> tuple[Array, float]:
    """(S, H, W) luminance and processor seconds of one sample of every pixel; kernels are made before."""
    integrator = models.make(model, shot.load(scene, boundaries=models.MODELS[model].boundaries, spectra=False))
    integrator.accumulate(samples=16, seed=99)
    shape = scene.camera.height_px, scene.camera.width_px
    images, spent = [], []
    for seed in range(seeds):
        begin = time.process_time()
        images.append(integrator.accumulate(samples=samples, seed=seed).mean().mean(axis=1).reshape(shape))
        spent.append(time.process_time() - begin)
    return np.array(images), float(np.median(spent)) / samples


def cycles(scene: SceneDict, python: Path, stem: Path, samples: int, seeds: int) -> tuple[Array, float]:
    """The same of Cycles; seconds are the slope from these samples to eight times as many.

    Before its first sample it spends seconds on a picture, so a slope between few samples errs by up to two times.
    """
    export(scene, stem)
    many = 8 * samples
    result = stem.with_suffix(".cycles.npz")
    command = [str(python), str(Path(__file__).parent / "cycles_peer.py"), str(stem), str(result)]
    subprocess.run([*command, "--samples", f"{samples},{many}", "--seeds", str(seeds)], check=True, capture_output=True)
    found = np.load(result)
    counts, spent = found["samples"], found["processor_s"]
    slope = (np.median(spent[counts == many]) - np.median(spent[counts == samples])) / (many - samples)
    return found["images"][counts == samples].astype(np.float64).mean(axis=3), float(slope)


def left_over(picture: Array, truth: Array) -> float:
    """Relative RMS error over the lit pixels, without the worst hundredth."""
    lit = truth > 1e-3 * truth.mean()
    relative = np.sort(np.abs(picture[lit] / truth[lit] - 1.0))
    return float(np.sqrt(np.mean(relative[: int(0.99 * relative.size)] ** 2)))


def denoised(
    street: Street, scene: SceneDict, python: Path, folder: Path, *, samples: int, seeds: int, truth: int, most: int
) -> dict[str, float]:
    """Processor seconds and error of ours at `samples`, of Cycles at the count that leaves as much, and their ratio.

    Args:
        street: for names of files.
        scene: matt.
        python: has bpy.
        folder: for what is exchanged.
        samples: a pixel of ours.
        seeds: renders of each count.
        truth: samples a pixel of each renderer's own reference.
        most: samples of Cycles are 4, 8 and so on up to these.
    """
    stem = folder / street.name.replace(" ", "_")
    integrator = models.make("path", shot.load(scene))
    shape = scene.camera.height_px, scene.camera.width_px
    own = integrator.accumulate(samples=truth, seed=1234).mean().mean(axis=1).reshape(shape)
    loaded = shot.load(scene)
    shot.render(scene, samples=samples, seed=99, model="path", denoise=True, loaded=loaded)  # kernels are made
    errors, spent = [], []
    for seed in range(seeds):
        begin = time.process_time()
        found = shot.render(scene, samples=samples, seed=seed, model="path", denoise=True, loaded=loaded)
        spent.append(time.process_time() - begin)
        errors.append(left_over(found.radiance.pixels.astype(np.float64).mean(axis=2), own))
    error, seconds = float(np.mean(errors)), float(np.median(spent))

    export(scene, stem)
    command = [str(python), str(Path(__file__).parent / "cycles_peer.py"), str(stem)]

    def drawn(name: str, counts: str, *words: str) -> Any:
        result = folder / f"{stem.name}_{name}.npz"
        subprocess.run([*command, str(result), "--samples", counts, *words], check=True, capture_output=True)
        return np.load(result)

    other = drawn("truth", str(truth), "--seeds", "1")["images"][0].astype(np.float64).mean(axis=2)
    counts = [4 * 2**power for power in range(most.bit_length() - 2)]
    found = drawn("denoised", ",".join(map(str, counts)), "--seeds", str(seeds), "--denoise")
    theirs, cost_s = [], []
    for count in counts:
        pictures = found["images"][found["samples"] == count].astype(np.float64).mean(axis=3)
        theirs.append(float(np.mean([left_over(picture, other) for picture in pictures])))
        cost_s.append(float(np.median(found["processor_s"][found["samples"] == count])))
    falls = np.minimum.accumulate(theirs)[::-1]
    reached = falls[0] <= error
    needed = float(np.exp(np.interp(np.log(error), np.log(falls), np.log(cost_s[::-1])))) if reached else cost_s[-1]
    return {
        "error": error,
        "seconds": seconds,
        "cycles_seconds": needed,
        "ratio": needed / seconds,
        "cycles_reached": float(reached),
        "cycles_errors": theirs,  # type: ignore[dict-item]
        "cycles_costs": cost_s,  # type: ignore[dict-item]
    }


def main() -> None:
    """Measure what the command line asks for."""
    parser = argparse.ArgumentParser()
    parser.add_argument("peer", choices=("volpath", "cycles", "denoised", "even"))
    parser.add_argument("--bpy", type=Path, help="a Python that has bpy 5.0.1")
    parser.add_argument("--only", default="", help="part of the streets' names")
    parser.add_argument("--models", default="path")
    parser.add_argument("--size", default="96x54")
    parser.add_argument("--samples", type=int, default=64)
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--truth", type=int, default=1024, help="samples of the references of `denoised`")
    parser.add_argument("--most", type=int, default=128, help="samples of Cycles in `denoised`")
    parser.add_argument("-o", "--out", type=Path)
    arguments = parser.parse_args()
    from synfog_usd.render import backend

    backend.start()
    width, height = (int(part) for part in arguments.size.split("x"))
    with tempfile.TemporaryDirectory() as scratch:
        folder = arguments.out or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        if arguments.peer == "denoised":
            print("| street | error left | ours [s] | Cycles [s] | Cycles over ours |")
            for street in STREETS:
                if arguments.only in street.name:
                    row = denoised(
                        street,
                        matt(scene_of(street, (width, height), folder)),
                        arguments.bpy,
                        folder,
                        samples=arguments.samples,
                        seeds=arguments.seeds,
                        truth=arguments.truth,
                        most=arguments.most,
                    )
                    more = "" if row["cycles_reached"] else "over "
                    print(
                        f"| {street.name} | {row['error']:.2%} | {row['seconds']:.2f} | {more}"
                        f"{row['cycles_seconds']:.2f} | {more}{row['ratio']:.1f} |",
                        flush=True,
                    )
                    name = f"{street.name.replace(' ', '_')}_denoised.json"
                    (folder / name).write_text(json.dumps(row, indent=1))
            return
        heads = " | ".join(f"{model} over {arguments.peer}, median / all" for model in arguments.models.split(","))
        print(f"| street | {heads} | mean of the picture, ours over theirs |")
        for street in STREETS:
            if arguments.only not in street.name:
                continue
            scene = scene_of(street, (width, height), folder)
            if arguments.peer == "cycles":
                scene = matt(scene)
                stem = folder / street.name.replace(" ", "_")
                images, seconds = cycles(scene, arguments.bpy, stem, arguments.samples, arguments.seeds)
            elif arguments.peer == "even":
                images, seconds = ours(in_patches(scene, None), "path", arguments.samples, arguments.seeds)
            else:
                images, seconds = ours(scene, "volpath", arguments.samples, arguments.seeds)
            theirs = cost(images, seconds, arguments.samples)
            rows: dict[str, Any] = {
                arguments.peer: {"median": theirs[0], "all": theirs[1], "us_per_path": seconds / (width * height) * 1e6}
            }
            cells, mean = [], float(images.mean())
            for model in arguments.models.split(","):
                if street.mor_m is None and model != "path":
                    cells.append("")
                    continue
                pictures, spent = ours(scene, model, arguments.samples, arguments.seeds)
                found = cost(pictures, spent, arguments.samples)
                rows[model] = {
                    "median": found[0],
                    "all": found[1],
                    "us_per_path": spent / (width * height) * 1e6,
                    "mean": float(pictures.mean()) / mean,
                }
                cells.append(f"{theirs[0] / found[0]:.1f} / {theirs[1] / found[1]:.1f}")
            print(f"| {street.name} | {' | '.join(cells)} | {rows['path']['mean']:.4f} |", flush=True)
            (folder / f"{street.name.replace(' ', '_')}_{arguments.peer}.json").write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
