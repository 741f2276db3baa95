"""Mitsuba's own materials on a stage: what is drawn, what becomes a note, and that `check` says what `bake` does."""

import json

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdLux, UsdShade
from support.cli import run
from support.looks import TYPES, fill, write

from synfog_usd.base.errors import StageError
from synfog_usd.dataset import check as verb
from synfog_usd.dataset.bake import StrictError
from synfog_usd.dataset.job import bake
from synfog_usd.render.load import refusal, to_mitsuba
from synfog_usd.translate import translate

RED = [0.5, 0.0, 0.0]
PICTURES = {"colours.png": 3, "grey.png": 1, "two.png": 2}


def of(kind, **inputs):
    """A shader and its inputs: numbers, words, colours, names of pictures, and other shaders."""
    return kind, inputs


def picture(name, **more):
    return of("bitmap", filename=Sdf.AssetPath(name), **more)


MATT, METAL, GLASS = of("diffuse", reflectance=(0.5, 0.5, 0.5)), of("roughconductor"), of("dielectric")
NORMALS, BUMPS = picture("colours.png", raw=True), picture("grey.png", raw=True)

DRAWN = {
    "two sides": of("twosided", bsdf=MATT),
    "a side each": of("twosided", front=MATT, back=METAL),
    "cut out": of("mask", opacity=picture("grey.png"), bsdf=of("twosided", bsdf=MATT)),
    "half by a colour": of("mask", opacity=(0.5, 0.2, 0.1), bsdf=MATT),
    "blended": of("blendbsdf", weight=BUMPS, bsdf_0=MATT, bsdf_1=GLASS),
    "bumps": of("bumpmap", any_name=BUMPS, scale=2.0, bsdf=MATT),
    "normals": of("normalmap", normalmap=NORMALS, any_name=MATT),
    "squares": of("diffuse", reflectance=of("checkerboard", color0=(1.0, 0.0, 0.0), color1=0.1)),
    "colours of vertices": of("diffuse", reflectance=of("mesh_attribute", name="vertex_color")),
    "two channels": of("diffuse", reflectance=picture("two.png")),
    "gold": of("conductor", material="Au"),
    "stretched": of("roughconductor", alpha_u=0.1, alpha_v=0.3),
}
"""What Mitsuba takes as it is."""

LEFT_OUT = {
    "an unknown name": (of("twosided", bsdf=MATT, foo=1.0), "foo"),
    "an unknown name of a texture": (of("diffuse", reflectance=picture("colours.png", gamma=2.0)), "gamma"),
    "an opacity in words": (of("mask", opacity="half", bsdf=MATT), "opacity"),
    "an opacity of 2": (of("mask", opacity=2.0, bsdf=MATT), "opacity"),
    "a reflectance of 2": (of("twosided", bsdf=of("diffuse", reflectance=2.0)), "reflectance"),
    "a scale in words": (of("bumpmap", bumps=BUMPS, scale="much", bsdf=MATT), "scale"),
    "an unknown wrap": (of("diffuse", reflectance=picture("colours.png", wrap_mode="twice")), "wrap_mode"),
    "an index by a picture": (of("dielectric", int_ior=BUMPS), "int_ior"),
    "another type": (of("twosided", bsdf=MATT, type=MATT), "type"),
}
"""What is drawn without one input, and its name."""

REFUSED = {
    "glass of two sides": of("twosided", bsdf=GLASS),
    "a mask on two sides": of("twosided", bsdf=of("mask", opacity=0.3, bsdf=MATT)),
    "three sides": of("twosided", a=MATT, b=MATT, c=MATT),
    "a surface as opacity": of("mask", opacity=MATT, bsdf=MATT),
    "a blend of one": of("blendbsdf", weight=0.5, bsdf_0=MATT),
    "a surface as reflectance": of("diffuse", reflectance=MATT),
    "bumps without a picture": of("bumpmap", bsdf=MATT),
    "bumps by squares": of("bumpmap", bumps=of("checkerboard"), bsdf=MATT),
    "normals in one channel": of("normalmap", normalmap=BUMPS, bsdf=MATT),
    "a metal by name and by index": of("conductor", material="Au", eta=(0.1, 0.1, 0.1)),
    "an unknown metal": of("conductor", material="Unobtainium"),
    "index and specular": of("twosided", bsdf=of("principled", eta=1.5, specular=0.5)),
}
"""What Mitsuba refuses as it is made, or as it is drawn."""

