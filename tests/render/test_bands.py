"""Wavelength bands: what a path carries, against closed forms, colour-science and `path` in R, G and B."""

from dataclasses import replace

import colour
import numpy as np
import pytest
from support.parts import glow, matte, rgb, squares
from support.renders import by_seed
from support.stats import assert_mean

from synfog_usd.base import photometry
from synfog_usd.base.colour import PRIMARIES_NM
from synfog_usd.base.errors import ParameterError
from synfog_usd.fog import Fog, FogMedium, FogVolume, kinds
from synfog_usd.render.shot import render
from synfog_usd.render.spectra import bands
from synfog_usd.scene.testing import box, scene, sky, wall

SKY = sky()
COUNTS = [8, 31]


def shining(*value, distance_m=50.0):
    """A black wall that shines."""
    return wall(distance_m, bsdf=matte(0.0), emitter=glow(*value))


def haze(angstrom, *, sigma_t=0.02, albedo=1.0, half_size=200.0):
    return FogVolume("/Haze", box(half_size), FogMedium(sigma_t, albedo=albedo, g=0.6, angstrom=angstrom))


@pytest.mark.parametrize("count", COUNTS)
def test_light_in_bands_is_the_light_that_was_authored(count):
    """A wall of a colour, seen by the CIE observer from its bands, has that colour; to 5 and 0.5 % of its
    luminance.
    """
    seen = render(scene({"shape_wall": shining(0.9, 0.5, 0.2)}), samples=2, bands=count).radiance
    assert seen.channels == bands.names(count)
    np.testing.assert_allclose(
        bands.to_rgb(seen.pixels, count)[4, 8], (0.9, 0.5, 0.2), atol=0.56 * {8: 0.05, 31: 0.005}[count]
    )
    assert photometry.luminance(seen)[4, 8] == pytest.approx(0.9 * 0.2126 + 0.5 * 0.7152 + 0.2 * 0.0722, rel=0.01)


def test_a_coloured_lamp_on_a_coloured_wall_is_a_product_of_spectra():
    """Orange light on a blue wall: band by band the product of what colour-science makes of both, which is not that of
    R, G and B.
    """
    world = {
        "light_sky": {"type": "constant", "radiance": rgb(1.0, 0.45, 0.05)},
        "shape_wall": wall(5.0, bsdf=matte(0.1, 0.2, 0.7)),
    }
    seen = render(scene(world), samples=256, bands=31).radiance.pixels.mean(axis=(0, 1))
    centres = np.array(bands.CENTRES_NM[31])
    basis = colour.recovery.MSDS_BASIS_FUNCTIONS_sRGB_MALLETT2019
    shapes = np.array([np.interp(centres, basis.wavelengths, basis.values[:, channel]) for channel in range(3)])
    d65 = np.interp(centres, colour.SDS_ILLUMINANTS["D65"].wavelengths, colour.SDS_ILLUMINANTS["D65"].values)
    expected = (np.array([1.0, 0.45, 0.05]) @ shapes) * (np.array([0.1, 0.2, 0.7]) @ shapes) * d65
    inside = (centres > 420) & (centres < 690)
    np.testing.assert_allclose(
        (seen / seen.sum())[inside], (expected / expected.sum())[inside], rtol=0.05
    )  # a band of 10 nm against its centre
    assert abs(bands.to_rgb(seen, 31)[1] / (0.45 * 0.2) - 1.0) > 0.05


def test_haze_dims_each_band_by_its_own_extinction(angstrom=1.3):
    """Beer and Lambert with Angstrom's law: exp(-0.02 * 50 * (lambda / 550)^-a), rays within a degree of the axis."""
    world = scene({"shape_wall": shining(1.0, 1.0, 1.0)}, [haze(angstrom, albedo=0.0)], fov_x_deg=1.0)
    clear = render(replace(world, fog=()), samples=2, bands=8).radiance.pixels[4, 8]
    means = (
        np.array(
            [
                run.radiance.pixels.mean(axis=(0, 1), dtype=np.float64)
                for run in by_seed(world, range(4), samples=64, bands=8)
            ]
        )
        / clear
    )
    wanted = np.exp(-((np.array(bands.CENTRES_NM[8]) / 550.0) ** -angstrom))
    np.testing.assert_allclose(means.mean(axis=0), wanted, rtol=1e-3)


def test_haze_that_absorbs_nothing_is_invisible_in_every_band(angstrom=1.3):
    """White furnace: whatever the extinction of a band, each is as bright as the sky."""
    world = scene(SKY, [haze(angstrom, half_size=60.0)], fov_x_deg=60.0)
    sky = render(replace(world, fog=()), samples=2, bands=8).radiance.pixels[4, 8].astype(np.float64)
    means = (
        np.array(
            [
                run.radiance.pixels.mean(axis=(0, 1), dtype=np.float64)
                for run in by_seed(world, range(12), samples=1024, bands=8)
            ]
        )
        / sky
    )
    for band in range(8):
        assert_mean(means[:, band], 1.0, resolves=0.02)


