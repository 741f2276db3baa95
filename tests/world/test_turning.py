"""Turns at the crossing: who gives way to whom, how fast the bends are taken, what blinks; and who comes in later."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapely
from pxr import Usd, UsdGeom

from synfog_usd.world import compose
from synfog_usd.world.roads.crossing import Crossing
from synfog_usd.world.traffic import idm, opendrive
from synfog_usd.world.traffic.follow import LOOK_S, STEP_S, Street, Vehicle, drive
from synfog_usd.world.traffic.paths import ZEBRA_X, routes

WAYS = routes(Crossing())
SECONDS = 25.0
SEED = 17
"""A crossing where somebody turns within twelve seconds."""
NORTH, SOUTH = 0, 1
"""Routes straight on along the main street."""


def turn(route, side):
    """Number of the turn to a side from where a route begins."""
    begins = WAYS[route].path.points[0]
    (number,) = (
        number for number, way in enumerate(WAYS)
        if way.turns and way.turns[0][2] == side and np.allclose(way.path.points[0], begins)
    )  # fmt: skip
    return number


def run(vehicles, people=None):
    """All signals are green."""
    steps = round((SECONDS + LOOK_S) / STEP_S) + 5
    people = np.zeros((steps, 0, 2)) if people is None else people
    empty = {vehicle.route: (np.zeros(0), np.zeros(0)) for vehicle in vehicles}
    street = Street(WAYS, vehicles, people, empty, idm.Driver(), np.zeros((steps, 2), dtype=bool))
    return street, drive(street, SECONDS)


def car(route, s, v=12.0):
    return Vehicle(route, s, 0.0, 0.0, 2.2, 2.2, 1.8, v, v)


def apart(street, driven):
    """Least distance of any two vehicles' outlines at any step [m]."""
    least = np.inf
    for state in driven.states:
        now = street.places(state)
        boxes = []
        for x, y, h in zip(now.x, now.y, now.heading, strict=True):
            c, s = np.cos(h), np.sin(h)
            corners = np.array([(-0.9, -2.2), (0.9, -2.2), (0.9, 2.2), (-0.9, 2.2)])
            boxes.append(shapely.Polygon(corners @ np.array([[c, s], [-s, c]]) + (x, y)))
        least = min(least, *(a.distance(b) for k, a in enumerate(boxes) for b in boxes[:k]))
    return least


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("route", range(4))
def test_a_free_turn_is_taken_at_half_a_g_at_most(route, side):
    """v^2 times the curvature stays below 0.5 g, brakes are gentle, and the car does not stop."""
    way = WAYS[turn(route, side)]
    _, driven = run([car(turn(route, side), 70.0)])
    s, v = driven.s[:, 0], driven.v[:, 0]
    assert s[-1] > way.path.length - 100.0
    assert (v**2 * np.abs(np.interp(s, way.path.s, way.path.curvature))).max() < 0.5 * 9.81
    assert driven.a.min() > -3.0
    assert v.min() > 4.0


def test_turns_are_the_ways_of_the_opendrive_file(tmp_path):
    """Between the lines each driven turn is within 0.25 m of a connecting road's line, which is the middle of lanes."""
    lines = []
    for road in opendrive.NETWORKS[Crossing](Crossing()).roads:
        for piece in road.pieces:
            if piece.begin:
                radius = 1.0 / piece.begin
                centre = np.array([piece.x - radius * np.sin(piece.hdg), piece.y + radius * np.cos(piece.hdg)])
                first = np.array([piece.x, piece.y]) - centre
                angle = np.arctan2(first[1], first[0]) + np.linspace(0.0, piece.length * piece.begin, 60)
                arc = centre + abs(radius) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
                begin, end = road.pieces[0], road.pieces[-1].after()
                lines.append(shapely.LineString([(begin.x, begin.y), *arc, end[:2]]))
    assert len(lines) == 8
    for side in (1, -1):
        for route in range(4):
            way = WAYS[turn(route, side)]
            inside = way.path.points[(np.abs(way.path.points) < 15.0).all(axis=1)]
            assert min(max(line.distance(shapely.Point(p)) for p in inside) for line in lines) < 0.25


