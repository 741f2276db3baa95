"""Everything that is made for a roundabout alone: surfaces, markings, signs, land, and plants that are sown."""

from __future__ import annotations

from synfog_usd.world.roads import lanes, roundabout_markings, roundabout_surface
from synfog_usd.world.roads.horizon import Horizon, Scatter
from synfog_usd.world.roads.road_built import PANES as PANES
from synfog_usd.world.roads.road_built import WET_MATERIALS as WET_MATERIALS
from synfog_usd.world.roads.road_built import instanced as instanced
from synfog_usd.world.roads.roundabout import Roundabout
from synfog_usd.world.roads.roundabout_surface import LOOKS as LOOKS
from synfog_usd.world.roads.structures import Built
from synfog_usd.world.shapes import Part
from synfog_usd.world.spec import WorldSpec


def water(spec: WorldSpec, junction: Roundabout, rate_mm_h: float) -> list[Part]:
    """What stands on the ring and the arms in rain."""
    return roundabout_surface.water(junction, spec.built["asphalt"], rate_mm_h, spec.scatter)


NAMES = {"road": "Carriageway", "sidewalk": "Pavement", "terrain": "Verges"}
TUFTS_PER_M2, TUFTS_M = 2.0, 32.0


def built(spec: WorldSpec, junction: Roundabout) -> list[Built]:
    """Parts by name, each with its Cityscapes label."""
    whole = [
        Built(NAMES[label], label, tuple(parts))
        for label, parts in roundabout_surface.surface(junction, spec.built["asphalt"], seed=spec.scatter).items()
    ]
    painted = [
        *roundabout_markings.paint(junction, give_way=spec.built["give_way"]),
        *roundabout_markings.worn(junction, seed=spec.scatter),
    ]
    whole.append(Built("Markings", "road", tuple(painted)))
    whole.append(Built("Land", "terrain", tuple(roundabout_surface.ground(junction, _horizon(spec, junction)))))
    return [*whole, *roundabout_markings.signs(junction)]


def _horizon(spec: WorldSpec, junction: Roundabout) -> Horizon:
    view = spec.view
    return Horizon(
        spec.scatter,
        spec.built["horizon"],
        junction.height,
        lambda x, y: junction.across(x, y)[0],
        (view.x, view.y, view.heading),
    )


def scatters(spec: WorldSpec, junction: Roundabout) -> list[Scatter]:
    """Woods, what stands at the horizon, shrubs and tall grass."""
    sown = roundabout_surface.sown(
        junction,
        seed=spec.scatter,
        trees=spec.built["trees"],
        trees_from_m=spec.built["trees_from_m"],
        shrubs=spec.built["shrubs"],
        tufts_per_m2=TUFTS_PER_M2 if spec.built["grass"] == "tufts" else 0.0,
        within_m=TUFTS_M,
    )
    return [*sown, *_horizon(spec, junction).scatters()]


def edged_lanes(junction: Roundabout) -> list[lanes.EdgedLane]:
    """The lane that goes round, closed, and both lanes of every arm from the circle on; they widen where they meet
    it.
    """
    return [
        lanes.EdgedLane(lanes.TYPES["lane"], *junction.ring_edges()),
        *(
            lanes.EdgedLane(lanes.TYPES["lane"], *junction.lane_edges(arm, way))
            for arm in range(len(junction.arms))
            for way in (-1, 1)
        ),
    ]
