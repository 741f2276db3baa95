"""MaterialX: files, the surfaces that Houdini, Solaris and Blender write, and the nodes on the way to them.

Expected values come from the same material as a UsdPreviewSurface, from Mitsuba's own words, from closed forms, and
from `colorsys`.
"""

import colorsys
import os
import shutil
import zipfile

import MaterialX as mx  # noqa: N813 - as its own pages do
import numpy as np
import pytest
from pxr import Usd, UsdShade
from support.looks import TYPES, linear, painted, picture_of, shade, write

from synfog_usd.base.errors import StageError
from synfog_usd.stage import check, open_stage, select, stage_hash
from synfog_usd.stage.open import composition_notes, dependencies
from synfog_usd.translate import translate

CODES = np.random.default_rng(6).integers(20, 236, (4, 4, 3), dtype=np.uint8)
STAGE = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Z"
)
def Xform "World" (
    variants = { string fog = "clear" }
    prepend variantSets = "fog"
) {
    def Camera "Eye" {
        double3 xformOp:rotateXYZ = (90, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:rotateXYZ"]
    }
    def Mesh "Quad" (prepend apiSchemas = ["MaterialBindingAPI"]) {
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(0, 5, 0), (1, 5, 0), (1, 5, 1), (0, 5, 1)]
        texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (interpolation = "vertex")
        uniform token subdivisionScheme = "none"
        rel material:binding = </World/Paint>
    }
    def Material "Paint" (ARC) {}
    variantSet "fog" = {
        "clear" {}
        "other" {
            over "Paint" (ARC2) {}
        }
    }
}
"""
SURFACE = """<standard_surface name="shine" type="surfaceshader">{inputs}</standard_surface>
<surfacematerial name="Car" type="material">
  <input name="surfaceshader" type="surfaceshader" nodename="shine"/>
