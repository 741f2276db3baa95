"""Rain on the roads of a stage that was not drawn for it: what is labelled road or pavement gets dark and shines.

Takes a scene; gives it with other materials where its fog has rain.  What shares a material with a road gets wet with
it; roads within instances stay dry.  Puddles and spray are drawn by recipes alone.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from synfog_usd.base.arrays import Array
from synfog_usd.base.colour import SRGB_TO_LINEAR, srgb_encode
from synfog_usd.base.notes import Note
from synfog_usd.base.numbers import RATES_MM_H
from synfog_usd.fog import FogVolume
from synfog_usd.fog.drops import Sizes, rain_sizes
from synfog_usd.fog.falling import SizeClasses
from synfog_usd.render.surface import TYPE
from synfog_usd.scene import SceneDict, mean_colour
from synfog_usd.world.roads import water
from synfog_usd.world.roads.asphalt import FILM_SMOOTHS, WATER_IOR, Asphalt, wet_albedo

OUTDOORS = ("road", "sidewalk", "parking")
"""Labels of what rain falls on."""


NOTE = "its rain wets what is labelled road, sidewalk or parking; `compose --fog` draws puddles and spray too"


def rained_on(scene: SceneDict) -> SceneDict:
    """The scene with roads as wet as the rain in which their middles lie makes them, see `roads.water`; the scene
    itself where a road has the index of water, and is wet already.
    """
    raining = [(volume, rate) for volume in scene.fog if (rate := _rate_mm_h(volume)) > 0.0]
    if not raining:
        return scene
    outdoors = {instance.id for instance in scene.instances if instance.label in OUTDOORS}
    shapes = [scene.world.get(key[0], {}) for key, number in scene.instance_of.items() if number in outdoors]
    rates: dict[str, float] = {}
    for shape in shapes:
        if shape.get("bsdf", {}).get("type") == "ref" and (rate := _above(shape, raining)) > 0.0:
            rates[shape["bsdf"]["id"]] = max(rate, rates.get(shape["bsdf"]["id"], 0.0))
    if not rates or any(_is_wet(scene.world[name]) for name in rates):
        return scene
    wet = {name: _wet(scene.world[name], water.covered(Asphalt(), rate)) for name, rate in rates.items()}
    note = Note("info", raining[0][0].path, NOTE)
    return replace(scene, world={**scene.world, **wet}, notes=(*scene.notes, note))


def _rate_mm_h(volume: FogVolume) -> float:
    """Of the rain of a volume, 0 where there is none: Marshall and Palmer's of that rate brings as much water."""
    rain = [_water(sizes) for kind, sizes in volume.medium.falls if kind == "rain"]
    return float(np.interp(sum(rain), _brought(), _RATES_MM_H)) if rain else 0.0


_RATES_MM_H = np.geomspace(*RATES_MM_H, 256)


@functools.cache
def _brought() -> Array:
    return np.array([_water(rain_sizes(rate)) for rate in _RATES_MM_H])


def _water(sizes: Sizes) -> float:
    """Volume of the drops that fall on an area, in any unit."""
    rain = SizeClasses.of_rain(sizes)
    middle, speed = (0.5 * (ends[1:] + ends[:-1]) for ends in (rain.edges_m, rain.speed_m_s))
    return float(rain.per_m3 @ (middle**3 * speed))


def _above(shape: Mapping[str, Any], raining: Sequence[tuple[FogVolume, float]]) -> float:
    """Rate [mm/h] of the rain over the middle of a shape, which falls from the volume's middle down at least."""
    place = shape.get("to_world", np.eye(4))[:3, 3]
    if "positions" in shape:
        place = 0.5 * (shape["positions"].min(axis=0) + shape["positions"].max(axis=0))
    highest = 0.0
    for volume, rate in raining:
        x, y, z = place
        low, high = volume.boundary.extent()
        if volume.boundary.contains([[x, y, max(z, 0.5 * (low[2] + high[2]))]])[0]:
            highest = max(highest, rate)
    return highest


def _is_wet(part: Mapping[str, Any]) -> bool:
    return _is_wet(part["bsdf"]) if "bsdf" in part else math.isclose(part.get("eta", 0.0), WATER_IOR, rel_tol=1e-6)


def _wet(part: Mapping[str, Any], covered: float) -> dict[str, Any]:
    """A material under water that covers a share of its texture."""
    if "bsdf" in part:
        return {**part, "bsdf": _wet(part["bsdf"], covered)}
    if part["type"] != TYPE:
        return dict(part)
    result = {**part, "base_color": _darker(part["base_color"])}
    if "roughness" in part:
        rough, factor = part["roughness"], 1.0 - covered * FILM_SMOOTHS
        rough = _dimmed(rough, factor) if isinstance(rough, Mapping) else rough * factor
        result |= {"roughness": rough, "eta": WATER_IOR}
    return result | {"clearcoat": water.COAT * covered, "clearcoat_roughness": water.COAT_ROUGHNESS}


def _darker(colour: Mapping[str, Any]) -> dict[str, Any]:
    if colour["type"] not in ("rgb", "bitmap") or not (dry := float(np.mean(mean_colour(colour)))) > 0.0:
        return dict(colour)
    factor = wet_albedo(dry) / dry
    if colour["type"] == "rgb":
        return {**colour, "value": (factor * np.asarray(colour["value"], dtype=np.float64)).tolist()}
    if colour["bitmap"].dtype != np.uint8:
        return _dimmed(colour, factor)
    codes = np.round(255.0 * srgb_encode(SRGB_TO_LINEAR * np.float32(factor))).astype(np.uint8)
    return {**colour, "bitmap": codes[colour["bitmap"]]}


def _dimmed(picture: Mapping[str, Any], factor: float) -> dict[str, Any]:
    """A picture with its texels times a factor."""
    return {**picture, "bitmap": (picture["bitmap"] * factor).astype(picture["bitmap"].dtype)}
