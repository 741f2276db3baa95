"""Who agrees with whom: our fog beside closed forms of other people, and our foggy streets beside Blender Cycles'.

    python -m docs.studies.agreement closed                    # two-stream, diffusion
    python -m docs.studies.agreement cycles --bpy BLENDER_ENV/bin/python -o out/agreement [--only crossroads]

`cycles`: both draw the same triangles, matt colours, lamps, sky and fog (`cycles_scene.py`).  Regions are a twelfth
of the picture.  Prints for each street the ratio of the whole means and the region that is farthest off, each with its
standard error from seeds, and chi-square over the regions: 1 where noise alone parts the two.  Writes
`agreement.csv`, a row a region, and `agreement.png`: ours, Cycles', and how far they are apart in blocks.
"""

from __future__ import annotations

import argparse
import csv
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from docs.studies.cycles_scene import export, from_stage
from docs.studies.streets import ROOT, STREETS, matt, scene_of
from synfog_usd.fog import FogMedium
from synfog_usd.fog.slab import solve
from synfog_usd.render import models, shot
from synfog_usd.scene import SceneDict

Array = npt.NDArray[np.float64]
ROWS, COLUMNS = 3, 4
"""Regions of a picture."""

BLOCK_PX = 4
SHOWN = 0.05
"""Difference that the map draws in its full colour."""

BENCH = ("overcast_street", "canyon")

EXTRAPOLATION = 0.7104461
"""Milne's problem: how far behind the edge of thick fog diffused light would end, in transport mean free paths."""


@dataclass(frozen=True)
class Compared:
    """Ours beside theirs.

    Attributes:
        ours, theirs: (S, H, W) luminance of renders with seeds of their own.
    """

    ours: Array
    theirs: Array

    def ratio(self, rows: int, columns: int) -> tuple[Array, Array]:
        """(rows, columns) theirs over ours, and its standard error."""
        one, other = (_regions(images, rows, columns) for images in (self.ours, self.theirs))
        found = other.mean(axis=0) / one.mean(axis=0)
        error2 = sum(images.var(axis=0, ddof=1) / len(images) / images.mean(axis=0) ** 2 for images in (one, other))
        return found, found * np.sqrt(error2)


