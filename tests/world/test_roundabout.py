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
from pxr import Usd, UsdUtils, UsdValidation
from support import outlines, sight
from support.outlines import apart
from support.sight import model as shape

from synfog_usd.base.cityscapes import LABELS
from synfog_usd.base.errors import RecipeError
from synfog_usd.world.compose import compose, draw, load
from synfog_usd.world.roads import horizon, roundabout_markings, roundabout_surface
from synfog_usd.world.roads.lane_section import KERB_M
from synfog_usd.world.roads.network import Land
from synfog_usd.world.roads.reference_line import ReferenceLine
from synfog_usd.world.roads.roundabout import ZEBRA_HALF_M, roundabout
from synfog_usd.world.shapes import by_material

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
    return roundabout(
        lines,
        radius=radius,
        ring_m=6.0,
        apron=apron,
        mound=1.0,
        lane_m=3.4,
        half_island=1.6,
        pavement=2.5,
        zebra_m=8.0,
        corner_m=corner_m,
        land=Land(hills, 1),
    )


def ground_triangles(junction, beside=True):
    """(N, 3, 3) triangles of a roundabout's ground."""
    parts = itertools.chain(*roundabout_surface.surface(junction).values())
    beyond = horizon.Horizon(3, "country", junction.height, lambda x, y: junction.across(x, y)[0])
    land = roundabout_surface.ground(junction, beyond) if beside else []
    parts = [*(part for part in parts if part.material in NEW), *land]
    return np.concatenate([part.points[part.faces] for part in parts])


def covering(triangles, x, y):
    """Heights [m] of all triangles over or under a place, sorted."""
    a, b, c = (triangles[:, i] for i in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    whole = np.abs(area) > 1e-9
    a, b, c, area = a[whole], b[whole], c[whole], area[whole]
    u = ((x - a[:, 0]) * (c[:, 1] - a[:, 1]) - (y - a[:, 1]) * (c[:, 0] - a[:, 0])) / area
    v = ((b[:, 0] - a[:, 0]) * (y - a[:, 1]) - (b[:, 1] - a[:, 1]) * (x - a[:, 0])) / area
    under = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9)
    return np.sort((a[:, 2] + u * (b[:, 2] - a[:, 2]) + v * (c[:, 2] - a[:, 2]))[under])


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


def test_arms_that_stand_close_get_the_arc_that_just_fits():
    """Between arms 70 degrees apart both arcs of the greatest radius meet on the line that halves the angle, within the
    half degree kept free.
    """
    junction = plain(corner_m=25.0, headings=(180.0, 250.0, 5.0, 95.0))
    r = junction.corners[0]
    assert r < 25.0
    touch = math.degrees(
        math.atan2(junction.half_island + junction.lane_width + r, junction.tangent(r))
    )  # of the arc's centre, seen from the middle
    assert 35.0 - 1.5 < touch < 35.0


@pytest.mark.parametrize("radius, apron, hills", [(14.0, 0.0, 0.0), (18.0, 1.5, 4.0), (22.5, 2.5, 0.0)])
def test_the_meshes_are_where_the_ground_is_said_to_be(radius, apron, hills):
    """The highest triangle at 250 places from the mound to the land is `height` within 6 mm, on grass within 3 cm, and
    there is one everywhere.
    """
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
        found = covering(triangles, x[i], y[i])
        assert len(found), (x[i], y[i])
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


def test_no_two_sheets_of_the_ground_lie_in_one_plane():
    """At 400 places no two triangles cover the same place within a centimetre of height: nothing flickers."""
    junction = plain()
    triangles = ground_triangles(junction)
    rng = np.random.Generator(np.random.PCG64(4))
    for x, y in rng.uniform(-55, 55, (400, 2)):
        found = covering(triangles, x, y)
        assert len(found) >= 1
        assert len(found) < 2 or np.diff(found).min() > 0.01, (x, y, found)


