"""Lanes that a drawn world tells of: who drives is in one and looks its way, who parks is in a bay; speeds."""

import functools
from dataclasses import replace

import numpy as np
import pytest
import shapely
from pxr import Usd, UsdGeom

from synfog_usd import resources
from synfog_usd.world import authoring
from synfog_usd.world.compose import draw, load
from synfog_usd.world.roads.stage import KINDS, author_lanes
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
    parked = [p for p in spec.placed if p.speed_m_s == 0.0]
    bays = shapely.union_all([area for one, area in zip(lanes, areas, strict=True) if one.type == "parking"])
    assert len(parked) > 5 and all(bays.contains(shapely.Point(p.x, p.y)) for p in parked)


def test_the_ring_of_a_roundabout_is_between_its_circles():
    spec, lanes, areas = world("roundabout")
    ring = spec.road
    assert areas[0].area == pytest.approx(np.pi * (ring.radius**2 - ring.inner**2), rel=0.01)
    (x, y), (dx, dy) = lanes[0].left[:-1, :2].T, np.diff(lanes[0].left[:, :2], axis=0).T
    assert (x * dy - y * dx > 0.0).all()  # counter-clockwise


def test_speeds_are_the_recipes_and_look_ahead():
    """22 to 32 km/h in a residential street, the same for all who neither brake nor park."""
    spec, _, _ = world("residential")
    vehicles = [p for p in spec.placed if p.group == "Vehicles"]
    speeds = {p.speed_m_s for p in vehicles if p.speed_m_s and p.lit["lamps"] == "glow"}
    assert len(speeds) == 1 and 22.0 <= 3.6 * speeds.pop() <= 32.0
    assert all(p.speed_m_s is None for p in vehicles if p.lit.get("lamps") == "brake")


def test_velocities_are_along_the_cars_own_axis():
    """Its +Y, uphill too, where other code puts the prim."""
    stage = Usd.Stage.CreateInMemory()
    p = Placement("Vehicles", "Car", "saloon", 3.0, 4.0, heading=130.0, pitch=7.0, speed_m_s=9.0)
    authoring.author_placements(stage, [p, replace(p, name="Who", speed_m_s=None)], str(resources.folder("assets")))
    car, who = (stage.GetPrimAtPath(f"/World/Vehicles/{name}") for name in ("Car", "Who"))
    axis = np.array(UsdGeom.XformCache().GetLocalToWorldTransform(car))[1, :3]
    np.testing.assert_allclose(car.GetAttribute("physics:velocity").Get(), 9.0 * axis, atol=1e-3)
    assert not who.GetAttribute("physics:velocity")


def test_lanes_are_guides_that_nobody_draws():
    stage = Usd.Stage.CreateInMemory()
    spec, lanes, _ = world("residential")
    author_lanes(stage, spec)
    (first, *others) = stage.GetPrimAtPath("/World/Lanes").GetChildren()
    assert len(others) + 1 == len(lanes) and UsdGeom.Imageable(first).ComputePurpose() == "guide"
    points = np.array(first.GetAttribute("points").Get())
    np.testing.assert_allclose(points, np.concatenate([lanes[0].left, lanes[0].right]), atol=1e-3)
