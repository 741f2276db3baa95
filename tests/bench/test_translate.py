"""Translation of large stages: time, and what copies cost."""

import resource
import time

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, Vt

from synfog_usd.translate import translate

pytestmark = pytest.mark.bench

PRIMS = 100_000


def header(layer):
    layer.pseudoRoot.SetInfo("upAxis", "Z")
    layer.pseudoRoot.SetInfo("metersPerUnit", 1.0)
    camera = Sdf.PrimSpec(layer, "Camera", Sdf.SpecifierDef, "Camera")
    Sdf.AttributeSpec(camera, "focalLength", Sdf.ValueTypeNames.Float).default = 35.0


def town(path, count):
    """`count` prims: half of them Xforms, each with a box of its own size."""
    layer = Sdf.Layer.CreateNew(str(path))
    rng = np.random.default_rng(1)
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float32)
    quads = Vt.IntArray([0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3])
    with Sdf.ChangeBlock():
        header(layer)
        for number in range(count // 2):
            parent = Sdf.PrimSpec(layer, f"X{number}", Sdf.SpecifierDef, "Xform")
            place = Sdf.AttributeSpec(parent, "xformOp:translate", Sdf.ValueTypeNames.Double3)
            place.default = Gf.Vec3d(*map(float, rng.uniform(-500, 500, 3)))
            order = Sdf.AttributeSpec(parent, "xformOpOrder", Sdf.ValueTypeNames.TokenArray, Sdf.VariabilityUniform)
            order.default = Vt.TokenArray(["xformOp:translate"])
            mesh = Sdf.PrimSpec(parent, "Mesh", Sdf.SpecifierDef, "Mesh")
            for name, kind, value in (
                (
                    "points",
                    Sdf.ValueTypeNames.Point3fArray,
                    Vt.Vec3fArray.FromNumpy(corners * np.float32(rng.uniform(0.5, 5))),
                ),
                ("faceVertexCounts", Sdf.ValueTypeNames.IntArray, Vt.IntArray([4] * 6)),
                ("faceVertexIndices", Sdf.ValueTypeNames.IntArray, quads),
                ("subdivisionScheme", Sdf.ValueTypeNames.Token, "none"),
            ):
                Sdf.AttributeSpec(
                    mesh,
                    name,
                    kind,
                    Sdf.VariabilityUniform if kind == Sdf.ValueTypeNames.Token else Sdf.VariabilityVarying,
                ).default = value
    layer.Save()


def test_a_hundred_thousand_prims_take_less_than_ten_seconds(tmp_path):
    """Beyond opening the stage, by the processor's own time: half of them are boxes of six quads, all different."""
    town(tmp_path / "town.usdc", PRIMS)
    stage = Usd.Stage.Open(str(tmp_path / "town.usdc"))
    began = time.process_time()
    scene = translate(stage)
    spent = time.process_time() - began
    print(
        f"{PRIMS} prims in {spent:.1f} s, {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.2f} GB at most"
    )
    assert sum(len(part.get("faces", ())) for part in scene.world.values() if part != "scene") == 12 * PRIMS // 2
    assert spent < 10.0
