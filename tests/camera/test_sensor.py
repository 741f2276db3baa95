"""Sensor ops: statistics with tolerances from the number of samples, limits, fixed patterns."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from support.stats import assert_mean

from synfog_usd import camera
from synfog_usd.base import resources, seeds
from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import cfa, isp, response, sensor
from synfog_usd.camera.profiles import Curve, QuantumEfficiency, load_sensor

SENSOR = load_sensor("imx363")
SIGMAS = 4.5
"""A right sensor misses by more than this in 7 of a million draws."""


def electrons(level: float, shape=(600, 600)) -> Image:
    return Image(np.full((*shape, 1), level, np.float32), ("CFA",), Quantity.ELECTRONS, provenance={"exposure_s": 0.01})


def analog(level: float, shape=(64, 64), **metadata) -> Image:
    return Image(
        np.full((*shape, 1), level, np.float32),
        ("CFA",),
        Quantity.DN,
        provenance={"system_gain_dn_e": 0.1705, **metadata},
    )


def digital(image: Image, chip=SENSOR, **params) -> Image:
    return sensor.adc(image, bits=10, black_level_dn=64, white_level_dn=1023, sensor=chip, **params)


def behind(pattern: str):
    """The phone's sensor behind other filters: Gaussians, each around a wavelength of its own."""
    centres_nm = {"R": 600.0, "G": 540.0, "B": 460.0, "C": 550.0, "I": 740.0}
    filters = tuple(
        Curve("gaussian", (centres_nm[letter], 300.0 if letter == "C" else 80.0, 0.9))
        for letter in cfa.filters(pattern)
    )
    return replace(
        SENSOR,
        cfa=pattern,
        qe=QuantumEfficiency(common=(Curve("flat", (0.8,)),), filters=filters),
        content_hash=pattern,
    )


def phone():
    return camera.load_graph(resources.folder("pipeline") / "phone.yaml")


def radiance(level: float, shape=(200, 300)) -> Image:
    return Image(
        np.full((*shape, 3), level, np.float32), ("R", "G", "B"), Quantity.RADIANCE, provenance={"fov_x_deg": 60.0}
    )


@pytest.mark.parametrize("mean", [1.0, 25.0, 3000.0])
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


@pytest.mark.parametrize("mean_e, resolves", [(1.0, 0.025), (25.0, 0.002)])
def test_few_electrons_are_not_shifted(mean_e, resolves):
    """From the mean count to the number, nothing moves the mean: E[DN] = black + K mu (a known fault elsewhere doubled
    it).
    """
    chip = load_sensor("imx363")
    means = []
    for seed in range(20):
        image = sensor.prnu(electrons(mean_e, (600, 600)), prnu_percent=chip.prnu_percent, serial=f"means {seed}")
        image = sensor.shot_noise(image, rng=seeds.stream(seed, "shot", str(mean_e)))
        image = sensor.dsnu(
            sensor.full_well(image, full_well_e=chip.full_well_e), dsnu_e=chip.dsnu_e, serial=f"means {seed}"
        )
        image = sensor.read_noise(image, rng=seeds.stream(seed, "read", str(mean_e)), sigma_e=chip.read_noise_e)
        image = sensor.gain(image, iso=chip.iso_base, iso_base=chip.iso_base, gain_dn_e=chip.gain_dn_e)
        image = digital(sensor.adc_noise(image, rng=seeds.stream(seed, "adc", str(mean_e)), sigma_dn=chip.adc_noise_dn))
        means.append(image.pixels.mean(dtype=np.float64) - chip.black_level_dn)
    assert_mean(np.array(means), mean_e * chip.gain_dn_e, resolves=resolves)


