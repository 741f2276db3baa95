"""People who walk: legs that carry them, feet that keep their place, and meshes that are the model's at frame 0."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom
from scipy import spatial

from synfog_usd.world import compose, library
from synfog_usd.world.library import nominal
from synfog_usd.world.roads.crossing import Crossing
from synfog_usd.world.traffic.cutting import read_part
from synfog_usd.world.traffic.gait import gait, skeleton, standing
from synfog_usd.world.traffic.limbs import limbs_of
from synfog_usd.world.traffic.motion import ground
from synfog_usd.world.traffic.walk import SPEED_M_S

FPS = 20.0
WALKERS = [(asset, individual) for asset in SPEED_M_S for individual in nominal().get(asset, {}).get("joints", {})]


def turned(degrees):
    """A (3, 3) turn about the axis to the right."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def places(bones, walk, frame, side):
    """Hip, knee, ankle and toes [m] at a frame, limb after limb."""
    suffix = ("Left", "Right")[side]
    rows = [row[side] for row in (bones.hips, bones.knees, bones.ankles, bones.toes)]
    result, turn = [rows[0] + (0.0, 0.0, walk.rise[frame])], np.eye(3)
    for limb, (above, below) in zip(("Thigh", "Shin", "Foot"), itertools.pairwise(rows), strict=True):
        turn = turn @ turned(walk.turns[f"{limb}_{suffix}"][frame])
        result.append(result[-1] + turn @ (below - above))
    return result


@pytest.mark.parametrize(("asset", "individual"), WALKERS)
def test_somebody_begins_in_the_pose_of_their_model(asset, individual):
    """Where no way was gone nothing is turned, and a millimetre later nothing has turned by more than 3 degrees."""
    bones = skeleton(asset, individual)
    walk = gait(bones, np.array([0.0, 0.001]), SPEED_M_S[asset])
    for name, turn in walk.turns.items():
        assert abs(turn[0]) < 1e-6, name
        assert abs(turn[1]) < 3.0, name
    assert abs(walk.rise[0]) < 1e-9


@pytest.mark.parametrize(("asset", "individual"), WALKERS)
def test_knees_bend_as_knees_do(asset, individual):
    """Over four strides no knee bends forward or beyond 130 degrees, no thigh turns beyond 60, hips rise by 12 cm."""
    bones = skeleton(asset, individual)
    walk = gait(bones, np.linspace(0.0, 6.0, 600), SPEED_M_S[asset])
    for side in (0, 1):
        for frame in range(0, 600, 5):
            hip, knee, ankle, _ = places(bones, walk, frame, side)
            thigh, shin = (np.degrees(np.arctan2(d[1], -d[2])) for d in (knee - hip, ankle - knee))
            assert -0.5 <= thigh - shin < 130.0
            assert abs(thigh) < 60.0
    assert np.ptp(walk.rise) < 0.12


@pytest.mark.parametrize(("asset", "individual"), WALKERS)
def test_turns_have_no_jumps(asset, individual):
    """No limb turns by more than 15 degrees in 1 cm of way."""
    walk = gait(skeleton(asset, individual), np.arange(0.0, 4.0, 0.01), SPEED_M_S[asset])
    for name, turn in walk.turns.items():
        assert np.abs(np.diff(turn)).max() < 15.0, name
    assert np.abs(np.diff(walk.rise)).max() < 0.01


@pytest.mark.parametrize(("asset", "individual"), WALKERS)
def test_who_waits_brings_the_feet_together(asset, individual):
    """Between 2 and 4 s of a walk somebody stands: after a second both feet are flat on the ground below the hips, with
    straight knees.  No limb jumps: 50 degrees in a twentieth of a second are the most, of a runner's 90.
    """
    bones, t = skeleton(asset, individual), np.arange(-0.05, 6.0, 0.05)
    speed = SPEED_M_S[asset]
    travel = speed * (np.clip(t, 0.0, 2.0) + np.clip(t - 4.0, 0.0, None))
    walk = gait(bones, travel, speed, standing(t, travel))
    for name, turn in walk.turns.items():
        assert abs(turn[1]) < 1e-6
        assert np.abs(np.diff(turn[t > 1.0])).max() < (90.0 if speed > 2.0 else 50.0), name
    frame = int(np.argmin(np.abs(t - 3.5)))
    feet = np.array([places(bones, walk, frame, side) for side in (0, 1)])
    assert np.abs(feet[:, 2, 1] - feet[:, 0, 1]).max() < 0.03
    np.testing.assert_allclose(feet[0, 2, 1:], feet[1, 2, 1:], atol=0.02)
    thighs, shins = feet[:, 1] - feet[:, 0], feet[:, 2] - feet[:, 1]
    bent = np.arctan2(thighs[:, 1], -thighs[:, 2]) - np.arctan2(shins[:, 1], -shins[:, 2])
    assert np.degrees(np.abs(bent)).max() < 25.0
    for side in (0, 1):
        low = min(feet[side, 2, 2], feet[side, 3, 2])
        assert 0.0 < low < 0.12


