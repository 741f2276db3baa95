"""Pairs of cameras side by side, and the disparity of what they see.

A pair is rectified: both look the same way, through the same pinhole, and stand beside each other on one row of their
pictures.  A point at planar depth Z that the left picture shows at column x is at x - d in the right one, d = f B / Z:
f is the focal length in pixels, B how far the right camera stands from the left one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import Array
from synfog_usd.scene import Camera, SceneDict

if TYPE_CHECKING:
    from synfog_usd.render.film.aovs import Aovs
    from synfog_usd.render.load import MitsubaScene

CHANNELS = ("disparity.X", "disparity.seen")

SEEN, HIDDEN, OUTSIDE = 1.0, 0.0, -1.0
"""What `disparity.seen` says: the right camera sees the point, something stands before it, its picture ends before."""

APART = 1e-3
"""What a baseline may have of the other two directions [1]."""

TURNED_PX = 0.02
"""By how much a picture may be turned against the other."""


@dataclass(frozen=True)
class RightEye:
    """The right eye of the camera that looks.

    Attributes:
        right: the camera.
        baseline_m: B.
        focal_px: f.
    """

    right: Camera
    baseline_m: float
    focal_px: float

    def metadata(self) -> dict[str, Any]:
        """What `labels.json` tells of it."""
        return {
            "right": self.right.path,
            "baseline_m": round(self.baseline_m, 9),
            "focal_px": round(self.focal_px, 6),
            "disparity": "column in the left picture less column in the right one [px]; 0 at the sky",
            "seen": "1: the right camera sees the point; 0: something stands before it; -1: outside of its picture",
        }

    def disparity_px(self, depth_m: Array) -> Array:
        """d [px] of planar depths [m], 0 at infinity."""
        return np.asarray(self.focal_px * self.baseline_m / depth_m)


def pair_of(scene: SceneDict) -> RightEye | None:
    """The nearest camera of a scene's rig that is the right eye of the one that looks; None where none is."""
    eye, candidates = scene.camera, list[RightEye]()
    for right in scene.further_cameras:
        offset = eye.to_world[:3, :3].T @ (right.to_world[:3, 3] - eye.to_world[:3, 3])
        if _same_lens(eye, right) and offset[0] > 0.0 and np.abs(offset[1:]).max() <= APART * offset[0]:
            focal = eye.width_px / (2.0 * math.tan(math.radians(eye.fov_x_deg) / 2.0))
            candidates.append(RightEye(right, float(offset[0]), focal))
    return min(candidates, key=lambda pair: pair.baseline_m, default=None)


def _same_lens(camera: Camera, reference: Camera) -> bool:
    """Whether two cameras look the same way through the same pinhole."""
    if not (
        camera.plane
        and reference.plane
        and (camera.width_px, camera.height_px) == (reference.width_px, reference.height_px)
    ):
        return False
    mine, theirs = ([eye.fov_x_deg, *eye.shift] for eye in (camera, reference))
    turned = float(np.abs(camera.to_world[:3, :3] - reference.to_world[:3, :3]).max())
    return np.allclose(mine, theirs, rtol=1e-6, atol=1e-6) and turned <= TURNED_PX * camera.pixel_rad


def planes(aov: Aovs, pair: RightEye, loaded: MitsubaScene) -> npt.NDArray[np.float32]:
    """(H, W, 2) disparity [px], and whether the right camera sees the point; see `CHANNELS`.

    Args:
        aov: what the left camera's pixels see.
        pair: its right eye.
        loaded: the scene from the left camera.
    """
    from synfog_usd.render.film import aovs

    height, width = aov.depth_m.shape
    disparity = pair.disparity_px(aov.depth_m)
    place = np.arange(width) + 0.5 - disparity
    outside = place < 0.0
    free = aovs.reached(loaded, pair.right, aov.distance_m.ravel()).reshape(height, width)
    codes = np.where(outside, OUTSIDE, np.where(free, SEEN, HIDDEN))
    return np.stack([disparity, codes], axis=2).astype(np.float32)
