"""`check` over the frames of a stage: each fault is told at the prim and frame at which it was authored, and a street
that was composed has none.
"""

import pytest
from pxr import Gf, Sdf, Usd, UsdGeom
from support.cli import run

from synfog_usd.stage import over_time
from synfog_usd.world import compose

TYPES = Sdf.ValueTypeNames
METRES = {"z": 1.0, "y": 0.01}


def label(prim, name):
    prim.GetPrim().CreateAttribute("userProperties:cityscapes", TYPES.String).Set(name)


class Street:
    """A level road of 200 by 20 m with a lane, 20 frames at 10 a second; Z up in metres, or Y up in centimetres."""

    def __init__(self, up="z"):
        self.stage, self.up = Usd.Stage.CreateInMemory(), up
        self.stage.SetStartTimeCode(0.0)
        self.stage.SetEndTimeCode(19.0)
        self.stage.SetTimeCodesPerSecond(10.0)
        UsdGeom.SetStageUpAxis(self.stage, up.upper())
        UsdGeom.SetStageMetersPerUnit(self.stage, METRES[up])
        road = UsdGeom.Mesh.Define(self.stage, "/Road")
        road.GetPointsAttr().Set([self.at(x, y, 0.0) for x, y in ((-10, -100), (10, -100), (10, 100), (-10, 100))])
        road.GetFaceVertexCountsAttr().Set([4])
        road.GetFaceVertexIndicesAttr().Set([0, 1, 2, 3])
        label(road, "road")
        lane = UsdGeom.BasisCurves.Define(self.stage, "/Lane")
        lane.GetTypeAttr().Set("linear")
        lane.GetCurveVertexCountsAttr().Set([2, 2])
        lane.GetPointsAttr().Set([self.at(x, y, 0.0) for x in (-2, 2) for y in (-100, 100)])
        lane.GetPrim().CreateAttribute("synfog:lane:type", TYPES.Token).Set("driving")

    def at(self, x, y, z):
        k = 1.0 / METRES[self.up]
        return (x * k, y * k, z * k) if self.up == "z" else (x * k, z * k, -y * k)

    def car(self, name, place, kind="car", size=(1.8, 4.4, 1.5)):
        """A box on the ground whose middle is at `place` (x, y, height) of each frame."""
        car = UsdGeom.Xform.Define(self.stage, f"/{name}")
        move = car.AddTranslateOp()
        for frame in range(20):
            x, y, z = place(frame)
            move.Set(self.at(x, y, z + size[2] / 2), float(frame))
        box = UsdGeom.Cube.Define(self.stage, f"/{name}/Body")
        box.GetSizeAttr().Set(1.0)
        box.AddScaleOp().Set(tuple(abs(v) for v in self.at(*size)))
        label(car, kind)
        return car

    def found(self):
        return [(one.rule, one.path, one.text.split(":")[0]) for one in over_time(self.stage)]


@pytest.fixture(params=["z", "y"])
def street(request):
    return Street(request.param)


def ahead(frame, x=0.0, begin=0.0, z=0.0):
    return x, begin + 1.0 * frame, z


def test_a_car_that_follows_its_lane_has_no_finding(street):
    street.car("Car", ahead)
    street.car("Other", lambda frame: ahead(frame, begin=6.0))
    assert street.found() == []


def test_two_that_drive_into_each_other_are_told_at_that_frame(street):
    """Bumpers 2.6 m apart at frame 0 that close by 0.5 m a frame: 0.4 m deep at frame 6, the first above 0.1 m."""
    street.car("Car", ahead)
    street.car("Slow", lambda frame: (0.0, 7.0 + 0.5 * frame, 0.0))
    assert street.found() == [("overlaps", "/Car", "frame 6")]


def test_who_rides_overlaps_nothing(street):
    """A driver keeps their place in the car; a walker whom it drives over does not."""
    street.car("Car", ahead)
    street.car("Driver", lambda frame: ahead(frame, x=-0.4), "person", (0.5, 0.5, 1.2))
    assert street.found() == []
    street.car("Walker", lambda frame: (0.0, 10.0, 0.0), "person", (0.5, 0.5, 1.7))
    assert ("overlaps", "/Car", "frame 8") in street.found()  # the bumper is at 2.2 + 8, the walker from 9.75 on


def test_a_bridge_is_above_those_below_it(street):
    """Boxes at other heights do not meet, whatever their outlines."""
    street.car("Car", ahead)
    street.car("Over", lambda frame: (0.0, 20.0 - frame, 6.0))
    assert [rule for rule, *_ in street.found()] == ["floats"]