def _regions(images: Array, rows: int, columns: int) -> Array:
    """(S, rows, columns) means."""
    seeds, height, width = images.shape
    return (
        images[:, : height // rows * rows, : width // columns * columns]
        .reshape(seeds, rows, height // rows, columns, width // columns)
        .mean(axis=(2, 4))
    )


def scenes(size: tuple[int, int], folder: Path) -> dict[str, Callable[[], SceneDict]]:
    """Name of each street, and what makes its scene."""
    found: dict[str, Callable[[], SceneDict]] = {
        f"{name} MOR 150": lambda name=name: from_stage(  # type: ignore[misc]
            ROOT / "stages" / "bench" / f"{name}.usda", fog="mor150", size=size
        )
        for name in BENCH
    }
    return found | {
        street.name: lambda street=street: matt(scene_of(street, size, folder))  # type: ignore[misc]
        for street in STREETS
        if street.source == "crossroads.usda" and street.mor_m is not None
    }


def compared(scene: SceneDict, python: Path, stem: Path, *, samples: int, seeds: int) -> Compared:
    """Both pictures; Cycles takes as many samples as ours."""
    shape = scene.camera.height_px, scene.camera.width_px
    integrator = models.make("path", shot.load(scene, boundaries=models.MODELS["path"].boundaries))
    own = [
        integrator.accumulate(samples=samples, seed=seed).mean().mean(axis=1).reshape(shape) for seed in range(seeds)
    ]
    export(scene, stem)
    result = stem.with_suffix(".cycles.npz")
    command = [str(python), str(Path(__file__).parent / "cycles_peer.py"), str(stem), str(result)]
    subprocess.run([*command, "--samples", str(samples), "--seeds", str(seeds)], check=True, capture_output=True)
    return Compared(np.array(own), np.load(result)["images"].astype(np.float64).mean(axis=3))


def draw(found: dict[str, Compared], path: Path) -> None:
    """Ours, Cycles', and the difference of each street in a row."""
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(len(found), 3, figsize=(11, 2.2 * len(found)), squeeze=False, layout="constrained")
    for line, (name, pair) in zip(axes, found.items(), strict=True):
        ours, theirs = pair.ours.mean(axis=0), pair.theirs.mean(axis=0)
        white = 1.3 * np.percentile(ours, 99.0)
        for axis, picture, title in zip(line, (ours, theirs), (f"{name}: ours", "Cycles 5.0.1"), strict=False):
            axis.imshow(np.clip(picture / white, 0.0, 1.0) ** (1 / 2.2), cmap="gray", vmin=0, vmax=1)
            axis.set_title(title, fontsize=9)
        ratio, _ = pair.ratio(ours.shape[0] // BLOCK_PX, ours.shape[1] // BLOCK_PX)
        shown = line[2].imshow(100.0 * (ratio - 1.0), cmap="RdBu_r", vmin=-100 * SHOWN, vmax=100 * SHOWN)
        line[2].set_title(f"Cycles over ours, less 1 [%], {BLOCK_PX} x {BLOCK_PX} pixels", fontsize=9)
        figure.colorbar(shown, ax=line[2])
        for axis in line:
            axis.set_xticks([])
            axis.set_yticks([])
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def transmitted(optical_depth: float, g: float) -> dict[str, float]:
    """Part of a uniform sky's light that reaches black ground through a slab that absorbs nothing: ours, and others'.

    Source: Meador and Weaver, J. Atmos. Sci. 37 (1980), for Eddington's and the quadrature's two streams; van de Hulst,
    "Multiple Light Scattering" (1980), for thick fog.
    """
    slab = solve(FogMedium(optical_depth / 60.0, g=g), bottom_m=0.0, top_m=60.0, ground=0.0)
    node, weight = np.polynomial.legendre.leggauss(64)
    up = (node + 1.0) / 2.0
    scaled = (1.0 - g) * optical_depth
    return {
        "ours": float(slab.radiance(np.zeros(up.size), up) * up @ weight),
        "diffusion": (4.0 / 3.0) / (scaled + 2.0 * EXTRAPOLATION),
        "Eddington": 1.0 / (1.0 + 0.75 * scaled),
        "quadrature": 1.0 / (1.0 + np.sqrt(0.75) * scaled),
    }


def closed() -> None:
    """A table."""
    print("| g | optical depth | ours | diffusion | Eddington | quadrature |\n|---|---|---|---|---|---|")
    for g in (0.0, 0.87):
        for depth in (1.2, 3.0, 10.0, 30.0, 100.0):
            row = transmitted(depth, g)
            others = " | ".join(f"{value / row['ours'] - 1.0:+.3%}" for name, value in row.items() if name != "ours")
            print(f"| {g:g} | {depth:g} | {row['ours']:.5f} | {others} |")


def main() -> None:
    """Measure what the command line asks for."""
    parser = argparse.ArgumentParser()
    parser.add_argument("verb", choices=("closed", "cycles"))
    parser.add_argument("--bpy", type=Path, help="a Python that has bpy 5.0.1")
    parser.add_argument("--only", default="", help="part of the streets' names")
    parser.add_argument("--size", default="64x36")
    parser.add_argument("--samples", type=int, default=1024, help="a pixel, of each seed")
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("-o", "--out", type=Path, default=Path("out/agreement"))
    arguments = parser.parse_args()
    if arguments.verb == "closed":
        closed()
        return
    from synfog_usd.render import backend

    backend.start()
    width, height = (int(part) for part in arguments.size.split("x"))
    arguments.out.mkdir(parents=True, exist_ok=True)
    found: dict[str, Compared] = {}
    table = []
    print(
        "| street | whole picture, Cycles over ours | farthest region | chi-square over 12 regions |\n|---|---|---|---|"
    )
    for name, make in scenes((width, height), arguments.out).items():
        if arguments.only not in name:
            continue
        stem = arguments.out / name.replace(" ", "_")
        found[name] = compared(make(), arguments.bpy, stem, samples=arguments.samples, seeds=arguments.seeds)
        (whole,), (whole_error,) = (x.ravel() for x in found[name].ratio(1, 1))
        ratio, error = found[name].ratio(ROWS, COLUMNS)
        worst = np.unravel_index(int(np.abs(ratio - 1.0).argmax()), ratio.shape)
        print(
            f"| {name} | {whole - 1:+.2%} ± {whole_error:.2%} | {ratio[worst] - 1:+.2%} ± {error[worst]:.2%} | "
            f"{np.mean(((ratio - 1.0) / error) ** 2):.1f} |",
            flush=True,
        )
        table += [
            (name, row, column, f"{ratio[row, column]:.5f}", f"{error[row, column]:.5f}")
            for row in range(ROWS)
            for column in range(COLUMNS)
        ]
        with (arguments.out / "agreement.csv").open("w", newline="") as file:
            csv.writer(file).writerows([("street", "row", "column", "cycles_over_ours", "standard_error"), *table])
        draw(found, arguments.out / "agreement.png")


if __name__ == "__main__":
    main()