@pytest.mark.parametrize(("asset", "individual"), WALKERS)
def test_joints_are_where_the_meshes_are(asset, individual):
    """Ankles and toes are in the shoes, or within 4 cm of them."""
    bones = skeleton(asset, individual)
    stem = asset if individual == "a" else f"{asset}.{individual}"
    limbs = limbs_of(library.model(asset).path.with_name(f"{stem}.geo.usdc"), asset, individual)
    for side, suffix in enumerate(("Left", "Right")):
        foot = next(limb for limb in limbs.limbs if limb.name == f"Foot_{suffix}")
        points = np.concatenate([part.points for part in foot.parts.values()])
        low, high = points.min(axis=0), points.max(axis=0)
        for joint in (bones.toes[side], bones.ankles[side]):
            assert (joint > low - 0.04).all()
            assert (joint < high + 0.04).all()


@pytest.fixture(scope="module")
def stages(tmp_path_factory):
    """The crossing with people, as a still and as a clip of 1.5 s."""
    folder = tmp_path_factory.mktemp("walk")
    change = {"people.count": 14, "traffic.count": 0}
    for name, seconds in (("still", 0.0), ("clip", 1.5)):
        compose.compose("crossroads", folder / f"{name}.usda", seed=5, change=change, seconds=seconds, fps=FPS)
    return [Usd.Stage.Open(str(folder / f"{name}.usda")) for name in ("still", "clip")]


def walkers(stage):
    """People on foot with limbs."""
    people = stage.GetPrimAtPath("/World/People").GetChildren()
    return [prim for prim in people if prim.GetChild("Limbs") and not prim.GetName().startswith("Rider")]


def points_of(prim, frame, names=None):
    """Of the meshes below a prim, of some materials or all, in the stage's axes [m]."""
    cache, result = UsdGeom.XformCache(frame), []
    for mesh in Usd.PrimRange(prim, Usd.TraverseInstanceProxies()):
        if mesh.IsA(UsdGeom.Mesh) and (names is None or mesh.GetName() in names):
            points = np.array(UsdGeom.Mesh(mesh).GetPointsAttr().Get(), dtype=float)
            result.append(np.c_[points, np.ones(len(points))] @ np.array(cache.GetLocalToWorldTransform(mesh)))
    return np.concatenate(result)[:, :3]


def test_frame_0_has_the_meshes_of_the_still(stages):
    """Cut into limbs, somebody has the points of the model where they were."""
    still, clip = stages
    assert len(walkers(clip)) >= 6
    for prim in walkers(clip):
        before, now = points_of(still.GetPrimAtPath(prim.GetPath()), 0.0), points_of(prim, 0.0)
        assert spatial.cKDTree(before).query(now)[0].max() < 1e-3, prim.GetPath()
        assert spatial.cKDTree(now).query(before)[0].max() < 1e-3, prim.GetPath()


def test_feet_that_stand_do_not_slip(stages):
    """What of the soles is within 1 cm of the ground at two frames keeps its place within 2 cm, while the body goes
    three times as far; but where a foot leaves the ground or comes down, which is at one pair of frames in six at most.
    """
    _, clip = stages
    for prim in walkers(clip):
        soles = [points_of(prim, float(frame), ("sole",)) for frame in range(1, 30)]
        slips = []
        for before, now in itertools.pairwise(soles):
            floor = min(before[:, 2].min(), now[:, 2].min())
            stands = (before[:, 2] < floor + 0.01) & (now[:, 2] < floor + 0.01)
            if stands.any():
                slips.append(np.median(np.hypot(*(now - before)[stands, :2].T)))
        assert len(slips) > 12
        assert np.mean(np.array(slips) < 0.02) > 5 / 6, prim.GetPath()


def test_all_walkers_that_can_have_limbs():
    """Only who is in a wheelchair has no gait."""
    assert {asset for asset, _ in WALKERS} == set(SPEED_M_S) - {"wheelchair_user"}
    for asset, individual in WALKERS:
        for low in ("", ".low"):
            stem = asset if individual == "a" else f"{asset}.{individual}"
            path = library.model(asset).path.with_name(f"{stem}{low}.geo.usdc")
            limbs = limbs_of(path, asset, individual)
            whole = sum(len(part.faces) for name in limbs.rest if (part := _whole(path, name)))
            cut = sum(len(part.faces) for limb in limbs.limbs for part in limb.parts.values())
            rest = sum(len(part.faces) for part in limbs.rest.values() if part)
            assert whole <= cut + rest < 1.6 * whole, path


def _whole(path, name):
    return read_part(Sdf.Layer.FindOrOpen(str(path)), name)


def test_the_ground_is_below(stages):
    """Feet touch the ground within 3 cm at every frame."""
    _, clip = stages
    for prim in walkers(clip):
        for frame in range(1, 30, 4):
            soles = points_of(prim, float(frame), ("sole",))
            at = soles[np.argmin(soles[:, 2])]
            floor = float(ground(Crossing(), at[None, 0], at[None, 1])[0])
            assert abs(at[2] - floor) < 0.03, (prim.GetPath(), frame)
