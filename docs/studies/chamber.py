"""A fog chamber, measured as in a laboratory: a laser on a power meter, and a chart of patches before a camera.

Takes a stage with cameras named 'Laser' and 'Meter', fog variants, and patches below a prim 'Chart'; gives what the
renderer's own transport makes of them.

**The laser** is a pencil: rays of a camera a thousandth of a degree wide, followed by `path` as a laser's photons go,
to a disc that counts what falls on it from any side.  Where less than half of the light is left, roulette decides who
arrives: there the law ln(P0 / P) = sigma u is drawn at random and not read off.

**The chart** is what the camera sees of the patches by `path`, by `single`, and by J t + A (1 - t) with two airlights:
the truth's own (what the fog between camera and chart sends out at this density, which only a simulation knows) and
the one guessed from the picture by its dark channel.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from scipy import ndimage, stats

from docs.studies import command, statistics
from synfog_usd.base import resources, seeds
from synfog_usd.base.arrays import Array, Flags, Indices
from synfog_usd.base.errors import StageError
from synfog_usd.base.progress import Progress, silent, within
from synfog_usd.cli.progress import shown
from synfog_usd.fog.airlight import estimated_airlight
from synfog_usd.fog.medium import FogMedium
from synfog_usd.fog.phase import Phase
from synfog_usd.render import models
from synfog_usd.render.film import aovs
from synfog_usd.render.film.accumulator import (
    CHUNK,
    HALVES,
    MULTIPLE,
    SINGLE,
    Accumulator,
    new_accumulator,
)
from synfog_usd.render.film.allocation import more_samples
from synfog_usd.render.film.launches import add_samples
from synfog_usd.render.sampling.sobol import RUN
from synfog_usd.render.shot import load, render
from synfog_usd.scene import Camera, Instance, SceneDict
from synfog_usd.stage.open import cameras, open_stage, override, select, variant_choices, variants
from synfog_usd.translate import translate

PENCIL_DEG = 1e-3
"""Across the laser's rays."""

PENCIL_PX = 128
SEEDS = 8
CORNERS = 255
"""Of the polygon, of the same area, that is the meter's disc; odd, so that its middle lies within a triangle: on an
edge one ray in 2000 would slip through."""

LAW_SEEDS, FIRST_PATHS = 32, 8
"""Seeds of the law, and paths a pixel and seed of the first look at how noisy it is."""

ROUGH = 0.2
"""Relative error of the first look below which it tells how many paths are needed."""

METER_PATHS = 8
"""Paths a pixel and seed where all light is followed: a million together."""

FIRST_SAMPLES = 1024
"""Paths a pixel of the first look at how noisy the chart is: in the thinnest fog few paths are bright, and intervals of
128 left 13 % of means outside instead of 5.
"""

MORE = 1.1
"""Times the paths that a patch or the law seems to need: what they have tells their noise but roughly."""

LONGEST_STRIDE = 8.0
"""Times the paths that it has which a patch gets at most, until it is looked at again: one bright path of few would
ask for too many."""

OPENINGS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 15.0)
"""Times the opening of the stage's own meter."""

WALL_SET = "walls"
MODELS = ("single", "asm_true", "asm_dark_channel")
"""Compared with `path`."""


@dataclass(frozen=True)
class MeterReading:
    """A relative power P / P0, and the 95 % interval of its mean over seeds.

    Attributes:
        power, error: mean and half of the interval [1].
        once, often: shares of it that the fog scattered once and more often, 0 where they were not followed.
    """

    power: float
    error: float
    once: float = 0.0
    often: float = 0.0

    def extinction(self, way_m: float) -> tuple[float, float]:
        """ln(P0 / P) / u and half of its interval [1/m]; inf where nothing arrived."""
        if self.power <= 0.0:
            return math.inf, math.inf
        return -math.log(self.power) / way_m, self.error / self.power / way_m


@dataclass(frozen=True)
class LaserRow:
    """One fog: what was authored, and what the meter says.

    Attributes:
        fog: variant.
        sigma_per_m: authored extinction [1/m].
        law: light that the fog did not turn aside.
        meters: by variant of the walls, all light that falls on the stage's own meter.
    """

    fog: str
    sigma_per_m: float
    law: MeterReading
    meters: dict[str, MeterReading]