</surfacematerial>"""


def placed(
    folder, text, *, arc="references = @./look/car.mtlx@</MaterialX/Materials/Car>", other="", at="look/car.mtlx"
):
    """A stage whose material refers to a .mtlx file of this text."""
    (folder / at).parent.mkdir(exist_ok=True, parents=True)
    (folder / at).write_text(text, encoding="utf-8")
    path = folder / "a.usda"
    path.write_text(STAGE.replace("ARC2", other).replace("ARC", arc), encoding="utf-8")
    return path


def document(inputs, *, more="", attributes='version="1.39"'):
    return f'<?xml version="1.0"?><materialx {attributes}>{more}{SURFACE.format(inputs=inputs)}</materialx>'


def constant(name, kind, value):
    return f'<input name="{name}" type="{kind}" value="{value}"/>'


def drawn(stage):
    scene = translate(stage)
    shape = scene.world["shape_0"]
    return scene, shape, scene.world[shape["bsdf"]["id"]]


def told(scene):
    return [note.text for note in scene.notes if note.severity == "warning"]


def test_a_file_draws_as_the_same_preview_surface(tmp_path):
    """Base, roughness, metalness, index, coat, opacity and light, through a file of the older version 1.37 with a node
    graph, a prefix for its files and a swizzle.
    """
    write(tmp_path / "look/tex/a.png", CODES)
    text = document(
        '<input name="base_color" type="color3" nodegraph="NG" output="color"/>'
        '<input name="specular_roughness" type="float" nodegraph="NG" output="rough"/>'
        + constant("base", "float", 1.0)
        + constant("metalness", "float", 0.25)
        + constant("specular_IOR", "float", 1.4)
        + constant("coat", "float", 0.75)
        + constant("coat_roughness", "float", 0.1)
        + constant("emission", "float", 2.0)
        + constant("emission_color", "color3", "1, 0.5, 0.25"),
        more="""<nodegraph name="NG">
          <image name="i" type="color3">
            <input name="file" type="filename" value="a.png" colorspace="srgb_texture"/>
          </image>
          <swizzle name="s" type="float"><input name="in" type="color3" nodename="i"/>
            <input name="channels" type="string" value="g"/></swizzle>
          <output name="color" type="color3" nodename="i"/><output name="rough" type="float" nodename="s"/>
        </nodegraph>""",
        attributes='version="1.37" fileprefix="tex/"',
    )
    scene, shape, bsdf = drawn(open_stage(placed(tmp_path, text)))
    assert told(scene) == []

    plain = open_stage(tmp_path / "a.usda")
    with Usd.EditContext(plain, plain.GetSessionLayer()):
        for path in ("/World/Quad", "/World/Preview"):
            plain.OverridePrim(path)
        numbers = {"metallic": 0.25, "ior": 1.4, "clearcoat": 0.75, "clearcoatRoughness": 0.1}
        file, wraps = tmp_path / "look/tex/a.png", {"wrapS": "repeat", "wrapT": "repeat"}
        color = picture_of(plain, file, path="/World/Preview", **wraps)
        green = UsdShade.Shader(color.GetPrim()).CreateOutput("g", TYPES.Float)
        numbers |= {"diffuseColor": color, "roughness": green, "emissiveColor": (2.0, 1.0, 0.5)}
        painted(plain.GetPrimAtPath("/World/Quad"), "/World/Preview", **numbers)
    _, same_shape, same = drawn(plain)
    np.testing.assert_equal(bsdf, same)
    np.testing.assert_equal(shape, same_shape)


def test_colours_of_other_spaces_are_made_linear_rec709(tmp_path):
    """ACEScg white is white, and its red by colour-science's matrix; sRGB constants are decoded."""
    colour = pytest.importorskip("colour")
    for space, value, expected in (
        ("acescg", (1.0, 1.0, 1.0), (1.0, 1.0, 1.0)),
        ("acescg", (0.5, 0.2, 0.1), None),
        ("srgb_texture", (128 / 255, 64 / 255, 0.0), linear([128, 64, 0])),
        ("lin_rec709", (0.5, 0.2, 0.1), (0.5, 0.2, 0.1)),
    ):
        text = document(
            f'<input name="base_color" type="color3" value="{value[0]},{value[1]},{value[2]}" colorspace="{space}"/>'
            + constant("base", "float", 1.0)
        )
        bsdf = drawn(open_stage(placed(tmp_path, text)))[2]
        if expected is None:
            expected = colour.RGB_to_RGB(value, "ACEScg", "sRGB", "Bradford")
        np.testing.assert_allclose(bsdf["bsdf"]["base_color"]["value"], expected, atol=2e-4)


def test_the_file_counts_as_part_of_the_stage(tmp_path):
    """It and its pictures are dependencies; a change of it changes the hash, wherever the folder lies."""
    write(tmp_path / "one/look/a.png", CODES)
    text = document(
        '<input name="base_color" type="color3" nodename="i"/>',
        more='<image name="i" type="color3"><input name="file" type="filename" value="a.png"/></image>',
    )
    path = placed(tmp_path / "one", text)
    before = sorted(tmp_path.rglob("*")), path.read_bytes()
    stage = open_stage(path)
    assert {file.name for file in dependencies(stage)} == {"a.usda", "car.mtlx", "a.png"}
    shutil.copytree(tmp_path / "one", tmp_path.parent / f"{tmp_path.name}_two")
    assert stage_hash(open_stage(tmp_path.parent / f"{tmp_path.name}_two/a.usda")) == stage_hash(stage)
    assert drawn(stage)[2]["bsdf"]["base_color"]["bitmap"].shape == (4, 4, 3)
    with pytest.raises(Exception, match="saving not allowed"):
        stage.GetRootLayer().Save()
    assert (sorted(tmp_path.rglob("*")), path.read_bytes()) == before
    again = open_stage(path)  # while the first one lives, whose layers are shared
    assert composition_notes(again) == [] and stage_hash(again) == stage_hash(stage)
    first = stage_hash(stage)
    del stage, again
    (tmp_path / "one/look/car.mtlx").write_text(document(constant("base_color", "color3", "1, 0, 0")))
    changed = open_stage(path)
    assert stage_hash(changed) != first and drawn(changed)[2]["bsdf"]["base_color"]["value"] == [1.0, 0.0, 0.0]


