"""What it saves, and what it costs in error, that fog hides instances: the same shot with all of them and without.

From a shell: `python -m synfog_usd.study.pages.culling docs/measurements/culling.md` measures CASES and
replaces what stands between the page's two marks.  Both pictures of a pair are made with
the same random numbers, so that most of their noise cancels, and twice, with seeds of their
own, which tells what noise is left.  Errors are in standard deviations of the sensor's noise.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from synfog_usd import files, photometry, resources
from synfog_usd.arrays import Array
from synfog_usd.errors import ParameterError

if TYPE_CHECKING:
    from synfog_usd.scene import SceneDict


BEGIN, END = "<!-- culling: written by synfog_usd.study.pages.culling; do not edit -->", "<!-- end of culling -->"

SIZE = (64, 36)
SAMPLES = 256
SEEDS = (5, 6)

SQUARE_PX = 4
"""Side of the squares over which errors are averaged: a pixel's own noise, at the samples that a minute allows, is as
large as what is looked for.
"""

CASES = (
    ("crossroads", "sky", 50.0),
    ("motorway", "sky", 50.0),
    ("motorway", "sky", 150.0),
    ("motorway", "active", 50.0),
    ("residential", "sky", 50.0),
    ("arterial", "sky", 50.0),
    ("bridge", "sky", 50.0),
    ("car_park", "sky", 50.0),
    ("roundabout", "sky", 50.0),
    ("rural", "sky", 50.0),
    ("tunnel", "sky", 50.0),
    ("crossroads", "active", 50.0),
    ("residential", "active", 50.0),
)
"""Stage or recipe, lighting and visibility [m]."""


@dataclass(frozen=True)
class Saving:
    """One shot whole and reduced.

    Attributes:
        name: stage, lighting and fog.
        instances, of_instances: that are not drawn whole, and all.
        triangles, of_triangles: that the renderer was spared, and all.
        limit: transmittance below which instances are hidden.
        load_s, render_s: wall time of loading and of one render, whole and reduced; the least of two renders, kernels
            made before.
        error, error_max: RMS and maximum over squares of the picture of |reduced - whole| over the sensor's sigma.
        noise, noise_max: the same of what differs between seeds.
    """

    name: str
    instances: int
    of_instances: int
    triangles: int
    of_triangles: int
    limit: float
    load_s: tuple[float, float]
    render_s: tuple[float, float]
    error: float
    error_max: float
    noise: float
    noise_max: float


def saving(name: str, scene: SceneDict, *, samples: int = SAMPLES, leave_out: bool = False) -> Saving | None:
    """Render a foggy scene whole and reduced.

    Args:
        name: for the record.
        scene: with its fog, at the size to compare at.
        samples: paths per pixel.
        leave_out: leave out all that is hidden, instead of simplifying what would be missed: to see what that would
            cost.

    Returns:
        None where the fog hides too little.
    """
    from synfog_usd import camera, cull
    from synfog_usd.render import shot

    graph = camera.load_graph(resources.folder("pipeline") / "phone.yaml")
    clear = shot.render(replace(scene, fog=()), samples=64, seed=1, size=(160, 90)).radiance
    pixel = camera.sensitivity(clear, graph, camera.meter(clear, graph))
    assert pixel is not None

    def noise(luminance: Array) -> Array:
        return camera.noise_floor(luminance, electrons_per_cd_m2=pixel[0], dark_noise_e=pixel[1])

    hidden = cull.hide(scene, noise, photometry.luminance(clear).astype(np.float64))
    if not hidden.triangles:
        return None
    if leave_out:
        hidden = replace(hidden, simplified=frozenset(), left_out=hidden.simplified | hidden.left_out)
    whole, load_whole, render_whole = _pictures(scene, samples)
    reduced, load_reduced, render_reduced = _pictures(cull.reduced(scene, hidden), samples)
    sigma = _squares(noise(np.mean(whole, axis=0)))
    one, other = (_squares(b - a) / sigma for a, b in zip(whole, reduced, strict=True))
    mean, half = 0.5 * (one + other), 0.5 * (one - other)
    metadata = hidden.metadata(scene)
    return Saving(
        name,
        metadata["simplified"] + metadata["left_out"],
        metadata["instances"],
        hidden.triangles,
        hidden.of_triangles,
        hidden.limit,
        (load_whole, load_reduced),
        (render_whole, render_reduced),
        float(np.sqrt((mean**2).mean())),
        float(np.abs(mean).max()),
        float(np.sqrt((half**2).mean())),
        float(np.abs(half).max()),
    )


def _pictures(scene: SceneDict, samples: int) -> tuple[list[Array], float, float]:
    from synfog_usd.render import shot

    began = time.perf_counter()
    loaded = shot.load(scene, boundaries=False)
    load_s = time.perf_counter() - began
    shot.render(scene, model="path", samples=16, seed=0, loaded=loaded)  # the kernels
    pictures, seconds = [], []
    for seed in SEEDS:
        began = time.perf_counter()
        made = shot.render(scene, model="path", samples=samples, seed=seed, loaded=loaded).radiance
        seconds.append(time.perf_counter() - began)
        pictures.append(
            photometry.luminance(made).reshape(scene.camera.height_px, scene.camera.width_px).astype(np.float64)
        )
    return pictures, load_s, min(seconds)


def _squares(picture: Array) -> Array:
    side = SQUARE_PX
    height, width = (length // side * side for length in picture.shape)
    return np.asarray(picture[:height, :width].reshape(height // side, side, width // side, side).mean(axis=(1, 3)))


def foggy(stage: Path, lighting: str, visibility_m: float) -> SceneDict:
    """A stage in one lighting and fog, small."""
    from synfog_usd import stage as usd
    from synfog_usd.fog import Fog
    from synfog_usd.translate import translate

    opened = usd.open_stage(stage)
    usd.select(opened, fog=None, lighting=lighting)
    return translate(opened, resolution=SIZE, fog=Fog(visibility_m))


def measured(cases: Iterable[tuple[str, str, float]] = CASES) -> list[Saving]:
    """Every case that hides anything; recipes are drawn with seed 3."""
    from synfog_usd.render import backend
    from synfog_usd.world.compose import compose

    backend.start("auto")
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name, lighting, visibility_m in cases:
            stage = resources.folder("stages") / f"{name}.usda"
            if not stage.exists():
                stage = Path(folder) / f"{name}.usda"
                if not stage.exists():
                    compose(resources.folder("stages") / "recipes" / f"{name}.yaml", stage, seed=3)
            row = saving(
                f"{name}, {lighting}, MOR {visibility_m:g}",
                foggy(stage, lighting, visibility_m),
            )
            rows += [] if row is None else [row]
            print(row, file=sys.stderr, flush=True)
    return rows


def section(rows: Iterable[Saving]) -> str:
    """What stands between the marks, in Markdown."""
    from synfog_usd.study.chart import machine

    text = f"{SIZE[0]} x {SIZE[1]}, {SAMPLES} samples of `path`, {machine()}; the phone's sensor, "
    text += f"errors over squares of {SQUARE_PX} pixels.\n\n"
    text += (
        "| shot | hidden below T | instances hidden | triangles saved | load, s | render, s | error / sigma, RMS | "
        "largest | of it noise |\n"
    )
    text += "|---|---|---|---|---|---|---|---|---|\n"
    for row in rows:
        cells: list[Any] = [
            row.name,
            f"{row.limit:.2g}",
            f"{row.instances} of {row.of_instances}",
            f"{row.triangles / row.of_triangles:.0%} of {row.of_triangles}",
        ]
        cells += [f"{whole:.1f} -> {reduced:.1f}" for whole, reduced in (row.load_s, row.render_s)]
        cells += [f"{row.error:.3f}", f"{row.error_max:.3f}", f"{row.noise:.3f}, {row.noise_max:.3f}"]
        text += f"| {' | '.join(map(str, cells))} |\n"
    return text


def write_culling_table(document: Path, rows: Iterable[Saving]) -> None:
    """Bring a page up to what was measured.

    Raises:
        ParameterError: no marks in it.
    """
    before, begin, rest = document.read_text(encoding="utf-8").partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise ParameterError(f"{document}: has not the two marks {BEGIN!r} and {END!r}, between which the numbers go")
    files.write_bytes(document, f"{before}{BEGIN}\n\n{section(rows)}\n{END}{after}".encode())


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python -m synfog_usd.study.pages.culling docs/measurements/culling.md")
    write_culling_table(Path(sys.argv[1]), measured())
