"""Recipes: the same seed gives the same stage, nothing stands in anything else, and every mistake has its place."""

from __future__ import annotations

import functools
import json
import math
import tempfile
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdUtils
from support import cli

from synfog_usd.base.errors import RecipeError
from synfog_usd.cli.main import main
from synfog_usd.world.compose import asset_folder, compose, draw, load
from synfog_usd.world.language import Distribution
from synfog_usd.world.roads import crossing_actors
from synfog_usd.world.roads.crossing import MAIN_HALF, WALL_X, ground_height

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = ROOT / "stages" / "recipes" / "crossroads.yaml"
SEEDS = range(10)
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


@functools.cache
def outline(asset):
    """(low, high) of a component on the ground in its own axes [m]."""
    stage = Usd.Stage.Open(str(ROOT / "assets" / "models" / asset / f"{asset}.usda"))
    bound = (
        UsdGeom.BBoxCache(Usd.TimeCode.Default(), ["default", "render"])
        .ComputeWorldBound(stage.GetDefaultPrim())
        .ComputeAlignedRange()
    )
    return np.array(bound.GetMin())[:2], np.array(bound.GetMax())[:2]


def footprint(p):
    """(4, 2) corners of a placement on the ground."""
    (x0, y0), (x1, y1) = outline(p.asset)
    corners = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
    c, s = math.cos(math.radians(p.heading)), math.sin(math.radians(p.heading))
    return corners @ np.array([[c, s], [-s, c]]) + (p.x, p.y)


def apart(a, b):
    """Largest gap [m] between two rectangles along their sides; negative where they overlap."""
    gaps = []
    for corners in (a, b):
        for edge in (corners[1] - corners[0], corners[3] - corners[0]):
            axis = edge / np.linalg.norm(edge)
            p, q = a @ axis, b @ axis
            gaps.append(max(q.min() - p.max(), p.min() - q.max()))
    return max(gaps)


def near(placed, reach=14.0):
    """Pairs of placements that could touch."""
    for i, one in enumerate(placed):
        for other in placed[i + 1 :]:
            if math.hypot(one.x - other.x, one.y - other.y) < reach:
                yield one, other


def group(world, name):
    return [p for p in world.placed if p.group == name]


WORLDS = [*((seed, None) for seed in SEEDS), *((seed, CROWDED) for seed in range(3))]


@pytest.mark.parametrize("seed, text", WORLDS)
def test_vehicles_do_not_overlap(seed, text):
    """Ten seeds of the shipped recipe and three of the fullest streets: 10 cm between any two, mirrors included."""
    vehicles = group(spec(seed, text), "Vehicles")
    assert len(vehicles) > 30
    prints = {p.name: footprint(p) for p in vehicles}
    for one, other in near(vehicles):
        assert apart(prints[one.name], prints[other.name]) > 0.1, (one, other)


@pytest.mark.parametrize("seed, text", WORLDS)
def test_nobody_stands_in_a_vehicle_a_wall_a_thing_or_another(seed, text):
    """A body is 40 cm wide; walls begin at WALL_X, and who is not on the pavement is on a zebra."""
    world = spec(seed, text)
    people = [p for p in group(world, "People") if p.asset != "rider"]
    solid = [
        (p, footprint(p))
        for p in [*group(world, "Vehicles"), *group(world, "Furniture")]
        if p.asset != "street_lamp" and "traffic_light" not in p.asset
    ]
    for p in people:
        body = np.array([(p.x + a, p.y + b) for a, b in ((-0.2, -0.2), (0.2, -0.2), (0.2, 0.2), (-0.2, 0.2))])
        for other, print_ in solid:
            assert math.hypot(p.x - other.x, p.y - other.y) > 8.0 or apart(body, print_) > 0.0, (p, other)
        assert abs(p.x) < WALL_X - 1.0 or abs(p.y) < 4.4
        assert abs(p.x) > MAIN_HALF + 1 or ground_height(p.x, p.y) == 0.0
    for one, other in near(people, 0.7):
        raise AssertionError((one, other))


def test_camera_sees_down_its_own_lane():
    """No car within the lane ahead before the crossing, whatever the seed."""
    for seed in SEEDS:
        world = spec(seed)
        ahead = [
            p
            for p in group(world, "Vehicles")
            if abs(p.x - world.view.x) < 2.0 and -42.0 < p.y < -12.0 and p.asset != "bicycle"
        ]
        assert ahead == []


def test_signals_crossers_and_traffic_agree():
    """Where the main street waits its signals are red and its zebras are walked on; where it goes, the side
    street's.
    """
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


def test_what_is_drawn_lies_where_the_recipe_says():
    """Numbers over ten seeds: within their ends, and not always the same."""
    for name, own, low, high in (("day", "overcast", 3000, 8000), ("dusk", "dusk", 3, 8)):
        domes = [getattr(spec(seed), name) for seed in SEEDS]
        assert len({dome.sky for dome in domes}) > 3
        assert all(dome.gain == 1.0 for dome in domes if dome.sky != own)
        values = [
            getattr(spec(seed, f"synfog: recipe/1\nsky: {{{own}_nits: {{uniform: [{low}, {high}]}}}}\n"), name).gain
            for seed in SEEDS
        ]
        assert all(low <= value <= high for value in values) and len(set(values)) == len(values)
    assert all(
        list(spec(seed).fog)[:3] == ["clear", "mor600", "mor300"] and 100 <= list(spec(seed).fog.values())[3] <= 200
        for seed in SEEDS
    )
    assert {sum(p.asset == "rider" for p in spec(seed).placed) for seed in SEEDS} == {0, 1}