def test_a_variant_that_is_chosen_later_finds_its_file(tmp_path):
    text = document(constant("base_color", "color3", "0, 1, 0") + constant("base", "float", 1))
    stage = open_stage(placed(tmp_path, text, arc="", other="references = @./look/car.mtlx@</MaterialX/Materials/Car>"))
    before = drawn(stage)[2]
    select(stage, fog="other")
    after = drawn(stage)[2]
    assert after["bsdf"]["base_color"]["value"] == [0.0, 1.0, 0.0] and before != after


DEEP = "<a>" * 40 + "</a>" * 40


@pytest.mark.parametrize("text, why", [
    ("<materialx>", "no XML"),
    ("<html/>", "root element"),
    ('<!DOCTYPE m [<!ENTITY a "b">]><materialx version="1.38">&a;</materialx>', "document type"),
    (f"<materialx>{DEEP}</materialx>", "deeper than"),
    ("<materialx>" + "<a/>" * 60_000 + "</materialx>", "elements"),
    ("<materialx>" + " " * (17 << 20) + "</materialx>", "bytes"),
])  # fmt: skip
def test_what_is_no_materialx_is_told_and_refused_where_all_counts(tmp_path, text, why):
    path = placed(tmp_path, text)
    (note,) = composition_notes(open_stage(path))
    assert (note.severity, note.path) == ("warning", "/World/Paint")
    assert "car.mtlx, which is not read" in note.text and why in note.text and "\n" not in note.text
    with pytest.raises(StageError, match="is not read"):
        open_stage(path, whole=True)


ODD = [
    ("base_color", "color3", "0.96 0.37 0.25"), ("base_color", "color3", " 0.96,0.37 ,  0.25, "),
    ("base_color", "color3", "9.6e-1\n37E-2\t.25"), ("base_color", "color3", "+0.5, 0.5f, 0.50"),
    ("base", "float", " 5.e-1 "), ("base", "float", "0.25, 0.75"), ("thin_walled", "boolean", "true"),
]  # fmt: skip


def stored(path, name):
    stage = open_stage(path)
    shader = next(prim for prim in stage.Traverse() if prim.GetTypeName() == "Shader")
    value = shader.GetAttribute(f"inputs:{name}").Get()
    return value if value is None else np.atleast_1d(np.array(value, dtype=float))


@pytest.mark.parametrize("name, kind, text", ODD)
def test_values_are_read_as_materialx_reads_them(tmp_path, name, kind, text):
    """However their numbers are parted and written: what MaterialX's own library makes of the same file."""
    path = placed(tmp_path, document(constant(name, kind, text)))
    read = mx.createDocument()
    mx.readFromXmlFile(read, str(tmp_path / "look" / "car.mtlx"))
    own = read.getNode("shine").getInput(name).getValue()
    wanted = np.atleast_1d(np.array(own if kind != "color3" else own.asTuple(), dtype=float))
    np.testing.assert_allclose(stored(path, name), wanted, rtol=1e-6)
    assert bool(composition_notes(open_stage(path))) == (kind == "float" and "," in text)


@pytest.mark.parametrize("name, kind, text", [
    ("base_color", "color3", "1, red"),
    ("base_color", "color3", "1, 1, 1, 1"),
    ("base", "float", "inf"),
    ("thin_walled", "boolean", "perhaps"),
])  # fmt: skip
def test_a_value_that_is_none_is_left_out_alone(tmp_path, name, kind, text):
    """The rest of the file is read: the metal of the same surface."""
    path = placed(tmp_path, document(constant(name, kind, text) + constant("metalness", "float", "0.75")))
    assert stored(path, name) is None and stored(path, "metalness") == 0.75
    (note,) = composition_notes(open_stage(path))
    assert (note.severity, note.path) == ("warning", "/World/Paint") and f"{name} of 'shine'" in note.text


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "iso-8859-1"])
def test_a_file_is_read_in_the_encoding_that_it_declares(tmp_path, encoding):
    declared = {"utf-8-sig": "UTF-8"}.get(encoding, encoding)
    text = document(constant("metalness", "float", "0.75") + "<!-- grün -->")
    path = placed(tmp_path, "")
    text = text.replace('version="1.0"', f'version="1.0" encoding="{declared}"', 1)
    (tmp_path / "look" / "car.mtlx").write_bytes(text.encode(encoding))
    assert stored(path, "metalness") == 0.75


