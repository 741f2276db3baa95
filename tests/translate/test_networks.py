"""Shader networks beyond UsdPreviewSurface, tiles, and textures with coordinates of their own."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pxr import UsdGeom, UsdLux, UsdShade
from support.looks import SQUARE, TYPES, linear, shade, with_st, write

from synfog_usd.render.shot import render
from synfog_usd.translate import translate

CODES = np.random.default_rng(6).integers(20, 236, (4, 4, 3), dtype=np.uint8)


@pytest.fixture
def quad(empty, polygon_mesh):
    """A unit quad in x and z with 'st' as its coordinates, and a function that adds a shader to its material."""
    stage = empty()
    mesh = with_st(polygon_mesh(stage, "/Quad", SQUARE, [4], [0, 1, 2, 3]))
    material = UsdShade.Material.Define(stage, "/Material")
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)

    def shader(name, kind, surface="", **inputs):
        path, output = f"/Material/{name}", "surface" if surface in ("", "universal") else "out"
        out = shade(stage, path, kind, output, **inputs)
        if surface:
            material.CreateSurfaceOutput("" if surface == "universal" else surface).ConnectToSource(out)
        return UsdShade.Shader(out.GetPrim())

    return stage, shader


def drawn(stage):
    scene = translate(stage)
    shape = scene.world["shape_0"]
    return scene, shape, scene.world[shape["bsdf"]["id"]]


def image(shader, name, file, kind="ND_image_color3", output="out", space="srgb_texture", **inputs):
    made = shader(name, kind, file=file, **inputs)
    if space:
        made.GetInput("file").GetAttr().SetColorSpace(space)
    return made.CreateOutput(output, TYPES.Color3f)


def test_standard_surface_weighs_its_picture(quad, tmp_path):
    """base x base_color, decoded from sRGB as its colour space says."""
    stage, shader = quad
    write(tmp_path / "a.png", CODES)
    shader(
        "Surface", "ND_standard_surface_surfaceshader", "mtlx", base=0.5,
        base_color=image(shader, "Picture", tmp_path / "a.png"), specular_roughness=0.3, metalness=0.25,
        specular_IOR=1.4, coat=0.75, emission=10.0, emission_color=(1, 0.5, 0.25), opacity=(0.5, 0.5, 0.5),
    )  # fmt: skip
    _, shape, bsdf = drawn(stage)
    assert (bsdf["type"], bsdf["opacity"]) == ("mask", 0.5)
    inner = bsdf["bsdf"]["bsdf"]
    np.testing.assert_allclose(inner["base_color"]["bitmap"], 0.5 * linear(CODES), rtol=1e-5)
    np.testing.assert_allclose(
        [inner[name] for name in ("roughness", "metallic", "eta", "clearcoat", "clearcoat_roughness")],
        [0.3, 0.25, 1.4, 0.75, 0.1],
        rtol=1e-6,
    )
    assert shape["emitter"]["radiance"]["value"] == [10.0, 5.0, 2.5]
    np.testing.assert_allclose(shape["texcoords"], shape["positions"][:, [0, 2]], atol=1e-6)


@pytest.mark.parametrize("kind, color, roughness, metal, f0", [
    ("ND_standard_surface_surfaceshader", 0.8, 0.2, 0.0, 0.04),
    ("ND_gltf_pbr_surfaceshader", 1.0, 1.0, 1.0, 0.04),
])  # fmt: skip
def test_what_is_not_authored_takes_the_nodes_own_defaults(quad, kind, color, roughness, metal, f0):
    """And no light: by their definitions."""
    stage, shader = quad
    shader("Surface", kind, "mtlx")
    _, shape, bsdf = drawn(stage)
    np.testing.assert_allclose(bsdf["bsdf"]["base_color"]["value"], color)
    assert bsdf["bsdf"]["roughness"] == pytest.approx(roughness) and "emitter" not in shape
    assert bsdf["bsdf"].get("metallic", 0.0) == metal and reflectivity(bsdf["bsdf"]["eta"]) == pytest.approx(f0)


def test_open_pbr_shines_in_nits(quad):
    stage, shader = quad
    shader(
        "Surface", "ND_open_pbr_surface_surfaceshader", "mtlx", base_color=(0.1, 0.2, 0.3), base_metalness=1.0,
        fuzz_weight=0.5, emission_luminance=1000.0, emission_color=(1, 1, 0.5),
    )  # fmt: skip
    scene, shape, bsdf = drawn(stage)
    np.testing.assert_allclose(bsdf["bsdf"]["base_color"]["value"], [0.1, 0.2, 0.3], rtol=1e-6)
    assert (bsdf["bsdf"]["metallic"], shape["emitter"]["radiance"]["value"]) == (1.0, [1000.0, 1000.0, 500.0])
    assert any("fuzz_weight is not drawn" in note.text and note.severity == "warning" for note in scene.notes)


@pytest.mark.parametrize("kind, output, more, index", [
    ("ND_separate3_color3", "outg", {}, 1),
    ("ND_separate3_color3", "outb", {}, 2),
    ("ND_extract_color3", "out", {"index": 2}, 2),
])  # fmt: skip
def test_channels_are_taken_apart(quad, tmp_path, kind, output, more, index):
    stage, shader = quad
    write(tmp_path / "orm.png", CODES)
    picture = image(shader, "Picture", tmp_path / "orm.png", space="lin_rec709")
    apart = shader("Apart", kind, **{"in": picture}, **more).CreateOutput(output, TYPES.Float)
    shader("Surface", "ND_standard_surface_surfaceshader", "mtlx", specular_roughness=apart)
    roughness = drawn(stage)[2]["bsdf"]["roughness"]
    np.testing.assert_allclose(roughness["bitmap"][..., 0], CODES[..., index] / 255, rtol=1e-6)


def test_nodes_on_the_way_are_passed_with_a_note(quad, tmp_path):
    """A blur between picture and colour is left out, which is better than a grey car."""
    stage, shader = quad
    write(tmp_path / "a.png", CODES)
    contrast = shader("More", "ND_blur_color3", **{"in": image(shader, "Picture", tmp_path / "a.png")})
    shader(
        "Surface", "ND_standard_surface_surfaceshader", "mtlx", base_color=contrast.CreateOutput("out", TYPES.Color3f)
    )
    scene, _, bsdf = drawn(stage)
    np.testing.assert_array_equal(bsdf["bsdf"]["base_color"]["bitmap"], CODES)
    assert any("ND_blur_color3" in note.text and note.severity == "warning" for note in scene.notes)


def test_materialx_normal_maps_are_decoded(quad, tmp_path):
    """Codes of [0, 255] stay as they are: the renderer decodes 2 c - 1."""
    stage, shader = quad
    write(tmp_path / "n.png", CODES)
    picture = image(shader, "Picture", tmp_path / "n.png", kind="ND_image_vector3", space="")
    normal = shader("Normal", "ND_normalmap", **{"in": picture}).CreateOutput("out", TYPES.Float3)
    shader("Surface", "ND_standard_surface_surfaceshader", "mtlx", normal=normal)
    bsdf = drawn(stage)[2]["bsdf"]
    assert bsdf["type"] == "normalmap"
    np.testing.assert_allclose(bsdf["normalmap"]["bitmap"], CODES / 255, rtol=1e-6)


def test_tiled_images_repeat(quad, tmp_path):
    """uv x tiling - offset."""
    stage, shader = quad
    write(tmp_path / "a.png", CODES)
    more = {"uvtiling": (3, 2), "uvoffset": (0.5, 0.25)}
    picture = image(shader, "Picture", tmp_path / "a.png", kind="ND_tiledimage_color3", **more)
    shader("Surface", "ND_standard_surface_surfaceshader", "mtlx", base_color=picture)
    _, shape, _ = drawn(stage)
    np.testing.assert_allclose(shape["texcoords"], shape["positions"][:, [0, 2]] * [3, 2] - [0.5, 0.25], atol=1e-6)


def reflectivity(eta):
    """Fresnel's, straight on."""
    return ((eta - 1) / (eta + 1)) ** 2


