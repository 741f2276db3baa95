"""How prims move while the camera exposes, as rigid bodies: by their time samples, else by `physics:velocity`.

Takes prims by path; gives matrices in the scene's axes at even steps of the exposure.  Knows nothing of shapes.
"""

from __future__ import annotations

import re

import numpy as np
from pxr import Sdf, Usd, UsdGeom

from synfog_usd.base.arrays import Array
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.finite import is_finite
from synfog_usd.translate.lasting import Lasting
from synfog_usd.translate.pose import authored_velocity
from synfog_usd.translate.space import FAR, Space, columns

MOMENTS = 33
"""Places of a moving prim in an exposure, with straight ways between: a wheel that turns once leaves its circle by half
a percent of its radius.
"""

STILL_M = 1e-6
"""Way [m] below which a prim counts as standing, of the corner of a cube of 1 m."""

_POINT = re.compile(r"([^\[]+)\[(\d+)\]")
_MOVING = (
    *("positions", "orientations", "orientationsf", "scales"),
    *("velocities", "angularVelocities", "accelerations"),
)


def velocity_above(prim: Usd.Prim, now: UsdGeom.XformCache, notes: Diagnostics) -> Array | None:
    """(3,) velocity of a prim, its own or that of the nearest above it that has one, in the stage's axes and units a
    second; None for none, and for one that stands.
    """
    while prim and not prim.IsPseudoRoot():
        if (velocity := authored_velocity(prim, now, notes)) is not None:
            return velocity if velocity.any() else None
        prim = prim.GetParent()
    return None


