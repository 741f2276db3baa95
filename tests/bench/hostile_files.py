"""What each command costs on files that ask for too much.

    python tests/bench/hostile_files.py [NAME ...]

Every stage is made in a child (what is started has its parent's memory at first) and given to every command that takes
one, in a child that is ended after a minute of the processor.
Prints processor seconds and MB of the child and all that it started, and what it said last.  The exit code is 1 where
one took more than 20 s or 3 GB, ended in a trace, or did not end.  A bake of an innocent stage is measured first: its
cost, mostly of kernels that are compiled, is taken off.
"""

import os
import resource
import subprocess
import sys
import tempfile
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdLux, Vt

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from support.hostile import png
from support.looks import fill, painted, picture_of, with_st

MOST_S, MOST_MB, END_S = 20.0, 3000.0, 60
HEAD = '#usda 1.0\n(\n    upAxis = "Z"\n    metersPerUnit = 1\n)\n'
CAMERA = 'def Camera "Ego"\n{\n}\ndef DomeLight "Sky"\n{\n    float inputs:intensity = 1000\n}\n'
FOG = """def Cube "Fog{n}" (
    prepend apiSchemas = ["SynFogMediumAPI"]
)
{{
    uniform token purpose = "guide"
    double size = 1
    float synfog:fog:mor = 100
    int synfog:fog:priority = {n}
    double3 xformOp:translate = ({x}, 10, 0)
    double3 xformOp:scale = (2, 2, 2)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
}}
"""
STAGES: dict[str, Callable[[Path], None]] = {}


def stage(make):
    STAGES[make.__name__] = make
    return make


def text(folder, body):
    (folder / "stage.usda").write_text(HEAD + CAMERA + body, encoding="utf-8")


def opened(folder):
    """A new binary stage with a camera and a sky."""
    made = Usd.Stage.CreateNew(str(folder / "stage.usdc"))
    UsdGeom.SetStageUpAxis(made, "Z")
    UsdGeom.SetStageMetersPerUnit(made, 1.0)
    UsdGeom.Camera.Define(made, "/Ego")
    UsdLux.DomeLight.Define(made, "/Sky").CreateIntensityAttr(1000.0)
    return made


def whole(values):
    return Vt.IntArray.FromNumpy(np.ascontiguousarray(values, dtype=np.int32))


def standing(kind, name, at, more=""):
    order = 'uniform token[] xformOpOrder = ["xformOp:translate"]'
    return f'def {kind} "{name}"\n{{\n{more}    double3 xformOp:translate = {at}\n    {order}\n}}\n'


@stage
def plain(folder):
    """Nothing hostile: what each command costs anyway."""
    text(folder, standing("Cube", "Box", (0, 8, 0)))


@stage
def fogs_under_the_limit(folder):
    text(folder, "".join(FOG.format(n=n, x=3 * n) for n in range(190)))


@stage
def packed_indices(folder):
    """0.1 MB that unpacks to 2.7 GB."""
    made = opened(folder)
    UsdGeom.Mesh.Define(made, "/M").CreateFaceVertexIndicesAttr(whole(np.zeros(700_000_000)))
    made.Save()


@stage
def packed_counts_under_the_limit(folder):
    made = opened(folder)
    for n in range(4):
        mesh = fill(UsdGeom.Mesh.Define(made, f"/M{n}"), points=[(0, 5, 0), (1, 5, 0), (0, 5, 1)])
        fill(mesh, faceVertexCounts=whole(np.full(6_000_000, 3)), subdivisionScheme="none")
        fill(mesh, faceVertexIndices=whole(np.tile([0, 1, 2], 6_000_000)))
    made.Save()


@stage
def references_twice_under_the_limit(folder, levels=13):
    """82 000 prims and references."""
    body = 'def Xform "L0"\n{\n    def Cube "Leaf"\n    {\n    }\n}\n'
    for level in range(1, levels + 1):
        inner = "".join(f'    def "{k}" (\n        references = </L{level - 1}>\n    )\n    {{\n    }}\n' for k in "ab")
        body += f'def Xform "L{level}"\n{{\n{inner}}}\n'
    text(folder, body)