@pytest.mark.parametrize("name", ["car.mtlx", "my look/grüne car.mtlx", "../car.mtlx"])
def test_a_file_lies_where_the_layer_that_names_it_lies(tmp_path, monkeypatch, name):
    """With './' or without, whichever folder the command is started in, and with what the folder is called."""
    top, started = tmp_path / "stage", tmp_path / "elsewhere"
    started.mkdir()
    monkeypatch.chdir(started)
    file = (top / "sub" / name).resolve()
    for folder in (top / "sub", file.parent):
        folder.mkdir(parents=True, exist_ok=True)
    file.write_text(document(constant("metalness", "float", "0.75")), encoding="utf-8")
    (top / "sub" / "look.usda").write_text(
        f'#usda 1.0\ndef "Paint" (\n    references = @{name}@</MaterialX/Materials/Car>\n)\n{{\n}}\n', encoding="utf-8"
    )
    path = top / "a.usda"
    path.write_text(STAGE.replace("ARC2", "").replace("ARC", "payload = @sub/look.usda@</Paint>"), encoding="utf-8")
    stage = open_stage(path)
    assert not composition_notes(stage)
    assert file in dependencies(stage)
    assert not [one for one in check(stage) if "is not there" in one.text]
    (shader,) = [prim for prim in stage.Traverse() if prim.GetTypeName() == "Shader"]
    assert shader.GetAttribute("inputs:metalness").Get() == 0.75


def test_a_file_within_an_archive_is_told_as_what_it_is(tmp_path):
    """It is there, and is not read."""
    (tmp_path / "car.mtlx").write_text(document(constant("metalness", "float", "0.75")), encoding="utf-8")
    placed(tmp_path, "", arc="references = @car.mtlx@</MaterialX/Materials/Car>")
    with zipfile.ZipFile(tmp_path / "a.usdz", "w") as archive:  # stored, as .usdz has it; alignment is no matter here
        for name in ("a.usda", "car.mtlx"):
            archive.write(tmp_path / name, name)
    told = [note.text for note in composition_notes(open_stage(tmp_path / "a.usdz")) if "car.mtlx" in note.text]
    assert len(told) == 1 and "is not read (it is within an archive; unpack that" in told[0]


def test_files_that_a_file_includes_are_not_read(tmp_path):
    (tmp_path / "look").mkdir()
    (tmp_path / "secret.mtlx").write_text(document(constant("base_color", "color3", "1, 0, 0")))
    text = (
        '<materialx version="1.39" xmlns:xi="http://www.w3.org/2001/XInclude">'
        f'<xi:include href="{tmp_path}/secret.mtlx"/><xi:include href="../secret.mtlx"/></materialx>'
    )
    stage = open_stage(placed(tmp_path, text))
    assert not stage.GetPrimAtPath("/World/Paint").GetChildren()


def test_pictures_outside_of_the_folder_are_refused(tmp_path, file="../../outside.png"):
    write(tmp_path / "outside.png", CODES)
    (tmp_path / "stage").mkdir()
    text = document(
        '<input name="base_color" type="color3" nodename="i"/>',
        more=f'<image name="i" type="color3"><input name="file" type="filename" value="{file}"/></image>',
    )
    with pytest.raises(StageError, match="outside of the stage's folder"):
        open_stage(placed(tmp_path / "stage", text))


def test_a_pipe_ends_in_an_error(tmp_path):
    """Nothing waits for a file that never ends."""
    path = placed(tmp_path, "")
    (tmp_path / "look/car.mtlx").unlink()
    os.mkfifo(tmp_path / "look/car.mtlx")
    with pytest.raises(StageError, match="no regular file"):
        open_stage(path)


# -- surfaces -------------------------------------------------------------------------------------------------------


def surface(folder, **inputs):
    """What a standard surface with these inputs becomes."""
    made = "".join(
        constant(name, {bool: "boolean", float: "float", tuple: "color3"}[type(value)], str(value).strip("()").lower())
        for name, value in inputs.items()
    )
    scene, _, bsdf = drawn(open_stage(placed(folder, document(made))))
    return bsdf, scene


