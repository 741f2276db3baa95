"""Recipes: the same seed gives the same stage, nothing stands in anything else, and every mistake has its place."""

from __future__ import annotations

import functools
import json
import math
import tempfile
from pathlib import Path

import numpy as np
import pytest
import shapely
from pxr import Gf, Usd, UsdGeom, UsdUtils
from support import cli
from support.outlines import apart, outline

from synfog_usd.base.errors import RecipeError
from synfog_usd.world.compose import compose, draw, load
from synfog_usd.world.roads import crossing_actors, rules
from synfog_usd.world.roads.crossing import MAIN_HALF, WALL_X, ground_height

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = ROOT / "stages" / "recipes" / "crossroads.yaml"
SEEDS = range(10)
ROAD = "synfog: recipe/1\nworld: road\n"
RING = "synfog: recipe/1\nworld: roundabout\n"
LANES = "lane_section: [{lane: 3.5, way: -1}, {lane: 3.5, way: 1}]\n"
CROWDED = """
synfog: recipe/1
parked: {share: 1.0, bodies: van}
traffic: {count: 24, bodies: {choice: {bus: 1, van: 2, lorry: 1}}}
people: {count: 60}
"""


@functools.cache
def spec(seed, text=None):
    return draw(load(SHIPPED) if text is None else read(text), seed=seed)


def read(text):
    with tempfile.TemporaryDirectory() as made:
        path = Path(made) / "mine.yaml"
        path.write_text(text)
        return load(path)


def near(placed, reach=14.0):
    """Pairs of placements that could touch."""
    for i, one in enumerate(placed):
        for other in placed[i + 1 :]:
            if math.hypot(one.x - other.x, one.y - other.y) < reach:
                yield one, other


def group(world, name):
    return [p for p in world.placed if p.group == name]


@pytest.mark.parametrize("seed, text", [*((seed, None) for seed in range(5)), (0, CROWDED), (1, CROWDED)])
def test_nobody_stands_in_a_vehicle_a_wall_a_thing_or_another(seed, text):
    """10 cm between any two vehicles, mirrors included; a body is 40 cm wide, walls begin at WALL_X, and who is not on
    the pavement is on a zebra.
    """
    world = spec(seed, text)
    vehicles, people = group(world, "Vehicles"), [p for p in group(world, "People") if p.asset != "rider"]
    assert len(vehicles) > 30
    prints = {p.name: outline(p) for p in [*vehicles, *group(world, "Furniture")]}
    for one, other in near(vehicles):
        assert apart(prints[one.name], prints[other.name]) > 0.1, (one, other)
    solid = [
        p for p in world.placed if p.name in prints and p.asset != "street_lamp" and "traffic_light" not in p.asset
    ]
    for p in people:
        body = np.array([(p.x + a, p.y + b) for a, b in ((-0.2, -0.2), (0.2, -0.2), (0.2, 0.2), (-0.2, 0.2))])
        for other in solid:
            assert math.hypot(p.x - other.x, p.y - other.y) > 8.0 or apart(body, prints[other.name]) > 0.0, (p, other)
        assert abs(p.x) < WALL_X - 1.0 or abs(p.y) < 4.4
        assert abs(p.x) > MAIN_HALF + 1 or ground_height(p.x, p.y) == 0.0
    assert not list(near(people, 0.7))


def test_signals_crossers_and_traffic_agree():
    """Where the main street waits its signals are red and its zebras are walked on."""
    phases = set()
    for seed in SEEDS:
        world = spec(seed)
        main = {p.variants["signal"] for p in world.placed if "signal" in p.variants and abs(p.x) < 10}
        side = {p.variants["signal"] for p in world.placed if "signal" in p.variants and abs(p.x) > 10}
        assert (main, side) in (({"red"}, {"green"}), ({"green"}, {"red"}))
        phases.add(tuple(main))
        crossers = [p for p in group(world, "People") if ground_height(p.x, p.y) == 0.0 and p.asset != "rider"]
        assert crossers
        assert all((abs(p.y) > abs(p.x)) == (main == {"red"}) for p in crossers)
    assert len(phases) == 2


