"""From a recipe and a seed to a stage, whichever world the recipe is of."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pxr import Sdf, Tf

from synfog_usd.base import resources, values
from synfog_usd.base.errors import OutputError, RecipeError
from synfog_usd.base.files import write_whole
from synfog_usd.base.numbers import check_range
from synfog_usd.base.yamlio import load_text
from synfog_usd.world import parameters
from synfog_usd.world.language import Draws, Recipe, load_root, read_fog
from synfog_usd.world.roads import crossing_recipe, roundabout_recipe, stage
from synfog_usd.world.roads import recipe as road_recipe
from synfog_usd.world.roads.traffic import speed_m_s
from synfog_usd.world.spec import WorldSpec
from synfog_usd.world.traffic import motion, scenario, write
from synfog_usd.world.traffic.fcd import driven, seconds_of
from synfog_usd.world.traffic.fcd import read as read_fcd
from synfog_usd.world.traffic.fcd import write as write_fcd
from synfog_usd.world.traffic.opendrive import write as write_roads

DRAWS: Mapping[str, Callable[[Draws], WorldSpec]] = {
    "crossroads": crossing_recipe.draw,
    "road": road_recipe.draw,
    "roundabout": roundabout_recipe.draw,
}
"""World -> what draws one of a recipe."""
HEADWAY_S = 0.9
"""Least time between bumpers in the streets of a crossing, whose recipes name none [s]."""


def load(path: Path, changes: Sequence[str] = ()) -> Recipe:
    """Read a recipe.

    Args:
        path: the file, or the name of a recipe that ships: 'residential'.
        changes: 'section.key=value' each, over what stands in the file.

    Raises:
        RecipeError: not YAML, or a section, key or value that is not known, with its place.
    """
    path = resources.named(path, "recipe")
    return parameters.read(load_root(path, changes), path.name)


def draw(recipe: Recipe, *, seed: int) -> WorldSpec:
    """One world of a recipe; the same seed gives the same.

    Raises:
        RecipeError: a rule cannot be met, or there is no room for so many people.
    """
    draws = Draws(recipe, seed)
    wind_m_s, towards = draws.number("time.wind_m_s"), math.radians(draws.number("time.wind_deg"))
    wind = round(wind_m_s * math.sin(towards), 6) + 0.0, round(wind_m_s * math.cos(towards), 6) + 0.0
    return replace(DRAWS[recipe.world](draws), wind_m_s=wind)


def compose(
    recipe: str | os.PathLike[str],
    path: str | os.PathLike[str],
    *,
    seed: int = 0,
    change: Mapping[str, Any] | Sequence[str] = (),
    fog: str | Sequence[str | int] = (),
    seconds: float | None = None,
    fps: float | None = None,
    traffic: str | os.PathLike[str] | None = None,
    fcd: str | os.PathLike[str] | None = None,
    opendrive: str | os.PathLike[str] | None = None,
    environment: str | os.PathLike[str] | None = None,
) -> WorldSpec:
    """Draw a world and write it as a stage: one file.

    With `seconds` it is a clip: vehicles follow their lanes, people walk, and the camera goes with its car, by time
    samples at the frames 0 to `seconds` times `fps`.  Frame 0 is what the stage is without them.
    References to the shipped assets are relative within the folder that holds them, and absolute elsewhere.

    Args:
        recipe: a name of `recipes`, or a YAML file.
        path: the stage, .usda, .usdc or .usd.
        seed: the same gives the same bytes in the same place.
        change: {'section.key': value}, or 'section.key=value' each, over what stands in the recipe.
        fog: instead of the recipe's: visibilities [m] and weather by name, as 'rain10,600' or ['rain10', 600].
        seconds: of the clip [s], 0 to 120; None for what the recipe's `time` says, and 0 for a still.
        fps: frames a second, 1 to 240; None for what the recipe's `time` says.  Of clips alone.
        traffic: FCD of SUMO (.xml) that drives and walks in place of what the recipe draws; it may say `seconds`.
        fcd: file for the same of this clip.
        environment: OpenSCENARIO (.xosc) whose fog, sun and time of day are taken in place of the recipe's.
        opendrive: file for the roads as OpenDRIVE 1.8 (.xodr), in the axes of the stage.

    Returns:
        what was drawn, all numbers; of a clip at frame 0.

    Raises:
        SynfogError: with its place; or the stage cannot be written.
    """
    seed = values.count(seed, "--seed")
    out = _output(path, "-o", "a USD file", ".usda", ".usdc", ".usd")
    out_fcd = None if fcd is None else _output(fcd, "--fcd", "an XML file", ".xml")
    out_roads = None if opendrive is None else _output(opendrive, "--opendrive", "OpenDRIVE", ".xodr")
    recorded = read_fcd(values.path_of(traffic, "--traffic")) if traffic is not None else None
    seconds = seconds_of(recorded) if recorded and seconds is None else seconds
    chosen = _in_fogs(load(values.path_of(recipe, "recipe"), _changes(change, seconds, fps)), fog)
    weather = None if environment is None else scenario.read(values.path_of(environment, "--environment"))
    chosen = scenario.at_its_hour(chosen, weather) if weather else chosen
    spec, clip = clip_of(chosen, draw(chosen, seed=seed), seed=seed)
    if clip is None:
        _refuse_in_stills({"--traffic": traffic, "--fcd": fcd, "--fps": None if seconds == 0 else fps})
    if clip and recorded:
        spec, clip = driven(spec, clip, recorded, seed)
    spec = scenario.around(spec, weather) if weather else spec
    _write(out, spec, clip, weather)
    if clip and out_fcd:
        write_fcd(out_fcd, spec, clip)
    if out_roads:
        write_roads(out_roads, spec.road, chosen.name)
    return spec


def _write(out: Path, spec: WorldSpec, clip: motion.Clip | None, weather: scenario.Environment | None) -> None:
    assets = asset_folder(out.resolve().parent, resources.folder("assets").resolve())

    def author(place: Path) -> Sdf.Layer:
        layer = stage.author(place, spec, assets=assets)
        if weather:
            scenario.author(layer, weather)
        if clip:
            write.author(layer, spec, clip)
        return layer

    write_stage(out, author)


def write_stage(path: Path, author: Callable[[Path], Sdf.Layer]) -> None:
    """Write a stage, whole.

    Args:
        author: makes the stage as one layer, not yet saved, at a path in the same folder.

    Raises:
        OutputError: it cannot be written.
    """
    try:
        write_whole(path, lambda temporary: author(temporary).Save())
    except Tf.ErrorException as error:
        raise OutputError(
            f"{path}: cannot be written ({str(error).split(' : ')[-1].strip()}); choose another output folder or free "
            f"some space"
        ) from error


def _output(path: str | os.PathLike[str], option: str, kind: str, *suffixes: str) -> Path:
    """A file that is written.

    Raises:
        RecipeError: its name has another suffix.
    """
    out = values.path_of(path, option)
    if out.suffix not in suffixes:
        allowed = " or ".join(filter(None, (", ".join(suffixes[:-1]), suffixes[-1])))
        raise RecipeError(f"{option} {out}: not {kind} by its name; it ends in {allowed}")
    return out


def _refuse_in_stills(options: Mapping[str, object]) -> None:
    """Refuse options that are of clips.

    Raises:
        RecipeError: one has a value.
    """
    if names := [name for name, value in options.items() if value is not None]:
        raise RecipeError(f"{' and '.join(names)}: for a clip, and this is a still; add --seconds")


def _in_fogs(recipe: Recipe, fog: str | Sequence[str | int]) -> Recipe:
    """A recipe with other fogs, where some are asked for."""
    parts = fog.split(",") if isinstance(fog, str) else [str(part) for part in fog]
    listed = json.dumps([int(part) if part.isdigit() else part.strip() for part in parts])
    return replace(recipe, fog=read_fog({"fog": load_text(listed, name="--fog", error=RecipeError)})) if fog else recipe


def _changes(change: Mapping[str, Any] | Sequence[str], seconds: float | None, fps: float | None) -> list[str]:
    """All changes as 'section.key=value'.

    Raises:
        ParameterError: `seconds` or `fps` out of range.
    """
    check_range("--seconds", seconds or None)
    check_range("--fps", fps)
    if isinstance(change, Mapping):
        change = [f"{key}={json.dumps(value)}" for key, value in change.items()]
    times = {"seconds": seconds, "fps": fps}
    return [*change, *(f"time.{key}={json.dumps(value)}" for key, value in times.items() if value is not None)]


def clip_of(recipe: Recipe, spec: WorldSpec, *, seed: int) -> tuple[WorldSpec, motion.Clip | None]:
    """A world that was drawn of a recipe with a seed with those who come in later, and what moves in it; the world
    alone where the recipe's `time` asks for a still.

    Raises:
        RecipeError: the camera's car would leave the drawn road.
    """
    draws = Draws(recipe, seed)
    fps = draws.number("time.fps")
    frames = round(draws.number("time.seconds") * fps)
    if not frames:
        return spec, None
    headway_s = draws.number("traffic.headway_s") if "traffic.headway_s" in recipe.distributions else HEADWAY_S
    pace = motion.Pace(speed_m_s(draws), headway_s, seed)
    return motion.clip_of(spec, pace, frames=frames, fps=fps)


def asset_folder(stage_folder: Path, assets: Path) -> str:
    """How a stage names the folder of assets: relative within the folder that holds it, absolute elsewhere."""
    if not stage_folder.is_relative_to(assets.parent):
        return assets.as_posix()
    steps = Path(os.path.relpath(assets, stage_folder)).as_posix()
    return steps if steps.startswith("..") else f"./{steps}"


def recipes() -> list[str]:
    """Names of the recipes that ship, as `compose` takes them."""
    return list(resources.shipped("recipe"))
