"""Roundabouts: arcs touch line and circle, the ground is where it is said to be, nothing overlaps or goes the wrong way
round, mistakes have their place.
"""

from __future__ import annotations

import functools
import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from support import outlines, sight
from support.outlines import assert_whole, heights, overlaps
from support.sight import model as shape

from synfog_usd.world.compose import compose, draw, load
from synfog_usd.world.roads import horizon, roundabout_surface
from synfog_usd.world.roads.network import Land
from synfog_usd.world.roads.reference_line import ReferenceLine
from synfog_usd.world.roads.roundabout import ZEBRA_HALF_M, Arm, Circle, roundabout

ROOT = Path(__file__).resolve().parents[2]
RECIPE = ROOT / "stages" / "recipes" / "roundabout.yaml"
USERS = {"person", "rider", "car", "truck", "bus", "motorcycle", "bicycle"}
QUICK = (0, 1, 2)
NEW = {"asphalt", "asphalt_lane", "chip_seal", "paving", "setts", "grass"}
"""Materials of the ground itself; kerbs are left out, whose edges are steep."""


@functools.cache
def spec(seed):
    return draw(load(RECIPE), seed=seed)


@functools.cache
def plain(radius=18.0, corner_m=15.0, headings=(180.0, 250.0, 5.0, 95.0), apron=1.5, hills=0.0):
    lines = [ReferenceLine(160.0, origin=(0.0, 0.0, heading)) for heading in headings]
    circle = Circle(radius=radius, ring=6.0, apron=apron, mound=1.0, corner=corner_m)
    return roundabout(lines, circle, Arm(lane=3.4, half_island=1.6, pavement=2.5, zebra=8.0), Land(hills, 1))


def ground_triangles(junction, beside=True):
    """(N, 3, 3) triangles of a roundabout's ground."""
    parts = itertools.chain(*roundabout_surface.surface(junction).values())
    beyond = horizon.Horizon(3, "country", junction.height, lambda x, y: junction.across(x, y)[0])
    land = roundabout_surface.ground(junction, beyond) if beside else []
    parts = [*(part for part in parts if part.material in NEW), *land]
    return np.concatenate([part.points[part.faces] for part in parts])


def outline(p):
    """(4, 2) corners of a placement's body on the ground; of poles, people and trees those of the foot."""
    _, high, label = shape(p.asset)
    half = {"person": 0.2, "pole": 0.08, "traffic sign": 0.08}.get(
        label, 0.25 if label == "vegetation" and high[2] > 3 else None
    )
    return outlines.outline(p, half)


# -- geometry


@pytest.mark.parametrize("corner_m", (10.0, 15.0, 25.0))
def test_entry_arcs_touch_the_circle_and_the_arms_edge(corner_m):
    """Through every three neighbouring samples of a kerb goes a straight line, the circle or an arc of the wished
    radius; it never has a corner.
    """
    junction = plain(corner_m=corner_m, headings=(180.0, 270.0, 0.0, 90.0))
    line = junction.outline
    p = line.points[line.span(0)]
    near = np.hypot(*p.T) < junction.radius + 15.5  # beyond that the lanes come together
    p = p[np.flatnonzero(near)[0] : np.flatnonzero(near)[-1] + 1]
    a, b, c = p[:-2], p[1:-1], p[2:]
    ab, bc, ac = (np.hypot(*(v - u).T) for u, v in ((a, b), (b, c), (a, c)))
    turn = (b - a)[:, 0] * (c - b)[:, 1] - (b - a)[:, 1] * (c - b)[:, 0]
    k = 2 * turn / (ab * bc * ac)  # Menger's curvature, positive to the left
    known = np.array([0.0, 1 / junction.radius, -1 / junction.corners[0]])
    off = np.abs(k[:, None] - known).min(axis=1)
    assert (off > 1e-6).sum() <= 4  # where pieces join the three lie on two of them
    assert np.abs(k).max() < 1.001 / min(junction.corners[0], junction.radius)
    assert junction.corners[0] == corner_m or junction.corners[0] < corner_m


FORMS = [(18.0, 1.5, 4.0), *(pytest.param(*one, 0.0, marks=pytest.mark.slow) for one in ((14.0, 0.0), (22.5, 2.5)))]


@pytest.mark.parametrize("radius, apron, hills", FORMS)
def test_the_meshes_are_where_the_ground_is_said_to_be(radius, apron, hills):
    """The highest triangle at 250 places from the mound to the land is `height` within 6 mm, on grass within 3 cm."""
    junction = plain(radius=radius, apron=apron, hills=hills, headings=(180.0, 262.0, 5.0, 95.0))
    triangles = ground_triangles(junction)
    rng = np.random.Generator(np.random.PCG64(1))
    r, angle = 62.0 * np.sqrt(rng.random(250)), rng.uniform(0, 2 * np.pi, 250)
    x, y = r * np.cos(angle), r * np.sin(angle)
    u, _ = junction.across(x, y)
    height, land = junction.height(x, y), u > junction.pavement
    for i in range(250):
        if (
            -0.02 < u[i] < 0.16
            or abs(r[i] - junction.island) < 0.17
            or abs(r[i] - junction.inner) < 0.05
            or abs(u[i] - junction.pavement) < 0.02
        ):
            continue  # kerbs
        if any(abs(abs(t) - w) < 0.2 or abs(s - e) < 0.2 for t, s, w, e in _island_edges(junction, x[i], y[i])):
            continue
        found = heights(triangles, x[i], y[i])
        rough = 0.03 if u[i] < junction.pavement + 12.0 else 0.2  # farther out only woods stand, a hand deep
        tolerance = rough if land[i] else 0.03 if r[i] < junction.island else 0.006
        assert found[-1] == pytest.approx(height[i], abs=tolerance), (x[i], y[i], u[i])


