"""How light it is outdoors: lux on open ground and the luminance of the view.

Takes a scene's emitters and camera; gives numbers, and the emitters multiplied by a factor.  Programs without
photometric units, Blender first, light for an exposure of their own: their sun of strength 3 is 3 lux by UsdLux.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from synfog_usd.base.arrays import Array, Indices
from synfog_usd.base.colour import LUMINANCE
from synfog_usd.scene import Camera, SceneDict

GROUND_ALBEDO = 0.2
"""Albedo of the ground in an open view, as of dry asphalt and grass."""

NIGHT_LUX = 100.0
"""Illuminance of open ground [lx] that any day exceeds; sunset under clear sky gives 400 lux."""

NOON_SUN_LUX, NOON_GROUND_LUX = 80_000.0, 20_000.0
"""What a clear noon's sun gives across its rays, and open ground has under a bright sky without sun."""

_NATURAL = (
    (1e5, "a day in full sun"),
    (1e4, "full daylight without the sun"),
    (1e3, "an overcast day"),
    (1e2, "a very dark day"),
    (1e1, "twilight"),
    (1e0, "deep twilight, brighter than any moonlit night"),
    (1e-1, "a night of full moon"),
    (1e-2, "a night of quarter moon"),
    (1e-3, "a clear night without a moon"),
    (1e-4, "an overcast night without a moon"),
)
"""Illuminance of open ground [lx], by decades.  Source: RCA Electro-Optics Handbook, EOH-11 (1974), levels of natural
illuminance at the earth's surface: direct sunlight, full daylight, overcast day, very dark day, twilight, deep
twilight, full moon, quarter moon, starlight, overcast starlight.
"""

_LIT = ("radiance", "irradiance", "intensity")


@dataclass(frozen=True)
class Outdoors:
    """What sun and sky give where nothing stands in their way; lamps do not count.

    Attributes:
        sun_lux: illuminance across the rays of all distant lights [lx].
        ground_lux: illuminance of level ground by sun and sky [lx].
        view_cd_m2: mean luminance of an open view from the camera: sky, and ground of albedo `GROUND_ALBEDO` [cd m-2].
        lamps: whether anything else shines.
    """

    sun_lux: float
    ground_lux: float
    view_cd_m2: float
    lamps: bool = False

    def __str__(self) -> str:
        return self.sentence()

    def sentence(self, times: float = 1.0) -> str:
        """How light it is, in words and numbers; where no day is that dark, with the option that makes it noon.

        Args:
            times: factor on all lights.
        """
        if not self.ground_lux > 0.0:
            return "lamps alone shine, without sun and sky" if self.lamps else "nothing shines"
        light = (
            f"as bright as {in_words(self.ground_lux)}: sun and sky give {rounded(self.ground_lux, 3)} lux on open "
            f"ground, and an open view {rounded(self.view_cd_m2, 3)} cd/m2"
        )
        return light if self.ground_lux >= NIGHT_LUX else f"{light}; {self.noon(times)} makes it noon"

    def noon(self, times: float = 1.0) -> str:
        """The option that makes it noon; `times` as above."""
        factor = NOON_SUN_LUX / self.sun_lux if self.sun_lux > 0.0 else NOON_GROUND_LUX / self.ground_lux
        return f"--light-scale {rounded(times * factor, 1)}"


def in_words(ground_lux: float) -> str:
    """What natural light gives open ground an illuminance [lx], to the nearest decade.

    >>> in_words(0.25), in_words(80_000.0)
    ('a night of full moon', 'a day in full sun')
    """
    return min(_NATURAL, key=lambda row: abs(math.log(ground_lux / row[0])))[1]


def rounded(value: float, digits: int) -> str:
    """A number of so many digits, without an exponent where it has less than ten places.

    >>> rounded(6366.2, 1), rounded(0.031416, 3)
    ('6000', '0.0314')
    """
    return f"{float(f'{value:.{digits}g}'):.10g}"


def outdoors(scene: SceneDict) -> Outdoors:
    """See `Outdoors`."""
    return measured(scene.world, scene.camera)


