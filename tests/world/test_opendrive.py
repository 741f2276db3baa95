"""OpenDRIVE: read back by formulas of its standard, roads and lanes are where they were drawn.

`asam-qc-opendrive` and SUMO's netconvert judge such files too (docs/sequences.md); they are no dependencies.
"""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import shapely
from scipy import integrate

from synfog_usd.base.errors import RecipeError
from synfog_usd.world import compose
from synfog_usd.world.roads import crossing_built
from synfog_usd.world.roads.network import Road
from synfog_usd.world.traffic import opendrive
from synfog_usd.world.traffic.paths import routes

SOME = ("bridge", "crossroads", "roundabout", "rural")
RECIPES = [one if one in SOME else pytest.param(one, marks=pytest.mark.slow) for one in compose.recipes()]


def drawn(folder, recipe, seed):
    """A site and its file, read."""
    site = compose.draw(compose.load(Path(recipe)), seed=seed).road
    opendrive.write(folder / "road.xodr", site, recipe)
    return site, ElementTree.parse(folder / "road.xodr").getroot()


def number(element, name):
    return float(element.get(name))


def place(road, s, t=0.0):
    """x, y [m] and heading [rad] at s, t by the standard: curvature is linear along a spiral."""
    geometry = [one for one in road.find("planView") if number(one, "s") <= s + 1e-9][-1]
    ds, hdg = s - number(geometry, "s"), number(geometry, "hdg")
    shape = geometry[0]
    begin = float(shape.get("curvStart", shape.get("curvature", "0")))
    end = float(shape.get("curvEnd", shape.get("curvature", "0")))
    grows = (end - begin) / number(geometry, "length")

    def heading(u):
        return hdg + begin * u + grows * u * u / 2.0

    x = number(geometry, "x") + integrate.quad(lambda u: math.cos(heading(u)), 0.0, ds)[0]
    y = number(geometry, "y") + integrate.quad(lambda u: math.sin(heading(u)), 0.0, ds)[0]
    return x - t * math.sin(heading(ds)), y + t * math.cos(heading(ds)), heading(ds)


def cubic(rows, s, key="s"):
    """Value of a polynomial at s, 0 where none holds."""
    row = [one for one in rows if number(one, key) <= s + 1e-9]
    if not row:
        return 0.0
    ds = s - number(row[-1], key)
    return sum(number(row[-1], name) * ds**power for power, name in enumerate("abcd"))


def middle(road, lane, s):
    """t of the middle of a lane [m]."""
    section, side = road.find("lanes/laneSection"), 1 if lane > 0 else -1
    widths = {int(one.get("id")): cubic(one.findall("width"), s, "sOffset") for one in section.iter("lane")}
    t = cubic(road.findall("lanes/laneOffset"), s) + side * widths[lane] / 2.0
    return t + side * sum(widths[side * k] for k in range(1, abs(lane)))


@pytest.mark.parametrize("recipe", [one for one in RECIPES if one not in ("crossroads", "roundabout")])
def test_a_road_is_where_it_was_drawn(tmp_path, recipe):
    """Line, heading, the middles of lanes and their heights agree within a millimetre along the road."""
    site, root = drawn(tmp_path, recipe, 2)
    (road,) = root.iter("road")
    line = site.reference_line
    assert number(road, "length") == pytest.approx(line.length, abs=1e-6)
    lanes = {int(one.get("id")): one for one in road.iter("lane")}
    middles = sorted(-middle(road, lane, 0.0) for lane in lanes if lane)
    np.testing.assert_allclose(middles, sorted(lane.middle for lane in site.lane_section.lanes), atol=1e-6)
    for s in np.linspace(0.0, line.length - 1e-3, 9):
        x, y, heading = place(road, float(s))
        np.testing.assert_allclose((x, y), np.array(line.place(s, 0.0)), atol=1e-3)
        assert math.remainder(heading - math.pi / 2 - float(line.heading(s)), 2 * math.pi) == pytest.approx(0, abs=1e-5)
        height = cubic(road.findall("elevationProfile/elevation"), float(s))
        assert height == pytest.approx(float(line.height(s)), abs=1e-3)
        for lane in (one for one in lanes if one):
            t = middle(road, lane, float(s))
            raised = [number(row, edge) for row in lanes[lane].iter("height") for edge in ("inner", "outer")]
            above = sum(raised) / 2.0 + cubic(road.findall("lateralProfile/shape"), t, "t")
            assert height + above == pytest.approx(float(site.ground(s, -t)), abs=1e-3)