@pytest.mark.parametrize("way, word", [(0.1, "above"), (-0.1, "below")])
def test_who_leaves_the_ground_is_told_at_that_frame(street, way, word):
    """0.1 m a frame after frame 7: at frame 10 it is 0.3 m, the first beyond 0.25."""
    street.car("Car", lambda frame: ahead(frame, z=way * max(frame - 7, 0)))
    (one,) = over_time(street.stage)
    assert (one.rule, one.path) == ("floats", "/Car")
    assert one.text == f"frame 10: is 0.3 m {word} the ground; move it onto the ground"


def test_a_teleport_is_told_at_that_frame(street):
    """5 m from frame 11 to 12, in the lane, where all other steps are 1 m."""
    street.car("Car", lambda frame: ahead(frame, begin=5.0 if frame >= 12 else 0.0))
    assert street.found() == [("jumps", "/Car", "frame 12")]
    first = Street()
    first.car("Car", lambda frame: ahead(frame, begin=5.0 if frame >= 1 else 0.0))
    assert first.found() == [("jumps", "/Car", "frame 1")]


def test_what_is_no_road_user_jumps_where_nothing_on_a_road_is_as_fast(street):
    """13 m from frame 11 to 12 are 130 m/s; 11 m are 110 m/s, of which nothing is said."""
    for name, way in (("Far", 12.0), ("Near", 10.0)):
        street.car(name, lambda frame, way=way: ahead(frame, begin=way if frame >= 12 else 0.0), kind="pole")
    assert street.found() == [("jumps", "/Far", "frame 12")]


def test_hard_braking_is_no_jump(street):
    """1 g from 10 m/s."""
    street.car("Car", lambda frame: (0.0, min(1.0 * frame - 0.049 * frame**2, 5.1), 0.0))
    assert street.found() == []


def test_who_leaves_all_lanes_is_told_at_that_frame(street):
    """0.26 m aside a frame: 2.6 m beside the middle of a lane of 4 m at frame 10, and 2.34 m before it."""
    street.car("Car", lambda frame: ahead(frame, x=0.26 * frame))
    assert street.found() == [("leaves-lane", "/Car", "frame 10")]


def test_who_is_hidden_may_be_anywhere(street):
    car = street.car("Car", lambda frame: ahead(frame, begin=50.0 if frame >= 12 else 0.0))
    for frame, shown in ((0, "inherited"), (12, "invisible")):
        car.GetVisibilityAttr().Set(shown, float(frame))
    assert street.found() == []


def test_a_camera_that_cuts_is_told_at_its_frames(street):
    """It drives at 10 m/s, is 300 m away at frame 8, and turns round at frame 14; stopping dead at 17 is no cut."""
    eye = UsdGeom.Camera.Define(street.stage, "/Eye")
    move, turn = eye.AddTranslateOp(), eye.AddRotateXYZOp()
    for frame in range(20):
        move.Set(street.at(0.0, min(frame, 17.0) + (300.0 if frame >= 8 else 0.0), 1.5), float(frame))
        turn.Set((0.0, 180.0 if frame >= 14 else 0.0, 0.0), float(frame))
    (one,) = over_time(street.stage)
    assert (one.rule, one.path) == ("cuts", "/Eye") and "at frame 8, 14;" in one.text


LONG = [pytest.param(one, marks=pytest.mark.slow) for one in ("crossroads", "motorway")]


@pytest.mark.parametrize("recipe", ["tunnel", *LONG])
def test_a_composed_clip_has_none_but_a_car_that_was_lifted(tmp_path, recipe):
    """None of these findings as it was composed; with one car lifted by a metre, that one at frame 0."""
    compose.compose(recipe, tmp_path / "street.usda", seed=1, seconds=1.0)
    stage = Usd.Stage.Open(str(tmp_path / "street.usda"))
    assert over_time(stage) == []
    cars = stage.GetPrimAtPath("/World/Vehicles").GetChildren()
    place = next(at for car in cars if (at := car.GetAttribute("xformOp:translate")).GetNumTimeSamples())
    for code in place.GetTimeSamples():
        place.Set(place.Get(code) + Gf.Vec3d(0.0, 0.0, 1.0), code)
    told = [(one.rule, one.path, one.text.split(";")[0]) for one in over_time(stage)]
    assert told == [("floats", str(place.GetPrimPath()), "frame 0: is 1 m above the ground")]


def test_the_command_tells_of_a_car_that_floats(tmp_path):
    """One warning, with which `--strict` ends."""
    street = Street()
    street.car("Car", lambda frame: ahead(frame, z=1.0))
    UsdGeom.Camera.Define(street.stage, "/Eye")
    street.stage.GetRootLayer().Export(str(tmp_path / "street.usda"))
    done = run("check", tmp_path / "street.usda", "--strict")
    assert done.returncode == 1
    assert "warning: /Car: frame 0: is 1 m above the ground; move it onto the ground [floats]" in done.stdout
