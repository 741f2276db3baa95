"""Weather that a recipe draws, against published formulas and against what the stage says in each of its fogs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdShade

import synfog_usd as sf
from synfog_usd.base.errors import RecipeError
from synfog_usd.dataset.wet import rained_on
from synfog_usd.fog import FogVolume
from synfog_usd.fog.drops import GammaSizes
from synfog_usd.fog.kinds import medium_of
from synfog_usd.scene import Instance, testing
from synfog_usd.stage import open_stage, select
from synfog_usd.translate import translate
from synfog_usd.world.compose import draw, load
from synfog_usd.world.roads.asphalt import Asphalt
from synfog_usd.world.roads.spray import clouds, extinction, water_kg_m3
from synfog_usd.world.roads.water import film_depth_mm, ripples, standing


def test_water_is_as_deep_as_the_road_research_laboratory_found():
    """Gallaway's depth over the bottom of the texture against that of the RRL (Ross and Russam 1968), as SANRAL's
    drainage manual has it: 0.046 (l I)^0.5 / s^0.2 mm of m and mm/h.  They agree within a quarter.
    """
    for rate in (25.0, 50.0):
        british = 0.046 * (5.0 * rate) ** 0.5 * 0.025**-0.2
        assert film_depth_mm(rate, 5.0, 0.025, 0.5) + 0.5 == pytest.approx(british, rel=0.25)


def test_ripples_have_the_energy_of_published_rain():
    """A hundredth of Wischmeier and Smith's (1958) kinetic energy, 11.9 + 8.7 log10(I) J/m2 for each mm, that decays by
    4 nu k^2 a second; surface waves have rho g + T k^2 times their mean square height.  Within a quarter.
    """
    for rate in (5.0, 25.0):
        watts = 0.01 * (11.9 + 8.7 * np.log10(rate)) * rate / 3600.0
        height2 = watts / (4e-6 * 200.0**2) / (9810.0 + 0.0728 * 200.0**2)
        assert ripples(rate) == pytest.approx(200.0**2 * height2, rel=0.25)
        assert 1e-4 < height2**0.5 < 1e-3


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


def with_only(usd, *names):
    """The stage, of whose world nothing but these is drawn by a translation; its layers stay as they are."""
    usd.SetEditTarget(usd.GetSessionLayer())
    for prim in usd.GetPrimAtPath("/World").GetChildren():
        if prim.GetName() not in names and prim.IsA(UsdGeom.Imageable):
            UsdGeom.Imageable(prim).MakeInvisible()
    return usd


def test_rain_wets_the_roads_that_lie_in_it_and_are_dry(stage):
    """By its label a road gets as dark as asphalt under a film of water, 0.047 of 0.085, and shines; a wall stays, and
    a road beside the rain.  More water of another distribution is heavier rain.  A recipe's wet road is wet already.
    """
    surface = {"type": "preview_surface", "base_color": {"type": "rgb", "value": [0.085] * 3}, "roughness": 0.8}
    labels = {"Road": "road", "Wall": "building", "Beside": "parking"}
    names = {(f"shape_{n}",): Instance(n, f"/{name}", label) for n, (name, label) in enumerate(labels.items(), 1)}
    world = {f"mat_{n}": surface for n in (1, 2, 3)}
    for n, x in ((1, 0.0), (2, 0.0), (3, 40.0)):
        corners = np.array([[x, 0.0, -2.0], [x + 9.0, 0.0, -2.0], [x, 9.0, -2.0]])
        world[f"shape_{n}"] = {"type": "mesh", "positions": corners, "bsdf": {"type": "ref", "id": f"mat_{n}"}}

    def wet(medium):
        rain = FogVolume("/Rain", testing.box(20.0, (0.0, 0.0, 19.0)), medium)
        scene = testing.scene(world, [rain])
        scene = replace(scene, instances=tuple(names.values()), instance_of={key: i.id for key, i in names.items()})
        return rained_on(scene)

    rained = wet(medium_of("rain", rate_mm_h=10.0))
    assert [rained.world[f"mat_{n}"] is surface for n in (1, 2, 3)] == [False, True, True]
    look = rained.world["mat_1"]
    assert look["base_color"]["value"][0] == pytest.approx(0.047, abs=0.002)
    assert look["roughness"] < 0.6 < 0.8 and look["clearcoat"] > 0.2
    assert rained_on(rained) is rained and rained.notes[-1].path == "/Rain"
    heavy = wet(medium_of("rain", sizes=GammaSizes(16000.0, 0.0, 4.1 * 10.0**-0.21))).world["mat_1"]
    assert look["clearcoat"] < heavy["clearcoat"]
    dry = wet(medium_of("rain", mor_m=2000.0))
    assert not dry.notes and dry.world["mat_1"] is surface
    usd = with_only(Usd.Stage.Open(stage[1].GetRootLayer()), "Fog", "Road")
    select(usd, fog="rain10", lighting="sky")
    drawn = translate(usd)
    assert rained_on(drawn) is drawn


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


def test_spray_is_what_the_published_shares_say_and_needs_water_and_speed():
    """Flintsch's own example: a lorry's twin tyre of 0.56 m at 62 mph (27.8 m/s) in 1 mm of water.  Standing, and on a
    dry road, there is none.
    """
    taken = 27.778 * 0.56 * 997.0 * np.array([0.75e-4, 0.25e-3, 0.3375e-3, 0.3375e-3])  # film, grooves, bow, sides
    shares = np.array([-2.69e-5, 1.16e-5, 2.67e-5, 1.65e-5]) * 62.137 + [2.43e-3, -5.25e-5, -4.71e-4, -3.99e-4]
    assert float(water_kg_m3(27.778, 1e-3, 0.56)) == pytest.approx(float(taken @ shares), rel=1e-3)
    drop_m = 0.8e-3 * 6.0 / 27.778
    wanted = 1.5 * float(taken @ shares) / (997.0 * drop_m)  # of balls: 3 V / 2 D
    assert float(extinction(27.778, 1e-3, 0.56)) == pytest.approx(wanted, rel=1e-3)
    np.testing.assert_array_equal(extinction([0.0, 4.0, 30.0], 0.0, 0.2), 0.0)
    np.testing.assert_array_equal(extinction([0.0, 4.0], 1e-3, 0.2), 0.0)


CLIP = ["traffic.per_hour=1600", "time.wind_m_s=2", "time.wind_deg=180"]


@pytest.fixture(scope="module")
def motorway(tmp_path_factory):
    path = tmp_path_factory.mktemp("spray") / "street.usda"
    fogs = "300,rain10,rain25,snow2,rain10+mor300"
    spec = sf.compose("motorway", path, seed=4, fog=fogs, seconds=3.0, fps=4.0, change=CLIP)
    return spec, path


def test_clouds_of_spray_go_with_vehicles_and_never_meet(motorway):
    """At the ends of a clip: its fogs are nested or apart, each cloud is about what is behind its vehicle, and heavier
    rain makes it denser; snow has none.  In fog of 300 m it has that too, on the mean over the height in which it falls
    by e.  The wind carries one field of patches, of the same mean.
    """
    spec, path = motorway
    usd = with_only(open_stage(path), "Fog")
    field = [translate(usd, frame=frame, fog=sf.Fog(150, outer_scale_m=8.0)).fog[0] for frame in (0.0, 11.0)]
    way = np.subtract(field[1].origin_m, field[0].origin_m)
    np.testing.assert_allclose(way, (0.0, -2.0 * 11.0 / 4.0, 0.0), atol=1e-3)  # 2 m/s to the south
    np.testing.assert_allclose(field[1].wind_m_s, (0.0, -2.0, 0.0), atol=1e-6)
    assert field[0].medium.grid is field[1].medium.grid and field[1].medium.visibility_m == pytest.approx(150.0)
    dense = {}
    for fog in spec.fog:
        select(usd, fog=fog)
        prims = [prim for prim in usd.GetPrimAtPath("/World/Fog").GetChildren() if prim.GetName().startswith("Spray")]
        dense[fog] = np.array([prim.GetAttribute("synfog:fog:sigma_t").Get(0.0) for prim in prims])
    assert {fog for fog, values in dense.items() if len(values)} == {"rain10", "rain25", "rain10-mor300"}
    assert np.all(dense["rain25"] > 1.2 * dense["rain10"])
    select(usd, fog="rain10", lighting="sky")
    behind = clouds(spec.placed, spec.view, spec.falls["rain10"])
    for frame in (0.0, 11.0):
        scene = translate(usd, frame=frame)  # fogs that cross are an error
        fogs, origin = scene.fog, np.asarray(scene.origin_m)
        balls = [volume for volume in fogs if "Spray" in volume.path]
        assert len(balls) == len(behind) > 2 or frame > 0.0
        for ball in balls:
            cloud = behind[int(ball.path[-2:]) - 1]
            p = spec.placed[cloud.vehicle]
            vehicle = UsdGeom.Xformable(usd.GetPrimAtPath(f"/World/{p.group}/{p.name}"))
            place = np.array(vehicle.ComputeLocalToWorldTransform(frame))[3, :3]
            apart = np.linalg.norm(ball.boundary.to_world[:3, 3] + origin - place)
            assert apart == pytest.approx(cloud.behind_m, abs=1e-3)
            assert fogs[ball.parent].path == "/World/Fog/Global"
    select(usd, fog="rain10-mor300")
    ball = next(volume for volume in translate(usd).fog if "Spray" in volume.path)
    up = np.linspace(0.0, ball.medium.scale_height_m, 1001) + ball.boundary.to_world[2, 3]
    beside = ball.medium.sigma_t(up).mean() - dense["rain10-mor300"][0] * (1.0 - np.exp(-1.0)) / np.e
    assert beside == pytest.approx(-np.log(0.05) / 300.0, rel=0.01)