def gltf(shader, **inputs):
    return shader("Surface", "ND_gltf_pbr_surfaceshader", "mtlx", **inputs)


def test_a_gltf_surface_is_drawn_by_its_inputs(quad):
    """glTF 2.0, appendix B, and KHR_materials_ior, _specular, _clearcoat and _emissive_strength: the reflectivity is
    specular ((ior - 1) / (ior + 1))^2, and light is in nits.
    """
    stage, shader = quad
    gltf(
        shader, base_color=(0.8, 0.4, 0.2), metallic=0.25, roughness=0.3, ior=1.33, specular=0.5, clearcoat=0.6,
        clearcoat_roughness=0.2, emissive=(1.0, 0.5, 0.25), emissive_strength=4.0, occlusion=0.1,
        sheen_color=(0.0, 0.0, 0.0),
    )  # fmt: skip
    scene, shape, bsdf = drawn(stage)
    inner = bsdf["bsdf"]
    np.testing.assert_allclose(inner["base_color"]["value"], [0.8, 0.4, 0.2], rtol=1e-6)
    np.testing.assert_allclose(
        [inner[name] for name in ("metallic", "roughness", "clearcoat", "clearcoat_roughness")], [0.25, 0.3, 0.6, 0.2]
    )
    assert reflectivity(inner["eta"]) == pytest.approx(0.5 * reflectivity(1.33))
    assert shape["emitter"]["radiance"]["value"] == [4.0, 2.0, 1.0]
    assert [note.text for note in scene.notes if note.severity == "warning"] == []


