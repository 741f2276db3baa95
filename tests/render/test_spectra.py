"""Lamps and surfaces with spectra of their own: against closed forms from the tables, and against R, G and B where all
is grey.
"""

from dataclasses import replace

import colour
import numpy as np
import pytest

from synfog_usd.base import photometry, spectra
from synfog_usd.base.colour import LUMINANCE
from synfog_usd.fog import FogMedium, FogVolume
from synfog_usd.render.shot import render
from synfog_usd.render.spectra import bands, bsdfs
from synfog_usd.scene import mean_colour, texels
from synfog_usd.scene.testing import box, scene, wall

WAVELENGTHS = photometry.WAVELENGTHS_NM
BLUE, RED = (0.018, 0.055, 0.19), (0.33, 0.012, 0.012)


def rgb(*value):
    return {"type": "rgb", "value": list(value)}


def in_bands(curve, count):
    """Means over bands of a curve, by a sum of its own: each nanometre within the band, those at its ends by half."""
    half = (bands.CENTRES_NM[count][1] - bands.CENTRES_NM[count][0]) / 2
    result = []
    for centre in bands.CENTRES_NM[count]:
        away = np.abs(WAVELENGTHS - centre)
        weight = np.where(away < half - 0.25, 1.0, np.where(away < half + 0.25, 0.5, 0.0))
        result.append((curve * weight).sum() / weight.sum())
    return np.array(result)


def illuminant(name):
    """Power of a CIE illuminant with a luminance of 1 cd m-2."""
    table, eye = colour.SDS_ILLUMINANTS[name], colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    power = np.interp(WAVELENGTHS, table.wavelengths, table.values)
    return power / (683.002 * np.sum(power * np.interp(WAVELENGTHS, eye.wavelengths, eye.values[:, 1])))


def card(curve, reflected, *, lamp="HP1", candela=(180.0, 100.0, 10.0), count=31, seed=0, samples=64):
    """What is seen in the middle of a card 8 m ahead in absorbing fog, lit by a lamp 1 m above the camera."""
    world = {
        "mat_card": {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": rgb(*reflected)}},
        "shape_card": wall(8.0, bsdf={"type": "ref", "id": "mat_card"}),
        "light_0": {"type": "point", "position": [0.0, 0.0, 1.0], "intensity": rgb(*candela)},
    }
    fog = FogVolume("/Fog", box(100.0), FogMedium(0.03, albedo=0.0, g=0.6))
    source = scene(world, [fog], fov_x_deg=1.0)
    own = {} if curve is None else {"mat_card": curve}
    lit = {} if lamp is None else {"light_0": spectra.emission(lamp)}
    made = render(replace(source, reflectance_of=own, emission_of=lit), samples=samples, seed=seed, bands=count)
    return made.radiance.pixels.mean(axis=(0, 1), dtype=np.float64)


def closed_form(curve, power, count=31):
    """Lambert, the inverse square and Beer's law, band by band; `power` is the lamp's intensity."""
    square = 8.0**2 + 1.0
    return (
        in_bands(curve, count)
        * in_bands(power, count)
        / np.pi
        * 8.0
        / square**1.5
        * np.exp(-0.03 * (8.0 + np.sqrt(square)))
    )


def bright(curve, reflected):
    """A curve, as bright under D65 as a colour of linear Rec.709."""
    white = illuminant("D65")
    eye = np.interp(
        WAVELENGTHS,
        *(lambda t: (t.wavelengths, t.values[:, 1]))(colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]),
    )
    return curve * (np.asarray(reflected) @ LUMINANCE) * (white * eye).sum() / (curve * white * eye).sum()


@pytest.mark.parametrize("count", [8, pytest.param(31, marks=pytest.mark.slow)])
def test_a_card_under_sodium_light_in_fog_is_what_the_tables_say(count):
    """Leaf x HP1 x geometry x fog, each band within 0.1 %: one point of a lamp, one surface, nothing left to chance but
    the place within a pixel.
    """
    leaf, colour_of_it, candela = spectra.reflectance("leaf"), (0.1, 0.2, 0.05), np.array([180.0, 100.0, 10.0])
    power = illuminant("HP1") * (candela @ LUMINANCE)
    np.testing.assert_allclose(
        card(leaf, colour_of_it, count=count), closed_form(bright(leaf, colour_of_it), power, count), rtol=1e-3
    )


@pytest.mark.slow
def test_the_red_edge_of_a_leaf_is_in_its_bands_and_not_in_its_colour():
    """From 670 to 700 nm a leaf's reflectance grows 2.5 times and more; what bands make of R, G and B stays the same
    within a tenth.
    """
    leaf, reflected = spectra.reflectance("leaf"), (0.1, 0.2, 0.05)
    seen = card(leaf, reflected, lamp="D65") / in_bands(illuminant("D65"), 31)
    guessed = np.array(reflected) @ bands.matrices(31)[1]
    at = {int(centre): index for index, centre in enumerate(bands.CENTRES_NM[31])}
    assert seen[at[700]] > 2.5 * seen[at[670]]
    assert guessed[at[700]] == pytest.approx(guessed[at[670]], rel=0.1)


