"""`synfog:spectrum:*`: what stands on lights and materials arrives, and what is no spectrum is one warning."""

import numpy as np
import pytest
from pxr import Gf, Sdf, UsdLux, UsdShade
from support.looks import TYPES, painted

from synfog_usd.base import spectra
from synfog_usd.translate import translate
from synfog_usd.world.components import author_material
from synfog_usd.world.materials import PALETTE


@pytest.fixture
def made(empty, polygon_mesh):
    """A quad with a preview surface: (stage, material, surface)."""
    stage = empty()
    mesh = polygon_mesh(stage, "/Quad", [(0, 5, 0), (1, 5, 0), (1, 5, 1), (0, 5, 1)], [4], [0, 1, 2, 3])
    material = painted(mesh.GetPrim(), diffuseColor=(0.1, 0.2, 0.05))
    surface = UsdShade.Shader.Get(stage, "/Material/Surface")
    return stage, material, surface


def put(prim, value, kind=TYPES.Token, name=spectra.REFLECTANCE):
    prim.CreateAttribute(name, kind).Set(value)


def warnings(scene):
    return [f"{note.path}: {note.text}" for note in scene.notes if note.severity == "warning"]


PAIRS = [Gf.Vec2f(400, 0.1), Gf.Vec2f(550, 0.4), Gf.Vec2f(700, 0.2)]


@pytest.mark.parametrize("value, kind", [
    ("leaf", TYPES.Token),
    ("leaf", TYPES.String),
    (PAIRS, TYPES.Float2Array),
    ([Gf.Vec2d(p) for p in PAIRS], TYPES.Double2Array),
])  # fmt: skip
def test_a_material_has_the_spectrum_that_stands_on_it(made, value, kind):
    """By name or as pairs, of either type; the drawn surface is the same as without."""
    stage, material, _ = made
    before = translate(stage)
    put(material.GetPrim(), value, kind)
    scene = translate(stage)
    key = next(part["bsdf"]["id"] for name, part in scene.world.items() if name.startswith("shape_"))
    curve, nm = scene.reflectance_of[key], spectra.WAVELENGTHS_NM
    if value == "leaf":  # its shape, in the material's colour
        np.testing.assert_allclose(spectra.rgb_of(curve), (0.1, 0.2, 0.05), atol=1e-6)
        seen = (nm >= 430.0) & (nm <= 650.0)
        curve, nm, shape = curve[seen], nm[seen], spectra.reflectance("leaf")[seen]
        bend = np.log(curve / shape)
        np.testing.assert_allclose(bend, np.polyval(np.polyfit(nm - 580.0, bend, 2), nm - 580.0), atol=1e-6)
    else:
        np.testing.assert_allclose(curve, np.interp(nm, [400, 550, 700], [0.1, 0.4, 0.2]), atol=1e-7)
    plain = next(part["bsdf"]["id"] for name, part in before.world.items() if name.startswith("shape_"))
    assert scene.world[key] == before.world[plain]
    assert not before.reflectance_of
    assert not warnings(scene)


def test_paint_is_the_smooth_spectrum_of_the_materials_own_colour(made):
    stage, material, _ = made
    put(material.GetPrim(), "paint")
    (curve,) = translate(stage).reflectance_of.values()
    np.testing.assert_allclose(spectra.rgb_of(curve), (0.1, 0.2, 0.05), atol=1e-6)


def test_two_materials_that_differ_in_their_spectrum_alone_are_two(made, polygon_mesh):
    stage, material, _ = made
    put(material.GetPrim(), "leaf")
    mesh = polygon_mesh(stage, "/Quad2", [(2, 5, 0), (3, 5, 0), (3, 5, 1), (2, 5, 1)], [4], [0, 1, 2, 3])
    painted(mesh.GetPrim(), "/Other", diffuseColor=(0.1, 0.2, 0.05))
    scene = translate(stage)
    worn = {part["bsdf"]["id"] for name, part in scene.world.items() if name.startswith("shape_")}
    assert len(worn) == 2
    assert len(worn & set(scene.reflectance_of)) == 1