@pytest.mark.parametrize("mode, alpha, more, seen", [
    (0, 0.3, {}, 1.0),
    (1, 0.3, {}, 0.0),
    (1, 0.5, {}, 1.0),
    (1, 0.3, {"alpha_cutoff": 0.2}, 1.0),
    (1, 0.0, {"alpha_cutoff": 0.0}, 1.0),
    (2, 0.3, {"alpha_cutoff": 0.9}, 0.3),
])  # fmt: skip
def test_alpha_counts_as_gltfs_mode_says(quad, mode, alpha, more, seen):
    """OPAQUE leaves it, MASK draws where it is at least the cutoff, 0.5 by default, BLEND takes it."""
    stage, shader = quad
    gltf(shader, alpha=alpha, alpha_mode=mode, **more)
    bsdf = drawn(stage)[2]
    assert bsdf.get("opacity", 1.0) == pytest.approx(seen)


def test_a_gltf_picture_is_placed_multiplied_and_cut_out(quad, tmp_path):
    """gltf_colorimage: its colour times colour, its alpha times alpha against the cutoff."""
    stage, shader = quad
    pixels = np.concatenate([CODES, np.linspace(0, 255, 16).reshape(4, 4, 1).astype(np.uint8)], axis=2)
    write(tmp_path / "a.png", pixels)
    made = shader(
        "Picture", "ND_gltf_colorimage", file=tmp_path / "a.png", color=(0.5, 1.0, 1.0, 0.5), scale=(2.0, 3.0),
        rotate=30.0, offset=(0.25, 0.125),
    )  # fmt: skip
    made.GetInput("file").GetAttr().SetColorSpace("srgb_texture")
    colour, alpha = made.CreateOutput("outcolor", TYPES.Color3f), made.CreateOutput("outa", TYPES.Float)
    gltf(shader, base_color=colour, alpha=alpha, alpha_mode=1, alpha_cutoff=0.2)
    _, shape, bsdf = drawn(stage)
    np.testing.assert_array_equal(bsdf["opacity"]["bitmap"][..., 0], 0.5 * pixels[..., 3] / 255 >= 0.2)
    np.testing.assert_allclose(bsdf["bsdf"]["bsdf"]["base_color"]["bitmap"], linear(CODES) * [0.5, 1.0, 1.0], rtol=1e-5)
    c, s = math.cos(math.radians(30)), math.sin(math.radians(30))
    u, v = shape["positions"][:, 0], 1 - shape["positions"][:, 2]
    moved = np.stack([c * 2 * u + s * 3 * v + 0.25, -s * 2 * u + c * 3 * v + 0.125], axis=1)
    np.testing.assert_allclose(shape["texcoords"], moved * [1, -1] + [0, 1], atol=1e-5)


