"""Units, axes and the origin: the same world in other words is the same scene."""

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdLux
from support.looks import fill

from synfog_usd.translate import translate

BOX = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
QUADS = [0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3]


def street(up, metres_per_unit, far=0.0):
    """One world, authored with another up axis or unit: a box, a ball, a lamp, fog and a camera."""

    def vector(x, y, z):
        x, y, z = (c / metres_per_unit for c in (x + far, y, z))
        return Gf.Vec3d(x, y, z) if up == "Z" else Gf.Vec3d(x, z, -y)

    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, up)
    UsdGeom.SetStageMetersPerUnit(stage, metres_per_unit)
    one = 1.0 / metres_per_unit
    mesh = UsdGeom.Mesh.Define(stage, "/Box")
    fill(mesh, points=[vector(*p) - vector(0, 0, 0) for p in BOX], faceVertexCounts=[4] * 6, faceVertexIndices=QUADS)
    fill(mesh, subdivisionScheme="none")
    mesh.AddTranslateOp().Set(vector(2, 20, 0))
    ball = fill(UsdGeom.Sphere.Define(stage, "/Ball"), radius=0.5 * one)
    ball.AddTranslateOp().Set(vector(-2, 15, 0.5))
    lamp = fill(UsdLux.SphereLight.Define(stage, "/Lamp"), radius=0.1 * one, intensity=700)
    lamp.AddTranslateOp().Set(vector(0, 10, 6))
    fog = UsdGeom.Cube.Define(stage, "/Fog")
    fog.GetPrim().AddAppliedSchema("SynFogMediumAPI")
    fog.AddTranslateOp().Set(vector(0, 10, 24))
    fog.AddScaleOp().Set(
        Gf.Vec3f(50 * one, 50 * one, 25 * one) if up == "Z" else Gf.Vec3f(50 * one, 25 * one, 50 * one)
    )
    camera = UsdGeom.Camera.Define(stage, "/Camera")
    fill(camera, focalLength=0.35 * one, horizontalAperture=0.36 * one, verticalAperture=0.24 * one, fStop=2.8)
    fill(camera, focusDistance=12 * one)
    camera.AddTranslateOp().Set(vector(0.25, -3, 1.5))
    if up == "Z":
        camera.AddRotateXOp().Set(90.0)
    return stage


def compare(found, wanted, where=""):
    if isinstance(wanted, dict):
        assert found.keys() == wanted.keys(), where
        for key in wanted:
            compare(found[key], wanted[key], f"{where}.{key}")
    elif isinstance(wanted, (list, tuple, np.ndarray, float)):
        np.testing.assert_allclose(found, wanted, rtol=2e-6, atol=5e-6, err_msg=where)  # float32 within 50 m: 2^-19 m
    else:
        assert found == wanted, where


@pytest.mark.parametrize("up, metres_per_unit", [("Z", 0.01), ("Y", 1.0), ("Y", 0.01), ("Z", 0.3048)])
def test_units_and_up_axis_do_not_change_the_scene(up, metres_per_unit):
    """Centimetres, feet and Y up give the scene that metres and Z up give."""
    wanted, found = translate(street("Z", 1.0)), translate(street(up, metres_per_unit))
    compare(dict(found.world), dict(wanted.world))
    compare(vars(found.camera) | {"path": ""}, vars(wanted.camera) | {"path": ""})
    for one, other in zip(found.fog, wanted.fog, strict=True):
        unit = np.abs(other.boundary.to_world[:3, :3]).sum(axis=1)
        np.testing.assert_allclose(
            np.abs(one.boundary.to_world[:3, :3]).sum(axis=1), unit, rtol=2e-6
        )  # a cube may be turned by its symmetry
        compare(one.boundary.to_world[:3, 3], other.boundary.to_world[:3, 3])
        compare(vars(one.medium), vars(other.medium))
    compare(found.origin_m, wanted.origin_m)


def test_the_origin_is_the_camera_rounded_to_whole_metres():
    scene = translate(street("Z", 1.0))
    assert scene.origin_m == (0.0, -3.0, 2.0)
    np.testing.assert_allclose(scene.camera.to_world[:3, 3], [0.25, 0.0, -0.5], atol=1e-12)


def test_a_street_at_city_coordinates_keeps_its_precision():
    """500 km away float32 has steps of 3 cm; what is subtracted in double leaves the vertices as they were."""
    near, far = translate(street("Z", 1.0)), translate(street("Z", 1.0, far=500_000.0))
    compare(dict(far.world), dict(near.world))
    assert far.origin_m[0] == 500_000.0


def test_a_stage_with_x_up_is_drawn_with_x_up(empty, only_shape):
    """(1, 2, 3) of such a stage is 1 m up; it was drawn lying, without a word."""
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetMetadata("upAxis", "X")
    UsdGeom.Camera.Define(stage, "/Camera").AddTranslateOp().Set((1, 2, 3))
    scene = translate(stage)
    np.testing.assert_allclose(np.add(scene.camera.to_world[:3, 3], scene.origin_m), (2, 3, 1))
    assert np.linalg.det(scene.camera.to_world[:3, :3]) == pytest.approx(1.0)
    assert [note.text for note in scene.notes if note.severity == "warning"] == [
        "upAxis is 'X', and USD knows Y and Z alone; drawn with X up"
    ]