def test_the_same_seed_gives_the_same_bytes_and_another_gives_others(tmp_path):
    """Two goes at one seed, and another seed; the stage opens from outside the tree with nothing missing."""
    files = [tmp_path / name / "stage.usda" for name in "abc"]
    for path, seed in zip(files, (1, 1, 2), strict=True):
        compose(SHIPPED, path, seed=seed)
    one, two, other = ({layer.name: layer.read_bytes() for layer in path.parent.iterdir()} for path in files)
    assert one == two
    assert [name for name in one if one[name] == other[name]] == []
    stage = Usd.Stage.Open(str(files[0]))
    assert stage.GetCompositionErrors() == []
    assert UsdUtils.ComputeAllDependencies(str(files[0]))[2] == []
    camera = UsdGeom.Camera(stage.GetPrimAtPath("/World/Ego")).GetCamera(Usd.TimeCode.Default())
    assert 48 <= camera.GetFieldOfView(Gf.Camera.FOVHorizontal) <= 62
    assert stage.GetRootLayer().customLayerData["seed"] == "1"


MISTAKES = [
    ("parked: {share: 0.5}", "1:1", "synfog is missing"),
    ("synfog: recipe/2", "1:9", "recipe/1"),
    ("synfog: recipe/1\nparkd: {}", "2:1", "Did you mean 'parked'"),
    ("synfog: recipe/1\nparked:\n  shore: 1", "3:3", "Did you mean 'share'"),
    ("synfog: recipe/1\nparked: 3", "2:9", "takes a mapping"),
    ("synfog: recipe/1\nparked: {share: .nan}", "2:17", "outside 0 to 1"),
    ("synfog: recipe/1\nparked: {share: {uniform: [0.8, 0.2]}}", "2:27", "lower"),
    ("synfog: recipe/1\nparked: {share: {integer: [0, 1]}}", "2:17", "{uniform: [low, high]}"),
    ("synfog: recipe/1\ntraffic: {count: 2.5}", "2:18", "whole number"),
    ("synfog: recipe/1\ntraffic: {count: {integer: [1, 99]}}", "2:32", "outside 0 to 24"),
    ("synfog: recipe/1\ntraffic: {bodies: {choice: {saloon: 1, vann: 2}}}", "2:40", "Did you mean 'van'"),
    ("synfog: recipe/1\ntraffic: {bodies: {choice: {saloon: 0}}}", "2:37", "above 0"),
    ("synfog: recipe/1\nfog: [300, 5]", "2:12", "outside 10 to 20000"),
    ("synfog: [recipe", "1:16", "not valid YAML"),
    ("synfog: recipe/1\nsky: {}\nsky: {}", "3:1", "twice"),
    ("synfog: recipe/1\nworld: rode\n", "2:8", "Did you mean 'road'"),
    (ROAD, "1:1", "needs 'lane_section'"),
    (ROAD + "lane_section: [{lame: 3.5, way: 1}]", "3:17", "Did you mean 'lane'"),
    (ROAD + "lane_section: [{lane: 3.5}]", "3:16", "needs its way"),
    (ROAD + "lane_section: [{lane: 3.5, way: -1}]", "3:15", "in which the camera drives"),
    (ROAD + "lane_section: [{lane: 3.5, way: 1}, {lane: 3.5, way: -1}]", "3:15", "keeps to the right"),
    (ROAD + LANES + "road: {turn_deg: {normal: {mean: 0, deviation: 1, low: 5}}}", "4:27", "lacks high"),
    (ROAD + LANES + "traffic: {per_hour: {by_hour: [[25, 3]]}}", "4:33", "outside 0 to 24"),
    (ROAD + LANES + "rows: [{models: lime_tre}]", "4:17", "Did you mean 'lime_tree'"),
    (ROAD + LANES + "rows: [{side: left}]", "4:8", "needs 'models'"),
    (RING + "lane_section: []", "3:1", "no 'lane_section'"),
    (RING + "circle: {diameter_m: 12}", "3:22", "outside 26 to 60"),
    (RING + "rows: [{models: lime_tree, side: left}]", "3:28", "no 'side'"),
]


