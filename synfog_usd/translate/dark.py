"""Why a picture would be black, found in the scene before or after it was rendered.

Takes a `SceneDict`; gives a sentence.  Renders nothing.
"""

from __future__ import annotations

import numpy as np

from synfog_usd.scene import SceneDict

_SKY = ("constant", "envmap")
_WITHOUT_SURFACE = ("directional", "point", "spot", "photometric")


def why_black(scene: SceneDict) -> str | None:
    """The reason why no light reaches the camera: there is none, or nothing before the camera, or its near plane lies
    beyond everything.

    Returns:
        one sentence with the fix; None where none of these is sure.
    """
    parts = [part for part in scene.world.values() if isinstance(part, dict)]
    kinds = {part["type"] for part in parts}
    shining = any("emitter" in part for part in parts)
    if not shining and kinds.isdisjoint((*_SKY, *_WITHOUT_SURFACE)):
        return "the picture is black: the stage has no light that shines; add a DomeLight, or a lamp"
    if shining or not kinds.isdisjoint(_SKY):
        return None  # which may be seen itself
    corners = np.stack(np.meshgrid(*scene.bounds_m.T), axis=-1).reshape(-1, 3)
    to_world, near = scene.camera.to_world, scene.camera.near_m
    ahead = float(((corners - to_world[:3, 3]) @ -to_world[:3, 2]).max())
    if ahead <= 1e-6:
        return (
            "the picture is black: everything lies behind the camera, and there is no sky; turn the camera, which "
            "looks along its -Z"
        )
    if ahead <= near:
        return (
            f"the picture is black: the camera's near clipping of {near:g} m lies beyond everything before it, which "
            f"ends at {ahead:.3g} m, and there is no sky; lower clippingRange"
        )
    return None
