"""The scene between `translate` and `render`: Mitsuba's words, without Mitsuba.

Lengths in metres, Z up, right-handed, origin near the camera.  The leaves are
plain numbers, strings and numpy arrays, so that a scene can be built, looked at
and tested without a renderer.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from synfog_usd.fog.volume import FogVolume

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Camera:
    """A pinhole or thin-lens camera.

    Attributes:
        path: prim path.
        to_world: (4, 4) float64, orthonormal, metres; looks down its local -Z with +Y up.
        width_px, height_px: image size.
        fov_x_deg: full horizontal angle of view [deg] of the whole image.
        shift: (x, y) offset of the optical axis from the image centre in image
            widths and heights, + right and + up (USD's aperture offset / aperture).
        near_m: authored near plane [m]; what lies before it is not drawn.
        focal_length_m: authored focal length [m].
        f_number: authored f-number, 0 for a pinhole.
        focus_m: distance of sharp focus [m]; used where f_number > 0.
    """

    path: str
    to_world: Array
    width_px: int
    height_px: int
    fov_x_deg: float
    shift: tuple[float, float] = (0.0, 0.0)
    near_m: float = 0.01
    focal_length_m: float = 0.0
    f_number: float = 0.0
    focus_m: float = 0.0


@dataclass(frozen=True)
class Thing:
    """What one label id stands for.

    Attributes:
        id: instance id, >= 1; 0 is no thing at all.
        path: prim path (of the instance, with [n] behind a point instancer's).
        label: Cityscapes name, or 'unlabeled'.
    """

    id: int
    path: str
    label: str


@dataclass(frozen=True)
class Note:
    """Something that the translation left out or made simpler.

    Attributes:
        severity: 'info' (a choice that was made), 'warning' (the picture differs
            from what the author meant).
        path: prim path, or '' for the stage.
        text: what was found and what became of it.
    """

    severity: Literal["info", "warning"]
    path: str
    text: str


@dataclass(frozen=True)
class SceneDict:
    """One frame of one variant of a stage, ready to be rendered.

    Attributes:
        world: {'type': 'scene', key: {...}} in Mitsuba's vocabulary: materials
            ('mat_*'), shapes ('shape_*'), shape groups ('group_*'), instances
            ('instance_*') and emitters ('light_*'); no camera, film, integrator
            or fog.  What differs from `mi.load_dict`:
            a 'to_world' is a (4, 4) array; a 'to_uv' is a (3, 3) one on texture coordinates (v up); a 'bitmap' is an (H, W, C) array, uint8 or float32;
            {'type': 'mesh', 'positions' (N, 3), 'faces' (M, 3), 'normals' (N, 3) or absent,
            'texcoords' (N, 2) or absent (v up), 'vertex_color' (N, 3) or absent,
            'face_normals': bool, 'bsdf': {...}, 'emitter': {...} or absent}
            is a mesh in memory.
            Radiance of emitters is RGB, linear Rec.709, in cd m-2.
        camera: the camera that looks.
        fog: fog volumes; the innermost one that contains the camera surrounds it.
        things: what the label ids mean, ids 1..K in order.
        thing_of: (shape key,) or (instance key, key in its group) -> label id.
        group_of: key of a lamp in `world` -> its light group: 'sky', 'headlights' (all lamps of vehicles), 'street_lamps', 'other', or an author's own.
        origin_m: what was subtracted from every stage position, in metres, Z up, float64.
        notes: what was left out or made simpler.
    """

    world: Mapping[str, Any]
    camera: Camera
    fog: tuple[FogVolume, ...] = ()
    things: tuple[Thing, ...] = ()
    thing_of: Mapping[tuple[str, ...], int] = field(default_factory=dict)
    group_of: Mapping[str, str] = field(default_factory=dict)
    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    notes: tuple[Note, ...] = ()
