"""Materials and textures: each input arrives as the number the specification gives it."""

import zipfile
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdShade, UsdUtils
from support.looks import SQUARE, TYPES, linear, painted, put, shade, with_st, write

from synfog_usd.translate import translate
from synfog_usd.translate.texture import SRGB_TO_LINEAR

CODES = np.random.default_rng(5).integers(0, 256, (4, 4, 4), dtype=np.uint8)


@pytest.fixture
def quad(empty, polygon_mesh):
    """A quad with texture coordinates 'st' and a preview surface to fill in: (stage, surface)."""
    stage = empty()
    painted(with_st(polygon_mesh(stage, "/Quad", SQUARE, [4], [0, 1, 2, 3])).GetPrim())
    return stage, UsdShade.Shader.Get(stage, "/Material/Surface")


def textured(stage, surface, name, file, channel="rgb", *, st=True, **inputs):
    more = {}
    if st:
        more["st"] = shade(stage, "/Material/Reader", "UsdPrimvarReader_float2", "result", TYPES.Float2, varname="st")
    wraps = {"wrapS": "repeat", "wrapT": "repeat"}
    gives = TYPES.Float3 if channel == "rgb" else TYPES.Float
    path = f"/Material/{name}Picture"
    put(surface, name, shade(stage, path, "UsdUVTexture", channel, gives, file=Path(file), **more, **wraps | inputs))


def drawn(stage):
    scene = translate(stage)
    shape = scene.world["shape_0"]
    return scene, shape, scene.world[shape["bsdf"]["id"]]


def test_unauthored_inputs_take_the_specifications_fallbacks(quad):
    """diffuseColor 0.18, roughness 0.5, ior 1.5, no metal, no coat, opaque."""
    _, _, bsdf = drawn(quad[0])
    assert bsdf["type"] == "twosided"
    np.testing.assert_allclose(bsdf["bsdf"].pop("base_color")["value"], 0.18, rtol=1e-6)
    assert bsdf["bsdf"] == {"type": "preview_surface", "roughness": 0.5, "eta": 1.5}


def test_constants_arrive(quad):
    stage, surface = quad
    given = {"roughness": 0.25, "metallic": 1.0, "ior": 1.33, "clearcoat": 0.5, "clearcoatRoughness": 0.25}
    for name, value in ({"diffuseColor": (0.1, 0.2, 0.3)} | given).items():
        put(surface, name, value)
    inner = drawn(stage)[2]["bsdf"]
    np.testing.assert_allclose(inner["base_color"]["value"], [0.1, 0.2, 0.3], rtol=1e-6)
    names = ("roughness", "metallic", "eta", "clearcoat", "clearcoat_roughness")
    np.testing.assert_allclose([inner[key] for key in names], [*given.values()], rtol=1e-6)


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


def test_without_a_reflection_a_surface_is_lambertian_at_every_angle(quad):
    """An index of 1: the BSDF times the cosine is albedo / pi times the cosine, from the normal to 85 degrees."""
    from synfog_usd.render.load import to_mitsuba

    stage, surface = quad
    for name, value in (("diffuseColor", (0.2, 0.4, 0.6)), ("ior", 1.0), ("roughness", 0.2)):
        put(surface, name, value)
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


def test_scale_and_bias_come_after_decoding(quad, tmp_path):
    stage, surface = quad
    write(tmp_path / "a.png", CODES[..., :3])
    textured(stage, surface, "diffuseColor", tmp_path / "a.png", scale=(0.5, 0.25, 0.75, 1), bias=(0.25, 0.1, 0.0, 0))
    _, _, bsdf = drawn(stage)
    wanted = linear(CODES[..., :3]) * [0.5, 0.25, 0.75] + [0.25, 0.1, 0.0]
    np.testing.assert_allclose(bsdf["bsdf"]["base_color"]["bitmap"], wanted, rtol=1e-5)


def test_a_picture_without_coordinates_is_its_corner_texel(quad, tmp_path):
    """Without 'st' the specification reads at (0, 0): the lower left, which is the last row of the file."""
    stage, surface = quad
    write(tmp_path / "a.png", CODES[..., :3])
    textured(stage, surface, "diffuseColor", tmp_path / "a.png", st=False)
    _, shape, bsdf = drawn(stage)
    np.testing.assert_allclose(bsdf["bsdf"]["base_color"]["value"], linear(CODES[3, 0, :3]), rtol=1e-5)
    assert "texcoords" not in shape