@dataclass(frozen=True)
class ApertureRow:
    """One opening of the meter in one fog.

    Attributes:
        fog: variant.
        sigma_per_m: authored extinction [1/m].
        half_angle_deg: of the opening seen from the laser.
        reading: what the meter says.
        single: what falls on it unscattered and scattered once, in closed form.
    """

    fog: str
    sigma_per_m: float
    half_angle_deg: float
    reading: MeterReading
    single: float


@dataclass(frozen=True)
class PatchRow:
    """One patch in one fog.

    Attributes:
        walls, fog: variants.
        tau: optical depth between camera and patch.
        patch: name.
        truth, error: (3,) radiance by `path` [cd m-2], and half of its 95 % interval.
        models: (3,) radiance by each of `MODELS`.
    """

    walls: str
    fog: str
    tau: float
    patch: str
    truth: Array
    error: Array
    models: dict[str, Array]


@dataclass(frozen=True)
class ChamberStudy:
    """What came of it.

    Attributes:
        stage: its name.
        way_m: from the laser to the meter.
        radius_m: of the stage's meter.
        laser, apertures, patches: rows.
    """

    stage: str
    way_m: float
    radius_m: float
    laser: tuple[LaserRow, ...]
    apertures: tuple[ApertureRow, ...]
    patches: tuple[PatchRow, ...]


@dataclass
class Chamber:
    """An opened stage, and what the study needs of it."""

    stage: Any
    name: str
    laser: str
    meter: str
    walls: dict[str, str]
    fogs: tuple[str, ...]

    def scene(self, fog: str, walls: str, camera: str | None = None) -> SceneDict:
        """The stage in a fog between walls, seen by a camera."""
        select(self.stage, fog=fog)
        if walls in self.walls:
            override(self.stage, choices=[self.walls[walls]])
        return translate(self.stage, camera=camera)


def chamber(file: Path) -> Chamber:
    """Open a stage and look for laser, meter, fogs and walls.

    Raises:
        StageError: what is missing.
    """
    stage = open_stage(file)
    found = {path.rpartition("/")[2]: path for path in cameras(stage)}
    for name, what in (("Laser", "where the laser stands, looking the way it shines"), ("Meter", "the power meter")):
        if name not in found:
            raise StageError(f"{file}: no camera is named {name!r}, {what}; see stages/chamber.usda")
    fogs = tuple(name for name in variants(stage).get("fog", []) if name != "clear")
    if not fogs or "clear" not in variants(stage)["fog"]:
        raise StageError(
            f"{file}: needs a variant set 'fog' with 'clear' and at least one fog; see stages/chamber.usda"
        )
    walls = {choice.rpartition("=")[2]: choice for choice in variant_choices(stage) if f":{WALL_SET}=" in choice}
    return Chamber(stage, file.stem, found["Laser"], found["Meter"], walls or {"as authored": ""}, fogs)


