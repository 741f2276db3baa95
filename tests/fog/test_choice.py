"""Fog that is asked for: its name, and what it does to the fog of a stage."""

import dataclasses
import math
import re
from pathlib import Path

import numpy as np
import pytest

from synfog_usd.base.errors import ParameterError
from synfog_usd.base.numbers import fog_fault
from synfog_usd.dataset.plan import BakePlan, shots
from synfog_usd.fog import Fog, FogMedium
from synfog_usd.fog.patchy import patchy
from synfog_usd.fog.phase import Droplets

SAID = (
    Fog(math.inf),
    Fog(75.5, albedo=0.98, g=-0.3),
    Fog(40, phase="droplets", droplet_diameter_um=8.25),
    Fog(1e5, angstrom=1.3, profile="exponential", scale_height_m=30),
    Fog(kind="rain", rate_mm_h=0.5),
    Fog(80, kind="smoke", scale_height_m=10),
    Fog(kind="snow", rate_mm_h=2, also=(Fog(400, g=0.8), Fog(2000, kind="haze"))),
    Fog(150, outer_scale_m=8, seed=3, also=(Fog(kind="rain", rate_mm_h=5, outer_scale_m=8, seed=3),)),
    Fog(300, kind="dust", outer_scale_m=2.5, deviation=0.25),
)


@pytest.mark.parametrize("fog", SAID, ids=[fog.name for fog in SAID])
def test_a_name_says_all_of_a_fog(fog):
    """What a name was made of is read from it again; a bake's folder and manifest need no more."""
    assert Fog.named(fog.name) == fog and not set(fog.name) & set('\\/:*?"<>| ,')
    assert BakePlan(Path("street.usda"), Path("out"), fog=(fog.name,)).fog == (fog.name,)


@pytest.mark.parametrize(
    "name, why",
    [
        ("rain0", "a rate is 0.01 to 1000 mm/h, as in rain10"),
        ("rain-1", "a rate is 0.01 to 1000"),
        ("rain1e9", "a rate is 0.01 to 1000"),
        ("snow999999", "no snow is clear"),
        ("rain1e1", "written in digits"),
        ("rain300+", "between two media"),
        ("hail3", "'hail' is no medium; they are mor, haze"),
        ("fog150", "'fog' is no medium"),
        ("rain10+dense", "'dense' is no medium"),
        ("MOR150", "Did you mean 'mor'"),
        ("mor0", "above 0 m"),
        ("mor15O", "'15O' is no number"),
        ("rain", r"a rate \[mm/h\] behind it"),
        ("mor150_x3", "'x' is none of albedo, g"),
        ("mor150_patch", "'patch' has a value"),
    ],
)
def test_a_name_that_is_nearly_a_medium_s_says_why(name, why):
    """One line with what is wrong and what to write; a variant's name is nobody's fault."""
    with pytest.raises(ParameterError, match=rf"^--fog {re.escape(name)}: .*{why}.*the stage has clear") as refusal:
        shots(BakePlan(Path("street.usda"), Path("out"), fog=(name,)), {"fog": ["clear"]})
    assert "\n" not in str(refusal.value)
    assert not any(map(fog_fault, ("dense", "a b", "_x", "dense_2", "5", "rain2.5+mor400_g0.8")))


def test_patches_are_asked_for_by_name():
    """The field that a stage's outerScale, deviation and seed give; its mean has the visibility."""
    medium = Fog.named("mor150_patch8_deviation0.8_seed3").over(FogMedium(0.5, profile="exponential"))
    assert medium.grid is patchy(8.0, 0.8, seed=3) and medium.profile == "grid"
    assert medium.mean_sigma_t_per_m == pytest.approx(math.log(20.0) / 150.0, rel=1e-6)


def test_fog_goes_over_what_is_there_and_leaves_the_rest():
    """Koschmieder's extinction of the visibility; the albedo and the base height stay."""
    own = FogMedium(0.5, albedo=0.9, g=0.3, base_height_m=-2.0, contrast=0.02)
    plain, more = (
        Fog(100.0).over(own),
        Fog(100.0, scale_height_m=20.0, phase="droplets", droplet_diameter_um=10).over(own),
    )
    np.testing.assert_allclose(plain.sigma_t_per_m, math.log(20.0) / 100.0, rtol=1e-15)
    assert dataclasses.replace(plain, sigma_t_per_m=0.5, contrast=0.02) == own
    assert (more.albedo, more.base_height_m, more.profile, more.scale_height_m) == (0.9, -2.0, "exponential", 20.0)
    assert more.phase == Droplets(10.0)


@pytest.mark.parametrize(
    "said",
    [
        {"mor_m": -3},
        {"mor_m": "far"},
        {"mor_m": math.nan},
        {"mor_m": 150, "albedo": 2},
        {"mor_m": 150, "g": 1},
        {"mor_m": 150, "phase": "rayleigh"},
        {"mor_m": 150, "phase": "droplets"},
        {"mor_m": 150, "phase": "droplets", "droplet_diameter_um": 8, "g": 0.8},
        {},
        {"mor_m": 150, "kind": "fog"},
        {"mor_m": 150, "kind": "rain"},
        {"rate_mm_h": 10},
        {"kind": "rain", "rate_mm_h": 1e9},
        {"mor_m": 150, "kind": "dust", "g": 0.5},
        {"mor_m": 150, "also": (Fog(math.inf),)},
        {"mor_m": 150, "also": (Fog(100, scale_height_m=10),)},
        {"mor_m": 150, "also": (Fog(100, outer_scale_m=8),)},
        {"mor_m": 150, "outer_scale_m": 0},
        {"mor_m": 150, "outer_scale_m": 8, "scale_height_m": 10},
        {"mor_m": 150, "outer_scale_m": 8, "deviation": 3},
        {"mor_m": 150, "outer_scale_m": 8, "seed": 0.5},
        {"mor_m": 150, "deviation": 0.5},
    ],
    ids=str,
)
def test_what_no_fog_is_like_is_refused(said):
    with pytest.raises(ParameterError):
        Fog(**said)


def test_dust_over_a_stage_s_fog_keeps_its_height():
    """Where the fog is stays; what it is becomes the kind's, and then fog's again."""
    own = FogMedium(0.5, profile="exponential", base_height_m=-2.0, scale_height_m=7.0)
    dust = Fog(100.0, kind="dust").over(own)
    assert (dust.profile, dust.base_height_m, dust.scale_height_m) == ("exponential", -2.0, 7.0)
    assert dust.albedo < 0.9 and dust.colours is not None
    assert Fog(100.0, albedo=1.0).over(dust).colours is None
