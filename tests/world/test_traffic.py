"""Streets that move: the law of following, and what holds in every frame of every recipe."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from pxr import Sdf, Usd, UsdGeom

from synfog_usd.base.errors import RecipeError
from synfog_usd.world import compose, library
from synfog_usd.world.roads import rules
from synfog_usd.world.traffic import idm
from synfog_usd.world.traffic.follow import LOOK_S, STEP_S, Street, Vehicle, drive
from synfog_usd.world.traffic.motion import ground
from synfog_usd.world.traffic.paths import Path as Line
from synfog_usd.world.traffic.paths import Route, StopLine, rounded
from synfog_usd.world.traffic.walk import SPEED_M_S, Way
from synfog_usd.world.traffic.wheels import wheels_of

G = 9.81
FPS = 10.0
DRIVER = idm.Driver()


def test_a_platoon_keeps_the_gap_of_the_equilibrium():
    """s_e(v) = (s0 + v T) / sqrt(1 - (v / v0)^4): nobody there speeds up or brakes (Treiber 2000, equation 4)."""
    v, v0 = np.array([1.0, 8.0, 13.0, 29.0]), 30.0
    gap = (DRIVER.standstill_m + v * DRIVER.headway_s) / (1.0 - (v / v0) ** 4) ** 0.5
    np.testing.assert_allclose(idm.acceleration(DRIVER, v, v0, gap, v), 0.0, atol=1e-12)
    assert (idm.acceleration(DRIVER, v, v0, 0.9 * gap, v) < 0.0).all()
    assert (idm.acceleration(DRIVER, v, v0, 1.1 * gap, v) > 0.0).all()


def street(vehicles, route, seconds, people=None):
    steps = round((seconds + LOOK_S) / STEP_S) + 5
    return Street(
        [route],
        vehicles,
        np.zeros((steps, 0, 2)) if people is None else people,
        {0: (np.zeros(0), np.zeros(0))},
        DRIVER,
        np.ones((steps, 1), dtype=bool),
    )


def car(s, v, v0=14.0):
    return Vehicle(0, s, 0.0, 0.0, 2.2, 2.2, 1.8, v, v0)


def straight(**more):
    return Route(Line(rounded(np.array([(0.0, 0.0), (0.0, 600.0)]), 0.0), 3.5), **more)


def test_a_platoon_stops_at_a_red_signal_without_touching():
    """Eight cars at 14 m/s and 1.2 s stand in a queue before the line, never harder than 0.9 g on the brakes."""
    cars = [car(150.0 - 21.0 * k, 14.0) for k in range(8)]
    run = drive(street(cars, straight(signals=(StopLine(230.0, 0),)), 40.0), 40.0)
    gaps = run.s[:, :-1] - run.s[:, 1:] - 4.4
    assert gaps.min() > 1.0
    assert run.v[-1].max() < 0.05
    assert 228.0 < run.s[-1, 0] + 2.2 <= 230.01
    assert np.diff(run.v, axis=0).min() / STEP_S > -0.9 * G
    assert np.diff(run.s, axis=0).min() >= 0.0


def test_who_is_on_a_zebra_goes_first():
    """A car waits before the zebra while somebody crosses, and goes on afterwards."""
    t = np.arange(0.0, 25.0, STEP_S)
    people = np.stack([-4.0 + 1.3 * t, np.full(len(t), 100.0)], axis=-1)[:, None]
    run = drive(street([car(50.0, 12.0)], straight(zebras=(100.0,)), 20.0, people), 20.0)
    crossing = np.abs(people[: len(run.s), 0, 0]) < 1.5
    assert (run.s[crossing, 0] + 2.2 < 98.0).all()
    assert run.s[-1, 0] > 110.0


def clip(recipe, seed, seconds, **change):
    given = {"time.seconds": seconds, "time.fps": FPS, **change}
    found = compose.load(Path(recipe), [f"{key}={value}" for key, value in given.items()])
    spec = compose.draw(found, seed=seed)
    return compose.clip_of(found, spec, seed=seed)


def placed_at(spec, track, index, frame):
    """What moves as a placement of one frame."""
    return replace(
        spec.placed[index],
        x=float(track.x[frame]), y=float(track.y[frame]), heading=float(track.heading[frame]),
    )  # fmt: skip


def collisions(spec, found):
    """Pairs of names whose outlines on the ground overlap, and at which frame first; not those that were drawn so."""
    skipped = ("Ground", "Buildings")  # eaves and oriels hang over the pavement
    solid = [i for i, p in enumerate(spec.placed) if p.group not in skipped and p.asset != "fallen_leaf"]
    still = [i for i in solid if i not in found.tracks]
    tree = shapely.STRtree([shapely.Polygon(rules.footprint(spec.placed[i])) for i in still])
    pairs, drawn = {}, set()
    for frame in range(1, len(found.codes) - 1):
        moving = [i for i, track in found.tracks.items() if track.shown[frame]]
        shapes = [shapely.Polygon(rules.footprint(placed_at(spec, found.tracks[i], i, frame))) for i in moving]
        for i, shape in zip(moving, shapes, strict=True):
            for k in tree.query(shape, predicate="intersects"):
                if shape.intersection(tree.geometries[k]).area > 1e-6:
                    pairs.setdefault((spec.placed[i].name, spec.placed[still[k]].name), frame)
        a, b = shapely.STRtree(shapes).query(shapes, predicate="intersects")
        for i, j in zip(a[a < b], b[a < b], strict=True):
            names = {spec.placed[moving[k]].asset for k in (i, j)}
            if names != {"rider", "bicycle"}:
                pairs.setdefault((spec.placed[moving[i]].name, spec.placed[moving[j]].name), frame)
        drawn = drawn or {pair for pair, at in pairs.items() if at == 1}
    return {pair: frame for pair, frame in pairs.items() if pair not in drawn}


def hold(spec, found):
    """What holds for every clip: nothing overlaps, jumps, floats or is thrown about."""
    assert collisions(spec, found) == {}
    for index, track in [(-1, found.ego), *found.tracks.items()]:
        name = "ego" if index < 0 else spec.placed[index].name
        at = np.stack([track.x, track.y], axis=1)
        velocity = np.diff(at, axis=0) * FPS
        change = np.diff(velocity, axis=0) * FPS
        ahead = np.stack([-np.sin(np.radians(track.heading)), np.cos(np.radians(track.heading))], axis=1)[1:-1]
        along, side = (change * ahead).sum(axis=1), ahead[:, 0] * change[:, 1] - ahead[:, 1] * change[:, 0]
        assert np.abs(velocity).max() < 45.0, name
        if index >= 0 and spec.placed[index].asset in SPEED_M_S:
            assert np.hypot(*velocity.T).max() < 4.0, name
            continue
        assert along.min() > -0.9 * G, name
        assert np.abs(side).max() < 0.5 * G, name
        if index >= 0:
            height = ground(spec.road, track.x, track.y)
            assert np.abs(track.z - height).max() < 0.01, name
            assert track.x[1] == spec.placed[index].x, name


RECIPES = compose.recipes()
QUICK = ("crossroads", "motorway", "residential", "roundabout")
FEW = [one if one in QUICK else pytest.param(one, marks=pytest.mark.slow) for one in RECIPES]


@pytest.mark.parametrize("recipe", FEW)
def test_nothing_overlaps_jumps_or_floats(recipe):
    """Four seconds of each recipe: outlines stay apart, 0.9 g and 0.5 g are kept, wheels are on the ground."""
    spec, found = clip(recipe, 1, 4.0)
    assert any(spec.placed[i].group == "Vehicles" for i in found.tracks) or found.ego.moves
    hold(spec, found)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2, 6))
@pytest.mark.parametrize("recipe", RECIPES)
def test_nothing_overlaps_in_many_draws(recipe, seed):
    """The same for four more seeds, eight seconds each."""
    spec, found = clip(recipe, seed, 8.0)
    hold(spec, found)


def test_a_still_is_frame_0_of_its_clip(tmp_path):
    """At the default time every attribute of the still is as it was, and at frame 0 everything stands where it did."""
    few = {"people.count": 6}
    compose.compose("residential", tmp_path / "still.usda", seed=3, change=few)
    compose.compose("residential", tmp_path / "clip.usda", seed=3, change=few, seconds=1.0, fps=10.0)
    still, moving = Usd.Stage.Open(str(tmp_path / "still.usda")), Usd.Stage.Open(str(tmp_path / "clip.usda"))
    assert (moving.GetStartTimeCode(), moving.GetEndTimeCode(), moving.GetTimeCodesPerSecond()) == (0.0, 9.0, 10.0)
    now, begun, later = UsdGeom.XformCache(), UsdGeom.XformCache(0.0), UsdGeom.XformCache(9.0)
    moved = 0
    for prim in still.Traverse():
        other = moving.GetPrimAtPath(prim.GetPath())
        assert other, prim.GetPath()
        if not UsdGeom.Xformable(prim):
            continue
        was = now.GetLocalToWorldTransform(prim)
        assert Usd.Prim.IsValid(other) and was == now.GetLocalToWorldTransform(other), prim.GetPath()
        at = begun.GetLocalToWorldTransform(other)
        np.testing.assert_allclose(np.array(was), np.array(at), atol=1e-5, err_msg=str(prim.GetPath()))
        moved += was != later.GetLocalToWorldTransform(other)
        if prim.GetName() in ("Buildings", "Road", "Sky", "Plants"):
            assert all(not one.GetNumTimeSamples() for below in Usd.PrimRange(other) for one in below.GetAttributes())
    assert moved >= 5


@pytest.mark.parametrize("recipe", ["tunnel", pytest.param("roundabout", marks=pytest.mark.slow)])
def test_the_same_seed_gives_the_same_bytes(tmp_path, recipe):
    """Two clips of one seed are equal files."""
    for folder in "ab":
        compose.compose(recipe, tmp_path / folder / "street.usda", seed=2, seconds=1.0)
    for file in sorted((tmp_path / "a").iterdir()):
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes(), file.name


@pytest.fixture(scope="module")
def circle(tmp_path_factory):
    """A roundabout over four seconds."""
    path = tmp_path_factory.mktemp("roundabout") / "street.usda"
    compose.compose("roundabout", path, seed=3, seconds=4.0, change={"people.count": 0})
    return Usd.Stage.Open(str(path))


def test_wheels_roll_on_the_ground_without_slipping(circle):
    """The tyre's lowest point is within 1.5 cm of the road, and a turn of the wheel is a circumference of way."""
    cars = [
        prim for prim in circle.GetPrimAtPath("/World/Vehicles").GetChildren()
        if prim.GetChild("Wheels") and UsdGeom.Imageable(prim).ComputeVisibility(0.0) != "invisible"
    ]  # fmt: skip
    assert cars
    steered = 0
    for prim in cars:
        places = [np.array(UsdGeom.XformCache(t).GetLocalToWorldTransform(prim)) for t in (0.0, 1.0)]
        way = np.linalg.norm(places[1][3, :2] - places[0][3, :2])
        for wheel in prim.GetChild("Wheels").GetChildren():
            tyre = UsdGeom.Mesh(wheel.GetChild("tyre"))
            points = np.c_[np.array(tyre.GetPointsAttr().Get(), dtype=float), np.ones(len(tyre.GetPointsAttr().Get()))]
            for t in (0.0, 4.0):
                low = (points @ np.array(UsdGeom.XformCache(t).GetLocalToWorldTransform(tyre.GetPrim())))[:, 2].min()
                assert abs(low) < 0.015, (prim.GetPath(), wheel.GetName(), t)
            spin = wheel.GetAttribute("xformOp:rotateX")
            radius = np.abs(points[:, 2]).max()
            turned = math.radians(spin.Get(0.0) - spin.Get(1.0))
            assert turned * radius == pytest.approx(way, abs=0.01 + 0.03 * way), prim.GetPath()
            steered += wheel.GetAttribute("xformOp:rotateZ").GetNumTimeSamples() > 0
    assert steered