@pytest.mark.parametrize("thickness, kind", [(0.0, "thindielectric"), (0.5, "dielectric")])
def test_gltf_glass_is_thin_unless_it_has_a_volume(quad, thickness, kind):
    """KHR_materials_transmission and _volume; what passes has the base colour."""
    stage, shader = quad
    gltf(
        shader, base_color=(0.5, 1.0, 1.0), metallic=0.0, roughness=0.0, transmission=0.75, ior=1.4, thickness=thickness
    )
    bsdf = drawn(stage)[2]
    assert (bsdf["type"], bsdf["weight"], bsdf["bsdf_1"]["type"]) == ("blendbsdf", 0.75, kind)
    assert bsdf["bsdf_1"]["int_ior"] == pytest.approx(1.4)
    assert bsdf["bsdf_1"]["specular_transmittance"]["value"] == [0.5, 1.0, 1.0]


def test_a_preview_surface_in_materialx_is_a_preview_surface(quad):
    """ND_UsdPreviewSurface_surfaceshader has the inputs and defaults of UsdPreviewSurface."""
    stage, shader = quad
    inputs = {
        "diffuseColor": (0.1, 0.2, 0.3), "metallic": 0.25, "ior": 1.4, "clearcoat": 0.5, "opacity": 0.5,
        "opacityThreshold": 0.25, "emissiveColor": (1, 2, 3),
    }  # fmt: skip
    shader("Surface", "ND_UsdPreviewSurface_surfaceshader", "mtlx", **inputs)
    _, shape, bsdf = drawn(stage)
    shader("Plain", "UsdPreviewSurface", "universal", **inputs)
    _, same_shape, same = drawn(stage)
    np.testing.assert_equal((shape, bsdf), (same_shape, same))
    assert bsdf["type"] == "twosided" and bsdf["bsdf"]["metallic"] == 0.25


def mdl(shader, file, kind, **inputs):
    """A surface of NVIDIA's MDL files."""
    made = shader("Surface", "", "mdl", **inputs)
    made.GetPrim().CreateAttribute("info:implementationSource", TYPES.Token).Set("sourceAsset")
    made.GetPrim().CreateAttribute("info:mdl:sourceAsset", TYPES.Asset).Set(file)
    made.GetPrim().CreateAttribute("info:mdl:sourceAsset:subIdentifier", TYPES.Token).Set(kind)
    return made


def test_a_matte_surface_reflects_its_colour_in_the_picture(quad):
    """Under a sky of 100 nits everywhere, a surface that only scatters is as bright as its colour times that."""
    stage, shader = quad
    shader("Surface", "ND_gltf_pbr_surfaceshader", "mtlx", metallic=0.0, specular=0.0, base_color=(0.8, 0.4, 0.2))
    UsdLux.DomeLight.Define(stage, "/Sky").CreateIntensityAttr(100.0)
    camera = UsdGeom.Camera(stage.GetPrimAtPath("/Camera"))
    camera.CreateFocalLengthAttr(1000.0)  # a degree about the middle of the quad's lower edge ...
    camera.CreateVerticalApertureOffsetAttr(100.0)  # ... and half a metre above it
    camera.CreateHorizontalApertureOffsetAttr(100.0)
    scene = translate(stage, resolution=(4, 4))
    seen = render(scene, samples=256).radiance.pixels  # a standard error of 0.1 percent
    np.testing.assert_allclose(seen.mean(axis=(0, 1)), [80.0, 40.0, 20.0], rtol=0.005)


@pytest.mark.parametrize("on", [False, True])
def test_omnipbr_constants_count_where_they_are_switched_on(quad, on):
    """Opacity and emission wait for their switches; intensity times colour is the radiance."""
    stage, shader = quad
    mdl(
        shader, "OmniPBR.mdl", "OmniPBR", diffuse_color_constant=(0.1, 0.2, 0.3), reflection_roughness_constant=0.7,
        opacity_constant=0.25, enable_opacity=on, emissive_color=(1, 0.5, 0), emissive_intensity=200.0,
        enable_emission=on,
    )  # fmt: skip
    _, shape, bsdf = drawn(stage)
    assert bsdf["type"] == ("mask" if on else "twosided") and ("emitter" in shape) is on
    inner = bsdf["bsdf"]["bsdf"] if on else bsdf["bsdf"]
    np.testing.assert_allclose([*inner["base_color"]["value"], inner["roughness"]], [0.1, 0.2, 0.3, 0.7], rtol=1e-6)
    if on:
        assert shape["emitter"]["radiance"]["value"] == [200.0, 100.0, 0.0]