@pytest.mark.parametrize("weight, tint, f0", [(0.0, 1.0, 0.0), (0.5, 1.0, 0.02), (1.0, 1.0, 0.04), (1.0, 0.25, 0.01)])
def test_specular_weighs_the_reflection_at_normal_incidence(tmp_path, weight, tint, f0):
    """An index of 1.5 reflects 4 percent; weight and tint multiply it."""
    bsdf, _ = surface(tmp_path, specular=weight, specular_color=(tint, tint, tint), specular_IOR=1.5)
    assert bsdf["bsdf"]["type"] == ("preview_surface" if f0 else "diffuse")  # without a reflection it is Lambert's
    eta = bsdf["bsdf"].get("eta", 1.0)
    assert ((eta - 1) / (eta + 1)) ** 2 == pytest.approx(f0, abs=1e-6)


def test_transmission_is_glass(tmp_path):
    """Smooth, rough by the square of the roughness, thin, in parts; none through metal."""
    bsdf, _ = surface(tmp_path, transmission=1.0, specular_IOR=1.33, specular_roughness=0.0)
    assert bsdf == {"type": "dielectric", "int_ior": pytest.approx(1.33)}
    bsdf, _ = surface(tmp_path, transmission=1.0, specular_roughness=0.4, transmission_color=(0.5, 1.0, 1.0))
    assert (bsdf["type"], bsdf["alpha"]) == ("roughdielectric", pytest.approx(0.16))
    np.testing.assert_allclose(bsdf["specular_transmittance"]["value"], [0.5, 1, 1])
    assert surface(tmp_path, transmission=1.0, thin_walled=True)[0]["type"] == "thindielectric"
    bsdf, _ = surface(tmp_path, transmission=0.5, metalness=0.5)
    assert (bsdf["type"], bsdf["weight"]) == ("blendbsdf", 0.25)
    assert (bsdf["bsdf_0"]["bsdf"]["type"], bsdf["bsdf_1"]["type"]) == ("preview_surface", "roughdielectric")
    assert surface(tmp_path, transmission=1.0, metalness=1.0)[0]["type"] == "twosided"


def test_transmitted_light_is_mitsubas(tmp_path):
    """Radiance that meets a solid of index 1.5 straight on: F is reflected and (1 - F) t / 1.5^2 goes in, with F of 4
    percent and a tint t; 20 000 samples.
    """
    from synfog_usd.render import backend
    from synfog_usd.render.load import to_mitsuba

    backend.mitsuba()
    import drjit as dr
    import mitsuba as mi

    for tint in (1.0, 0.5):
        glass = constant("transmission", "float", 1.0) + constant("specular_roughness", "float", 0.0)
        glass += constant("transmission_color", "color3", f"{tint},{tint},{tint}")
        path = placed(tmp_path, document(glass))
        scene = to_mitsuba(translate(open_stage(path))).scene
        (bsdf,) = {shape.bsdf() for shape in scene.shapes()}
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(1, 20_000)
        si = dr.zeros(mi.SurfaceInteraction3f, 20_000)
        si.wi = mi.Vector3f(0, 0, 1)
        _, weight = bsdf.sample(mi.BSDFContext(), si, sampler.next_1d(), sampler.next_2d())
        mean = float(np.mean(np.array(weight)))
        assert mean == pytest.approx(0.04 + 0.96 * tint / 1.5**2, rel=0.01)


# -- nodes ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def quad(tmp_path):
    """A stage with a unit quad, and a function that adds a shader to its material."""
    path = tmp_path / "a.usda"
    path.write_text(STAGE.replace("ARC2", "").replace("ARC", ""), encoding="utf-8")
    stage = open_stage(path)
    material = UsdShade.Material(stage.GetPrimAtPath("/World/Paint"))

    def shader(name, kind, output=TYPES.Color3f, **inputs):
        named = {key.rstrip("_"): value for key, value in inputs.items()}
        return shade(stage, f"/World/Paint/{name}", kind, gives=output, **named)

    def finish(**inputs):
        made = shader("Surface", "ND_standard_surface_surfaceshader", base=1.0, **inputs)
        material.CreateSurfaceOutput("mtlx").ConnectToSource(made)
        scene, shape, bsdf = drawn(stage)
        return scene, shape, bsdf["bsdf"]

    def picture(name="Picture", file="a.png", **inputs):
        write(tmp_path / file, CODES)
        made = shader(name, "ND_image_color3", file=tmp_path / file, **inputs)
        UsdShade.Shader(made.GetPrim()).GetInput("file").GetAttr().SetColorSpace("lin_rec709")
        return made

    return shader, picture, finish


