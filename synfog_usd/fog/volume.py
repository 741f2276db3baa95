"""Where fog is: closed boundaries, what they contain, and which lies in which.

Takes meshes, boxes and spheres in metres; gives containment and optical depth.  A denser bank may lie wholly inside
another fog; `Boundary.meets` finds boundaries that cross, whose meaning is not clear.  Knows nothing of USD or Mitsuba.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.optimize import nnls

from synfog_usd.base.arrays import Array
from synfog_usd.base.errors import ParameterError
from synfog_usd.fog.grid import MAX_VOXELS
from synfog_usd.fog.medium import FogMedium

OPAQUE = 60.0
"""Optical depth beyond which a ray through a patchy field is black: e^-60 is 1e-26."""


@dataclass(frozen=True)
class Boundary:
    """A closed surface.

    Attributes:
        kind: 'box' and 'sphere' are the unit shapes [-1, 1]^3 and |p| <= 1 under
            `to_world`; 'mesh' is `vertices` and `faces` in world metres.
        to_world: (4, 4) float64, column vectors; identity for a mesh.
        vertices: (N, 3) float64 [m], for a mesh.
        faces: (M, 3) int, outward by the right-hand rule, for a mesh.
    """

    kind: Literal["box", "sphere", "mesh"]
    to_world: Array
    vertices: Array | None = None
    faces: npt.NDArray[np.int64] | None = None

    def __post_init__(self) -> None:
        if self.kind == "mesh":
            if self.vertices is None or self.faces is None or len(self.faces) < 4:
                raise ParameterError("a fog boundary needs a closed mesh of at least 4 triangles")
            span = np.ptp(self.vertices, axis=0).min()
        else:
            span = 2.0 * np.abs(np.linalg.svd(self.to_world[:3, :3], compute_uv=False)).min()
        if not span > 1e-3:
            raise ParameterError(f"a fog boundary only {span:.3g} m thick holds no fog")

    def contains(self, points_m: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Which of (N, 3) points [m] lie inside."""
        points = np.atleast_2d(np.asarray(points_m, dtype=np.float64))
        if self.kind == "mesh":
            return self._winding(points) > 0.5
        local = (np.linalg.inv(self.to_world) @ np.c_[points, np.ones(len(points))].T).T[:, :3]
        if self.kind == "box":
            return np.all(np.abs(local) <= 1.0, axis=1)
        return np.sum(local**2, axis=1) <= 1.0

    def interval(self, origin_m: Array, direction: Array) -> tuple[Array, Array]:
        """Where rays are inside a box or a sphere.

        Args:
            origin_m: (N, 3) [m].
            direction: (N, 3), unit length.

        Returns:
            distances (N,) [m] at which each ray enters, >= 0, and leaves; equal where it misses.

        Raises:
            ParameterError: for a mesh, which has no closed form.
        """
        if self.kind == "mesh":
            raise ParameterError("a mesh boundary has no closed form for its intervals")
        inverse = np.linalg.inv(self.to_world)
        o, d = origin_m @ inverse[:3, :3].T + inverse[:3, 3], direction @ inverse[:3, :3].T
        if self.kind == "box":
            d = np.where(np.abs(d) < 1e-15, 1e-15, d)
            low, high = (-1.0 - o) / d, (1.0 - o) / d
            near = functools.reduce(np.maximum, np.minimum(low, high).T)
            far = functools.reduce(np.minimum, np.maximum(low, high).T)
        else:
            a, b, c = (d * d).sum(axis=1), (o * d).sum(axis=1), (o * o).sum(axis=1) - 1.0
            root = np.sqrt(np.maximum(b * b - a * c, 0.0))
            near, far = (-b - root) / a, (-b + root) / a
        near = np.maximum(near, 0.0)
        return near, np.maximum(far, near)

    def surface_points(self) -> Array:
        """(N, 3) points [m] on the surface: corners, and centres of edges and faces."""
        if self.kind == "mesh":
            assert self.vertices is not None and self.faces is not None
            return np.concatenate([self.vertices, self.vertices[self.faces].mean(axis=1)])
        grid = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
        grid = grid[np.any(grid != 0.0, axis=1)]
        if self.kind == "sphere":
            grid = grid / np.linalg.norm(grid, axis=1, keepdims=True)
        return (self.to_world @ np.c_[grid, np.ones(len(grid))].T).T[:, :3]

    def extent(self) -> tuple[Array, Array]:
        """Corners (3,) [m] of a box along the world's axes around it."""
        if self.vertices is not None:
            return self.vertices.min(axis=0), self.vertices.max(axis=0)
        rows = np.abs(self.to_world[:3, :3])
        reach = rows.sum(axis=1) if self.kind == "box" else np.linalg.norm(rows, axis=1)
        return self.to_world[:3, 3] - reach, self.to_world[:3, 3] + reach

    def frame(self) -> Array:
        """Matrix (4, 4) from the unit box to the box of a density grid; a mesh's is along the world's axes."""
        if self.vertices is None:
            return self.to_world
        low, high = self.extent()
        matrix = np.diag([*((high - low) / 2.0), 1.0])
        matrix[:3, 3] = (low + high) / 2.0
        return matrix

    def meets(self, hull_m: Array) -> bool:
        """Whether the surface has a point in the convex hull of (N, 3) points [m].

        Exact to 1e-6 of the hull's size; touching counts.
        """
        if self.kind == "mesh":
            assert self.vertices is not None and self.faces is not None
            corners = self.vertices[self.faces]
            near = np.all(
                (corners.min(axis=1) <= hull_m.max(axis=0)) & (corners.max(axis=1) >= hull_m.min(axis=0)), axis=1
            )
            return any(_hulls_meet(hull_m, triangle) for triangle in corners[near])
        inverse = np.linalg.inv(self.to_world)
        local = hull_m @ inverse[:3, :3].T + inverse[:3, 3]
        if self.kind == "box":
            low, high = np.maximum(local.min(axis=0), -1.0), np.minimum(local.max(axis=0), 1.0)
            part = np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(
                -1, 3
            )  # of the box, around the hull
            return not np.all(np.abs(local) < 1.0) and bool(np.all(low <= high)) and _hulls_meet(local, part)
        nearest = (
            nnls(np.vstack([local.T, np.ones(len(local))]), np.array([0.0, 0.0, 0.0, 1.0]))[1] ** 2
        )  # is d^2 / (1 + d^2)
        return bool(nearest <= 0.5 and np.linalg.norm(local, axis=1).max() >= 1.0)

    def _winding(self, points: Array) -> Array:
        """Generalised winding number (Jacobson et al. 2013), by solid angles (Van Oosterom and Strackee 1983)."""
        assert self.vertices is not None and self.faces is not None
        total = np.zeros(len(points))
        for index, point in enumerate(points):
            a, b, c = np.moveaxis(self.vertices[self.faces] - point, 1, 0)
            la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
            top = np.einsum("ij,ij->i", a, np.cross(b, c))
            bottom = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
            total[index] = np.arctan2(top, bottom).sum() / (2.0 * np.pi)
        return np.abs(total)