def test_every_face_of_the_ground_looks_up():
    """No triangle of asphalt, slabs, setts or grass is seen from below."""
    for seed in QUICK[:2]:
        junction = spec(seed).road
        triangles = ground_triangles(junction)
        normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        assert normal[:, 2].min() > -1e-9


def test_lanes_join_where_the_disc_ends():
    """Every corner of an arm's first row is a corner of the disc: no gap between the sheets."""
    junction = plain()
    road = roundabout_surface.surface(junction)["road"]
    disc = {tuple(p) for p in np.round(next(part for part in road if part.material == "asphalt").points[:, :2], 4)}
    far = junction.radius + 16.0
    first = [
        p
        for part in road
        if part.material == "asphalt_lane"
        for p in part.points[:, :2]
        if abs(np.hypot(*p) - far) < 1e-6
    ]
    assert len(first) == 4 * len(junction.arms)
    assert all(tuple(p) in disc for p in np.round(first, 4))


def test_markings_lie_on_the_carriageway():
    """Every corner of paint is 3 mm over asphalt, between the kerbs and off the islands, and patches, seams and covers
    are below it, for four draws.
    """
    for seed in range(4):
        junction = spec(seed).road
        for kind in roundabout_markings.GIVE_WAY:
            points = np.concatenate([part.points for part in roundabout_markings.drawn(junction, give_way=kind)])
            inside = np.hypot(*points[:, :2].T) < 75.0
            u, _ = junction.across(points[:, 0], points[:, 1])
            assert u.max() < 0.0, seed
            assert np.abs(junction.height(points[:, 0], points[:, 1])[inside]).max() == 0.0, seed
            np.testing.assert_allclose(points[:, 2], roundabout_markings.THICK_M, atol=1e-9)
        worn = np.concatenate([part.points for part in roundabout_markings.worn(junction, seed=seed)])
        u, _ = junction.across(worn[:, 0], worn[:, 1])
        assert u.max() < 0.0 and np.hypot(*worn[:, :2].T).min() > junction.inner
        assert worn[:, 2].min() > 0.001 and worn[:, 2].max() < roundabout_markings.THICK_M


def test_kerbs_are_low_where_people_cross():
    """At both ends of every zebra the kerb is 2 to 3 cm high, elsewhere 12 cm; the pavement rises behind it at less
    than 1 in 8.
    """
    junction = plain()
    line = junction.outline
    for arm, road in enumerate(junction.arms):
        at = (line.arm == arm) & (np.abs(line.station - road.zebras[0]) < ZEBRA_HALF_M)
        assert at.sum() >= 8
        assert np.all((line.kerb[at] > 0.02) & (line.kerb[at] < 0.03))
        for side in (-1, 1):
            t = side * (float(junction.edge(arm, side, road.zebras[0])) + np.array([0.16, 0.6, 1.0, 1.5]))
            z = junction.height(*road.reference_line.place(road.zebras[0], t))
            assert np.all(np.diff(z) / np.diff(np.abs(t)) < 1 / 8) and z[-1] == pytest.approx(KERB_M)
    assert np.isclose(line.kerb, KERB_M).mean() > 0.8


# -- what stands where


def check(seed):
    """Everything that must hold of one draw; gives its layout for comparison."""
    world = spec(seed)
    junction = world.road
    bodies = [(p, outline(p)) for p in world.placed]
    centres = np.array([(p.x, p.y) for p, _ in bodies])
    radii = np.array([np.linalg.norm(prints - (p.x, p.y), axis=1).max() for p, prints in bodies])
    for i, (p, prints) in enumerate(bodies):
        close = np.flatnonzero(np.hypot(*(centres[i + 1 :] - centres[i]).T) < radii[i + 1 :] + radii[i]) + i + 1
        for j in close:
            assert apart(prints, bodies[j][1]) > 0.0, (seed, p, bodies[j][0])
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


@pytest.mark.parametrize("seed", QUICK)
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