def study(
    file: Path,
    *,
    error: float = 0.01,
    laser_error: float = 1e-3,
    most_paths: float = 1e9,
    most_samples: int = 1 << 16,
    progress: Progress = silent,
) -> ChamberStudy:
    """All of it.

    Args:
        file: stage.
        error: half of the 95 % interval of each patch's R, G and B by `path`, relative, that is asked for.
        laser_error: the same of the extinction by the laser.
        most_paths: of the law in one fog.
        most_samples: paths a pixel of a patch.
        progress: whom to tell.

    Raises:
        StageError: the stage lacks something, or the laser does not reach the meter.
    """
    room = chamber(file)
    bench = LaserBench(room)
    laser, count = [], len(room.fogs)
    names = list(room.walls)
    for number, fog in enumerate(room.fogs):
        told = within(progress, 0.3 * number / count, 0.3 * (number + 1) / count)
        told(f"laser in {fog}", 0.0)
        law = bench.law(fog, names[0], error=laser_error, most=most_paths)
        meters = {wall: bench.reading(fog, wall, bench.radius_m) for wall in names}
        laser.append(LaserRow(fog, bench.sigma_per_m(fog), law, meters))
    apertures = []
    chosen = [room.fogs[number * (count - 1) // 2] for number in range(3)] if count > 2 else list(room.fogs)
    for number, fog in enumerate(chosen):
        for times in OPENINGS:
            progress(f"meters in {fog}", 0.3 + 0.1 * number / len(chosen))
            radius = times * bench.radius_m
            medium = bench.medium(fog)
            once = single_into_disc(medium.sigma_t_per_m, bench.way_m, radius, medium.phase_function, medium.albedo)
            row = ApertureRow(
                fog,
                medium.sigma_t_per_m,
                math.degrees(math.atan2(radius, bench.way_m)),
                bench.reading(fog, names[0], radius),
                math.exp(-medium.sigma_t_per_m * bench.way_m) + once,
            )
            apertures.append(row)
    rows: list[PatchRow] = []
    for number, wall in enumerate(names):
        told = within(progress, 0.4 + 0.6 * number / len(names), 0.4 + 0.6 * (number + 1) / len(names))
        rows += patches(room, wall, error=error, most_samples=most_samples, progress=told)
    return ChamberStudy(room.name, bench.way_m, bench.radius_m, tuple(laser), tuple(apertures), tuple(rows))


class LaserBench:
    """Laser and meter of a chamber.

    Attributes:
        way_m: between them.
        radius_m: of the meter's opening.

    Raises:
        StageError: they do not look at each other.
    """

    def __init__(self, room: Chamber) -> None:
        self.room = room
        wall = next(iter(room.walls))
        laser, meter = (room.scene("clear", wall, camera) for camera in (room.laser, room.meter))
        self.radius_m = meter.camera.focal_length_m / meter.camera.f_number / 2.0 if meter.camera.f_number > 0 else 0.0
        if self.radius_m <= 0.0:
            raise StageError(
                f"{room.meter}: has no fStop or no focusDistance; focal length over f-number is its opening's width"
            )
        self._meter = meter.camera.to_world.copy()
        self._meter[:3, 3] += np.subtract(meter.origin_m, laser.origin_m)
        way = self._meter[:3, 3] - laser.camera.to_world[:3, 3]
        self.way_m = float(np.linalg.norm(way))
        along = float(-laser.camera.to_world[:3, 2] @ way)
        aside = math.sqrt(max(self.way_m**2 - along**2, 0.0))
        facing = float(laser.camera.to_world[:3, 2] @ self._meter[:3, 2])
        if along <= 0.0 or aside > 0.5 * self.radius_m or facing > -0.9:
            raise StageError(
                f"{room.laser}: does not shine on the middle of {room.meter}, facing it: it passes at {aside:.3g} m; "
                "the laser looks along its -Z, as cameras do"
            )
        self._seen("clear", wall)

    def _seen(self, fog: str, wall: str) -> None:
        loaded = load(self._scene(fog, wall, self.radius_m), boundaries=False)
        seen = aovs.measure(loaded)
        met = int(seen.instance_id[PENCIL_PX // 2, PENCIL_PX // 2])
        path = loaded.source.instances[met - 1].path if met else "nothing"
        if path != self.room.meter:
            raise StageError(
                f"{self.room.laser}: meets {path} before {self.room.meter}; move it, or what stands between"
            )

    def medium(self, fog: str) -> FogMedium:
        """Fog around the laser.

        Raises:
            StageError: not the one uniform fog that the law is about.
        """
        scene = self.room.scene(fog, next(iter(self.room.walls)), self.room.laser)
        if len(scene.fog) != 1 or scene.fog[0].medium.profile != "uniform":
            raise StageError(f"{self.room.name}, fog {fog}: the laser's law is about one uniform fog")
        return scene.fog[0].medium

    def sigma_per_m(self, fog: str) -> float:
        """Authored extinction [1/m]."""
        return self.medium(fog).sigma_t_per_m

    def _scene(self, fog: str, wall: str, radius_m: float) -> SceneDict:
        """The laser's rays, in the dark but for the meter, which shines with 1 on them."""
        scene = self.room.scene(fog, wall, self.room.laser)
        turn = np.arange(CORNERS) * (2.0 * np.pi / CORNERS)
        reach = radius_m / math.sqrt(float(np.sinc(2.0 / CORNERS)))
        local = np.c_[reach * np.cos(turn), reach * np.sin(turn), np.zeros(CORNERS)]
        faces = np.array([[0, k + 1, k] for k in range(1, CORNERS - 1)])  # it faces -Z
        disc = {
            "type": "mesh",
            "positions": local @ self._meter[:3, :3].T + self._meter[:3, 3],
            "faces": faces,
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.0] * 3}},
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [1.0] * 3}},
        }
        number = len(scene.instances) + 1
        pencil = Camera(
            scene.camera.path, scene.camera.to_world, PENCIL_PX, PENCIL_PX, PENCIL_DEG, near_m=scene.camera.near_m
        )
        return replace(
            scene,
            world={**_dark(scene.world), "shape_meter": disc},
            camera=pencil,
            instances=(*scene.instances, Instance(number, self.room.meter, "unlabeled")),
            instance_of={**scene.instance_of, ("shape_meter",): number},
            group_of={},
            flux_of={},
            emission_of={},
        )

    def law(self, fog: str, wall: str, *, error: float, most: float) -> MeterReading:
        """Light that arrives without having been scattered, to about a relative error of the extinction.

        Each fog has random numbers of its own, so that one fog's luck is not the next one's.

        Args:
            error: half of the 95 % interval that is asked for.
            most: paths.
        """
        loaded = load(self._scene(fog, wall, self.radius_m), boundaries=False)
        integrator = models.make("path", loaded, scatterings=0)
        tau = loaded.source.fog[0].medium.sigma_t_per_m * self.way_m
        numbers = iter(range(1 << 30))

        def look(paths: int) -> MeterReading:
            runs = [
                integrator.accumulate(samples=paths, seed=seeds.seed32(0, "law", fog, next(numbers)))
                .mean()
                .mean(dtype=np.float64)
                for _ in range(LAW_SEEDS)
            ]
            return _reading(np.array(runs))

        limit = max(FIRST_PATHS, int(most / (PENCIL_PX**2 * LAW_SEEDS)))
        return two_looks(look, error=error * tau, first=FIRST_PATHS, limit=limit)

    def reading(self, fog: str, wall: str, radius_m: float) -> MeterReading:
        """All light that falls on a meter of a given opening."""
        scene = self._scene(fog, wall, radius_m)
        loaded = load(scene, boundaries=False)
        runs, once, often = [], [], []
        for seed in range(SEEDS):
            made = render(scene, model="path", samples=METER_PATHS, seed=seed, loaded=loaded)
            runs.append(made.radiance.pixels.mean(dtype=np.float64))
            once.append(made.components["airlight_single"].mean(dtype=np.float64))
            often.append(made.components["airlight_multiple"].mean(dtype=np.float64))
        return replace(_reading(np.array(runs)), once=float(np.mean(once)), often=float(np.mean(often)))


