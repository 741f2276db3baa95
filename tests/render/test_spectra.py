"""Lamps and surfaces with spectra of their own: against closed forms from the tables, and against R, G and B where all
is grey.
"""

from dataclasses import replace

import colour
import numpy as np
import pytest
from support.parts import glow, matte, rgb

from synfog_usd.base import photometry, spectra
from synfog_usd.base.colour import LUMINANCE
from synfog_usd.fog import FogMedium, FogVolume
from synfog_usd.render.shot import render
from synfog_usd.render.spectra import bands
from synfog_usd.scene import mean_colour
from synfog_usd.scene.testing import box, scene, wall

WAVELENGTHS = photometry.WAVELENGTHS_NM


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
        "mat_card": matte(*reflected),
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


def test_a_card_under_sodium_light_in_fog_is_what_the_tables_say(count=8):
    """Leaf x HP1 x geometry x fog, each band within 0.1 %: one point of a lamp, one surface, nothing left to chance but
    the place within a pixel.
    """
    leaf, colour_of_it, candela = spectra.reflectance("leaf"), (0.1, 0.2, 0.05), np.array([180.0, 100.0, 10.0])
    power = illuminant("HP1") * (candela @ LUMINANCE)
    np.testing.assert_allclose(
        card(leaf, colour_of_it, count=count), closed_form(bright(leaf, colour_of_it), power, count), rtol=1e-3
    )


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
        9.0, bsdf={"type": "ref", "id": "mat_card"}, emitter=glow(1.0, 1.0, 1.0)
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


def picture():
    """Green, as 8-bit sRGB."""
    rng = np.random.default_rng(3)
    pixels = np.clip(rng.normal([70, 95, 45], [8, 10, 5], (64, 64, 3)), 0, 255).astype(np.uint8)
    return {"type": "bitmap", "bitmap": pixels, "raw": False, "wrap_mode": "repeat"}


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
