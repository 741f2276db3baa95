"""What instances cost: memory."""

import json
import subprocess
import sys

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdLux, Vt

pytestmark = pytest.mark.bench

CHILD = """
import json, resource, sys, time
from synfog_usd.base.errors import StageError
from synfog_usd.render.load import to_mitsuba
from synfog_usd.stage import open_stage
from synfog_usd.translate import translate
begin = time.process_time()
try:
    to_mitsuba(translate(open_stage(sys.argv[1]), resolution=tuple(map(int, sys.argv[2:4]))))
    said = "drawn"
except StageError as error:
    said = str(error)
memory_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(json.dumps([said, time.process_time() - begin, memory_mb]))
"""


def crowd(path, instances, triangles):
    """Bumpy sheets of a metre, 1.3 m apart, around a camera."""
    side = max(int((triangles / 2) ** 0.5), 1)
    y, x = np.mgrid[: side + 1, : side + 1] / side
    points = np.stack([x - 0.5, y - 0.5, 0.1 * np.sin(9 * x) * np.cos(7 * y)], axis=-1).reshape(-1, 3)
    first = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    quads = np.stack([first, first + 1, first + side + 2, first + side + 1], axis=1)
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, "Z")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    camera = UsdGeom.XformCommonAPI(UsdGeom.Camera.Define(stage, "/Camera"))
    camera.SetTranslate((0, -5, 2))
    camera.SetRotate((85, 0, 0))
    UsdLux.DomeLight.Define(stage, "/Sky").CreateIntensityAttr(1000.0)
    many = UsdGeom.PointInstancer.Define(stage, "/Many")
    mesh = UsdGeom.Mesh.Define(stage, "/Many/Sheet")
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points.astype(np.float32)))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(quads), 4, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(quads.ravel().astype(np.int32)))
    mesh.CreateSubdivisionSchemeAttr("none")
    many.CreatePrototypesRel().SetTargets(["/Many/Sheet"])
    many.CreateProtoIndicesAttr(Vt.IntArray.FromNumpy(np.zeros(instances, np.int32)))
    row = int(np.ceil(instances**0.5))
    number = np.arange(instances)
    places = np.stack([(number % row - row / 2) * 1.3, (number // row) * 1.3, 0 * number], axis=1)
    many.CreatePositionsAttr(Vt.Vec3fArray.FromNumpy(places.astype(np.float32)))
    stage.Save()


def test_200_million_triangles_stand_in_the_renderer_within_4_GB(tmp_path):
    """10 000 instances of 20 000 triangles, in a picture of 1280x720."""
    crowd(tmp_path / "a.usdc", 10_000, 20_000)
    words = [sys.executable, "-c", CHILD, str(tmp_path / "a.usdc"), "1280", "720"]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    said, seconds, memory_mb = json.loads(done.stdout.splitlines()[-1])
    print(f"200 million triangles at 1280x720: {seconds:.1f} s, {memory_mb:.0f} MB")
    assert said == "drawn" and memory_mb < 4000.0