def test_omnipbr_pictures_are_read(quad, tmp_path):
    """The base times its tint; roughness from the green and metalness from the blue channel of an ORM map."""
    stage, shader = quad
    write(tmp_path / "a.png", CODES)
    write(tmp_path / "orm.png", CODES[::-1].copy())
    mdl(
        shader, "OmniPBR.mdl", "OmniPBR", diffuse_texture=tmp_path / "a.png", diffuse_tint=(0.5, 1, 1),
        ORM_texture=tmp_path / "orm.png", enable_ORM_texture=True, texture_scale=(2, 2),
    )  # fmt: skip
    _, shape, bsdf = drawn(stage)
    np.testing.assert_allclose(bsdf["bsdf"]["base_color"]["bitmap"], linear(CODES) * [0.5, 1, 1], rtol=1e-5)
    np.testing.assert_allclose(bsdf["bsdf"]["roughness"]["bitmap"][..., 0], CODES[::-1, :, 1] / 255, rtol=1e-6)
    np.testing.assert_allclose(bsdf["bsdf"]["metallic"]["bitmap"][..., 0], CODES[::-1, :, 2] / 255, rtol=1e-6)
    np.testing.assert_allclose(shape["texcoords"], 2 * shape["positions"][:, [0, 2]], atol=1e-6)


def test_omnipbr_changes_its_pictures_as_its_formulas_say(quad, tmp_path):
    """Brightness and addition before the tint, a share of grey of Rec.709 luminance; roughness between its constant
    and its map; light behind a mask; a reflectivity of 8 percent times the specular level; slopes by the bump factor.
    """
    stage, shader = quad
    write(tmp_path / "a.png", CODES)
    file = tmp_path / "a.png"
    mdl(
        shader, "OmniPBR.mdl", "OmniPBR", diffuse_texture=file, albedo_brightness=0.5, albedo_add=0.1,
        albedo_desaturation=0.25, diffuse_tint=(0.5, 1, 1), reflectionroughness_texture=file,
        reflection_roughness_texture_influence=0.75, reflection_roughness_constant=0.4, specular_level=0.25,
        enable_emission=True, emissive_mask_texture=file, emissive_color=(1, 0.5, 0), emissive_intensity=10.0,
        normalmap_texture=file, bump_factor=0.5,
    )  # fmt: skip
    _, shape, bsdf = drawn(stage)
    normals, bsdf = bsdf["bsdf"]["normalmap"]["bitmap"], bsdf["bsdf"]["bsdf"]
    bright = linear(CODES) * 0.5 + 0.1
    grey = (bright @ [0.2126729, 0.7151522, 0.0721750])[..., None]
    np.testing.assert_allclose(bsdf["base_color"]["bitmap"], (0.75 * bright + 0.25 * grey) * [0.5, 1, 1], rtol=1e-4)
    np.testing.assert_allclose(bsdf["roughness"]["bitmap"][..., 0], 0.75 * CODES[..., 0] / 255 + 0.1, rtol=1e-5)
    assert ((bsdf["eta"] - 1) / (bsdf["eta"] + 1)) ** 2 == pytest.approx(0.02)
    np.testing.assert_allclose(shape["emitter"]["radiance"]["bitmap"], linear(CODES) * [10, 5, 0], rtol=1e-4)
    slopes = (CODES / 127.5 - 1) * [0.5, 0.5, 1]
    np.testing.assert_allclose(2 * normals - 1, slopes / np.linalg.norm(slopes, axis=2, keepdims=True), atol=1e-5)


def reader_of(shader, name, **transform):
    reader = shader(f"{name}Reader", "UsdPrimvarReader_float2", varname="st").CreateOutput("result", TYPES.Float2)
    if not transform:
        return reader
    return shader(f"{name}Turn", "UsdTransform2d", **{"in": reader}, **transform).CreateOutput("result", TYPES.Float2)