def two_looks(look: Callable[[int], MeterReading], *, error: float, first: int, limit: int) -> MeterReading:
    """A power to about a relative error.

    A first look tells how many paths are needed.  The answer is of so many new ones, whatever its interval then is: who
    looks again until an interval is short enough ends with those that are too short by chance (of 8 seeds 6.5 % missed
    the truth, instead of 5).

    Args:
        look: number of paths -> what so many new ones read.
        error: half of the 95 % interval that is asked for, relative to the power.
        first, limit: paths at first, and at most.
    """
    paths, found = first, look(first)
    while found.error > ROUGH * found.power or found.power <= 0.0:
        if paths == limit:
            return found
        paths = min(16 * paths, limit)
        found = look(paths)
    needed = max(paths, math.ceil(MORE * paths * (found.error / found.power / error) ** 2))
    whole = 1 << (needed - 1).bit_length() if needed < RUN else math.ceil(needed / RUN) * RUN  # the evenest numbers
    return look(min(whole, limit))


def _reading(runs: Array) -> MeterReading:
    half = float(stats.t.ppf(0.975, len(runs) - 1)) * float(runs.std(ddof=1)) / math.sqrt(len(runs))
    return MeterReading(float(runs.mean()), half)


def _dark(world: Any) -> dict[str, Any]:
    """The world without its lights."""
    return {
        key: {name: value for name, value in part.items() if name != "emitter"} if isinstance(part, dict) else part
        for key, part in world.items()
        if not key.startswith("light_")
    }


