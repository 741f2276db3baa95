"""Frames and velocities of labelled prims, as the stage tells them."""

import numpy as np
import pytest
from pxr import Gf, Sdf, UsdGeom
from support.looks import fill

from synfog_usd.translate import translate


def car(stage, path, place=(0.0, 0.0, 0.0), turn_z=0.0):
    form = UsdGeom.Xform.Define(stage, path)
    form.AddTranslateOp().Set(Gf.Vec3d(*place))
    form.AddRotateZOp().Set(turn_z)
    prim = form.GetPrim()
    prim.AddAppliedSchema("SemanticsLabelsAPI:cityscapes")
    prim.CreateAttribute("semantics:labels:cityscapes", Sdf.ValueTypeNames.TokenArray).Set(["car"])
    UsdGeom.Cube.Define(stage, f"{path}/Body")
    return form


def only(stage, frame=None):
    (instance,) = translate(stage, frame=frame).instances
    return instance


def test_a_frame_is_that_of_the_labelled_prim(empty):
    """Not of the shape below it; turned by 30 degrees, in metres, from the scene's origin."""
    stage = empty(metres_per_unit=0.01)
    car(stage, "/Car", (100.0, 2000.0, 50.0), 30.0)
    made = translate(stage)
    frame = made.instances[0].frame
    np.testing.assert_allclose(frame[:3, 3] + made.origin_m, [1.0, 20.0, 0.5], atol=1e-9)
    np.testing.assert_allclose(frame[:2, 0] * 100.0, [np.cos(np.pi / 6), np.sin(np.pi / 6)], atol=1e-9)
    assert made.instances[0].velocity_m_s is None


def test_points_of_an_instancer_have_frames_of_their_own(empty):
    stage = empty()
    instancer = UsdGeom.PointInstancer.Define(stage, "/Cars")
    car(stage, "/Cars/Prototypes/Car")
    instancer.CreatePrototypesRel().SetTargets(["/Cars/Prototypes/Car"])
    fill(instancer, protoIndices=[0, 0], positions=[(1.0, 20.0, 0.0), (5.0, 30.0, 0.0)])
    made = translate(stage)
    places = [instance.frame[:3, 3] + made.origin_m for instance in made.instances]
    np.testing.assert_allclose(places, [[1.0, 20.0, 0.0], [5.0, 30.0, 0.0]], atol=1e-6)


@pytest.mark.parametrize("frame", [1.0, 12.0, 25.0])
def test_a_prim_that_moves_has_the_speed_of_its_key_frames(empty, frame):
    """50 m in 24 frames of 24 a second, at either end of the range too; one that stands still has none."""
    stage = empty()
    stage.SetStartTimeCode(1.0)
    stage.SetEndTimeCode(25.0)
    stage.SetTimeCodesPerSecond(24.0)
    moves = car(stage, "/Car", (0.0, 20.0, 0.0)).GetOrderedXformOps()[0]
    moves.Set(Gf.Vec3d(0.0, 20.0, 0.0), 1.0)
    moves.Set(Gf.Vec3d(0.0, 70.0, 0.0), 25.0)
    car(stage, "/Parked", (3.0, 10.0, 0.0))
    found = {instance.path: instance.velocity_m_s for instance in translate(stage, frame=frame).instances}
    np.testing.assert_allclose(found["/Car"], [0.0, 50.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(found["/Parked"], [0.0, 0.0, 0.0], atol=1e-6)


def test_an_authored_velocity_is_taken_in_the_axes_of_the_parent(empty):
    """UsdPhysics' attribute, on a still stage in centimetres whose group is turned by 90 degrees."""
    stage = empty(metres_per_unit=0.01)
    group = UsdGeom.Xform.Define(stage, "/Group")
    group.AddRotateZOp().Set(90.0)
    prim = car(stage, "/Group/Car", (2000.0, 0.0, 0.0)).GetPrim()
    prim.CreateAttribute("physics:velocity", Sdf.ValueTypeNames.Vector3f).Set(Gf.Vec3f(1500.0, 0.0, 0.0))
    np.testing.assert_allclose(only(stage).velocity_m_s, [0.0, 15.0, 0.0], atol=1e-5)


def test_a_y_up_stage_gives_poses_with_z_up(empty):
    stage = empty(up="Y")
    car(stage, "/Car", (0.0, 1.0, -20.0))
    made = translate(stage)
    np.testing.assert_allclose(made.instances[0].frame[:3, 3] + made.origin_m, [0.0, 20.0, 1.0], atol=1e-6)
