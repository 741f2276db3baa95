"""Rows that begin together and end as they are read: their light, their dark current and a flash, by closed form."""

import numpy as np
import pytest

from synfog_usd import camera
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.exposure import meter
from synfog_usd.camera.flicker import flicker
from synfog_usd.camera.graph import make_graph

TIME_S, READOUT_S, ROWS = 0.004, 0.012, 60
TIMES_S = TIME_S + READOUT_S * (np.arange(ROWS) + 0.5) / ROWS


def radiance(level: float = 100.0) -> Image:
    return Image(np.full((ROWS, 8, 3), level, np.float32), ("R", "G", "B"), Quantity.RADIANCE)


def graph(shutter: str = "global_reset", **more):
    """A camera behind a lens that mixes no rows."""
    return make_graph(
        camera.OPS,
        extends="machine_vision_mono",
        nodes=[
            {"name": "irradiance", "falloff": "none"},
            {"name": "expose", "exposure_s": TIME_S, "shutter": shutter, "readout_s": READOUT_S, **more},
        ],
        outputs={},
    ).without(["diffraction", "glare"])


def test_a_row_gathers_light_and_heat_for_its_own_time():
    """Even light: 1 + v readout / t times the electrons of the shutter that rolls: 1.025 in the middle of the top row,
    3.975 in that of the bottom row.  Dark current likewise.
    """
    light, dark = (
        {
            shutter: graph(shutter).run({"radiance": radiance(level)}, seed=0, settings={"iso": 100.0}, until=until)[
                until
            ]
            for shutter in ("rolling", "global_reset")
        }
        for level, until in ((100.0, "expose"), (0.0, "dark_current"))
    )
    for kind in (light, dark):
        rows = {shutter: image.pixels[:, 0, 0].astype(np.float64) for shutter, image in kind.items()}
        assert rows["rolling"].min() > 0.001
        np.testing.assert_allclose(rows["global_reset"] / rows["rolling"], TIMES_S / TIME_S, rtol=1e-6)
        assert rows["global_reset"][-1] / rows["global_reset"][0] == pytest.approx(3.975 / 1.025, rel=1e-6)


def test_a_flash_within_the_time_of_the_top_row_is_even_and_steady_light_is_not():
    """A lamp that is on once, for 2 ms from the beginning on, and nothing besides: all rows count the same.  Under a
    rolling shutter the rows that begin after it are dark.
    """
    lamp = {"frequency_hz": (10.0,), "duty": (0.02,), "exposure_s": TIME_S, "readout_s": READOUT_S}
    shown = {
        shutter: flicker(radiance(), radiance(), shutter=shutter, **lamp) for shutter in ("rolling", "global_reset")
    }
    counts = {
        shutter: graph(shutter)
        .run({"radiance": light}, seed=0, settings={"iso": 100.0}, until="expose")["expose"]
        .pixels[:, 0, 0]
        for shutter, light in shown.items()
    }
    np.testing.assert_allclose(counts["global_reset"], counts["global_reset"][0], rtol=1e-5)
    assert counts["global_reset"][0] == pytest.approx(counts["rolling"][0], rel=0.06)  # it begins 0.1 ms later
    assert counts["rolling"][ROWS // 4] == 0.0 < counts["rolling"][0]


def test_automatic_exposure_meters_the_top_row():
    """Which lasts as long under both."""
    times = [meter(radiance(), graph(shutter, exposure_s="auto")).exposure_s for shutter in ("rolling", "global_reset")]
    assert times[0] == times[1]
