"""Asphalts, wet and dry, works beside the road, company on the pavement, skies, rigs and render products."""

from __future__ import annotations

import functools
import itertools
import math
import re
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdRender

from synfog_usd.lab.study.pages import worlds
from synfog_usd.world import language, parameters
from synfog_usd.world.compose import compose, draw, load
from synfog_usd.world.lamps import lamp_of
from synfog_usd.world.materials import PALETTE
from synfog_usd.world.roads import asphalt, rules, surface, works
from synfog_usd.world.roads.lane_section import LaneSection
from synfog_usd.world.roads.network import Land, Road
from synfog_usd.world.roads.reference_line import ReferenceLine, bends
from synfog_usd.world.skies import skies
from synfog_usd.world.spec import Placement

ROOT = Path(__file__).resolve().parents[2]
RECIPES = ROOT / "stages" / "recipes"
TOWN = [("pavement", 2.6, 0), ("parking", 2.1, 0), ("lane", 3.2, -1), ("lane", 3.2, 1), ("pavement", 3.0, 0)]


@functools.cache
def drawn(name, seed, *changes):
    path = RECIPES / f"{name}.yaml"
    return draw(load(path, changes), seed=seed)


def street(hill=None):
    return Road(
        ReferenceLine(400.0, bends([(40.0, 150.0, 40.0)], length=400.0)), LaneSection.from_widths(TOWN), Land(hill=hill)
    )


# -- wet


def _fresnel(cosine, n1, n2):
    """Reflectance of unpolarised light by its angle in the first medium."""
    sine = (n1 / n2) ** 2 * (1 - cosine**2)
    inside = np.sqrt(np.clip(1 - sine, 0, None))
    s = ((n1 * cosine - n2 * inside) / (n1 * cosine + n2 * inside)) ** 2
    p = ((n2 * cosine - n1 * inside) / (n2 * cosine + n1 * inside)) ** 2
    return np.where(sine < 1, (s + p) / 2, 1.0)


@pytest.mark.parametrize("dry", [0.05, 0.09, 0.25, 0.56])
def test_a_wet_surface_is_as_dark_as_light_bounced_under_a_film_says(dry):
    """Bounce by bounce, with Fresnel's reflectance integrated over the hemisphere: within 0.5 %, the error of the fit
    that the code takes.
    """
    cosine = (np.arange(20_000) + 0.5) / 20_000
    turned_back = float(np.mean(2 * cosine * _fresnel(cosine, 1.333, 1.0)))
    light, left = 1.0 - ((1.333 - 1) / (1.333 + 1)) ** 2, 0.0
    for _ in range(60):
        light *= dry
        left += light * (1 - turned_back)
        light *= turned_back
    assert asphalt.wet_albedo(dry) == pytest.approx(left, rel=5e-3)
    assert asphalt.wet_albedo(dry, 1.0001) == pytest.approx(dry, rel=5e-3)  # a film of air changes nothing


def test_water_darkens_asphalt_more_than_paint_and_smooths_both():
    """About half of asphalt's albedo goes and less of the paint's; damp lies between; dry worn asphalt is what the
    crossing has.
    """
    dry, damp, wet = (asphalt.looks(asphalt.Asphalt("worn", name), {}) for name in asphalt.WETNESS)
    assert dry["asphalt_lane"] == PALETTE["asphalt_lane"] and dry["marking"] == PALETTE["marking"]
    assert 0.45 < wet["asphalt_lane"].colour[0] < 0.6 < wet["marking"].colour[0] < 0.8
    for name in ("asphalt_lane", "marking", "tar"):
        for key in ("roughness", "gloss_factor"):
            assert getattr(wet[name], key) < getattr(damp[name], key) < getattr(dry[name], key)
        assert wet[name].colour[0] < damp[name].colour[0] < dry[name].colour[0]


def test_four_asphalts_are_of_four_tones():
    """Mean albedo of the lanes, factor times that of the texture: no two within 8 %, new asphalt the darkest."""
    tones = {}
    for kind in asphalt.KINDS:
        name = asphalt.Asphalt(kind).lane
        tones[kind] = asphalt.looks(asphalt.Asphalt(kind), {})[name].colour[0] * asphalt.ALBEDO[name]
    ordered = sorted(tones.values())
    assert min(tones, key=tones.__getitem__) == "new"
    assert all(b > 1.08 * a for a, b in itertools.pairwise(ordered))


