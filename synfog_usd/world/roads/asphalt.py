"""The asphalt of a road: which kind, how old, how wet; its materials, and puddles.

Water in the pores of a surface keeps light in by total reflection, so that it is
darker, and a film over them is smoother than the stones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from synfog_usd.base.seeds import stream
from synfog_usd.world.materials import PALETTE, Material
from synfog_usd.world.roads.lane_section import DRIVEN, PAVED
from synfog_usd.world.roads.network import Road
from synfog_usd.world.shapes import Part, strip

KINDS = ("new", "worn", "old", "chip_seal")
WETNESS = {"dry": 0.0, "damp": 0.5, "wet": 1.0}
WATER_IOR = 1.333
FILM_SMOOTHS = 0.62
"""Share of its roughness that a wet surface loses: the film fills the grooves between the stones."""
ALBEDO = {
    "asphalt_lane": 0.08,
    "asphalt": 0.085,
    "asphalt_patch": 0.053,
    "asphalt_old": 0.11,
    "chip_seal": 0.13,
    "marking": 0.50,
    "paving": 0.25,
    "kerb": 0.3,
}
"""Mean albedo of what rain falls on, where a texture gives it."""
RAINED_ON = (*ALBEDO, "tar", "iron", "setts")
TONES: Mapping[str, Mapping[str, tuple[float, float, float]]] = {
    "new": {"asphalt": (0.62, 0.62, 0.64)},
    "worn": {},
    "old": {"asphalt_lane": (1.5, 1.47, 1.42), "asphalt": (1.42, 1.4, 1.36), "asphalt_old": (1.75, 1.72, 1.66)},
    "chip_seal": {"asphalt": (1.2, 1.18, 1.13)},
}
"""Factors on the textures by kind: bitumen is black, wear bares grey stone."""
REPAIRS = {"new": 0.12, "worn": 1.0, "old": 2.2, "chip_seal": 0.5}
"""Patches and cracks of a road, over those of a worn one."""
LOOKS: dict[str, Material] = {
    "chip_seal": Material((1.0, 1.0, 1.0), texture="chip_seal.jpg", gloss="chip_seal_gloss.jpg"),
    "puddle": Material((0.032, 0.031, 0.029), 0.07, ior=WATER_IOR),
}
PUDDLE_M = 0.001
"""Over the asphalt; below patches, covers and paint, which stand out of the water."""
TRACK_M = 0.78
STEP_M = 0.4
KERB_STEP_M, TRACK_STEP_M = 11.0, 13.0
INTO_TUNNEL_M = 10.0


@dataclass(frozen=True)
class Asphalt:
    """What a road is paved with.

    Attributes:
        kind: one of KINDS; wet: one of WETNESS.
    """

    kind: str = "worn"
    wet: str = "dry"

    @property
    def lane(self) -> str:
        """Material of the lanes; only `asphalt_lane` has wheel tracks."""
        return {"new": "asphalt", "chip_seal": "chip_seal"}.get(self.kind, "asphalt_lane")


def wet_albedo(dry: float, ior: float = WATER_IOR) -> float:
    """Diffuse reflectance of a porous matt surface under a film of water.

    The surface reflects light into the film, whose underside sends a share p = 1 - (1 - r) / n^2
    back to the surface.

    Args:
        dry: reflectance of the dry surface, 0 to 1; ior: n of the liquid.

    Source: Lekner and Dorf (1988), Applied Optics 27, 1278, with the dry surface's
    reflectance kept for the wetted grains; r, the mean of Fresnel's reflectance over
    a hemisphere, by the fit of Egan and Hilgeman (1973).
    """
    outside = ((ior - 1) / (ior + 1)) ** 2
    mean = -1.4399 / ior**2 + 0.7099 / ior + 0.6681 + 0.0636 * ior  # inner reflection of diffuse light
    return (1 - outside) * (1 - mean) * dry / (1 - mean * dry)


def looks(asphalt: Asphalt, materials: Mapping[str, Material], smooth: float | None = None) -> dict[str, Material]:
    """What this road's materials are, by name; those that its kind and the water leave alone are left out.

    Args:
        smooth: share of the texture that water fills, 0 to 1; by default as `asphalt` is wet.
    """
    share = WETNESS[asphalt.wet]
    result = {}
    for name in RAINED_ON:
        base = LOOKS.get(name) or materials.get(name) or PALETTE.get(name)
        if base is None:
            continue
        tone = TONES[asphalt.kind].get(name, (1.0, 1.0, 1.0))
        colour = (
            tuple(c * t for c, t in zip(base.colour, tone, strict=True))
            if name in TONES[asphalt.kind] and base.texture
            else base.colour
        )
        albedo = ALBEDO.get(name, float(np.mean(base.colour))) * float(np.mean(tone))
        darker = 1.0 - share * (1.0 - wet_albedo(albedo) / albedo)
        smoother = 1.0 - (share if smooth is None else smooth) * FILM_SMOOTHS
        r, g, b = (round(c * darker, 4) for c in colour)
        rough = round(base.roughness * smoother, 4)
        result[name] = replace(
            base,
            colour=(r, g, b),
            roughness=rough,
            gloss_factor=round(smoother, 4),
            ior=WATER_IOR if share else base.ior,
        )
    return {**LOOKS, **result}


def puddles(road: Road, asphalt: Asphalt, *, seed: int) -> list[Part]:
    """Standing water in wheel tracks and at the kerbs, in the level plane; none where it is dry."""
    share = WETNESS[asphalt.wet]
    if not share:
        return []
    rng = stream(seed, "road", "puddles")
    end = road.reference_line.length if road.land.hill is None else road.land.hill[0] + INTO_TUNNEL_M
    parts = []
    fewer = 0.35 if asphalt.kind in ("new", "chip_seal") else 1.0  # no ruts yet, or no standing water between chippings
    for lane in road.lane_section.of(*DRIVEN):
        for _ in range(rng.poisson(share**2 * fewer * end / TRACK_STEP_M)):
            t = lane.middle + TRACK_M * float(rng.choice((-1.0, 1.0))) + float(rng.normal(0, 0.1))
            parts.append(
                _puddle(
                    rng,
                    float(rng.uniform(2.0, end - 12.0)),
                    t,
                    float(rng.uniform(1.0, 7.0)),
                    float(rng.uniform(0.08, 0.22)),
                    0,
                )
            )
    for kerb, side in road.lane_section.kerbs():
        below = road.lane_section.at(kerb - 0.05 * side)
        if below is None or below.kind not in PAVED:
            continue
        if road.crossfall and not road.lane_section.from_crown(kerb):  # water runs away from it
            continue
        for _ in range(rng.poisson(share * end / KERB_STEP_M)):
            parts.append(
                _puddle(
                    rng,
                    float(rng.uniform(2.0, end - 14.0)),
                    kerb,
                    float(rng.uniform(1.5, 10.0)),
                    float(rng.uniform(0.12, 0.45)),
                    -side,
                )
            )
    return parts


def _puddle(rng: np.random.Generator, s: float, t: float, long: float, wide: float, side: int) -> Part:
    """A puddle with a wavering edge; `side` tells on which side of t it lies, 0 on both."""
    count = max(4, round(long / STEP_M) + 1)
    at = np.linspace(s, s + long, count)
    shape = np.sin(np.linspace(0.0, np.pi, count)) ** 0.7
    edges = []
    for direction in (-1, 1):
        waver = 1 + 0.4 * np.convolve(rng.normal(0, 1, count + 2), (0.25, 0.5, 0.25), "valid")
        reach = wide * shape * np.clip(waver, 0.25, 1.9)
        edges.append(t + direction * (reach if side in (0, direction) else np.zeros(count)))
    low, high = edges
    return strip(
        [np.array([(a, y, PUDDLE_M), (b, y, PUDDLE_M)]) for a, b, y in zip(low, high, at, strict=True)], "puddle"
    )
