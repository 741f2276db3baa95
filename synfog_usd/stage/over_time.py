"""Findings on a stage that moves: what overlaps, floats, jumps or leaves the lanes, and at which frame first.

Takes a stage with frames; gives findings.  Road users are the boxes of labelled prims in their own axes, the ground is
the triangles of what is labelled as ground, lanes are guide curves with a type.  Lengths in metres, Z up.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from pxr import Usd, UsdGeom

from synfog_usd.base.arrays import Array, Flags
from synfog_usd.stage.labels import direct_label, official_name
from synfog_usd.stage.open import plain_errors
from synfog_usd.stage.rulebook import Finding, finding

ON_FOOT = ("person", "rider")
VEHICLES = ("car", "truck", "bus", "motorcycle", "bicycle")
GROUND = ("road", "sidewalk", "parking", "rail track", "terrain", "ground", "bridge")
LANE = "synfog:lane:type"
MOST_FRAMES = 3000
"""So many frames are looked at; of more, every second or further one."""
MOST_TRIANGLES = 3_000_000
"""Of the ground below road users; of more, nothing is said about heights."""
TRUNK_M = 0.3
"""Half of what somebody on foot takes up: arms and legs pass beside others."""
DEEP_M, HIGH_M, OFF_M = 0.1, 0.25, 0.5
"""Least overlap of two boxes, height over the ground, and distance from the lanes, of which a finding tells."""
JUMP_M, HARDEST = 0.5, 30.0
"""A step jumps that differs from the one before by more than JUMP_M, and than HARDEST [m/s2] explains."""
FASTEST = 120.0
"""[m/s]; what is faster jumps."""
TURN_DEG, TURNS = 30.0, 1000.0
"""A camera cuts where it turns by more within a frame, and by more than TURNS [deg/s2] explains."""
CARRIED_M = 0.1
"""Who rides keeps their place in the vehicle within this."""


@dataclass(frozen=True)
class User:
    """A road user over F frames.

    Attributes:
        path, label: of its prim.
        outline: (F, 4, 2) of its box on the ground.
        heights: (F, 2) of the lowest and highest point of its box.
        foot: (F, 3) middle of the lower side of its box.
        shown: (F,) whether it is visible.
        axes: (F, 4, 4) from the stage, in metres, to its axes.
    """

    path: str
    label: str
    outline: Array
    heights: Array
    foot: Array
    shown: Flags
    axes: Array

    @property
    def moves(self) -> bool:
        """Whether it is ever elsewhere."""
        return bool(np.ptp(self.foot, axis=0).max() > 1e-3)


@plain_errors
def over_time(stage: Usd.Stage) -> list[Finding]:
    """All findings on road users and cameras over a stage's frames, as its variants stand; none where it has one frame.

    Raises:
        StageError: the stage is damaged.
    """
    first, last = stage.GetStartTimeCode(), stage.GetEndTimeCode()
    rate = stage.GetTimeCodesPerSecond()
    if not (stage.HasAuthoredTimeCodeRange() and 1.0 <= last - first < math.inf and 0.0 < rate < math.inf):
        return []
    every = math.ceil((last - first + 1.0) / MOST_FRAMES)
    codes = np.arange(first, last + 1e-6, every)
    result = list(_cuts(stage, codes))
    users = list(_users(stage, codes))
    labelled = {user.path for user in users}
    result += [_jump(path, *jump) for path, jump in jumps(stage, codes).items() if path not in labelled]
    if not any(user.moves for user in users):
        return result
    lanes, ground = _lanes(stage), _Ground.below(stage, users, first)
    result += _overlaps(users, codes)
    for user in users:
        result += [*_jumps(user, codes, every / rate), *ground.floats(user, codes), *_off_lane(user, lanes, codes)]
    return result


# -- who there is, and where


def _users(stage: Usd.Stage, codes: Array) -> Iterator[User]:
    """Every prim with a road user's label, the outermost where one is below another."""
    to_metres = _to_metres(stage)
    time = Usd.TimeCode(float(codes[0]))
    boxes = UsdGeom.BBoxCache(time, [UsdGeom.Tokens.default_, UsdGeom.Tokens.render], False, True)
    prims = iter(Usd.PrimRange(stage.GetPseudoRoot()))
    for prim in prims:
        label = None if prim.IsPseudoRoot() else direct_label(prim, time)
        kind = official_name(label) if label else None
        if kind not in (*ON_FOOT, *VEHICLES) or not prim.IsA(UsdGeom.Imageable):
            continue
        prims.PruneChildren()
        box = boxes.ComputeUntransformedBound(prim).ComputeAlignedRange()
        if not box.IsEmpty():
            low, high = np.array(box.GetMin()), np.array(box.GetMax())
            if np.isfinite([low, high]).all():
                yield _user(prim, kind, (low, high), _matrices(prim, codes) @ to_metres, codes)


