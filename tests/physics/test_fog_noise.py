"""Noise against fog density after the contrast of every region has been stretched, as in figure 2 of the SynFog paper.

A brick wall 100 m away under an overcast sky, by the phone, exposed once for clear air;
eight frames in each fog, which differ in temporal noise alone.
"""

from __future__ import annotations

import itertools
import math

import pytest

from docs.studies.camera import FOGS_M, WALL_M, frames_in_fog, noise, stretched, wall_in_fog
from synfog_usd import camera
from synfog_usd.base import resources
from synfog_usd.camera.profiles import load_sensor

pytestmark = pytest.mark.physics


@pytest.fixture(scope="module")
def seen():
    """Visibility -> (8, H, W, 3) pictures of 8 bits."""
    return {visibility_m: frames_in_fog(visibility_m, count=8) for visibility_m in FOGS_M}


@pytest.fixture(scope="module")
def brought(seen):
    """The same with their contrast stretched, by the map of the scene without noise."""
    return {
        visibility_m: stretched(frames, frames_in_fog(visibility_m, count=1, quiet=True)[0])
        for visibility_m, frames in seen.items()
    }


def resolved(pairs) -> float:
    """Standard error of the mean over independent pairs of frames."""
    return float(pairs.std(ddof=1) / math.sqrt(pairs.size))


def test_noise_grows_with_the_fog_once_contrast_is_stretched(brought):
    """From clear to MOR 600, 300 and 150 m it grows by more than half each time; a growth of 2 % would be seen."""
    pairs = [noise(frames) for frames in brought.values()]
    print(
        "\nstretched:",
        ", ".join(
            f"MOR {visibility_m:g} m: {255 * found.mean():.1f}"
            for visibility_m, found in zip(brought, pairs, strict=True)
        ),
        "of 255",
    )
    for thin, thick in itertools.pairwise(pairs):
        error = math.hypot(resolved(thin) / thin.mean(), resolved(thick) / thick.mean())
        assert 5 * error < 0.02, f"cannot see 2 %: error {error:.2%}"
        assert thick.mean() > 1.5 * thin.mean()


def test_it_grows_as_photons_and_transmittance_say(brought):
    """sqrt(electrons + dark noise^2) / transmittance, within 20 %: tone curve and gamma stretch noise and contrast
    alike, where they are straight.
    """
    graph = camera.load_graph(resources.folder("pipeline") / "phone.yaml")
    settings = camera.meter(wall_in_fog(math.inf), graph).settings
    chip = load_sensor("imx363")
    dark_e = math.hypot(chip.read_noise_e, chip.adc_noise_dn / chip.gain_dn_e)

    def expected(visibility_m):
        electrons = graph.run({"radiance": wall_in_fog(visibility_m)}, seed=0, settings=settings, until="expose")[
            "expose"
        ].pixels
        return math.sqrt(electrons.mean() + dark_e**2) * 20.0 ** (WALL_M / visibility_m)

    clear = noise(brought[math.inf]).mean() / expected(math.inf)
    for visibility_m in FOGS_M[1:]:
        ratio = noise(brought[visibility_m]).mean() / expected(visibility_m) / clear
        print(f"\nMOR {visibility_m:g} m: {ratio:.3f} of what is expected")
        assert abs(ratio - 1) < 0.2
