"""Weather that a recipe draws, against published formulas and against what the stage says in each of its fogs."""

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdShade

import synfog_usd as sf
from synfog_usd.base.errors import RecipeError
from synfog_usd.stage import select
from synfog_usd.world.compose import draw, load
from synfog_usd.world.roads.asphalt import Asphalt
from synfog_usd.world.roads.water import film_depth_mm, standing


def test_water_is_as_deep_as_the_road_research_laboratory_found():
    """Gallaway's depth over the bottom of the texture against that of the RRL (Ross and Russam 1968), as SANRAL's
    drainage manual has it: 0.046 (l I)^0.5 / s^0.2 mm of m and mm/h.  They agree within a quarter.
    """
    for rate in (25.0, 50.0):
        british = 0.046 * (5.0 * rate) ** 0.5 * 0.025**-0.2
        assert film_depth_mm(rate, 5.0, 0.025, 0.5) + 0.5 == pytest.approx(british, rel=0.25)


def test_standing_water_grows_with_the_rate_and_never_leaves_what_is_paved():
    """More rain covers more of the same hollows, in ruts and at kerbs, and a new road has less than an old one."""
    road = draw(load(Path("residential")), seed=3).road

    def area(kind, rate):
        parts = standing(road, Asphalt(kind), rate, seed=5)
        corners = [part.points[part.faces] for part in parts]
        return sum(0.5 * np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0])[:, 2].sum() for c in corners)

    drizzle, rain, downpour = (area("worn", rate) for rate in (0.5, 10.0, 50.0))
    assert 0.0 <= drizzle < 0.2 * rain < rain < downpour
    assert area("new", 10.0) < rain < area("old", 10.0)
    paved = 460.0 * 8.0
    assert 0.01 < rain / paved < 0.15


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    path = tmp_path_factory.mktemp("weather") / "street.usda"
    spec = sf.compose("residential", path, seed=3, fog="300,rain10,haze2000", change=["road.wet=dry"])
    return spec, Usd.Stage.Open(str(path))


def look(stage, fog, name):
    """Base, coat and water of a material of the road in a fog."""
    select(stage, fog=fog)
    surface = UsdShade.Shader(stage.GetPrimAtPath(f"/World/Road/Materials/{name}/Surface"))
    colour = stage.GetPrimAtPath(f"/World/Road/Materials/{name}/Colour").GetAttribute("inputs:scale").Get()
    coat = surface.GetInput("clearcoat")
    return colour[0] if colour else 1.0, coat.Get() if coat else 0.0, bool(stage.GetPrimAtPath("/World/Road/Water"))


def test_the_road_is_wet_where_it_rains_and_there_alone(stage):
    """The variant of the rain darkens the asphalt to 0.55 of itself and coats it; other fogs have it dry."""
    _, usd = stage
    dry = look(usd, "mor300", "asphalt_lane")
    wet = look(usd, "rain10", "asphalt_lane")
    assert dry[1:] == (0.0, False)
    assert wet[0] / dry[0] == pytest.approx(0.55, abs=0.05)
    assert wet[1] > 0.2
    assert wet[2]
    assert look(usd, "haze2000", "asphalt_lane") == dry


def test_rain_falls_from_an_overcast_sky_and_drivers_have_their_lamps_on(stage):
    """The stage opens dry, its rain has its rate, its sky is overcast, and its traffic glows by day."""
    spec, usd = stage
    assert spec.fog_selected == "mor300"
    assert spec.day.sky in ("rain", "overcast_noon", "stratus_winter", "storm_front")
    select(usd, fog="rain10", lighting="sky")
    fog = usd.GetPrimAtPath("/World/Fog/Global")
    assert fog.GetAttribute("synfog:medium:kind").Get() == "rain"
    assert fog.GetAttribute("synfog:medium:rate").Get() == 10.0
    driven = [p for p in spec.placed if p.group == "Vehicles" and p.lit]
    assert driven
    lamps = {
        usd.GetPrimAtPath(f"/World/Vehicles/{p.name}").GetVariantSet("lamps").GetVariantSelection() for p in driven
    }
    assert lamps == {"glow"}


@pytest.mark.parametrize("fog", ["hail3", "rain0", "mor300_g0.5", "rain99999"])
def test_weather_that_does_not_exist_is_refused_with_its_place(fog, tmp_path):
    """One line that says what it takes."""
    with pytest.raises(RecipeError, match=r"--fog:1:\d+: "):
        sf.compose("residential", tmp_path / "s.usda", fog=fog)