class Mover:
    """Where prims stand while the shutter is open.

    Args:
        stage: with its skeletons posed.
        space: of the scene.
        time: the middle of the exposure.
        half: frames from there to its end; 0 where nothing is to move.
        notes: for a motion that is no number.
        lasting: of the stage.

    Attributes:
        moving: paths that move.
    """

    def __init__(
        self, stage: Usd.Stage, space: Space, time: Usd.TimeCode, half: float, notes: Diagnostics, lasting: Lasting
    ) -> None:
        self._stage, self._space, self._notes, self.open = stage, space, notes, half > 0.0
        self._elsewhere = lasting.elsewhere
        self.moving: dict[str, None] = {}
        self._varies: dict[Sdf.Path, bool] = {}
        self._timed = not time.IsDefault()
        if not self.open:
            return
        self._middle = time
        self._times = [Usd.TimeCode(time.GetValue() + half * way) for way in np.linspace(-1.0, 1.0, MOMENTS)]
        self._caches = [UsdGeom.XformCache(moment) for moment in (time, *self._times)]
        self._points: dict[str, Array | None] = {}
        self._motions: dict[str, Array | None] = {}

    def of(self, path: str) -> Array | None:
        """(1, MOMENTS, 4, 4) from the place in mid-exposure to those of the exposure's even steps, or None.

        Args:
            path: of a prim of the stage, of one within an instance, or with [n] behind a point instancer's.
        """
        if not self.open:
            return None
        point = _POINT.match(path)
        key = point.group(0) if point else path
        if key not in self._motions:
            places = self._placed(point.group(1), int(point.group(2))) if point else self._standing(path)
            self._motions[key] = None if places is None else self._relative(places)
        if self._motions[key] is not None:
            self.moving[path] = None
        return self._motions[key]

    def elsewhere(self, path: str) -> bool:
        """Whether a prim has another place in other frames of the stage; paths as `of` takes them."""
        if self._timed and path not in self._elsewhere:
            self._elsewhere[path] = self._goes(path)
        return self._timed and self._elsewhere[path]

    def _goes(self, path: str) -> bool:
        point = _POINT.match(path)
        prim = self._prim(point.group(1) if point else path)
        if prim is None:
            return False
        if not point:
            return self._vary(prim)
        attributes = [prim.GetAttribute(name) for name in _MOVING]
        return self._vary(prim) or any(attribute and attribute.ValueMightBeTimeVarying() for attribute in attributes)

    def part(self, path: str, owner: str) -> str | None:
        """Path of the nearest prim at or above `path`, and below `owner`, whose own transform may vary; or None."""
        prim = self._prim(path)
        while self._timed and prim is not None and prim.GetPath().HasPrefix(owner) and prim.GetPath() != owner:
            if UsdGeom.Xformable(prim) and UsdGeom.Xformable(prim).TransformMightBeTimeVarying():
                return str(prim.GetPath())
            prim = prim.GetParent()
        return None

    def _prim(self, path: str) -> Usd.Prim | None:
        prim = self._stage.GetPrimAtPath(path) if Sdf.Path.IsValidPathString(path) else None
        return prim or None

    def _standing(self, path: str) -> Array | None:
        """(1 + MOMENTS, 4, 4) to the stage, in mid-exposure and at each step; None where nothing varies."""
        prim = self._prim(path)
        if prim is None:
            return None
        if not self._vary(prim):
            return self._going(prim)
        return np.stack([columns(cache.GetLocalToWorldTransform(prim)) for cache in self._caches])

    def _going(self, prim: Usd.Prim) -> Array | None:
        """The same of a prim that goes straight on at its velocity, or that of the nearest above it that has one."""
        velocity = velocity_above(prim, self._caches[0], self._notes)
        if velocity is None:
            return None
        seconds = np.array([0.0, *(moment.GetValue() - self._middle.GetValue() for moment in self._times)])
        places = np.tile(columns(self._caches[0].GetLocalToWorldTransform(prim)), (1 + MOMENTS, 1, 1))
        places[:, :3, 3] += np.outer(seconds / self._stage.GetTimeCodesPerSecond(), velocity)
        return places

    def _placed(self, path: str, number: int) -> Array | None:
        """The same of a point of an instancer."""
        if path not in self._points:
            self._points[path] = self._of_points(path)
        places = self._points[path]
        return None if places is None or number >= places.shape[1] else places[:, number]

    def _of_points(self, path: str) -> Array | None:
        prim = self._prim(path)
        if prim is None:
            return None
        instancer = UsdGeom.PointInstancer(prim)
        attributes = [prim.GetAttribute(name) for name in _MOVING]
        alive = any(
            attribute
            and (
                attribute.ValueMightBeTimeVarying()
                or ("elocities" in attribute.GetName() and attribute.HasAuthoredValue())
            )
            for attribute in attributes
        )
        if not alive and not self._vary(prim):
            return None
        for attribute in attributes:
            if attribute and not is_finite(attribute.Get(self._middle)):
                self._notes.warn(path, f"{attribute.GetName()} has numbers that are not finite; those instances stand")
        steps = []
        for cache, time in zip(self._caches, (self._middle, *self._times), strict=True):
            inner = instancer.ComputeInstanceTransformsAtTime(
                time, self._middle, UsdGeom.PointInstancer.IncludeProtoXform, UsdGeom.PointInstancer.IgnoreMask
            )
            matrices = np.array(inner, dtype=np.float64).reshape(-1, 4, 4).transpose(0, 2, 1)
            with np.errstate(invalid="ignore"):  # points that are not finite stand
                steps.append(columns(cache.GetLocalToWorldTransform(prim)) @ matrices)
        return np.stack(steps) if len({len(step) for step in steps}) == 1 else None

    def _vary(self, prim: Usd.Prim) -> bool:
        """Whether a prim or one above it has a transform that may vary."""
        path = prim.GetPath()
        if path not in self._varies:
            parent = prim.GetParent()
            varies = bool(UsdGeom.Xformable(prim) and UsdGeom.Xformable(prim).TransformMightBeTimeVarying())
            self._varies[path] = varies or bool(parent and not parent.IsPseudoRoot() and self._vary(parent))
        return self._varies[path]

    def _relative(self, places: Array) -> Array | None:
        if not np.abs(places).max() <= FAR or not abs(np.linalg.det(places[0, :3, :3])) > 1e-300:
            return None
        in_scene = self._space.matrix @ places
        ways = in_scene[1:] @ np.linalg.inv(in_scene[0])
        corner = in_scene[0][:3, 3] + 1.0
        went = ways[:, :3, :3] @ corner + ways[:, :3, 3] - corner
        return ways[None] if np.abs(went).max() > STILL_M else None
