"""Skinned people: posed at the frame, on a copy; the stage that was given stays as it is."""

import numpy as np
import pytest
from pxr import Gf, Sdf, UsdGeom, UsdSkel, Vt
from support.looks import fill

from synfog_usd.translate import translate


def arm(stage, path):
    """A quad of two joints: the lower two points hang on the first, the upper two on the second."""
    UsdSkel.Root.Define(stage, path)
    joints = ["Shoulder", "Shoulder/Elbow"]
    rest = Vt.Matrix4dArray([Gf.Matrix4d(1), Gf.Matrix4d().SetTranslate((0, 0, 1))])
    skeleton = UsdSkel.Skeleton.Define(stage, f"{path}/Skeleton")
    fill(skeleton, joints=joints, bindTransforms=rest, restTransforms=rest)
    animation = UsdSkel.Animation.Define(stage, f"{path}/Wave")
    fill(animation, joints=joints, translations=[(0, 0, 0), (0, 0, 1)], scales=Vt.Vec3hArray([(1, 1, 1)] * 2))
    turns = animation.CreateRotationsAttr()
    for frame, degrees in ((1, 0.0), (2, 90.0)):
        turn = Gf.Quatf(Gf.Rotation((0, 1, 0), degrees).GetQuat())
        turns.Set(Vt.QuatfArray([Gf.Quatf(1), turn]), frame)
    mesh = UsdGeom.Mesh.Define(stage, f"{path}/Mesh")
    fill(mesh, points=[(0, 0, 0), (0.1, 0, 0), (0.1, 0, 2), (0, 0, 2)], faceVertexCounts=[4])
    fill(mesh, faceVertexIndices=[0, 1, 2, 3], subdivisionScheme="none")
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets([f"{path}/Skeleton"])
    binding.CreateJointIndicesPrimvar(False, 1).Set([0, 0, 1, 1])
    binding.CreateJointWeightsPrimvar(False, 1).Set([1.0] * 4)
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([f"{path}/Wave"])


WAVED = [(0, 0, 0), (0.1, 0, 0), (1, 0, 0.9), (1, 0, 1)]
"""By hand: the upper points turn 90 degrees about Y around the elbow at z = 1, (x, z) -> (z - 1, 1 - x)."""


def drawn(stage, **choice):
    scene = translate(stage, **choice)
    points = [part["positions"] for key, part in scene.world.items() if key.startswith("shape_")]
    return np.concatenate(points)


def test_a_pose_is_that_of_the_frame(empty):
    stage = empty()
    arm(stage, "/Arm")
    layers = [layer.ExportToString() for layer in (stage.GetRootLayer(), stage.GetSessionLayer())]
    np.testing.assert_allclose(drawn(stage, frame=1), [(0, 0, 0), (0.1, 0, 0), (0.1, 0, 2), (0, 0, 2)], atol=1e-6)
    np.testing.assert_allclose(drawn(stage, frame=2), WAVED, atol=1e-6)
    assert layers == [layer.ExportToString() for layer in (stage.GetRootLayer(), stage.GetSessionLayer())]


@pytest.mark.parametrize("interpolation", ["vertex", "faceVarying"])
@pytest.mark.parametrize("name", ["normals", "primvars:normals", "primvars:normals:indices"])
def test_normals_turn_with_the_bones(empty, name, interpolation):
    """However they are authored; by hand, (x, z) -> (z, -x) for what hangs on the elbow."""
    stage = empty()
    arm(stage, "/Arm")
    mesh = UsdGeom.Mesh.Get(stage, "/Arm/Mesh")
    told = [(0.6, -0.8, 0)]
    if name == "normals":
        mesh.CreateNormalsAttr(told * 4)
        mesh.SetNormalsInterpolation(interpolation)
    else:
        primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("normals", Sdf.ValueTypeNames.Normal3fArray, interpolation)
        primvar.Set(told if name.endswith("indices") else told * 4)
        if name.endswith("indices"):
            primvar.SetIndices(Vt.IntArray([0] * 4))
    (part,) = [part for key, part in translate(stage, frame=2).world.items() if key.startswith("shape_")]
    below = np.isclose(part["positions"][:, 2], 0.0)
    np.testing.assert_allclose(part["normals"][below], [(0.6, -0.8, 0)] * below.sum(), atol=1e-6)
    np.testing.assert_allclose(part["normals"][~below], [(0, -0.8, -0.6)] * (~below).sum(), atol=1e-6)
    assert below.sum() >= 2 and (~below).sum() >= 2


def test_characters_in_instances_are_posed_too(empty):
    """A prototype cannot be written to, so instances that hold characters are opened on the copy."""
    stage = empty()
    stage.CreateClassPrim("/Proto")
    arm(stage, "/Proto/Arm")
    for number in range(2):
        prim = stage.DefinePrim(f"/Person{number}", "Xform")
        prim.GetReferences().AddInternalReference("/Proto")
        prim.SetInstanceable(True)
        UsdGeom.Xformable(prim).AddTranslateOp().Set((0.0, 5.0 * number, 0.0))
    wanted = np.concatenate([WAVED, np.add(WAVED, [0, 5, 0])])
    np.testing.assert_allclose(drawn(stage, frame=2), wanted, atol=1e-6)
