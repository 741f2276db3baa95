"""Triangles with a material name: made, moved, joined and smoothed.

Takes numbers in metres; gives `Part`s, which `components` turns into meshes.  Knows
nothing of USD or files.
"""

# ruff: noqa: RUF005 -- offsets are added to arrays, which only look like lists
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy import sparse

from synfog_usd.base.arrays import Array
from synfog_usd.base.arrays import Indices as Index

COLLAPSE = {
    "targetperc": 0.0,
    "qualitythr": 0.3,
    "preserveboundary": False,
    "boundaryweight": 1.0,
    "preservenormal": True,
    "preservetopology": False,
    "optimalplacement": True,
    "planarquadric": False,
    "planarweight": 0.001,
    "qualityweight": False,
    "autoclean": True,
    "selected": False,
}
"""Everything that pymeshlab's quadric edge collapse can be told: what is left out it takes from its last call, and
bytes would depend on that.
"""


@dataclass(frozen=True)
class Part:
    """Triangles of one material.

    Attributes:
        points: (N, 3) float64 [m].
        faces: (M, 3) int64, counter-clockwise seen from outside.
        material: name of the material.
        uv: (N, 2) texture coordinates or None.
        normals: (N, 3) unit normals, or None for flat faces.
    """

    points: Array
    faces: Index
    material: str
    uv: Array | None = None
    normals: Array | None = None

    def moved(self, matrix: npt.ArrayLike) -> Part:
        """The part under a (4, 4) matrix of column vectors; a mirror turns the faces round."""
        m = np.asarray(matrix, dtype=np.float64)
        points = self.points @ m[:3, :3].T + m[:3, 3]
        faces = self.faces if np.linalg.det(m[:3, :3]) > 0 else self.faces[:, ::-1]
        normals = None
        if self.normals is not None:
            normals = self.normals @ np.linalg.inv(m[:3, :3])
            normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        return replace(self, points=points, faces=faces, normals=normals)

    def painted(self, material: str) -> Part:
        """The same triangles in another material."""
        return replace(self, material=material)


def shift(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Array:
    """(4, 4) translation [m]."""
    m = np.eye(4)
    m[:3, 3] = x, y, z
    return m


def turn(degrees: float, axis: str = "z") -> Array:
    """(4, 4) rotation about a coordinate axis, counter-clockwise seen from its tip."""
    a, m = np.deg2rad(degrees), np.eye(4)
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    m[i, i] = m[j, j] = np.cos(a)
    m[i, j], m[j, i] = -np.sin(a), np.sin(a)
    return m


def scale(x: float, y: float, z: float) -> Array:
    """(4, 4) scaling."""
    return np.diag([x, y, z, 1.0])


def join(parts: Sequence[Part], material: str | None = None) -> Part:
    """One part out of several of the same material; flat ones keep their edges."""
    parts = [p for p in parts if len(p.faces)]
    smooth = any(p.normals is not None for p in parts)
    if smooth:
        parts = [p if p.normals is not None else _faceted(p) for p in parts]
    offsets = np.cumsum([0] + [len(p.points) for p in parts[:-1]])
    textured = any(p.uv is not None for p in parts)
    return Part(
        points=np.concatenate([p.points for p in parts]),
        faces=np.concatenate([p.faces + o for p, o in zip(parts, offsets, strict=True)]),
        material=material or parts[0].material,
        uv=np.concatenate([p.uv if p.uv is not None else np.zeros((len(p.points), 2)) for p in parts])
        if textured
        else None,
        normals=np.concatenate([p.normals for p in parts if p.normals is not None]) if smooth else None,
    )


def by_material(parts: Sequence[Part]) -> dict[str, Part]:
    """Parts joined so that each material has one, in the order of first use."""
    groups: dict[str, list[Part]] = {}
    for part in parts:
        if len(part.faces):
            groups.setdefault(part.material, []).append(part)
    return {name: join(group, name) for name, group in groups.items()}


def face_normals(part: Part) -> Array:
    """(M, 3) unit normals of the triangles."""
    a, b, c = (part.points[part.faces[:, i]] for i in range(3))
    n = np.cross(b - a, c - a)
    return n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-15)