def _island_edges(junction, x, y):
    """(t, s, half width, nearest end) of a place by every part of a splitter island that it is near."""
    for arm, road in enumerate(junction.arms):
        h = math.radians(road.reference_line.origin[2])
        s, t = -x * math.sin(h) + y * math.cos(h), x * math.cos(h) + y * math.sin(h)
        for low, high in junction.islands(arm):
            if low - 0.3 < s < high + 0.3 and abs(t) < 3:
                inside = np.clip(s, low, high)
                yield t, s, float(junction.half_width(low, high, inside)), low if s - low < high - s else high


# -- what stands where


def check(seed):
    """Everything that must hold of one draw; gives its layout for comparison."""
    world = spec(seed)
    junction = world.road
    bodies = [(p, outline(p)) for p in world.placed]
    assert overlaps(bodies) is None, (seed, overlaps(bodies))
    labels = {p.name: shape(p.asset)[2] for p in world.placed}
    assert sum(label in USERS for label in labels.values()) >= 5
    assert sum(share >= sight.SEEN for share in sight.shares(world, within_m=100.0, enough=3).values()) >= 3, seed
    going_round = 0
    for p, prints in bodies:
        u, _ = junction.across(prints[:, 0], prints[:, 1])
        label, r = labels[p.name], math.hypot(p.x, p.y)
        if label in USERS:
            assert p.z == pytest.approx(float(junction.height(p.x, p.y)), abs=0.002), (seed, p)
        if label in ("building", "fence") or p.asset == "hedge":
            assert u.min() > junction.pavement, (seed, p)
        if label in ("car", "truck", "bus", "rider", "motorcycle"):
            assert u.max() < 0.0, (seed, p)  # between the kerbs
            forward = np.array([-math.sin(math.radians(p.heading)), math.cos(math.radians(p.heading))])
            if r < junction.radius:
                going_round += 1
                tangent = np.array([-p.y, p.x]) / r
                assert forward @ tangent > 0.98, (seed, p)  # counter-clockwise
                assert np.abs(junction.height(prints[:, 0], prints[:, 1])).max() == 0.0, (seed, p)  # nor on the apron
                assert r > junction.inner + 0.5
            else:
                arm, side = _arm_of(junction, p)
                heading = float(junction.arms[arm].reference_line.heading(side[0]))
                along = forward @ np.array([-math.sin(heading), math.cos(heading)])
                assert along * (1 if side[1] > 0 else -1) > 0.97, (seed, p)  # keeps to the right
                for arm_, road in enumerate(junction.arms):
                    s, t = (np.array(v) for v in road.reference_line.nearest(prints[:, 0], prints[:, 1]))
                    assert not np.any((np.abs(s - road.zebras[0]) < ZEBRA_HALF_M) & (np.abs(t) < 6)), (seed, p, arm_)
        elif label == "person":
            crossed = ((road.reference_line.nearest(p.x, p.y), road.zebras[0]) for road in junction.arms)
            on_zebra = any(abs(float(s) - zebra) < ZEBRA_HALF_M and abs(float(t)) < 9.0 for (s, t), zebra in crossed)
            middle, _ = junction.across(p.x, p.y)
            assert 0.0 < middle < junction.pavement or (middle < 0.0 and on_zebra), (seed, p)
    return tuple((p.asset, p.x, p.y) for p in world.placed), going_round


def _arm_of(junction, p):
    """The arm that a place is on, with its station and offset there."""
    found = [tuple(float(v) for v in road.reference_line.nearest(p.x, p.y)) for road in junction.arms]
    arm = min(range(len(found)), key=lambda k: abs(found[k][1]) if found[k][0] > junction.radius * 0.6 else math.inf)
    return arm, found[arm]


@pytest.mark.parametrize("seed", [pytest.param(n, marks=pytest.mark.slow if n else ()) for n in QUICK])
def test_nothing_overlaps_floats_or_goes_the_wrong_way(seed):
    """A few seeds; hundreds are among the long tests."""
    check(seed)


@pytest.mark.physics
def test_three_hundred_roundabouts_keep_the_rules_and_none_is_another():
    """Every rule, no two layouts alike, three to five arms all drawn, and in most someone goes round."""
    found = [check(seed) for seed in range(300)]
    assert len({layout for layout, _ in found}) == 300
    assert {len(spec(seed).road.arms) for seed in range(300)} == {3, 4, 5}
    assert sum(n > 0 for _, n in found) > 280


# -- the stage


@pytest.fixture(scope="module")
def stages(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stages")
    compose(RECIPE, folder / "first" / "stage.usda", seed=2)
    return folder


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes(stages):
    """And another seed another layout."""
    compose(RECIPE, stages / "again" / "stage.usda", seed=2)
    first, again = (
        {layer.name: layer.read_bytes() for layer in (stages / name).iterdir()} for name in ("first", "again")
    )
    assert first == again
    assert len({tuple((p.asset, p.x, p.y) for p in spec(seed).placed) for seed in QUICK}) == len(QUICK)


def test_a_stage_is_whole_labelled_and_valid(stages):
    """Plain USD without a composition error or a missing file, under 10 MiB, every component labelled, every validator
    content.
    """
    path = stages / "first" / "stage.usda"
    assert sum(layer.stat().st_size for layer in path.parent.iterdir()) < 10 << 20
    assert_whole(path, least=50)