@pytest.mark.parametrize("recipe", RECIPES)
def test_cars_drive_the_way_that_lanes_go(tmp_path, recipe):
    """Each route of our traffic begins in the middle of a driving lane of the file, which goes its way."""
    site, root = drawn(tmp_path, recipe, 2)
    wanted = [route.path.at(40.0 if type(site) is Road else 3.0) for route in routes(site)]
    for x, y, heading in wanted:
        best = np.inf
        for road in root.iter("road"):
            for lane in road.iter("lane"):
                if lane.get("type") not in ("driving", "biking"):
                    continue
                for s in np.linspace(0.0, number(road, "length") - 1e-3, 61):
                    t = middle(road, int(lane.get("id")), float(s))
                    px, py, h = place(road, float(s), t)
                    if math.hypot(px - x, py - y) > 12.0:
                        continue
                    along = (int(lane.get("id")) < 0) != (lane.get("direction") == "reversed")
                    h += 0.0 if along else math.pi
                    aside = (px - x) * math.sin(h) - (py - y) * math.cos(h)
                    if math.cos(h - math.pi / 2 - float(heading)) > 0.9:
                        best = min(best, abs(aside))
        assert best < 0.45


@pytest.mark.parametrize(("recipe", "seed"), [("crossroads", 1), ("roundabout", 1), ("roundabout", 2)])
def test_ways_through_a_junction_meet_the_lanes_they_join(tmp_path, recipe, seed):
    """Each connecting road begins and ends in the middle of the lane that it links to, with its heading."""
    _, root = drawn(tmp_path, recipe, seed)
    roads = {road.get("id"): road for road in root.iter("road")}
    ways = [road for road in roads.values() if road.get("junction") != "-1"]
    assert len(ways) == (12 if recipe == "crossroads" else 3 * len(list(root.iter("junction"))))
    for way in ways:
        (lane,) = (one for one in way.iter("lane") if one.get("id") == "-1")
        for tag, s in (("predecessor", 0.0), ("successor", number(way, "length"))):
            link = way.find(f"link/{tag}")
            other, number_of = roads[link.get("elementId")], int(lane.find(f"link/{tag}").get("id"))
            at = 0.0 if link.get("contactPoint") == "start" else number(other, "length")
            x, y, h = place(other, at, middle(other, number_of, at))
            px, py, ph = place(way, s, middle(way, -1, s))
            assert math.hypot(px - x, py - y) < 2e-3, (way.get("id"), tag)
            assert abs(math.sin(ph - h)) < 1e-6, (way.get("id"), tag)
            widths = [
                cubic(one.findall("width"), here, "sOffset")
                for road, here, which in ((other, at, number_of), (way, s, -1))
                for one in road.iter("lane") if int(one.get("id")) == which
            ]  # fmt: skip
            assert widths[0] == pytest.approx(widths[1], abs=1e-6)
    for junction in root.iter("junction"):
        for connection in junction:
            way = roads[connection.get("connectingRoad")]
            assert way.find("link/predecessor").get("elementId") == connection.get("incomingRoad")


def test_another_name_is_one_clear_line(tmp_path):
    """Nothing is written over a file of another kind."""
    with pytest.raises(RecipeError, match=r"--opendrive .*ends in \.xodr"):
        compose.compose("residential", tmp_path / "a.usda", opendrive=tmp_path / "a.xml")


def test_bays_of_the_crossing_are_where_its_stage_has_them(tmp_path):
    """Rows of repeated parking spaces cover the parking lanes of the stage, and nothing else."""
    site, root = drawn(tmp_path, "crossroads", 1)
    boxes = []
    for road in root.iter("road"):
        for bay in road.iter("object"):
            if bay.get("type") != "parkingSpace":
                continue
            row = bay.find("repeat")
            half, step = number(bay, "length") / 2.0, number(row, "distance")
            for k in range(round(number(row, "length") / step) + 1):
                corners = []
                for ds, dt in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
                    s, t = number(row, "s") + k * step, number(row, "tStart")
                    corners.append(place(road, s + ds * half, t + dt * number(bay, "width") / 2.0)[:2])
                boxes.append(shapely.Polygon(corners))
    lanes = [one for one in crossing_built.edged_lanes(site) if one.type == "parking"]
    drawn_bays = shapely.union_all([shapely.Polygon([*one.left[:, :2], *one.right[::-1, :2]]) for one in lanes])
    assert shapely.union_all(boxes).symmetric_difference(drawn_bays).area < 1e-3 * drawn_bays.area