@dataclass(frozen=True)
class FogVolume:
    """Fog within a boundary.

    Attributes:
        path: prim path of its source, for messages.
        boundary: where it is.
        medium: its extinction, profile and phase function.
        priority: where two overlap, the higher one fills the place.
        parent: index of the volume that surrounds it in `SceneDict.fog`, or None for clear air.
        origin_m: (3,) where a patchy field's own origin is [m]; it drifts by this.
        wind_m_s: (3,) velocity of the air, which carries what falls in it.
    """

    path: str
    boundary: Boundary
    medium: FogMedium
    priority: int = 0
    parent: int | None = None
    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    wind_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def grid_frame(self) -> Array:
        """Matrix (4, 4) from the box of its density grid, whose half sides are 1, to world metres."""
        grid = self.medium.grid
        if grid is None or grid.period_m is None:
            return self.boundary.frame()
        matrix = np.diag([*[grid.period_m / 2.0] * 3, 1.0])
        matrix[:3, 3] = self.origin_m
        return matrix

    def optical_depth(self, begin_m: Array, end_m: Array) -> Array:
        """Optical depth (N,) [1] of straight segments inside, from (N, 3) to (N, 3) points [m].

        In closed form; of a grid exact for trilinear densities, to rounding.
        """
        length = np.linalg.norm(end_m - begin_m, axis=1)
        if self.medium.grid is None:
            return self.medium.optical_depth(begin_m[:, 2], end_m[:, 2], length)
        inverse = np.linalg.inv(self.grid_frame())
        begin, end = (points @ inverse[:3, :3].T + inverse[:3, 3] for points in (begin_m, end_m))
        grid, sigma_t, total = self.medium.grid, self.medium.sigma_t_per_m, np.zeros(len(length))
        pieces = 1 if grid.period_m is None else max(1, math.ceil(length.max(initial=0.0) / grid.period_m))
        cuts = np.linspace(0.0, 1.0, pieces + 1)
        for low, high in itertools.pairwise(cuts):
            rows = np.flatnonzero(total < OPAQUE)
            ends = (begin[rows] + share * (end[rows] - begin[rows]) for share in (low, high))
            total[rows] += sigma_t * (high - low) * length[rows] * grid.mean(*ends)
        return total

    def covered(self) -> tuple[npt.NDArray[np.float32], Array]:
        """Densities (Z, Y, X) of a grid that need not repeat, and the matrix (4, 4) from its box to the world.

        Raises:
            ParameterError: more voxels than a grid has.
        """
        grid, frame = self.medium.grid, self.grid_frame()
        assert grid is not None
        if grid.period_m is None:
            return grid.values, frame
        counts, voxel = np.array(grid.values.shape[::-1]), grid.period_m / np.array(grid.values.shape[::-1])
        lowest = frame[:3, 3] - grid.period_m / 2.0
        low, high = ((corner - lowest) / voxel for corner in self.boundary.extent())
        first, last = np.floor(low).astype(int) - 1, np.ceil(high).astype(int) + 1
        if (count := math.prod((last - first).tolist())) > MAX_VOXELS:
            raise ParameterError(
                f"{self.path}: its patchy fog fills {count} voxels, and this model holds at most {MAX_VOXELS}; use "
                f"--model path"
            )
        x, y, z = (np.arange(*ends) % size for *ends, size in zip(first, last, counts, strict=True))
        place = np.diag([*((last - first) * voxel / 2.0), 1.0])
        place[:3, 3] = lowest + (first + last) / 2.0 * voxel
        return grid.values[np.ix_(z, y, x)], place


