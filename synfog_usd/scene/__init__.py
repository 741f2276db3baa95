"""The scene between `translate` and `render`: Mitsuba's words, without Mitsuba.

Lengths in metres, Z up, right-handed, origin near the camera.  The leaves are
plain numbers, strings and numpy arrays, so that a scene can be built, looked at
and tested without a renderer.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import Array, Indices
from synfog_usd.base.colour import LUMINANCE, SRGB_TO_LINEAR
from synfog_usd.base.fisheye import Fisheye
from synfog_usd.base.image import PARALLEL_DEG as PARALLEL_DEG
from synfog_usd.base.notes import Note
from synfog_usd.fog.volume import FogVolume

Down = TypeVar("Down", float, Array)


@dataclass(frozen=True)
class Camera:
    """A pinhole, thin-lens, orthographic or fisheye camera, which may move while it exposes.

    Attributes:
        path: prim path.
        to_world: (4, 4) float64, orthonormal, metres; looks down its local -Z with +Y up; in the middle of the
            exposure of the middle row.
        width_px, height_px: image size.
        fov_x_deg: full horizontal angle of view [deg] of the whole image; of a fisheye up to 360.
        shift: (x, y) offset of the image's centre from the optical axis in image
            widths and heights, + right and + up (USD's aperture offset / aperture).
        near_m: authored near plane [m]; what lies before it is not drawn.
        focal_length_m: authored focal length [m].
        f_number: authored f-number, 0 for a pinhole.
        focus_m: distance of sharp focus [m]; used where f_number > 0.
        width_m: width [m] of what an orthographic camera sees; 0 for any other.  Its `fov_x_deg` is `PARALLEL_DEG`.
        drift_m: (x, y, z) way [m] that it goes while it exposes, evenly, in the scene's axes: from the moment at which
            the first row begins to that at which the last one ends.
        turn_rad: (x, y, z) rotation vector [rad] by which it turns meanwhile about its own place, in the scene's axes.
        shutter_s: that time [s]; 0 where no shutter is open for any time.
        rolling: part of that time which lies between the beginnings of the top row and of the bottom row, 0 to 1; 0
            for a global shutter, under which all rows expose together.
        global_reset: all rows begin together, and `rolling` lies between the ends of the top row and of the bottom row.
        during: begin and end of the part of that time in which it looks, 0 to 1; all of it but where a picture is drawn
            moment by moment.
        exposes: begin and end of the part of a row's own exposure that counts, 0 to 1: of a sensor that exposes a row
            several times, one after the other.
        fisheye: the lens of a fisheye, whose angle of view is `fov_x_deg`; None for any other camera.  All is sharp
            behind it.
        velocity_m_s: (x, y, z) with which it goes from frame to frame [m/s], in the scene's axes, whether or not a
            shutter is authored; what falls before it passes as fast.
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
    width_m: float = 0.0
    drift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    shutter_s: float = 0.0
    rolling: float = 0.0
    global_reset: bool = False
    during: tuple[float, float] = (0.0, 1.0)
    exposes: tuple[float, float] = (0.0, 1.0)
    fisheye: Fisheye | None = None
    velocity_m_s: tuple[float, float, float] = field(default=(0.0, 0.0, 0.0), compare=False)

    def exposed(self, down: Down) -> tuple[float | Down, float | Down]:
        """Begin and end of what counts of the exposure of a row.

        Args:
            down: where the row is, 0 at the top of the picture to 1 at its bottom.

        Returns:
            Parts of the time from the first row's beginning to the last one's end.
        """
        lasts: float | Down = max(1.0 - self.rolling, 1e-9)
        if self.global_reset:
            lasts = lasts + down * self.rolling
        begins = 0.0 if self.global_reset else down * self.rolling
        return begins + self.exposes[0] * lasts, begins + self.exposes[1] * lasts

    @property
    def plane(self) -> bool:
        """Whether its picture is that of a pinhole, with or without a blur."""
        return self.fisheye is None and not self.width_m > 0.0

    @property
    def pixel_rad(self) -> float:
        """Angle that the pixel on the axis spans [rad]; of a pinhole or a fisheye."""
        if self.fisheye is not None:
            return 1.0 / (float(self.fisheye.slope(np.zeros(()))) * self.width_px)
        return 2.0 * math.tan(math.radians(self.fov_x_deg) / 2.0) / self.width_px

    def directions(self, places: Array) -> Array:
        """Unit directions (..., 3) in the scene of places (..., 2) in a pinhole's or fisheye's picture, in widths and
        heights from its upper left corner.
        """
        tall = self.height_px / self.width_px
        across = (places - 0.5 + np.array(self.shift) * (1.0, -1.0)) * (1.0, tall)
        if self.fisheye is not None:
            local = self.fisheye.directions(across)
        else:
            across = across * 2.0 * math.tan(math.radians(self.fov_x_deg) / 2.0)
            local = np.concatenate([across, np.ones((*across.shape[:-1], 1))], axis=-1)
            local /= np.linalg.norm(local, axis=-1, keepdims=True)
        return np.asarray((local * (1.0, -1.0, -1.0)) @ self.to_world[:3, :3].T)

    @property
    def axis_shift(self) -> tuple[float, float]:
        """Offset of the optical axis from the image's centre, as the camera's ops take it: right and up."""
        return 0.0 - self.shift[0], 0.0 - self.shift[1]

    @property
    def moves(self) -> bool:
        """Whether it is elsewhere, or looks elsewhere, at the end of its exposure."""
        return any(self.drift_m) or any(self.turn_rad)


@dataclass(frozen=True)
class Instance:
    """What one label id stands for.

    Attributes:
        id: instance id, >= 1; 0 is none.
        path: prim path (of the instance, with [n] behind a point instancer's).
        label: Cityscapes name, or 'unlabeled'.
        frame: (4, 4) float64 from the prim's own axes to the scene's; may scale and mirror.
        velocity_m_s: (3,) of the prim's origin in the scene's axes [m/s], or None where the stage tells none.
        shown: whether it has a shape in this frame; what is invisible for a time keeps its id.
    """

    id: int
    path: str
    label: str
    frame: Array = field(default_factory=lambda: np.eye(4), compare=False, repr=False)
    velocity_m_s: tuple[float, float, float] | None = None
    shown: bool = True


@dataclass(frozen=True)
class MovingPart:
    """What moves by itself within an instance: a wheel, a leg.

    Attributes:
        id: from 1 on.
        path: prim path.
        instance: label id of the vehicle or person that has it.
        frame: (4, 4) float64 from the prim's own axes to the scene's; may scale and mirror.
    """

    id: int
    path: str
    instance: int
    frame: Array = field(compare=False, repr=False)


@dataclass(frozen=True)
class Lanelet:
    """A lane of a road, as Lanelet2 has it.

    Attributes:
        path: prim path.
        type: as OpenDRIVE has it: 'driving', 'bus', 'parking', 'shoulder', 'biking' ...
        left, right: (N, 3) and (M, 3) edges in the scene [m], in the order and from the seat of who drives there.
    """

    path: str
    type: str
    left: Array = field(compare=False, repr=False)
    right: Array = field(compare=False, repr=False)


@dataclass(frozen=True)
class SceneDict:
    """One frame of one variant of a stage, ready to be rendered.

    Attributes:
        world: {'type': 'scene', key: {...}} in Mitsuba's vocabulary: materials
            ('mat_*'), shapes ('shape_*'), shape groups ('group_*'), instances
            ('instance_*') and emitters ('light_*'); no camera, film, integrator
            or fog.  What differs from `mi.load_dict`:
            a 'to_world' is a (4, 4) array; a 'to_uv' is a (3, 3) one on texture coordinates (v up); a 'bitmap' is an
            (H, W, C) array, uint8 or float32;
            {'type': 'mesh', 'positions' (N, 3), 'faces' (M, 3), 'normals' (N, 3) or absent,
            'texcoords' (N, 2) or absent (v up), 'vertex_color' (N, 3) or absent,
            'face_normals': bool, 'bsdf': {...}, 'emitter': {...} or absent}
            is a mesh in memory; a 'preview_surface' is the BSDF of `render.surface`.
            Radiance of emitters is RGB, linear Rec.709, in cd m-2.
        camera: the camera that looks.
        further_cameras: those that look at the same world, of a rig.
        fog: fog volumes; the innermost one that contains the camera surrounds it.
        instances: what the label ids mean, ids 1..K in order.
        instance_of: (shape key,) or (instance key, key in its group) -> label id.
        parts: what moves by itself within an instance from frame to frame, ids 1..P in order.
        part_of: (shape key,) -> id of the part that it belongs to.
        reflectance_of: key of a material in `world` -> (401,) reflectance on `photometry.WAVELENGTHS_NM`, 0 to 1, that
            it has instead of the one that its colour suggests; the colour says how bright it is, see
            `render.spectra.bsdfs`.
        emission_of: key of a lamp in `world` -> (401,) relative power that it has instead of its colour's; the
            luminance stays.
        group_of: key of a lamp in `world` -> its light group: 'sky', 'headlights' (all lamps of vehicles),
            'street_lamps', 'other', or an author's own.
        motion_of: key in `world` of what moves while the camera exposes -> matrices (M, K, 4, 4) from the place in
            `world` to the place then.  There are M ways to move, at K even steps from the beginning of the first row to
            the end of the last one.  Which way a vertex of a mesh goes stands in its 'motion' (N,); without it M is 1.
        moving: keys in `world` of what has another place in other frames of the stage.
        route_m: (K, 3) places of the camera over the stage's frames; none where it stands.
        bounds_m: (2, 3) corners of the box around the camera and all that is drawn.
        flux_of: key of a lamp in `world` -> its luminous flux [lm]; inf for a sky or a sun.
        lanes: of the roads, where the stage tells of them.
        origin_m: what was subtracted from every stage position, in metres, Z up, float64.
        notes: what was left out or made simpler.
    """

    world: Mapping[str, Any]
    camera: Camera
    fog: tuple[FogVolume, ...] = ()
    instances: tuple[Instance, ...] = ()
    instance_of: Mapping[tuple[str, ...], int] = field(default_factory=dict)
    parts: tuple[MovingPart, ...] = ()
    part_of: Mapping[tuple[str, ...], int] = field(default_factory=dict)
    group_of: Mapping[str, str] = field(default_factory=dict)
    flux_of: Mapping[str, float] = field(default_factory=dict)
    reflectance_of: Mapping[str, Array] = field(default_factory=dict)
    emission_of: Mapping[str, Array] = field(default_factory=dict)
    motion_of: Mapping[str, Array] = field(default_factory=dict)
    moving: frozenset[str] = frozenset()
    route_m: Array = field(default_factory=lambda: np.zeros((0, 3)))
    bounds_m: Array = field(default_factory=lambda: np.zeros((2, 3)))
    lanes: tuple[Lanelet, ...] = ()
    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    notes: tuple[Note, ...] = ()
    further_cameras: tuple[Camera, ...] = ()

    def number_of(self, key: tuple[str, ...]) -> int:
        """Number of a shape for who asks what a ray meets: the label id of its instance, or that of its part behind
        those of all instances; 0 where it has none.
        """
        part = self.part_of.get(key)
        return self.instance_of.get(key, 0) if part is None else len(self.instances) + part

    def away_m(self, places: Array) -> Array:
        """(N,) distances [m] of places (N, 3) from the nearest camera, wherever it is in the stage's frames."""
        eyes = [*(eye.to_world[:3, 3] for eye in (self.camera, *self.further_cameras)), *self.route_m]
        return np.asarray(np.min([np.linalg.norm(places - eye, axis=1) for eye in eyes], axis=0))


def taken_over(world: Mapping[str, Any], before: Mapping[str, Any]) -> dict[str, Any]:
    """A world whose parts that are as those of another are these themselves: what was made of them is still right."""
    return {key: before[key] if key in before and _same(part, before[key]) else part for key, part in world.items()}


def _same(part: Any, before: Any) -> bool:
    """Whether parts of two worlds mean the same; large arrays do only where they are one object."""
    if part is before:
        return True
    if type(part) is not type(before):
        return False
    if isinstance(part, Mapping):
        return part.keys() == before.keys() and all(_same(value, before[key]) for key, value in part.items())
    if isinstance(part, np.ndarray):
        return part.size <= _SMALL and part.dtype == before.dtype and np.array_equal(part, before)
    return bool(part == before)


_SMALL = 64
"""Numbers of an array that is compared one by one."""


@dataclass(frozen=True)
class Placements:
    """All instances of a world, in its order, N of them.

    Attributes:
        keys: of the instances.
        rows: key of a prototype -> which of them are of it, ascending; in the order in which they first stand.
        to_world: (N, 4, 4) float64.
    """

    keys: list[str]
    rows: Mapping[str, Indices]
    to_world: Array


def placements(world: Mapping[str, Any]) -> Placements:
    """Where the prototypes of a world stand: as arrays, since they may be hundreds of thousands."""
    keys, rows, matrices = list[str](), dict[str, list[int]](), list[Any]()
    for key, part in world.items():
        if key.startswith("instance_"):
            rows.setdefault(prototype_of(part), []).append(len(keys))
            keys.append(key)
            matrices.append(part["to_world"])
    to_world = np.array(matrices, dtype=np.float64).reshape(-1, 4, 4)
    return Placements(keys, {group: np.array(some, dtype=np.int64) for group, some in rows.items()}, to_world)


def boxes(low: Array, high: Array, to_world: Array) -> tuple[Array, Array]:
    """Lower and upper corners (N, 3) of the boxes around one box wherever it stands.

    Args:
        low, high: corners of the box.
        to_world: (N, 4, 4) where it stands.
    """
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(-1, 3).astype(np.float64)
    result = np.empty((2, len(to_world), 3))
    for first in range(0, len(to_world), _BOXES_AT_ONCE):
        some = slice(first, first + _BOXES_AT_ONCE)
        turned = corners @ to_world[some, :3, :3].transpose(0, 2, 1) + to_world[some, None, :3, 3]
        result[0, some], result[1, some] = turned.min(axis=1), turned.max(axis=1)
    return result[0], result[1]


_BOXES_AT_ONCE = 10_000
"""Boxes whose corners lie in memory together: 2 MB."""


def prototype_of(instance: Mapping[str, Any]) -> str:
    """Key of the prototype that an instance of a world is of."""
    for value in instance.values():
        if isinstance(value, dict) and value.get("type") == "ref":
            return str(value["id"])
    raise KeyError("an instance of no prototype")


def shapes_of(world: Mapping[str, Any], prototype: str) -> dict[str, Mapping[str, Any]]:
    """The shapes of a prototype, by their keys in it."""
    return {name: shape for name, shape in world[prototype].items() if name != "type"}


MANY_LIT = 256
"""Lit surfaces up to which each is drawn by itself; of more those far away are drawn together."""


def lit_kind(scene: SceneDict, key: str) -> tuple[Any, ...] | None:
    """What shapes share that shine evenly and could be one; None for what is no such shape."""
    part = scene.world[key]
    if not (key.startswith("shape_") and isinstance(part, Mapping) and "emitter" in part):
        return None
    radiance = part["emitter"].get("radiance", {})
    if part["emitter"].get("type") != "area" or radiance.get("type") != "rgb":
        return None
    emission = scene.emission_of.get(key)
    return (
        tuple(np.ravel(radiance["value"]).tolist()),
        scene.group_of.get(key),
        None if emission is None else emission.tobytes(),
        part.get("bsdf", {}).get("id"),
        "normals" in part,
        "texcoords" in part,
        "vertex_color" in part,
    )


def base_colour(bsdf: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """The colour of a surface's matte part, an 'rgb' or a 'bitmap'; None where it has none, or takes it from
    vertices.
    """
    for name in _COLOURS:
        part = bsdf.get(name)
        if isinstance(part, Mapping):
            return part if part["type"] in ("rgb", "bitmap") else None
    inner = bsdf.get("bsdf")
    return base_colour(inner) if isinstance(inner, Mapping) else None


def recoloured(bsdf: Mapping[str, Any], colour: Mapping[str, Any]) -> dict[str, Any]:
    """The same surface with another colour of its matte part, and a reflection that is grey."""
    if any(name in bsdf for name in _COLOURS):
        surface = {name: colour if name in _COLOURS else part for name, part in bsdf.items()}
        if "specular" in surface:
            surface["specular"] = {"type": "rgb", "value": [float(LUMINANCE @ mean_colour(surface["specular"]))] * 3}
        return surface
    return {**bsdf, "bsdf": recoloured(bsdf["bsdf"], colour)}


_COLOURS = ("base_color", "reflectance")


def texels(colour: Mapping[str, Any]) -> npt.NDArray[np.float32]:
    """(H, W, 3) linear Rec.709 of an 'rgb' or a 'bitmap'."""
    if colour["type"] == "rgb":
        return np.broadcast_to(np.asarray(colour["value"], dtype=np.float32), 3).reshape(1, 1, 3)
    pixels = np.asarray(colour["bitmap"])
    pixels = pixels if pixels.ndim == 3 else pixels[:, :, None]
    if pixels.dtype == np.uint8:
        pixels = pixels / np.float32(255.0) if colour.get("raw", False) else SRGB_TO_LINEAR[pixels]
    return np.asarray(
        np.broadcast_to(pixels[..., :3] if pixels.shape[2] >= 3 else pixels[..., :1], (*pixels.shape[:2], 3)),
        dtype=np.float32,
    )


def mean_colour(colour: Mapping[str, Any]) -> tuple[float, float, float]:
    """Mean linear Rec.709 of an 'rgb' or a 'bitmap'."""
    r, g, b = texels(colour).mean(axis=(0, 1), dtype=np.float64)
    return float(r), float(g), float(b)
