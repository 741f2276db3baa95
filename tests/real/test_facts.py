"""Real files, fact by fact, against a reading of the same prims that shares no code with the translation."""

import math
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest
from pxr import Usd, UsdGeom, UsdShade

from synfog_usd.translate import translate

REAL = Path(__file__).resolve().parents[3] / "shared" / "usd"
CARS = REAL / "vehicles/USD_Mini_Car_Kit/assets/vehicles"
BLENDER = REAL / "blender501/street_zup.usda"


def alone(path):
    """A model by itself on a stage of metres, Y up, as its file has it."""
    if not path.is_file():
        pytest.skip(f"no {path}")
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, "Y")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.Camera.Define(stage, "/Camera")
    stage.DefinePrim("/Instance").GetReferences().AddReference(str(path))
    return stage


def diffuse(prim):
    """diffuseColor of the material bound to a prim: as authored, or the lower left texel of its picture (all of the
    kit's are of one colour).
    """
    material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
    shader = material.ComputeSurfaceSource()[0]
    source = shader.GetInput("diffuseColor").GetValueProducingAttributes()[0]
    value = source.Get()
    if value is None:
        picture = OpenImageIO.ImageBuf(UsdShade.Shader(source.GetPrim()).GetInput("file").Get().resolvedPath)
        code = np.array(picture.getpixel(0, picture.spec().height - 1))[:3]
        value = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
    return tuple(np.round(value, 4).tolist())


def read(stage):
    """Triangles by diffuse colour, and the corners of the box around all meshes (Z up), by pxr and schoolbook
    arithmetic.
    """
    by_color, low, high = {}, np.full(3, np.inf), np.full(3, -np.inf)
    for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
        if not prim.IsA(UsdGeom.Mesh):
            continue
        mesh = UsdGeom.Mesh(prim)
        matrix = np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(0.0))
        world = (
            np.c_[np.array(mesh.GetPointsAttr().Get(), dtype=float), np.ones(len(mesh.GetPointsAttr().Get()))] @ matrix
        )
        used = world[np.unique(mesh.GetFaceVertexIndicesAttr().Get()), :3]
        turned = np.stack([used[:, 0], -used[:, 2], used[:, 1]], axis=1)
        low, high = np.minimum(low, turned.min(axis=0)), np.maximum(high, turned.max(axis=0))
        counts = np.array(mesh.GetFaceVertexCountsAttr().Get())
        left = set(range(len(counts)))
        for subset in UsdGeom.Subset.GetAllGeomSubsets(mesh):
            if subset.GetFamilyNameAttr().Get() == "materialBind":
                faces = list(subset.GetIndicesAttr().Get())
                left -= set(faces)
                color = diffuse(subset.GetPrim())
                by_color[color] = by_color.get(color, 0) + int((counts[faces] - 2).sum())
        if left:
            color = diffuse(prim)
            by_color[color] = by_color.get(color, 0) + int((counts[sorted(left)] - 2).sum())
    return by_color, low, high


def drawn(scene):
    """The same from what the translation made."""
    by_color, low, high = {}, np.full(3, np.inf), np.full(3, -np.inf)

    def take(shape, matrix):
        nonlocal low, high
        bsdf = scene.world[shape["bsdf"]["id"]]
        while "bsdf" in bsdf:
            bsdf = bsdf["bsdf"]
        color = tuple(np.round(bsdf["base_color"]["value"], 4).tolist())
        by_color[color] = by_color.get(color, 0) + len(shape["faces"])
        points = shape["positions"][np.unique(shape["faces"])] @ matrix[:3, :3].T + matrix[:3, 3] + scene.origin_m
        low, high = np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))

    for key, part in scene.world.items():
        if key.startswith("shape_"):
            take(part, np.eye(4))
        elif key.startswith("instance_"):
            for name, shape in scene.world[part["shapegroup"]["id"]].items():
                if name != "type":
                    take(shape, part["to_world"])
    return by_color, low, high


