"""Rain on the roads of a stage that was not drawn for it: what is labelled road or pavement gets dark and shines.

Takes a scene and the rate of rain; gives the scene with other materials.  What shares a material with a road gets wet
with it; roads within instances stay dry.  Puddles and spray are drawn by recipes alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from synfog_usd.base.colour import SRGB_TO_LINEAR, srgb_encode
from synfog_usd.render.surface import TYPE
from synfog_usd.scene import SceneDict, mean_colour
from synfog_usd.world.roads import water
from synfog_usd.world.roads.asphalt import FILM_SMOOTHS, WATER_IOR, Asphalt, wet_albedo

OUTDOORS = ("road", "sidewalk", "parking")
"""Labels of what rain falls on."""


def rained_on(scene: SceneDict, rate_mm_h: float) -> SceneDict:
    """The scene in rain of a rate [mm/h], see `roads.water`; what has the index of water is wet already."""
    outdoors = {instance.id for instance in scene.instances if instance.label in OUTDOORS}
    shapes = [scene.world.get(key[0], {}) for key, number in scene.instance_of.items() if number in outdoors]
    names = {shape["bsdf"]["id"] for shape in shapes if shape.get("bsdf", {}).get("type") == "ref"}
    covered = water.covered(Asphalt(), rate_mm_h)
    wet = {name: _wet(part, covered) if name in names else part for name, part in scene.world.items()}
    return replace(scene, world=wet)


def _wet(part: Mapping[str, Any], covered: float) -> dict[str, Any]:
    """A material under water that covers a share of its texture."""
    if "bsdf" in part:
        return {**part, "bsdf": _wet(part["bsdf"], covered)}
    if part["type"] != TYPE or part.get("eta") == WATER_IOR:
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