def _to_metres(stage: Usd.Stage) -> Array:
    """(4, 4) for rows on its left: from the stage's units and axes to metres with Z up."""
    turn = np.eye(4)
    if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y:
        turn[:3, :3] = (1, 0, 0), (0, 0, 1), (0, -1, 0)
    return np.asarray(np.diag([*[UsdGeom.GetStageMetersPerUnit(stage)] * 3, 1.0]) @ turn)


def _chain(prim: Usd.Prim) -> Iterator[Usd.Prim]:
    while prim and not prim.IsPseudoRoot():
        yield prim
        prim = prim.GetParent()


def _matrices(prim: Usd.Prim, codes: Array) -> Array:
    """(F, 4, 4) of a prim's axes, for rows on the left."""
    moves = any(
        UsdGeom.Xformable(above).TransformMightBeTimeVarying() for above in _chain(prim) if above.IsA(UsdGeom.Xformable)
    )
    xform = UsdGeom.Imageable(prim)
    matrices = [np.array(xform.ComputeLocalToWorldTransform(code)) for code in (codes if moves else codes[:1]).tolist()]
    return np.broadcast_to(np.array(matrices), (len(codes), 4, 4))


def _shown(prim: Usd.Prim, codes: Array) -> Flags:
    """(F,) whether a prim is visible."""
    changes = any(
        UsdGeom.Imageable(above).GetVisibilityAttr().ValueMightBeTimeVarying()
        for above in _chain(prim)
        if above.IsA(UsdGeom.Imageable)
    )
    eye = UsdGeom.Imageable(prim)
    shown = [
        eye.ComputeVisibility(code) != UsdGeom.Tokens.invisible for code in codes[: None if changes else 1].tolist()
    ]
    return np.broadcast_to(np.array(shown), len(codes))


def _user(prim: Usd.Prim, kind: str, box: tuple[Array, Array], matrices: Array, codes: Array) -> User:
    """A road user of a box in its own axes; that of somebody on foot is narrowed."""
    low, high = box
    up = int(np.argmax(np.abs(matrices[0, :3, 2])))
    right, ahead = (axis for axis in range(3) if axis != up)
    if kind in ON_FOOT:
        sizes = np.linalg.norm(matrices[0, :3, :3], axis=1)
        half = np.minimum((high - low) / 2.0, TRUNK_M / np.maximum(sizes, 1e-9))
        half[up] = (high[up] - low[up]) / 2.0
        low, high = (low + high) / 2.0 - half, (low + high) / 2.0 + half
    corners = np.tile([*((low + high) / 2.0), 1.0], (4, 1))
    corners[:, right] = low[right], high[right], high[right], low[right]
    corners[:, ahead] = low[ahead], low[ahead], high[ahead], high[ahead]
    ends = np.array([(*corner, 1.0) for corner in itertools.product(*zip(low, high, strict=True))])
    below = np.array([*((low + high) / 2.0), 1.0])
    below[up] = low[up] if matrices[0, up, 2] > 0.0 else high[up]
    z = (ends @ matrices)[..., 2]
    return User(
        str(prim.GetPath()),
        kind,
        (corners @ matrices)[..., :2],
        np.stack([z.min(axis=1), z.max(axis=1)], axis=1),
        (below @ matrices)[:, :3],
        _shown(prim, codes),
        np.asarray(np.linalg.pinv(matrices), dtype=np.float64),
    )


# -- one against the other