def adjusted(colour):
    h, s, v = colorsys.rgb_to_hsv(*colour)
    return colorsys.hsv_to_rgb((h + 0.3) % 1, s * 0.5, v * 0.9)


X = CODES / 255.0
BY_PIXEL = {
    "multiply": ({"in2": (0.5, 1.0, 0.25)}, lambda x: x * [0.5, 1, 0.25]),
    "add": ({"in2": 0.1}, lambda x: x + 0.1),
    "subtract": ({"in2": (0.05, 0.0, 0.01)}, lambda x: x - [0.05, 0, 0.01]),
    "divide": ({"in2": 2.0}, lambda x: x / 2),
    "power": ({"in2": 2.2}, lambda x: x**2.2),
    "invert": ({}, lambda x: 1 - x),
    "clamp": ({"low": 0.3, "high": 0.6}, lambda x: np.clip(x, 0.3, 0.6)),
    "contrast": ({"amount": 0.5}, lambda x: (x + 0.5) / 2),
    "remap": ({"inlow": 0.0, "inhigh": 2.0, "outlow": 1.0, "outhigh": 0.0}, lambda x: 1 - x / 2),
    "range": ({"gamma": 2.0, "outhigh": 0.5}, lambda x: np.sqrt(x) / 2),
    "smoothstep": ({"low": -1.0, "high": 1.0}, lambda x: (lambda t: 3 * t**2 - 2 * t**3)((x + 1) / 2)),
    "mix": ({"bg": (0.2, 0.4, 0.6), "mix": 0.25}, lambda x: 0.25 * x + 0.75 * np.array([0.2, 0.4, 0.6])),
    "screen": ({"bg": (0.5, 0.5, 0.5)}, lambda x: 0.5 + 0.5 * x),
    "min": ({"in2": 0.4}, lambda x: np.minimum(x, 0.4)),
    "saturate": ({"amount": 0.0}, lambda x: np.repeat((x @ [0.2722287, 0.6740818, 0.0536895])[..., None], 3, axis=2)),
    "hsvadjust": ({"amount": (0.3, 0.5, 0.9)}, lambda x: np.apply_along_axis(adjusted, 2, x)),
}


@pytest.mark.parametrize("kind", BY_PIXEL)
def test_a_node_changes_each_pixel_as_its_formula_says(quad, kind):
    """And a constant likewise."""
    shader, picture, finish = quad
    inputs, formula = BY_PIXEL[kind]
    name = {"mix": "fg", "screen": "fg", "multiply": "in1", "add": "in1", "subtract": "in1", "divide": "in1"}
    name |= {"power": "in1", "min": "in1"}
    out = shader("Node", f"ND_{kind}_color3", **{name.get(kind, "in"): picture(), **inputs})
    scene, _, bsdf = finish(base_color=out)
    np.testing.assert_allclose(bsdf["base_color"]["bitmap"], np.clip(formula(X), 0, 1), atol=1e-5)
    beyond = np.abs(formula(X) - np.clip(formula(X), 0, 1)).max() > 0.01
    assert ["0 to 1 can be drawn" in text for text in told(scene)] == [True] * bool(beyond)
    out = shader("Node2", f"ND_{kind}_color3", **{name.get(kind, "in"): tuple(X[0, 0]), **inputs})
    bsdf = finish(base_color=out)[2]
    np.testing.assert_allclose(bsdf["base_color"]["value"], np.clip(formula(X[:1, :1])[0, 0], 0, 1), atol=1e-5)


