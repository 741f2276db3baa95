"""The study of the scattering model on shots whose light is written down, so that the answer is known."""

from __future__ import annotations

import json

import numpy as np
import pytest
from colour import cctf_decoding, cctf_encoding

from docs.studies.scattering_model import DEPTHS, crossing, models, study
from synfog_usd.base import seeds
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.writers import write_exr

AIRLIGHT = np.array([90.0, 100.0, 110.0])
HEIGHT, WIDTH = 60, 80
ELECTRONS, DARK_E = 50.0, 3.0
WHITE = 200.0
MULTIPLE = np.broadcast_to(np.linspace(1.0, 9.0, 60)[:, None, None], (60, 80, 3))
"""What the fog scattered more than once, in the made shots."""


def frames(*, glow: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Clear frame, transmittance and foggy frame of the model itself, and beyond optical depth 1 a glow besides."""
    rng = seeds.stream(3, "study")
    clear = rng.uniform(5.0, 60.0, (HEIGHT, WIDTH, 3))
    clear[10, 10] = 1e5
    depth = np.geomspace(0.05, 9.0, HEIGHT)[:, None] * np.ones(WIDTH)
    t = np.exp(-depth)
    foggy = clear * t[..., None] + AIRLIGHT * (1.0 - t[..., None])
    return clear, t, foggy + glow * (depth > 1.0)[..., None]


def bake(folder, *, glow: float = 0.0) -> None:
    clear, t, foggy = frames(glow=glow)
    for fog, pixels in (("clear", clear), ("mor150", foggy)):
        image = Image(pixels.astype(np.float32), ("R", "G", "B"), Quantity.RADIANCE, provenance={"fov_x_deg": 60.0})
        write_exr(folder / "active" / fog / "radiance.exr", image)
        layers = [
            Image(t.astype(np.float32)[..., None], ("transmittance.Y",), Quantity.DATA),
            Image(np.full((HEIGHT, WIDTH, 1), 0.01, np.float32), ("error.Y",), Quantity.DATA),
            Image(MULTIPLE.astype(np.float32), tuple(f"airlight_multiple.{c}" for c in "RGB"), Quantity.RADIANCE),
        ]
        write_exr(folder / "active" / fog / "layers.exr", layers)
    sensor = {"electrons_per_cd_m2": ELECTRONS, "dark_noise_e": DARK_E}
    shots = [
        {"lighting": "active", "fog": fog, "folder": f"active/{fog}", "mor_m": mor_m, "target": {"sensor": sensor}}
        for fog, mor_m in (("clear", None), ("mor150", 150.0))
    ]
    (folder / "bake.json").write_text(json.dumps({"shots": shots}), encoding="utf-8")


def by_model(foggy, clear, t):
    return models(foggy, clear, t, white=WHITE, noise=np.sqrt(foggy.mean(axis=2)))


def test_light_that_is_the_models_has_no_error():
    clear, t, foggy = frames()
    found = by_model(foggy, clear, t)
    np.testing.assert_allclose(found["fitted"], foggy, rtol=1e-9)
    np.testing.assert_allclose(found["horizon"], foggy, rtol=0.02)
    np.testing.assert_allclose(found["dark_channel"], foggy, rtol=1e-3)
    near = by_model(
        foggy[:30], clear[:30], t[:30]
    )  # nothing of optical depth 1 is in view: no pixel shows the airlight
    assert "horizon" not in near and np.abs(near["dark_channel"] - foggy[:30]).max() > 1.0


def test_codes_that_were_mixed_are_found_by_the_model_that_mixes_codes():
    clear, t, _ = frames()
    clear = np.minimum(clear, WHITE)
    code = cctf_encoding(clear / WHITE, function="sRGB") * t[..., None] + 0.6 * (1.0 - t[..., None])
    truth = WHITE * cctf_decoding(code, function="sRGB")
    found = by_model(truth, clear, t)
    np.testing.assert_allclose(found["srgb"], truth, rtol=1e-4)
    assert np.median(np.abs(found["fitted"] / truth - 1.0)) > 0.02


def test_the_noise_is_the_sensors_and_the_place_of_the_error_is_found(tmp_path):
    """A glow of 20 nits beyond optical depth 1: sigma there is sqrt(50 L + 9) / 50, about 1.5 nits, and what the best
    airlight cannot make up for shows in the bins beyond 1 and before it; without the glow nothing shows anywhere.
    """
    bake(tmp_path / "plain")
    plain = study(tmp_path / "plain")
    assert len(plain.shots) == 1 and crossing(plain, "fitted", "active", "depth") == "nowhere"
    bake(tmp_path / "glow", glow=20.0)
    found = study(tmp_path / "glow")
    clear, t, foggy = frames(glow=20.0)
    y = np.array([0.2126729, 0.7151522, 0.0721750])
    noise = np.sqrt(foggy @ y * ELECTRONS + DARK_E**2) / ELECTRONS
    fitted = models(foggy, clear, t, white=WHITE, noise=noise)["fitted"]
    depth = -np.log(t)
    for place in range(len(DEPTHS) - 1):
        inside = (depth >= DEPTHS[place]) & (depth < DEPTHS[place + 1])
        units, single = (np.median((np.abs(miss @ y) / noise)[inside]) for miss in (fitted - foggy, MULTIPLE))
        assert found.over_noise("fitted", "active", "depth", place).value == pytest.approx(units, rel=1e-3), place
        assert found.over_noise("single", "active", "depth", place).value == pytest.approx(single, rel=1e-3), place
    assert found.rendering("active", "depth", 6).value == pytest.approx(0.01 / 1.5, rel=0.3)
