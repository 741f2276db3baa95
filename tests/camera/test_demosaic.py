"""Demosaicing of every pattern: against colour-demosaicing, and by what any of them must keep."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from support import raws

from synfog_usd.base import seeds
from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import cfa
from synfog_usd.camera.demosaic import demosaic

ALGORITHMS = ("directional", "linear", "mhc")
OTHERS = ("RCCB", "RGIB")

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # it imports from a SciPy namespace that will go
    import colour_demosaicing


def mosaic(pixels, pattern="RGGB") -> Image:
    return Image(
        np.asarray(pixels, np.float32)[..., None], ("CFA",), Quantity.LINEAR_RGB, provenance={"cfa_pattern": pattern}
    )


def of_planes(planes, pattern) -> Image:
    return mosaic(raws.mosaic_of(np.asarray(planes, np.float32), pattern)[..., 0], pattern)


def noise(*shape) -> np.ndarray:
    return seeds.stream(1, "demosaic", *shape).random(shape, dtype=np.float32)


def smooth_noise(height, width, planes) -> np.ndarray:
    """A picture with detail that a demosaicing can follow."""
    from scipy.ndimage import gaussian_filter

    return np.stack(
        [gaussian_filter(noise(height, width, index + 1)[..., index], 1.5) for index in range(planes)], axis=-1
    )


@pytest.mark.parametrize("pattern, algorithm", [("GBRG", algorithm) for algorithm in ALGORITHMS])
def test_demosaicing_keeps_known_samples_and_even_colours(algorithm, pattern):
    """Pixels keep their own value; an even colour comes back everywhere, borders and odd sizes too."""
    out = demosaic(of_planes(np.broadcast_to([0.2, 0.4, 0.7], (9, 11, 3)), pattern), algorithm=algorithm)
    np.testing.assert_allclose(out.pixels, np.broadcast_to([0.2, 0.4, 0.7], (9, 11, 3)), atol=1e-6)
    assert out.channels == ("R", "G", "B")
    image = mosaic(noise(8, 10), pattern)
    out = demosaic(image, algorithm=algorithm)
    np.testing.assert_array_equal(raws.mosaic_of(out.pixels, pattern), image.pixels)


@pytest.mark.parametrize(("algorithm", "judge"), [("linear", "bilinear"), ("mhc", "Malvar2004")])
def test_openimageio_agrees_with_colour_demosaicing_inside(algorithm, judge, pattern="GRBG"):
    """The same two algorithms by another hand; they differ in the two rows at the border.  float32 rounding."""
    pixels = noise(33, 40)
    expected = getattr(colour_demosaicing, f"demosaicing_CFA_Bayer_{judge}")(pixels.astype(np.float64), pattern)
    np.testing.assert_allclose(
        demosaic(mosaic(pixels, pattern), algorithm=algorithm).pixels[2:-2, 2:-2], expected[2:-2, 2:-2], atol=1e-6
    )


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_mosaic_shifted_by_a_pixel_gives_the_shifted_picture(algorithm):
    """One scene behind the four phases: a crop that starts a column or a row later is of the next phase.

    Eight pixels of border are left out, as far as the widest of the three looks.
    """
    planes = smooth_noise(41, 43, 3)
    whole = demosaic(of_planes(planes, "RGGB"), algorithm=algorithm).pixels
    pixels = raws.mosaic_of(planes, "RGGB")[..., 0]
    for pattern, down, right in (("GRBG", 0, 1), ("GBRG", 1, 0), ("BGGR", 1, 1)):
        shifted = demosaic(mosaic(pixels[down:, right:], pattern), algorithm=algorithm).pixels
        np.testing.assert_allclose(shifted[8:-8, 8:-8], whole[down:, right:][8:-8, 8:-8], atol=1e-6, err_msg=pattern)
        wrong = demosaic(mosaic(pixels[down:, right:], "RGGB"), algorithm=algorithm).pixels
        assert np.abs(wrong - whole[down:, right:]).max() > 0.05


def grey_edge(angle_deg: float, *, low=0.1, high=0.8, size=96) -> np.ndarray:
    """(size, size) of a neutral edge, area-sampled 8 x 8."""
    at = (np.arange(size * 8) + 0.5) / 8 - size / 2
    side = at[None, :] * np.cos(np.deg2rad(angle_deg)) + at[:, None] * np.sin(np.deg2rad(angle_deg))
    return np.where(side > 0.0, high, low).reshape(size, 8, size, 8).mean(axis=(1, 3)).astype(np.float32)


def off_grey(picture) -> float:
    """Mean of the largest less the smallest of R, G and B."""
    return float(np.ptp(picture[12:-12, 12:-12], axis=2).mean())


@pytest.mark.parametrize("angle_deg", [0.0, 20.0, 87.0])
def test_directional_leaves_a_neutral_edge_neutral(angle_deg):
    """A fifth at most of the colour that linear interpolation makes, and no more than 1.5 times Menon's."""
    image = of_planes(np.repeat(grey_edge(angle_deg)[..., None], 3, axis=2), "RGGB")
    directional, linear = (off_grey(demosaic(image, algorithm=name).pixels) for name in ("directional", "linear"))
    menon = off_grey(colour_demosaicing.demosaicing_CFA_Bayer_Menon2007(image.pixels[..., 0], "RGGB"))
    assert directional < 0.2 * linear
    assert directional < max(1.5 * menon, 1e-6)


