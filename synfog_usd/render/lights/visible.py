"""Lamps that the eye sees: their faces clipped to the pixels.

A lamp's face is a hundred times as bright as the street and, far away, smaller than a pixel: whether one of a
pixel's rays meets it is luck, and the brightest points of a night came and went with the seed.  Here each face is cut
at the pixels' edges (Sutherland and Hodgman 1974), and every piece is asked for certain, by a ray through a random
point of it.  What is left to chance is what hides it.

Takes a loaded scene with a pinhole and its lamps; gives `VisibleFaces`.  Lamps that cover many pixels, or reach behind
the near plane, are left to chance, as all are where the camera has a lens, is a fisheye or moves.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np

from synfog_usd.base.arrays import Array, Indices, Pixels
from synfog_usd.render import backend
from synfog_usd.render.lights.importance import emitter_index
from synfog_usd.render.load import MitsubaScene, is_thin_lens

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float, UInt32
    from mitsuba import Point2f

    from synfog_usd.render.lights.sampler import LightSampler
    from synfog_usd.scene import Camera

MOST_PX, MOST_SHARE = 256.0, 1.0 / 16.0
"""Pixels that a lamp covers, and their share of the picture, beyond which it is large enough for chance."""

MOST_LOOKED_THROUGH = 4096.0
"""Pixels of the boxes around a lamp's faces, all together, from which on it is left to chance: a thin tube across the
picture covers few of those that it passes."""

MOST_FACES = 2048
"""Faces of a lamp from which on it is left to chance: cutting them would take longer than they are worth."""

LEAST_PX = 1e-9
"""Area of a piece [pixels] below which it is dropped: rounding."""

Point = tuple[float, float]


class VisibleFaces:
    """Pieces of lamps' faces, each within one pixel.

    Args:
        begin: (P + 1,) number of each pixel's first piece.
        corners: (N, 3, 2) of each piece, a triangle [pixels].
        area: (N,) [pixels].
        owner: (N, 2) its emitter's index and its face's number.
        lamps: (L,) whether the faces of each lamp are all in, by `LightSampler`'s numbers.

    Attributes:
        count: how many pieces there are.
    """

    def __init__(self, begin: Indices, corners: Array, area: Array, owner: Indices, lamps: Pixels) -> None:
        self.count = len(area)
        if not self.count:
            corners, area, owner = np.zeros((1, 3, 2)), np.zeros(1), np.zeros((1, 2), dtype=np.int64)
        self.begin, self.lamps = backend.numbers(begin), backend.numbers(lamps)
        self.corners = [backend.floats(column) for column in corners.reshape(-1, 6).T]
        self.area, self.owner = backend.floats(area), [backend.numbers(column) for column in owner.T]

    @classmethod
    def of(cls, loaded: MitsubaScene, lights: LightSampler) -> VisibleFaces | None:
        """A scene's; None where it has no lit faces, or its camera is no pinhole that stands still."""
        camera, world = loaded.source.camera, loaded.source.world
        meshes = [number for number, key in enumerate(lights.keys) if (key,) in loaded.shapes]
        if not meshes or camera.moves or not camera.plane or is_thin_lens(camera):
            return None
        pieces: list[tuple[int, tuple[Point, Point, Point], float, int, int]] = []
        held = np.zeros(lights.count, dtype=np.uint32)
        for number in meshes:
            part, faces = world[lights.keys[number]], lights.row_numbers[number]
            corners = np.asarray(part["positions"], dtype=np.float64)[np.asarray(part["faces"], dtype=np.int64)[faces]]
            if len(corners) > MOST_FACES or (placed := _in_picture(corners, camera)) is None:
                continue
            if "normals" in part:  # its shading decides which side shines
                placed[1][:] = True
            held[number], emitter = 1, emitter_index(loaded.shapes[(lights.keys[number],)].emitter())
            for row in np.flatnonzero(placed[1]):
                for pixel, triangle, area in _cut(placed[0][row], camera.width_px, camera.height_px):
                    pieces.append((pixel, triangle, area, emitter, int(faces[row])))
        pieces.sort(key=lambda piece: piece[0])
        return cls(
            np.searchsorted([piece[0] for piece in pieces], np.arange(camera.width_px * camera.height_px + 1)),
            np.array([piece[1] for piece in pieces]),
            np.array([piece[2] for piece in pieces]),
            np.array([piece[3:] for piece in pieces], dtype=np.int64),
            held,
        )

    def pieces(self, pixel: UInt32) -> tuple[UInt32, UInt32]:
        """Numbers of pixels' first pieces, and of those after their last."""
        mi = backend.mitsuba()
        return dr.gather(mi.UInt32, self.begin, pixel), dr.gather(mi.UInt32, self.begin, pixel + 1)

    def point(self, piece: UInt32, u: Point2f) -> tuple[Point2f, Float, UInt32, UInt32]:
        """A point in a piece [pixels], its area, its emitter's index and its face's number."""
        mi = backend.mitsuba()
        ax, ay, bx, by, cx, cy = (dr.gather(mi.Float, column, piece) for column in self.corners)
        root = dr.sqrt(u.x)
        a, b, c = 1.0 - root, root * (1.0 - u.y), root * u.y
        place = mi.Point2f(ax * a + bx * b + cx * c, ay * a + by * b + cy * c)
        owner, face = (dr.gather(mi.UInt32, column, piece) for column in self.owner)
        return place, dr.gather(mi.Float, self.area, piece), owner, face

    def holds(self, lamp: UInt32, active: Bool) -> Bool:
        """Whether a lamp's faces are all in, so that no path must count them where the eye sees them."""
        return active & (dr.gather(backend.mitsuba().UInt32, self.lamps, lamp, active) > 0)


