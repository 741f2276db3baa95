"""Asphalts, wet and dry, works beside the road, company on the pavement, skies, rigs and render products."""

from __future__ import annotations

import functools
import math
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdRender

from synfog_usd.world.compose import compose, draw, load
from synfog_usd.world.lamps import lamp_of
from synfog_usd.world.roads import asphalt

ROOT = Path(__file__).resolve().parents[2]
RECIPES = ROOT / "stages" / "recipes"


@functools.cache
def drawn(name, seed, *changes):
    path = RECIPES / f"{name}.yaml"
    return draw(load(path, changes), seed=seed)


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


def test_rain_does_not_fall_on_a_dry_road():
    """Under the sky `rain` the road is wet, whatever was drawn."""
    assert drawn("bridge", 0, "sky.day=rain", "road.wet=dry").built["asphalt"].wet == "wet"
    assert drawn("bridge", 0, "sky.day=overcast_noon", "road.wet=dry").built["asphalt"].wet == "dry"


# -- who and what


# -- skies, cameras, products


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
        compose(RECIPES / "tunnel.yaml", folder / f"{rig}.usda", seed=2, change=changes)
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