def test_bands_change_nothing_where_all_is_grey():
    """White light on a grey ground in grey fog: every band is the white spectrum times what R, G and B see, path by
    path.
    """
    ground = squares([[-150, -150, -2], [150, -150, -2], [150, 150, -2], [-150, 150, -2]], bsdf=matte(0.3))
    world = scene({**SKY, "shape_ground": ground}, [haze(0.0)], fov_x_deg=60.0)
    plain, banded = (render(world, model="path", samples=32, bands=count) for count in (3, 8))
    white = bands.matrices(8)[0].sum(axis=0)
    np.testing.assert_allclose(
        banded.radiance.pixels / white, np.repeat(plain.radiance.pixels[..., :1], 8, axis=2), rtol=2e-3
    )
    for part, pixels in plain.components.items():
        np.testing.assert_allclose(
            banded.components[part].mean(axis=(0, 1)) / white, pixels.mean(), rtol=2e-3, atol=1e-6
        )
    assert banded.relative_error == pytest.approx(plain.relative_error, rel=0.1)


@pytest.mark.parametrize(
    "wrong, words", [({"bands": 5}, "--bands 5"), ({"bands": 16, "model": "volpath"}, "R, G and B alone")]
)
def test_bands_that_cannot_be_are_refused(wrong, words):
    """With the option and what it takes."""
    with pytest.raises(ParameterError, match=words):
        render(scene({**SKY, "shape_wall": wall(20.0)}, [haze(0.0)]), **wrong)


def test_fogs_of_different_colours_are_refused_in_bands():
    """One path cannot be drawn for two of them."""
    inner = FogVolume("/Inner", box(5.0, (0.0, 20.0, 0.0)), FogMedium(0.1, g=0.6, angstrom=0.0), parent=0)
    world = scene(SKY, [haze(1.3), inner])
    with pytest.raises(ParameterError, match="Angstrom"):
        render(world, samples=2, bands=8)


def medium_box(medium, half_size=200.0):
    return FogVolume("/Medium", box(half_size), medium)


def test_smoke_dims_red_green_and_blue_by_its_own_extinctions():
    """Beer and Lambert at the wavelengths of the primaries, for soot that scatters nothing."""
    smoke = kinds.medium_of("smoke", mor_m=150.0)
    colours = replace(smoke.colours, albedo=(0.0,) * len(smoke.colours.albedo))
    world = scene(
        {"shape_wall": shining(1.0, 1.0, 1.0)}, [medium_box(replace(smoke, albedo=0.0, colours=colours))], fov_x_deg=1.0
    )
    seen = render(world, model="path", samples=64).radiance.pixels.mean(axis=(0, 1))
    wanted = np.exp(-smoke.sigma_t_per_m * 50.0 * smoke.extinction_at(PRIMARIES_NM))
    np.testing.assert_allclose(seen, wanted, rtol=1e-3)
    assert wanted[0] > 1.2 * wanted[2]


@pytest.mark.parametrize("model, rtol", [("path", 0.02), pytest.param("volpath", 0.04, marks=pytest.mark.slow)])
def test_dust_is_brown(model, rtol):
    """A thin cloud of it before a black wall under an even sky: once scattered light is as its scattering is.

    `volpath` has one extinction, which is within 2 % of each colour's.
    """
    dust = replace(kinds.medium_of("dust", mor_m=3e4), profile="uniform")
    world = scene({**SKY, "shape_wall": wall(150.0)}, [medium_box(dust)], fov_x_deg=1.0)
    runs = by_seed(world, range(4), model=model, samples=512 if model == "path" else 2048)
    means = np.mean([run.radiance.pixels.mean(axis=(0, 1)) for run in runs], axis=0)
    scattered = dust.extinction_at(PRIMARIES_NM) * dust.albedo_at(PRIMARIES_NM)
    np.testing.assert_allclose(means / means[1], scattered / scattered[1], rtol=rtol)
    assert means[0] > 1.1 * means[2]


@pytest.mark.slow
def test_rain_in_fog_sends_light_where_both_do():
    """Thin, so that light is scattered once: rain in fog is as bright as rain and as fog together."""
    parts = [Fog.named(name).over(FogMedium(1.0)) for name in ("rain10", "mor9000")]
    together = Fog.named("rain10+mor9000").over(FogMedium(1.0))
    lamp = {"light_sun": {"type": "directional", "direction": [0.3, 0.9, -0.2], "irradiance": rgb(1.0, 1.0, 1.0)}}

    def glow_of(medium):
        world = scene({**lamp, "shape_wall": wall(20.0)}, [medium_box(medium, 21.0)], fov_x_deg=40.0)
        return np.mean([run.radiance.pixels.mean() for run in by_seed(world, range(4), model="path", samples=256)])

    assert glow_of(together) == pytest.approx(sum(map(glow_of, parts)), rel=0.02)
