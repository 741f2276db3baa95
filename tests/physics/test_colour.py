"""A ColorChecker under four lights, through the whole camera without noise, with every sensor that ships.

The truth is colour-science's XYZ of the measured spectra, adapted to D65 (Bradford), as
`isp.colour_correct` promises it.  The camera gets radiance in 1 nm bands.  Its converter is
widened to 16 bits and its gain set so that the full well just fits: the question is colour,
not rounding.
"""

from __future__ import annotations

import functools
import re
from pathlib import Path

import colour
import numpy as np
import pytest

from synfog_usd import camera
from synfog_usd.base import photometry, resources
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import response
from synfog_usd.camera.graph import make_graph
from synfog_usd.camera.profiles import load_sensor

LIGHTS = {"d65": "D65", "a": "A", "hps": "HP1", "led": "LED-B3"}
"""Our name of a light -> colour-science's."""

SRGB = colour.RGB_COLOURSPACES["sRGB"]
BANDS_NM = np.arange(380.0, 781.0, 1.0)

MEDIAN_DE00 = {"d65": 0.73, "a": 1.06, "hps": 1.26, "led": 0.70}
"""Measured for the curves of the Nikon D5100, which every colour sensor that ships but `ideal` borrows."""

OWN = {
    "RCCB": "{R: {gaussian: [600, 80, 0.9]}, B: {gaussian: [460, 80, 0.9]}}",
    "RGIB": (
        "{R: {gaussian: [600, 80, 0.9]}, G: {gaussian: [540, 80, 0.9]}, B: {gaussian: [460, 80, 0.9]}, I: {long_pass: "
        "[650, 20]}}"
    ),
}
"""Patterns that no shipped sensor has, with filters of our own."""


def on_bands(table) -> np.ndarray:
    return np.interp(BANDS_NM, table.wavelengths, table.values)


def developed(sensor: str, light: str, reflectances: np.ndarray, folder: Path = Path()) -> np.ndarray:
    """(N, 3) linear Rec.709 of N surfaces of (N, 401) reflectance under a light, white at 0.8 of saturation; to any
    scale.
    """
    chip = load_sensor(sensor, folder)
    span = 65535 - chip.black_level_dn
    graph = make_graph(
        camera.OPS,
        extends="noise_free",
        folder=folder,
        sensor=sensor,
        nodes=[
            {"name": "irradiance", "falloff": "none"},  # the colours of patches, without a lens
            {"name": "diffraction", "remove": True},
            {"name": "adc", "bits": 16, "white_level_dn": 65535},
            {"name": "gain", "gain_dn_e": span / chip.full_well_e, "iso": chip.iso_base},
            {"name": "white_balance", "illuminant": light},
            {"name": "colour", "illuminant": light},
        ],
        outputs={},
    )
    names = tuple(photometry.band_name(centre) for centre in BANDS_NM)

    def shot(rows: np.ndarray, exposure_s: float, node: str) -> Image:
        lit = rows * on_bands(colour.SDS_ILLUMINANTS[LIGHTS[light]])
        blocks = np.repeat(
            np.repeat(lit[None].astype(np.float32), 8, axis=0), 8, axis=1
        )  # a strip of blocks of 8 x 8 pixels
        return graph.run(
            {"radiance": Image(blocks, names, Quantity.RADIANCE)},
            seed=0,
            settings={"exposure_s": exposure_s},
            until=node,
        )[node]

    brightest = float(shot(np.ones((1, BANDS_NM.size)), 1e-6, "expose").pixels.max())
    picture = shot(reflectances, 0.8e-6 * chip.full_well_e / brightest, "colour")
    return picture.pixels[3, 3::8].astype(np.float64)


