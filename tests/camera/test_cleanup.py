"""Defects, noise and sharpness: what is found, what is left alone, and what it costs in contrast."""

from __future__ import annotations

import numpy as np
import pytest

from synfog_usd import camera
from synfog_usd.base import seeds
from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.cleanup import defects, denoise, false_colour, sharpen
from synfog_usd.camera.graph import make_graph

WELL_E, READ_E = 6000.0, 5.0
SHOT, DARK = 1.0 / WELL_E, (READ_E / WELL_E) ** 2
"""Of the test sensor: a signal x of the well has the variance SHOT x + DARK."""


def mosaic(pixels, pattern="RGGB") -> Image:
    return Image(
        np.asarray(pixels, np.float32)[..., None],
        ("CFA",),
        Quantity.LINEAR_RGB,
        provenance={"cfa_pattern": pattern, "noise_profile": [SHOT, DARK]},
    )


def sigma(level):
    return np.sqrt(SHOT * level + DARK)


def frame(mean, seed) -> np.ndarray:
    """Counted light: Poisson and read noise on a mean signal (H, W), 1 = full well."""
    rng = seeds.stream(seed, "cleanup")
    return ((rng.poisson(mean * WELL_E) + READ_E * rng.standard_normal(np.shape(mean))) / WELL_E).astype(np.float32)


def textured(size, seed, contrast=0.4) -> np.ndarray:
    """A scene of 1/f amplitude around 0.3, as natural scenes have, through the phone's lens (lambda N / pitch = 0.64)
    and its pixels.
    """
    down, right = np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None, :]
    frequencies = np.hypot(down, right)
    spectrum = np.fft.rfft2(seeds.stream(seed, "texture").standard_normal((size, size))) / np.maximum(
        frequencies, 1 / size
    )
    detail = np.fft.irfft2(spectrum, s=(size, size))
    v = np.minimum(0.64 * frequencies, 1.0)
    lens = 2 / np.pi * (np.arccos(v) - v * np.sqrt(1 - v**2)) * np.sinc(down) * np.sinc(right)
    return np.clip(
        np.fft.irfft2(np.fft.rfft2(0.3 * (1 + contrast * detail / detail.std())) * lens, s=(size, size)), 0.0, 1.0
    )


# ---- defects


@pytest.mark.parametrize("scene", ["dark", "texture"])
def test_ordinary_pixels_stay(scene):
    """A million noisy pixels without a defect: fewer than ten (1e-5) change.

    None of a million tells a rate below 3e-6 (95 %).
    """
    mean = np.zeros((1000, 1000)) if scene == "dark" else textured(1000, 3)
    out = defects(mosaic(frame(mean, 1)))
    assert out.provenance["defects_corrected"] < 10


