"""Materials and textures: each input arrives as the number the specification gives it."""

import zipfile

import numpy as np
import OpenImageIO
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, UsdUtils

from synfog_usd.translate import summary, translate
from synfog_usd.translate.texture import SRGB_TO_LINEAR

TYPES = Sdf.ValueTypeNames
CODES = np.random.default_rng(5).integers(0, 256, (4, 4, 4), dtype=np.uint8)


def write(path, pixels):
    out = OpenImageIO.ImageOutput.create(str(path))
    spec = OpenImageIO.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], str(pixels.dtype))
    spec.attribute("oiio:UnassociatedAlpha", 1)
    out.open(str(path), spec)
    out.write_image(pixels)
    out.close()


@pytest.fixture
def quad(empty, polygon_mesh):
    """A quad with texture coordinates 'st' and a preview surface to fill in: (stage, surface)."""
    stage = empty()
    mesh = polygon_mesh(stage, "/Quad", [(0, 5, 0), (1, 5, 0), (1, 5, 1), (0, 5, 1)], [4], [0, 1, 2, 3])
    UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", TYPES.TexCoord2fArray, "vertex").Set([(0, 0), (1, 0), (1, 1), (0, 1)])
    material = UsdShade.Material.Define(stage, "/Material")
    surface = UsdShade.Shader.Define(stage, "/Material/Surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", TYPES.Token))
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    return stage, surface


def textured(stage, surface, name, file, channel="rgb", *, st=True, transform=None, **inputs):
    picture = UsdShade.Shader.Define(stage, f"/Material/{name}Picture")
    picture.CreateIdAttr("UsdUVTexture")
    picture.CreateInput("file", TYPES.Asset).Set(str(file))
    for key, value in ({"wrapS": "repeat", "wrapT": "repeat"} | inputs).items():
        kind = TYPES.Token if isinstance(value, str) else TYPES.Float4
        picture.CreateInput(key, kind).Set(value if isinstance(value, str) else Gf.Vec4f(*value))
    if st:
        reader = UsdShade.Shader.Define(stage, "/Material/Reader")
        reader.CreateIdAttr("UsdPrimvarReader_float2")
        reader.CreateInput("varname", TYPES.String).Set("st")
        source = reader.CreateOutput("result", TYPES.Float2)
        if transform:
            turned = UsdShade.Shader.Define(stage, "/Material/Turn")
            turned.CreateIdAttr("UsdTransform2d")
            turned.CreateInput("in", TYPES.Float2).ConnectToSource(source)
            for key, value in transform.items():
                turned.CreateInput(key, TYPES.Float if key == "rotation" else TYPES.Float2).Set(value)
            source = turned.CreateOutput("result", TYPES.Float2)
        picture.CreateInput("st", TYPES.Float2).ConnectToSource(source)
    kind = TYPES.Color3f if name in ("diffuseColor", "emissiveColor", "specularColor") else TYPES.Float
    surface.CreateInput(name, kind).ConnectToSource(
        picture.CreateOutput(channel, TYPES.Float3 if channel == "rgb" else TYPES.Float)
    )


def drawn(stage):
    scene = translate(stage)
    shape = scene.world["shape_0"]
    return scene, shape, scene.world[shape["bsdf"]["id"]]


def srgb(code):
    """IEC 61966-2-1, for one 8-bit code."""
    v = code / 255
    return v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4


def test_the_table_of_srgb_codes_is_the_standard():
    np.testing.assert_allclose(SRGB_TO_LINEAR, [srgb(code) for code in range(256)], rtol=1e-6)
    assert SRGB_TO_LINEAR[0] == 0 and SRGB_TO_LINEAR[255] == 1


def test_unauthored_inputs_take_the_specifications_fallbacks(quad):
    """diffuseColor 0.18, roughness 0.5, ior 1.5, no metal, no coat, opaque."""
    _, _, bsdf = drawn(quad[0])
    assert bsdf["type"] == "twosided"
    np.testing.assert_allclose(bsdf["bsdf"].pop("base_color")["value"], 0.18, rtol=1e-6)
    assert bsdf["bsdf"] == {"type": "preview_surface", "roughness": 0.5, "eta": 1.5}