def test_puddles_lie_in_wheel_tracks_and_at_kerbs_and_not_in_the_tunnel():
    """One millimetre above the carriageway, within it, none beyond the portal; none on a dry road, more on a wet one
    than on a damp one.
    """
    road = street(hill=(200.0, 14.0))
    paved = [lane for lane in road.lane_section.lanes if lane.kind in ("lane", "parking")]
    count = {}
    for wet in asphalt.WETNESS:
        parts = asphalt.puddles(road, asphalt.Asphalt("worn", wet), seed=3)
        count[wet] = len(parts)
        for part in parts:
            assert (part.points[:, 2] == 0.001).all()
            assert part.points[:, 0].min() >= paved[0].low - 1e-9 and part.points[:, 0].max() <= paved[-1].high + 1e-9
            assert part.points[:, 1].min() > 0 and part.points[:, 1].max() < 210.0
    assert count["dry"] == 0 < count["damp"] < count["wet"]


@pytest.mark.parametrize("kind", ["worn", "new"])
def test_no_two_roads_show_the_same_piece_of_asphalt(kind):
    """Texture coordinates of the lanes at the road's beginning, modulo the tile: ten seeds, ten places; and metres stay
    metres.
    """
    starts = []
    for seed in range(10):
        part = next(
            p
            for p in surface.surface(street(), seed=seed, asphalt=asphalt.Asphalt(kind))["road"]
            if p.material == asphalt.Asphalt(kind).lane
        )
        starts.append(part.uv[0] % 1.0)
        if kind == "new":
            one, other = part.points[0], part.points[1]
            assert np.linalg.norm(part.uv[1] - part.uv[0]) * surface.ASPHALT_TILE_M == pytest.approx(
                np.linalg.norm(other - one), rel=1e-3
            )
    apart = [np.abs((a - b + 0.5) % 1.0 - 0.5).max() for a, b in itertools.combinations(starts, 2)]
    assert min(apart) > 1e-3


def test_rain_does_not_fall_on_a_dry_road():
    """Under the sky `rain` the road is wet, whatever was drawn."""
    assert drawn("bridge", 0, "sky.day=rain", "road.wet=dry").built["asphalt"].wet == "wet"
    assert drawn("bridge", 0, "sky.day=overcast_noon", "road.wet=dry").built["asphalt"].wet == "dry"


# -- who and what


def test_people_walk_in_company():
    """With company, most walkers have another beside them who goes the same way; without, few happen to; the number
    stays what was asked for.
    """

    def share(company):
        together = alone = 0
        for seed in range(2):
            world = drawn("arterial", seed, f"people.company={company}", "people.count=24", "works.where=none")
            people = [p for p in world.placed if p.group == "People"]
            assert len(people) == 24
            for p in (p for p in people if p.asset in parameters.WALKERS):
                beside = any(
                    q is not p
                    and math.hypot(p.x - q.x, p.y - q.y) < 1.15
                    and math.cos(math.radians(p.heading - q.heading)) > math.cos(math.radians(9))
                    for q in people
                )
                together, alone = together + beside, alone + (not beside)
        return together / (together + alone)

    assert share(1.0) > 0.6
    assert share(0.0) < 0.1


@pytest.mark.parametrize("name", ["arterial", "motorway", "rural"])
def test_works_stand_beside_the_lanes_and_hold_their_workers(name):
    """The site keeps off lanes and zebras, workers stand within its boards, and nothing else does."""
    found = 0
    for seed in range(2):
        world = drawn(name, seed, "works.where=right", "works.ahead_m=15")
        site = world.built["works"]
        if site is None:
            continue
        found += 1
        kinds = {world.road.lane_section.at(t).kind for t in (site.low, site.high)}
        assert kinds <= {"pavement", "shoulder", "verge"}
        assert all(zebra < site.s or zebra > site.s + site.length for zebra in world.road.zebras)
        inside = []
        for p in world.placed:
            s, t = (float(v) for v in world.road.reference_line.nearest(p.x, p.y))
            if site.s < s < site.s + site.length and site.low < t < site.high:
                inside.append(p.asset)
        assert 1 <= len(inside) <= 2 and set(inside) == {"worker"}
        points = np.concatenate([part.points for part in works.built(world.road, site).parts])
        s, t = world.road.reference_line.nearest(points[:, 0], points[:, 1])
        height = points[:, 2] - world.road.ground(s, t)
        assert (
            height.max() == pytest.approx(1.0, abs=0.12) and height.min() > -0.7
        )  # the heap and the verge's fall go below
    assert found >= 1


