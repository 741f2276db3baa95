"""Kinds of medium against published optics, against the theory of Lorenz and Mie, and against each other."""

import importlib.util
import math

import numpy as np
import pytest

from docs.studies import media
from synfog_usd.base import tables
from synfog_usd.base.errors import ParameterError
from synfog_usd.fog import Fog, FogMedium, drops, kinds, mie
from synfog_usd.fog.drops import GammaSizes, extinction, rain_sizes
from synfog_usd.fog.grid import DensityGrid
from synfog_usd.fog.phase import HenyeyGreenstein

needs_mie = pytest.mark.skipif(importlib.util.find_spec("miepython") is None, reason="needs miepython")
OTHER = [name for name in kinds.KINDS if name != kinds.FOG]
OPAC_FOG = GammaSizes(3.04e-4 * 500.0**4 * 5e8, 4.0, 0.0562 * 500.0**1.77, 1.77)
"""1 droplet a cm^3: Hess, Koepke and Schult (1998), component FOGR."""


@needs_mie
@pytest.mark.parametrize(
    ("sizes", "nm", "index", "radii_um", "per_km"),
    [
        (GammaSizes.of_radii(100.0, 6.0, 1.0, 4.0), 450, 1.34, (0.05, 40.0), 16.33),
        (GammaSizes.of_radii(100.0, 6.0, 1.0, 4.0), 700, 1.33, (0.05, 40.0), 16.73),
        (GammaSizes.of_radii(100.0, 1.0, 0.5, 0.05), 450, 1.34, (0.005, 20.0), 0.1056),
        (GammaSizes.of_radii(100.0, 1.0, 0.5, 0.05), 700, 1.33, (0.005, 20.0), 0.1055),
        (OPAC_FOG, 400, 1.339, (0.02, 50.0), 0.5570),
        (OPAC_FOG, 550, 1.333, (0.02, 50.0), 0.5620),
        (OPAC_FOG, 700, 1.331, (0.02, 50.0), 0.5650),
        (OPAC_FOG, 1000, 1.327 - 2.89e-6j, (0.02, 50.0), 0.5744),
        (OPAC_FOG, 1500, 1.321 - 2e-4j, (0.02, 50.0), 0.5821),
    ],
    ids=[
        "cloud C1 at 450 nm, Deirmendjian (1969)",
        "cloud C1 at 700 nm",
        "haze M at 450 nm, Deirmendjian (1969)",
        "haze M at 700 nm",
        *(f"fog at {nm} nm, OPAC" for nm in (400, 550, 700, 1000, 1500)),
    ],
)
def test_droplets_stop_light_as_published(sizes, nm, index, radii_um, per_km):
    """Within 2 % of the tables named."""
    assert 1e3 * mie.optics(sizes, index, nm, radii_um).extinction_per_m == pytest.approx(per_km, rel=0.02)


@needs_mie
@pytest.mark.parametrize(
    ("sizes", "radii_um", "water_g_m3", "by_nm"),
    [
        (
            GammaSizes.of_radii(20.0, 3.0, 1.0, 10.0),
            (0.05, 100.0),
            1.295e-2,
            {550.0: (1.0, 0.8717), 694.3: (1.00576, 0.8703), 1060.0: (1.01747, 0.8652)},
        ),
        (
            media.SPHERES["mist"].sizes,
            media.SPHERES["mist"].radii_um,
            1.804e-3,
            {550.0: (1.0, 0.8286), 694.3: (1.00937, 0.8224), 1060.0: (1.05177, 0.7883), 1536.0: (1.12519, 0.7763)},
        ),
    ],
    ids=["heavy advection fog", "mist: moderate radiation fog"],
)
def test_fog_is_that_of_shettle_and_fenn(sizes, radii_um, water_g_m3, by_nm):
    """Within 2 % of their fogs of 1979 as LOWTRAN 7 has them, `FG1` and `FG2` of its block data EXTDTA: the water in
    fog of 1 per km, and by wavelength the extinction over that at 550 nm and the mean cosine.
    """
    optics = {nm: mie.optics(sizes, mie.index("water", nm), nm, radii_um) for nm in by_nm}
    per_km = 1e3 * optics[550.0].extinction_per_m
    assert drops.water(sizes) / per_km == pytest.approx(water_g_m3, rel=0.02)
    ours = {nm: (1e3 * row.extinction_per_m / per_km, row.g) for nm, row in optics.items()}
    np.testing.assert_allclose(list(ours.values()), list(by_nm.values()), rtol=0.02)


