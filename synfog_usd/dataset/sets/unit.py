"""One scene in one lighting: drawn, baked, developed by further pipelines, and written down.

What is made follows from the set and the scene's number alone.  `unit.json` is written last: with it a unit is
finished, without it the same call goes on where the last one stopped.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from synfog_usd.base import files, resources, system
from synfog_usd.base.errors import OutputError, SetError
from synfog_usd.base.progress import Progress, silent
from synfog_usd.dataset.plan import CLEAR, TOGETHER, BakePlan, Exposing, Sampling, StageReading, noise_seed
from synfog_usd.dataset.sets import layout
from synfog_usd.dataset.sets.definition import SetDefinition, exposed
from synfog_usd.dataset.sets.layout import Unit
from synfog_usd.dataset.sets.scenes import PlannedScene, held_out, scene, with_weather
from synfog_usd.fog import Fog

if TYPE_CHECKING:
    from synfog_usd.base.image import Image

SCHEMA = {"schema": "synfog-usd/unit", "version": 1}
Reading = Callable[[], contextlib.AbstractContextManager[None]]


def make(
    definition: SetDefinition,
    out: Path,
    unit: Unit,
    *,
    variant: str = "auto",
    repair: bool = False,
    progress: Progress = silent,
    log: Callable[[str], None] = lambda text: None,
    reading: Reading = contextlib.nullcontext,
) -> tuple[dict[str, Any], bool]:
    """Make one unit of a set, or look that it is made.

    Args:
        definition: the set.
        out: its folder.
        unit: which one.
        variant: of the renderer, see `BakePlan`.
        repair: look at every file of a finished unit, and make those again that were changed.
        progress, log, reading: see `dataset.bake.bake`.

    Returns:
        what `unit.json` holds, and whether it was made now.

    Raises:
        SetError: the set has no such unit, or a rule of hold-outs cannot be met.
        SynfogError: whatever drawing or baking raises.
    """
    planned = scene(definition, unit.number)
    if unit not in planned.units:
        raise SetError(
            f"{definition.name}: scene {unit.number} has no lighting {unit.lighting!r} with camera "
            f"{unit.camera or 'own'!r}; it has {', '.join(choice.name for choice in planned.units)}"
        )
    folder = out / unit.folder
    with _alone(out, unit):
        done = None if repair and not _whole(folder) else record(out, unit)
        if done is not None:
            return done, False
        (folder / layout.UNIT).unlink(missing_ok=True)
        with _drawn(definition, planned, out, unit, reading) as (stage, shown):
            from synfog_usd.dataset.bake import bake

            plan = _plan(definition, planned, unit, stage, folder, variant)
            baked = bake(plan, progress=progress, log=log, reading=reading)
        more = _developments(definition, folder, baked.manifest["shots"], planned)
        written = _record(definition, planned, unit, folder, baked.manifest, more, shown)
        files.write_json(folder / layout.UNIT, written)
    return written, True


def _plan(
    definition: SetDefinition, planned: PlannedScene, unit: Unit, stage: Path, folder: Path, variant: str
) -> BakePlan:
    return BakePlan(
        stage=stage,
        out=folder,
        pipeline=definition.pipelines[0],
        lighting=(unit.lighting,),
        fog=planned.fogs,
        camera=unit.camera or None,
        size=definition.size,
        seed=planned.seed,
        by_lighting=False,
        same_noise=definition.same_noise,
        rig=definition.cameras if len(definition.cameras) > 1 else (),
        sampling=Sampling(variant=variant, **definition.quality),
        reads=StageReading(allow=(resources.folder("assets"),)),
        exposes=Exposing(
            meter=definition.meter,
            meter_for=definition.pipelines[1:] if _one_exposure(definition) or _falls(planned) else (),
            **definition.exposure,
        ),
    )


def record(out: Path, unit: Unit) -> dict[str, Any] | None:
    """What `unit.json` says, or None where the unit is not finished.

    Raises:
        OutputError: it cannot be read.
    """
    path = out / unit.folder / layout.UNIT
    try:
        content = json.loads(path.read_bytes())
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError) as error:
        raise OutputError(f"{path}: cannot be read ({error}); run --repair makes it again") from error
    return dict(content)


def changed(folder: Path) -> Iterator[str]:
    """What of a finished unit is not as it was written, in words, file by file.

    Raises:
        OutputError: `unit.json` cannot be read.
    """
    try:
        listed = json.loads((folder / layout.UNIT).read_bytes())["files"]
        expected = {str(name): (int(size), str(digest)) for name, (size, digest) in listed.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        yield f"{layout.UNIT}: cannot be read ({error})"
        return
    for name, (size, digest) in expected.items():
        path = folder / name
        try:
            if path.stat().st_size != size or files.sha256_of(path) != digest:
                yield f"{name}: changed since it was made"
        except OSError as error:
            yield f"{name}: {error.strerror}"
    for path in sorted(folder.rglob("*")):
        inside = path.relative_to(folder).as_posix()
        if path.is_file() and inside not in expected and inside != layout.UNIT:
            yield f"{inside}: no file of the set"


def _one_exposure(definition: SetDefinition) -> bool:
    """Whether several cameras are exposed alike."""
    return len(definition.cameras) > 1 and definition.meter == TOGETHER


def _falls(planned: PlannedScene) -> bool:
    """Whether rain or snow falls in a scene, whose streaks are of each pipeline's exposure."""
    return any(fog.rates for name in planned.fogs if (fog := Fog.named(name)))