def test_constants_arrive(quad):
    stage, surface = quad
    for name, kind, value in (
        ("diffuseColor", TYPES.Color3f, (0.1, 0.2, 0.3)),
        ("roughness", TYPES.Float, 0.25),
        ("metallic", TYPES.Float, 1.0),
        ("ior", TYPES.Float, 1.33),
        ("clearcoat", TYPES.Float, 0.5),
        ("clearcoatRoughness", TYPES.Float, 0.25),
    ):
        surface.CreateInput(name, kind).Set(value)
    _, _, bsdf = drawn(stage)
    inner = bsdf["bsdf"]
    np.testing.assert_allclose(inner["base_color"]["value"], [0.1, 0.2, 0.3], rtol=1e-6)
    found = [inner[key] for key in ("roughness", "metallic", "eta", "clearcoat", "clearcoat_roughness")]
    np.testing.assert_allclose(found, [0.25, 1.0, 1.33, 0.5, 0.25], rtol=1e-6)


def test_an_input_connected_to_the_materials_interface_is_followed(quad):
    stage, surface = quad
    knob = UsdShade.Material.Get(stage, "/Material").CreateInput("shine", TYPES.Float)
    knob.Set(0.125)
    surface.CreateInput("roughness", TYPES.Float).ConnectToSource(knob)
    assert drawn(stage)[2]["bsdf"]["roughness"] == 0.125


@pytest.mark.parametrize(
    "opacity, threshold, wanted", [(1.0, 0.0, None), (0.3, 0.0, 0.3), (0.3, 0.5, 0.0), (0.6, 0.5, None)]
)
def test_opacity_masks(quad, opacity, threshold, wanted):
    stage, surface = quad
    surface.CreateInput("opacity", TYPES.Float).Set(opacity)
    surface.CreateInput("opacityThreshold", TYPES.Float).Set(threshold)
    _, _, bsdf = drawn(stage)
    if wanted is None:
        assert bsdf["type"] == "twosided"
    else:
        assert bsdf["type"] == "mask" and bsdf["bsdf"]["type"] == "twosided"
        np.testing.assert_allclose(bsdf["opacity"], wanted, rtol=1e-6)


def test_emission_is_in_nits_and_sits_on_the_shape(quad):
    stage, surface = quad
    surface.CreateInput("emissiveColor", TYPES.Color3f).Set((50, 5, 0))
    _, shape, _ = drawn(stage)
    assert shape["emitter"]["type"] == "area"
    np.testing.assert_allclose(shape["emitter"]["radiance"]["value"], [50, 5, 0])


@pytest.mark.parametrize("roughness", [0.2, 1.0])
def test_without_a_reflection_a_surface_is_lambertian_at_every_angle(quad, roughness):
    """An index of 1: the BSDF times the cosine is albedo / pi times the cosine, from the normal to 85 degrees; Disney's
    diffuse part, which glows at grazing angles, does not follow from the specification.
    """
    from synfog_usd.render.load import to_mitsuba

    stage, surface = quad
    surface.CreateInput("diffuseColor", TYPES.Color3f).Set(Gf.Vec3f(0.2, 0.4, 0.6))
    surface.CreateInput("ior", TYPES.Float).Set(1.0)
    surface.CreateInput("roughness", TYPES.Float).Set(roughness)
    import drjit as dr
    import mitsuba as mi

    bsdf = to_mitsuba(translate(stage)).scene.shapes()[0].bsdf()
    for degrees in (0.0, 45.0, 85.0):
        cosine = float(np.cos(np.radians(degrees)))
        met = dr.zeros(mi.SurfaceInteraction3f)
        met.n = mi.Normal3f(0.0, 0.0, 1.0)
        met.sh_frame = mi.Frame3f(met.n)
        met.wi = mi.Vector3f(float(np.sin(np.radians(85.0))), 0.0, float(np.cos(np.radians(85.0))))
        value = bsdf.eval(mi.BSDFContext(), met, mi.Vector3f(float(np.sin(np.radians(degrees))), 0.0, cosine))
        np.testing.assert_allclose(np.array(value).ravel(), np.array([0.2, 0.4, 0.6]) / np.pi * cosine, rtol=1e-5)


