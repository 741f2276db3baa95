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
from pxr import Usd, UsdGeom, UsdUtils, UsdValidation
from scipy import special, stats
from support import sight
from support.outlines import apart, outline
from support.sight import model as shape

from synfog_usd.base.cityscapes import LABELS
from synfog_usd.base.errors import RecipeError
from synfog_usd.world import language
from synfog_usd.world.compose import compose, draw, load
from synfog_usd.world.roads import asphalt, horizon, land, markings, rules, surface, traffic
from synfog_usd.world.roads.lane_section import KERB_M, LaneSection
from synfog_usd.world.roads.network import Land, Road
from synfog_usd.world.roads.reference_line import ReferenceLine, bends
from synfog_usd.world.shapes import by_material
from synfog_usd.world.spec import Placement, View

ROOT = Path(__file__).resolve().parents[2]
RECIPES = ROOT / "stages" / "recipes"
ROADS = tuple(sorted(path.stem for path in RECIPES.glob("*.yaml") if "world: road" in path.read_text()))
QUICK = [(name, seed) for name in ROADS for seed in range(3)]
ALL = [(name, seed) for seed in range(-(-500 // len(ROADS))) for name in ROADS][:500]
USERS = {"person", "rider", "car", "truck", "bus", "motorcycle", "bicycle"}


@functools.cache
def read(name):
    path = RECIPES / f"{name}.yaml"
    return load(path)


@functools.cache
def spec(name, seed):
    return draw(read(name), seed=seed)


def from_text(tmp_path, text):
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    return load(path)


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
    centres = np.array([(p.x, p.y) for p, _ in bodies])
    radii = np.array([np.linalg.norm(prints - (p.x, p.y), axis=1).max() for p, prints in bodies])
    for i, (p, prints) in enumerate(bodies):
        close = np.flatnonzero(np.hypot(*(centres[i + 1 :] - centres[i]).T) < radii[i + 1 :] + radii[i]) + i + 1
        for j in close:
            assert apart(prints, bodies[j][1]) > 0.0, (name, seed, p, bodies[j][0])
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


def height_below(triangles, x, y):
    """Highest ground under a point [m]."""
    a, b, c = (triangles[:, i] for i in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    whole = np.abs(area) > 1e-12
    a, b, c, area = a[whole], b[whole], c[whole], area[whole]
    u = ((x - a[:, 0]) * (c[:, 1] - a[:, 1]) - (y - a[:, 1]) * (c[:, 0] - a[:, 0])) / area
    v = ((b[:, 0] - a[:, 0]) * (y - a[:, 1]) - (b[:, 1] - a[:, 1]) * (x - a[:, 0])) / area
    under = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9)
    assert under.any(), (x, y)
    return float((a[:, 2] + u * (b[:, 2] - a[:, 2]) + v * (c[:, 2] - a[:, 2]))[under].max())


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
    """Three bends end in the sum of their angles, and a slope that grows linearly lifts by half of it times the
    length.
    """
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
        assert height_below(triangles, x, y) == pytest.approx(
            float(road.ground(s, t)), abs=0.005 if on_road else 0.08
        ), (s, t)
    pavement = float(road.ground(100.0, road.lane_section.high - 1.0) - line.height(100.0))
    assert pavement == pytest.approx(KERB_M - crossfall * (3.2 + 2.0))


def test_a_carriageway_falls_from_its_crown_to_its_gutters():
    """2.5 %: from the line between the directions over all that is paved, and from both sides of an island; beyond a
    gutter everything lies lower by as much as the gutter does.
    """
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


def test_water_stands_at_gutters_and_not_at_the_high_side():
    """Beside an island, from which the road falls, there are puddles only where it is level across."""
    dual = [("lane", 3.5, -1), ("island", 2.0, 0), ("lane", 3.5, 1), ("pavement", 2.0, 0)]
    section = LaneSection.from_widths(dual)
    touching = {}
    for crossfall in (0.0, 0.025):
        road = Road(ReferenceLine(300.0), section, crossfall=crossfall)
        found = asphalt.puddles(road, asphalt.Asphalt(wet="wet"), seed=1)
        edges = [np.abs(part.points[:, 0]) for part in found]
        touching[crossfall] = [sum(np.isclose(t, kerb).any() for t in edges) for kerb in (1.0, 4.5)]
    assert min(touching[0.0]) >= 8
    assert touching[0.025][0] == 0 and touching[0.025][1] >= 8


def test_a_stripe_over_the_crown_bends_with_it():
    """Triangles of zebra stripes are 1 to 4 mm above the asphalt in their middles too."""
    bands = [("lane", 3.5, -1), ("lane", 3.0, 1)]
    road = Road(ReferenceLine(90.0), LaneSection.from_widths(bands), zebras=(40.0,), crossfall=0.025)
    triangles = mesh_triangles(road)
    stripes = [part for part in markings.markings(road) if abs(part.points[:, 1] - 40.0).max() < 2.0]
    middles = np.concatenate([part.points[part.faces].mean(axis=1) for part in stripes])
    assert len(middles) >= 12
    for x, y, z in middles:
        assert 0.001 < z - height_below(triangles, x, y) < 0.004


def test_wheels_touch_a_road_with_crossfall_as_the_stage_has_them(stage_of):
    """The corners of axles by the stage's own matrices, within 8 mm of the asphalt; cars lean by the crossfall to
    their gutter.
    """
    world = spec("rural", 4)
    assert world.road.crossfall == 0.025
    triangles = mesh_triangles(world.road, seed=world.scatter)
    stage = Usd.Stage.Open(str(stage_of("rural")))
    leaning = 0
    for p in world.placed:
        s, _ = world.road.reference_line.nearest(p.x, p.y)
        if p.group != "Vehicles" or shape(p.asset)[2] in ("bicycle", "rider"):
            continue
        if not 6 < s < world.road.reference_line.length - 6:
            continue
        matrix = UsdGeom.XformCache().GetLocalToWorldTransform(stage.GetPrimAtPath(f"/World/Vehicles/{p.name}"))
        for corner in itertools.product((-0.75, 0.75), (-1.3, 1.3)):
            x, y, z = matrix.Transform((*corner, 0.0))
            assert z == pytest.approx(height_below(triangles, x, y), abs=0.008), p
        leaning += math.isclose(matrix.TransformDir((1, 0, 0))[2], -0.025, abs_tol=0.002)
    assert leaning >= 2


def test_markings_lie_above_the_asphalt_and_within_the_carriageway():
    """Every corner of a marking is 1 to 4 mm above the triangles below, so that none flickers or floats."""
    world = spec("arterial", 1)
    triangles = mesh_triangles(world.road, seed=world.scatter)
    points = np.concatenate([part.points for part in markings.markings(world.road)])
    chosen = points[np.random.Generator(np.random.PCG64(2)).choice(len(points), 150, replace=False)]
    low, high = markings.zebra_span(world.road)
    for x, y, z in chosen:
        s, t = (float(v) for v in world.road.reference_line.nearest(x, y))
        assert low - 0.01 <= t <= high + 0.01
        if 1.0 < s < world.road.reference_line.length - 1.0 and all(
            abs(t - kerb) > 0.2 for kerb, _ in world.road.lane_section.kerbs()
        ):
            assert 0.001 < z - height_below(triangles, x, y) < 0.004


# -- what stands where


@pytest.mark.parametrize("name, seed", QUICK)
def test_nothing_overlaps_floats_or_goes_against_its_lane(name, seed):
    """A few seeds of every recipe; all 500 are among the long tests."""
    check(name, seed)


@pytest.mark.physics
def test_five_hundred_worlds_keep_the_rules_and_none_is_another():
    """500 draws over all recipes: every rule, and no two layouts alike."""
    layouts = {check(name, seed) for name, seed in ALL}
    assert len(layouts) == 500


def test_no_two_seeds_share_a_layout():
    """Among the quick ones; placements and lines both differ."""
    assert len({check(name, seed)[0] for name, seed in QUICK}) == len(QUICK)
    assert len({spec("rural", seed).road.reference_line.curvature for seed in range(4)}) == 4


def test_two_wheelers_lorries_and_houses_in_the_country_do_stand_on_the_roads():
    """The quick draws hold each of these models."""
    seen = {p.asset for name, seed in QUICK for p in spec(name, seed).placed}
    wanted = {
        "box_truck",
        "coach",
        "minibus",
        "jogger",
        "worker",
        "woman_pram",
        "cyclist",
        "motorcyclist",
        "farmhouse",
        "fence",
        "office_block",
        "sign_crossing",
    }
    assert wanted - seen == set()


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
                assert p.z + ahead * math.sin(pitch) == pytest.approx(height_below(triangles, x, y), abs=0.02), (
                    p,
                    ahead,
                )
        checked += 1
    assert checked >= 4


def test_vehicles_keep_the_distance_in_which_they_can_stop():
    """Bumper to bumper at least 1.5 m and 0.9 s at 54 km/h in 200 draws of a lane, and no order is lost."""
    least = 1.5 + 15.0 * 0.9
    rng = np.random.Generator(np.random.PCG64(3))
    for _ in range(200):
        lengths = list(rng.uniform(3.5, 12.0, int(rng.integers(0, 14))))
        places = list(traffic.queue(rng, (20.0, 220.0), lengths, least))
        for (a, length_a), (b, length_b) in itertools.pairwise(zip(places, lengths, strict=False)):
            assert b - a - (length_a + length_b) / 2 >= least - 1e-9
        assert all(20.0 + n / 2 - 1e-9 <= at <= 220.0 - n / 2 + 1e-9 for at, n in zip(places, lengths, strict=False))


def test_a_bus_hides_a_car_and_a_crest_hides_both():
    """Straight ahead a car is seen whole; with a bus before it, not at all; nor over a crest, nor out of the
    picture.
    """
    flat = Road(ReferenceLine(300.0), LaneSection.from_widths([("lane", 3.5, -1), ("lane", 3.5, 1)]))
    view = View(0.0, 0.0, 1.45, 90.0, 0.0)

    def seen(placed, road=flat):
        return rules.visible_shares(view, 55.0, placed, road, within_m=100.0)

    car = Placement("Vehicles", "Car", "saloon", 0.0, 60.0, 0.0, z=0.0)
    bus = Placement("Vehicles", "Bus", "bus", 0.0, 30.0, 0.0, z=0.0)
    assert seen([car]) == {"Car": 1.0}
    assert seen([car, bus])["Car"] == 0.0 and seen([car, bus])["Bus"] == 1.0
    assert seen([Placement("Vehicles", "Far", "saloon", 0.0, 120.0, 0.0, z=0.0)]) == {}
    assert seen([Placement("Vehicles", "Aside", "saloon", 40.0, 50.0, 0.0, z=0.0)]) == {}
    crest = Road(
        ReferenceLine(300.0, slope=((0.0, 0.0), (10.0, 0.12), (30.0, 0.12), (50.0, -0.12), (120.0, -0.12))),
        flat.lane_section,
    )
    low = Placement("Vehicles", "Car", "saloon", 0.0, 90.0, 0.0, z=float(crest.reference_line.height(90.0)))
    assert seen([low], crest)["Car"] == 0.0


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


def test_houses_in_the_country_stand_on_the_land():
    """No corner of a farmhouse or church hangs over the ground, and none is dug in by more than a man's height."""
    found = 0
    for seed in range(4):
        world = spec("rural", seed)
        for p in world.placed:
            if p.asset in ("farmhouse", "church"):
                corners = outline(p)
                ground = world.road.height(corners[:, 0], corners[:, 1]) - p.z
                assert ground.min() >= 0.0 and ground.max() < 1.7, (seed, p)
                found += 1
    assert found >= 2


def test_lamps_do_not_hang_in_trees():
    """Between every lamp and every trunk at least 4.5 m."""
    for name, seed in QUICK:
        lamps = [p for p in spec(name, seed).placed if p.asset.startswith(("street_lamp", "lamp_"))]
        trees = [p for p in spec(name, seed).placed if p.asset.endswith("_tree") or p.asset == "conifer"]
        assert all(math.hypot(a.x - b.x, a.y - b.y) > 4.5 for a in lamps for b in trees)


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


@pytest.mark.slow
def test_more_traffic_by_day_than_by_night():
    """40 seeds of the arterial road at 8 h and at 3 h: the mean number of vehicles on the lanes grows by at least
    half.
    """

    def mean(hour):
        found = load(RECIPES / "arterial.yaml", [f"traffic.hour={hour}", "rules.in_view=0"])
        return np.mean(
            [sum(bool(p.lit) and p.group == "Vehicles" for p in draw(found, seed=seed).placed) for seed in range(6)]
        )

    assert mean(8) > 1.5 * mean(3)


def test_the_command_line_overrides_the_recipe():
    """Twenty vehicles are twenty vehicles; what else was drawn stays as it was."""
    plain = spec("motorway", 3)
    changed = draw(load(RECIPES / "motorway.yaml", ["traffic.count=20"]), seed=3)
    assert sum(p.group == "Vehicles" for p in changed.placed) in (19, 20)  # one may find no room
    assert [p for p in changed.placed if p.group == "Plants"] == [p for p in plain.placed if p.group == "Plants"]
    assert changed.road == plain.road


HEAD = "synfog: recipe/1\nworld: road\n"
LANES = "lane_section: [{lane: 3.5, way: -1}, {lane: 3.5, way: 1}]\n"
MISTAKES = [
    ("synfog: recipe/1\nworld: rode\n", "2:8", "Did you mean 'road'"),
    (HEAD, "1:1", "needs 'lane_section'"),
    (HEAD + "lane_section: []", "3:15", "list of lanes"),
    (HEAD + "lane_section: [{lame: 3.5, way: 1}]", "3:17", "Did you mean 'lane'"),
    (HEAD + "lane_section: [{lane: 3.5}]", "3:16", "needs its way"),
    (HEAD + "lane_section: [{lane: 3.5, way: 2}]", "3:33", "takes 1"),
    (HEAD + "lane_section: [{lane: 3.5, way: -1}]", "3:15", "in which the camera drives"),
    (HEAD + "lane_section: [{lane: 3.5, way: 1}, {lane: 3.5, way: -1}]", "3:15", "keeps to the right"),
    (HEAD + "lane_section: [{lane: 300, way: 1}]", "3:23", "outside 0.3 to 30"),
    (HEAD + LANES + "road: {length_m: 10000}", "4:18", "outside 150 to 1500"),
    (HEAD + LANES + "road: {turn_deg: {normal: {mean: 0, deviation: 1, low: 5}}}", "4:27", "lacks high"),
    (
        HEAD + LANES + "road: {turn_deg: {normal: {mean: 0, deviation: 1, low: 50, high: 60}}}",
        "4:27",
        "has nothing from 50 to 60",
    ),
    (HEAD + LANES + "traffic: {per_hour: {by_hour: [[25, 3]]}}", "4:33", "outside 0 to 24"),
    (HEAD + LANES + "traffic: {bodies: tank}", "4:19", "takes"),
    (HEAD + LANES + "rows: [{models: lime_tre}]", "4:17", "Did you mean 'lime_tree'"),
    (HEAD + LANES + "rows: [{models: lime_tree, wher: kerb}]", "4:28", "no 'wher'"),
    (HEAD + LANES + "rows: [{side: left}]", "4:8", "needs 'models'"),
]


@pytest.mark.parametrize("text, place, words", MISTAKES)
def test_a_mistake_has_its_place(tmp_path, text, place, words):
    """File, line and column, what was found and what is allowed."""
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(RecipeError) as raised:
        compose(path, tmp_path / "s.usda", seed=0)
    assert str(raised.value).startswith(f"{path}:{place}: ")
    assert words in str(raised.value)
    assert not (tmp_path / "s.usda").exists()


@pytest.mark.parametrize(
    "text, words",
    [
        ("rules: {in_view: 20}\n", "rules.in_view 20 cannot be met: 60 tries gave at most"),
        ("traffic: {count: 0}\n", "rules.users 5 cannot be met: 60 tries gave at most 0"),
        ("people: {count: 3}\n", "no pavement"),
        ("camera: {lane: 1}\n", "camera.lane 1: the road has 1 lanes"),
        ("road: {length_m: 150}\ncamera: {station_m: 120}\n", "less than 60 m"),
    ],
)
def test_a_rule_that_cannot_be_met_is_named(tmp_path, text, words):
    """After a bounded number of tries, in one line."""
    with pytest.raises(RecipeError) as raised:
        draw(from_text(tmp_path, HEAD + LANES + text), seed=0)
    assert words in str(raised.value) and "\n" not in str(raised.value)


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


@pytest.mark.parametrize(
    "name", [n if n in ("bridge", "rural", "tunnel") else pytest.param(n, marks=pytest.mark.slow) for n in ROADS]
)
def test_a_stage_is_whole_labelled_and_valid(stage_of, name):
    """Plain USD without a composition error or a missing file, under 10 MiB, every component labelled, every validator
    content.
    """
    path = stage_of(name)
    assert sum(layer.stat().st_size for layer in path.parent.glob(f"{name}.*")) < 10 << 20
    stage = Usd.Stage.Open(str(path))
    assert stage.GetCompositionErrors() == []
    assert UsdUtils.ComputeAllDependencies(str(path))[2] == []
    components = [
        prim
        for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies())
        if Usd.ModelAPI(prim).GetKind() == "component"
    ]
    assert len(components) > 20
    for prim in components:
        assert next(iter(prim.GetAttribute("semantics:labels:cityscapes").Get())) in LABELS, prim.GetPath()
    assert sum(prim.IsInstance() for prim in components) > 8
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    for fog, lighting in (("mor300", "sky"), ("clear", "active")):
        stage.SetEditTarget(stage.GetSessionLayer())
        sets = stage.GetDefaultPrim().GetVariantSets()
        sets.GetVariantSet("fog").SetVariantSelection(fog)
        sets.GetVariantSet("lighting").SetVariantSelection(lighting)
        assert [e.GetMessage() for e in UsdValidation.ValidationContext(validators).Validate(stage)] == []


def test_the_same_seed_gives_the_same_bytes(stage_of, tmp_path):
    """Two goes at one seed, and another seed; all layers."""
    for seed in (4, 5):
        compose(RECIPES / "bridge.yaml", tmp_path / str(seed) / "bridge.usda", seed=seed)
    first, again, other = (
        {layer.name: layer.read_bytes() for layer in folder.glob("bridge.*")}
        for folder in (stage_of("bridge").parent, tmp_path / "4", tmp_path / "5")
    )
    assert len(first) == 6
    assert first == again
    assert first != other


def test_every_mesh_has_texture_coordinates_where_its_material_has_a_texture():
    """No part of any road shows one texel."""
    from synfog_usd.world.materials import PALETTE
    from synfog_usd.world.roads import stage

    for name in ROADS:
        for thing in stage.built(spec(name, 0)):
            for material, part in by_material(thing.parts).items():
                look = stage.LOOKS.get(material) or PALETTE[material]
                assert not look.texture or (part.uv is not None and np.ptp(part.uv) > 0), (name, thing.name, material)