def test_tiles_lie_side_by_side(quad, tmp_path):
    """1001 and 1002 in the lower row, 1012 above the second; a quad over 2 x 2 tiles finds each where its number
    says.
    """
    stage, shader = quad
    tiles = {1001: CODES, 1002: CODES[::-1].copy(), 1012: CODES[:2, :2].copy()}
    for number, pixels in tiles.items():
        write(tmp_path / f"paint.{number}.png", pixels)
    stage.GetRootLayer().Export(str(tmp_path / "stage.usda"))
    coordinates = reader_of(shader, "Picture", scale=(2, 2))
    picture = shader("Picture", "UsdUVTexture", file=tmp_path / "paint.<UDIM>.png", st=coordinates)
    shader("Surface", "UsdPreviewSurface", "universal", diffuseColor=picture.CreateOutput("rgb", TYPES.Float3))
    _, shape, bsdf = drawn(stage)
    pixels = bsdf["bsdf"]["base_color"]["bitmap"]
    assert pixels.shape == (8, 8, 3)
    np.testing.assert_array_equal(pixels[4:, :4], tiles[1001])
    np.testing.assert_array_equal(pixels[4:, 4:], tiles[1002])
    assert not pixels[:4, :4].any()
    np.testing.assert_allclose(
        pixels[:4, 4:].mean(axis=(0, 1)), tiles[1012].mean(axis=(0, 1)), atol=6
    )  # grown to the others' size, filtered
    np.testing.assert_allclose(shape["texcoords"], shape["positions"][:, [0, 2]], atol=1e-6)


def test_each_texture_is_looked_up_by_its_own_transform(quad, tmp_path):
    """Roughness is read at M st and colour at N st: the renderer finds in both the texel that the specification asks
    for.
    """
    stage, shader = quad
    write(tmp_path / "a.png", CODES)
    write(tmp_path / "b.png", CODES[:, ::-1].copy())
    turns = {"A": {"scale": (2, 0.5), "translation": (0.25, 0.125)}, "B": {"rotation": 90.0, "translation": (1.0, 0.0)}}
    inputs = {}
    for name, key, output in (("A", "diffuseColor", "rgb"), ("B", "roughness", "g")):
        picture = shader(
            f"Picture{name}", "UsdUVTexture", file=tmp_path / f"{name.lower()}.png", sourceColorSpace="raw",
            st=reader_of(shader, name, **turns[name]), wrapS="repeat", wrapT="repeat",
        )  # fmt: skip
        inputs[key] = picture.CreateOutput(output, TYPES.Float3)
    shader("Surface", "UsdPreviewSurface", "universal", **inputs)
    scene, shape, bsdf = drawn(stage)
    found = {name: looked_up(scene, shape, bsdf["bsdf"][name]) for name in ("base_color", "roughness")}
    for st in ((0.1, 0.1), (0.15, 0.6), (0.6, 0.35), (0.9, 0.85)):
        a = texel(CODES, (2 * st[0] + 0.25, 0.5 * st[1] + 0.125))
        b = texel(CODES[:, ::-1], (1.0 - st[1], st[0]))
        np.testing.assert_allclose(found["base_color"](st), a / 255, atol=2e-3)
        np.testing.assert_allclose(found["roughness"](st)[0], b[1] / 255, atol=2e-3)


def texel(pixels, st):
    """Bilinear, v up, repeated."""
    x, y = st[0] * pixels.shape[1] - 0.5, (1 - st[1]) * pixels.shape[0] - 0.5
    left, top, result = math.floor(x), math.floor(y), 0.0
    for j, v in ((0, 1 - (y - top)), (1, y - top)):
        for i, u in ((0, 1 - (x - left)), (1, x - left)):
            result = result + u * v * pixels[(top + j) % pixels.shape[0], (left + i) % pixels.shape[1]].astype(float)
    return result


def looked_up(scene, shape, bitmap):
    """What the renderer reads from a texture at coordinates of the quad."""
    from synfog_usd.render import backend
    from synfog_usd.render.load import to_mitsuba

    backend.start("auto")
    mi = backend.mitsuba()
    key = shape["bsdf"]["id"]
    shown = replace(
        scene, world={**scene.world, key: {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": bitmap}}}
    )
    loaded = to_mitsuba(shown).scene

    def at(st):
        x, y, z = (np.array([st[0], 5.0, st[1]]) - scene.origin_m).tolist()
        si = loaded.ray_intersect(mi.Ray3f(mi.Point3f(x, y - 1.0, z), mi.Vector3f(0, 1, 0)))
        return np.array(si.bsdf().eval_diffuse_reflectance(si)).ravel()

    return at