def test_every_model_of_the_library_stands_in_some_recipe():
    """Named in a recipe, a default, or what the composer places; what belongs to the crossing alone is listed here."""
    crossing = {
        "bicycle",
        "rider",
        "corner_brick",
        "corner_cream",
        "corner_green",
        "fallen_leaf",
        "street_land",
        "street_pavement",
        "street_road",
        "traffic_light",
        "traffic_light_mast",
    }
    own = {"guard_rail", "sign_no_entry"}  # roads build their rails along the line, and none is one-way
    text = "".join(path.read_text() for path in RECIPES.glob("*.yaml"))
    text += "".join(path.read_text() for path in (ROOT / "synfog_usd" / "world").rglob("*.py"))
    named = set(re.findall(r"\b\w+\b", text))
    assert set(rules.names()) - named - crossing - own == set()


def test_a_rider_and_what_is_ridden_both_count():
    """A cyclist is a rider and a bicycle, and is under way; a parked car is parked, a walker on foot."""
    place = {"x": 0.0, "y": 0.0}
    assert worlds.labels(Placement("Vehicles", "a", "cyclist", **place)) == ("rider", "bicycle")
    assert worlds.labels(Placement("Vehicles", "a", "saloon", **place)) == ("car",)
    who = [
        worlds.who(Placement(group, "a", asset, **place, lit=lit))
        for group, asset, lit in (
            ("Vehicles", "cyclist", {}),
            ("Vehicles", "saloon", {"lamps": "glow"}),
            ("Vehicles", "saloon", {}),
            ("People", "child", {}),
        )
    ]
    assert who == ["under way", "under way", "parked", "on foot"]


# -- skies, cameras, products


def test_the_recipes_draw_all_sixteen_skies():
    """Over the road recipes every sky is a choice, by day or by dusk, and no sky is both."""
    choices = {"day": set(), "dusk": set()}
    for path in RECIPES.glob("*.yaml"):
        root = language.load_root(path)
        if parameters.world_of(root) == "road":
            found = parameters.read(root, path.name).distributions
            for key, names in choices.items():
                names.update(found[f"sky.{key}"].values)
    assert choices["day"] | choices["dusk"] == set(skies()) and not choices["day"] & choices["dusk"]


@pytest.fixture(scope="module")
def rigs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rigs")
    for rig in ("single", "stereo", "surround"):
        changes = [
            f"camera.rig={rig}",
            "camera.baseline_m=0.4",
            "sky.day=storm_front",
            "sky.heading_deg=70",
            "camera.headlights=low_beam_led",
        ]
        compose(RECIPES / "motorway.yaml", folder / f"{rig}.usda", seed=2, change=changes)
    return {path.stem: Usd.Stage.Open(str(path)) for path in folder.iterdir()}


def test_a_sky_has_its_nits_and_heading(rigs):
    """The drawn picture at intensity 1, turned clockwise by its heading, with its pole up."""
    dome = UsdLux.DomeLight(rigs["single"].GetPrimAtPath("/World/Sky/Day"))
    assert (
        Path(dome.GetTextureFileAttr().Get().path).name == "storm_front.exr"
        and Path(dome.GetTextureFileAttr().Get().resolvedPath).is_file()
    )
    assert dome.GetIntensityAttr().Get() == 1.0
    turned = UsdGeom.XformCache().GetLocalToWorldTransform(dome.GetPrim())
    np.testing.assert_allclose(turned.TransformDir((0, 1, 0)), (0, 0, 1), atol=1e-6)
    angle = math.radians(70)
    np.testing.assert_allclose(turned.TransformDir((0, 0, -1)), (math.sin(angle), math.cos(angle), 0), atol=1e-6)