@pytest.mark.parametrize("value, kind, words", [
    ("leav", TYPES.Token, "Did you mean 'leaf'?"),
    ([Gf.Vec2f(0.4, 0.1), Gf.Vec2f(0.7, 0.2)], TYPES.Float2Array, "micrometres"),
    ([Gf.Vec2f(400, 0.1), Gf.Vec2f(700, 40.0)], TYPES.Float2Array, "0 to 1"),
    ([400.0, 0.1, 700.0, 0.2], TYPES.FloatArray, "pairs"),
    ([], TYPES.Float2Array, "pairs"),
    (7.0, TYPES.Float, "pairs"),
    ([Gf.Vec3f(400, 1, 1), Gf.Vec3f(700, 1, 1)], TYPES.Float3Array, "pairs"),
    (["leaf", "grass"], TYPES.TokenArray, "neither a name nor numbers"),
    (Sdf.AssetPath("leaf.csv"), TYPES.Asset, "neither a name nor numbers"),
])  # fmt: skip
def test_what_is_no_spectrum_is_one_warning_with_its_prim_and_the_colour_counts(made, value, kind, words):
    stage, material, _ = made
    put(material.GetPrim(), value, kind)
    scene = translate(stage)
    (warning,) = warnings(scene)
    assert warning.startswith("/Material: synfog:spectrum:reflectance")
    assert words in warning
    assert "colour is used" in warning
    assert not scene.reflectance_of


def test_lights_have_the_spectra_that_stand_on_them(empty):
    """A ball, a lamp at a point, a sun, a sky of one colour, a lit mesh, and a material that shines."""
    stage = empty()
    for path, kind, name in (
        ("/Ball", UsdLux.SphereLight, "HP1"),
        ("/Sun", UsdLux.DistantLight, "A"),
        ("/Sky", UsdLux.DomeLight, "D65"),
        ("/Point", UsdLux.SphereLight, "LED 592 nm"),
    ):
        light = kind.Define(stage, path)
        put(light.GetPrim(), name, TYPES.String, spectra.EMISSION)
        if path == "/Point":
            light.CreateTreatAsPointAttr(True)
    scene = translate(stage)
    kinds = {scene.world[key].get("type"): curve for key, curve in scene.emission_of.items()}
    for kind, name in (("sphere", "HP1"), ("directional", "A"), ("constant", "D65"), ("point", "LED 592 nm")):
        np.testing.assert_array_equal(kinds[kind], spectra.emission(name))
    assert [warning for warning in warnings(scene) if "on open ground" not in warning] == []  # the sun is dim


def test_a_shining_material_and_a_mesh_light_may_have_spectra(made):
    stage, material, surface = made
    surface.CreateInput("emissiveColor", TYPES.Color3f).Set(Gf.Vec3f(100, 50, 5))
    put(material.GetPrim(), "HP1", TYPES.Token, spectra.EMISSION)
    (curve,) = translate(stage).emission_of.values()
    np.testing.assert_array_equal(curve, spectra.emission("HP1"))
    mesh = stage.GetPrimAtPath("/Quad")
    UsdLux.MeshLightAPI.Apply(mesh)
    put(mesh, "A", TYPES.Token, spectra.EMISSION)
    (curve,) = translate(stage).emission_of.values()
    np.testing.assert_array_equal(curve, spectra.emission("A"))


@pytest.mark.parametrize("name", ["soil", "paint", "tyre"])
def test_a_material_of_the_palette_is_written_with_its_spectrum(name, made):
    """And read back in the material's own colour; one without has none."""
    stage = made[0]
    material = author_material(stage, Sdf.Path("/Palette"), PALETTE[name], textures="")
    UsdShade.MaterialBindingAPI(stage.GetPrimAtPath("/Quad")).Bind(material)
    scene = translate(stage)
    assert not warnings(scene)
    assert len(scene.reflectance_of) == bool(PALETTE[name].spectrum)
    for curve in scene.reflectance_of.values():
        np.testing.assert_allclose(spectra.rgb_of(curve), PALETTE[name].colour, atol=1e-5)
