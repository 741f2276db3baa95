"""Translation of large stages: time, and what copies cost."""

import resource
import subprocess
import sys
import time

import numpy as np
import OpenImageIO
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, Vt

from synfog_usd import stage as usd
from synfog_usd.translate import summary, translate

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
    assert summary(scene)["triangles"] == 12 * PRIMS // 2
    assert spent < 10.0


def parking(path, cars, texture):
    """Instances of one car: 20 000 triangles with a texture."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, "Z")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.Camera.Define(stage, "/Camera")
    stage.CreateClassPrim("/Car")
    n = 101
    y, x = np.mgrid[:n, :n].astype(np.float32)
    first = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    mesh = UsdGeom.Mesh.Define(stage, "/Car/Body")
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.stack([x, y, np.sin(x) * np.cos(y)], axis=-1).reshape(-1, 3)))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray([4] * len(first)))
    mesh.CreateFaceVertexIndicesAttr(
        Vt.IntArray.FromNumpy(np.stack([first, first + 1, first + n + 1, first + n], axis=1).astype(np.int32).ravel())
    )
    mesh.CreateSubdivisionSchemeAttr("none")
    UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, "vertex").Set(
        Vt.Vec2fArray.FromNumpy(np.stack([x, y], axis=-1).reshape(-1, 2) / np.float32(n))
    )
    for number in range(10):
        material = UsdShade.Material.Define(stage, f"/Car/Paint{number}")
        surface = UsdShade.Shader.Define(stage, f"/Car/Paint{number}/Surface")
        surface.CreateIdAttr("UsdPreviewSurface")
        picture = UsdShade.Shader.Define(stage, f"/Car/Paint{number}/Picture")
        picture.CreateIdAttr("UsdUVTexture")
        picture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(str(texture))
        reader = UsdShade.Shader.Define(stage, f"/Car/Paint{number}/Reader")
        reader.CreateIdAttr("UsdPrimvarReader_float2")
        reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
        picture.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(
            reader.CreateOutput("result", Sdf.ValueTypeNames.Float2)
        )
        surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(
            picture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
        )
        surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(0.1 * number)
        material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", Sdf.ValueTypeNames.Token))
        subset = UsdGeom.Subset.Define(stage, f"/Car/Body/Part{number}")
        subset.CreateIndicesAttr(Vt.IntArray.FromNumpy(np.arange(number * 1000, number * 1000 + 1000, dtype=np.int32)))
        subset.CreateElementTypeAttr("face")
        subset.CreateFamilyNameAttr("materialBind")
        UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(material)
    for number in range(cars):
        prim = stage.DefinePrim(f"/Cars/C{number}", "Xform")
        prim.GetReferences().AddInternalReference("/Car")
        prim.SetInstanceable(True)
        UsdGeom.Xformable(prim).AddTranslateOp().Set((number % 40 * 6.0, number // 40 * 3.0, 0.0))
    stage.Save()


PROGRAM = """
import re, sys
from synfog_usd import stage as usd
from synfog_usd.translate import summary, translate
stage = usd.open_stage(sys.argv[1])
def peak_kb():
    return int(re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read())[1])
before = peak_kb()
scene = translate(stage)
found = summary(scene)
print(peak_kb() - before, found["triangles"], found["triangles_drawn"], found["textures"])
"""


def test_a_thousand_cars_cost_the_memory_of_one(tmp_path):
    """Instances share geometry and their ten materials one 64 MB picture: a thousand cost at most 20 MB more than two,
    in processes of their own.
    """
    picture = tmp_path / "paint.png"
    out = OpenImageIO.ImageOutput.create(str(picture))
    out.open(str(picture), OpenImageIO.ImageSpec(4096, 4096, 4, "uint8"))
    pixels = np.zeros((4096, 4096, 4), dtype=np.uint8)
    pixels[::2, ::3] = 200
    out.write_image(pixels)
    out.close()
    found = {}
    for cars in (2, 1000):
        parking(tmp_path / f"{cars}.usda", cars, picture)
        done = subprocess.run(
            [sys.executable, "-c", PROGRAM, str(tmp_path / f"{cars}.usda")],
            capture_output=True,
            text=True,
            check=True,
            timeout=300,
        )
        found[cars] = list(map(int, done.stdout.split()))
        print(f"{cars} cars: {found[cars][0] / 1024:.0f} MB for {found[cars][2]} triangles drawn")
    (few_kb, stored, _, textures), (many_kb, also, drawn, _) = found[2], found[1000]
    assert (stored, also, drawn, textures) == (20_000, 20_000, 20_000_000, 1)
    assert many_kb - few_kb < 20 * 1024


def test_opening_is_not_translating(tmp_path):
    """`open_stage` with its own counts and checks stays below 20 s for as many prims."""
    town(tmp_path / "town.usdc", PRIMS)
    began = time.process_time()
    usd.open_stage(tmp_path / "town.usdc")
    assert time.process_time() - began < 20.0