@pytest.mark.parametrize("name", ["gone.png", "broken.png"])
def test_a_picture_that_is_missing_or_broken_is_its_fallback_and_a_note(quad, tmp_path, name):
    stage, surface = quad
    (tmp_path / "broken.png").write_bytes(b"\x89PNG\r\n\x1a\nnothing")
    textured(stage, surface, "diffuseColor", tmp_path / name, fallback=(0.5, 0.25, 0.125, 1))
    scene, _, bsdf = drawn(stage)
    np.testing.assert_allclose(bsdf["bsdf"]["base_color"]["value"], [0.5, 0.25, 0.125])
    assert any(name in note.text and note.severity == "warning" for note in scene.notes)


def test_a_mesh_without_the_coordinates_that_its_material_reads_is_noted(quad, tmp_path):
    stage, surface = quad
    write(tmp_path / "a.png", CODES[..., :3])
    textured(stage, surface, "diffuseColor", tmp_path / "a.png")
    UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/Quad")).RemovePrimvar("st")
    scene, shape, bsdf = drawn(stage)
    np.testing.assert_allclose(bsdf["bsdf"]["base_color"]["value"], linear(CODES[3, 0, :3]), rtol=1e-5)
    assert "texcoords" not in shape and any(note.path == "/Quad" and "'st'" in note.text for note in scene.notes)


def test_pictures_inside_a_usdz_are_read(quad, tmp_path):
    stage, surface = quad
    write(tmp_path / "a.png", CODES[..., :3])
    textured(stage, surface, "diffuseColor", "a.png")
    stage.GetRootLayer().Export(str(tmp_path / "quad.usdc"))
    assert UsdUtils.CreateNewUsdzPackage(str(tmp_path / "quad.usdc"), str(tmp_path / "quad.usdz"))
    assert len(zipfile.ZipFile(tmp_path / "quad.usdz").namelist()) == 2
    (tmp_path / "a.png").unlink()
    _, _, bsdf = drawn(Usd.Stage.Open(str(tmp_path / "quad.usdz")))
    np.testing.assert_array_equal(bsdf["bsdf"]["base_color"]["bitmap"], CODES[..., :3])


def test_a_shining_picture_is_radiance_times_its_scale(quad, tmp_path):
    """emissiveColor = decoded texel x scale, in nits; the lamp's share of samples follows its mean."""
    stage, surface = quad
    write(tmp_path / "a.png", CODES[..., :3])
    textured(stage, surface, "emissiveColor", tmp_path / "a.png", scale=(200.0, 100.0, 50.0, 1.0))
    _, shape, _ = drawn(stage)
    np.testing.assert_allclose(
        shape["emitter"]["radiance"]["bitmap"], linear(CODES[..., :3]) * [200, 100, 50], rtol=1e-5
    )
    assert "texcoords" in shape


@pytest.mark.parametrize("scale, bias, slope", [
    ((2, 2, 2), (-1, -1, -1), (1, 1)),
    ((2, -2, 2), (-1, 1, -1), (1, -1)),
    ((1, 1, 2), (-0.5, -0.5, -1), (0.5, 0.5)),
    ((2, -2, 2), (-1, -1, -1), None),
    ((3, 1, 2), (0, 0, 0), None),
])  # fmt: skip
def test_normal_maps_are_drawn_as_their_scale_and_bias_turn_them(quad, tmp_path, scale, bias, slope):
    """Green turned is DirectX's handedness; half the scale, half the slope."""
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
    """Four quads: two materials of one colour are one BSDF, and each is told of its displacement."""
    stage = empty()
    red, blue = (0.8, 0.1, 0.1), (0.1, 0.1, 0.8)
    for number, (colour, elsewhere) in enumerate([(red, False), (red, False), (red, True), (blue, True)]):
        corners = [(number, 5, 0), (number + 1, 5, 0), (number + 1, 5, 1), (number, 5, 1)]
        prim = polygon_mesh(stage, f"/Quad{number}", corners, [4], [0, 1, 2, 3]).GetPrim()
        path = f"/Material{number}"
        painted(prim, path, **({} if elsewhere else {"diffuseColor": colour, "displacement": 0.5}))
        if elsewhere:
            source = UsdShade.NodeGraph.Define(stage, f"/Colours{number}").CreateInput("colour", TYPES.Color3f)
            source.Set(colour)
            surface = UsdShade.Shader.Get(stage, f"{path}/Surface")
            surface.CreateInput("diffuseColor", TYPES.Color3f).ConnectToSource(source)
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
