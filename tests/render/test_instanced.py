"""What is placed by instances covers the pixels, at the distances, that it does without them."""

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom

from synfog_usd.render.film import aovs
from synfog_usd.render.shot import load
from synfog_usd.translate import assemble, translate

FLOAT32 = 1e-5
"""Relative error of a distance that Mitsuba holds in float32, with its ray offsets."""

PLACES = [(-2.0, 10.0, 0.0), (2.0, 11.0, 0.5)]
QUADRICS = ("Sphere", "Cylinder", "Cone", "Capsule", "Plane", "Cube")


def stage_of(kind, how, metres_per_unit, *, scale=1.0, places=PLACES, fov_mm=50.0):
    """Two shapes of some units before a camera, as they are, as native instances or by a PointInstancer."""
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, "Z")
    UsdGeom.SetStageMetersPerUnit(stage, metres_per_unit)
    camera = UsdGeom.Camera.Define(stage, "/Camera")
    camera.AddTransformOp().Set(Gf.Matrix4d().SetRotate(Gf.Rotation((1, 0, 0), 90.0)))
    camera.CreateClippingRangeAttr((0.1, 1e5))
    camera.CreateHorizontalApertureAttr(40.0)
    camera.CreateVerticalApertureAttr(20.0)
    camera.CreateFocalLengthAttr(fov_mm)
    stage.CreateClassPrim("/Model")
    turned(stage.DefinePrim("/Model/Shape", kind))
    if how == "points":
        made = UsdGeom.PointInstancer.Define(stage, "/Points")
        turned(stage.DefinePrim("/Points/Shape", kind))
        made.CreatePrototypesRel().AddTarget("/Points/Shape")
        made.CreateProtoIndicesAttr([0] * len(places))
        made.CreatePositionsAttr([tuple(scale * c for c in place) for place in places])
        made.CreateScalesAttr([(scale,) * 3] * len(places))
        return stage
    for number, place in enumerate(places):
        placed = UsdGeom.Xform.Define(stage, f"/Placed{number}")
        placed.GetPrim().GetReferences().AddInternalReference("/Model")
        placed.AddTranslateOp().Set(tuple(scale * c for c in place))
        placed.AddScaleOp().Set((scale,) * 3)
        placed.GetPrim().SetInstanceable(how == "native")
    return stage


def turned(prim):
    UsdGeom.Xformable(prim).AddRotateXOp().Set(50.0)


def measured(stage):
    return aovs.measure(load(translate(stage, resolution=(96, 48))))


@pytest.mark.parametrize(
    "kind, metres_per_unit, scale, how",
    [
        ("Sphere", 1e-3, 1.0, "native"),
        ("Sphere", 1.0, 1e4, "native"),
        *[(kind, 0.01, 1.0, "points") for kind in QUADRICS],
    ],
)
def test_instances_cover_what_copies_do(kind, metres_per_unit, scale, how):
    plain = measured(stage_of(kind, "plain", metres_per_unit, scale=scale))
    found = measured(stage_of(kind, how, metres_per_unit, scale=scale))
    assert (plain.instance_id > 0).sum() > 300 and set(np.unique(plain.instance_id)) == {0, 1, 2}
    np.testing.assert_array_equal(found.instance_id, plain.instance_id)
    np.testing.assert_allclose(found.distance_m, plain.distance_m, rtol=FLOAT32)


def test_many_balls_are_meshes_of_the_same_size(monkeypatch):
    """Beyond so many instances, by which each ball has its faces: 5120 here, which lie within 0.05 % of its radius."""
    plain = measured(stage_of("Sphere", "plain", 0.01))
    monkeypatch.setattr(assemble, "MOST_BALLS", 1)
    found = measured(stage_of("Sphere", "points", 0.01))
    off = found.instance_id != plain.instance_id
    assert off.sum() <= 0.01 * (plain.instance_id > 0).sum()
    inner = ~off & (plain.normal[..., 1] < -0.5)
    np.testing.assert_allclose(found.distance_m[inner], plain.distance_m[inner], rtol=3e-4)