def test_the_camera_looks_at_the_circle_from_its_lane():
    """15 to 45 m before the circle, right of the arm's line, facing inwards within 8 degrees."""
    for seed in range(4):
        world = spec(seed)
        away = math.hypot(world.view.x, world.view.y) - world.road.radius
        assert 14.9 < away < 45.5
        assert (
            world.view.x > 1.0 and world.view.y < 0.0
        )  # on the arm towards -Y, whose entry is on the right of who goes to +Y
        assert abs(world.view.heading) < 8.0


def test_every_arm_has_its_signs_facing_who_arrives():
    """Give way within 5 m of the circle and chevrons on the island, both turned to the arm, give way to the right of
    the lane.
    """
    for seed in QUICK:
        world = spec(seed)
        for road in world.road.arms:
            facing = road.reference_line.origin[2]
            turned = [p for p in world.placed if abs((p.heading - facing + 180) % 360 - 180) < 1.0]
            ways = [p for p in turned if p.asset == "sign_give_way"]
            assert len(ways) == 1
            s, t = (float(v) for v in road.reference_line.nearest(ways[0].x, ways[0].y))
            assert 0.0 < s - world.road.radius < 5.0 and t < -world.road.lane_width
            boards = [p for p in turned if p.asset == "sign_chevron"]
            assert len(boards) == 1 and math.hypot(boards[0].x, boards[0].y) < world.road.island


def test_lamps_do_not_hang_in_trees():
    """Between every lamp and every trunk at least 4.5 m."""
    for seed in QUICK:
        lamps = [p for p in spec(seed).placed if p.asset.startswith(("street_lamp", "lamp_"))]
        trees = [p for p in spec(seed).placed if p.asset.endswith("_tree") or p.asset == "conifer"]
        assert len(lamps) >= 8 and len(trees) >= 8
        assert all(math.hypot(a.x - b.x, a.y - b.y) > 4.5 for a in lamps for b in trees)


def test_some_walk_in_company():
    """Where all who can walk in company do, somebody has a neighbour within a metre who looks the same way; where
    nobody does, fewer have.
    """

    def pairs(company):
        found = load(RECIPE, [f"people.company={company}", "people.count=14", "people.crossing_share=0"])
        people = [p for p in draw(found, seed=1).placed if shape(p.asset)[2] == "person"]
        assert len(people) == 14
        near = [(a, b) for a, b in itertools.combinations(people, 2) if math.hypot(a.x - b.x, a.y - b.y) < 1.0]
        return sum(abs((a.heading - b.heading + 180) % 360 - 180) < 8 for a, b in near)

    assert pairs(1) >= 3 > pairs(0)


# -- the language

