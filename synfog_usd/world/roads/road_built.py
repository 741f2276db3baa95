"""Everything that is made for one road alone: surfaces, markings, rails, structures, land, and plants that are sown."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence

import numpy as np

from synfog_usd.base.arrays import Array
from synfog_usd.world.roads import horizon, land, lanes, markings, rules, structures, surface, works
from synfog_usd.world.roads.asphalt import RAINED_ON
from synfog_usd.world.roads.network import Road
from synfog_usd.world.roads.structures import Built, Instanced, LitPanes
from synfog_usd.world.roads.water import standing
from synfog_usd.world.shapes import Part
from synfog_usd.world.spec import Placement, View, WorldSpec

WET_MATERIALS = {"/World/Road/Materials": RAINED_ON}
"""Scope -> materials in it that rain wets."""
LIT_M = 170.0
"""How far windows are lit, from the camera."""
TUFTS_M, MEADOW_M = 45.0, 110.0
"""How far tall grass grows, from the camera: on verges, and on the land beside."""


def _lit(p: Placement, view: View) -> bool:
    return math.hypot(p.x - view.x, p.y - view.y) < LIT_M


PANES = LitPanes("roads", {"window": 0.34, "shop_glass": 0.85}, _lit)


def built(spec: WorldSpec, road: Road) -> list[Built]:
    """Everything that is made for this road alone, by name."""
    parts = surface.surface(road, seed=spec.scatter, asphalt=spec.built["asphalt"])
    names = {"road": "Carriageway", "sidewalk": "Pavement", "terrain": "Verges"}
    whole = [Built(names[key], key, tuple(of_label)) for key, of_label in parts.items()]
    whole.append(Built("Markings", "road", tuple(markings.markings(road))))
    whole.append(Built("Land", "terrain", tuple(land.land(road, _horizon(spec, road)))))
    rails = spec.built.get("rails", "none")
    end = road.reference_line.length if road.land.hill is None else road.land.hill[0] - 0.3
    if rails in ("outer", "all"):
        for t, side in ((_soft(road, -1), 1), (_soft(road, 1), -1)):
            whole.append(
                structures.guard_rail(road, t, side, 0.0, end, f"Guard_Rail_{'Left' if side > 0 else 'Right'}")
            )
    if rails in ("median", "all"):
        for lane in road.lane_section.of("reserve"):
            for t, side, name in ((lane.low + 0.7, -1, "Against"), (lane.high - 0.7, 1, "Along")):
                whole.append(structures.guard_rail(road, t, side, 0.0, end, f"Guard_Rail_{name}"))
    if spec.built.get("delineators") == "both":
        whole += structures.delineators(road, 0.0, end)
    whole += [structures.gantry(road, s, i + 1) for i, s in enumerate(spec.built.get("gantries", ()))]
    if spec.built.get("works"):
        whole.append(works.built(road, spec.built["works"]))
    if road.land.valley:
        whole += structures.bridge(road)
        whole.append(Built("River", "terrain", (land.river(road, _horizon(spec, road)),)))
    if road.land.hill:
        whole += structures.tunnel(road)
    return whole


def water(spec: WorldSpec, road: Road, rate_mm_h: float) -> list[Part]:
    """What stands on the road in rain."""
    return [surface.bend(part, road) for part in standing(road, spec.built["asphalt"], rate_mm_h, seed=spec.scatter)]


def _horizon(spec: WorldSpec, road: Road) -> horizon.Horizon:
    return horizon.Horizon(
        spec.scatter,
        spec.built["horizon"],
        road.height,
        functools.partial(land.away, road),
        (spec.view.x, spec.view.y, spec.view.heading),
        road.flooded,
    )


def _soft(road: Road, side: int) -> float:
    """Offset of a guard rail beside the carriageway: 0.6 m into the verge."""
    verges = [lane for lane in road.lane_section.of("verge") if lane.middle * side > 0]
    if not verges:
        return road.lane_section.high - 0.3 if side > 0 else road.lane_section.low + 0.3
    return verges[-1].low + 0.6 if side > 0 else verges[0].high - 0.6


def scatters(spec: WorldSpec, road: Road) -> Sequence[horizon.Scatter | None]:
    """Woods, what stands at the horizon, and tall grass where the camera is near."""
    sown: list[horizon.Scatter | None] = [
        land.wood(road, seed=spec.scatter, count=spec.built["trees"], nearest_m=spec.built["trees_from_m"]),
        *_horizon(spec, road).scatters(),
    ]
    station = spec.built["station"]
    if spec.built["grass"] == "tufts":
        sown.append(land.tufts(road, seed=spec.scatter, low=station, high=station + TUFTS_M))
        if spec.built["horizon"] == "country":
            end = station + MEADOW_M
            sown.append(land.meadow(road, seed=spec.scatter, low=station, high=end, houses=_houses(spec)))
    return sown


def _houses(spec: WorldSpec) -> Array:
    """(N, 3) x, y and radius [m] of the ground that buildings stand on."""
    circles = []
    for p in spec.placed:
        if p.group == "Buildings":
            corners = rules.footprint(p)
            middle = corners.mean(axis=0)
            circles.append((*middle, np.hypot(*(corners - middle).T).max()))
    return np.array(circles).reshape(-1, 3)


def edged_lanes(road: Road) -> list[lanes.EdgedLane]:
    """Its lanes, bays and shoulders."""
    return lanes.of_road(road)


def instanced(spec: WorldSpec, road: Road) -> list[Instanced]:
    """No models of the library stand here in their hundreds."""
    return []