def test_lamps_follow_what_a_vehicle_does(circle):
    """Who brakes has emissive brake lenses at those frames and no others; who leaves a roundabout blinks right."""
    circle.GetPrimAtPath("/World").GetVariantSets().GetVariantSet("lighting").SetVariantSelection("active")
    seen = set()
    for prim in circle.GetPrimAtPath("/World/Vehicles").GetChildren():
        for name in ("tail_lens", "amber_left", "amber_right"):
            lens = prim.GetPrimAtPath(f"Materials/{name}/Surface.inputs:emissiveColor".split(".")[0])
            emission = lens.GetAttribute("inputs:emissiveColor") if lens else None
            if emission and emission.GetNumTimeSamples():
                lit = {round(float(emission.Get(t)[0])) for t in emission.GetTimeSamples()}
                assert len(lit) == 2, (prim.GetPath(), name)
                seen.add(name)
    assert {"tail_lens", "amber_right"} <= seen
    assert "amber_left" not in seen


def test_all_models_that_drive_have_wheels_that_turn():
    """Every tyre of every model of a vehicle belongs to a wheel, in both levels of detail."""
    folder = library.model("saloon").path.parent.parent
    for name in library.names():
        kinds = ("car", "truck", "bus", "bicycle", "motorcycle", "rider")
        if library.model(name).label not in kinds or name == "rider":
            continue
        for file in sorted((folder / name).glob("*.geo.usdc")):
            wheels = wheels_of(file)
            assert wheels is not None, file
            assert wheels.rest["tyre"] is None, file
            assert len(wheels.wheels) in (2, 4, 6), file
            assert all(abs(wheel.axle[2] - wheel.radius) < 0.01 for wheel in wheels.wheels), file