def _whole(folder: Path) -> bool:
    return next(changed(folder), None) is None


@contextlib.contextmanager
def _alone(out: Path, unit: Unit) -> Iterator[None]:
    """Wait until nobody else makes this unit; a killed process leaves no lock behind."""
    path = out / layout.RUN / "locks" / unit.folder.partition("/")[2]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({error.strerror})") from error
    try:
        system.lock(handle, wait=True)
        yield
    finally:
        os.close(handle)


@contextlib.contextmanager
def _drawn(
    definition: SetDefinition, planned: PlannedScene, out: Path, unit: Unit, reading: Reading
) -> Iterator[tuple[Path, dict[str, list[str]]]]:
    """The stage of a scene, and which models and skies it shows.

    A drawn stage names its assets relative to itself, through a link beside it, so that its bytes are the same in
    every folder and on every machine.
    """
    if planned.stage is not None:
        yield planned.stage, {"models": [], "skies": []}
        return
    from synfog_usd.world.compose import draw, write_stage
    from synfog_usd.world.roads import stage

    with _folder_beside_assets(out / layout.RUN / "work" / unit.folder.partition("/")[2]) as folder:
        with reading():
            recipe = with_weather(held_out(definition, planned.source, planned.split), planned.fogs)
            spec = draw(recipe, seed=planned.seed)
            spec = replace(spec, origin={**spec.origin, "set": definition.name, "scene": str(planned.number)})
            shown = {
                "models": sorted({placement.asset for placement in spec.placed}),
                "skies": sorted({spec.day.sky, spec.dusk.sky}),
            }
            _check_held_out(definition, planned, shown)
            path = folder / "scene.usda"
            write_stage(path, lambda place: stage.author(place, spec, assets="./assets"))
        yield path, shown


