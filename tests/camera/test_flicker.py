"""Pulsed lamps: the share of an exposure in which they are on, by brute force, and what a camera makes of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from synfog_usd import camera
from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.flicker import flicker, lit_share
from synfog_usd.camera.graph import make_graph


def radiance(level: float, shape=(40, 6)) -> Image:
    return Image(
        np.full((*shape, 3), level, np.float32), ("R", "G", "B"), Quantity.RADIANCE, provenance={"fov_x_deg": 60.0}
    )


@pytest.mark.parametrize(
    ("exposure_s", "frequency_hz", "duty", "phase"), [(0.001, 90.0, 0.1, 0.0), (0.0123, 250.0, 0.35, 0.9)]
)
def test_the_share_is_that_of_a_million_moments(exposure_s, frequency_hz, duty, phase):
    """Counted at 10^5 moments of each of five exposures; the count is known to two moments a flank."""
    begins = np.array([0.0, 0.0017, 0.0049, 0.0101, 0.0333])
    moments = begins[:, None] + (np.arange(100_000) + 0.5) / 100_000 * exposure_s
    counted = (((moments * frequency_hz + phase) % 1.0) < duty).mean(axis=1)
    flanks = 2 + 2 * exposure_s * frequency_hz
    np.testing.assert_allclose(
        lit_share(begins, exposure_s, frequency_hz, duty, phase), counted, atol=2 * flanks / 100_000
    )


def test_over_all_phases_a_lamp_has_its_authored_mean():
    """300 rows over exactly seven periods: the mean row has the authored light, single rows none or ten times."""
    steady = radiance(100.0, (300, 4))
    shown = flicker(
        steady, steady, frequency_hz=(700.0,), duty=(0.1,), phase=(0.03,), exposure_s=1e-5, readout_s=0.01
    ).pixels
    assert shown.mean() == pytest.approx(100.0, rel=0.01)
    assert shown.min() == 0.0 and shown.max() == pytest.approx(1000.0, rel=1e-5)


def test_a_whole_number_of_periods_shows_no_flicker_and_other_light_stays():
    """At 100 Hz 20 ms are even; 5 ms make bands of a lamp of a half duty, between 0 and 2 of it beside steady light."""
    whole, lamp = radiance(10.0, (200, 4)), radiance(3.0, (200, 4))
    pulse = {"frequency_hz": (100.0,), "duty": (0.5,), "readout_s": 0.02}
    even = flicker(whole, lamp, exposure_s=0.02, **pulse).pixels
    np.testing.assert_allclose(even, 10.0, rtol=1e-6)
    bands = flicker(whole, lamp, exposure_s=0.005, **pulse).pixels[:, 0, 0]
    assert bands.min() == pytest.approx(7.0, abs=0.1) and bands.max() == pytest.approx(13.0, abs=0.1)
    spectrum = np.abs(np.fft.rfft(bands - bands.mean()))
    assert spectrum.argmax() == 2, "two periods of 10 ms in a readout of 20 ms"


def test_groups_that_do_not_fit_are_refused():
    whole = radiance(1.0)
    with pytest.raises(ImageError, match="1 groups of lamps, but 2 frequencies, 1 duties and 1 phases"):
        flicker(whole, whole, frequency_hz=(1.0, 2.0), duty=(0.5,), exposure_s=0.01)
    with pytest.raises(ImageError, match="is no part of one of"):
        flicker(whole, radiance(1.0, (3, 3)), frequency_hz=(1.0,), duty=(0.5,), exposure_s=0.01)


def test_a_phone_whose_lamps_flicker_meters_as_if_they_did_not():
    """Auto exposure averages over periods; the picture then shows a lamp that is off while the rows expose."""
    node = {
        "name": "pulse",
        "op": "light.flicker",
        "in": ["radiance", "lightgroup_signal"],
        "frequency_hz": [90.0],
        "duty": [0.001],
        "phase": [0.5],
        "exposure_s": "auto",
        "before": "irradiance",
    }
    graph = make_graph(
        camera.OPS,
        extends="phone",
        inputs={"radiance": "radiance", "lightgroup_signal": "radiance"},
        nodes=[node, {"name": "irradiance", "in": "pulse"}],
        outputs={"linear.exr": "colour"},
    )
    plain = camera.load_graph(Path("phone"))
    whole, lamp = radiance(5000.0, (80, 120)), radiance(1500.0, (80, 120))
    exposure = camera.meter(whole, graph)
    assert exposure == camera.meter(whole, plain)
    assert exposure.exposure_s < 0.5 / 90.0, "else the lamp comes on"
    run = camera.develop(graph, {"radiance": whole, "lightgroup_signal": lamp}, seed=1, keep=["pulse", "expose"])
    np.testing.assert_allclose(run["pulse"].pixels, 3500.0, rtol=1e-5)