def _overlaps(users: Sequence[User], codes: Array) -> Iterator[Finding]:
    """Pairs of whom one moves and whose boxes overlap; who rides in or on a vehicle may."""
    moving = [number for number, user in enumerate(users) if user.moves]
    pairs: dict[tuple[int, int], tuple[int, float]] = {}
    for frame in range(len(codes)):
        shapes = shapely.polygons(np.array([user.outline[frame] for user in users]))
        for k, j in shapely.STRtree(shapes).query(shapes[moving], predicate="intersects").T.tolist():
            i = moving[k]
            a, b = users[i], users[j]
            pair = min(i, j), max(i, j)
            if i == j or pair in pairs or not (a.shown[frame] and b.shown[frame]):
                continue
            depth = min(_depth(a.outline[frame], b.outline[frame]), _shared(a.heights[frame], b.heights[frame]))
            if depth > DEEP_M and not _rides(a, b):
                pairs[pair] = frame, depth
    for (i, j), (frame, depth) in pairs.items():
        text = f"frame {codes[frame]:g}: overlaps {users[j].path} by {depth:.2g} m; move one of them"
        yield finding("overlaps", users[i].path, text)


def _shared(a: Array, b: Array) -> float:
    """Length that two stretches have in common; negative for the gap between them."""
    return float(min(a.max(), b.max()) - max(a.min(), b.min()))


def _depth(a: Array, b: Array) -> float:
    """By how much one of two (4, 2) rectangles has to move to be beside the other."""
    sides = np.array([outline[k] - outline[0] for outline in (a, b) for k in (1, 3)])
    sides /= np.maximum(np.linalg.norm(sides, axis=1, keepdims=True), 1e-9)
    return min(_shared(a @ side, b @ side) for side in sides)


def _rides(a: User, b: User) -> bool:
    """Whether one is somebody who keeps their place in or on the other."""
    if not {a.label, b.label} & set(ON_FOOT):
        return False
    both = a.shown & b.shown
    place = np.einsum("fi,fij->fj", np.c_[b.foot, np.ones(len(b.foot))], a.axes)[both, :3]
    return bool(np.ptp(place, axis=0).max() < CARRIED_M)


def _jumps(user: User, codes: Array, step_s: float) -> Iterator[Finding]:
    bad, length = _leaps(user.foot, user.shown[1:] & user.shown[:-1], step_s)
    if bad.any():
        k = int(np.argmax(bad))
        k -= bool(k == 1 and length[0] > length[1])  # nothing is before the first step
        yield _jump(user.path, codes[k + 1], length[k])


def _jump(path: str, code: float, length_m: float) -> Finding:
    return finding("jumps", path, f"frame {code:g}: jumps {length_m:.2g} m within a frame; smooth its time samples")


def _leaps(places: Array, both: Flags, step_s: float) -> tuple[Flags, Array]:
    """Steps that differ from the one before by more than any driver brakes or turns, and the lengths of all [m].

    Args:
        places: (F, 3) [m]; both: (F - 1,) whether a step counts.
    """
    way = np.diff(places, axis=0)
    change = np.r_[0.0, np.linalg.norm(np.diff(way, axis=0), axis=1) * (both[1:] & both[:-1])]
    length = np.linalg.norm(way, axis=1) * both
    return (change > max(JUMP_M, HARDEST * step_s**2)) | (length > max(JUMP_M, FASTEST * step_s)), length


@plain_errors
def jumps(stage: Usd.Stage, codes: Array) -> dict[str, tuple[float, float]]:
    """What goes faster from one frame to the next than anything on a road: path -> time code at which it is there
    first, and the way [m].

    Of prims that move the outermost ones are looked at, but for those that carry a camera, of which `cuts` tells.
    """
    if len(codes) < 2:
        return {}
    step_s = abs(codes[1] - codes[0]) / stage.GetTimeCodesPerSecond()
    to_metres, result = _to_metres(stage), dict[str, tuple[float, float]]()
    cameras = [prim for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()) if prim.IsA(UsdGeom.Camera)]
    carriers = {above.GetPath() for camera in cameras for above in _chain(camera)}
    prims = iter(Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()))
    for prim in prims:
        if prim.GetPath() in carriers or not prim.IsA(UsdGeom.Xformable):
            continue
        if UsdGeom.Xformable(prim).TransformMightBeTimeVarying():
            prims.PruneChildren()
            places, shown = (_matrices(prim, codes) @ to_metres)[:, 3, :3], _shown(prim, codes)
            with np.errstate(invalid="ignore", over="ignore"):  # of places that are no numbers nothing is said
                length = np.linalg.norm(np.diff(places, axis=0), axis=1) * (shown[1:] & shown[:-1])
            fast = length > max(JUMP_M, FASTEST * step_s)
            if fast.any():
                first = int(np.argmax(fast))
                result[str(prim.GetPath())] = float(codes[first + 1]), float(length[first])
    return result