MITR = {
    400: (5.650e-3, 0.6797, 0.850), 450: (5.720e-3, 0.7551, 0.814), 500: (5.782e-3, 0.7814, 0.799),
    550: (5.853e-3, 0.8370, 0.775), 600: (5.910e-3, 0.8690, 0.760), 700: (6.040e-3, 0.8934, 0.742),
    800: (6.158e-3, 0.9048, 0.731), 1000: (6.373e-3, 0.9213, 0.714), 1500: (6.701e-3, 0.9248, 0.697),
}  # fmt: skip
"""Wavelength [nm] -> extinction [1/km] of 1 grain a cm^3, albedo, mean cosine: OPAC's `mitr00`, which NicheMapR has."""


@pytest.mark.parametrize(("nm", "published"), MITR.items())
def test_dust_is_that_of_opac(nm, published):
    """Mineral transported, Hess, Koepke and Schult (1998), within 2 %; the mean cosine at 550 nm, where it is drawn."""
    table, dust = tables.table("media"), kinds.medium_of("dust", mor_m=100.0)
    ours = *(np.interp(nm, table["wavelength_nm"], table[f"dust_{name}"]) for name in ("per_km", "albedo")), dust.g
    np.testing.assert_allclose(ours[: 3 if nm == 550 else 2], published[: 3 if nm == 550 else 2], rtol=0.02)


def test_smoke_and_fog_are_those_of_opac():
    """Within 2 %: what 1 particle a cm^3 of SOOT absorbs, its albedo and mean cosine at 550 nm, and the mean cosine of
    FOGR, which fog has by itself: Hess, Koepke and Schult (1998).
    """
    table, nm = tables.table("media"), [400, 450, 500, 550, 800]
    absorbed = table["smoke_per_km"] * (1.0 - table["smoke_albedo"])
    ours = np.exp(np.interp(nm, table["wavelength_nm"], np.log(absorbed)))
    np.testing.assert_allclose(ours, [6.311e-7, 5.564e-7, 4.943e-7, 4.383e-7, 2.828e-7], rtol=0.02)
    smoke, fog = (kinds.medium_of(kind, mor_m=100.0) for kind in ("smoke", "fog"))
    assert (smoke.albedo, smoke.g, fog.g) == pytest.approx((0.209, 0.337, 0.866), rel=0.02)


@needs_mie
@pytest.mark.parametrize("kind", media.SPHERES)
@pytest.mark.parametrize("nm", [400, 550, 1000])
def test_the_table_is_what_the_theory_gives(kind, nm):
    """Extinction, albedo and mean cosine of the shipped rows; `python -m docs.studies.media` writes them again."""
    spheres, table = media.SPHERES[kind], tables.table("media")
    optics = mie.optics(spheres.sizes, spheres.index_at(nm), nm, spheres.radii_um)
    row = list(table["wavelength_nm"]).index(nm)
    assert table[f"{kind}_per_km"][row] == pytest.approx(1e3 * optics.extinction_per_m, rel=1e-4)
    assert table[f"{kind}_albedo"][row] == pytest.approx(optics.albedo, abs=1e-5)
    if nm == 550:
        assert kinds.medium_of(kind, mor_m=100.0).g == pytest.approx(optics.g, rel=2e-3)


@needs_mie
@pytest.mark.slow
def test_sizes_of_another_medium_are_summed_as_its_table_is():
    """Spray's own sizes by their name: extinction and albedo between the rows within 0.5 %, the mean cosine 0.2 %."""
    own, summed = (
        kinds.medium_of("spray", mor_m=80.0, sizes=sizes) for sizes in (None, drops.sizes_of("strong-spray", "spray"))
    )
    nm = np.array([400.0, 464.0, 549.0, 611.0, 750.0, 900.0])
    np.testing.assert_allclose(summed.extinction_at(nm), own.extinction_at(nm), rtol=5e-3)
    np.testing.assert_allclose(summed.albedo_at(nm), own.albedo_at(nm), rtol=5e-3)
    assert (summed.sigma_t_per_m, summed.g) == (pytest.approx(own.sigma_t_per_m), pytest.approx(own.g, rel=2e-3))
    counted = kinds.medium_of("fog", sizes=drops.sizes_of("strong-spray", "mist"))
    assert 1000.0 * counted.sigma_t_per_m == pytest.approx(16.5, rel=0.02)  # cloud C1, between its two above