def single_into_disc(sigma_per_m: float, way_m: float, radius_m: float, phase: Phase, albedo: float = 1.0) -> float:
    """Share of a laser's power that uniform fog scatters once onto a disc across its way, in closed form.

    At a distance s before the disc, on its axis, light that turns by less than psi = atan(a / s) meets it, after
    u - s + s / cos psi of fog; with p the phase function it is

        albedo sigma * integral over s of the integral over psi of 2 pi p sin psi exp(-sigma (u - s + s / cos psi)),

    by Gauss and Legendre, in ln s, since much comes from close to the disc.

    Args:
        sigma_per_m: extinction [1/m].
        way_m: u, from the laser to the disc.
        radius_m: a.
    """
    node, weight = np.polynomial.legendre.leggauss(128)
    deep = 25.0  # below exp(-25) of the way nothing is left
    s = way_m * np.exp(-deep * (node + 1.0) / 2.0)
    ds = weight * deep / 2.0 * s
    most = np.arctan2(radius_m, s)
    psi = (node[:, None] + 1.0) / 2.0 * most
    turned = 2.0 * np.pi * phase.value(np.cos(psi)) * np.sin(psi) * np.exp(-sigma_per_m * (way_m - s + s / np.cos(psi)))
    return float(albedo * sigma_per_m * (((turned * weight[:, None]).sum(axis=0) * most / 2.0) @ ds))


# -- the chart


def patches(
    room: Chamber, wall: str, *, error: float, most_samples: int, progress: Progress = silent
) -> list[PatchRow]:
    """The chart in every fog between one kind of walls.

    Args:
        error, most_samples: see `study`.

    Raises:
        StageError: the camera sees no patches.
    """
    scene = room.scene("clear", wall)
    loaded = load(scene, boundaries=False)
    places = patch_pixels(scene, aovs.measure(loaded).instance_id, room.name)
    chart = np.any(list(places.values()), axis=0)
    ask = functools.partial(sample_patches, places=places, error=error, most_samples=most_samples)
    clear = ask(loaded, "path", everywhere=True)
    shape = (*chart.shape, -1)
    J = clear.mean().reshape(shape).astype(np.float64)
    rows = [
        PatchRow(wall, "clear", 0.0, name, *patch_mean(clear, where), dict.fromkeys(MODELS, _over(J, where)))
        for name, where in places.items()
    ]
    for number, fog in enumerate(room.fogs):
        progress(f"chart in {fog}, walls {wall}", (number + 1) / (len(room.fogs) + 1))
        loaded = load(room.scene(fog, wall), boundaries=False)
        truth, single = ask(loaded, "path"), ask(loaded, "single")
        t = aovs.measure(loaded).transmittance[..., None]
        lit = sum(truth.aov(name).reshape(shape) for name in (SINGLE, MULTIPLE))
        airlights = {
            "asm_true": _over(lit, chart) / (1.0 - _over(t, chart)),
            "asm_dark_channel": estimated_airlight(J, t),
        }
        for name, where in places.items():
            made = {"single": patch_mean(single, where)[0]} | {
                model: _over(J * t + A * (1.0 - t), where) for model, A in airlights.items()
            }
            tau = float(-np.log(_over(t, where)[0]))
            rows.append(PatchRow(wall, fog, tau, name, *patch_mean(truth, where), made))
    return rows


def sample_patches(
    loaded: Any,
    model: str,
    places: Mapping[str, Flags],
    *,
    error: float,
    most_samples: int,
    everywhere: bool = False,
    seed: int = 0,
) -> Accumulator:
    """Paths through the pixels of patches, until each patch is known or has all that it may have.

    Where noise is left, each estimator gets paths by its own noise and cost.

    Args:
        loaded: scene without boundaries.
        model: one of ours, by name.
        places: name of a patch -> (H, W) its pixels.
        error, most_samples: see `study`.
        everywhere: whether pixels outside of patches are looked at, too, as often as these at first.
        seed: of the paths.
    """
    integrator = models.make(model, loaded)
    patch_of = {name: np.flatnonzero(where) for name, where in places.items()}
    chart = np.sort(np.concatenate(list(patch_of.values())))
    pixels = next(iter(places.values())).size
    accumulated = new_accumulator(integrator, pixels)
    first = _runs(min(FIRST_SAMPLES, most_samples))
    add_samples(accumulated, integrator, np.arange(pixels) if everywhere else chart, accumulated.even(first), seed=seed)
    had = dict.fromkeys(patch_of, first)
    while True:
        short: dict[int, list[Indices]] = {}
        for name, where in patch_of.items():
            mean, half = patch_mean(accumulated, where)
            need = float(np.max(half / np.maximum(mean, 1e-30)) / error) ** 2
            wanted = min(most_samples, had[name] * min(MORE * need, LONGEST_STRIDE))
            if need > 1.0 and (more := _runs(wanted - had[name])) > 0:
                short.setdefault(more, []).append(where)
                had[name] += more
        if not short:
            return accumulated
        for more, wheres in short.items():
            where = np.sort(np.concatenate(wheres))
            more_of = more_samples(accumulated, round(accumulated.samples_of(where)) + more, pixels=where)
            add_samples(
                accumulated, integrator, where, {name: _runs(count) for name, count in more_of.items()}, seed=seed
            )