def measured(world: Mapping[str, Any], camera: Camera) -> Outdoors:
    """See `Outdoors`; `world` as in `SceneDict`."""
    sun = ground = 0.0
    sky, lamps = None, False
    for light in (part for part in world.values() if isinstance(part, dict)):
        if light["type"] == "directional":
            lux = float(LUMINANCE @ np.broadcast_to(np.asarray(light["irradiance"]["value"], dtype=np.float64), 3))
            sun += lux
            ground += lux * max(0.0, -float(light["to_world"][2, 2]))
        elif light["type"] in ("constant", "envmap"):
            sky = light
        else:
            lamps = lamps or _shines(light)
    across = np.linspace(0.0, 1.0, 33)[:-1] + 1 / 64
    rays = camera.directions(np.stack(np.meshgrid(across, across), axis=-1)).reshape(-1, 3)
    nits_seen = np.zeros(len(rays))
    if sky is not None and sky["type"] == "constant":
        nits = float(LUMINANCE @ np.broadcast_to(np.asarray(sky["radiance"]["value"], dtype=np.float64), 3))
        ground += math.pi * nits
        nits_seen[:] = nits
    elif sky is not None:
        nits_of, way, steradians = _texels(sky)
        ground += float((nits_of * np.maximum(way[..., 2], 0.0) * steradians).sum())
        nits_seen = nits_of.reshape(-1)[_nearest(rays @ sky["to_world"][:3, :3], nits_of.shape)]
    nits_seen = np.where(rays[:, 2] > 0.0, nits_seen, GROUND_ALBEDO * ground / math.pi)
    return Outdoors(sun, ground, float(nits_seen.mean()), lamps)


def _shines(part: Mapping[str, Any]) -> bool:
    """Whether a part of a scene is a lamp, a surface that shines, or has one in it."""
    if part.get("type") == "shapegroup":
        return any(_shines(shape) for shape in part.values() if isinstance(shape, dict))
    return "emitter" in part or part.get("type") in ("point", "spot", "photometric")


def _texels(sky: Mapping[str, Any]) -> tuple[Array, Array, Array]:
    """Luminance (H, W), direction in the scene (H, W, 3) and solid angle (H, 1) of an environment's texels."""
    nits = np.asarray(sky["bitmap"], dtype=np.float64) @ LUMINANCE
    height, width = nits.shape
    azimuth, polar = 2.0 * np.pi * (np.arange(width) + 0.5) / width, np.pi * (np.arange(height)[:, None] + 0.5) / height
    local = np.stack(
        [np.sin(polar) * np.sin(azimuth), np.broadcast_to(np.cos(polar), nits.shape), -np.sin(polar) * np.cos(azimuth)],
        axis=-1,
    )
    return nits, local @ sky["to_world"][:3, :3].T, 2.0 * np.pi**2 / (width * height) * np.sin(polar)


def _nearest(local: Array, shape: tuple[int, ...]) -> Indices:
    """Texel number that each direction of an environment's own frame falls on."""
    height, width = shape
    column = np.floor(np.arctan2(local[:, 0], -local[:, 2]) / (2.0 * np.pi) * width).astype(np.int64) % width
    row = np.clip(np.arccos(np.clip(local[:, 1], -1.0, 1.0)) / np.pi * height, 0, height - 1).astype(np.int64)
    return np.asarray(row * width + column)


def brightened(world: Mapping[str, Any], times: float) -> dict[str, Any]:
    """A scene's world with all lights multiplied by a factor."""
    return {name: _brighter(part, times) if isinstance(part, dict) else part for name, part in world.items()}


def _brighter(part: dict[str, Any], times: float) -> dict[str, Any]:
    if part["type"] == "envmap":
        return {**part, "bitmap": (part["bitmap"] * times).astype(np.float32)}
    if part["type"] == "shapegroup":
        return {name: _brighter(value, times) if isinstance(value, dict) else value for name, value in part.items()}
    if "emitter" in part:
        return {**part, "emitter": _brighter(part["emitter"], times)}
    return {name: _times(value, times) if name in _LIT else value for name, value in part.items()}


def _times(colour: dict[str, Any], times: float) -> dict[str, Any]:
    """A colour, or the linear texels of a picture, times a factor."""
    if colour["type"] == "bitmap":
        return {**colour, "bitmap": (colour["bitmap"] * times).astype(np.float32)}
    return {**colour, "value": (np.asarray(colour["value"], dtype=np.float64) * times).tolist()}