@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "RCCC", "RGIB", "MONO"])
def test_the_mosaic_sees_each_site_through_its_own_filter(pattern):
    """Weights computed site by site from the response matrix and the pattern's letters; odd sizes too."""
    chip, rows = behind(pattern), cfa.PATTERNS[pattern]
    pixels = seeds.stream(0, "mosaic").random((5, 7, 3), dtype=np.float32)
    image = sensor.expose(
        Image(pixels, ("R", "G", "B"), Quantity.IRRADIANCE),
        exposure_s=0.5,
        pixel_pitch_um=1.4,
        fill_factor=0.8,
        sensor=chip,
    )
    rate = response.electrons_per_second(chip, ("R", "G", "B"), pixel_pitch_um=1.4, fill_factor=0.8)
    assert image.provenance["cfa_pattern"] == pattern and image.provenance["spectra"].startswith(
        "upsampled from linear Rec.709"
    )
    for row in range(5):
        for column in range(7):
            number = cfa.filters(pattern).index(rows[row % len(rows)][column % len(rows[0])])
            assert image.pixels[row, column, 0] == pytest.approx(0.5 * rate[number] @ pixels[row, column], rel=1e-5)


def test_fixed_patterns_stay_and_belong_to_a_specimen():
    """PRNU and DSNU of one serial are the same in every frame, of another serial others; their spread is the
    profile's.
    """
    lit = electrons(1000.0)
    one = sensor.prnu(lit, prnu_percent=0.7, serial="a").pixels
    sensor.pattern.cache_clear()  # as in another process
    again = sensor.prnu(lit, prnu_percent=0.7, serial="a").pixels
    other = sensor.prnu(lit, prnu_percent=0.7, serial="b").pixels
    np.testing.assert_array_equal(one, again)
    assert np.mean(one == other) < 0.01
    n = one.size
    assert abs(one.std(dtype=np.float64) - 7.0) < SIGMAS * 7.0 / math.sqrt(2 * n)
    offset = sensor.dsnu(lit, dsnu_e=0.5, serial="a").pixels - 1000.0
    assert abs(offset.std(dtype=np.float64) - 0.5) < SIGMAS * 0.5 / math.sqrt(2 * n) + 1e-4  # float32 steps at 1000
    assert abs(np.corrcoef(offset.ravel(), one.ravel())[0, 1]) < SIGMAS / math.sqrt(n)


def test_dark_current_doubles_with_every_eight_kelvin():
    for temperature, expected in [(25.0, 0.2), (33.0, 0.4), (17.0, 0.1), (49.0, 1.6)]:
        image = sensor.dark_current(electrons(0.0, (2, 2)), dark_current_e_s=20.0, temperature_c=temperature)
        np.testing.assert_allclose(image.pixels, expected, rtol=1e-6)
    with pytest.raises(ImageError, match=r"does not say its exposure_s; put sensor\.expose before"):
        sensor.dark_current(Image(np.ones((2, 2, 1), np.float32), ("CFA",), Quantity.ELECTRONS), dark_current_e_s=1.0)


def test_blooming_keeps_the_charge_and_fills_the_column():
    """1000 e- over a well of 100 that holds them: 900 go up and down in halves, 4.5 pixels of 100 each way; none goes
    sideways.
    """
    image = electrons(0.0, (21, 3))
    image.pixels[10, 1] = 1000.0
    out = sensor.full_well(image, full_well_e=100.0, blooming=1.0).pixels[..., 0]
    expected = np.zeros(21)
    expected[6:15], expected[5], expected[15] = 100.0, 50.0, 50.0
    np.testing.assert_allclose(out[:, 1], expected, rtol=1e-6)
    assert out[:, [0, 2]].max() == 0.0
    np.testing.assert_allclose(
        sensor.full_well(image, full_well_e=100.0, blooming=0.2).pixels.sum(), 100.0 + 0.2 * 900.0, rtol=1e-6
    )


def test_a_headlight_stays_below_two_to_the_n():
    """1e9 cd m-2 beside darkness: 1023 in 10 bits, never 1024, and no number below 0."""
    scene = radiance(0.01, (40, 60))
    scene.pixels[10:20, 10:20] = 1e9
    out = (
        phone()
        .run({"radiance": scene}, seed=3, settings={"exposure_s": 1 / 60, "iso": 7040}, until="adc")["adc"]
        .pixels
    )
    assert out.max() == 1023.0 and out.min() >= 0.0 and (out == np.rint(out)).all()


