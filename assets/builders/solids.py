"""Solid bodies from signed distances, and what is cut out of them.

A body comes as a function of space and leaves as triangles (`surface`); painted areas and
openings are cut out of them exactly, by planes (`carve`).  Lengths in metres.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from synfog_usd.world.shapes import COLLAPSE, Array, Index, Part, join

Field = Callable[[Array, Array, Array], Array]


def rounded(outline: npt.ArrayLike, passes: int = 3, keep: float = 0.25) -> Array:
    """A closed 2-D outline with its corners cut `passes` times (Chaikin)."""
    p = np.asarray(outline, dtype=np.float64)
    for _ in range(passes):
        q = np.roll(p, -1, axis=0)
        p = np.stack([(1 - keep) * p + keep * q, keep * p + (1 - keep) * q], axis=1).reshape(-1, 2)
    return p


def filleted(outline: npt.ArrayLike, setback: float, *, closed: bool = True, points: int = 5) -> Array:
    """A 2-D outline whose corners are parabolas that begin `setback` [m] before them, at most half-way to the next."""
    p = np.asarray(outline, dtype=np.float64)
    before, after = np.roll(p, 1, axis=0) - p, np.roll(p, -1, axis=0) - p
    begin, end = (
        p + edge * np.minimum(0.5, setback / np.sqrt((edge * edge).sum(axis=1, keepdims=True)))
        for edge in (before, after)
    )
    t = np.linspace(0, 1, points)[None, :, None]
    bent = (1 - t) ** 2 * begin[:, None] + 2 * t * (1 - t) * p[:, None] + t**2 * end[:, None]
    return bent.reshape(-1, 2) if closed else np.concatenate([p[:1], bent[1:-1].reshape(-1, 2), p[-1:]])


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


def limb_distance(
    x: Array, y: Array, z: Array, start: npt.ArrayLike, end: npt.ArrayLike, r0: float, r1: float
) -> Array:
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


def surface(
    field: Field,
    low: Sequence[float],
    high: Sequence[float],
    *,
    step: float,
    triangles: int,
    material: str,
    coarse: int = 1,
) -> Part:
    """The zero surface of a signed distance as about `triangles` smooth triangles.

    Surface nets on a grid of `step` [m], simplified by quadric edge collapse, then
    every vertex is pulled back onto the surface and takes its normal from the
    gradient there.  With `coarse` above 1 the field is asked on a grid so many times
    wider first, and on the fine one near the surface only.
    """
    axes = [np.arange(a, b + step, step) for a, b in zip(low, high, strict=True)]
    values = _sampled(field, axes, step, coarse)
    points, faces = _surface_nets(values, np.asarray(low, dtype=np.float64), step)
    if len(faces) > triangles:
        points, faces = _simplified(points, faces, triangles)
    for _ in range(4):
        g = gradient(field, points)
        f = field(*points.T)
        move = -f[:, None] * g / np.maximum((g * g).sum(axis=1, keepdims=True), 0.05)
        points = points + np.clip(move, -step / 2, step / 2)
    g = gradient(field, points)
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


def _only(part: Part, faces: Index) -> Part:
    used, inverse = np.unique(faces, return_inverse=True)
    return replace(
        part,
        points=part.points[used],
        faces=inverse.reshape(-1, 3).astype(np.int64),
        uv=None if part.uv is None else part.uv[used],
        normals=None if part.normals is None else part.normals[used],
    )


def _sampled(field: Field, axes: Sequence[Array], step: float, coarse: int) -> Array:
    """Values of a field on a grid; where a wider grid shows that the surface is far, the nearest value of that."""
    wide = field(*np.meshgrid(*(axis[::coarse] for axis in axes), indexing="ij"))
    if coarse == 1:
        return wide
    nearest = np.ix_(
        *(np.minimum((np.arange(len(a)) + coarse // 2) // coarse, n - 1) for a, n in zip(axes, wide.shape, strict=True))
    )
    values = wide[nearest]
    near = np.nonzero(np.abs(values) < 1.5 * coarse * step)
    values[near] = field(*(axis[index] for axis, index in zip(axes, near, strict=True)))
    return values


def gradient(field: Field, points: Array, e: float = 2e-3) -> Array:
    """(N, 3) gradient of a field at points, from differences over 2 `e` [m]."""
    x, y, z = points.T
    return np.stack(
        [
            field(x + e, y, z) - field(x - e, y, z),
            field(x, y + e, z) - field(x, y - e, z),
            field(x, y, z + e) - field(x, y, z - e),
        ],
        axis=1,
    ) / (2 * e)


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


def _simplified(points: Array, faces: Index, triangles: int) -> tuple[Array, Index]:
    import pymeshlab

    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(points, faces.astype(np.int32)))
    meshes.meshing_decimation_quadric_edge_collapse(**{**COLLAPSE, "preservetopology": True}, targetfacenum=triangles)
    mesh = meshes.current_mesh()
    return np.array(mesh.vertex_matrix()), np.array(mesh.face_matrix(), dtype=np.int64)
