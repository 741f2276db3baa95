"""Lanes of a stage: guide curves with a type, in metres, Z up, from the scene's origin."""

import numpy as np
import pytest
from pxr import Gf, Sdf, UsdGeom
from support.looks import fill

from synfog_usd.translate import translate


def lane(stage, path, points, counts=(2, 2), kind="linear"):
    curves = UsdGeom.BasisCurves.Define(stage, path)
    fill(curves, type=kind, curveVertexCounts=list(counts), points=points, purpose="guide")
    curves.GetPrim().CreateAttribute("synfog:lane:type", Sdf.ValueTypeNames.Token).Set("driving")
    return curves


def test_a_lane_arrives_in_metres_and_z_up(empty):
    stage = empty(metres_per_unit=0.01)
    made = lane(stage, "/Lane", [(0, 0, 0), (0, 900, 0), (350, 0, 0), (350, 900, 0)])
    UsdGeom.Xformable(made).AddTranslateOp().Set(Gf.Vec3d(0.0, 10000.0, 5.0))
    scene = translate(stage)
    (found,) = scene.lanes
    assert (found.path, found.type) == ("/Lane", "driving")
    np.testing.assert_allclose(found.left + scene.origin_m, [[0.0, 100.0, 0.05], [0.0, 109.0, 0.05]], atol=1e-6)
    np.testing.assert_allclose(found.right + scene.origin_m, [[3.5, 100.0, 0.05], [3.5, 109.0, 0.05]], atol=1e-6)
    assert not scene.notes and not any(key.startswith("shape") for key in scene.world)


@pytest.mark.parametrize(
    "words", [{"counts": (4,)}, {"counts": (1, 3)}, {"counts": (2, 3)}, {"kind": "cubic"}, {"bad": float("nan")}]
)
def test_what_is_no_pair_of_edges_is_told(empty, words):
    stage = empty()
    x = words.pop("bad", 3.5)
    lane(stage, "/Lane", [(0, 0, 0), (0, 9, 0), (x, 0, 0), (3.5, 9, 0)], **words)
    scene = translate(stage)
    assert scene.lanes == ()
    (note,) = [one for one in scene.notes if one.path == "/Lane"]
    assert note.severity == "warning" and "two curves" in note.text