def test_weights_are_kept():
    """4,000 draws of weights 3 : 1, within five standard deviations of a binomial."""
    drawn = Distribution("choice", ("a", "b"), (3.0, 1.0))
    rng = np.random.Generator(np.random.PCG64(0))
    share = np.mean([drawn(rng) == "a" for _ in range(4000)])
    assert share == pytest.approx(0.75, abs=5 * math.sqrt(0.75 * 0.25 / 4000))
    assert drawn(rng, among=("c", "d")) == "c"


def test_one_parameter_leaves_the_others_as_they_were():
    """More people move no car, and another sky moves nobody."""
    one, two = (
        spec(3, f"synfog: recipe/1\npeople: {{count: {count}}}\nsky: {{dusk_nits: {count}}}\n") for count in (10, 20)
    )
    assert group(one, "Vehicles") == group(two, "Vehicles")
    assert group(one, "People")[:10] == group(two, "People")[:10]


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


@pytest.mark.parametrize(
    "folder, found",
    [
        ("/tree/stages/drawn", "../../assets"),
        ("/tree", "./assets"),
        ("/elsewhere", "/tree/assets"),
        ("/treehouse", "/tree/assets"),
    ],
)
def test_references_are_relative_within_the_tree_and_absolute_elsewhere(folder, found):
    """The folder that holds the assets can move as a whole; a stage outside of it still opens."""
    assert asset_folder(Path(folder), Path("/tree/assets")) == found


MISTAKES = [
    ("parked: {share: 0.5}", "1:1", "synfog is missing"),
    ("synfog: recipe/2", "1:9", "recipe/1"),
    ("synfog: recipe/1\nparkd: {}", "2:1", "Did you mean 'parked'"),
    ("synfog: recipe/1\nparked:\n  shore: 1", "3:3", "Did you mean 'share'"),
    ("synfog: recipe/1\nparked: 3", "2:9", "takes a mapping"),
    ("synfog: recipe/1\nparked: {share: 1.5}", "2:17", "outside 0 to 1"),
    ("synfog: recipe/1\nparked: {share: many}", "2:17", "{uniform: [low, high]}"),
    ("synfog: recipe/1\nparked: {share: .nan}", "2:17", "outside 0 to 1"),
    ("synfog: recipe/1\nparked: {share: {uniform: [0.8, 0.2]}}", "2:27", "lower"),
    ("synfog: recipe/1\nparked: {share: {uniform: [0.8]}}", "2:17", "{uniform: [low, high]}"),
    ("synfog: recipe/1\nparked: {share: {integer: [0, 1]}}", "2:17", "{uniform: [low, high]}"),
    ("synfog: recipe/1\nparked: {share: {}}", "2:17", "{uniform: [low, high]}"),
    ("synfog: recipe/1\ntraffic: {count: 2.5}", "2:18", "whole number"),
    ("synfog: recipe/1\ntraffic: {count: true}", "2:18", "whole number"),
    ("synfog: recipe/1\ntraffic: {count: {integer: [1, 99]}}", "2:32", "outside 0 to 24"),
    ("synfog: recipe/1\ntraffic: {bodies: tank}", "2:19", "hatchback"),
    ("synfog: recipe/1\ntraffic: {bodies: {choice: {saloon: 1, vann: 2}}}", "2:40", "Did you mean 'van'"),
    ("synfog: recipe/1\ntraffic: {bodies: {choice: {saloon: 0}}}", "2:37", "above 0"),
    ("synfog: recipe/1\ntraffic: {bodies: {choice: [saloon]}}", "2:28", "weight"),
    ("synfog: recipe/1\ntraffic: {bodies: {one: saloon}}", "2:19", "{choice: {name: weight, ...}}"),
    ("synfog: recipe/1\ntraffic: {bodies: [saloon]}", "2:19", "hatchback"),
    ("synfog: recipe/1\nfog: 300", "2:6", "list"),
    ("synfog: recipe/1\nfog: []", "2:6", "list"),
    ("synfog: recipe/1\nfog: [300, 5]", "2:12", "outside 10 to 20000"),
    ("synfog: [recipe", "1:16", "not valid YAML"),
    ("synfog: recipe/1\nsky: {}\nsky: {}", "3:1", "twice"),
]


@pytest.mark.parametrize("text, place, words", MISTAKES)
def test_a_mistake_has_its_place(tmp_path, text, place, words):
    """File, line and column, what was found and what is allowed."""
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(RecipeError) as raised:
        load(path)
    assert str(raised.value).startswith(f"{path}:{place}: ")
    assert words in str(raised.value)


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


@pytest.mark.parametrize("path, out, words", [("none.yaml", "s.usda", "none.yaml"), (SHIPPED, "s.txt", "s.txt")])
def test_the_command_refuses_in_one_line(tmp_path, capsys, path, out, words):
    """Exit code 2, and nothing written."""
    with pytest.raises(SystemExit) as left:
        main(["compose", str(tmp_path / path), "--seed", "1", "-o", str(tmp_path / out)])
    assert left.value.code == 2
    told = capsys.readouterr().err
    assert words in told and len(told.splitlines()) == 1
    assert not (tmp_path / out).exists()
