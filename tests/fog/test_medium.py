"""Extinction, profiles and optical depth against other formulas."""

import numpy as np
import pytest
from scipy import integrate

from synfog_usd.base.errors import ParameterError
from synfog_usd.fog import FogMedium, extinction_from_visibility

EPS64 = np.finfo(np.float64).eps


def test_visibilities_of_the_paper_give_its_extinctions():
    """MOR 600, 300 and 150 m are 0.005, 0.01 and 0.02 per metre (SynFog, table 1) to the 0.14 % by which 2.996 misses
    3.
    """
    np.testing.assert_allclose(extinction_from_visibility([600.0, 300.0, 150.0]), [0.005, 0.01, 0.02], rtol=0.0015)


def test_contrast_at_the_visibility_is_the_threshold():
    """exp(-sigma MOR) is the threshold itself, for any threshold."""
    for contrast in (0.02, 0.05, 0.5):
        np.testing.assert_allclose(
            np.exp(-extinction_from_visibility(70.0, contrast=contrast) * 70.0), contrast, rtol=4 * EPS64
        )


@pytest.mark.parametrize("start, end", [(30.0, 0.0), (-8.0, 12.0), (-3.0, -1.0), (5.0, 5.0 + 1e-6)])
def test_optical_depth_is_the_integral_of_extinction(start, end):
    """The closed form of an exponential fog equals adaptive quadrature, above, below and across its base."""
    fog = FogMedium(0.02, profile="exponential", base_height_m=1.0, scale_height_m=12.0)
    length = 40.0
    wanted, _ = integrate.quad(
        lambda s: float(fog.sigma_t(start + (end - start) * s / length)),
        0.0,
        length,
        points=[20.0],
        epsabs=1e-13,
        limit=200,
    )
    np.testing.assert_allclose(
        fog.optical_depth(start, end, length), wanted, rtol=1e-8
    )  # quadrature across the kink at the base; measured 2e-10


@pytest.mark.parametrize(
    "visibility, contrast", [(0.0, 0.05), (-5.0, 0.05), (float("nan"), 0.05), (100.0, 0.0), (100.0, 1.0)]
)
def test_impossible_visibility_is_refused(visibility, contrast):
    """Zero, negative and NaN visibilities are errors."""
    with pytest.raises(ParameterError):
        extinction_from_visibility(visibility, contrast=contrast)