@pytest.mark.parametrize("pattern", [*OTHERS, "RCCC"])
def test_other_patterns_keep_known_samples_and_slopes(pattern):
    """A pixel keeps its number in its own plane; a slope is interpolated exactly where it has pixels on both sides."""
    letters = cfa.filters(pattern)
    rows, columns = np.mgrid[0:12, 0:14]
    planes = np.stack(
        [0.1 + 0.01 * (index + 1) * rows + 0.02 * columns for index in range(len(letters))], axis=-1
    ).astype(np.float32)
    image = of_planes(planes, pattern)
    out = demosaic(image)
    names = [letter for letter in letters if letter == "C"] if pattern == "RCCC" else letters
    for channel, letter in enumerate(names):
        number = letters.index(letter)
        np.testing.assert_allclose(out.pixels[2:-2, 2:-2, channel], planes[2:-2, 2:-2, number], rtol=1e-6)
        for where, site in cfa.sites(pattern):
            if site == number:
                np.testing.assert_array_equal(out.pixels[where][..., channel], image.pixels[where][..., 0])


def test_a_sensor_without_colour_gives_brightness():
    """MONO as it is; RCCC the clear pixels, the red ones as their clear neighbours."""
    pixels = noise(6, 8)
    out = demosaic(mosaic(pixels, "MONO"))
    assert out.channels == ("Y",)
    np.testing.assert_array_equal(out.pixels[..., 0], pixels)
    out = demosaic(mosaic(pixels, "RCCC"))
    assert out.channels == ("Y",)
    around = (
        2 * (pixels[1, 2] + pixels[3, 2] + pixels[2, 1] + pixels[2, 3])
        + pixels[1, 1]
        + pixels[1, 3]
        + pixels[3, 1]
        + pixels[3, 3]
    ) / 12
    assert out.pixels[2, 2, 0] == pytest.approx(around, rel=1e-6)


@pytest.mark.parametrize("pattern", list(cfa.PATTERNS))
@pytest.mark.parametrize("shape", [(2, 2), (3, 5)])
def test_the_smallest_pictures_are_taken(shape, pattern):
    for algorithm in ALGORITHMS:
        out = demosaic(mosaic(noise(*shape), pattern), algorithm=algorithm).pixels
        assert np.isfinite(out).all() and out.shape[:2] == shape


def test_a_mosaic_that_is_none_is_refused():
    with pytest.raises(ImageError, match="the least is 2 x 2"):
        demosaic(mosaic(np.zeros((1, 4))))
    with pytest.raises(ImageError, match="a mosaic has one channel"):
        demosaic(Image(np.zeros((4, 4, 3), np.float32), ("R", "G", "B"), Quantity.LINEAR_RGB))
    with pytest.raises(ImageError, match="does not say its cfa_pattern"):
        demosaic(Image(np.zeros((4, 4, 1), np.float32), ("CFA",), Quantity.LINEAR_RGB))