def test_rows_and_columns_have_offsets_that_stay_and_some_that_do_not():
    """Standard deviations of 400 rows and 500 columns: theirs, to the accuracy of so many draws; one frame less another
    leaves the temporal part.
    """
    frames = [
        sensor.row_column(
            analog(0.0, (400, 500)),
            rng=seeds.stream(seed, "rows"),
            row_noise_dn=3.0,
            column_noise_dn=5.0,
            temporal_row_noise_dn=temporal,
            serial="a",
        ).pixels[..., 0]
        for seed, temporal in ((1, 0.0), (2, 0.0), (3, 2.0))
    ]
    np.testing.assert_array_equal(frames[0], frames[1])
    rows, columns = frames[0].mean(axis=1), frames[0].mean(axis=0)
    assert abs(rows.std() - 3.0) < SIGMAS * 3.0 / math.sqrt(800) and abs(
        columns.std() - 5.0
    ) < SIGMAS * 5.0 / math.sqrt(1000)
    np.testing.assert_allclose(frames[0], rows[:, None] + columns[None, :] - frames[0].mean(), atol=1e-4)
    moved = frames[2] - frames[0]
    assert np.ptp(moved, axis=1).max() < 1e-4 and abs(moved[:, 0].std() - 2.0) < SIGMAS * 2.0 / math.sqrt(800)


@pytest.mark.parametrize(("level", "number"), [(0.4, 64), (0.6, 65), (959.6, 1023), (1e9, 1023), (-63.8, 0), (-1e6, 0)])
def test_numbers_are_rounded_and_stay_in_range(level, number):
    """Rounded, not cut; never above 2^n - 1 and never below 0."""
    assert (digital(analog(level)).pixels == number).all()


def test_the_noise_profile_of_the_raw_file_is_the_noise_that_is_there():
    """S = K / (W - B); O = dark variance / (W - B)^2, the last with 1/12 of the rounding."""
    metadata = digital(analog(0.0, shot_noise=True, read_noise_e=2.5, dark_e=0.3, adc_noise_dn=0.738)).provenance
    variance = 0.1705**2 * (2.5**2 + 0.3) + 0.738**2 + 1 / 12
    np.testing.assert_allclose(metadata["noise_profile"], [0.1705 / 959, variance / 959**2], rtol=1e-12)
    np.testing.assert_allclose(
        digital(analog(0.0)).provenance["noise_profile"], [0.0, 1 / 12 / 959**2], rtol=1e-12
    )  # a graph without noise rounds


def test_a_smaller_picture_is_a_part_of_the_same_specimen():
    """Pixels, rows and columns keep their patterns whatever the size of the picture, across the tiles in which they are
    drawn.
    """
    whole, part = (np.zeros((*size, 1), np.float32) for size in ((600, 300), (300, 270)))
    light = Image(whole, ("CFA",), Quantity.ELECTRONS)
    large, small = (sensor.dsnu(image, dsnu_e=1.0, serial="a").pixels for image in (light, light.with_pixels(part)))
    np.testing.assert_array_equal(large[:300, :270], small)
    assert large.std() == pytest.approx(1.0, abs=SIGMAS / math.sqrt(2 * large.size))
    assert abs(np.corrcoef(large[:256, :256].ravel(), large[256:512, :256].ravel())[0, 1]) < SIGMAS / 256
    lines = [
        sensor.row_column(
            Image(pixels, ("CFA",), Quantity.DN),
            rng=seeds.stream(0, "x"),
            row_noise_dn=1.0,
            column_noise_dn=1.0,
            serial="a",
        ).pixels
        for pixels in (whole, part)
    ]
    np.testing.assert_array_equal(lines[0][:300, :270], lines[1])