# -- cameras


def cuts(camera: Usd.Prim, codes: Array) -> list[float]:
    """Time codes at which a camera looks from elsewhere, or elsewhere, than any that is carried could.

    Args:
        camera: of a stage with a rate.
        codes: (F,) of the frames, at even steps.
    """
    if len(codes) < 2:
        return []
    stage = camera.GetStage()
    step_s = abs(codes[1] - codes[0]) / stage.GetTimeCodesPerSecond()
    matrices = _matrices(camera, codes) @ _to_metres(stage)
    bad, length = _leaps(matrices[:, 3, :3], np.ones(len(codes) - 1, dtype=bool), step_s)
    bad &= length >= np.r_[0.0, length[:-1]]  # one that stops dead does not cut
    ahead = matrices[:, 2, :3] / np.maximum(np.linalg.norm(matrices[:, 2, :3], axis=1, keepdims=True), 1e-9)
    turn = np.degrees(np.arccos(np.clip((ahead[1:] * ahead[:-1]).sum(axis=1), -1.0, 1.0)))
    bad |= turn > max(TURN_DEG, TURNS * step_s**2)
    return [float(code) for code in codes[1:][bad]]


def _cuts(stage: Usd.Stage, codes: Array) -> Iterator[Finding]:
    for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()):
        if prim.IsA(UsdGeom.Camera) and (found := cuts(prim, codes)):
            text = (
                f"cuts at frame {', '.join(f'{code:g}' for code in found[:8])}{' ...' * (len(found) > 8)}; a clip and "
            )
            text += "its flow go on over cuts, so bake the frames before and after one by themselves"
            yield finding("cuts", str(prim.GetPath()), text)


# -- against the road


@dataclass(frozen=True)
class _Ground:
    """(N, 3, 3) triangles of the ground, and a tree of their outlines."""

    triangles: Array
    tree: shapely.STRtree

    @classmethod
    def below(cls, stage: Usd.Stage, users: Sequence[User], code: float) -> _Ground:
        """All that is labelled as ground and lies where road users come."""
        feet = np.concatenate([user.foot[user.shown, :2] for user in users])
        low, high = feet.min(axis=0), feet.max(axis=0)
        time, to_metres = Usd.TimeCode(code), _to_metres(stage)
        meshes, count = [np.zeros((0, 3, 3))], 0
        for root in stage.Traverse():
            label = direct_label(root, time)
            if not label or official_name(label) not in GROUND:
                continue
            for prim in Usd.PrimRange(root, Usd.TraverseInstanceProxies()):
                if prim.IsA(UsdGeom.Mesh):
                    corners = _triangles(UsdGeom.Mesh(prim), time, to_metres)
                    flat = corners[..., :2]
                    near = (flat.max(axis=1) >= low).all(axis=1) & (flat.min(axis=1) <= high).all(axis=1)
                    meshes.append(corners[near])
                    count += int(near.sum())
        triangles = np.concatenate(meshes) if count <= MOST_TRIANGLES else meshes[0]
        return cls(triangles, shapely.STRtree(shapely.polygons(triangles[..., :2])))

    def floats(self, user: User, codes: Array) -> Iterator[Finding]:
        """The first frame at which somebody is above or below all ground; nothing where there is none."""
        frames = np.flatnonzero(user.shown)
        frames = frames if user.moves else frames[:1]
        feet = user.foot[frames]
        k, at = self.tree.query(shapely.points(feet[:, :2]), predicate="intersects")
        gap = np.full(len(feet), np.inf)
        height = feet[k, 2] - _height(self.triangles[at], feet[k, :2])
        order = np.argsort(-np.abs(height))  # the nearest last
        gap[k[order]] = height[order]
        bad = np.isfinite(gap) & (np.abs(gap) > HIGH_M)
        if bad.any():
            first = int(np.argmax(bad))
            way = "above" if gap[first] > 0.0 else "below"
            text = (
                f"frame {codes[frames[first]]:g}: is {abs(gap[first]):.2g} m {way} the ground; move it onto the ground"
            )
            yield finding("floats", user.path, text)


