"""Lanes that a drawn world tells of: who drives is in one and looks its way, who parks is in a bay; speeds."""

import functools
from dataclasses import replace

import numpy as np
import pytest
import shapely
from pxr import Usd, UsdGeom

from synfog_usd.base import resources
from synfog_usd.world import authoring
from synfog_usd.world.compose import draw, load
from synfog_usd.world.library import model
from synfog_usd.world.roads.stage import KINDS
from synfog_usd.world.spec import Placement

RECIPES = resources.folder("stages") / "recipes"


@functools.cache
def world(name):
    """A draw, its lanes and their areas."""
    spec = draw(load(RECIPES / f"{name}.yaml"), seed=4)
    lanes = KINDS[type(spec.road)].edged_lanes(spec.road)
    return spec, lanes, [shapely.Polygon(np.r_[one.left, one.right[::-1]][:, :2]).buffer(0.0) for one in lanes]


@pytest.mark.parametrize("name", ["residential", "roundabout", "crossroads"])
def test_traffic_is_in_lanes_and_goes_their_way(name):
    """Where a vehicle is and looks was drawn by other code than the lanes' edges."""
    spec, lanes, areas = world(name)
    driven = [p for p in spec.placed if p.group == "Vehicles" and p.lit]
    assert len(driven) > 3
    for p in driven:
        here = shapely.Point(p.x, p.y)
        inside = [one for one, area in zip(lanes, areas, strict=True) if one.type == "driving" and area.contains(here)]
        assert inside, p
        ahead = np.array([-np.sin(np.radians(p.heading)), np.cos(np.radians(p.heading))])
        turns = []
        for one in inside:
            line = shapely.LineString(one.left[:, :2])
            s = line.project(here)
            a, b = (np.array(line.interpolate(s + d).coords[0]) for d in (-0.5, 0.5))
            turns.append((b - a) @ ahead / np.linalg.norm(b - a))
        assert max(turns) > np.cos(np.radians(15.0)), p


@pytest.mark.parametrize("name", ["residential", "crossroads"])
def test_who_parks_stands_and_is_in_a_bay(name):
    spec, lanes, areas = world(name)
    parked = [p for p in spec.placed if p.speed_m_s == 0.0 and not p.lit]
    bays = shapely.union_all([area for one, area in zip(lanes, areas, strict=True) if one.type == "parking"])
    assert len(parked) > 5 and all(bays.contains(shapely.Point(p.x, p.y)) for p in parked)


def test_speeds_are_the_recipes_and_look_ahead():
    """22 to 32 km/h in a residential street, the same for all who neither brake nor park."""
    spec, _, _ = world("residential")
    vehicles = [p for p in spec.placed if p.group == "Vehicles"]
    speeds = {p.speed_m_s for p in vehicles if p.speed_m_s and p.lit["lamps"] == "glow"}
    assert len(speeds) == 1 and 22.0 <= 3.6 * speeds.pop() <= 32.0


def test_who_brakes_before_a_zebra_can_stop_there_and_is_no_faster_than_its_lane():
    """All of a lane by one deceleration, below half of the weight; of who brakes elsewhere nothing is known."""
    rates = []
    for seed in (1, 2, 3):
        spec = draw(load(RECIPES / "arterial.yaml", ("road.zebras=2", "traffic.hour=8")), seed=seed)
        stations = np.arange(0.0, spec.road.reference_line.length, 0.25)
        line = shapely.LineString(np.column_stack(spec.road.reference_line.place(stations, 0.0)))
        driven = [p for p in spec.placed if p.group == "Vehicles" and p.lit]
        flow = max(p.speed_m_s for p in driven if p.speed_m_s is not None)
        for p in driven:
            s = line.project(shapely.Point(p.x, p.y))
            here, there = (line.interpolate(s + d) for d in (0.0, 1.0))
            ahead = -np.sin(np.radians(p.heading)), np.cos(np.radians(p.heading))
            way = np.sign(np.dot(ahead, (there.x - here.x, there.y - here.y)))
            left = [(zebra - s) * way for zebra in spec.road.zebras if 0.5 < (zebra - s) * way < 29.5]
            if left and p.speed_m_s:
                front = min(left) - model(p.asset).length / 2
                assert p.speed_m_s < flow
                rates.append(p.speed_m_s**2 / (2.0 * (front - 3.6)) / flow**2)
                assert rates[-1] * flow**2 < 0.5 * 9.81
            elif p.speed_m_s != 0.0 and not any(abs(abs(zebra - s) - 30.0) < 0.5 for zebra in spec.road.zebras):
                assert p.speed_m_s in (None, flow)  # far off, brake lamps are drawn as ones that glow
    assert len(rates) > 2 and np.ptp(rates) < 0.15 * np.mean(rates)  # stations off the line are found to a few cm


def test_at_a_roundabout_who_goes_round_is_held_to_its_curve():
    """Between 1 and 3 m s-2 towards the middle, though 50 km/h are allowed; who waits at the circle stands."""
    spec = draw(load(RECIPES / "roundabout.yaml", ("traffic.ring=6", "traffic.speed_kmh=50", "traffic.hour=8")), seed=1)
    where = [(float(np.hypot(p.x, p.y)), p.speed_m_s) for p in spec.placed if p.group == "Vehicles" and p.lit]
    round_it = [(away, speed) for away, speed in where if away < spec.road.radius]
    assert len(round_it) > 2 and all(1.0 < speed**2 / away < 3.0 for away, speed in round_it)
    waiting = [speed for away, speed in where if spec.road.radius < away < spec.road.arms[0].zebras[0]]
    assert waiting == [0.0] * len(waiting) and max(speed for _, speed in where if speed is not None) == 50 / 3.6


def test_at_a_red_light_three_stand_and_who_comes_brakes_to_the_end_of_the_queue():
    """Six in the lane that waits: 0, 0, 0, then ever faster, and 36 km/h where there is nobody to wait for."""
    recipe = load(
        RECIPES / "crossroads.yaml", ("traffic.count=24", "traffic.speed_kmh=36", "traffic.main_street=waits")
    )
    driven = [p for p in draw(recipe, seed=1).placed if p.group == "Vehicles" and p.lit]
    waiting = sorted((p.y, p.speed_m_s) for p in driven if p.x < 0.0 and p.y > 0.0 and p.heading == 180.0)
    speeds = [speed for _, speed in waiting]
    assert len(speeds) > 4 and speeds[:3] == [0.0] * 3 and speeds == sorted(speeds) and 0.0 < speeds[3] <= 10.0
    assert all(p.speed_m_s == 10.0 for p in driven if abs(p.heading) == 90.0)


def test_velocities_are_along_the_cars_own_axis():
    """Its +Y, uphill too, where other code puts the prim."""
    stage = Usd.Stage.CreateInMemory()
    p = Placement("Vehicles", "Car", "saloon", 3.0, 4.0, heading=130.0, pitch=7.0, speed_m_s=9.0)
    authoring.author_placements(
        stage.GetRootLayer(), [p, replace(p, name="Who", speed_m_s=None)], str(resources.folder("assets"))
    )
    car, who = (stage.GetPrimAtPath(f"/World/Vehicles/{name}") for name in ("Car", "Who"))
    axis = np.array(UsdGeom.XformCache().GetLocalToWorldTransform(car))[1, :3]
    np.testing.assert_allclose(car.GetAttribute("physics:velocity").Get(), 9.0 * axis, atol=1e-3)
    assert not who.GetAttribute("physics:velocity")