@functools.lru_cache(maxsize=64)
def differences(sensor: str, light: str) -> np.ndarray:
    """(24,) CIEDE2000 of the patches of the ISO 17321-1 chart."""
    chart = colour.SDS_COLOURCHECKERS["ISO 17321-1"]
    source = colour.SDS_ILLUMINANTS[LIGHTS[light]]
    found = developed(sensor, light, np.array([on_bands(patch) for patch in chart.values()])) @ SRGB.matrix_RGB_to_XYZ.T
    with colour.utilities.suppress_warnings(
        colour_runtime_warnings=True
    ):  # it says that it interpolates its own tables
        expected = np.array([colour.sd_to_XYZ(patch, illuminant=source) for patch in chart.values()]) / 100
        white = colour.sd_to_XYZ(colour.sd_ones(), illuminant=source) / 100
    d65 = SRGB.matrix_RGB_to_XYZ.sum(axis=1)
    expected = expected @ colour.adaptation.matrix_chromatic_adaptation_VonKries(white, d65, transform="Bradford").T
    found *= expected[:, 1].sum() / found[:, 1].sum()
    return colour.delta_E(
        colour.XYZ_to_Lab(expected, SRGB.whitepoint), colour.XYZ_to_Lab(found, SRGB.whitepoint), method="CIE 2000"
    )


@pytest.mark.parametrize("light", LIGHTS)
def test_the_ideal_sensor_sees_what_the_eye_sees(light):
    """Its filters are the eye's, so a matrix can be exact: median CIEDE2000 below 0.3 (the bar is 1.5)."""
    assert np.median(differences("ideal", light)) < 0.3


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("sensor", ["imx363", "ar0132at"])
def test_other_sensors_reach_what_is_recorded(sensor, light):
    """No matrix can be exact for filters that are not the eye's; 0.1 for another version of the tables.

    The most under sodium, whose lines leave little of a surface's spectrum to tell.  The provenance of the
    picture says the mean over the same patches, to 0.03: rounding, and grids of 1 and 5 nm.
    """
    found = differences(sensor, light)
    assert np.median(found) == pytest.approx(MEDIAN_DE00[light], abs=0.1)
    assert response.colour_matrix(load_sensor(sensor), light.upper()).mean_de00 == pytest.approx(found.mean(), abs=0.03)


@pytest.mark.parametrize("sensor, light", [("ideal", "a"), ("imx363", "hps"), ("imx363", "led")])
def test_neutrals_are_neutral(sensor, light):
    """Greys of 2 to 95 % lie within 0.002 of D65 in CIE 1976 u'v', rounding to 16 bits included."""
    levels = np.array([0.02, 0.05, 0.1, 0.2, 0.4, 0.7, 0.95])
    found = developed(sensor, light, levels[:, None] * np.ones(BANDS_NM.size)) @ SRGB.matrix_RGB_to_XYZ.T
    uv = colour.xy_to_Luv_uv(colour.XYZ_to_xy(found))
    assert np.hypot(*(uv - colour.xy_to_Luv_uv(SRGB.whitepoint)).T).max() < 0.002


@pytest.mark.parametrize("pattern, light", [("RCCB", "a"), ("RGIB", "hps")])
def test_neutrals_are_neutral_behind_other_patterns(pattern, light, tmp_path):
    """The same for a clear-filter and an infra-red pattern: 3 x F matrices, and balance of every filter."""
    text = (resources.folder("assets") / "sensors" / "imx363.yaml").read_text()
    text = re.sub(r"(?m)^cfa:.*$", f"cfa: {pattern}", text)
    text = re.sub(
        r"(?m)^qe:.*$",
        f"qe: {{product: {{sensor: {{flat: 0.6}}, filters: {OWN[pattern]}}}, source: borrowed_qe}}",
        text,
    )
    (tmp_path / "own.yaml").write_text(text)
    levels = np.array([0.05, 0.2, 0.7])
    found = (
        developed("./own.yaml", light, levels[:, None] * np.ones(BANDS_NM.size), tmp_path) @ SRGB.matrix_RGB_to_XYZ.T
    )
    assert (
        np.hypot(*(colour.xy_to_Luv_uv(colour.XYZ_to_xy(found)) - colour.xy_to_Luv_uv(SRGB.whitepoint)).T).max() < 0.002
    )
    blue = developed("./own.yaml", light, np.where(BANDS_NM < 500, 0.9, 0.1)[None], tmp_path)[0]
    assert blue[2] > 1.5 * max(blue[0], blue[1])  # colour is seen, not only greys