def optical_depth(fog: Sequence[FogVolume], origin_m: Array, direction: Array, length_m: Array) -> Array:
    """Optical depth along rays through nested fog.

    Each volume counts where the ray is in it but in none of its children.

    Args:
        fog: volumes with box or sphere boundaries.
        origin_m: (N, 3) [m].
        direction: (N, 3), unit length.
        length_m: (N,) [m], may be infinite.
    """
    total = np.zeros(len(origin_m))
    spans = [
        tuple(np.minimum(end, length_m) for end in volume.boundary.interval(origin_m, direction)) for volume in fog
    ]

    for index, volume in enumerate(fog):
        ends = [origin_m + end[:, None] * direction for end in spans[index]]
        total += volume.optical_depth(*ends)
        if volume.parent is not None:
            total -= fog[volume.parent].optical_depth(*ends)
    return total


def _hulls_meet(first: Array, second: Array) -> bool:
    """Whether the convex hulls of (N, 3) and (M, 3) points have a point in common, to 1e-6 of the first one's size.

    They have where the least-squares problem `first' u = second' v`, sum u = sum v = 1,
    with u, v >= 0 leaves nothing.
    """
    size = np.maximum(np.ptp(first, axis=0), 1e-9 * np.ptp(first))
    a, b = (first - first[0]) / size, (second - first[0]) / size
    shares = np.zeros((2, len(a) + len(b)))
    shares[0, : len(a)] = shares[1, len(a) :] = 1.0
    return bool(nnls(np.vstack([np.hstack([a.T, -b.T]), shares]), np.array([0.0, 0.0, 0.0, 1.0, 1.0]))[1] < 1e-6)