def _triangles(mesh: UsdGeom.Mesh, time: Usd.TimeCode, to_metres: Array) -> Array:
    """(N, 3, 3) of a mesh, its faces cut into fans."""
    points = np.asarray(mesh.GetPointsAttr().Get(time) or (), dtype=np.float64).reshape(-1, 3)
    counts = np.asarray(mesh.GetFaceVertexCountsAttr().Get(time) or (), dtype=np.int64)
    corners = np.asarray(mesh.GetFaceVertexIndicesAttr().Get(time) or (), dtype=np.int64)
    if (
        not len(corners)
        or counts.sum() != len(corners)
        or counts.min() < 3
        or not 0 <= corners.min() <= corners.max() < len(points)
    ):
        return np.zeros((0, 3, 3))
    begins = np.repeat(np.r_[0, np.cumsum(counts)[:-1]], counts - 2)
    second = np.arange(len(begins)) - np.repeat(np.r_[0, np.cumsum(counts - 2)[:-1]], counts - 2) + 1
    faces = corners[np.stack([begins, begins + second, begins + second + 1], axis=1)]
    matrix = np.array(mesh.ComputeLocalToWorldTransform(time)) @ to_metres
    placed = points @ matrix[:3, :3] + matrix[3, :3]
    return np.asarray(placed[faces][np.isfinite(placed[faces]).all(axis=(1, 2))])


def _height(triangles: Array, at: Array) -> Array:
    """(K,) z of triangles at x, y; upright ones have that of their first corner."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    normal = np.cross(b - a, c - a)
    upright = np.abs(normal[:, 2]) < 1e-9
    over = ((at - a[:, :2]) * normal[:, :2]).sum(axis=1) / np.where(upright, 1.0, normal[:, 2])
    return np.asarray(a[:, 2] - np.where(upright, 0.0, over))


def _lanes(stage: Usd.Stage) -> shapely.Geometry | None:
    """The area of all lanes; None where the stage has none."""
    to_metres, areas = _to_metres(stage), []
    for prim in stage.Traverse():
        if not (prim.IsA(UsdGeom.BasisCurves) and prim.HasAttribute(LANE)):
            continue
        curves = UsdGeom.BasisCurves(prim)
        counts, points = curves.GetCurveVertexCountsAttr().Get(), curves.GetPointsAttr().Get()
        if not counts or not points or len(counts) != 2 or min(counts) < 2 or sum(counts) != len(points):
            continue
        matrix = np.array(curves.ComputeLocalToWorldTransform(Usd.TimeCode.Default())) @ to_metres
        edges = np.asarray(points, dtype=np.float64) @ matrix[:3, :3] + matrix[3, :3]
        if np.isfinite(edges).all():
            outline = np.concatenate([edges[: counts[0]], edges[counts[0] :][::-1]])
            areas.append(shapely.Polygon(outline[:, :2]).buffer(OFF_M))
    return shapely.union_all(areas) if areas else None


def _off_lane(user: User, lanes: shapely.Geometry | None, codes: Array) -> Iterator[Finding]:
    """The first frame at which a vehicle that drove in a lane is beside all of them."""
    frames = np.flatnonzero(user.shown)
    if lanes is None or user.label not in VEHICLES or not user.moves or not len(frames):
        return
    inside = shapely.contains_xy(lanes, *user.foot[frames, :2].T)
    if inside[0] and not inside.all():
        text = f"frame {codes[frames[np.argmin(inside)]]:g}: leaves all lanes; lead it along one"
        yield finding("leaves-lane", user.path, text)
