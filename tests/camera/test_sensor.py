"""Sensor ops: statistics with tolerances from the number of samples, limits, fixed patterns."""

from __future__ import annotations

import math

import numpy as np
import pytest

from synfog_usd import seeds
from synfog_usd.camera import response, sensor
from synfog_usd.camera.profiles import load_sensor
from synfog_usd.errors import ImageError
from synfog_usd.image import Image, Quantity

SENSOR = load_sensor("imx363")
SIGMAS = 4.5
"""A right sensor misses by more than this in 7 of a million draws."""


def electrons(level: float, shape=(600, 600)) -> Image:
    return Image(np.full((*shape, 1), level, np.float32), ("CFA",), Quantity.ELECTRONS, provenance={"exposure_s": 0.01})


def analog(level: float, shape=(64, 64), **facts) -> Image:
    return Image(np.full((*shape, 1), level, np.float32), ("CFA",), Quantity.DN, provenance={"system_gain_dn_e": 0.1705, **facts})


def digital(image: Image) -> Image:
    return sensor.adc(image, bits=10, black_level_dn=64, white_level_dn=1023, sensor=SENSOR)


@pytest.mark.parametrize("mean", [1.0, 5.0, 25.0, 3000.0])
def test_shot_noise_is_poisson(mean):
    """Mean, variance and third central moment all equal the mean; a Gaussian's third would be 0.

    Sampling variances for N draws: m, m + 2 m^2, m + 18 m^2 + 6 m^3, each over N.
    """
    drawn = sensor.shot_noise(electrons(mean), rng=seeds.stream(3, "test", str(mean))).pixels.astype(np.float64).ravel()
    n, away = drawn.size, drawn - drawn.mean()
    assert abs(drawn.mean() - mean) < SIGMAS * math.sqrt(mean / n)
    assert abs(np.mean(away**2) - mean) < SIGMAS * math.sqrt((mean + 2 * mean**2) / n)
    third_sigma = math.sqrt((mean + 18 * mean**2 + 6 * mean**3) / n)
    assert abs(np.mean(away**3) - mean) < SIGMAS * third_sigma
    if mean <= 25.0:
        assert mean > 2 * SIGMAS * third_sigma, "the test could not tell a Gaussian"
    assert (drawn == np.rint(drawn)).all() and drawn.min() >= 0


def test_the_mosaic_sees_each_site_through_its_own_filter():
    """Weights computed site by site from the response matrix; odd sizes too."""
    pixels = seeds.stream(0, "mosaic").random((5, 7, 3), dtype=np.float32)
    image = sensor.expose(Image(pixels, ("R", "G", "B"), Quantity.IRRADIANCE), exposure_s=0.5, pixel_pitch_um=1.4, fill_factor=0.8, sensor=SENSOR)
    rate = response.electrons_per_second(SENSOR, ("R", "G", "B"), pixel_pitch_um=1.4, fill_factor=0.8)
    for row in range(5):
        for column in range(7):
            channel = "RGGB".index("RGGB"[2 * (row % 2) + column % 2]) if (row + column) % 2 == 0 else 1
            filter_row = {0: 0, 1: 1, 3: 2}[channel]
            assert image.pixels[row, column, 0] == pytest.approx(0.5 * rate[filter_row] @ pixels[row, column], rel=1e-5)


def test_fixed_patterns_stay_and_belong_to_a_specimen():
    """PRNU and DSNU of one serial are the same in every frame, of another serial others; their spread is the profile's."""
    lit = electrons(1000.0)
    one = sensor.prnu(lit, prnu_percent=0.7, serial="a").pixels
    again = sensor.prnu(lit, prnu_percent=0.7, serial="a").pixels
    other = sensor.prnu(lit, prnu_percent=0.7, serial="b").pixels
    np.testing.assert_array_equal(one, again)
    assert np.mean(one == other) < 0.01
    n = one.size
    assert abs(one.std(dtype=np.float64) - 7.0) < SIGMAS * 7.0 / math.sqrt(2 * n)
    offset = sensor.dsnu(lit, dsnu_e=0.5, serial="a").pixels - 1000.0
    assert abs(offset.std(dtype=np.float64) - 0.5) < SIGMAS * 0.5 / math.sqrt(2 * n) + 1e-4  # float32 steps at 1000
    assert abs(np.corrcoef(offset.ravel(), one.ravel())[0, 1]) < SIGMAS / math.sqrt(n)


def test_temporal_noise_differs_from_frame_to_frame():
    dark = electrons(0.0)
    one, two = (sensor.read_noise(dark, rng=seeds.stream(seed, "n"), sigma_e=2.5).pixels.astype(np.float64) for seed in (1, 2))
    n = one.size
    assert abs((one - two).std() - 2.5 * math.sqrt(2)) < SIGMAS * 2.5 * math.sqrt(2) / math.sqrt(2 * n)
    assert abs(one.mean()) < SIGMAS * 2.5 / math.sqrt(n)


