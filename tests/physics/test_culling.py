"""What fog hides may be missing: the picture differs by less than a tenth of the sensor's noise."""

import pytest

from synfog_usd import resources
from synfog_usd.render import backend
from synfog_usd.study.pages.culling import foggy, saving
from synfog_usd.world.compose import compose

pytestmark = pytest.mark.physics

RESOLVES = 0.06
"""RMS of the noise that may be left over squares of 4 pixels [sigma]; a few squares have six times that, since paths
that meet what is missing are few.
"""


@pytest.fixture(scope="module", autouse=True)
def started():
    backend.start("auto")


def stage_of(name, folder):
    shipped = resources.folder("stages") / f"{name}.usda"
    if shipped.exists():
        return shipped
    compose(resources.folder("stages") / "recipes" / f"{name}.yaml", folder / f"{name}.usda", seed=3)
    return folder / f"{name}.usda"


@pytest.mark.parametrize(
    ("name", "lighting", "visibility_m", "least"),
    [
        ("crossroads", "sky", 50.0, 0.5),
        ("motorway", "sky", 50.0, 0.5),
        ("motorway", "sky", 150.0, 0.15),
        ("motorway", "active", 50.0, 0.4),
    ],
)
def test_a_reduced_scene_looks_like_the_whole_one(name, lighting, visibility_m, least, tmp_path):
    """Squares of 4 pixels differ by less than 0.1 sigma and the noise that is left, and at least a share of the
    triangles is saved.
    """
    row = saving(name, foggy(stage_of(name, tmp_path), lighting, visibility_m))
    assert row is not None and row.triangles > least * row.of_triangles
    assert row.noise < RESOLVES
    assert row.error**2 - row.noise**2 < 0.05**2
    assert row.error_max < 0.1 + row.noise_max


def test_leaving_all_of_it_out_is_seen():
    """What T alone would allow: the same parts left out instead of simplified change the fog by more than 0.1 sigma,
    RMS, noise taken off.
    """
    row = saving("crossroads", foggy(stage_of("crossroads", None), "sky", 50.0), leave_out=True)
    assert row is not None
    assert row.error**2 - row.noise**2 > 0.1**2  # measured 0.165^2