@pytest.mark.parametrize("space, is_srgb", [("auto", True), ("sRGB", True), ("raw", False)])
def test_colour_space_of_an_8_bit_picture(quad, tmp_path, space, is_srgb):
    """'auto' takes 3 channels of 8 bit for sRGB; those stay as codes, which the renderer decodes; raw ones are value /
    255.
    """
    stage, surface = quad
    write(tmp_path / "a.png", CODES[..., :3])
    textured(stage, surface, "diffuseColor", tmp_path / "a.png", sourceColorSpace=space)
    _, _, bsdf = drawn(stage)
    color = bsdf["bsdf"]["base_color"]
    assert color["raw"] is False
    if is_srgb:
        np.testing.assert_array_equal(color["bitmap"], CODES[..., :3])
        assert color["bitmap"].dtype == np.uint8
    else:
        np.testing.assert_allclose(color["bitmap"], CODES[..., :3] / 255, rtol=1e-6)


@pytest.mark.parametrize("pixels", [CODES[..., :1], np.uint16(257) * CODES[..., :3].astype(np.uint16)])
def test_auto_takes_grey_and_16_bit_pictures_as_linear(quad, tmp_path, pixels):
    stage, surface = quad
    write(tmp_path / "a.png", pixels)
    textured(stage, surface, "diffuseColor", tmp_path / "a.png")
    _, _, bsdf = drawn(stage)
    wanted = np.broadcast_to(CODES[..., : pixels.shape[2]] / 255, (4, 4, 3))
    np.testing.assert_allclose(bsdf["bsdf"]["base_color"]["bitmap"], wanted, rtol=1e-5)


@pytest.mark.parametrize("channel, index", [("r", 0), ("g", 1), ("b", 2), ("a", 3)])
def test_a_number_takes_one_channel(quad, tmp_path, channel, index):
    """Packed maps keep roughness in one channel; alpha is never decoded, nor multiplied into the rest."""
    stage, surface = quad
    write(tmp_path / "orm.png", CODES)
    textured(stage, surface, "roughness", tmp_path / "orm.png", channel, sourceColorSpace="raw")
    _, _, bsdf = drawn(stage)
    found = bsdf["bsdf"]["roughness"]
    assert found["raw"] is True
    np.testing.assert_allclose(found["bitmap"][..., 0], CODES[..., index] / 255, rtol=1e-6)


def test_scale_and_bias_come_after_decoding(quad, tmp_path):
    stage, surface = quad
    write(tmp_path / "a.png", CODES[..., :3])
    textured(stage, surface, "diffuseColor", tmp_path / "a.png", scale=(0.5, 0.25, 0.75, 1), bias=(0.25, 0.1, 0.0, 0))
    _, _, bsdf = drawn(stage)
    wanted = np.vectorize(srgb)(CODES[..., :3]) * [0.5, 0.25, 0.75] + [0.25, 0.1, 0.0]
    np.testing.assert_allclose(bsdf["bsdf"]["base_color"]["bitmap"], wanted, rtol=1e-5)


def test_a_picture_without_coordinates_is_its_corner_texel(quad, tmp_path):
    """Without 'st' the specification reads at (0, 0): the lower left, which is the last row of the file."""
    stage, surface = quad
    write(tmp_path / "a.png", CODES[..., :3])
    textured(stage, surface, "diffuseColor", tmp_path / "a.png", st=False)
    _, shape, bsdf = drawn(stage)
    np.testing.assert_allclose(bsdf["bsdf"]["base_color"]["value"], [srgb(c) for c in CODES[3, 0, :3]], rtol=1e-5)
    assert "texcoords" not in shape


def test_a_missing_picture_is_its_fallback_and_a_note(quad):
    stage, surface = quad
    textured(stage, surface, "diffuseColor", "./gone.png", fallback=(0.5, 0.25, 0.125, 1))
    scene, _, bsdf = drawn(stage)
    np.testing.assert_allclose(bsdf["bsdf"]["base_color"]["value"], [0.5, 0.25, 0.125])
    assert any("gone.png" in note.text and note.severity == "warning" for note in scene.notes)