def test_dark_current_doubles_with_every_eight_kelvin():
    for temperature, expected in [(25.0, 0.2), (33.0, 0.4), (17.0, 0.1), (49.0, 1.6)]:
        image = sensor.dark_current(electrons(0.0, (2, 2)), dark_current_e_s=20.0, temperature_c=temperature)
        np.testing.assert_allclose(image.pixels, expected, rtol=1e-6)
    with pytest.raises(ImageError, match=r"does not say its exposure_s; put sensor\.expose before"):
        sensor.dark_current(Image(np.ones((2, 2, 1), np.float32), ("CFA",), Quantity.ELECTRONS), dark_current_e_s=1.0)


def test_a_full_pixel_takes_no_more():
    np.testing.assert_array_equal(sensor.full_well(electrons(7000.0, (2, 2)), full_well_e=6000.0).pixels, 6000.0)


def test_iso_multiplies_the_noise_before_the_gain_only():
    """Total noise in DN: sqrt((2.5 K)^2 + 0.738^2); at base ISO that is the public figure, 5 e- in all."""
    for iso, expected_dn in [(55.0, 5.0 * 0.1705), (880.0, math.hypot(2.5 * 0.1705 * 16, 0.738))]:
        image = sensor.read_noise(electrons(0.0), rng=seeds.stream(1, "a"), sigma_e=SENSOR.read_noise_e)
        image = sensor.gain(image, iso=iso, iso_base=SENSOR.iso_base, gain_dn_e=SENSOR.gain_dn_e)
        image = sensor.adc_noise(image, rng=seeds.stream(1, "b"), sigma_dn=SENSOR.adc_noise_dn)
        found = image.pixels.std(dtype=np.float64)
        assert abs(found - expected_dn) < (SIGMAS / math.sqrt(2 * image.pixels.size) + 1e-3) * expected_dn  # 0.738 has three digits


@pytest.mark.parametrize(("level", "number"), [(0.0, 64), (0.4, 64), (0.6, 65), (959.0, 1023), (959.6, 1023), (1e9, 1023), (-63.8, 0), (-1e6, 0)])
def test_numbers_are_rounded_and_stay_in_range(level, number):
    """Rounded, not cut; never above 2^n - 1 and never below 0."""
    assert (digital(analog(level)).pixels == number).all()


def test_the_noise_profile_of_the_raw_file_is_the_noise_that_is_there():
    """S = K / (W - B); O = dark variance / (W - B)^2, the last with 1/12 of the rounding."""
    facts = digital(analog(0.0, read_noise_e=2.5, dark_e=0.3, adc_noise_dn=0.738)).provenance
    variance = 0.1705**2 * (2.5**2 + 0.3) + 0.738**2 + 1 / 12
    np.testing.assert_allclose(facts["noise_profile"], [0.1705 / 959, variance / 959**2], rtol=1e-12)


def test_levels_that_do_not_fit_the_bits_are_refused():
    with pytest.raises(ImageError, match="does not hold"):
        sensor.adc(analog(0.0), bits=10, black_level_dn=64, white_level_dn=1024, sensor=SENSOR)


@pytest.mark.physics
def test_photon_transfer_gives_back_the_gain_and_the_dark_noise():
    """EMVA 1288: the slope of variance against mean, from pairs of frames, is K; the offset is the dark noise."""
    means, variances = [], []
    for level in np.linspace(100.0, 3900.0, 14):
        pair = []
        for frame in (0, 1):
            image = electrons(float(level), (500, 500))
            image = sensor.prnu(image, prnu_percent=0.7, serial="x")
            image = sensor.shot_noise(image, rng=seeds.stream(frame, "shot", int(level)))
            image = sensor.read_noise(image, rng=seeds.stream(frame, "read", int(level)), sigma_e=2.5)
            image = sensor.gain(image, iso=55.0, iso_base=55.0, gain_dn_e=0.1705)
            pair.append(digital(sensor.adc_noise(image, rng=seeds.stream(frame, "adc", int(level)), sigma_dn=0.738)).pixels.astype(np.float64))
        means.append((pair[0] + pair[1]).mean() / 2 - 64)
        variances.append(np.var(pair[0] - pair[1]) / 2)
    slope, offset = np.polyfit(means, variances, 1, w=1 / np.array(variances))
    assert slope == pytest.approx(0.1705, rel=0.005)  # 14 levels of 250,000 pixels: 0.08 % each
    assert math.sqrt(offset - 1 / 12) == pytest.approx(5.0 * 0.1705, rel=0.05)