@pytest.mark.parametrize("pattern, level", [("RGGB", 0.5), ("RGIB", 0.1), ("MONO", 0.0)])
def test_all_single_hot_pixels_of_twenty_sigma_are_found(level, pattern):
    """1024 of them, twelve pixels apart, all phases, corners and borders included; each becomes what it was, to the
    noise of a median.
    """
    clean = frame(np.full((379, 379), level), 2)
    image = clean.copy()
    rows, columns = (index.ravel() for index in np.mgrid[0:373:12, 0:373:12])
    rows, columns = np.minimum(rows + (columns // 12) % 7, 378), np.minimum(columns + (rows // 12) % 5, 378)
    image[rows, columns] = level + 20 * sigma(level)
    out = defects(mosaic(image, pattern))
    assert out.provenance["defects_corrected"] == rows.size
    assert np.abs(out.pixels[rows, columns, 0] - level).max() < 4 * sigma(level)
    untouched = np.ones(image.shape, dtype=bool)
    untouched[rows, columns] = False
    np.testing.assert_array_equal(out.pixels[..., 0][untouched], image[untouched])


def test_lamps_are_left_alone():
    """225 lamps of one green pixel through the phone's lens without its errors, which is the hardest case, 200 sigma to
    500 wells: none is touched.  At 30 sigma nearly all are.

    Such a lens puts 2.4 % of such a lamp into each pixel beside it (asserted): 4.8 sigma at 200, in
    sum over four 4.4 times their own noise and more than the bound of 4; at 30 sigma nothing shows.
    """
    graph = make_graph(
        camera.OPS,
        inputs=["radiance"],
        sensor="imx363",
        lens="pixel4a",
        nodes=[
            {"op": "optics.irradiance", "falloff": "none"},
            {"op": "optics.diffraction", "spot_um": 0.0},
            {"op": "sensor.expose", "exposure_s": 0.01},
            {"op": "sensor.shot_noise"},
            {"op": "sensor.full_well"},
            {"op": "sensor.read_noise"},
            {"op": "sensor.gain", "iso": 55},
            {"op": "sensor.adc_noise"},
            {"op": "sensor.adc"},
            {"op": "isp.black_level"},
            {"op": "isp.defects"},
        ],
        outputs={"defects.exr": "defects"},
    )
    lamps = np.zeros((240, 240, 3), np.float32)
    lamps[8::16, 9::16] = 1.0
    exposed = graph.run({"radiance": Image(lamps, ("R", "G", "B"), Quantity.RADIANCE)}, seed=0, until="expose")[
        "expose"
    ].pixels[..., 0]
    peak = exposed[8::16, 9::16].mean()
    assert 0.02 < exposed[7, 9] / peak < 0.03 and 0.02 < exposed[8, 8] / peak < 0.03
    corrected = {}
    for electrons in (30 * READ_E, 200 * READ_E, 2 * WELL_E, 500 * WELL_E):
        image = Image(lamps * np.float32(electrons / peak), ("R", "G", "B"), Quantity.RADIANCE)
        run = graph.run({"radiance": image}, seed=1)
        corrected[electrons] = run["defects"].provenance["defects_corrected"]
        assert (run["defects"].pixels != run["black_level"].pixels).sum() == corrected[electrons]
    faint, *others = corrected.values()
    assert others == [0, 0, 0]
    assert faint > 200  # what the docstring says of faint lamps


def test_defects_need_a_noise_profile_and_leave_tiny_pictures_alone():
    with pytest.raises(ImageError, match="does not say its noise_profile"):
        defects(Image(np.zeros((8, 8, 1), np.float32), ("CFA",), Quantity.LINEAR_RGB))
    image = mosaic([[0.0, 9.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    np.testing.assert_array_equal(defects(image).pixels, image.pixels)


# ---- denoise


@pytest.mark.parametrize("pattern, level", [("RGGB", 0.02), ("RGIB", 0.4)])
def test_noise_falls_and_the_mean_stays(level, pattern):
    """Flat grey: noise below a fifth; the mean within 4 standard errors of the input's own."""
    clean = frame(np.full((400, 400), level), 4)
    out = denoise(mosaic(clean, pattern)).pixels[..., 0]
    assert out[20:-20, 20:-20].std() < 0.2 * clean.std()
    assert abs(out.mean(dtype=np.float64) - clean.mean(dtype=np.float64)) < 4 * sigma(level) / 400


def test_contrast_above_the_noise_stays_and_below_it_goes():
    """Vertical edges of 40 and of 1 sigma: 97 % of the first is kept two pixels off the edge, and the mean over its
    halves exactly.

    The step's largest detail is 0.3 of its height in level 1, where T is 2.7 sigma: it loses T^2 / w = 0.6 of 12 sigma.
    """
    level = 0.3
    for height, low, high in ((40.0, 0.97, 1.02), (1.0, 0.0, 1.2)):
        mean = np.full((400, 400), level)
        mean[:, 200:] += height * sigma(level)
        out = denoise(mosaic(frame(mean, 5), "MONO")).pixels[..., 0]
        step = (out[:, 202].mean() - out[:, 197].mean()) / (height * sigma(level))
        assert low < step < high
    bump = np.full((400, 400), level)
    bump[50::100, 50::100] += 2.0 * sigma(level)  # single pixels of 2 sigma: gone with the noise
    out = denoise(mosaic(frame(bump, 6), "MONO")).pixels[..., 0]
    assert abs(out[50::100, 50::100].mean() - level) < 0.5 * sigma(level)


# ---- false colours


def picture(pixels) -> Image:
    return Image(np.asarray(pixels, np.float32), ("R", "G", "B"), Quantity.LINEAR_RGB)


def test_colour_differences_become_medians_as_scipy_takes_them():
    """Over rows of a strip and of the next; within three pixels of the rim the order of the four passes shows."""
    from scipy.ndimage import median_filter

    pixels = seeds.stream(2, "false colour").random((140, 33, 3), dtype=np.float32)
    out = false_colour(picture(pixels)).pixels
    np.testing.assert_array_equal(out[..., 1], pixels[..., 1])
    for channel in (0, 2):
        expected = pixels[..., channel] - pixels[..., 1]
        for reach in (1, 2):
            for shape in ((2 * reach + 1, 1), (1, 2 * reach + 1)):
                three = np.zeros(shape, dtype=bool)
                three.flat[::reach] = True
                expected = median_filter(expected, footprint=three)
        inside = (slice(6, -6), slice(6, -6))
        np.testing.assert_array_equal(out[..., channel][inside], (pixels[..., 1] + expected)[inside])


# ---- sharpen


def wave(period_px, amplitude=0.1) -> Image:
    line = 0.5 + amplitude * np.sin(2 * np.pi * np.arange(400) / period_px)
    return Image(
        np.broadcast_to(line.astype(np.float32)[None, :, None], (20, 400, 3)).copy(),
        ("R", "G", "B"),
        Quantity.DISPLAY_RGB,
    )


@pytest.mark.parametrize("radius_px, period_px", [(0.8, 4.0), (2.0, 10.0)])
def test_waves_rise_as_the_unsharp_mask_says(radius_px, period_px):
    """Amplitude times 1 + amount (1 - exp(-2 pi^2 r^2 / P^2)); 1 % for a kernel cut at 3 r and sampled at pixels."""
    out = sharpen(wave(period_px), radius_px=radius_px, amount=0.8, threshold=0.0).pixels[10, 100:300, 0]
    expected = 0.1 * (1 + 0.8 * (1 - np.exp(-2 * (np.pi * radius_px / period_px) ** 2)))
    carrier = np.sin(2 * np.pi * np.arange(100, 300) / period_px)
    assert 2 * np.mean((out - 0.5) * carrier) == pytest.approx(expected, rel=0.01)
