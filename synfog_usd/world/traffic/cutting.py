"""Meshes of a model cut into parts: read from a layer, and some of their faces as a mesh of their own."""

from __future__ import annotations

import numpy as np
from pxr import Sdf
from scipy import sparse

from synfog_usd.base.arrays import Flags, Indices
from synfog_usd.world.shapes import Part


def read_part(layer: Sdf.Layer, name: str) -> Part | None:
    """The mesh of a material in a layer of meshes; None where there is none with normals."""
    mesh = layer.GetPrimAtPath(f"/Geometry/{name}")
    if not mesh or "normals" not in mesh.attributes:
        return None
    points, normals, faces = (
        np.array(mesh.attributes[key].default) for key in ("points", "normals", "faceVertexIndices")
    )
    return Part(
        points.astype(np.float64), faces.reshape(-1, 3).astype(np.int64), name, None, normals.astype(np.float64)
    )


def subset(part: Part, faces: Flags) -> Part:
    """Some faces of a part, and the points that they use."""
    used, corners = np.unique(part.faces[faces], return_inverse=True)
    normals = None if part.normals is None else part.normals[used]
    return Part(part.points[used], corners.reshape(-1, 3), part.material, None, normals)


def pieces(part: Part) -> tuple[int, Indices]:
    """How many pieces hang together, and of which each point is."""
    edges = np.concatenate([part.faces[:, :2], part.faces[:, 1:]])
    graph = sparse.coo_matrix((np.ones(len(edges)), tuple(edges.T)), shape=(len(part.points),) * 2)
    count, piece = sparse.csgraph.connected_components(graph, directed=False)
    return int(count), piece.astype(np.int64)
