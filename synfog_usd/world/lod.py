"""Fewer triangles for models that stand far away, as like the full ones as was asked for.

Solid parts are simplified by quadric edge collapse (pymeshlab) until no point of
either surface lies farther than a limit from the other; so no silhouette moves
by more.  Leaves and needles, which do not touch, become fewer and larger.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from synfog_usd.base.arrays import Array
from synfog_usd.base.arrays import Indices as Index
from synfog_usd.world.components import Component
from synfog_usd.world.materials import PALETTE, Material
from synfog_usd.world.shapes import COLLAPSE, Part, by_material, face_normals, join

LIMIT_M = 0.0195  # 2 cm, less half a millimetre that samples of a surface and five decimals can miss
WORTH = 3000
"""Triangles above which a model comes in two levels of detail."""
SLIVER_M2 = 1e-9
SHARES = (0.15, 0.25, 0.4, 0.6)
INSIDE = ("cabin_dark", "cabin_grey", "seat_cloth", "driver_skin", "driver_hair", "driver_coat")
"""What is seen through glass only; far away the glass is dark and nothing is behind it, which saves rays as well."""
DARK_GLASS = {"glass_clear": "glass_car"}
CLEAN_M = 0.005
"""How far cleaning may move a surface: half a pixel of a picture 640 wide at 6 m."""
CLEAN_SHARES = (0.5, 0.6, 0.7, 0.8)
CLEANED = (
    *("paint", "paint_dusty", "paint_dirty", "plastic_dusty", "gloss_black", "black_plastic", "seam"),
    *("cabin_dark", "cabin_grey", "headlamp", "tail_lamp"),
)
"""What is cut out of skins, all of it without pictures; wheels, seats and glass are not."""
SKEW = 0.6
"""Cosine between a face and a normal below which there is a crease."""
KEPT = {"leaf_": (4, 12, 40), "needle": (3, 6, 14)}
"""One leaf in so many is kept at the levels `low`, `far` and `distant`, and larger, so that as much is covered."""
LEAVES = tuple(KEPT)
FINE = ("twig",)
"""What is thinner than a tenth of a pixel beyond 60 m, among leaves: at the level `low` it is not smooth, and `far` and
`distant` have none of it.
"""


def with_low(component: Component, limit_m: float = LIMIT_M) -> Component:
    """The component with a level `low`, if it is worth one and gets smaller by a quarter; its other individuals
    likewise.
    """
    if component.individuals:
        component = replace(
            component,
            individuals={name: with_low(individual, limit_m) for name, individual in component.individuals.items()},
        )
    if component.triangles() < WORTH:
        return component
    outside = [part for part in component.parts if part.material not in INSIDE]
    low = simplified(outside, limit_m, {**PALETTE, **component.materials})
    dark = DARK_GLASS if len(outside) < len(component.parts) else {}
    return (
        replace(component, low=low, low_bindings=dark, afar=_afar(component, low))
        if sum(len(p.faces) for p in low) < 0.75 * component.triangles()
        else component
    )


def bare(component: Component) -> Component:
    """The component without texture coordinates where none of its materials shows a picture."""
    worn: dict[str, set[str]] = {}
    for mesh, material in (
        *component.low_bindings.items(),
        *(pair for looks in component.variants.values() for look in looks.values() for pair in look.bindings.items()),
    ):
        worn.setdefault(mesh, set()).add(material)
    looks_of = {**PALETTE, **component.materials}

    def without(parts: Sequence[Part]) -> tuple[Part, ...]:
        return tuple(
            part
            if any(
                _pictured(looks_of[name]) for name in {part.material, *worn.get(part.material, ())} & looks_of.keys()
            )
            else replace(part, uv=None)
            for part in parts
        )

    return replace(
        component,
        parts=without(component.parts),
        low=without(component.low),
        afar={level: without(parts) for level, parts in component.afar.items()},
        individuals={name: bare(individual) for name, individual in component.individuals.items()},
    )


def _pictured(look: Material) -> bool:
    return bool(look.texture or look.gloss or look.emission_texture)


def simplified(
    parts: Sequence[Part], limit_m: float = LIMIT_M, materials: Mapping[str, Material] = PALETTE
) -> tuple[Part, ...]:
    """The parts, one for each material, with as few triangles as `limit_m` [m] allows; what wears a texture stays."""
    return tuple(
        _simplified(part, limit_m, materials.get(part.material, Material())) for part in by_material(parts).values()
    )


def cleaned(parts: Sequence[Part], limit_m: float = CLEAN_M) -> tuple[Part, ...]:
    """The parts, one for each material, without most of the slivers that cutting them out of a skin left.

    A smooth part keeps the normals that it had at the nearest place, so that it shines as before.
    """
    return tuple(_cleaned(part, limit_m) for part in by_material(parts).values())


def distance(a: Part, b: Part, samples: int = 20_000) -> float:
    """Greatest distance [m] from a point of either surface to the other: from every corner, and from `samples` points
    spread evenly by area, the same ones in every call.
    """
    import pymeshlab

    meshes = pymeshlab.MeshSet(verbose=False)
    for part in (a, b):
        corners = part.points[part.faces]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        solid = area > SLIVER_M2  # the search for the nearest point passes slivers over
        used, faces = np.unique(part.faces[solid], return_inverse=True)
        meshes.add_mesh(pymeshlab.Mesh(part.points[used], faces.reshape(-1, 3).astype(np.int32)))
        spread = _spread(corners[solid], area[solid], samples)
        meshes.add_mesh(pymeshlab.Mesh(np.r_[part.points[used], spread]))
    reach = pymeshlab.PureValue(10.0)
    both = [
        meshes.get_hausdorff_distance(
            sampledmesh=places, targetmesh=surface, samplevert=True, sampleface=False, maxdist=reach
        )["max"]
        for places, surface in ((1, 2), (3, 0))
    ]
    return float(max(both))


def _spread(corners: Array, area: Array, count: int) -> Array:
    """`count` points [m] on triangles (N, 3, 3), even by area: systematic along the list, inside a triangle by the R2
    sequence (Roberts 2018). MeshLab's own samples depend on how many it drew before.
    """
    summed = np.cumsum(area)
    number = np.arange(count)
    of = np.searchsorted(summed, (number + 0.5) / count * summed[-1])
    u, v = np.modf(np.outer([0.7548776662466927, 0.5698402909980532], number + 1))[0]
    u, v = np.where(u + v > 1.0, [1.0 - u, 1.0 - v], [u, v])
    first, second, third = corners[of].swapaxes(0, 1)
    return first + u[:, None] * (second - first) + v[:, None] * (third - first)


def collapsed(points: Array, faces: Index, triangles: int) -> tuple[Array, Index]:
    """A mesh of about so many triangles, its borders kept near where they are."""
    import pymeshlab

    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(points, faces.astype(np.int32)))
    meshes.meshing_decimation_quadric_edge_collapse(
        **{**COLLAPSE, "planarquadric": True, "planarweight": 1e-4}, targetfacenum=triangles
    )
    mesh = meshes.current_mesh()
    return np.array(mesh.vertex_matrix()), np.array(mesh.face_matrix(), dtype=np.int64)


def _cleaned(part: Part, limit_m: float) -> Part:
    if part.material not in CLEANED or part.normals is None or len(part.faces) < 100:
        return part
    points, faces = _welded(part)
    for share in CLEAN_SHARES:
        fewer = Part(*collapsed(points, faces, int(share * len(faces))), part.material)
        if len(fewer.faces) and distance(part, fewer) <= limit_m:
            return _with_normals_of(part, fewer)
    return part


def _with_normals_of(part: Part, fewer: Part) -> Part:
    """`fewer` with the mean normal of `part` at the four nearest points; at a crease, where that lies askew, with that
    of the face.
    """
    assert part.normals is not None
    gap, near = cKDTree(part.points).query(fewer.points, k=4)
    normals = (part.normals[near] / (gap + 1e-4)[:, :, None]).sum(axis=1)
    normals = (normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12))[fewer.faces].reshape(-1, 3)
    face = np.repeat(face_normals(fewer), 3, axis=0)
    normals = np.where((np.einsum("ij,ij->i", normals, face) > SKEW)[:, None], normals, face)
    corners = fewer.points[fewer.faces].reshape(-1, 3)
    _, first, inverse = np.unique(
        np.round(np.c_[corners, 0.05 * normals], 4), axis=0, return_index=True, return_inverse=True
    )
    return Part(corners[first], inverse.reshape(-1, 3), part.material, None, normals[first])


def _welded(part: Part) -> tuple[Array, Index]:
    """Points and faces with points at one place made one, and no face without area."""
    points, inverse = np.unique(np.round(part.points, 5), axis=0, return_inverse=True)
    faces = inverse.reshape(-1)[part.faces]
    solid = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return points, faces[solid]


def _simplified(part: Part, limit_m: float, look: Material) -> Part:
    if part.material.startswith(LEAVES):
        return _fewer_leaves(part, _kept(part)[0])
    if look.texture or look.gloss or len(part.faces) < 150:
        return part  # pictures stay where they are
    points, faces = _welded(part)
    for share in SHARES:
        fewer = Part(*collapsed(points, faces, int(share * len(faces))), part.material)
        if len(fewer.faces) and distance(part, fewer) <= limit_m:
            smooth = part.normals is not None and part.material not in FINE
            return _with_normals_of(part, fewer) if smooth else fewer
    return replace(part, normals=None) if part.material in FINE else part


def _afar(component: Component, low: Sequence[Part]) -> dict[str, tuple[Part, ...]]:
    """A plant for woods of hundreds: stem and boughs of its level `low`, and few large leaves; nothing for other
    things.
    """
    leaves = [part for part in by_material(component.parts).values() if part.material.startswith(LEAVES)]
    if component.label != "vegetation" or not leaves:
        return {}
    stem = [part for part in low if not part.material.startswith(LEAVES) and part.material not in FINE]
    return {
        level: (*stem, *(_fewer_leaves(part, _kept(part)[number]) for part in leaves))
        for number, level in enumerate(("far", "distant"), 1)
    }


def _kept(part: Part) -> tuple[int, ...]:
    return next(counts for begin, counts in KEPT.items() if part.material.startswith(begin))


def _fewer_leaves(part: Part, of: int) -> Part:
    """One leaf in `kept`, larger by its root: so it covers as much."""
    corners = part.points[part.faces.reshape(-1, 6)[:, [0, 1, 2, 5]]][::of]
    middle = corners.mean(axis=1, keepdims=True)
    larger = middle + (corners - middle) * np.sqrt(of)
    first = 4 * np.arange(len(larger))[:, None]
    faces = (first + np.array([0, 1, 2, 0, 2, 3])).reshape(-1, 3)
    return join([Part(larger.reshape(-1, 3), faces, part.material)])