@needs_mie
def test_drops_of_rain_are_rays_of_large_spheres():
    """With its diffraction, half of all, straight on, a drop's mean cosine is a sphere's of size parameter 2e4."""
    _, _, g = mie.efficiencies(1.333, 2e4)
    assert (1.0 + kinds.medium_of("rain", rate_mm_h=10.0).g) / 2.0 == pytest.approx(g, rel=2e-3)


def test_rain_has_its_bows():
    """Descartes' angles for n = 1.333: 138 and 129 degrees from straight on, and it is darker between them."""
    phase = kinds.medium_of("rain", rate_mm_h=10.0).phase_function
    angles = np.arange(120.0, 150.0, 0.1)
    values = phase.value(np.cos(np.radians(angles)))
    assert angles[values.argmax()] == pytest.approx(138.2, abs=0.5)
    second = angles < 133.0
    assert angles[second][values[second].argmax()] == pytest.approx(129.0, abs=0.8)
    assert phase.value(math.cos(math.radians(134.0))) < 0.3 * values.max()


@pytest.mark.parametrize("kind", OTHER)
def test_a_phase_function_sends_all_somewhere(kind):
    """Its integral over all directions is 1, to 0.1 %, by Gauss and Legendre's rule between the rows."""
    asked = {"rate_mm_h": 5.0} if kinds.KINDS[kind].rated else {"mor_m": 100.0}
    phase = kinds.medium_of(kind, **asked).phase_function
    assert phase.moments(1)[0] == pytest.approx(1.0, abs=1e-3)
    assert (phase.table()[1] >= 0.0).all()


@pytest.mark.parametrize("nm", [450.0, 550.0, 650.0])
def test_media_in_one_place_add_up(nm):
    """Extinction and scattering by wavelength are sums, of twelve; so is the phase function times the scattering at
    550 nm.
    """
    dust, rain = kinds.medium_of("dust", mor_m=300.0), kinds.medium_of("rain", rate_mm_h=25.0)
    media_there = [dust, FogMedium(0.01, g=0.8), *[rain] * 10]
    both = kinds.joined(media_there)
    at = [medium.sigma_t_per_m * medium.extinction_at(nm) for medium in media_there]
    assert both.sigma_t_per_m * both.extinction_at(nm) == pytest.approx(sum(at), rel=1e-4)
    scattered = sum(t * medium.albedo_at(nm) for t, medium in zip(at, media_there, strict=True))
    assert both.sigma_t_per_m * both.extinction_at(nm) * both.albedo_at(nm) == pytest.approx(scattered, rel=1e-4)
    cosines = np.cos(np.radians([0.5, 10.0, 60.0, 138.0, 175.0]))
    sent = sum(m.sigma_t_per_m * m.albedo * m.phase_function.value(cosines) for m in media_there)
    ours = both.sigma_t_per_m * both.albedo * both.phase_function.value(cosines)
    np.testing.assert_allclose(ours, sent, rtol=1e-4)


def test_a_part_of_fog_scatters_less_than_it_stops():
    """Albedo of a mixture: smoke takes light away from fog."""
    both = Fog(100.0, also=(Fog(100.0, kind="smoke"),)).over(FogMedium(0.1))
    assert both.albedo == pytest.approx((1.0 + kinds.medium_of("smoke", mor_m=1.0).albedo) / 2.0)
    assert both.visibility_m == pytest.approx(50.0)
    assert isinstance(Fog(100.0).over(FogMedium(0.1)).phase_function, HenyeyGreenstein)
    # where forests burn, in midvisible light: Sayer et al., Atmos. Chem. Phys. 14, 11493 (2014)
    assert 0.95 <= Fog.named("haze100+smoke1500").over(FogMedium(1.0)).albedo <= 0.97


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"kind": "rain", "rate_mm_h": 0.0}, "0.01 to 1000"),
        ({"kind": "snow", "rate_mm_h": -1.0}, "0.01 to 1000"),
        ({"kind": "rain", "rate_mm_h": 1e9}, "0.01 to 1000"),
        ({"kind": "rian", "rate_mm_h": 1.0}, "Did you mean 'rain'"),
        ({"kind": "dust", "rate_mm_h": 1.0}, "a visibility"),
        ({"kind": "dust"}, "one of them"),
    ],
)
def test_what_no_medium_is_like_is_refused(asked, words):
    with pytest.raises(ParameterError, match=words):
        kinds.medium_of(**asked)


