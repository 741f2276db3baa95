"""A camera that moves while it exposes: each ray at a moment of its own.

Takes rays of the camera as it stands in the middle of the exposure; gives them as
they are at another moment.  Knows nothing of what the camera sees.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import drjit as dr
import numpy as np

from synfog_usd.render import backend
from synfog_usd.scene import Camera

if TYPE_CHECKING:
    from drjit.auto.ad import Float
    from mitsuba import Ray3f, Vector3f


def moved(ray: Ray3f, camera: Camera, down: Float, u: Float) -> Ray3f:
    """A ray of a camera that moves while it exposes, at the share `u` of its row's exposure (Cook, Porter and
    Carpenter 1984).

    Under a rolling shutter rows begin one after the other, from the top: `down` is the ray's place in the picture, 0
    at the top and 1 at the bottom.  Under global reset all begin together, and end one after the other.
    """
    mi = backend.mitsuba()
    if camera.global_reset:
        begin, end = (dr.opaque(mi.Float, moment) for moment in camera.during)
        opens, closes = camera.exposed(mi.Float(down))
        begin, end = dr.maximum(begin, opens), dr.minimum(end, closes)
        since = begin + u * dr.maximum(end - begin, 0.0) - 0.5
    elif camera.during == camera.exposes == (0.0, 1.0):
        since = down * camera.rolling + u * (1.0 - camera.rolling) - 0.5 if camera.rolling else u - 0.5
    else:
        begin, end = (dr.opaque(mi.Float, moment) for moment in camera.during)
        first, last = (dr.opaque(mi.Float, part * (1.0 - camera.rolling)) for part in camera.exposes)
        begin = dr.maximum(begin, down * camera.rolling + first)
        end = dr.minimum(end, down * camera.rolling + last)
        since = begin + u * dr.maximum(end - begin, 0.0) - 0.5
    eye, drift = mi.Point3f(camera.to_world[:3, 3].tolist()), mi.Vector3f(list(camera.drift_m))
    angle = float(np.linalg.norm(camera.turn_rad))
    ray = mi.Ray3f(ray)
    arm = ray.o - eye
    if angle > 0.0:
        axis = mi.Vector3f((np.array(camera.turn_rad) / angle).tolist())
        ray.d, arm = _turned(ray.d, axis, angle * since), _turned(arm, axis, angle * since)
    ray.o = eye + drift * since + arm
    return ray


def _turned(way: Vector3f, axis: Vector3f, angle: Float) -> Vector3f:
    """A vector turned about an axis (Rodrigues)."""
    sine, cosine = dr.sincos(angle)
    return way * cosine + dr.cross(axis, way) * sine + axis * (dr.dot(axis, way) * (1.0 - cosine))