@pytest.mark.parametrize("kind, inputs, mean", [
    ("ND_noise3d_color3FA", {"amplitude": 0.3, "pivot": 0.4}, 0.4),
    ("ND_ramplr_color3", {"valuel": (0.2, 0.2, 0.2), "valuer": (0.8, 0.8, 0.8)}, 0.5),
    ("ND_splitlr_float", {"valuel": 1.0, "valuer": 0.0, "center": 0.25}, 0.25),
    ("ND_checkerboard_color3", {"color1": (0.1, 0.1, 0.1), "color2": (0.5, 0.5, 0.5)}, 0.3),
])  # fmt: skip
def test_what_varies_without_a_picture_is_its_mean_and_told(quad, kind, inputs, mean):
    shader, _, finish = quad
    scene, _, bsdf = finish(specular_roughness=shader("Node", kind, TYPES.Float, **inputs))
    assert bsdf["roughness"] == pytest.approx(mean, abs=1e-6)
    assert any("drawn as its mean" in line and kind.split("_")[1] in line for line in told(scene))


def test_a_circle_of_nodes_and_a_long_chain_end(quad):
    shader, picture, finish = quad
    one = shader("One", "ND_add_color3", in2=0.1)
    two = shader("Two", "ND_add_color3", in1=one)
    UsdShade.Shader(one.GetPrim()).CreateInput("in1", TYPES.Color3f).ConnectToSource(two)
    assert any("circle" in line for line in told(finish(base_color=two)[0]))
    last = picture("Far", "c.png")
    for number in range(300):
        last = shader(f"N{number}", "ND_add_color3", in1=last, in2=0.0001)
    np.testing.assert_allclose(finish(base_color=last)[2]["base_color"]["bitmap"], np.clip(X + 0.03, 0, 1), atol=1e-4)


@pytest.mark.parametrize("order", [0, 1])
def test_place2d_puts_the_picture_where_its_formula_says(quad, order):
    """About the pivot: divided by the scale, turned by 90 degrees, less the offset; and the other way round."""
    shader, picture, finish = quad
    coordinates = shader("Coordinates", "ND_geompropvalue_vector2", TYPES.Float2, geomprop="st")
    node = shader(
        "Place", "ND_place2d_vector2", TYPES.Float2,
        texcoord=coordinates, pivot=(0.5, 0.25), scale=(2.0, 4.0), rotate=90.0, offset=(0.1, 0.2),
    )  # fmt: skip
    UsdShade.Shader(node.GetPrim()).CreateInput("operationorder", TYPES.Int).Set(order)
    scene, shape, _ = finish(base_color=picture(texcoord=node))
    st = np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) - [0.5, 0.25]
    if order == 0:
        st = st / [2, 4]
        st = np.stack([st[:, 1], -st[:, 0]], axis=1) - [0.1, 0.2]
    else:
        st = st - [0.1, 0.2]
        st = np.stack([st[:, 1], -st[:, 0]], axis=1) / [2, 4]
    np.testing.assert_allclose(shape["texcoords"], st + np.array([0.5, 0.25]), atol=1e-6)
    assert told(scene) == []


def test_a_normal_map_is_weaker_by_its_scale(quad):
    """Slopes times one half, at unit length."""
    shader, picture, finish = quad
    normal = shader("Normal", "ND_normalmap_float", TYPES.Float3, in_=picture(), scale=0.5)
    bsdf = finish(normal=normal)[2]
    wanted = (2 * X - 1) * [0.5, 0.5, 1]
    wanted /= np.linalg.norm(wanted, axis=2, keepdims=True)
    np.testing.assert_allclose(2 * bsdf["normalmap"]["bitmap"] - 1, wanted, atol=1e-5)
    flipped = shader("Flip", "ND_multiply_color3", in1=picture("P2", "d.png"), in2=(1.0, -1.0, 1.0))
    flipped = shader("Flip2", "ND_add_color3", in1=flipped, in2=(0.0, 1.0, 0.0))
    bsdf = finish(normal=shader("Normal2", "ND_normalmap_float", TYPES.Float3, in_=flipped))[2]
    np.testing.assert_allclose(bsdf["normalmap"]["bitmap"], X * [1, -1, 1] + [0, 1, 0], atol=1e-5)