@pytest.mark.parametrize("text, place, words", MISTAKES)
def test_a_mistake_has_its_place(tmp_path, text, place, words):
    """File, line and column, what was found and what is allowed; nothing is written."""
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(RecipeError) as raised:
        compose(path, tmp_path / "s.usda", seed=0)
    assert str(raised.value).startswith(f"{path}:{place}: ")
    assert words in str(raised.value) and not (tmp_path / "s.usda").exists()


@pytest.mark.parametrize("text, words", [
    (ROAD + LANES + "rules: {in_view: 20}", "rules.in_view 20 cannot be met: 60 tries gave at most"),
    (ROAD + LANES + "traffic: {count: 0}", "rules.users 5 cannot be met: 60 tries gave at most 0"),
    (ROAD + LANES + "people: {count: 3}", "no pavement"),
    (ROAD + LANES + "camera: {lane: 1}", "camera.lane 1: the road has 1 lanes"),
    (ROAD + LANES + "road: {length_m: 150}\ncamera: {station_m: 120}", "less than 60 m"),
    (RING + "circle: {diameter_m: 26, ring_m: 9, apron_m: 4}", "circle.diameter_m 26 leaves no middle island"),
    (RING + "arms: {count: 5, apart_deg: 100}", "arms.apart_deg 100: 5 arms do not find it"),
    (RING + "arms: {count: 5, apart_deg: 40}\ncircle: {diameter_m: 26}", "degrees apart leave no arc"),
])  # fmt: skip
def test_a_rule_that_cannot_be_met_is_named(text, words):
    """After a bounded number of tries, in one line."""
    with pytest.raises(RecipeError) as raised:
        draw(read(text), seed=0)
    assert words in str(raised.value) and "\n" not in str(raised.value)


def test_the_largest_traffic_fits_and_too_dense_a_crowd_is_refused(monkeypatch):
    """The limits leave room for as many buses as cars; people who keep 20 m from each other are too many."""
    for way in ("waits", "goes"):
        full = spec(0, f"synfog: recipe/1\ntraffic: {{count: 24, bodies: bus, main_street: {way}}}\n")
        assert sum(p.asset == "bus" for p in full.placed) == 24
    monkeypatch.setattr(crossing_actors, "ROOM_ELSE_M", 20.0)
    with pytest.raises(RecipeError, match=r"crossroads.yaml: people.count \d+: no room for more than \d+"):
        draw(load(SHIPPED), seed=0)


def test_the_command_writes_a_stage_and_tells_what_stands_where(tmp_path):
    """--json is the whole world in numbers, and the stage holds that many cars."""
    done = cli.run("compose", SHIPPED, "--seed", "5", "-o", tmp_path / "s.usda", "--json")
    assert done.returncode == 0, done.stderr
    printed = json.loads(done.stdout)
    assert printed == json.loads(json.dumps(spec(5).plain()))
    stage = Usd.Stage.Open(str(tmp_path / "s.usda"))
    for name in ("Vehicles", "People"):
        assert len(stage.GetPrimAtPath(f"/World/{name}").GetChildren()) == sum(
            p["group"] == name for p in printed["placed"]
        )


@pytest.mark.parametrize("seed", [4, 13])
def test_nobody_at_the_crossing_stands_in_a_tree(seed):
    """Outlines of people keep apart from those of trunks, poles and benches."""
    placed = spec(seed).placed
    fixed = [shapely.Polygon(rules.footprint(p)) for p in placed if p.group in ("Plants", "Furniture")]
    people = [shapely.Polygon(rules.footprint(p)) for p in placed if p.group == "People"]
    assert len(people) > 15
    assert not len(shapely.STRtree(fixed).query(people, predicate="intersects").T)
