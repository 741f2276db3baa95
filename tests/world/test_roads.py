"""Roads: clothoids are clothoids, nothing overlaps, floats or drives against its lane, and every mistake has its
place.
"""

from __future__ import annotations

import functools
import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from scipy import special, stats
from support import sight
from support.outlines import assert_whole, heights, outline, overlaps
from support.sight import model as shape

from synfog_usd.world import language
from synfog_usd.world.compose import compose, draw, load
from synfog_usd.world.roads import horizon, land, markings, rules, surface
from synfog_usd.world.roads.lane_section import KERB_M, LaneSection
from synfog_usd.world.roads.network import Land, Road
from synfog_usd.world.roads.reference_line import ReferenceLine, bends

ROOT = Path(__file__).resolve().parents[2]
RECIPES = ROOT / "stages" / "recipes"
ROADS = tuple(sorted(path.stem for path in RECIPES.glob("*.yaml") if "world: road" in path.read_text()))
FEW = [pytest.param(name, n, marks=pytest.mark.slow if n else ()) for name in ROADS for n in range(3)]
ALL = [(name, seed) for seed in range(-(-500 // len(ROADS))) for name in ROADS][:500]
USERS = {"person", "rider", "car", "truck", "bus", "motorcycle", "bicycle"}


@functools.cache
def read(name):
    path = RECIPES / f"{name}.yaml"
    return load(path)


@functools.cache
def spec(name, seed):
    return draw(read(name), seed=seed)


def solid(world):
    """(placement, outline) of whatever has a body: vehicles, people and houses whole, of poles and trees the foot."""
    found = []
    for p in world.placed:
        _, high, label = shape(p.asset)
        if p.asset == "rider":
            continue  # sits on the bicycle
        if label in ("car", "truck", "bus", "bicycle", "rider", "building") or p.asset in (
            "woman_pram",
            "wheelchair_user",
        ):
            found.append((p, outline(p)))
        elif label == "person":
            found.append((p, outline(p, 0.2)))
        elif label in ("pole", "traffic sign", "traffic light", "polegroup"):
            found.append((p, outline(p, 0.08)))
        elif label == "vegetation" and high[2] > 3:
            found.append((p, outline(p, 0.25)))
        else:
            found.append((p, outline(p)))
    return found


def check(name, seed):
    """Everything that must hold of one draw; gives its layout for comparison."""
    world = spec(name, seed)
    road = world.road
    bodies = solid(world)
    assert overlaps(bodies) is None, (name, seed, overlaps(bodies))
    users = [p for p in world.placed if shape(p.asset)[2] in USERS]
    assert len(users) >= 5
    assert sum(share >= sight.SEEN for share in sight.shares(world, within_m=100.0, enough=3).values()) >= 3, (
        name,
        seed,
    )
    for p in world.placed:
        s, t = (float(v) for v in road.reference_line.nearest(p.x, p.y))
        if p.group in ("Vehicles", "People"):
            assert p.z == pytest.approx(float(road.height(p.x, p.y)), abs=0.005), (name, seed, p)
        lane = road.lane_section.at(t)
        if p.group == "Vehicles" and lane is not None and lane.way:
            along = math.cos(math.radians(p.heading) - float(road.reference_line.heading(s)))
            assert along * lane.way > 0.99, (name, seed, p)
        if p.group == "People" and p.asset != "rider":
            crossing = any(abs(s - z) < markings.ZEBRA_DEPTH_M / 2 for z in road.zebras)
            working = p.asset == "worker" and lane is not None and lane.kind in ("shoulder", "verge")
            assert lane is not None and (lane.kind == "pavement" or crossing or working), (name, seed, p)
    return tuple((p.asset, p.x, p.y) for p in world.placed), road.reference_line.curvature, road.lane_section


def beyond(road):
    """Its horizon."""
    return horizon.Horizon(3, "country", road.height, functools.partial(land.away, road))


def mesh_triangles(road, seed=0, beside=False):
    """(N, 3, 3) triangles of the ground of a road, and of the land beside it."""
    parts = [
        *itertools.chain(*surface.surface(road, seed=seed).values()),
        *(land.land(road, beyond(road)) if beside else ()),
    ]
    return np.concatenate(
        [p.points[p.faces] for p in parts if p.material not in ("tar", "iron", "asphalt_patch", "asphalt_old", "kerb")]
    )


# -- geometry


def test_a_clothoid_ends_where_fresnel_says():
    """Curvature from 0 to 1/60 over 80 m: x and y of the Euler spiral by Fresnel's integrals, within a tenth of a
    millimetre.
    """
    length, radius = 80.0, 60.0
    line = ReferenceLine(length, ((0.0, 0.0), (length, 1.0 / radius)))
    scale = math.sqrt(math.pi * radius * length)  # heading = s^2 / (2 R L) = (pi / 2) (s / scale)^2
    s = np.linspace(0, length, 41)
    across, along = special.fresnel(s / scale)
    x, y = line.place(s, 0.0)
    np.testing.assert_allclose(
        y, scale * along, atol=1e-4
    )  # Simpson's rule over 0.25 m; measured 1e-9, plus chords of 0.13 mm between
    np.testing.assert_allclose(x, -scale * across, atol=2e-4)
    np.testing.assert_allclose(line.heading(s), s * s / (2 * radius * length), atol=1e-5)


def test_a_bend_turns_by_its_angle_and_slopes_make_parabolas():
    """Three bends end in the sum of their angles."""
    line = ReferenceLine(
        900.0,
        bends([(30.0, 200.0, 40.0), (20.0, 120.0, -70.0), (10.0, 300.0, 12.0)], length=900.0),
        ((0.0, 0.0), (200.0, 0.06)),
    )
    assert math.degrees(float(line.heading(900.0))) == pytest.approx(-18.0, abs=1e-3)
    s = np.array([0.0, 50.0, 125.0, 200.0, 300.0])
    np.testing.assert_allclose(line.height(s), np.where(s <= 200, 0.06 / 400 * s**2, 6.0 + 0.06 * (s - 200)), atol=1e-5)


def test_nearest_finds_what_place_placed():
    """1,000 places on a winding line, within a millimetre in station and offset."""
    line = ReferenceLine(600.0, bends([(20.0, 150.0, 60.0), (10.0, 150.0, -80.0), (40.0, 90.0, 30.0)], length=600.0))
    rng = np.random.Generator(np.random.PCG64(5))
    s, t = rng.uniform(1, 599, 1000), rng.uniform(-40, 40, 1000)
    found = line.nearest(*line.place(s, t))
    np.testing.assert_allclose(found[0], s, atol=2e-3)
    np.testing.assert_allclose(found[1], t, atol=2e-3)


@pytest.mark.parametrize("crossfall", [0.0, 0.025])
def test_the_meshes_are_where_the_ground_is_said_to_be(crossfall):
    """On a road with bends, crests, kerbs and hills: the highest triangle at 300 places is the ground within 5 mm, on
    the land within 8 cm.
    """
    bands = [("verge", 2.0, 0), ("lane", 3.2, -1), ("lane", 3.2, 1), ("parking", 2.0, 0), ("pavement", 2.5, 0)]
    line = ReferenceLine(
        300.0,
        bends([(20.0, 160.0, 50.0), (10.0, 200.0, -40.0)], length=300.0),
        ((0.0, 0.0), (60.0, 0.05), (180.0, -0.05), (300.0, 0.02)),
    )
    road = Road(line, LaneSection.from_widths(bands), land=Land(6.0, 3), crossfall=crossfall)
    triangles = mesh_triangles(road, beside=True)
    rng = np.random.Generator(np.random.PCG64(1))
    for s, t in zip(
        rng.uniform(5, 295, 300), rng.uniform(road.lane_section.low - 8, road.lane_section.high + 8, 300), strict=True
    ):
        if any(abs(t - kerb) < 0.2 for kerb, _ in road.lane_section.kerbs()):
            continue
        x, y = (float(v) for v in line.place(s, t))
        on_road = road.lane_section.low <= t <= road.lane_section.high
        assert heights(triangles, x, y)[-1] == pytest.approx(
            float(road.ground(s, t)), abs=0.005 if on_road else 0.08
        ), (s, t)
    pavement = float(road.ground(100.0, road.lane_section.high - 1.0) - line.height(100.0))
    assert pavement == pytest.approx(KERB_M - crossfall * (3.2 + 2.0))


def test_a_carriageway_falls_from_its_crown_to_its_gutters():
    """2.5 %: from the line between the directions over all that is paved, and from both sides of an island."""
    street = [("pavement", 2.0, 0), ("parking", 2.0, 0), ("lane", 3.0, -1), ("lane", 3.0, 1), ("cycle", 1.5, 1)]
    road = Road(ReferenceLine(90.0), LaneSection.from_widths([*street, ("verge", 2.0, 0)]), crossfall=0.025)
    t = np.array([-6.0, -5.0 + 1e-9, -3.0, 0.0, 2.0, 4.5, 4.5 + 2.0])
    falls = 0.025 * np.array([5.0, 5.0, 3.0, 0.0, 2.0, 4.5, 4.5])
    over = np.array([KERB_M, 0.0, 0.0, 0.0, 0.0, -0.03, -0.15])
    np.testing.assert_allclose(road.ground(40.0, t), over - falls, atol=1e-7)
    dual = [("lane", 3.5, -1), ("lane", 3.5, -1), ("island", 2.0, 0), ("lane", 3.5, 1), ("lane", 3.5, 1)]
    road = Road(ReferenceLine(90.0), LaneSection.from_widths(dual), crossfall=0.025)
    t = np.array([-8.0, -4.5, -0.5, 0.5, 4.5, 8.0])
    np.testing.assert_allclose(road.ground(40.0, t), np.where(abs(t) < 1, KERB_M, -0.025 * (abs(t) - 1)), atol=1e-9)
    one_way = [("shoulder", 1.0, 0), ("lane", 3.5, 1), ("lane", 3.5, 1), ("shoulder", 2.5, 0)]
    road = Road(ReferenceLine(90.0), LaneSection.from_widths(one_way), crossfall=0.025)
    t = np.array([-1.0, 0.0, 3.5, 9.5])
    np.testing.assert_allclose(road.ground(40.0, t), -0.025 * np.array([1.0, 0.0, 3.5, 9.5]), atol=1e-9)


# -- what stands where


@pytest.mark.parametrize("name, seed", FEW)
def test_nothing_overlaps_floats_or_goes_against_its_lane(name, seed):
    """A few seeds of every recipe; all 500 are among the long tests."""
    check(name, seed)


@pytest.mark.physics
def test_five_hundred_worlds_keep_the_rules_and_none_is_another():
    """500 draws over all recipes: every rule, and no two layouts alike."""
    layouts = {check(name, seed) for name, seed in ALL}
    assert len(layouts) == 500


@pytest.mark.parametrize("name", ("rural", "motorway", "tunnel"))
def test_wheels_touch_the_road_on_slopes(name):
    """The four corners of a vehicle's axles are within 2 cm of the triangles below, pitch and all."""
    world = spec(name, 2)
    triangles = mesh_triangles(world.road, seed=world.scatter)
    checked = 0
    for p in world.placed:
        if p.group != "Vehicles" or shape(p.asset)[2] == "bicycle":
            continue
        s, _ = world.road.reference_line.nearest(p.x, p.y)
        if not 6 < s < world.road.reference_line.length - 6:
            continue
        h, pitch = math.radians(p.heading), math.radians(p.pitch)
        two_wheels = shape(p.asset)[2] == "rider"
        for ahead in (-0.6, 0.6) if two_wheels else (-1.3, 1.3):
            for side in (0.0,) if two_wheels else (-0.75, 0.75):
                x = p.x + side * math.cos(h) - ahead * math.cos(pitch) * math.sin(h)
                y = p.y + side * math.sin(h) + ahead * math.cos(pitch) * math.cos(h)
                assert p.z + ahead * math.sin(pitch) == pytest.approx(heights(triangles, x, y)[-1], abs=0.02), (
                    p,
                    ahead,
                )
        checked += 1
    assert checked >= 4


@pytest.mark.parametrize("name, seed", [("arterial", 0), ("residential", 1), ("rural", 1)])
def test_who_is_seen_is_seen_in_shapely_too(name, seed):
    """Six rays against 64 through footprints cut by GEOS: the same users in the picture, shares alike to 1/8 on average
    and to 0.45 each.

    Six rays know a share to 0.2 (standard deviation at one half); over 16 worlds the mean difference was -0.02, its
    mean size 0.07 and its greatest 0.39.
    """
    world = spec(name, seed)
    fov = math.degrees(2 * math.atan(0.36 / 2 / world.view.focal_length))
    rays, cut = (
        rules.visible_shares(world.view, fov, world.placed, world.road, within_m=100.0),
        sight.shares(world, within_m=100.0),
    )
    assert set(rays) == set(cut) and len(cut) >= 5
    off = np.array([rays[name] - cut[name] for name in cut])
    assert np.abs(off).mean() < 1 / 8 and np.abs(off).max() < 0.45


# -- the language


def test_a_truncated_normal_is_one():
    """4,000 draws against scipy's (Kolmogorov and Smirnov, alpha 1e-4)."""
    drawn = language.Distribution("normal", (2.0, 3.0, -1.0, 4.0))
    rng = np.random.Generator(np.random.PCG64(0))
    values = [drawn(rng) for _ in range(4000)]
    assert stats.kstest(values, stats.truncnorm(-1.0, 2.0 / 3.0, loc=2.0, scale=3.0).cdf).pvalue > 1e-4


def test_hours_are_interpolated_round_midnight():
    """Between 22 h (100) and 2 h (300) lies midnight with 200."""
    drawn = language.Distribution("by_hour", ((2.0, 300.0), (12.0, 500.0), (22.0, 100.0)))
    rng = np.random.Generator(np.random.PCG64(0))
    assert [drawn(rng, hour=h) for h in (22.0, 0.0, 2.0, 7.0)] == pytest.approx([100.0, 200.0, 300.0, 400.0])


def test_the_command_line_overrides_the_recipe():
    """Twenty vehicles are twenty vehicles; what else was drawn stays as it was."""
    plain = spec("motorway", 3)
    changed = draw(load(RECIPES / "motorway.yaml", ["traffic.count=20"]), seed=3)
    assert sum(p.group == "Vehicles" for p in changed.placed) in (19, 20)  # one may find no room
    assert [p for p in changed.placed if p.group == "Plants"] == [p for p in plain.placed if p.group == "Plants"]
    assert changed.road == plain.road


# -- the stage


@pytest.fixture(scope="module")
def stage_of(tmp_path_factory):
    """The stage of a recipe, composed once."""

    @functools.cache
    def composed(name):
        path = tmp_path_factory.mktemp("stages") / f"{name}.usda"
        compose(RECIPES / f"{name}.yaml", path, seed=4)
        return path

    return composed


@pytest.mark.parametrize("name", [n if n == "bridge" else pytest.param(n, marks=pytest.mark.slow) for n in ROADS])
def test_a_stage_is_whole_labelled_and_valid(stage_of, name):
    """Plain USD without a composition error or a missing file, under 10 MiB, every component labelled, every validator
    content.
    """
    path = stage_of(name)
    assert sum(layer.stat().st_size for layer in path.parent.glob(f"{name}.*")) < 10 << 20
    assert_whole(path, least=20)


def test_the_same_seed_gives_the_same_bytes(stage_of, tmp_path):
    """Two goes at one seed, and another seed."""
    for seed in (4, 5):
        compose(RECIPES / "bridge.yaml", tmp_path / str(seed) / "bridge.usda", seed=seed)
    first, again, other = (
        path.read_bytes()
        for path in (stage_of("bridge"), tmp_path / "4" / "bridge.usda", tmp_path / "5" / "bridge.usda")
    )
    assert first == again
    assert first != other