@pytest.mark.parametrize("reflected, off", [(BLUE, 0.1), (RED, 1.0)])
def test_sodium_light_on_paint_is_off_from_r_g_and_b_by_what_the_tables_say(reflected, off):
    """How bright paint is under HP1 against white: the integral of both spectra; R, G and B give blue 11 % too dark and
    red twice too bright.
    """
    paint, candela = spectra.smooth(reflected), np.array([2.5589, 0.6373, 0.0])
    weights = np.array([photometry.luminance_of(curve) for curve in photometry.channel_spectra(bands.names(31))])
    seen = card(paint, reflected, candela=candela) @ weights
    lit = closed_form(np.ones_like(paint), illuminant("HP1") * (candela @ LUMINANCE)) @ weights
    eye = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    exact = 683.002 * np.sum(paint * illuminant("HP1") * np.interp(WAVELENGTHS, eye.wavelengths, eye.values[:, 1]))
    by_colour = ((candela * reflected) @ LUMINANCE) / (candela @ LUMINANCE)
    assert seen / lit == pytest.approx(exact, rel=0.02)  # the lamp's lines are narrower than a band of 10 nm
    assert abs(by_colour / exact - 1.0) > off


GROUND = np.array([[-150, -150, -2], [150, -150, -2], [150, 150, -2], [-150, 150, -2.0]])


@pytest.mark.slow
def test_gloss_stays_white_and_each_band_is_that_of_a_grey_surface():
    """A glossy, lacquered ground with a leaf's spectrum: each band is what R, G and B make of a ground as grey as the
    leaf is in it.  Roulette and choices by colour differ between the two, so 1024 samples are compared to 0.5 %.
    """
    leaf, reflected = spectra.reflectance("leaf"), (0.05, 0.1, 0.02)

    def source(colour_of_it, own):
        material = {
            "type": "preview_surface",
            "base_color": rgb(*colour_of_it),
            "roughness": 0.3,
            "clearcoat": 0.8,
            "clearcoat_roughness": 0.1,
            "eta": 1.5,
        }
        world = {
            "mat_ground": {"type": "twosided", "bsdf": material},
            "shape_ground": {
                "type": "mesh",
                "positions": GROUND,
                "faces": np.array([[0, 1, 2], [0, 2, 3]]),
                "bsdf": {"type": "ref", "id": "mat_ground"},
            },
            "light_sky": {"type": "constant", "radiance": rgb(1.0, 1.0, 1.0)},
        }
        fog = FogVolume("/Fog", box(200.0), FogMedium(0.02, g=0.6))
        return replace(scene(world, [fog], fov_x_deg=60.0), reflectance_of={"mat_ground": leaf} if own else {})

    banded = render(source(reflected, True), model="path", samples=1024, bands=8)
    white, level = bands.matrices(8)[0].sum(axis=0), in_bands(bright(leaf, reflected), 8)
    for band in (3, 7):
        grey = render(source([level[band]] * 3, False), model="path", samples=1024)
        for part, pixels in grey.components.items():
            mean = banded.components[part][..., band].mean() / white[band]
            assert mean == pytest.approx(pixels.mean(), rel=5e-3, abs=1e-5), (band, part)


def test_each_lamp_has_its_own_spectrum_and_its_light_group():
    """A sodium lamp, an amber LED and a lamp of a colour light one card: each group has its lamp's spectrum, and they
    add up.
    """
    lamps = {"light_0": ("HP1", "street"), "light_1": ("LED 592 nm", "indicators"), "light_2": (None, "other")}
    world = {
        "mat_card": {"type": "diffuse", "reflectance": rgb(0.5, 0.5, 0.5)},
        "shape_card": wall(8.0, bsdf={"type": "ref", "id": "mat_card"}),
    }
    world |= {key: {"type": "point", "position": [0.0, 0.0, 1.0], "intensity": rgb(100.0, 60.0, 5.0)} for key in lamps}
    world["shape_lit"] = wall(
        9.0, bsdf={"type": "ref", "id": "mat_card"}, emitter={"type": "area", "radiance": rgb(1.0, 1.0, 1.0)}
    )  # behind the card
    source = replace(
        scene(world, fov_x_deg=1.0),
        group_of={key: group for key, (_, group) in lamps.items()} | {"shape_lit": "street"},
        emission_of={key: spectra.emission(name) for key, (name, _) in lamps.items() if name},
    )
    made = render(source, samples=2048, bands=31)
    seen = {name: pixels.mean(axis=(0, 1), dtype=np.float64) for name, pixels in made.groups.items()}
    np.testing.assert_allclose(sum(seen.values()), made.radiance.pixels.mean(axis=(0, 1)), rtol=1e-5)
    sodium, led = (
        in_bands(illuminant("HP1"), 31),
        in_bands(colour.sd_single_led(592.0, colour.SpectralShape(380, 780, 1), half_spectral_width=15.0).values, 31),
    )
    np.testing.assert_allclose(seen["street"] / seen["street"].sum(), sodium / sodium.sum(), rtol=2e-4)
    np.testing.assert_allclose(seen["indicators"] / seen["indicators"].sum(), led / led.sum(), rtol=2e-4, atol=1e-7)
    mixed = np.array([100.0, 60.0, 5.0]) @ bands.matrices(31)[0]
    np.testing.assert_allclose(seen["other"] / seen["other"].sum(), mixed / mixed.sum(), rtol=2e-4)
    weights = np.array([photometry.luminance_of(curve) for curve in photometry.channel_spectra(bands.names(31))])
    assert seen["street"] @ weights == pytest.approx(seen["other"] @ weights, rel=0.01)  # the same candelas


