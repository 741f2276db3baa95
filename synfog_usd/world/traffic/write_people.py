"""People who walk or pedal as time samples: legs and arms that turn, in the place of those of the model's meshes."""

from __future__ import annotations

import numpy as np
from pxr import Gf, Sdf, UsdGeom

from synfog_usd.base.arrays import Array
from synfog_usd.world.components import author_mesh
from synfog_usd.world.shapes import shift
from synfog_usd.world.spec import Placement
from synfog_usd.world.traffic.gait import Gait, gait, skeleton, standing
from synfog_usd.world.traffic.limbs import Limb, Limbs, limbs_of
from synfog_usd.world.traffic.motion import Clip, Track
from synfog_usd.world.traffic.pedals import PEDALLERS, pedalling
from synfog_usd.world.traffic.samples import KINDS, attribute, begin, bound, geometry, keep, refer, sample


def _gait(p: Placement, track: Track, t: Array) -> Gait | None:
    """How somebody goes at times [s]; None for a model without joints."""
    bones = skeleton(p.asset, individual(p))
    if bones is None:
        return None
    if p.asset in PEDALLERS:
        return pedalling(bones, track.travel / p.size)
    return gait(bones, track.travel / p.size, pace(track), standing(t, track.travel))


def rise_of(p: Placement, track: Track, t: Array) -> Array:
    """(F,) by how much the hips of somebody are higher than in the pose of their model [m]."""
    walk = _gait(p, track, t)
    return np.zeros(len(track.x)) if walk is None else walk.rise * p.size


def author_walker(layer: Sdf.Layer, prim: Sdf.PrimSpec, p: Placement, track: Track, clip: Clip) -> None:
    """Limbs of somebody who walks or pedals."""
    meshes, parts = geometry(p)
    parts += "_limbs"
    walk, limbs = _gait(p, track, clip.codes / clip.fps), limbs_of(meshes, p.asset, individual(p))
    if limbs is None or walk is None:
        return
    if not layer.GetPrimAtPath(parts):
        _author_parts(layer, parts, limbs)
    refer(prim, parts)
    for limb in limbs.limbs:
        over = Sdf.CreatePrimInLayer(layer, prim.path.AppendPath(_place(limb, limbs)))
        angles = np.round(walk.turns.get(limb.name, np.zeros(len(clip.codes))), 2) + 0.0
        sample(layer, attribute(over, "xformOp:rotateX", KINDS.Float), clip.codes, angles.tolist())


def individual(p: Placement) -> str:
    """Which one of the model's kind somebody is."""
    return p.variants.get("individual", "a")


def pace(track: Track) -> float:
    """Usual speed of somebody, by which they stride [m/s]."""
    return max(float(np.max(track.speed)), 0.3)


def _place(limb: Limb, limbs: Limbs) -> str:
    """Path of a limb below its person: each hangs on the one above."""
    path, above = limb.name, limb.above
    while above:
        upper = next(item for item in limbs.limbs if item.name == above)
        path, above = f"{upper.name}/{path}", upper.above
    return f"Limbs/{path}"


def _author_parts(layer: Sdf.Layer, path: str, limbs: Limbs) -> None:
    """What a reference brings to somebody whose limbs turn: the limbs, and meshes without them."""
    scratch = begin(path)
    for name, part in limbs.rest.items():
        if part is None:
            scratch.OverridePrim(f"{path}/Geometry/{name}").SetActive(False)
        else:
            author_mesh(scratch, Sdf.Path(f"{path}/Geometry/{name}"), part)
    UsdGeom.Scope.Define(scratch, f"{path}/Limbs")
    joints = {limb.name: np.array(limb.joint) for limb in limbs.limbs}
    for limb in limbs.limbs:
        root = UsdGeom.Xform.Define(scratch, f"{path}/{_place(limb, limbs)}")
        above = joints[limb.above] if limb.above else np.zeros(3)
        root.AddTranslateOp().Set(Gf.Vec3d(*np.round(joints[limb.name] - above, 5).tolist()))
        root.AddRotateXOp().Set(0.0)
        for name, part in limb.parts.items():
            centred = part.moved(shift(*(-v for v in limb.joint)))
            bound(scratch, f"{root.GetPath()}/{name}", centred, f"{path}/Materials/{name}")
    keep(layer, scratch, path)