@contextlib.contextmanager
def _folder_beside_assets(folder: Path) -> Iterator[Path]:
    """A new folder with a link `assets` to the shipped ones, removed at the end.

    Raises:
        OutputError: it cannot be made.
    """
    shutil.rmtree(folder, ignore_errors=True)
    try:
        folder.mkdir(parents=True)
        (folder / "assets").symlink_to(resources.folder("assets").resolve(), target_is_directory=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written ({error.strerror})") from error
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _check_held_out(definition: SetDefinition, planned: PlannedScene, shown: Mapping[str, list[str]]) -> None:
    """What recipes place by themselves is held out too."""
    for rival in definition.splits:
        if rival is planned.split:
            continue
        both = sorted({*shown["models"], *shown["skies"]} & (rival.models | rival.skies) - planned.split.models)
        if both:
            raise SetError(
                f"{definition.name}: scene {planned.number} of the split {planned.split.name!r} shows "
                f"{', '.join(both)}, held out for {rival.name!r}: "
                f"the recipe {planned.source.name!r} places it without a choice; hold the "
                f"recipe out too"
            )


def _developments(
    definition: SetDefinition, folder: Path, shots: list[dict[str, Any]], planned: PlannedScene
) -> dict[str, dict[str, Any]]:
    """What else is made of the radiance: name -> shot -> exposure and outputs.

    Each pipeline after the first develops it.  Those of `asm_estimated` develop the clear frame in fog by the
    atmospheric scattering model, L = J t + A (1 - t): t is exact, A is guessed from the picture, see `fog.airlight`.
    """
    result = {}
    for path in definition.pipelines:
        if path is not definition.pipelines[0]:
            result[path.stem] = _developed(definition, path, path.stem, folder, shots, planned, _radiance)
        if path.stem in definition.asm_estimated:
            name = f"asm_estimated.{path.stem}"
            foggy = [row for row in shots if row["fog"] != CLEAR]
            result[name] = _developed(definition, path, name, folder, foggy, planned, _guessed)
    return result


def _radiance(folder: Path, shot: str) -> Image:
    from synfog_usd.camera import writers

    return writers.read_exr(folder / shot / "radiance.exr")


def _guessed(folder: Path, shot: str) -> Image:
    """The clear frame in a fog whose airlight is guessed."""
    from synfog_usd.base.image import Quantity
    from synfog_usd.camera import writers
    from synfog_usd.fog.airlight import estimated_airlight

    clear = _radiance(folder, CLEAR)
    layers = folder / shot / "layers.exr"
    t = writers.read_exr(layers, quantity=Quantity.DATA, channels=["transmittance.Y"]).pixels
    airlight = estimated_airlight(clear.pixels, t)
    return clear.with_pixels((clear.pixels * t + airlight * (1.0 - t)).astype(clear.pixels.dtype))


def _developed(
    definition: SetDefinition,
    pipeline: Path,
    name: str,
    folder: Path,
    shots: list[dict[str, Any]],
    planned: PlannedScene,
    radiance: Callable[[Path, str], Image],
) -> dict[str, Any]:
    """What a pipeline makes of shots, metered on the clear one: shot -> exposure and outputs."""
    from synfog_usd import camera
    from synfog_usd.camera import writers

    graph = exposed(camera.load_graph(pipeline), definition.exposure)
    (name_of_input,) = graph.inputs
    exposure = None
    if shots and (_one_exposure(definition) or _falls(planned)):
        exposure_row = shots[0].get("further_exposures", {}).get(pipeline.stem) or shots[0]["exposure"]
        exposure = (
            camera.Exposure(exposure_row["exposure_s"], exposure_row["iso"])
            if camera.exposure_left_open(graph)
            else None
        )
    elif shots:
        clear = {name_of_input: _radiance(folder, CLEAR)}
        exposure = camera.metered(graph, clear, compensation_ev=definition.exposure.get("ev", 0.0))
    result = {}
    for row in shots:
        shot = row["folder"]
        rained_on = (folder / shot / name / "radiance.exr").is_file()
        picture = {name_of_input: _radiance(folder, f"{shot}/{name}") if rained_on else radiance(folder, shot)}
        seed = noise_seed(planned.seed, row["lighting"], row["fog"], same_noise=definition.same_noise)
        names = list(graph.outputs.values())
        results = camera.develop(graph, picture, seed=seed, exposure=exposure, keep=names)
        for output, node in graph.outputs.items():
            writers.write_output(output, results[node], folder / shot / name, options=graph.options_of(output))
        result[shot] = {
            "exposure": {"exposure_s": exposure.exposure_s, "iso": exposure.iso} if exposure else None,
            "outputs": sorted(graph.outputs),
        }
    return result


def _record(
    definition: SetDefinition,
    planned: PlannedScene,
    unit: Unit,
    folder: Path,
    manifest: Mapping[str, Any],
    more: Mapping[str, Mapping[str, Any]],
    shown: Mapping[str, list[str]],
) -> dict[str, Any]:
    from synfog_usd import camera

    first = definition.pipelines[0]
    outputs = sorted(camera.load_graph(first).outputs)
    shots = []
    for row in manifest["shots"]:
        place = row["folder"]
        shots.append(
            {
                "fog": row["fog"],
                "mor_m": row["mor_m"],
                "size_px": row["size_px"],
                "folder": place,
                "pictures": {
                    first.stem: {"folder": place, "outputs": outputs, "exposure": row["exposure"]},
                    **{
                        name: {"folder": f"{place}/{name}", **development[place]}
                        for name, development in more.items()
                        if place in development
                    },
                },
            }
        )
    inside = [path for path in sorted(folder.rglob("*")) if path.is_file() and path.name != layout.UNIT]
    return {
        **SCHEMA,
        "scene": planned.number,
        "split": planned.split.name,
        "source": planned.source.name,
        "seed": planned.seed,
        "lighting": unit.lighting,
        "camera": unit.camera,
        "stage_sha256": manifest["stage"]["sha256"],
        **shown,
        "shots": shots,
        "files": {path.relative_to(folder).as_posix(): [path.stat().st_size, files.sha256_of(path)] for path in inside},
    }


def rows(content: Mapping[str, Any], unit: Unit) -> Iterator[dict[str, Any]]:
    """The rows of the index for a unit, from its `unit.json`."""
    same = {name: content[name] for name in ("scene", "split", "source", "seed", "lighting", "camera")}
    for shot in content["shots"]:
        for pipeline, picture in shot["pictures"].items():
            yield {
                **same,
                "fog": shot["fog"],
                "mor_m": shot["mor_m"],
                "pipeline": pipeline,
                "width_px": shot["size_px"][0],
                "height_px": shot["size_px"][1],
                "bake": unit.folder,
                "shot": f"{unit.folder}/{shot['folder']}",
                "developed": f"{unit.folder}/{picture['folder']}",
                "outputs": picture["outputs"],
            }