def test_the_cars_own_lamps_are_dipped_beams_that_look_ahead(rigs):
    """Both carry the drawn lamp's IES file and peak candelas, and look along the road within the slope."""
    stage = Usd.Stage.Open(rigs["single"].GetRootLayer(), Sdf.Layer.CreateAnonymous())
    stage.SetEditTarget(stage.GetSessionLayer())
    stage.GetDefaultPrim().GetVariantSets().GetVariantSet("lighting").SetVariantSelection("active")
    for name in ("Left", "Right"):
        prim = stage.GetPrimAtPath(f"/World/Lights/Headlights/{name}")
        assert Path(UsdLux.ShapingAPI(prim).GetShapingIesFileAttr().Get().path).name == "low_beam_led.ies"
        assert prim.GetAttribute("inputs:radius").Get() == pytest.approx(lamp_of("low_beam_led").radius_m)
        ahead = UsdGeom.XformCache().GetLocalToWorldTransform(prim).TransformDir((0, 0, -1))
        seen = UsdGeom.XformCache().GetLocalToWorldTransform(stage.GetPrimAtPath("/World/Ego")).TransformDir((0, 0, -1))
        assert math.degrees(math.acos(ahead * seen)) < 1.5


def test_a_stereo_pair_looks_one_way_a_baseline_apart(rigs):
    """The right eye stands 0.4 m to the right of the ego's own, square to where both look."""
    cache = UsdGeom.XformCache()
    left, right = (
        cache.GetLocalToWorldTransform(rigs["stereo"].GetPrimAtPath(path))
        for path in ("/World/Ego", "/World/Rig/Right")
    )
    between = right.ExtractTranslation() - left.ExtractTranslation()
    np.testing.assert_allclose(between, 0.4 * np.array(left.TransformDir((1, 0, 0))), atol=2e-5)
    np.testing.assert_allclose(right.TransformDir((0, 0, -1)), left.TransformDir((0, 0, -1)), atol=2e-6)


def test_six_cameras_see_all_round(rigs):
    """Angles of nuScenes' rig to the left of the front camera, and together no gap in 360 degrees."""
    stage = rigs["surround"]
    front = UsdGeom.XformCache().GetLocalToWorldTransform(stage.GetPrimAtPath("/World/Ego"))
    covered = np.zeros(360, dtype=bool)
    yaws = {}
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.Camera):
            look = np.array(UsdGeom.XformCache().GetLocalToWorldTransform(prim).TransformDir((0, 0, -1)))
            x, y = look @ np.array(front.TransformDir((-1, 0, 0))), look @ np.array(front.TransformDir((0, 0, -1)))
            yaws[prim.GetName()] = math.degrees(math.atan2(x, y))
            half = UsdGeom.Camera(prim).GetCamera(Usd.TimeCode.Default()).GetFieldOfView(Gf.Camera.FOVHorizontal) / 2
            off = (np.arange(360) - yaws[prim.GetName()] + 180) % 360 - 180
            covered |= np.abs(off) <= half
    assert {name: round(abs(yaw)) for name, yaw in yaws.items()} == {
        "Ego": 0, "Front_Left": 55, "Front_Right": 55, "Back_Left": 110, "Back_Right": 110, "Back": 180,
    }  # fmt: skip
    assert yaws["Front_Left"] > 0 > yaws["Front_Right"] and yaws["Back_Left"] > 0 > yaws["Back_Right"]
    assert covered.all()


@pytest.mark.parametrize("rig, cameras", [("single", 1), ("stereo", 2), ("surround", 6)])
def test_products_name_every_camera_and_what_a_bake_writes(rigs, rig, cameras):
    """Two files a camera, each with variables that exist; the settings' own camera is the ego's."""
    stage = rigs[rig]
    settings = UsdRender.Settings.GetStageRenderSettings(stage)
    assert settings.GetCameraRel().GetTargets() == ["/World/Ego"]
    assert next(str(prim.GetPath()) for prim in stage.Traverse() if prim.IsA(UsdGeom.Camera)) == "/World/Ego"
    products = [UsdRender.Product(stage.GetPrimAtPath(path)) for path in settings.GetProductsRel().GetTargets()]
    assert len({product.GetProductNameAttr().Get() for product in products}) == len(products) == 2 * cameras
    assert len({product.GetCameraRel().GetTargets()[0] for product in products}) == cameras
    sources = set()
    for product in products:
        assert stage.GetPrimAtPath(product.GetCameraRel().GetTargets()[0]).IsA(UsdGeom.Camera)
        for path in product.GetOrderedVarsRel().GetTargets():
            sources.add(UsdRender.Var(stage.GetPrimAtPath(path)).GetSourceNameAttr().Get())
    assert sources == {"RGB", "depth.Z", "distance.Z", "N", "instance.ID", "semantic.ID"}
