"""What each command costs on files that ask for too much.

    python tests/bench/hostile_files.py [--only NAME,...] [--commands check,bake,...]

Every file is made in a child (what is started has its parent's memory at first) and given to every command that takes
such a file, in a child that is ended after a minute of the processor.
Prints processor seconds and MB of the child and all that it started, and what it said last; writes
out/hostile.csv.  The exit code is 1 where one took more than 20 s or 3 GB, ended in a trace, or did not end.  A bake
of an innocent stage is measured first: its cost, mostly of kernels that are compiled, is taken off.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdShade, Vt

MOST_S, MOST_MB, END_S = 20.0, 3000.0, 60
HEAD = '#usda 1.0\n(\n    upAxis = "Z"\n    metersPerUnit = 1\n)\n'
CAMERA = 'def Camera "Ego"\n{\n}\ndef DomeLight "Sky"\n{\n    float inputs:intensity = 1000\n}\n'
FOG = """def Cube "Fog{n}" (
    prepend apiSchemas = ["SynFogMediumAPI"]
)
{{
    uniform token purpose = "guide"
    double size = 1
    float synfog:fog:mor = {mor}
    int synfog:fog:priority = {n}
    double3 xformOp:translate = {at}
    double3 xformOp:scale = {scale}
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
}}
"""
STAGES: dict[str, Callable[[Path], None]] = {}
GRAPHS: dict[str, Callable[[Path], None]] = {}
RECIPES: dict[str, Callable[[Path], None]] = {}


def stage(make):
    STAGES[make.__name__] = make
    return make


def text(folder, body, name="stage.usda"):
    (folder / name).write_text(HEAD + CAMERA + body, encoding="utf-8")


def opened(folder):
    """A new binary stage with a camera and a sky."""
    found = Usd.Stage.CreateNew(str(folder / "stage.usdc"))
    UsdGeom.SetStageUpAxis(found, "Z")
    UsdGeom.SetStageMetersPerUnit(found, 1.0)
    UsdGeom.Camera.Define(found, "/Ego")
    UsdLux.DomeLight.Define(found, "/Sky").CreateIntensityAttr(1000.0)
    return found


def whole(values):
    return Vt.IntArray.FromNumpy(np.ascontiguousarray(values, dtype=np.int32))


def places(values):
    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values, dtype=np.float32))


def outline(folder, flat):
    """One polygon."""
    found = opened(folder)
    mesh = UsdGeom.Mesh.Define(found, "/P")
    mesh.CreatePointsAttr(places(np.c_[flat[:, 0], np.full(len(flat), -5.0), flat[:, 1]]))
    mesh.CreateFaceVertexCountsAttr(whole([len(flat)]))
    mesh.CreateFaceVertexIndicesAttr(whole(np.arange(len(flat))))
    mesh.CreateSubdivisionSchemeAttr("none")
    found.Save()


@stage
def plain(folder):
    """Nothing hostile: what each command costs anyway."""
    text(
        folder,
        'def Cube "Box"\n{\n    double3 xformOp:translate = (0, 8, 0)\n'
        '    uniform token[] xformOpOrder = ["xformOp:translate"]\n}\n',
    )


@stage
def fogs_apart_600(folder):
    text(folder, "".join(FOG.format(n=n, mor=100, at=(3 * n, 10, 0), scale=(2, 2, 2)) for n in range(600)))


@stage
def fogs_under_the_limit(folder):
    text(folder, "".join(FOG.format(n=n, mor=100, at=(3 * n, 10, 0), scale=(2, 2, 2)) for n in range(190)))


@stage
def fogs_that_cross_600(folder):
    text(folder, "".join(FOG.format(n=n, mor=100, at=(0.5 * n, 10, 0), scale=(2, 2, 2)) for n in range(600)))


@stage
def fogs_nested_300(folder):
    text(folder, "".join(FOG.format(n=n, mor=100, at=(0, 0, 0), scale=(700 - n,) * 3) for n in range(300)))


@stage
def fog_banks_10000(folder):
    text(
        folder,
        "".join(
            FOG.format(n=n, mor=100, at=(3 * (n % 100), 3 * (n // 100), 0), scale=(2, 2, 2)) for n in range(10_000)
        ),
    )


@stage
def packed_indices(folder):
    """0.1 MB that unpacks to 2.7 GB."""
    found = opened(folder)
    mesh = UsdGeom.Mesh.Define(found, "/M")
    mesh.CreateFaceVertexIndicesAttr(whole(np.zeros(700_000_000)))
    found.Save()


@stage
def packed_counts_under_the_limit(folder):
    found = opened(folder)
    for n in range(4):
        mesh = UsdGeom.Mesh.Define(found, f"/M{n}")
        mesh.CreateFaceVertexCountsAttr(whole(np.full(6_000_000, 3)))
        mesh.CreateFaceVertexIndicesAttr(whole(np.tile([0, 1, 2], 6_000_000)))
        mesh.CreatePointsAttr([(0, 5, 0), (1, 5, 0), (0, 5, 1)])
        mesh.CreateSubdivisionSchemeAttr("none")
    found.Save()


@stage
def sublayers_twice(folder):
    for level in range(17):
        for name in "ab":
            below = f"    subLayers = [@./a{level + 1}.usda@, @./b{level + 1}.usda@]\n" if level < 16 else ""
            (folder / f"{name}{level}.usda").write_text(f"#usda 1.0\n(\n{below})\n")
    (folder / "stage.usda").write_text("#usda 1.0\n(\n    subLayers = [@./a0.usda@, @./b0.usda@]\n)\n" + CAMERA)


def _doubled(levels, more="", arc="references"):
    body = 'def Xform "L0"\n{\n    def Cube "Leaf"\n    {\n    }\n}\n'
    for level in range(1, levels + 1):
        inner = "".join(
            f'    def "{k}" (\n        {more}\n        {arc} = </L{level - 1}>\n    )\n    {{\n    }}\n' for k in "ab"
        )
        body += f'def Xform "L{level}"\n{{\n{inner}}}\n'
    return body


@stage
def references_twice(folder):
    text(folder, _doubled(30))


@stage
def references_twice_under_the_limit(folder):
    """82 000 prims and references."""
    text(folder, _doubled(13))


@stage
def instances_twice(folder):
    text(folder, _doubled(40, "instanceable = true"))


@stage
def inherits_twice(folder):
    text(folder, _doubled(30, arc="inherits"))


@stage
def deep_5000(folder):
    text(folder, 'def Xform "d" {\n' * 5000 + "}\n" * 5000)


@stage
def braces_deep(folder):
    text(folder, 'def Xform "d" {\n' * 300_000 + "}\n" * 300_000)


@stage
def references_in_a_circle(folder):
    text(folder, "".join(f'def "A{n}" (\n    references = </A{(n + 1) % 150}>\n)\n{{\n}}\n' for n in range(150)))


@stage
def prims_1000000(folder):
    _rows(folder, 1000)


@stage
def prims_under_the_limit(folder):
    _rows(folder, 98)


def _rows(folder, rows):
    """A thousand prims in each row."""
    layer = Sdf.Layer.CreateNew(str(folder / "stage.usdc"))
    with Sdf.ChangeBlock():
        Sdf.PrimSpec(layer, "Ego", Sdf.SpecifierDef, "Camera")
        for row in range(rows):
            parent = Sdf.PrimSpec(layer, f"X{row}", Sdf.SpecifierDef, "Xform")
            for n in range(1000):
                Sdf.PrimSpec(parent, f"p{n}", Sdf.SpecifierDef, "Xform")
    layer.Save()


@stage
def spheres_98000(folder):
    layer = Sdf.Layer.CreateNew(str(folder / "stage.usdc"))
    with Sdf.ChangeBlock():
        Sdf.PrimSpec(layer, "Ego", Sdf.SpecifierDef, "Camera")
        for n in range(98_000):
            Sdf.PrimSpec(layer, f"p{n}", Sdf.SpecifierDef, "Sphere")
    layer.Save()


@stage
def cubes_8192_in_one_place(folder):
    text(folder, "".join(f'def Cube "C{n}"\n{{\n}}\n' for n in range(8192)))


def _lamps(folder, many, kind="SphereLight", more="", inputs=""):
    text(
        folder,
        "".join(
            f'def {kind} "L{n}"{more}\n{{\n{inputs.format(n=n % 100)}'
            f"    double3 xformOp:translate = ({n % 100}, {n // 100}, 3)\n"
            '    uniform token[] xformOpOrder = ["xformOp:translate"]\n}\n'
            for n in range(many)
        ),
    )


@stage
def lamps_20000(folder):
    _lamps(folder, 20_000)


@stage
def lamps_under_the_limit(folder):
    _lamps(folder, 5000)


@stage
def lamps_of_a_hundred_kinds(folder):
    _lamps(folder, 5000, inputs="    float inputs:intensity = 1{n}\n")


@stage
def panels_under_the_limit(folder):
    _lamps(folder, 5000, "RectLight")


@stage
def beams_under_the_limit(folder):
    _lamps(
        folder,
        5000,
        more=' (\n    prepend apiSchemas = ["ShapingAPI"]\n)',
        inputs="    float inputs:shaping:cone:angle = 40\n    float inputs:shaping:focus = 2\n",
    )


@stage
def long_string(folder):
    text(folder, f'def "A"\n{{\n    string x = "{"x" * 100_000_000}"\n}}\n')


@stage
def long_name(folder):
    text(folder, f'def "{"x" * 10_000_000}"\n{{\n}}\n')


@stage
def long_array_of_text(folder):
    text(folder, f'def Mesh "A"\n{{\n    point3f[] points = [{"(0, 0, 0), " * 4_000_000}(0, 0, 0)]\n}}\n')


@stage
def zigzag_1000000(folder):
    n = 500_000
    along, high = np.linspace(0, 1, n), np.arange(n) % 2
    outline(folder, np.r_[np.c_[along, high - 0.001], np.c_[along, high + 0.001][::-1]])


@stage
def crossing_outline_1000000(folder):
    outline(folder, np.random.default_rng(1).random((1_000_000, 2)))


@stage
def zigzags_of_4000_corners(folder):
    """A thousand faces whose ears are cut one by one."""
    n, many = 2000, 1000
    along, high = np.linspace(0, 1, n), np.arange(n) % 2
    flat = np.r_[np.c_[along, high - 0.001], np.c_[along, high + 0.001][::-1]]
    found = opened(folder)
    mesh = UsdGeom.Mesh.Define(found, "/P")
    mesh.CreatePointsAttr(places(np.c_[flat[:, 0], np.full(len(flat), -5.0), flat[:, 1]]))
    mesh.CreateFaceVertexCountsAttr(whole(np.full(many, len(flat))))
    mesh.CreateFaceVertexIndicesAttr(whole(np.tile(np.arange(len(flat)), many)))
    mesh.CreateSubdivisionSchemeAttr("none")
    found.Save()


def _instancer(folder, many):
    found = opened(folder)
    instancer = UsdGeom.PointInstancer.Define(found, "/Many")
    UsdGeom.Cube.Define(found, "/Many/Box").CreateSizeAttr(0.1)
    instancer.CreatePrototypesRel().SetTargets(["/Many/Box"])
    instancer.CreateProtoIndicesAttr(whole(np.zeros(many)))
    row = np.arange(many)
    instancer.CreatePositionsAttr(places(np.stack([row % 1000, row // 1000 + 5, 0 * row], axis=1)))
    found.Save()


@stage
def instancer_4000000(folder):
    _instancer(folder, 4_000_000)


@stage
def instancer_750000(folder):
    _instancer(folder, 750_000)


@stage
def instancers_nested(folder):
    found = opened(folder)
    target = UsdGeom.Cube.Define(found, "/Leaf").GetPath()
    for level in range(3):
        instancer = UsdGeom.PointInstancer.Define(found, f"/P{level}")
        instancer.CreatePrototypesRel().AddTarget(target)
        instancer.CreateProtoIndicesAttr([0] * 300)
        instancer.CreatePositionsAttr([(n, 0, 0) for n in range(300)])
        target = instancer.GetPath()
    found.Save()


@stage
def curves_20000000(folder):
    found = opened(folder)
    curves = UsdGeom.BasisCurves.Define(found, "/C")
    curves.CreateTypeAttr("linear")
    curves.CreateCurveVertexCountsAttr(whole(np.full(10_000_000, 2)))
    curves.CreatePointsAttr(places(np.zeros((20_000_000, 3))))
    curves.CreateWidthsAttr([0.01])
    found.Save()


@stage
def points_5000000(folder):
    found = opened(folder)
    cloud = UsdGeom.Points.Define(found, "/C")
    cloud.CreatePointsAttr(places(np.random.default_rng(1).uniform((0, 5, 0), (1, 6, 1), (5_000_000, 3))))
    cloud.CreateWidthsAttr(Vt.FloatArray.FromNumpy(np.full(5_000_000, 0.001, np.float32)))
    found.Save()


@stage
def subdivided_2000000(folder):
    side = 1000
    y, x = np.mgrid[: side + 1, : side + 1]
    first = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    found = opened(folder)
    for n in range(2):
        mesh = UsdGeom.Mesh.Define(found, f"/M{n}")
        mesh.CreatePointsAttr(places(np.stack([x, y + 5, 0 * x], axis=-1).reshape(-1, 3)))
        mesh.CreateFaceVertexCountsAttr(whole(np.full(len(first), 4)))
        mesh.CreateFaceVertexIndicesAttr(
            whole(np.stack([first, first + 1, first + side + 2, first + side + 1], 1).ravel())
        )
    found.Save()


@stage
def patch_of_4000000(folder):
    found = opened(folder)
    patch = UsdGeom.NurbsPatch.Define(found, "/N")
    n = 2000
    patch.CreateUVertexCountAttr(n)
    patch.CreateVVertexCountAttr(n)
    patch.CreateUOrderAttr(4)
    patch.CreateVOrderAttr(4)
    for make in (patch.CreateUKnotsAttr, patch.CreateVKnotsAttr):
        make(Vt.DoubleArray.FromNumpy(np.arange(n + 4.0)))
    y, x = np.mgrid[:n, :n]
    patch.CreatePointsAttr(places(np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3)))
    found.Save()


def painted(folder, name):
    found = opened(folder)
    mesh = UsdGeom.Mesh.Define(found, "/Card")
    mesh.CreatePointsAttr([(-1, 5, -1), (1, 5, -1), (1, 5, 1), (-1, 5, 1)])
    mesh.CreateFaceVertexCountsAttr([4])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
    UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, "vertex").Set(
        [(0, 0), (1, 0), (1, 1), (0, 1)]
    )
    material = UsdShade.Material.Define(found, "/Paint")
    surface = UsdShade.Shader.Define(found, "/Paint/Surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    picture = UsdShade.Shader.Define(found, "/Paint/Picture")
    picture.CreateIdAttr("UsdUVTexture")
    picture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(name)
    reader = UsdShade.Shader.Define(found, "/Paint/Reader")
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
    picture.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(
        reader.CreateOutput("result", Sdf.ValueTypeNames.Float2)
    )
    surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(
        picture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
    )
    material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", Sdf.ValueTypeNames.Token))
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    found.Save()


def _zeros(path, width, height):
    """A PNG of zeros: a thousandth of its pixels' bytes."""
    import struct
    import zlib

    def chunk(kind, content):
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    packer = zlib.compressobj(9)
    rows = b"".join(packer.compress(bytes(1 + 3 * width)) for _ in range(height)) + packer.flush()
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
        + chunk(b"IDAT", rows)
        + chunk(b"IEND", b"")
    )


