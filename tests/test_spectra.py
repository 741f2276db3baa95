"""Spectra by name: figures of the literature, colours that standards demand, colour-science, and what is refused."""

import colour
import numpy as np
import pytest

from synfog_usd.base import photometry, spectra
from synfog_usd.base.errors import ParameterError
from synfog_usd.world.materials import PAINTS

NM = photometry.WAVELENGTHS_NM


def at(curve, nm):
    return float(np.interp(nm, NM, curve))


def tristimulus(curve):
    """XYZ under D65, white at Y = 1, by colour-science."""
    cmfs = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().trim(colour.SpectralShape(380, 780, 1))
    white = colour.SDS_ILLUMINANTS["D65"].copy().align(cmfs.shape)
    return colour.sd_to_XYZ(colour.SpectralDistribution(curve, NM), cmfs, white, method="Integration") / 100.0


def chromaticity(curve):
    """(x, y) under D65."""
    return colour.XYZ_to_xy(tristimulus(curve))


@pytest.mark.parametrize("name", list(spectra.TABLE))
def test_reflectances_are_between_black_and_white_and_say_where_they_are_from(name):
    """And none is flat to 1 %."""
    curve, entry = spectra.reflectance(name), spectra.TABLE[name]
    assert curve.shape == NM.shape
    assert curve.min() >= 0.0
    assert curve.max() <= 1.0
    assert np.ptp(curve[20:321]) > 0.01 * curve.mean()
    assert entry.about
    assert len(entry.source) > 10


def test_a_leaf_has_its_green_peak_and_its_red_edge_where_they_are_measured():
    """Peak at 545 to 560 nm, least at 670 to 680 nm, steepest at 690 to 730 nm, 40 to 50 % beyond."""
    curve = spectra.reflectance("leaf")
    seen = (NM >= 500) & (NM <= 600)
    red = (NM >= 620) & (NM <= 720)
    steep = (NM >= 680) & (NM <= 750)
    assert 540 <= NM[seen][curve[seen].argmax()] <= 560
    assert 668 <= NM[red][curve[red].argmin()] <= 680
    edge = NM[steep][np.gradient(curve)[steep].argmax()]
    assert 690 <= edge <= 730
    assert 0.40 < at(curve, 770) < 0.50
    dark = spectra.leaf(NM, chlorophyll=80.0, carotene=10.0)
    assert NM[steep][np.gradient(dark)[steep].argmax()] > edge


BOXES = {  # EN 12899-1, daytime chromaticity of retro-reflective faces, and least luminance factor of class RA1
    "sheeting_white": ([(0.355, 0.355), (0.305, 0.305), (0.285, 0.325), (0.335, 0.375)], 0.35),
    "sheeting_yellow": ([(0.545, 0.454), (0.487, 0.423), (0.427, 0.483), (0.465, 0.534)], 0.27),
    "sheeting_red": ([(0.735, 0.265), (0.674, 0.236), (0.569, 0.341), (0.655, 0.345)], 0.03),
    "sheeting_blue": ([(0.078, 0.171), (0.150, 0.220), (0.210, 0.160), (0.137, 0.038)], 0.01),
}


@pytest.mark.parametrize("name", list(BOXES))
def test_sheeting_has_the_colour_that_signs_must_have(name):
    """Inside the four corners, and as bright as is demanded."""
    corners, least = np.array(BOXES[name][0]), BOXES[name][1]
    curve = spectra.reflectance(name)
    from_corner = chromaticity(curve) - corners
    along = np.roll(corners, -1, axis=0) - corners
    side = along[:, 0] * from_corner[:, 1] - along[:, 1] * from_corner[:, 0]
    assert (side > 0).all() or (side < 0).all()
    assert spectra.brightness(spectra.rgb_of(curve)) >= least


def test_d65_shows_of_a_reflectance_what_colour_science_says():
    """Linear Rec.709 within 0.002; white is (1, 1, 1) to 1e-9."""
    np.testing.assert_allclose(spectra.rgb_of(np.ones(401)), 1.0, atol=1e-9)
    for name in ("leaf", "brick", "sheeting_blue"):
        wanted = np.linalg.inv(colour.RGB_COLOURSPACES["ITU-R BT.709"].matrix_RGB_to_XYZ) @ tristimulus(
            spectra.reflectance(name)
        )
        np.testing.assert_allclose(spectra.rgb_of(spectra.reflectance(name)), wanted, atol=2e-3)


@pytest.mark.parametrize("rgb", [*PAINTS.values(), (0.9, 0.9, 0.88), (0.02, 0.02, 0.6)])
def test_paint_has_exactly_its_colour_and_one_edge_or_bump(rgb):
    """D65 shows the colour to 1e-5, and over wavelength the reflectance turns once at most."""
    curve = spectra.smooth(rgb)
    np.testing.assert_allclose(spectra.rgb_of(curve), rgb, atol=1e-5)
    turns = np.diff(np.sign(np.diff(curve)))
    assert np.count_nonzero(turns) <= 2  # one turn, on a point of the grid or beside it
    assert 0.0 < curve.min() < curve.max() < 1.0


@pytest.mark.parametrize(
    "name, table",
    [("HPS", "HP1"), ("HP1", "HP1"), ("LED", "LED-B3"), ("LED-B5", "LED-B5"), ("A", "A"), ("FL11", "FL11")],
)
def test_lights_are_those_of_the_cie(name, table):
    wanted = colour.SDS_ILLUMINANTS[table]
    np.testing.assert_allclose(spectra.emission(name)[::5], wanted[NM[::5]], rtol=1e-9)


def test_authored_pairs_are_joined_by_straight_lines_and_go_on_as_they_end():
    curve = spectra.spectrum_of_pairs([(400, 0.1), (500, 0.3), (700, 0.2)], most=1.0)
    assert [at(curve, nm) for nm in (380, 450, 600, 780)] == pytest.approx([0.1, 0.2, 0.25, 0.2])


@pytest.mark.parametrize("pairs, words", [
    ([(400, 0.1), (400, 0.2), (700, 0.3)], "do not rise"),
    ([(0.4, 0.1), (0.7, 0.2)], "micrometres"),
    ([(450, 0.1), (650, 0.2)], "covers 450 to 650 nm"),
    ([(400, 0.1), (700, 1.2)], "0 to 1"),
    ([(400, -0.1), (700, 0.2)], "-0.1 to 0.2"),
    ([(400, 0.0), (700, 0.0)], "not all 0"),
    ([(400, np.nan), (700, 0.2)], "not finite"),
    ([(400, 0.1)], "two or more pairs"),
    ([400, 700], "two or more pairs"),
])  # fmt: skip
def test_what_is_no_spectrum_is_refused(pairs, words):
    with pytest.raises(ParameterError, match=words):
        spectra.spectrum_of_pairs(pairs, most=1.0)


def test_unknown_names_are_refused_with_the_nearest():
    with pytest.raises(ParameterError, match="Did you mean 'leaf'"):
        spectra.reflectance("leav")
    with pytest.raises(ParameterError, match="Did you mean 'LED-B3'"):
        spectra.emission("LED-B33")