def _in_picture(corners: Array, camera: Camera) -> tuple[Array, Array] | None:
    """(F, 3, 2) corners of faces [pixels] and which of them face the eye; None where they are left to chance."""
    eye, turn = camera.to_world[:3, 3], camera.to_world[:3, :3]
    local = (corners - eye) @ turn
    front = (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) * (eye - corners[:, 0])).sum(
        1
    ) > 0.0
    if not front.any() or (-local[..., 2]).min() <= max(camera.near_m, 1e-3):
        return None
    width = 2.0 * np.tan(np.radians(camera.fov_x_deg) / 2.0)
    plane = local[..., :2] / -local[..., 2:] / width
    x = (0.5 + plane[..., 0] - camera.shift[0]) * camera.width_px
    y = (0.5 + camera.shift[1]) * camera.height_px - plane[..., 1] * camera.width_px
    u, v = np.clip(x[front], 0.0, camera.width_px), np.clip(y[front], 0.0, camera.height_px)
    doubled = (u[:, 1] - u[:, 0]) * (v[:, 2] - v[:, 0]) - (u[:, 2] - u[:, 0]) * (v[:, 1] - v[:, 0])
    covered, pixels = 0.5 * np.abs(doubled).sum(), camera.width_px * camera.height_px
    boxes = ((np.ptp(u, axis=1) + 1.0) * (np.ptp(v, axis=1) + 1.0)).sum()  # pixels that are looked through
    if not 0.0 < covered <= min(MOST_PX, MOST_SHARE * pixels) or boxes > MOST_LOOKED_THROUGH:
        return None
    return np.stack([x, y], axis=-1), front


def _cut(triangle: Array, width: int, height: int) -> list[tuple[int, tuple[Point, Point, Point], float]]:
    """(pixel, triangle, area) of the pieces of a triangle in each pixel."""
    corners: list[Point] = [(float(x), float(y)) for x, y in triangle]
    rows = range(max(int(np.floor(triangle[:, 1].min())), 0), min(int(np.ceil(triangle[:, 1].max())), height))
    columns = range(max(int(np.floor(triangle[:, 0].min())), 0), min(int(np.ceil(triangle[:, 0].max())), width))
    pieces = []
    for row in rows:
        strip = _clipped(_clipped(corners, 1, row, 1.0), 1, row + 1, -1.0)
        for column in columns:
            outline = _clipped(_clipped(strip, 0, column, 1.0), 0, column + 1, -1.0)
            for second, third in itertools.pairwise(outline[1:]):
                piece = (outline[0], second, third)
                if (area := _area(piece)) > LEAST_PX:
                    pieces.append((row * width + column, piece, area))
    return pieces


def _clipped(outline: list[Point], axis: int, at: float, side: float) -> list[Point]:
    """The part of a convex outline where side x (coordinate - at) >= 0."""
    corners: list[Point] = []
    for a, b in zip(outline, outline[1:] + outline[:1], strict=True):
        here, there = side * (a[axis] - at), side * (b[axis] - at)
        if here >= 0.0:
            corners.append(a)
        if (here >= 0.0) != (there >= 0.0):
            share = here / (here - there)
            corners.append((a[0] + (b[0] - a[0]) * share, a[1] + (b[1] - a[1]) * share))
    return corners


def _area(piece: tuple[Point, Point, Point]) -> float:
    (ax, ay), (bx, by), (cx, cy) = piece
    return 0.5 * abs((bx - ax) * (cy - ay) - (cx - ax) * (by - ay))