def _runs(samples: float) -> int:
    """The next number of samples that gives each half whole runs of random numbers."""
    return math.ceil(samples / (HALVES * CHUNK)) * HALVES * CHUNK


def patch_pixels(scene: SceneDict, instance_id: Array, name: str) -> dict[str, Flags]:
    """Name of a patch -> (H, W) its pixels, without its edge."""
    found = {}
    for one in scene.instances:
        parts = one.path.split("/")
        if len(parts) > 2 and parts[-2] == "Chart" and parts[-1].startswith("Patch"):
            inside = ndimage.binary_erosion(instance_id == one.id, np.ones((3, 3)))
            if inside.any():
                found[parts[-1]] = inside
    if not found:
        raise StageError(
            f"{name}: its camera sees no prims Chart/Patch* of at least 3 x 3 pixels; see stages/chamber.usda"
        )
    return found


def _over(pixels: Array, where: Flags) -> Array:
    return np.asarray(pixels[where].mean(axis=0, dtype=np.float64))


def patch_mean(light: Accumulator, where: Flags | Indices) -> tuple[Array, Array]:
    """(3,) mean over pixels, and half of its 95 % interval by their own variances."""
    pixels = np.flatnonzero(where) if where.dtype == np.bool_ else where
    error = np.sqrt(light.variance()[pixels].sum(axis=0, dtype=np.float64)) / pixels.size
    return light.mean()[pixels].mean(axis=0, dtype=np.float64), 1.96 * error


@dataclass(frozen=True)
class Departure:
    """How far a model leaves the truth in one fog.

    Attributes:
        tau: optical depth between camera and chart.
        median, worst: relative error over patches and channels.
        low, high: interval of the median at 95 %, by bootstrap over patches, whose channels belong together.
    """

    tau: float
    median: float
    low: float
    high: float
    worst: float


def departures(rows: Sequence[PatchRow], walls: str, model: str) -> list[Departure]:
    """A model's departure from the truth in each fog, in the order of the rows."""
    kept = [row for row in rows if row.walls == walls and row.fog != "clear"]
    found = []
    for fog in dict.fromkeys(row.fog for row in kept):
        some = [row for row in kept if row.fog == fog]
        off = np.abs(np.array([row.models[model] / row.truth - 1.0 for row in some]))
        drawn = seeds.stream(0, "patches", len(off)).integers(len(off), size=(statistics.RESAMPLES, len(off)))
        low, high = statistics.interval(np.median(off[drawn].reshape(len(drawn), -1), axis=1))
        found.append(Departure(float(np.mean([row.tau for row in some])), float(np.median(off)), low, high, off.max()))
    return found


def main(
    out: command.Out,
    stage: Annotated[
        Path | None, typer.Argument(help="USD file of a fog chamber; the shipped one if left out.")
    ] = None,
    error: Annotated[float, typer.Option(help="Relative error to which each patch of the chart is rendered.")] = 0.01,
    laser_error: Annotated[float, typer.Option(help="Relative error of the extinction that the laser reads.")] = 1e-3,
) -> None:
    """Measure a fog chamber: a laser's extinction, what falls into its meter, and a chart by every model."""
    from docs.studies import chamber_page

    command.writable(out)
    stage = stage or resources.folder("stages") / "chamber.usda"
    with shown(quiet=False) as (progress, _):
        found = study(stage, error=error, laser_error=laser_error, progress=progress)
    chamber_page.write(found, out)
    print(chamber_page.markdown(found))


if __name__ == "__main__":
    command.run(main)