def test_who_turns_left_lets_oncoming_traffic_pass():
    """The turning car stands in the junction until four others have passed, who never brake for it, then goes."""
    left = turn(NORTH, 1)
    oncoming = [car(SOUTH, 150.0 + 30.0 * k) for k in range(4)]
    street, driven = run([car(left, 90.0), *oncoming])
    meet = WAYS[SOUTH].path.nearest(np.array(WAYS[left].gives_way[0].meet))[0]
    passed = driven.s[:, 1] > meet + 2.2
    waits = driven.v[:, 0] < 0.5
    assert waits.any() and (driven.s[waits, 0] + 2.2 < WAYS[left].holds[0] + 1.2).all()
    assert passed[np.flatnonzero(waits)[-1]]
    assert driven.s[-1, 0] > WAYS[left].holds[1]
    assert driven.a[:, 1:].min() > -1.0
    assert apart(street, driven) > 0.5


def test_two_who_turn_left_pass_each_other():
    """Both from the main street: neither waits for the other."""
    street, driven = run([car(turn(NORTH, 1), 90.0), car(turn(SOUTH, 1), 208.0)])
    assert driven.v.min() > 3.0
    assert apart(street, driven) > 1.0


@pytest.mark.parametrize("side", [1, -1])
def test_who_turns_gives_way_to_people_on_the_zebra(side):
    """Somebody crosses the side street; the car comes to their way when they are gone."""
    number = turn(NORTH, side)
    t = np.arange(0.0, SECONDS + LOOK_S + 1.0, STEP_S)
    x = -side * ZEBRA_X
    people = np.stack([np.full(len(t), x), 8.0 - 1.2 * t], axis=-1)[:, None]
    _, driven = run([car(number, 110.0)], people)
    zebra = WAYS[number].zebras[0]
    on_road = np.abs(people[: len(driven.s), 0, 1]) < 4.4
    assert (driven.s[on_road, 0] + 2.2 < zebra - 1.6).all()
    assert driven.s[-1, 0] > zebra + 5.0
    assert driven.a.min() > -0.6 * 9.81


@pytest.fixture(scope="module")
def clip():
    """A crossing over twelve seconds: as it was drawn, with who comes in, and the clip."""
    recipe = compose.load(Path("crossroads"), ["time.seconds=12", "time.fps=4", "people.count=0"])
    drawn = compose.draw(recipe, seed=SEED)
    return drawn, *compose.clip_of(recipe, drawn, seed=SEED)


def test_who_comes_in_is_no_part_of_the_still(clip, tmp_path):
    """They are invisible at frame 0 and later come in at a road's end, whole and once; the others are as drawn."""
    drawn, spec, found = clip
    assert spec.placed[: len(drawn.placed)] == drawn.placed
    coming = range(len(drawn.placed), len(spec.placed))
    assert len(coming) >= 2
    names = [p.name for p in spec.placed]
    assert len(names) == len(set(names))
    for index in coming:
        track = found.tracks[index]
        first = int(np.argmax(track.shown))
        assert not track.shown[:2].any() and track.shown[first:].all()
        assert max(abs(track.x[first]), abs(track.y[first])) > 140.0
    few = {"people.count": 0}
    compose.compose("crossroads", tmp_path / "a.usda", seed=SEED, seconds=12.0, fps=4.0, change=few)
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    for index in coming:
        eye = UsdGeom.Imageable(stage.GetPrimAtPath(f"/World/Vehicles/{names[index]}"))
        assert eye.ComputeVisibility(Usd.TimeCode.Default()) == eye.ComputeVisibility(0.0) == "invisible"
        assert eye.ComputeVisibility(47.0) == ("inherited" if found.tracks[index].shown[-2] else "invisible")


def test_who_turns_blinks_before_it(clip):
    """Of those who turned by a right angle, each blinked to that side before, and to no other."""
    _, spec, found = clip
    turned = [
        track for index, track in found.tracks.items()
        if spec.placed[index].group == "Vehicles" and abs(track.heading[-1] - track.heading[1]) > 60.0
    ]  # fmt: skip
    assert turned
    for track in turned:
        side = 1 if track.heading[-1] > track.heading[1] else -1
        begins = int(np.argmax(np.abs(track.heading - track.heading[1]) > 5.0))
        assert set(track.blinks.tolist()) == {0, side}
        assert (track.blinks[:begins] == side).any()