@stage
def picture_of_900_megapixels(folder):
    painted(folder, "./a.png")
    _zeros(folder / "a.png", 30_000, 30_000)


@stage
def picture_under_the_limit(folder):
    painted(folder, "./a.png")
    _zeros(folder / "a.png", 8192, 8192)


@stage
def sky_of_900_megapixels(folder):
    text(folder, 'def DomeLight "Big"\n{\n    asset inputs:texture:file = @./a.png@\n}\n')
    _zeros(folder / "a.png", 30_000, 30_000)


@stage
def tiles_1000(folder):
    painted(folder, "./a.<UDIM>.png")
    _zeros(folder / "one.png", 2048, 2048)
    for n in range(1000):
        (folder / f"a.{1001 + n}.png").hardlink_to(folder / "one.png")


@stage
def fog_grid_that_unpacks_to_8_GB(folder):
    import zipfile

    text(
        folder,
        FOG.format(n=0, mor=100, at=(0, 0, 0), scale=(50, 50, 50)).replace(
            "    int synfog",
            '    token synfog:fog:profile = "grid"\n    asset synfog:fog:densityGrid = @./g.npz@\n    int synfog',
        ),
    )
    header = b"{'descr': '<f4', 'fortran_order': False, 'shape': (1280, 1280, 1280), }".ljust(117) + b"\n"
    with (
        zipfile.ZipFile(folder / "g.npz", "w", zipfile.ZIP_DEFLATED) as packer,
        packer.open("density.npy", "w", force_zip64=True) as out,
    ):
        out.write(b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)
        for _ in range(1280):
            out.write(bytes(4 * 1280 * 1280))


