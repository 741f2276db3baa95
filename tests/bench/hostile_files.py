"""What each command costs on files that ask for too much.

    python tests/bench/hostile_files.py [--only NAME,...] [--commands check,bake,...]

Every stage is made in a child (what is started has its parent's memory at first) and given to every command that takes
one, in a child that is ended after a minute of the processor.
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
from pxr import Sdf, Usd, UsdGeom, UsdLux, UsdShade, Vt

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


@stage
def plain(folder):
    """Nothing hostile: what each command costs anyway."""
    text(
        folder,
        'def Cube "Box"\n{\n    double3 xformOp:translate = (0, 8, 0)\n'
        '    uniform token[] xformOpOrder = ["xformOp:translate"]\n}\n',
    )


@stage
def fogs_under_the_limit(folder):
    text(folder, "".join(FOG.format(n=n, mor=100, at=(3 * n, 10, 0), scale=(2, 2, 2)) for n in range(190)))


@stage
def fogs_that_cross_600(folder):
    text(folder, "".join(FOG.format(n=n, mor=100, at=(0.5 * n, 10, 0), scale=(2, 2, 2)) for n in range(600)))


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
def references_twice_under_the_limit(folder):
    """82 000 prims and references."""
    text(folder, _doubled(13))


@stage
def instances_twice(folder):
    text(folder, _doubled(40, "instanceable = true"))


@stage
def braces_deep(folder):
    text(folder, 'def Xform "d" {\n' * 300_000 + "}\n" * 300_000)


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
def lamps_under_the_limit(folder):
    _lamps(folder, 5000)


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


def make(name, path):
    """Write a stage into a folder."""
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
        lines = told.read().decode(errors="replace").strip()
    code = "TRACE" if "Traceback" in lines else str(child.returncode)
    return spent.ru_utime + spent.ru_stime, spent.ru_maxrss / 1024, code, (lines.splitlines() or [""])[-1]


def commands(folder, file):
    """(name, words) of every command that takes a stage."""
    me = [sys.executable, "-m", "synfog_usd.cli.main"]
    small = ["--resolution", "64x36", "--samples", "2", "-o", str(folder / "out")]
    yield "check", [*me, "check", file]
    yield "bake", [*me, "bake", file, *small, "--quality", "reference"]
    yield "preview", [*me, "preview", file, *small]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--make", nargs=2, metavar=("NAME", "PATH"), help=argparse.SUPPRESS)
    parser.add_argument("--only", default="")
    parser.add_argument("--commands", default="")
    asked = parser.parse_args()
    if asked.make:
        name, path = asked.make
        STAGES[name](Path(path))
        return 0
    only, wanted = set(filter(None, asked.only.split(","))), set(filter(None, asked.commands.split(",")))
    rows, failed, usual = [], 0, {}
    out = Path.cwd() / "out"
    out.mkdir(exist_ok=True)
    with (out / "hostile.csv").open("w", encoding="utf-8") as table:
        print("file,command,processor s,MB,exit code,last line", file=table, flush=True)
        for name in STAGES:
            if only and name not in only and name != "plain":
                continue
            with tempfile.TemporaryDirectory() as place:
                folder = Path(place)
                make(name, folder)
                file = next(str(path) for path in folder.glob("stage.usd?"))
                for command, words in commands(folder, file):
                    if wanted and command not in wanted:
                        continue
                    seconds, mb, code, last = run(words, cwd=folder)
                    if name == "plain":
                        usual[command] = seconds
                    over = seconds - usual.get(command, 0.0) > MOST_S or mb > MOST_MB or not code.lstrip("-").isdigit()
                    failed += over
                    rows.append((seconds, mb))
                    row = f"{seconds:7.1f} s {mb:7.0f} MB  {code:8} {last[-160:]}"
                    print(f"{'OVER' if over else 'ok':5}{name:34} {command:20} {row}", flush=True)
                    print(f'{name},{command},{seconds:.1f},{mb:.0f},{code},"{last[-160:]}"', file=table, flush=True)
    seconds, mb = (max(column) for column in zip(*rows, strict=True))
    print(f"{len(rows)} runs, {failed} over; worst {seconds:.0f} s, {mb:.0f} MB")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