NONE = {
    "a blend without a weight": of("blendbsdf", bsdf_0=MATT, bsdf_1=MATT),
    "normals without a picture": of("normalmap", bsdf=MATT),
    "a missing picture": of("mask", opacity=0.5, bsdf=of("diffuse", reflectance=picture("gone.png"))),
    "a damaged picture": of("diffuse", reflectance=picture("bad.png")),
    "no picture": of("diffuse", reflectance=of("bitmap")),
    "an unknown plugin": of("twosided", bsdf=of("measured")),
    "a texture as a surface": picture("colours.png"),
    "another attribute": of("diffuse", reflectance=of("mesh_attribute", name="vertex_other")),
    "four in one": of("blendbsdf", weight=0.5, a=MATT, b=MATT, c=MATT, d=MATT),
}
"""What the translation itself does not make."""

ALL = DRAWN | {name: case for name, (case, _) in LEFT_OUT.items()} | REFUSED | NONE


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Pictures of one, two and three channels, and a file that is none."""
    made = tmp_path_factory.mktemp("native")
    random = np.random.default_rng(6)
    for name, channels in PICTURES.items():
        write(made / name, random.integers(20, 236, (4, 4, channels), dtype=np.uint8))
    (made / "bad.png").write_bytes(b"nothing")
    return made


def stage_of(folder, cases, *, coordinates=True):
    """Path of a stage under a sky, on which a square wears each material; its usual surface is red."""
    path = folder / "stage.usda"
    stage = Usd.Stage.CreateNew(str(path)) if not path.exists() else Usd.Stage.Open(str(path))
    stage.GetRootLayer().Clear()
    UsdGeom.SetStageUpAxis(stage, "Z")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    UsdGeom.Camera.Define(stage, "/World/Ego").AddRotateXOp().Set(90.0)
    UsdLux.DomeLight.Define(stage, "/World/Sky").CreateIntensityAttr(3000.0)
    across = int(np.ceil(len(cases) ** 0.5))
    for k, case in enumerate(cases):
        x, z = k % across - across / 2.0, k // across - across / 2.0
        mesh = UsdGeom.Mesh.Define(stage, f"/World/Mesh{k}")
        fill(mesh, points=[(x, 9, z), (x + 1, 9, z), (x + 1, 9, z + 1), (x, 9, z + 1)], faceVertexCounts=[4])
        fill(mesh, faceVertexIndices=[0, 1, 2, 3], subdivisionScheme="none", displayColor=[(0.25, 0.5, 0.75)])
        if coordinates:
            corners = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", TYPES.TexCoord2fArray, "vertex")
            corners.Set([(0, 0), (1, 0), (1, 1), (0, 1)])
        material = UsdShade.Material.Define(stage, f"/World/M{k}")
        UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
        usual = fill(UsdShade.Shader.Define(stage, f"/World/M{k}/Usual"), id="UsdPreviewSurface")
        usual.CreateInput("diffuseColor", TYPES.Color3f).Set(tuple(RED))
        material.CreateSurfaceOutput().ConnectToSource(usual.CreateOutput("surface", TYPES.Token))
        own = shader(stage, material.GetPath(), case, [0])
        material.CreateSurfaceOutput("mitsuba").ConnectToSource(own)
    stage.Save()
    return path


def shader(stage, material, case, count):
    """Output of a shader and all that it is made of."""
    kind, inputs = case
    count[0] += 1
    made = fill(UsdShade.Shader.Define(stage, material.AppendChild(f"S{count[0]}")), id=f"mitsuba_{kind}")
    kinds = {bool: TYPES.Bool, float: TYPES.Float, str: TYPES.String, Sdf.AssetPath: TYPES.Asset}
    for name, value in inputs.items():
        if isinstance(value, tuple) and isinstance(value[0], str):
            made.CreateInput(name, TYPES.Token).ConnectToSource(shader(stage, material, value, count))
        else:
            made.CreateInput(name, kinds.get(type(value), TYPES.Color3f)).Set(value)
    return made.CreateOutput("surface", TYPES.Token)


def drawn(path, **choices):
    """The scene of a stage with one square, and its surface."""
    scene = translate(Usd.Stage.Open(str(path)), resolution=(8, 8), **choices)
    (shape,) = [part for key, part in scene.world.items() if key.startswith("shape_")]
    return scene, shape, scene.world[shape["bsdf"]["id"]]


def is_usual(bsdf):
    return bsdf.get("bsdf", {}).get("base_color", {}).get("value") == RED


@pytest.mark.parametrize("name", DRAWN)
def test_what_mitsuba_takes_is_drawn_as_it_is(folder, name):
    _, _, bsdf = drawn(stage_of(folder, [DRAWN[name]]), refusal=refusal)
    assert bsdf["type"] == DRAWN[name][0]


@pytest.mark.parametrize("name", LEFT_OUT)
def test_an_input_that_a_plugin_does_not_take_is_left_out(folder, name):
    """At any depth, with a note that names it."""
    case, left_out = LEFT_OUT[name]
    scene, _, bsdf = drawn(stage_of(folder, [case]), refusal=refusal)
    (note,) = [note for note in scene.notes if note.path.startswith("/World/M0/S")]
    assert bsdf["type"] == case[0]
    assert note.text.startswith(f"{left_out} is ") and note.text.endswith("; drawn without it")


@pytest.mark.parametrize("name", REFUSED)
def test_the_renderer_says_what_it_does_not_draw(folder, name):
    """Asked, Mitsuba says why, which stands in the note; the usual surface is drawn."""
    path = stage_of(folder, [REFUSED[name]])
    scene, _, believed = drawn(path)
    assert believed["type"] == REFUSED[name][0]
    why = refusal(believed)
    assert why and "[" not in why
    if "by squares" not in name and "in one channel" not in name:  # which are refused as they are drawn
        with pytest.raises(StageError, match="refused by the renderer"):
            to_mitsuba(scene)
    scene, _, bsdf = drawn(path, refusal=refusal)
    assert is_usual(bsdf)
    (note,) = [note for note in scene.notes if note.path == "/World/M0"]
    assert note.text == f"outputs:mitsuba:surface is not drawn: /World/M0/S1: {why}"


@pytest.mark.parametrize("name", NONE)
def test_what_is_no_material_is_told_without_a_renderer(folder, name):
    scene, _, bsdf = drawn(stage_of(folder, [NONE[name]]))
    assert is_usual(bsdf)
    assert [note for note in scene.notes if note.path == "/World/M0" and "is not drawn: " in note.text]


def test_a_bake_draws_a_stage_with_all_of_them(folder, tmp_path):
    """At 8x8 pixels; check and bake tell the same of each material, and both stop where warnings are errors."""
    path = stage_of(folder, ALL.values())
    checked = run("check", path, "--json")
    assert checked.returncode == 0, checked.stderr
    small = ("--resolution", "8x8", "--samples", "2", "--fog", "clear")
    done = run("bake", path, "--out", tmp_path / "out", *small)
    assert done.returncode == 0, done.stderr
    told = json.loads((tmp_path / "out" / "bake.json").read_text(encoding="utf-8"))["notes"]
    baked = {(note["path"], note["text"]) for note in told if note["path"].startswith("/World/M")}
    said = json.loads(checked.stdout)["translation"]
    assert baked == {(at, one["text"]) for one in said for at in one["paths"] if at.startswith("/World/M")}
    assert {at.split("/")[2] for at, _ in baked} == {f"M{k}" for k, name in enumerate(ALL) if name not in DRAWN}
    assert run("check", path, "--strict").returncode == verb.WARNINGS_UNDER_STRICT
    with pytest.raises(StrictError, match="is not drawn: ") as stopped:
        bake(path, tmp_path / "strict", resolution="8x8", samples=2, fog="clear", strict=True)
    assert stopped.value.exit_code == verb.WARNINGS_UNDER_STRICT