def test_a_broken_picture_is_its_fallback_and_a_note(quad, tmp_path):
    stage, surface = quad
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\nnothing")
    textured(stage, surface, "diffuseColor", tmp_path / "a.png", fallback=(0.5, 0.25, 0.125, 1))
    scene, _, bsdf = drawn(stage)
    np.testing.assert_allclose(bsdf["bsdf"]["base_color"]["value"], [0.5, 0.25, 0.125])
    assert any("a.png" in note.text and note.severity == "warning" for note in scene.notes)


def test_texture_transform_scales_turns_and_shifts_in_that_order(quad, tmp_path):
    """UsdTransform2d: in * scale, rotated counter-clockwise, + translation."""
    stage, surface = quad
    write(tmp_path / "a.png", CODES[..., :3])
    textured(
        stage,
        surface,
        "diffuseColor",
        tmp_path / "a.png",
        transform={"scale": (2, 3), "rotation": 90.0, "translation": (0.25, 0.5)},
    )
    _, shape, _ = drawn(stage)
    by_corner = {
        tuple(np.round(p[[0, 2]]).astype(int)): uv for p, uv in zip(shape["positions"], shape["texcoords"], strict=True)
    }
    for (u, v), found in by_corner.items():
        np.testing.assert_allclose(found, [-3 * v + 0.25, 2 * u + 0.5], atol=1e-6)


@pytest.mark.parametrize("wrap", ["repeat", "mirror", "clamp"])
def test_wrap_modes(quad, tmp_path, wrap):
    stage, surface = quad
    write(tmp_path / "a.png", CODES[..., :3])
    textured(stage, surface, "diffuseColor", tmp_path / "a.png", wrapS=wrap, wrapT=wrap)
    made = drawn(stage)[2]["bsdf"]["base_color"]
    assert made["wrap_mode"] == wrap and "to_uv" not in made


def test_a_mesh_without_the_coordinates_that_its_material_reads_is_noted(quad, tmp_path):
    stage, surface = quad
    write(tmp_path / "a.png", CODES[..., :3])
    textured(stage, surface, "diffuseColor", tmp_path / "a.png")
    UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/Quad")).RemovePrimvar("st")
    scene, shape, bsdf = drawn(stage)
    np.testing.assert_allclose(bsdf["bsdf"]["base_color"]["value"], [srgb(c) for c in CODES[3, 0, :3]], rtol=1e-5)
    assert "texcoords" not in shape and any(note.path == "/Quad" and "'st'" in note.text for note in scene.notes)


def test_pictures_inside_a_usdz_are_read(quad, tmp_path):
    stage, surface = quad
    write(tmp_path / "a.png", CODES[..., :3])
    textured(stage, surface, "diffuseColor", "./a.png")
    stage.GetRootLayer().Export(str(tmp_path / "quad.usdc"))
    assert UsdUtils.CreateNewUsdzPackage(str(tmp_path / "quad.usdc"), str(tmp_path / "quad.usdz"))
    assert len(zipfile.ZipFile(tmp_path / "quad.usdz").namelist()) == 2
    (tmp_path / "a.png").unlink()
    _, _, bsdf = drawn(Usd.Stage.Open(str(tmp_path / "quad.usdz")))
    np.testing.assert_array_equal(bsdf["bsdf"]["base_color"]["bitmap"], CODES[..., :3])


def test_shapes_without_a_material_take_display_colour_or_grey(empty):
    stage = empty()
    UsdGeom.Cube.Define(stage, "/Plain")
    UsdGeom.Xform.Define(stage, "/Group")
    UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/Group")).CreatePrimvar(
        "displayColor", TYPES.Color3fArray, "constant"
    ).Set([(0.25, 0.5, 0.75)])
    for name in "AB":
        UsdGeom.Cube.Define(stage, f"/Group/{name}")
    scene = translate(stage)
    colors = [scene.world[scene.world[f"shape_{n}"]["bsdf"]["id"]]["bsdf"]["reflectance"]["value"] for n in range(3)]
    np.testing.assert_allclose(colors, [[0.18] * 3, [0.25, 0.5, 0.75], [0.25, 0.5, 0.75]])
    assert summary(scene)["materials"] == 2


def test_an_unknown_shader_is_grey_and_noted(quad):
    stage, surface = quad
    surface.GetIdAttr().Set("arnold:standard_surface")
    scene, _, bsdf = drawn(stage)
    np.testing.assert_allclose(bsdf["bsdf"]["reflectance"]["value"], 0.18)
    assert any(note.path == "/Material" and "arnold:standard_surface" in note.text for note in scene.notes)


