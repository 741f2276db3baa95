"""Place and velocity of labelled prims."""

from __future__ import annotations

import numpy as np
from pxr import Usd, UsdGeom

from synfog_usd.base.arrays import Array
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.space import Space, columns

VELOCITY = "physics:velocity"
"""UsdPhysicsRigidBodyAPI's attribute, in stage units per second and the axes of the prim's parent."""


def authored_velocity(prim: Usd.Prim, now: UsdGeom.XformCache, notes: Diagnostics) -> Array | None:
    """(3,) velocity by a prim's own `physics:velocity`, in the stage's axes and units a second; None for none, with a
    note where it is no number.
    """
    attribute = prim.GetAttribute(VELOCITY)
    velocity = attribute.Get(now.GetTime()) if attribute and attribute.HasAuthoredValue() else None
    if velocity is None:
        return None
    if not np.isfinite(velocity).all():
        notes.warn(prim.GetPath(), f"{VELOCITY} is {velocity}, no finite number; it is not taken")
        return None
    return np.asarray(columns(now.GetParentToWorldTransform(prim))[:3, :3] @ np.array(velocity, dtype=np.float64))


class Poser:
    """Frames and velocities of prims at one moment.

    Args:
        stage: with its variants chosen.
        space: of the scene.
        time: the moment.
        notes: for a velocity that is no number.
    """

    def __init__(self, stage: Usd.Stage, space: Space, time: Usd.TimeCode, notes: Diagnostics) -> None:
        self._notes = notes
        self._stage, self._to_scene, self._now = stage, space.matrix, UsdGeom.XformCache(time)
        self._around: tuple[UsdGeom.XformCache, UsdGeom.XformCache] | None = None
        self._seconds = 0.0
        begin, end = stage.GetStartTimeCode(), stage.GetEndTimeCode()
        if not time.IsDefault() and stage.HasAuthoredTimeCodeRange() and begin < end:
            first, last = max(begin, time.GetValue() - 0.5), min(end, time.GetValue() + 0.5)
            if first < last:
                self._around = UsdGeom.XformCache(first), UsdGeom.XformCache(last)
                self._seconds = (last - first) / stage.GetTimeCodesPerSecond()

    def pose(self, path: str, around: Array) -> tuple[Array, tuple[float, float, float] | None]:
        """Frame and velocity of an instance.

        Args:
            path: of the prim, with [n] behind a point instancer's.
            around: (4, 4) to the scene, of the instance that it is part of, or of the stage; the frame where `path` is
                of no prim.

        Returns:
            (4, 4) from the prim's own axes to the scene's; and its velocity [m/s] in the scene's axes, from
            `physics:velocity`, else from how it moves about this moment, None on a stage where nothing moves.
        """
        prim = None if "[" in path else self._stage.GetPrimAtPath(path)
        if not prim:
            return around, None
        frame = self._to_scene @ columns(self._now.GetLocalToWorldTransform(prim))
        return frame, self._velocity(prim)

    def _velocity(self, prim: Usd.Prim) -> tuple[float, float, float] | None:
        velocity = authored_velocity(prim, self._now, self._notes)
        if velocity is not None:
            return self._finite(self._to_scene[:3, :3] @ velocity)
        if self._around is None:
            return None
        before, after = (columns(cache.GetLocalToWorldTransform(prim))[:3, 3] for cache in self._around)
        return self._finite(self._to_scene[:3, :3] @ (after - before) / self._seconds)

    @staticmethod
    def _finite(velocity: Array) -> tuple[float, float, float] | None:
        if not np.isfinite(velocity).all():
            return None
        return float(velocity[0]), float(velocity[1]), float(velocity[2])