@stage
def variants_1000_by_1000(folder):
    """A million shots."""

    def names(word):
        inner = "".join(f'        "{word}{n}" {{\n        }}\n' for n in range(1000))
        return f'    variantSet "{word}" = {{\n{inner}    }}\n'

    (folder / "stage.usda").write_text(
        '#usda 1.0\n(\n    upAxis = "Z"\n    metersPerUnit = 1\n    defaultPrim = "W"\n)\n'
        + CAMERA
        + 'def Xform "W" (\n    prepend variantSets = ["fog", "lighting"]\n    variants = {\n'
        '        string fog = "fog0"\n'
        '        string lighting = "lighting0"\n    }\n)\n{\n' + names("fog") + names("lighting") + "}\n"
    )


@stage
def samples_1000000(folder):
    rows = "".join(f"        {n}: ({n % 7}, 5, 0),\n" for n in range(1_000_000))
    text(
        folder,
        'def Cube "A"\n{\n    double3 xformOp:translate.timeSamples = {\n'
        + rows
        + '    }\n    uniform token[] xformOpOrder = ["xformOp:translate"]\n}\n',
    )


@stage
def subsets_20000(folder):
    subsets = "".join(
        f'    def GeomSubset "s{n}"\n    {{\n        uniform token familyName = "materialBind"\n        '
        f'uniform token elementType = "face"\n        int[] indices = [{n}]\n    }}\n'
        for n in range(20_000)
    )
    faces = 20_000
    text(
        folder,
        f'def Mesh "A"\n{{\n    int[] faceVertexCounts = [{", ".join(["3"] * faces)}]\n    int[] faceVertexIndices = '
        f"[{', '.join(['0, 1, 2'] * faces)}]\n    point3f[] points = [(0, 5, 0), (1, 5, 0), (0, 5, 1)]\n"
        f'    uniform token subdivisionScheme = "none"\n{subsets}}}\n',
    )