def test_media_of_one_grid_are_one():
    """Rain over a stage's patchy fog is patchy as that is; media that thin with different heights are refused."""
    with pytest.raises(ParameterError, match="one scale height"):
        kinds.joined([FogMedium(0.1), FogMedium(0.1, profile="exponential")])
    grid = DensityGrid(np.linspace(0.0, 1.0, 8, dtype=np.float32).reshape(2, 2, 2))
    both = Fog(kind="rain", rate_mm_h=10.0, also=(Fog(100.0),)).over(FogMedium(0.1, profile="grid", grid=grid))
    assert both.grid is grid and both.sigma_t_per_m > 0.03


@pytest.mark.parametrize(
    ("number", "alpha", "power", "mode_um"),
    [
        pytest.param(20, 3, 1, 10, id="strong advection fog"),
        pytest.param(20, 3, 1, 8, id="moderate advection fog"),
        pytest.param(100, 6, 1, 4, id="strong spray"),
        pytest.param(100, 6, 1, 2, id="moderate spray"),
        pytest.param(100, 1, 0.5, 0.05, id="haze at the coast"),
        pytest.param(100, 2, 0.5, 0.07, id="haze of a continent"),
        pytest.param(20, 2, 0.5, 1, id="Chu and Hogg"),
    ],
)
def test_sizes_are_those_of_rasshofer(number, alpha, power, mode_um):
    """Rasshofer, Spies and Spies (2011), eq. 9 and table 1: their number by radius, halved for one by diameter."""
    b = alpha / power / mode_um**power
    radii = np.array([0.3, 1.0, 3.0]) * mode_um
    by_radius = power * number * b ** ((alpha + 1) / power) / math.gamma((alpha + 1) / power) * radii**alpha
    by_radius *= np.exp(-b * radii**power)  # 1/(cm^3 um)
    ours = GammaSizes.of_radii(number, alpha, power, mode_um).density(2e-3 * radii)
    np.testing.assert_allclose(ours, by_radius * 1e9 / 2.0, rtol=1e-9)


@needs_mie
@pytest.mark.parametrize(
    ("name", "per_m"),
    [
        ("chu-hogg-fog", 3.2664e-3),
        ("heavy-advection-fog", 5.8114e-2),
        ("moderate-advection-fog", 3.7438e-2),
        ("strong-spray", 3.4066e-2),
        ("moderate-spray", 8.9588e-3),
        ("continental-haze", 6.3243e-5),
        ("coastal-haze", 2.0042e-4),
    ],
)
def test_lisa_has_twice_the_droplets(name, per_m):
    """Alphas of LISA (Kilic et al. 2021) at 905 nm, n = 1.328, by its formula and the program that it uses, PyMieScatt
    1.8.1: it takes densities by radius as those by diameter, so they are twice ours, within 1 %.

    Its coastal haze is here of 0.05 um; the 0.05e-3 of its code stops no light.
    """
    sizes = drops.sizes_of(name, "fog")
    ours = mie.optics(sizes, 1.328, 905.0, mie.radii_of(sizes)).extinction_per_m
    assert 2.0 * ours == pytest.approx(per_m, rel=0.01)


@needs_mie
@pytest.mark.parametrize(("rate", "per_m"), [(1.0, 3.6702e-4), (10.0, 1.56295e-3), (30.0, 3.1207e-3)])
def test_rain_is_lisas_but_for_diffraction_of_small_drops(rate, per_m):
    """LISA's alpha of rain likewise: Marshall and Palmer's drops by Lorenz and Mie, 1 % above twice their sections."""
    assert extinction("rain", rain_sizes(rate)) == pytest.approx(per_m, rel=0.01)