def picture(*, gaudy=False):
    """Green, as 8-bit sRGB; with a brown patch, and blue and white texels, if gaudy."""
    rng = np.random.default_rng(3)
    pixels = np.clip(rng.normal([70, 95, 45], [8, 10, 5], (64, 64, 3)), 0, 255).astype(np.uint8)
    if gaudy:
        pixels[:8, :16], pixels[20, 20], pixels[30, 30] = (90, 60, 40), (20, 40, 230), (250, 250, 250)
    return {"type": "bitmap", "bitmap": pixels, "raw": False, "wrap_mode": "repeat"}


def test_a_texture_has_the_spectrum_at_its_mean_and_its_own_hues_around_it():
    """The mean of all reflectances is the material's within 0.5 %, and D65 shows texels by their ratio to the mean."""
    part, grass = picture(), spectra.reflectance("grass")
    mean = np.array(mean_colour(part))
    carried = bsdfs.basis_weights(texels(part), grass, mean) @ bsdfs.basis(grass, mean)
    own = bright(grass, mean)
    np.testing.assert_allclose(carried.mean(axis=(0, 1)), own, rtol=5e-3, atol=2e-4)
    shown, ratio = spectra.rgb_of(carried), texels(part) / mean
    usual = np.abs(ratio - ratio.mean(axis=2, keepdims=True)).max(axis=2) < 0.2
    assert usual.mean() > 0.5
    np.testing.assert_allclose(shown[usual], (ratio * spectra.rgb_of(own))[usual], rtol=0.02, atol=1e-3)


@pytest.mark.parametrize("name", ["grass", "asphalt", "sheeting_red"])
def test_no_texel_reflects_less_than_nothing_or_more_than_it_gets(name):
    """Whatever its hue: 0 to 1 at every wavelength, to a hundredth between those that are looked at."""
    part, curve = picture(gaudy=True), spectra.reflectance(name)
    carried = bsdfs.basis_weights(texels(part), curve, mean_colour(part)) @ bsdfs.basis(curve, mean_colour(part))
    assert carried.min() > -0.01
    assert carried.max() < 1.01
    assert carried[30, 30].mean() > carried[40, 40].mean()


def test_a_textured_card_is_rendered_with_the_spectrum_of_its_mean():
    """Seen from afar, so that every pixel averages many texels: the mean's spectrum in each band, within 3 %."""
    part, grass = picture(), spectra.reflectance("grass")
    square = wall(8.0, 4.0, bsdf={"type": "ref", "id": "mat_card"})
    square["texcoords"] = np.array([[0, 0], [8, 0], [8, 8], [0, 8.0]])
    world = {"mat_card": {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": part}}, "shape_card": square}
    world["light_sky"] = {"type": "constant", "radiance": rgb(1.0, 1.0, 1.0)}
    source = replace(scene(world, fov_x_deg=30.0, width_px=32, height_px=32), reflectance_of={"mat_card": grass})
    seen = render(source, samples=64, bands=16).radiance.pixels.mean(axis=(0, 1), dtype=np.float64)
    wanted = in_bands(bright(grass, mean_colour(part)), 16) * bands.matrices(16)[0].sum(axis=0)
    np.testing.assert_allclose(seen, wanted, rtol=0.03)


def test_r_g_and_b_do_not_see_spectra():
    """The same bytes with and without."""
    world = {
        "mat_card": {"type": "diffuse", "reflectance": rgb(0.1, 0.2, 0.05)},
        "shape_card": wall(8.0, bsdf={"type": "ref", "id": "mat_card"}),
        "light_sky": {"type": "constant", "radiance": rgb(1.0, 0.9, 0.7)},
    }
    source = scene(world, [FogVolume("/Fog", box(100.0), FogMedium(0.03, g=0.6))])
    spectral = replace(
        source,
        reflectance_of={"mat_card": spectra.reflectance("leaf")},
        emission_of={"light_sky": spectra.emission("A")},
    )
    plain, other = (render(one, samples=16).radiance.pixels.tobytes() for one in (source, spectral))
    assert plain == other