def smooth_normals(part: Part, crease_deg: float = 40.0) -> Part:
    """The part with smooth normals, but for edges sharper than `crease_deg`."""
    n = face_normals(part)
    _, vertex = np.unique(np.round(part.points, 5), axis=0, return_inverse=True)
    corner_vertex = vertex.reshape(-1)[part.faces.ravel()]
    corner_face = np.repeat(np.arange(len(part.faces)), 3)
    a, b, c = (part.points[part.faces[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    incidence = sparse.csr_matrix((np.ones(len(corner_vertex)), (np.arange(len(corner_vertex)), corner_vertex)))
    pairs = (incidence @ incidence.T).tocoo()
    keep = np.einsum("ij,ij->i", n[corner_face[pairs.row]], n[corner_face[pairs.col]]) > np.cos(np.deg2rad(crease_deg))
    weights = sparse.csr_matrix(
        (area[corner_face[pairs.col[keep]]], (pairs.row[keep], corner_face[pairs.col[keep]])),
        shape=(len(corner_vertex), len(n)),
    )
    normals = weights @ n
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-15)
    corner_point = part.faces.ravel()
    uv = part.uv[corner_point] if part.uv is not None else np.zeros((len(corner_point), 2))
    key = np.round(np.c_[part.points[corner_point], normals * 0.05, uv], 4)
    _, first, inverse = np.unique(key, axis=0, return_index=True, return_inverse=True)
    return Part(
        points=part.points[corner_point][first],
        faces=inverse.reshape(-1, 3),
        material=part.material,
        uv=uv[first] if part.uv is not None else None,
        normals=normals[first],
    )


def quad(corners: npt.ArrayLike, material: str, uv: npt.ArrayLike | None = None) -> Part:
    """Four corners, counter-clockwise, as two triangles."""
    coordinates = None if uv is None else np.asarray(uv, dtype=np.float64)
    return Part(np.asarray(corners, dtype=np.float64), np.array([[0, 1, 2], [0, 2, 3]]), material, coordinates)


def quads(corners: npt.ArrayLike, material: str, uv: npt.ArrayLike | None = None) -> Part:
    """(K, 4, 3) corners, counter-clockwise, as 2K triangles; `uv` is (K, 4, 2)."""
    points = np.asarray(corners, dtype=np.float64).reshape(-1, 3)
    base = 4 * np.arange(len(points) // 4)[:, None]
    faces = np.concatenate([base + [0, 1, 2], base + [0, 2, 3]], axis=1).reshape(-1, 3)
    return Part(points, faces, material, None if uv is None else np.asarray(uv, dtype=np.float64).reshape(-1, 2))


def box(
    low: Sequence[float],
    high: Sequence[float],
    material: str,
    *,
    tile_m: float = 1.0,
    bottom: bool = True,
    back: bool = True,
) -> Part:
    """An upright box between two corners, textured in metres over `tile_m`; `back` is its face towards -Y."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    p = [(x0, y0, z0), (x1, y0, z0), (x1, y1, z0), (x0, y1, z0), (x0, y0, z1), (x1, y0, z1), (x1, y1, z1), (x0, y1, z1)]
    rows = [(0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7), (4, 5, 6, 7)] + ([(3, 2, 1, 0)] if bottom else [])
    dx, dy, dz = ((x1 - x0) / tile_m, (y1 - y0) / tile_m, (z1 - z0) / tile_m)
    spans = [(dx, dz), (dy, dz), (dx, dz), (dy, dz), (dx, dy), (dx, dy)]
    uv = [[(0, 0), (u, 0), (u, v), (0, v)] for u, v in spans[: len(rows)]]
    sides = slice(0 if back else 1, None)
    return quads([[p[i] for i in row] for row in rows[sides]], material, uv[sides])


def soft_box(low: Sequence[float], high: Sequence[float], material: str, *, radius: float, sides: int = 3) -> Part:
    """A box with rounded upright edges and a rounded top rim, `radius` [m] wide."""
    low_a, high_a = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
    middle, half = (low_a + high_a) / 2, (high_a - low_a) / 2
    r = min(radius, 0.95 * float(half[:2].min()), 0.95 * 2 * float(half[2]))
    angle = np.concatenate([np.linspace(q * np.pi / 2, (q + 1) * np.pi / 2, sides + 1) for q in range(4)])
    corner = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]).repeat(sides + 1, axis=0) * (half[:2] - r)
    rim = np.linspace(0, np.pi / 2, sides + 1)
    rings = [(r, -half[2])] + [(r * np.cos(t), half[2] - r + r * np.sin(t)) for t in rim]
    loops = [
        np.c_[corner + radius_ring * np.c_[np.cos(angle), np.sin(angle)], np.full(len(angle), z)]
        for radius_ring, z in rings
    ]
    skin = strip(loops, material, closed=True)
    top = Part(
        np.vstack([loops[-1], [(0, 0, half[2])]]),
        np.array([(i, (i + 1) % len(angle), len(angle)) for i in range(len(angle))]),
        material,
    )
    return smooth_normals(join([skin, top]), 50).moved(shift(*middle))


def strip(loops: Sequence[Array], material: str, *, closed: bool = False, uv: Sequence[Array] | None = None) -> Part:
    """Quads between loops of equally many points; `closed` joins the last point to the first."""
    grid = np.stack([np.asarray(loop, dtype=np.float64) for loop in loops])
    coordinates = np.stack(uv) if uv is not None else None
    if closed:
        grid = np.concatenate([grid, grid[:, :1]], axis=1)
    rows, columns = grid.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (index[:-1, :-1].ravel(), index[:-1, 1:].ravel(), index[1:, 1:].ravel(), index[1:, :-1].ravel())
    faces = np.concatenate([np.c_[a, b, c], np.c_[a, c, d]])
    return Part(grid.reshape(-1, 3), faces, material, None if coordinates is None else coordinates.reshape(-1, 2))


def lathe(profile: Sequence[tuple[float, float]], material: str, *, sides: int = 16, crease_deg: float = 40.0) -> Part:
    """A profile of (radius, height) [m], bottom to top, turned about Z."""
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    loops = [np.c_[r * np.cos(angle), r * np.sin(angle), np.full(sides, z)] for r, z in profile]
    part = _without_slivers(strip(loops, material, closed=True))
    return smooth_normals(part, crease_deg)


def tube(
    path: npt.ArrayLike,
    radii: npt.ArrayLike,
    material: str,
    *,
    sides: int = 8,
    tile_m: float = 1.0,
    capped: bool = True,
    smooth: bool = True,
) -> Part:
    """A round bar along (K, 3) points with a radius at each; textured round and along."""
    p = np.asarray(path, dtype=np.float64)
    r = np.broadcast_to(np.asarray(radii, dtype=np.float64), len(p))
    along = np.gradient(p, axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    first = np.cross(along[0], (0.0, 0.0, 1.0) if abs(along[0, 2]) < 0.9 else (1.0, 0.0, 0.0))
    sideways = first / np.linalg.norm(first)
    length = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))]
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    loops, uv, normals = [], [], []
    for point, direction, radius, at in zip(p, along, r, length, strict=True):
        sideways = sideways - direction * (sideways @ direction)
        sideways /= np.linalg.norm(sideways)
        around = np.outer(np.cos(angle), sideways) + np.outer(np.sin(angle), np.cross(direction, sideways))
        loops.append(point + radius * around)
        normals.append(around)
        uv.append(np.c_[angle / (2 * np.pi), np.full(sides + 1, at / tile_m)])
    skin = strip(loops, material, uv=uv)
    skin = replace(skin, normals=np.concatenate(normals)) if smooth else skin
    if not capped:
        return skin
    parts = [skin]
    for loop, centre, flip in ((loops[0], p[0], True), (loops[-1], p[-1], False)):
        faces = np.array([(i, i + 1, sides + 1) for i in range(sides)])
        parts.append(
            Part(np.vstack([loop, centre]), faces[:, ::-1] if flip else faces, material, np.zeros((sides + 2, 2)))
        )
    return join(parts)


def ball(centre: Sequence[float], radii: Sequence[float], material: str, *, sides: int = 12) -> Part:
    """An ellipsoid."""
    t = np.linspace(-np.pi / 2, np.pi / 2, max(sides // 2, 3) + 1)
    part = lathe([(max(np.cos(a), 1e-6), np.sin(a)) for a in t], material, sides=sides, crease_deg=180)
    return part.moved(shift(*centre) @ scale(*radii))


def disc(centre: Sequence[float], radius: float, material: str, *, sides: int = 16) -> Part:
    """A flat disc that faces up; uv covers the unit square."""
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    rim = np.c_[np.cos(angle), np.sin(angle), np.zeros(sides)]
    points = np.vstack([rim * radius, [(0, 0, 0)]]) + np.asarray(centre)
    uv = np.vstack([rim[:, :2] / 2 + 0.5, [(0.5, 0.5)]])
    return Part(points, np.array([(i, (i + 1) % sides, sides) for i in range(sides)]), material, uv)


def fan(outline: npt.ArrayLike, material: str, *, tile_m: float = 1.0) -> Part:
    """A convex outline of (K, 3) points as a fan, textured in metres from above."""
    points = np.asarray(outline, dtype=np.float64)
    faces = np.array([(0, i, i + 1) for i in range(1, len(points) - 1)])
    return Part(points, faces, material, points[:, :2] / tile_m)


def rectangle(
    low: tuple[float, float], high: tuple[float, float], z: float, material: str, *, tile_m: float = 1.0
) -> Part:
    """A level rectangle between two corners, textured in metres from above."""
    (x0, y0), (x1, y1) = low, high
    return fan([(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z)], material, tile_m=tile_m)


def untextured(part: Part) -> Part:
    """Without texture coordinates, for materials without a texture."""
    return replace(part, uv=None)


def textured_from_above(part: Part, tile_m: float) -> Part:
    """With texture coordinates over `tile_m`, and flat."""
    return Part(part.points, part.faces, part.material, part.points[:, :2] / tile_m)


def _faceted(part: Part) -> Part:
    corner = part.faces.ravel()
    return Part(
        part.points[corner],
        np.arange(len(corner)).reshape(-1, 3),
        part.material,
        None if part.uv is None else part.uv[corner],
        np.repeat(face_normals(part), 3, axis=0),
    )


def _without_slivers(part: Part) -> Part:
    a, b, c = (part.points[part.faces[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return replace(part, faces=part.faces[area > 1e-10])
