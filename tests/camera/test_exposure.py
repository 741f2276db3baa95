"""Automatic exposure: what a photographer expects of it, in numbers."""

from __future__ import annotations

import numpy as np
import pytest

from synfog_usd import camera
from synfog_usd.base import resources
from synfog_usd.base.errors import ParameterError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import exposure as metering


@pytest.fixture(scope="module")
def phone():
    return camera.load_graph(resources.folder("pipeline") / "phone.yaml")


def street(sky: float, road: float, lamps: int = 0, lamp: float = 1e5) -> Image:
    """Sky over 40 % of the frame, road below, some single pixels of lamps."""
    pixels = np.full((90, 160, 3), road, np.float32)
    pixels[:36] = sky
    for index in range(lamps):
        pixels[20 + 3 * (index % 5), 10 + 9 * (index // 5)] = lamp
    return Image(pixels, ("R", "G", "B"), Quantity.RADIANCE, provenance={"fov_x_deg": 65.0})


def shown(graph, image, exposure) -> np.ndarray:
    return graph.run({"radiance": image}, seed=1, settings=exposure.settings)["srgb"].pixels


def test_an_overcast_street_has_a_bright_sky_that_does_not_clip_and_a_readable_road(phone):
    image = street(5000.0, 800.0)
    exposure = camera.meter(image, phone)
    out = shown(phone, image, exposure)
    sky, road = out[4:32, 40:120], out[60:86, 40:120]
    assert 0.78 < sky.mean() < 0.97 and np.mean(sky > 0.999) < 1e-3
    assert 0.3 < road.mean() < 0.5
    assert exposure.iso == 55.0 and exposure.limit == "none" and exposure.exposure_s < 1 / 500


def test_lamps_do_not_move_the_exposure(phone):
    """40 lamps of 100 000 nits in 14 400 pixels: a meter keyed on the brightest pixel would go down by 10 000."""
    plain = camera.meter(street(0.5, 1.0), phone)
    lit = camera.meter(street(0.5, 1.0, lamps=40), phone)
    ratio = (lit.exposure_s * lit.iso) / (plain.exposure_s * plain.iso)
    assert 0.7 < ratio <= 1.0


def test_the_range_of_the_sensor_is_kept_and_said(phone):
    """Full sun on snow a thousand times over, and a moonless night."""
    bright = camera.meter(street(1e7, 1e7), phone)
    assert (bright.exposure_s, bright.iso, bright.limit) == (5e-5, 55.0, "bright")
    dark = camera.meter(street(1e-6, 1e-6), phone)
    assert (dark.exposure_s, dark.iso, dark.limit) == (pytest.approx(1 / 15, rel=1e-6), 7040.0, "dark")
    black = camera.meter(street(0.0, 0.0), phone)
    assert (black.iso, black.mean_cd_m2, black.limit) == (7040.0, 0.0, "dark")


def test_exposure_follows_the_light(phone):
    """Twice the light, half the time, where the key is the day's."""
    one, two = camera.meter(street(2000.0, 400.0), phone), camera.meter(street(4000.0, 800.0), phone)
    assert one.exposure_s / two.exposure_s == pytest.approx(2.0, rel=1e-4)
    assert two.mean_cd_m2 == pytest.approx(4000.0**0.4 * 800.0**0.6, rel=0.01)  # geometric mean of the two areas
    brighter = camera.meter(street(2000.0, 400.0), phone, compensation_ev=1.0)
    assert brighter.exposure_s / one.exposure_s == pytest.approx(2.0, rel=1e-6)


def test_what_the_graph_fixes_stays_and_the_other_makes_up_for_it(phone):
    image = street(50.0, 8.0)
    free = camera.meter(image, phone)
    product = free.exposure_s * free.iso
    fixed_time = camera.meter(image, phone.with_overrides({"expose.exposure_s": free.exposure_s / 4}))
    assert (fixed_time.exposure_s, fixed_time.exposure_s * fixed_time.iso) == (
        free.exposure_s / 4,
        pytest.approx(product),
    )
    fixed_iso = camera.meter(image, phone.with_overrides({"gain.iso": 440}))
    assert (fixed_iso.iso, fixed_iso.exposure_s * fixed_iso.iso, fixed_iso.limit) == (
        440.0,
        pytest.approx(product),
        "none",
    )
    assert camera.meter(image, phone.with_overrides({"expose.exposure_s": 10})).limit == "bright"


def test_a_photographers_exposure_goes_over_the_graph_and_stays_in_the_sensors_range(phone):
    """The imx363 of the phone takes 1/20000 to 1/15 s and ISO 55 to 7040; what is left open is metered as before."""
    image = street(50.0, 8.0)
    free = camera.meter(image, phone)
    both = camera.exposed(phone, exposure_s=1 / 200, iso=400.0)
    assert camera.exposure_left_open(both) == set()
    found = camera.meter(image, both)
    assert (found.exposure_s, found.iso, found.limit, str(found)) == (1 / 200, 400.0, "none", "1/200 s, ISO 400")
    time = camera.meter(image, camera.exposed(phone, exposure_s=free.exposure_s / 2))
    assert time.iso == pytest.approx(2.0 * free.iso)
    assert camera.exposed(phone) is phone
    for words, told in (
        ({"exposure_s": 1.0}, r"--exposure 1 s: the sensor imx363 takes 1/20000 s to 1/15 s"),
        ({"iso": 50.0}, r"--iso 50: the sensor imx363 takes 55 to 7040"),
    ):
        with pytest.raises(ParameterError, match=told):
            camera.exposed(phone, **words)


@pytest.fixture(scope="module")
def automotive():
    return camera.load_graph(resources.folder("pipeline") / "automotive_hdr.yaml")


def test_of_several_exposures_the_most_sensitive_is_metered(automotive):
    """The large diode's green pixels collect the key of its well, 22 000 e-; the small one a tenth of it."""
    graph, image = automotive.with_overrides({"irradiance.falloff": "none"}), street(1000.0, 1000.0)
    exposure = camera.meter(image, graph)
    run = graph.run({"radiance": image}, seed=0, settings=exposure.settings, until="merge")
    large, small = (run[name].pixels[30:60:2, 41:120:2].mean() for name in ("expose", "expose_small"))
    assert large == pytest.approx(metering.DAY_KEY * 22_000, rel=0.005) and small == pytest.approx(large / 10, rel=1e-4)
    assert exposure.limit == "none" and exposure.iso == 100.0


@pytest.mark.parametrize("name, iso", [("phone", 440.0), ("machine_vision_mono", 100.0), ("automotive_hdr", 100.0)])
def test_the_noise_floor_is_the_noise_of_frames(name, iso):
    """Standard deviation in the middle of real frames, from two of them, over what a nit gives: as `noise_floor` says,
    within 3 %.

    24 576 pixels: 0.45 % for one standard deviation.  Fixed patterns cancel in the difference.
    """
    graph = camera.load_graph(resources.folder("pipeline") / f"{name}.yaml")
    for level in (0.0, 6.0):
        frame = street(level, level).with_pixels(np.full((256, 384, 3), level, np.float32))
        exposure = camera.Exposure(1 / 60, iso, max(level, 1.0))
        electrons, dark_e = camera.sensitivity(frame, graph, exposure)
        until = "merge" if name == "automotive_hdr" else "adc"
        frames = [
            graph.run({"radiance": frame}, seed=seed, settings=exposure.settings, until=until)[until] for seed in (1, 2)
        ]
        gain = frames[0].provenance["system_gain_dn_e"]
        middle = [image.pixels[64:192, 96:288].astype(np.float64) for image in frames]
        found = np.sqrt(np.mean((middle[0] - middle[1]) ** 2) / 2) / gain / electrons
        expected = camera.noise_floor(np.array(level), electrons_per_cd_m2=electrons, dark_noise_e=dark_e)
        assert float(expected) == pytest.approx(found, rel=0.03)