def test_a_clip_that_leaves_the_road_is_one_clear_line():
    """The line names the option and what would help; 300 m at 120 km/h are gone after 9 s."""
    with pytest.raises(RecipeError, match=r"--seconds 12: the camera's car leaves the drawn road.*road.length_m"):
        clip("motorway", 3, 12.0, **{"road.length_m": 300})


def test_layers_of_a_clip_have_one_clock(tmp_path):
    """A sublayer whose time codes last differently would be stretched."""
    compose.compose("tunnel", tmp_path / "street.usda", seed=1, seconds=0.5, fps=20.0)
    for file in tmp_path.glob("*.usda"):
        assert Sdf.Layer.FindOrOpen(str(file)).timeCodesPerSecond == 20.0, file


@pytest.mark.parametrize("shift", [-1.0, 0.0, 1.0])
def test_people_walk_at_their_speed_round_a_bend(shift):
    """On a ring of 6 m radius, 1 m inside and outside of its middle: the way between positions is 1.4 m/s each step."""
    angle = np.linspace(0.0, 1.5 * np.pi, 500)
    path = Line(6.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1), 3.0)
    times = np.arange(0.0, 12.0, 0.5)
    way = Way(path, 1.0, 0.0, 0.0, -1.5, 1.5)
    x, y, _ = way.position(way.travel(1.4, times, shift), shift).T
    gone = np.hypot(np.diff(x), np.diff(y))[4:]  # once aside
    np.testing.assert_allclose(gone, 0.7, rtol=3e-3)