HEAD = "synfog: recipe/1\nworld: roundabout\n"
MISTAKES = [
    ("synfog: recipe/1\nworld: roundabuot\n", "2:8", "Did you mean 'roundabout'"),
    (HEAD + "lane_section: []", "3:1", "no 'lane_section'"),
    (HEAD + "circle: {diametre_m: 30}", "3:10", "Did you mean 'diameter_m'"),
    (HEAD + "circle: {diameter_m: 12}", "3:22", "outside 26 to 60"),
    (HEAD + "circle: {give_way: tooth}", "3:20", "Did you mean 'teeth'"),
    (HEAD + "arms: {count: 6}", "3:15", "outside 3 to 5"),
    (HEAD + "arms: {count: {integer: [5, 3]}}", "3:25", "the first end is the lower one"),
    (HEAD + "camera: {station_m: 30}", "3:10", "no 'station_m'"),
    (HEAD + "rows: [{models: lime_tree, side: left}]", "3:28", "no 'side'"),
    (HEAD + "rows: [{models: lime_tre}]", "3:17", "Did you mean 'lime_tree'"),
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


@pytest.mark.parametrize(
    "change, words",
    [
        ("circle: {diameter_m: 26, ring_m: 9, apron_m: 4}", "circle.diameter_m 26 leaves no middle island"),
        ("arms: {count: 5, apart_deg: 100}", "arms.apart_deg 100: 5 arms do not find it"),
        ("arms: {count: 5, apart_deg: 40}\ncircle: {diameter_m: 26}", "degrees apart leave no arc"),
        ("traffic: {count: 0, ring: 0}", "rules.users 5 cannot be met: 60 tries gave at most 0"),
        ("traffic: {count: 4}\nrules: {in_view: 20}", "rules.in_view 20 cannot be met: 60 tries gave at most"),
        ("people: {count: 80}\narms: {length_m: 110}\ncamera: {before_m: 80}", "less than 30 m of the arm's 110 m"),
    ],
)
def test_a_rule_that_cannot_be_met_is_named(tmp_path, change, words):
    """After a bounded number of tries, in one line."""
    path = tmp_path / "mine.yaml"
    path.write_text(HEAD + change + "\n")
    with pytest.raises(RecipeError) as raised:
        draw(load(path), seed=0)
    assert words in str(raised.value) and "\n" not in str(raised.value)


def test_the_command_line_overrides_the_recipe():
    """Five arms are five; another flow leaves circle, arms and plants as they were."""

    def drawn(*changes):
        return draw(load(RECIPE, changes), seed=1)

    assert len(drawn("arms.count=5").road.arms) == 5
    fuller = drawn("traffic.per_hour=900")
    assert fuller.road == spec(1).road
    assert [p for p in fuller.placed if p.group == "Plants"] == [p for p in spec(1).placed if p.group == "Plants"]
    assert sum(p.group == "Vehicles" for p in fuller.placed) > sum(p.group == "Vehicles" for p in spec(1).placed)


# -- the stage


@pytest.fixture(scope="module")
def stages(tmp_path_factory):
    """Two goes at one seed."""
    folder = tmp_path_factory.mktemp("stages")
    for name in ("first", "again"):
        compose(RECIPE, folder / name / "stage.usda", seed=2)
    return folder


def test_the_same_seed_gives_the_same_bytes(stages):
    """And another seed another layout."""
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
    stage = Usd.Stage.Open(str(path))
    assert stage.GetCompositionErrors() == []
    assert UsdUtils.ComputeAllDependencies(str(path))[2] == []
    components = [
        prim
        for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies())
        if Usd.ModelAPI(prim).GetKind() == "component"
    ]
    assert len(components) > 50
    for prim in components:
        assert next(iter(prim.GetAttribute("semantics:labels:cityscapes").Get())) in LABELS, prim.GetPath()
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    for fog, lighting in (("mor300", "sky"), ("clear", "active")):
        stage.SetEditTarget(stage.GetSessionLayer())
        sets = stage.GetDefaultPrim().GetVariantSets()
        sets.GetVariantSet("fog").SetVariantSelection(fog)
        sets.GetVariantSet("lighting").SetVariantSelection(lighting)
        assert [e.GetMessage() for e in UsdValidation.ValidationContext(validators).Validate(stage)] == []


def test_every_mesh_has_texture_coordinates_where_its_material_has_a_texture():
    """No part shows one texel, and every material is known."""
    from synfog_usd.world.materials import PALETTE
    from synfog_usd.world.roads import stage

    for seed in QUICK[:2]:
        for thing in stage.built(spec(seed)):
            for material, part in by_material(thing.parts).items():
                look = stage.LOOKS.get(material) or PALETTE[material]
                assert not look.texture or (part.uv is not None and np.ptp(part.uv) > 0), (thing.name, material)


def test_signs_show_their_faces_to_who_arrives():
    """Every blue face of the built signs looks out along its arm, and the white arrow on it too."""
    junction = plain()
    for thing in roundabout_markings.signs(junction):
        heading = math.radians(junction.arms[int(thing.name[-1]) - 1].reference_line.origin[2])
        out = np.array([-math.sin(heading), math.cos(heading), 0.0])
        for part in thing.parts:
            if part.material in ("sign_blue", "sign_white"):
                a, b, c = (part.points[part.faces[:, i]] for i in range(3))
                normal = np.cross(b - a, c - a)
                assert np.all(normal @ out > 0.99 * np.linalg.norm(normal, axis=1)), (thing.name, part.material)