@pytest.mark.parametrize(
    ("name", "kind", "value", "told"),
    [
        ("displacement", TYPES.Float, 0.2, ["displacement is not drawn"]),
        ("displacement", TYPES.Float, 0.0, []),
        ("normal", TYPES.Normal3f, (0.0, 0.5, 1.0), ["a normal without a picture is not drawn"]),
        ("normal", TYPES.Normal3f, (0.0, 0.0, 1.0), []),
    ],
)
def test_constants_that_are_not_drawn_are_told(quad, name, kind, value, told):
    stage, surface = quad
    surface.CreateInput(name, kind).Set(value)
    assert [note.text for note in translate(stage).notes if note.path == "/Material"] == told


def test_a_shining_picture_is_radiance_times_its_scale(quad, tmp_path):
    """emissiveColor = decoded texel x scale, in nits; the lamp's share of samples follows its mean."""
    stage, surface = quad
    write(tmp_path / "a.png", CODES[..., :3])
    textured(stage, surface, "emissiveColor", tmp_path / "a.png", scale=(200.0, 100.0, 50.0, 1.0))
    _, shape, _ = drawn(stage)
    np.testing.assert_allclose(
        shape["emitter"]["radiance"]["bitmap"], np.vectorize(srgb)(CODES[..., :3]) * [200, 100, 50], rtol=1e-5
    )
    assert "texcoords" in shape


def test_equal_materials_are_one(empty, polygon_mesh):
    """Referenced assets bring a copy of each material; constants that agree are kept once, unused ones not at all."""
    stage = empty()
    for number in range(3):
        mesh = polygon_mesh(stage, f"/M{number}", [(0, 5, 0), (1, 5, 0), (1, 5, 1)], [3], [0, 1, 2])
        material = UsdShade.Material.Define(stage, f"/Paint{number}")
        surface = UsdShade.Shader.Define(stage, f"/Paint{number}/Surface")
        surface.CreateIdAttr("UsdPreviewSurface")
        surface.CreateInput("roughness", TYPES.Float).Set(0.25)
        material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", TYPES.Token))
        UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    assert sum(key.startswith("mat_") for key in translate(stage).world) == 1


@pytest.mark.parametrize(
    "scale, bias, slope",
    [
        ((2, 2, 2), (-1, -1, -1), (1, 1)),
        ((2, -2, 2), (-1, 1, -1), (1, -1)),
        ((1, -1, 1), (0, 1, 0), (1, -1)),
        ((-2, 2, 2), (1, -1, -1), (-1, 1)),
        ((1, 1, 2), (-0.5, -0.5, -1), (0.5, 0.5)),
        ((2, -2, 2), (-1, -1, -1), None),
        ((2, 2, -2), (-1, -1, 1), None),
        ((3, 1, 2), (0, 0, 0), None),
    ],
)
def test_normal_maps_are_drawn_as_their_scale_and_bias_turn_them(quad, tmp_path, scale, bias, slope):
    """Green turned is DirectX's handedness; half the scale, half the slope; what puts a flat map askew or inside out is
    left out with a note.
    """
    stage, surface = quad
    codes = np.array([[(128, 128, 255), (180, 90, 220), (60, 200, 230)]], dtype=np.uint8)
    write(tmp_path / "bumps.png", codes)
    textured(stage, surface, "normal", tmp_path / "bumps.png", scale=(*scale, 1), bias=(*bias, 0))
    scene, _, bsdf = drawn(stage)
    bsdf = bsdf["bsdf"]
    assert (bsdf["type"] == "normalmap") == (slope is not None)
    assert any("normal map" in note.text and "left out" in note.text for note in scene.notes) == (slope is None)
    if slope is not None:
        own, seen = (
            codes / 255 * 2.0 - 1.0,
            np.asarray(bsdf["normalmap"]["bitmap"], dtype=np.float64)[..., :3] * 2.0 - 1.0,
        )
        np.testing.assert_allclose(
            seen[..., :2] / seen[..., 2:], own[..., :2] / own[..., 2:] * slope, rtol=1e-5, atol=1e-6
        )


