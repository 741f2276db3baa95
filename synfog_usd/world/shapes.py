"""Triangles with a material name: made, moved, cut and smoothed.

Takes numbers in metres; gives `Part`s, which the asset writer turns into meshes.
Solid bodies come as signed distances and leave as triangles (`surface`); painted
areas and openings are cut out of them exactly, by planes (`carve`).  Knows
nothing of USD or files.
"""

# ruff: noqa: RUF005 -- offsets are added to arrays, which only look like lists
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy import sparse

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]
Field = Callable[[Array, Array, Array], Array]

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
"""Everything that pymeshlab's quadric edge collapse can be told: what is left out it takes from its last call, and bytes would depend on that."""


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
        uv=np.concatenate([p.uv if p.uv is not None else np.zeros((len(p.points), 2)) for p in parts]) if textured else None,
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


def shaded(part: Part, crease_deg: float = 40.0) -> Part:
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
    weights = sparse.csr_matrix((area[corner_face[pairs.col[keep]]], (pairs.row[keep], corner_face[pairs.col[keep]])), shape=(len(corner_vertex), len(n)))
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


def box(low: Sequence[float], high: Sequence[float], material: str, *, tile_m: float = 1.0, bottom: bool = True) -> Part:
    """An upright box between two corners, textured in metres over `tile_m`."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    p = [(x0, y0, z0), (x1, y0, z0), (x1, y1, z0), (x0, y1, z0), (x0, y0, z1), (x1, y0, z1), (x1, y1, z1), (x0, y1, z1)]
    rows = [(0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7), (4, 5, 6, 7)] + ([(3, 2, 1, 0)] if bottom else [])
    dx, dy, dz = ((x1 - x0) / tile_m, (y1 - y0) / tile_m, (z1 - z0) / tile_m)
    spans = [(dx, dz), (dy, dz), (dx, dz), (dy, dz), (dx, dy), (dx, dy)]
    uv = [[(0, 0), (u, 0), (u, v), (0, v)] for u, v in spans[: len(rows)]]
    return quads([[p[i] for i in row] for row in rows], material, uv)


def soft_box(low: Sequence[float], high: Sequence[float], material: str, *, radius: float, sides: int = 3) -> Part:
    """A box with rounded upright edges and a rounded top rim, `radius` [m] wide."""
    low_a, high_a = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
    middle, half = (low_a + high_a) / 2, (high_a - low_a) / 2
    r = min(radius, 0.95 * float(half[:2].min()), 0.95 * 2 * float(half[2]))
    angle = np.concatenate([np.linspace(q * np.pi / 2, (q + 1) * np.pi / 2, sides + 1) for q in range(4)])
    corner = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]).repeat(sides + 1, axis=0) * (half[:2] - r)
    rim = np.linspace(0, np.pi / 2, sides + 1)
    rings = [(r, -half[2])] + [(r * np.cos(t), half[2] - r + r * np.sin(t)) for t in rim]
    loops = [np.c_[corner + radius_ring * np.c_[np.cos(angle), np.sin(angle)], np.full(len(angle), z)] for radius_ring, z in rings]
    skin = strip(loops, material, closed=True)
    top = Part(np.vstack([loops[-1], [(0, 0, half[2])]]), np.array([(i, (i + 1) % len(angle), len(angle)) for i in range(len(angle))]), material)
    return shaded(join([skin, top]), 50).moved(shift(*middle))


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
    return shaded(part, crease_deg)


def tube(path: npt.ArrayLike, radii: npt.ArrayLike, material: str, *, sides: int = 8, tile_m: float = 1.0, capped: bool = True, smooth: bool = True) -> Part:
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
        parts.append(Part(np.vstack([loop, centre]), faces[:, ::-1] if flip else faces, material, np.zeros((sides + 2, 2))))
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


def rounded(outline: npt.ArrayLike, passes: int = 3, keep: float = 0.25) -> Array:
    """A closed 2-D outline with its corners cut `passes` times (Chaikin)."""
    p = np.asarray(outline, dtype=np.float64)
    for _ in range(passes):
        q = np.roll(p, -1, axis=0)
        p = np.stack([(1 - keep) * p + keep * q, keep * p + (1 - keep) * q], axis=1).reshape(-1, 2)
    return p


def outline_distance(outline: Array, u: Array, v: Array) -> Array:
    """Signed distance [m] of points (u, v) to a closed outline, negative inside."""
    d = np.full(u.shape, np.inf)
    odd = np.zeros(u.shape, dtype=bool)
    for (ax, ay), (bx, by) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        ex, ey = bx - ax, by - ay
        wx, wy = u - ax, v - ay
        t = np.clip((wx * ex + wy * ey) / max(ex * ex + ey * ey, 1e-18), 0, 1)
        np.minimum(d, (wx - t * ex) ** 2 + (wy - t * ey) ** 2, out=d)
        if ay != by:
            odd ^= ((ay > v) != (by > v)) & (u < ax + ex * (v - ay) / ey)
    return np.where(odd, -1.0, 1.0) * np.sqrt(d)


def soft_min(a: Array, b: Array, k: float) -> Array:
    """The smaller of two distances with a fillet about `k` wide where they meet."""
    h = np.maximum(k - np.abs(a - b), 0) / k
    return np.minimum(a, b) - h * h * k / 4


def soft_max(a: Array, b: Array, k: float) -> Array:
    """The larger of two distances with an edge rounded over about `k`."""
    return -soft_min(-a, -b, k)


def limb_distance(x: Array, y: Array, z: Array, start: npt.ArrayLike, end: npt.ArrayLike, r0: float, r1: float) -> Array:
    """Distance to a limb: a bar from `start` to `end` whose radius goes from r0 to r1."""
    a, b = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    e = b - a
    w = (x - a[0], y - a[1], z - a[2])
    t = np.clip((w[0] * e[0] + w[1] * e[1] + w[2] * e[2]) / max(float(e @ e), 1e-18), 0, 1)
    return np.sqrt((w[0] - t * e[0]) ** 2 + (w[1] - t * e[1]) ** 2 + (w[2] - t * e[2]) ** 2) - (r0 + (r1 - r0) * t)


def blob_distance(x: Array, y: Array, z: Array, centre: Sequence[float], radii: Sequence[float]) -> Array:
    """Approximate distance to an ellipsoid; exact on its surface."""
    px, py, pz = ((q - c) / r for q, c, r in zip((x, y, z), centre, radii, strict=True))
    k0 = np.sqrt(px**2 + py**2 + pz**2)
    k1 = np.sqrt((px / radii[0]) ** 2 + (py / radii[1]) ** 2 + (pz / radii[2]) ** 2)
    return k0 * (k0 - 1) / np.maximum(k1, 1e-9)


def surface(field: Field, low: Sequence[float], high: Sequence[float], *, step: float, triangles: int, material: str) -> Part:
    """The zero surface of a signed distance as about `triangles` smooth triangles.

    Surface nets on a grid of `step` [m], thinned by quadric edge collapse, then
    every vertex is pulled back onto the surface and takes its normal from the
    gradient there.
    """
    axes = [np.arange(a, b + step, step) for a, b in zip(low, high, strict=True)]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    values = field(x, y, z)
    points, faces = _surface_nets(values, np.asarray(low, dtype=np.float64), step)
    if len(faces) > triangles:
        points, faces = _thinned(points, faces, triangles)
    for _ in range(4):
        g = _gradient(field, points)
        f = field(*points.T)
        move = -f[:, None] * g / np.maximum((g * g).sum(axis=1, keepdims=True), 0.05)
        points = points + np.clip(move, -step / 2, step / 2)
    g = _gradient(field, points)
    return Part(points, faces, material, normals=g / np.maximum(np.linalg.norm(g, axis=1, keepdims=True), 1e-12))


def split(part: Part, field: Array) -> tuple[Part, Part]:
    """Cut triangles where a field over the points, linear in each, is zero: (below, above)."""
    f = np.where(np.abs(field) < 1e-7, 1e-7, field)
    above = f > 0
    count = above[part.faces].sum(axis=1)
    mixed = part.faces[(count == 1) | (count == 2)]
    if len(mixed) == 0:
        return _only(part, part.faces[count == 0]), _only(part, part.faces[count == 3])
    side = above[mixed]
    lone_above = side.sum(axis=1) == 1
    lone = np.argmax(side == lone_above[:, None], axis=1)
    rows = np.arange(len(mixed))
    a, b, c = mixed[rows, lone], mixed[rows, (lone + 1) % 3], mixed[rows, (lone + 2) % 3]
    edges = np.sort(np.concatenate([np.c_[a, b], np.c_[a, c]]), axis=1)
    edges, where = np.unique(edges, axis=0, return_inverse=True)
    t = (f[edges[:, 0]] / (f[edges[:, 0]] - f[edges[:, 1]]))[:, None]
    count_points = len(part.points)
    p, q = count_points + where.reshape(-1)[: len(mixed)], count_points + where.reshape(-1)[len(mixed) :]

    def grown(data: Array | None) -> Array | None:
        return None if data is None else np.concatenate([data, data[edges[:, 0]] * (1 - t) + data[edges[:, 1]] * t])

    points = grown(part.points)
    assert points is not None
    bigger = replace(part, points=points, uv=grown(part.uv), normals=grown(part.normals))
    tip, rest = np.c_[a, p, q], np.concatenate([np.c_[p, b, c], np.c_[p, c, q]])
    twice = np.r_[lone_above, lone_above]
    low_faces = np.concatenate([part.faces[count == 0], tip[~lone_above], rest[twice]])
    high_faces = np.concatenate([part.faces[count == 3], tip[lone_above], rest[~twice]])
    return _only(bigger, low_faces), _only(bigger, high_faces)


def carve(part: Part, planes: Sequence[Callable[[Array], Array]]) -> tuple[Part, Part]:
    """Cut out what lies below every plane: (inside, the rest).  A plane gives (N,) from points (N, 3)."""
    outside = np.zeros(len(part.faces), dtype=bool)
    for plane in planes:  # what lies wholly beyond one plane need not be cut by the others
        outside |= (plane(part.points) >= 0)[part.faces].all(axis=1)
    rest = [_only(part, part.faces[outside])]
    inside = _only(part, part.faces[~outside])
    for plane in planes:
        if len(inside.faces) == 0:
            break
        inside, out = split(inside, plane(inside.points))
        rest.append(out)
    return inside, join([*rest]) if any(len(r.faces) for r in rest) else _only(part, part.faces[:0])


def prism(outline: npt.ArrayLike, axes: tuple[int, int]) -> list[Callable[[Array], Array]]:
    """Planes of a convex outline, counter-clockwise in the given two axes, endless along the third."""
    p = np.asarray(outline, dtype=np.float64)
    planes = []
    for a, b in zip(p, np.roll(p, -1, axis=0), strict=True):
        n = np.array([b[1] - a[1], a[0] - b[0]]) / max(float(np.hypot(*(b - a))), 1e-12)
        planes.append(lambda q, a=a, n=n: (q[:, axes[0]] - a[0]) * n[0] + (q[:, axes[1]] - a[1]) * n[1])
    return planes


def _faceted(part: Part) -> Part:
    corner = part.faces.ravel()
    return Part(
        part.points[corner],
        np.arange(len(corner)).reshape(-1, 3),
        part.material,
        None if part.uv is None else part.uv[corner],
        np.repeat(face_normals(part), 3, axis=0),
    )


def _only(part: Part, faces: Index) -> Part:
    used, inverse = np.unique(faces, return_inverse=True)
    return replace(
        part,
        points=part.points[used],
        faces=inverse.reshape(-1, 3).astype(np.int64),
        uv=None if part.uv is None else part.uv[used],
        normals=None if part.normals is None else part.normals[used],
    )


def _without_slivers(part: Part) -> Part:
    a, b, c = (part.points[part.faces[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return replace(part, faces=part.faces[area > 1e-10])


def _gradient(field: Field, points: Array, e: float = 2e-3) -> Array:
    x, y, z = points.T
    return np.stack([field(x + e, y, z) - field(x - e, y, z), field(x, y + e, z) - field(x, y - e, z), field(x, y, z + e) - field(x, y, z - e)], axis=1) / (
        2 * e
    )


def _surface_nets(values: Array, low: Array, step: float) -> tuple[Array, Index]:
    inside = values < 0
    shape = np.array(values.shape) - 1
    offsets = [(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)]

    def corner(data: npt.NDArray, o: tuple[int, ...]) -> npt.NDArray:
        return data[o[0] : o[0] + shape[0], o[1] : o[1] + shape[1], o[2] : o[2] + shape[2]]

    total = np.sum([corner(inside, o) for o in offsets], axis=0)
    mixed = (total > 0) & (total < 8)
    index = np.full(tuple(shape), -1)
    cells = np.argwhere(mixed)
    index[mixed] = np.arange(len(cells))
    v = np.stack([corner(values, o)[mixed] for o in offsets], axis=1)
    o = np.array(offsets, dtype=np.float64)
    total_position, hits = np.zeros((len(cells), 3)), np.zeros(len(cells))
    for a in range(8):
        for b in range(a + 1, 8):
            if np.abs(o[a] - o[b]).sum() != 1:
                continue
            cross = (v[:, a] < 0) != (v[:, b] < 0)
            t = np.where(cross, v[:, a] / np.where(cross, v[:, a] - v[:, b], 1), 0)
            total_position += np.where(cross[:, None], o[a] + t[:, None] * (o[b] - o[a]), 0)
            hits += cross
    points = low + step * (cells + total_position / hits[:, None])
    faces = []
    for axis in range(3):
        j, k = (axis + 1) % 3, (axis + 2) % 3
        lower = [slice(None)] * 3
        upper = [slice(None)] * 3
        lower[axis], upper[axis] = slice(0, -1), slice(1, None)
        change = inside[tuple(lower)] != inside[tuple(upper)]
        at = np.argwhere(change)
        at = at[(at[:, j] > 0) & (at[:, k] > 0) & (at[:, j] < shape[j]) & (at[:, k] < shape[k])]
        step_j, step_k = np.eye(3, dtype=np.int64)[j], np.eye(3, dtype=np.int64)[k]
        ring = [index[tuple((at - s).T)] for s in (step_j + step_k, step_k, 0 * step_j, step_j)]
        loop = np.stack(ring, axis=1)
        outward = inside[tuple(at.T)]
        loop = np.where(outward[:, None], loop, loop[:, ::-1])
        faces += [loop[:, [0, 1, 2]], loop[:, [0, 2, 3]]]
    return points, np.concatenate(faces)


def _thinned(points: Array, faces: Index, triangles: int) -> tuple[Array, Index]:
    import pymeshlab

    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(points, faces.astype(np.int32)))
    meshes.meshing_decimation_quadric_edge_collapse(**{**COLLAPSE, "preservetopology": True}, targetfacenum=triangles)
    mesh = meshes.current_mesh()
    return np.array(mesh.vertex_matrix()), np.array(mesh.face_matrix(), dtype=np.int64)