@pytest.mark.parametrize("pattern", ["RGGB", "RGIB", "MONO"])
def test_the_raw_file_is_told_the_colours_of_the_filters_that_are_there(pattern):
    """A matrix row and a neutral per filter, each sending its light's white to the neutral; nothing for fewer than
    three.

    In daylight its matrix and tungsten's; in any other light that light's alone, as if daylight were its white.
    """
    chip, count = behind(pattern), len(cfa.filters(pattern))
    by_day, by_lamp = (digital(analog(0.0, (2, 2)), chip, illuminant=light).provenance for light in ("d65", "hps"))
    assert by_day["cfa_pattern"] == pattern
    if count < 3:
        assert not {"xyz_to_camera", "xyz_to_camera_a", "as_shot_neutral"} & set(by_day)
        return
    assert (
        np.shape(by_day["xyz_to_camera"])
        == np.shape(by_day["xyz_to_camera_a"])
        == np.shape(by_lamp["xyz_to_camera"])
        == (count, 3)
    )
    assert "xyz_to_camera_a" not in by_lamp
    tungsten, daylight = (1.0985, 1.0, 0.3558), (0.9505, 1.0, 1.0890)  # CIE 015, XYZ of illuminants A and D65
    np.testing.assert_allclose(
        np.array(by_day["xyz_to_camera_a"]) @ tungsten, response.neutral(chip, "A"), atol=4e-3
    )  # four digits, times the matrix
    np.testing.assert_allclose(np.array(by_day["xyz_to_camera"]) @ daylight, by_day["as_shot_neutral"], atol=4e-3)
    np.testing.assert_allclose(np.array(by_lamp["xyz_to_camera"]) @ daylight, by_lamp["as_shot_neutral"], atol=4e-3)
    np.testing.assert_allclose(by_lamp["as_shot_neutral"], response.neutral(chip, "HPS"), rtol=1e-12)


def test_the_amplifiers_end_and_numbers_go_on():
    """K = K0 * min(ISO / base, 8); the rest is noted, and isp.black_level multiplies by it when black is gone."""
    for iso, k, rest in ((55, 1, 1), (440, 8, 1), (880, 8, 2), (7040, 8, 16)):
        image = sensor.gain(electrons(100.0, (4, 4)), iso=iso, iso_base=55, gain_dn_e=0.17, analog_gain_max=8)
        np.testing.assert_allclose(image.pixels, 17.0 * k, rtol=1e-6)
        assert image.provenance["digital_gain"] == pytest.approx(rest)
        raw = digital(image)
        assert isp.black_level(raw, coring=0).pixels[0, 0, 0] == pytest.approx(
            rest * np.rint(17.0 * k) / (1023 - 64), rel=1e-6
        )


def test_rows_in_the_dark_take_dark_current_off():
    """64 frames of 50 e- of dark signal: their mean moves to black within 4.5 standard errors of the formula, and one
    frame by one number.

    N = 4 rows of 64: sqrt((K^2 (2.5^2 + 50) + 0.7^2) / 256) = 0.096 DN a frame at K = 0.2, which 64 draws know to 9 %.
    """
    metadata = {"dark_e": 50.0, "shot_noise": True, "read_noise_e": 2.5, "adc_noise_dn": 0.7}
    frame = analog(10.0, **metadata | {"system_gain_dn_e": 0.2})
    left = [
        sensor.black_clamp(frame, rng=seeds.stream(seed, "clamp"), optical_black_rows=4).pixels for seed in range(64)
    ]
    assert all(np.ptp(pixels) == 0.0 for pixels in left)
    means = np.array([pixels.mean() for pixels in left], dtype=np.float64)
    sigma = math.sqrt((0.04 * 56.25 + 0.49) / 256)
    assert abs(means.mean()) < SIGMAS * sigma / 8
    assert means.std(ddof=1) == pytest.approx(sigma, rel=SIGMAS / math.sqrt(2 * 63))


def test_bands_that_no_sensor_sees_are_refused():
    """They were darkness before; 380 to 780 nm is what is simulated."""
    names = ("S0.850,000000nm", "S0.940,000000nm")
    light = Image(np.ones((2, 2, 2), np.float32), names, Quantity.IRRADIANCE)
    with pytest.raises(
        ImageError, match=r"S0\.850,000000nm, S0\.940,000000nm outside 380 to 780 nm, where no sensor is simulated"
    ):
        sensor.expose(light, exposure_s=0.01, pixel_pitch_um=1.4, fill_factor=1.0, sensor=SENSOR)