@stage
def materials_5000(folder):
    found = opened(folder)
    for n in range(5000):
        cube = UsdGeom.Cube.Define(found, f"/C{n}")
        cube.AddTranslateOp().Set(Gf.Vec3d(n % 70, 5 + n // 70, 0))
        cube.CreateSizeAttr(0.2)
        material = UsdShade.Material.Define(found, f"/M{n}")
        surface = UsdShade.Shader.Define(found, f"/M{n}/S")
        surface.CreateIdAttr("UsdPreviewSurface")
        surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set((n / 5000, 0.5, 0.5))
        material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", Sdf.ValueTypeNames.Token))
        UsdShade.MaterialBindingAPI.Apply(cube.GetPrim()).Bind(material)
    found.Save()


@stage
def profile_of_a_million_angles(folder):
    n = 1000
    text(
        folder,
        'def SphereLight "L" (\n    prepend apiSchemas = ["ShapingAPI"]\n)\n{\n'
        "    asset inputs:shaping:ies:file = @./a.ies@\n}\n",
    )
    rows = "\n".join(" ".join(["100"] * n) for _ in range(n))
    angles = " ".join(f"{180 * k / (n - 1):.4f}" for k in range(n))
    turns = " ".join(f"{360 * k / (n - 1):.4f}" for k in range(n))
    (folder / "a.ies").write_text(
        f"IESNA:LM-63-2002\nTILT=NONE\n1 1000 1 {n} {n} 1 2 0.1 0.1 0\n1 1 50\n{angles}\n{turns}\n{rows}\n"
    )


@stage
def joints_200000(folder):
    names = ", ".join(f'"j{n}"' for n in range(200_000))
    unit = "((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))"
    text(
        folder,
        f'def SkelRoot "R"\n{{\n    def Skeleton "S"\n    {{\n        uniform token[] joints = [{names}]\n'
        f"        uniform matrix4d[] bindTransforms = [{', '.join([unit] * 200_000)}]\n"
        f"        uniform matrix4d[] restTransforms = [{', '.join([unit] * 200_000)}]\n    }}\n}}\n",
    )


def graph(name):
    def keep(make):
        GRAPHS[name] = make
        return make

    return keep


@graph("pipe")
def _pipe(path):
    os.mkfifo(path)


@graph("aliases_that_double")
def _aliases(path):
    rows = ["a0: &a0 [1, 1]"] + [f"a{n}: &a{n} [*a{n - 1}, *a{n - 1}]" for n in range(1, 40)]
    path.write_text("\n".join(rows) + "\nnodes: *a39\n")


@graph("brackets_deep")
def _brackets(path):
    path.write_text("nodes: " + "[" * 100_000 + "]" * 100_000)


@graph("long_text")
def _long(path):
    path.write_text("nodes:\n" + "".join(f"  n{n}: {{op: x}}\n" for n in range(300_000)))


@graph("builds_on_itself")
def _itself(path):
    path.write_text(f"extends: ./{path.name}\n")


@graph("includes_twice")
def _twice(path):
    for level in range(31):
        below = f"include: [./b{level + 1}.yaml, ./b{level + 1}.yaml]\n" if level < 30 else ""
        (path.parent / f"b{level}.yaml").write_text(below + "nodes: []\n")
    path.write_text("include: [./b0.yaml, ./b0.yaml]\nnodes: []\n")


@graph("nodes_3000")
def _nodes(path):
    rows = ["inputs: {radiance: radiance}", "nodes:"]
    for n in range(3000):
        rows.append(f"  n{n}: {{op: optics.falloff, in: {'radiance' if n == 0 else f'n{n - 1}'}}}")
    path.write_text("\n".join(rows) + "\noutputs: {}\n")


RECIPES.update(GRAPHS)


def make(name, path):
    """Write a file, or a stage into a folder."""
    subprocess.run([sys.executable, __file__, "--make", name, str(path)], check=True)


def run(words, *, cwd):
    """(processor seconds, MB, exit code or a word, last line) of a command line."""

    def bounded():
        resource.setrlimit(resource.RLIMIT_CPU, (END_S, END_S + 1))

    with tempfile.TemporaryFile() as told:
        child = subprocess.Popen(words, stdout=told, stderr=told, stdin=subprocess.DEVNULL, cwd=cwd, preexec_fn=bounded)
        _, status, spent = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        told.seek(0)
        said = told.read().decode(errors="replace").strip()
    code = "TRACE" if "Traceback" in said else str(child.returncode)
    return spent.ru_utime + spent.ru_stime, spent.ru_maxrss / 1024, code, said.splitlines()[-1:] or [""]


def commands(folder, file, kind):
    """(name, words) of every command that takes such a file."""
    me = [sys.executable, "-m", "synfog_usd.cli.main"]
    small = ["--resolution", "64x36", "--samples", "2", "--quiet", "-o", str(folder / "out")]
    if kind == "stage":
        yield "check", [*me, "check", file]
        yield "check --fix", [*me, "check", file, "--fix", str(folder / "mended.usda")]
        few = ["--lighting", "lighting0,lighting1"] if b"lighting0" in Path(file).read_bytes() else []
        yield "bake", [*me, "bake", file, *small, *few, "--quality", "reference"]
        yield "bake --max-distance", [*me, "bake", file, *small, "--max-distance", "20", "--quality", "reference"]
        yield "preview", [*me, "preview", file, *small, "--terminal", "none"]
    if kind == "graph":
        yield "graph check", [*me, "graph", "check", file]
        yield "graph show", [*me, "graph", "show", file]
        yield "graph run", [*me, "graph", "run", file, "--in", file, "-o", str(folder / "out")]
        yield "bake --pipeline", [*me, "bake", str(folder / "plain.usda"), "--pipeline", file, *small]
    if kind == "recipe":
        yield "compose", [*me, "compose", file, "--seed", "1", "-o", str(folder / "out.usda")]
        yield "contact", [*me, "contact", file, "--seeds", "0-1", "-o", str(folder / "sheet.png")]
        yield "dataset run", [*me, "dataset", "run", file, "-o", str(folder / "set")]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--make", nargs=2, metavar=("NAME", "PATH"), help=argparse.SUPPRESS)
    parser.add_argument("--only", default="")
    parser.add_argument("--commands", default="")
    asked = parser.parse_args()
    if asked.make:
        name, path = asked.make
        {**STAGES, **GRAPHS}[name](Path(path))
        return 0
    only, wanted = set(filter(None, asked.only.split(","))), set(filter(None, asked.commands.split(",")))
    rows, failed, usual = [], 0, {}
    out = Path.cwd() / "out"
    out.mkdir(exist_ok=True)
    kinds = [("stage", STAGES), ("graph", GRAPHS), ("recipe", RECIPES)]
    with (out / "hostile.csv").open("w", encoding="utf-8") as table:
        print("file,command,processor s,MB,exit code,said", file=table, flush=True)
        for kind, family in kinds:
            for name in family:
                if only and name not in only and name != "plain":
                    continue
                with tempfile.TemporaryDirectory() as place:
                    folder = Path(place)
                    if kind == "stage":
                        make(name, folder)
                        file = next(str(found) for found in folder.glob("stage.usd?"))
                    else:
                        make("plain", folder)
                        (folder / "stage.usda").rename(folder / "plain.usda")
                        file = str(folder / "file.yaml")
                        make(name, file)
                    for command, words in commands(folder, file, kind):
                        if wanted and command not in wanted:
                            continue
                        seconds, mb, code, said = run(words, cwd=folder)
                        if name == "plain":
                            usual[command] = seconds
                        over = (
                            seconds - usual.get(command, 0.0) > MOST_S or mb > MOST_MB or not code.lstrip("-").isdigit()
                        )
                        failed += over
                        rows.append((name, command, seconds, mb, code))
                        word = "OVER" if over else "ok"
                        line = said[0][-160:]
                        print(
                            f"{word:5}{name:34} {command:20} {seconds:7.1f} s {mb:7.0f} MB  {code:8} {line}", flush=True
                        )
                        print(f'{name},{command},{seconds:.1f},{mb:.0f},{code},"{line}"', file=table, flush=True)
    print(
        f"{len(rows)} runs, {failed} over; worst {max(row[2] for row in rows):.0f} s, "
        f"{max(row[3] for row in rows):.0f} MB"
    )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
