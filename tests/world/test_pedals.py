"""Cyclists who pedal: feet stay on pedals that go round with the wheels, and at frame 0 all is as in the still."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from scipy import spatial

from synfog_usd.world import compose
from synfog_usd.world.traffic.gait import skeleton
from synfog_usd.world.traffic.pedals import DEVELOPMENT_M, PEDALLERS, pedalling

FPS = 10.0
STREETS = {"crossroads": ("/World/People/Rider_1", "/World/Vehicles/Bicycle_1"), "residential": (None, None)}


@pytest.fixture(scope="module", params=["residential", pytest.param("crossroads", marks=pytest.mark.slow)])
def street(request, tmp_path_factory):
    """A still and its clip of 2 s, and the paths of who rides and of what is ridden."""
    folder = tmp_path_factory.mktemp(request.param)
    for name, seconds in (("still", 0.0), ("clip", 2.0)):
        few = {"people.count": 0}
        compose.compose(request.param, folder / f"{name}.usda", seed=1, seconds=seconds, fps=FPS, change=few)
    still, clip = (Usd.Stage.Open(str(folder / f"{name}.usda")) for name in ("still", "clip"))
    rider, bicycle = STREETS[request.param]
    if rider is None:
        vehicles = clip.GetPrimAtPath("/World/Vehicles").GetChildren()
        rider = bicycle = next(str(prim.GetPath()) for prim in vehicles if prim.GetChild("Cranks"))
    return still, clip, rider, bicycle


def points_of(prim, frame):
    """Of the meshes below a prim, in the stage's axes [m]."""
    cache, result = UsdGeom.XformCache(frame), []
    for mesh in Usd.PrimRange(prim, Usd.TraverseInstanceProxies()):
        if mesh.IsA(UsdGeom.Mesh):
            points = np.array(UsdGeom.Mesh(mesh).GetPointsAttr().Get(), dtype=float)
            result.append(np.c_[points, np.ones(len(points))] @ np.array(cache.GetLocalToWorldTransform(mesh)))
    return np.concatenate(result)[:, :3]


def test_frame_0_has_the_meshes_of_the_still(street):
    """Cut into limbs and cranks, rider and bicycle have the points of the models where they were, within 2 mm."""
    still, clip, *paths = street
    for path in dict.fromkeys(paths):
        before, now = points_of(still.GetPrimAtPath(path), 0.0), points_of(clip.GetPrimAtPath(path), 0.0)
        assert spatial.cKDTree(before).query(now)[0].max() < 2e-3, path
        assert spatial.cKDTree(now).query(before)[0].max() < 2e-3, path


def test_shoes_stay_on_their_pedals(street):
    """At every frame the lowest point of each shoe keeps its place over the middle of a pedal within 1 cm."""
    _, clip, rider, bicycle = street
    apart = []
    for frame in range(0, 20, 2):
        cache = UsdGeom.XformCache(frame)
        for side in ("Left", "Right"):
            foot = clip.GetPrimAtPath(f"{rider}/Limbs/Thigh_{side}/Shin_{side}/Foot_{side}")
            pedal = cache.GetLocalToWorldTransform(clip.GetPrimAtPath(f"{bicycle}/Cranks/{side}"))
            body = np.array(cache.GetLocalToWorldTransform(clip.GetPrimAtPath(rider)))[:3, :3]
            ankle = np.array(cache.GetLocalToWorldTransform(foot).ExtractTranslation())
            apart.append((ankle - np.array(pedal.ExtractTranslation())) @ np.linalg.inv(body))
    sides = np.array(apart).reshape(-1, 2, 3)
    assert np.ptp(sides, axis=0).max() < 0.01
    assert (np.abs(sides[..., 2]) < 0.12).all()


def test_cranks_turn_by_the_way_that_is_gone(street):
    """A turn for each DEVELOPMENT_M, forward over the top, and pedals stay level."""
    _, clip, _, bicycle = street
    prim = clip.GetPrimAtPath(bicycle)
    spin = prim.GetChild("Cranks").GetAttribute("xformOp:rotateX")
    places = [UsdGeom.XformCache(t).GetLocalToWorldTransform(prim).ExtractTranslation() for t in (0.0, 19.0)]
    way = (places[1] - places[0]).GetLength()
    assert way > 3.0
    assert (spin.Get(0.0) - spin.Get(19.0)) / 360.0 * DEVELOPMENT_M == pytest.approx(way, rel=0.03)
    for side in ("Left", "Right"):
        pedal = prim.GetPrimAtPath(f"Cranks/{side}")
        level = UsdGeom.XformCache(7.0).GetLocalToWorldTransform(pedal).ExtractRotationMatrix()
        whole = UsdGeom.XformCache(7.0).GetLocalToWorldTransform(prim).ExtractRotationMatrix()
        np.testing.assert_allclose(np.array(level), np.array(whole), atol=2e-3)


def test_parts_of_a_bicycle_keep_its_label(street):
    """Of a model that is rider and bicycle in one, wheels and cranks are labelled as the bicycle."""
    _, clip, rider, bicycle = street
    for name in ("Wheels", "Cranks") if rider == bicycle else ():
        label = clip.GetPrimAtPath(f"{bicycle}/{name}").GetAttribute("semantics:labels:cityscapes")
        assert list(label.Get()) == ["bicycle"]


@pytest.mark.parametrize("asset", PEDALLERS)
def test_knees_bend_as_those_of_cyclists_do(asset):
    """Over a turn each knee is bent by 20 to 130 degrees."""
    bones = skeleton(asset, "a")
    legs = pedalling(bones, np.linspace(0.0, DEVELOPMENT_M, 60)).turns
    for side, suffix in enumerate(("Left", "Right")):
        thigh, shin = bones.knees[side] - bones.hips[side], bones.ankles[side] - bones.knees[side]
        rest = np.degrees(np.arctan2(thigh[1], -thigh[2]) - np.arctan2(shin[1], -shin[2]))
        bent = rest - legs[f"Shin_{suffix}"]
        assert 20.0 < bent.min() < bent.max() < 130.0, bent
        assert np.abs(np.diff(legs[f"Thigh_{suffix}"])).max() < 8.0
