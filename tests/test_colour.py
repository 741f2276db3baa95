"""sRGB and luminance, against colour-science."""

from __future__ import annotations

import colour as colour_science
import numpy as np
import pytest

from synfog_usd.base import colour


@pytest.mark.parametrize(("kind", "rtol"), [(np.float32, 1e-6), (np.float64, 1e-12)])  # some roundings of each type
def test_the_transfer_function_is_that_of_the_standard(kind, rtol):
    """Both directions over 0 to 1 and beyond, in the type that is given; encoding cuts to 0 to 1, decoding goes on."""
    codes = np.linspace(0.0, 1.0, 4097).astype(kind)
    light = colour.srgb_decode(codes)
    assert light.dtype == kind and colour.srgb_encode(light).dtype == kind
    np.testing.assert_allclose(light, colour_science.models.eotf_sRGB(codes.astype(np.float64)), rtol=rtol)
    np.testing.assert_allclose(
        colour.srgb_encode(light),
        colour_science.models.eotf_inverse_sRGB(light.astype(np.float64)),
        rtol=10 * rtol,
        atol=1e-7,
    )
    np.testing.assert_allclose(colour.srgb_encode(np.array([-1.0, 0.0, 1.0, 7.0], dtype=kind)), [0, 0, 1, 1], rtol=rtol)
    np.testing.assert_allclose(
        colour.srgb_decode(np.array([1.5, -0.1], dtype=kind)), [((1.5 + 0.055) / 1.055) ** 2.4, -0.1 / 12.92], rtol=rtol
    )


def test_the_table_of_codes_is_the_function():
    """Each of 256 codes; the ends are exact."""
    np.testing.assert_allclose(
        colour.SRGB_TO_LINEAR, colour_science.models.eotf_sRGB(np.arange(256) / 255.0), rtol=1e-7
    )
    assert colour.SRGB_TO_LINEAR[0] == 0.0 and colour.SRGB_TO_LINEAR[255] == 1.0


def test_luminance_follows_from_the_primaries_and_white():
    """The second row of the matrix that takes the primaries of ITU-R BT.709 to the white that the module names."""
    x, y = np.array([0.64, 0.30, 0.15]), np.array([0.33, 0.60, 0.06])
    primaries = np.stack([x / y, np.ones(3), (1.0 - x - y) / y])
    share = np.linalg.solve(primaries, [0.95047, 1.0, 1.08883])
    np.testing.assert_allclose(colour.LUMINANCE, share, atol=1e-7)