@stage
def prims_under_the_limit(folder):
    """A thousand prims in each of 98 rows."""
    layer = Sdf.Layer.CreateNew(str(folder / "stage.usdc"))
    with Sdf.ChangeBlock():
        Sdf.PrimSpec(layer, "Ego", Sdf.SpecifierDef, "Camera")
        for row in range(98):
            parent = Sdf.PrimSpec(layer, f"X{row}", Sdf.SpecifierDef, "Xform")
            for n in range(1000):
                Sdf.PrimSpec(parent, f"p{n}", Sdf.SpecifierDef, "Xform")
    layer.Save()


@stage
def lamps_under_the_limit(folder):
    text(folder, "".join(standing("SphereLight", f"L{n}", (n % 100, n // 100, 3)) for n in range(5000)))


def instancer(folder, many):
    made = opened(folder)
    points = UsdGeom.PointInstancer.Define(made, "/Many")
    UsdGeom.Cube.Define(made, "/Many/Box").CreateSizeAttr(0.1)
    points.CreatePrototypesRel().SetTargets(["/Many/Box"])
    row = np.arange(many)
    places = np.stack([row % 1000, row // 1000 + 5, 0 * row], axis=1).astype(np.float32)
    fill(points, protoIndices=whole(0 * row), positions=Vt.Vec3fArray.FromNumpy(places))
    made.Save()


@stage
def instancer_4000000(folder):
    instancer(folder, 4_000_000)


@stage
def instancer_750000(folder):
    instancer(folder, 750_000)


def picture(folder, side):
    """A card that wears a picture of zeros: a thousandth of its pixels' bytes."""
    made = opened(folder)
    mesh = fill(UsdGeom.Mesh.Define(made, "/Card"), points=[(-1, 5, -1), (1, 5, -1), (1, 5, 1), (-1, 5, 1)])
    fill(mesh, faceVertexCounts=[4], faceVertexIndices=[0, 1, 2, 3])
    painted(with_st(mesh).GetPrim(), diffuseColor=picture_of(made, Path("./a.png")))
    made.Save()
    packer = zlib.compressobj(9)
    rows = b"".join(packer.compress(bytes(1 + 3 * side)) for _ in range(side)) + packer.flush()
    (folder / "a.png").write_bytes(png(side, side, packed=rows))


@stage
def picture_of_900_megapixels(folder):
    picture(folder, 30_000)


@stage
def picture_under_the_limit(folder):
    picture(folder, 8192)


@stage
def fog_grid_that_unpacks_to_8_GB(folder):
    grid = 'token synfog:fog:profile = "grid"\n    asset synfog:fog:densityGrid = @./g.npz@\n    int synfog'
    text(folder, FOG.format(n=0, x=0).replace("(2, 2, 2)", "(50, 50, 50)").replace("int synfog", grid))
    header = b"{'descr': '<f4', 'fortran_order': False, 'shape': (1280, 1280, 1280), }".ljust(117) + b"\n"
    with (
        zipfile.ZipFile(folder / "g.npz", "w", zipfile.ZIP_DEFLATED) as packer,
        packer.open("density.npy", "w", force_zip64=True) as out,
    ):
        out.write(b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)
        for _ in range(1280):
            out.write(bytes(4 * 1280 * 1280))


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


def main(names):
    rows, failed, usual = [], 0, {}
    for name in STAGES:
        if names and name not in (*names, "plain"):
            continue
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place)
            subprocess.run([sys.executable, __file__, "--make", name, place], check=True)
            file = next(str(path) for path in folder.glob("stage.usd?"))
            for command, words in commands(folder, file):
                seconds, mb, code, last = run(words, cwd=folder)
                usual.setdefault(command, seconds)
                over = seconds - usual[command] > MOST_S or mb > MOST_MB or not code.lstrip("-").isdigit()
                failed += over
                rows.append((seconds, mb))
                row = f"{seconds:7.1f} s {mb:7.0f} MB  {code:8} {last[-160:]}"
                print(f"{'OVER' if over else 'ok':5}{name:34} {command:20} {row}", flush=True)
    seconds, mb = (max(column) for column in zip(*rows, strict=True))
    print(f"{len(rows)} runs, {failed} over; worst {seconds:.0f} s, {mb:.0f} MB")
    return 1 if failed else 0


if __name__ == "__main__":
    if sys.argv[1:2] == ["--make"]:
        STAGES[sys.argv[2]](Path(sys.argv[3]))
    else:
        sys.exit(main(sys.argv[1:]))