@pytest.mark.parametrize("name", ["4wd", "ambulance", "formula", "sedan", "tractor", "truckFlat", "van"])
def test_cars_are_drawn_triangle_by_triangle(name):
    """Every material has its triangles (n - 2 for n corners), and the box in metres agrees to 1e-4."""
    stage = alone(CARS / name / "asset" / f"{name}FullAsset.usda")
    wanted, low, high = read(stage)
    found, its_low, its_high = drawn(translate(stage))
    assert found == wanted
    np.testing.assert_allclose([its_low, its_high], [low, high], atol=1e-4)


@pytest.mark.parametrize("name, triangles, textures", [("CesiumMan", 4672, 1), ("RiggedFigure", 256, 0)])
def test_people_keep_their_triangles_and_textures(name, triangles, textures):
    """Triangle counts of the glTF originals (14 016 and 768 indices over 3); bodies are measured elsewhere."""
    world = translate(alone(REAL / "people" / name / f"{name}.usdz")).world
    assert sum(len(part["faces"]) for key, part in world.items() if key.startswith("shape_")) == triangles
    colours = [part["bsdf"]["base_color"] for key, part in world.items() if key.startswith("mat_")]
    assert sum(colour["type"] == "bitmap" for colour in colours) == textures


@pytest.fixture(scope="module")
def street():
    if not BLENDER.is_file():
        pytest.skip(f"no {BLENDER}")
    return translate(Usd.Stage.Open(str(BLENDER)))


def test_blenders_lamps_shine_with_their_watts(street):
    """In the .blend: 100 W (2 x 0.5 m, and a disk of 0.5 m), 1000 W (a tinted ball of 0.1 m), a spot of 500 W; P / (pi
    A), and P / (4 pi) in candela.
    """
    shapes = [part for key, part in street.world.items() if key.startswith("shape_") and "emitter" in part]
    found = {part["type"]: part["emitter"]["radiance"]["value"] for part in shapes}
    np.testing.assert_allclose(
        found["sphere"], 1000 / (math.pi * 4 * math.pi * 0.1**2) * np.array([1, 0.8, 0.5]), rtol=0.02
    )
    np.testing.assert_allclose(found["rectangle"], 100 / (math.pi * 2 * 0.5), rtol=0.02)
    np.testing.assert_allclose(found["disk"], 100 / (math.pi * math.pi * 0.5**2), rtol=0.02)
    spot = next(part for part in street.world.values() if part != "scene" and part["type"] == "photometric")
    np.testing.assert_allclose(spot["intensity"]["value"], 500 / (4 * math.pi), rtol=0.02)


def test_blenders_subdivided_monkey_is_smooth(street):
    """Suzanne's cage of 500 faces becomes 4^2 quads each; its limit surface lies within the box of its cage."""
    stage = Usd.Stage.Open(str(BLENDER))
    mesh = next(
        prim
        for prim in stage.Traverse()
        if prim.IsA(UsdGeom.Mesh) and UsdGeom.Mesh(prim).GetSubdivisionSchemeAttr().Get() == "catmullClark"
    )
    cage = np.array(UsdGeom.Mesh(mesh).GetPointsAttr().Get(), dtype=float)
    matrix = np.array(UsdGeom.Xformable(mesh).ComputeLocalToWorldTransform(0.0))
    world = (np.c_[cage, np.ones(len(cage))] @ matrix)[:, :3]
    corners = len(UsdGeom.Mesh(mesh).GetFaceVertexIndicesAttr().Get())
    instance = next(instance for instance in street.instances if instance.path.startswith(str(mesh.GetPath())))
    shape = street.world[next(key for key, number in street.instance_of.items() if number == instance.id)[0]]
    assert len(shape["faces"]) == 2 * 4 * corners  # one quad for each corner, then four for each quad
    points = shape["positions"] + street.origin_m
    assert (points.min(axis=0) >= world.min(axis=0) - 1e-6).all() and (
        points.max(axis=0) <= world.max(axis=0) + 1e-6
    ).all()
    assert (np.ptp(points, axis=0) > 0.9 * np.ptp(world, axis=0)).all()