def test_the_specular_workflow_is_its_colour_and_its_picture(quad, tmp_path):
    """specularColor is the reflection at normal incidence; metallic is not asked, and ior is the coat's alone."""
    stage, surface = quad
    surface.CreateInput("useSpecularWorkflow", TYPES.Int).Set(1)
    surface.CreateInput("metallic", TYPES.Float).Set(1.0)
    colour = surface.CreateInput("specularColor", TYPES.Color3f)
    colour.Set((0.5, 0.25, 0.125))
    inner = drawn(stage)[2]["bsdf"]
    assert inner["type"] == "preview_surface" and "metallic" not in inner
    np.testing.assert_allclose(inner["specular"]["value"], [0.5, 0.25, 0.125])
    write(tmp_path / "a.png", CODES[..., :3])
    textured(stage, surface, "specularColor", tmp_path / "a.png")
    made = drawn(stage)[2]["bsdf"]["specular"]
    np.testing.assert_array_equal(made["bitmap"], CODES[..., :3])


def test_materials_that_say_the_same_are_drawn_alike_and_told_one_by_one(empty, polygon_mesh):
    """Four quads: two materials of one colour are one BSDF, and each is told of its displacement; of two that read
    their colour from a prim elsewhere each has the colour that stands there.
    """
    stage = empty()
    red, blue = (0.8, 0.1, 0.1), (0.1, 0.1, 0.8)
    for number, (colour, elsewhere) in enumerate([(red, False), (red, False), (red, True), (blue, True)]):
        corners = [(number, 5, 0), (number + 1, 5, 0), (number + 1, 5, 1), (number, 5, 1)]
        mesh = polygon_mesh(stage, f"/Quad{number}", corners, [4], [0, 1, 2, 3])
        material = UsdShade.Material.Define(stage, f"/Material{number}")
        surface = UsdShade.Shader.Define(stage, f"/Material{number}/Surface")
        surface.CreateIdAttr("UsdPreviewSurface")
        given = surface.CreateInput("diffuseColor", TYPES.Color3f)
        if elsewhere:
            source = UsdShade.NodeGraph.Define(stage, f"/Colours{number}").CreateInput("colour", TYPES.Color3f)
            source.Set(Gf.Vec3f(*colour))
            given.ConnectToSource(source)
        else:
            given.Set(Gf.Vec3f(*colour))
            surface.CreateInput("displacement", TYPES.Float).Set(0.5)
        material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", TYPES.Token))
        UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    scene = translate(stage)
    worn = [scene.world[f"shape_{number}"]["bsdf"]["id"] for number in range(4)]
    colours = [scene.world[key]["bsdf"]["base_color"]["value"] for key in worn]
    np.testing.assert_allclose(colours, [red, red, red, blue], rtol=1e-6)
    assert worn[0] == worn[1] != worn[3]
    told = {note.path for note in scene.notes if "displacement" in note.text}
    assert told == {"/Material0", "/Material1"}


@pytest.mark.parametrize("channel", ["r", "g", "b", "a"])
def test_one_channel_of_a_picture_is_decoded_as_all_of_them_are(quad, tmp_path, channel):
    """Roughness from a picture of 1 to 4 channels, in sRGB and raw: the channel that is named, a grey one for red,
    green and blue, and 1 for an alpha that is not there; colour by the sRGB table, alpha as it stands.
    """
    for count in (1, 2, 3, 4):
        for space in ("raw", "sRGB"):
            stage, surface = quad
            file = tmp_path / f"{count}.png"
            write(file, CODES[..., :count])
            textured(stage, surface, "roughness", file, channel, sourceColorSpace=space)
            got = drawn(stage)[2]["bsdf"]["roughness"]
            grey = count <= 2
            place = "rgba".index(channel) if not grey else (1 if channel == "a" else 0)
            if place >= count:
                assert (got["bitmap"] == 1.0).all()
                continue
            codes = CODES[..., place]
            plain = space == "raw" or (channel == "a" and count == 4)
            wanted = codes / 255.0 if plain else SRGB_TO_LINEAR[codes]
            np.testing.assert_allclose(got["bitmap"][..., 0], wanted, atol=1e-6)
