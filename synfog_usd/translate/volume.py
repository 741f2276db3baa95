"""Fog: boundaries from the prims that carry fog attributes, and how they lie in each other.

Takes leaves of the walk; gives `FogVolume`s in scene metres, each with the one
that surrounds it.  What other tools write for fog is recognised or refused with advice.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from pxr import Ar, Sdf, Usd, UsdGeom, UsdShade

from synfog_usd.base.arrays import Array, distinct
from synfog_usd.base.errors import ParameterError, StageError
from synfog_usd.fog import Boundary, Fog, FogMedium, FogVolume
from synfog_usd.fog.grid import DensityGrid
from synfog_usd.scene import Camera
from synfog_usd.stage import budget
from synfog_usd.stage.open import fence_of
from synfog_usd.stage.schema import DEFAULTS, PREFIX, FogAttributes, read_fog
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.geometry import Triangles, part
from synfog_usd.translate.implicit import read_implicit
from synfog_usd.translate.medium import VDB_TOOL, read_medium, read_vdb
from synfog_usd.translate.mesh import read_mesh
from synfog_usd.translate.pose import authored_velocity
from synfog_usd.translate.space import apply, columns, scaled

_SLACK = 1e-5
"""Relative shrinking before containment is asked, so that faces that lie in one plane do not count as crossing."""

SLAB_TOP_M = 100.0
SLAB_HALF_WIDTH_M = 2000.0
"""Size of the fog that is made for a stage that has none."""

_FAR = 1e30
"""Largest coordinate that can be multiplied without overflow."""


class FogError(StageError):
    """Fog boundaries that cannot be where they are.

    Attributes:
        rule: the rule of `synfog_usd.stage.rules` that they break.
        path: prim path of the boundary.
    """

    def __init__(self, rule: str, path: str, text: str) -> None:
        super().__init__(text)
        self.rule, self.path = rule, path


def fog_volume(
    prim: Usd.Prim, source: Usd.Prim | None, matrix: Array, time: Usd.TimeCode, notes: Diagnostics
) -> FogVolume | None:
    """The fog within one boundary prim, or None where it is switched off.

    Args:
        prim: the boundary.
        source: prim with the fog attributes; None for a boundary that has none
            (an exported fog box), which gets the default visibility.
        matrix: (4, 4) of the boundary to scene metres.

    Raises:
        StageError: a value outside its range, or a boundary that is not closed.
    """
    attributes = read_fog(source, time) if source is not None else None
    if attributes is None:
        attributes = FogAttributes(str(prim.GetPath()), DEFAULTS, {})
    if not attributes.values["enabled"]:
        return None
    grid, densest = None, 1.0
    if prim.GetTypeName() == "Volume" and "densityGrid" not in attributes.attribute_of and _vdb_path(prim) is not None:
        boundary, grid, densest = _vdb(prim, matrix, notes)
    else:
        boundary = _boundary(prim, matrix, time, notes)
    lowest = float(boundary.extent()[0][2])
    medium = read_medium(attributes, lowest, prim.GetStage(), notes, grid=grid, densest=densest)
    x, y, z = matrix[:3, 3].tolist()
    wind = _wind(prim, matrix, time, notes)
    return FogVolume(
        str(prim.GetPath()), boundary, medium, attributes.values["priority"], origin_m=(x, y, z), wind_m_s=wind
    )


def _wind(prim: Usd.Prim, matrix: Array, time: Usd.TimeCode, notes: Diagnostics) -> tuple[float, float, float]:
    """Velocity [m/s] of a boundary by its `physics:velocity`, in the scene's axes; (4, 4) `matrix` is its place."""
    now = UsdGeom.XformCache(time)
    velocity = authored_velocity(prim, now, notes)
    if velocity is None:
        return 0.0, 0.0, 0.0
    to_scene = matrix @ np.linalg.inv(columns(now.GetLocalToWorldTransform(prim)))
    x, y, z = (to_scene[:3, :3] @ velocity).tolist()
    return x, y, z


def nested(volumes: list[FogVolume]) -> tuple[FogVolume, ...]:
    """The same volumes, each with the innermost other one around it as parent.

    Raises:
        FogError: two boundaries that cross.
    """
    inner = [_shrunk(volume.boundary) for volume in volumes]
    sizes = [_size(volume.boundary) for volume in volumes]
    inside, partly, wholly = _contained(volumes, inner)
    around: list[list[int]] = [[] for _ in volumes]
    crossing: list[tuple[str, str]] = []
    for i, j in sorted({(max(pair), min(pair)) for pair in inside | partly}):
        i_in_j, j_in_i = (i, j) in inside, (j, i) in inside
        if i_in_j and j_in_i:  # the same place twice: priority says which fog fills it
            i_in_j = (volumes[i].priority, -sizes[i], i) > (volumes[j].priority, -sizes[j], j)
            j_in_i = not i_in_j
        if i_in_j:
            around[i].append(j)
        elif j_in_i:
            around[j].append(i)
        elif (i, j) not in wholly and (j, i) not in wholly:
            crossing.append((volumes[j].path, volumes[i].path))
    if crossing:
        first, second = crossing[0]
        more = f" (and {len(crossing) - 1} pairs more)" if len(crossing) > 1 else ""
        raise FogError(
            "fog-crosses",
            first,
            f"{first} and {second}: fog boundaries that cut through each other{more}; put one wholly inside the "
            f"other, or move them apart",
        )
    return tuple(
        replace(volume, parent=max(around[k], key=lambda j: len(around[j])) if around[k] else None)
        for k, volume in enumerate(volumes)
    )


MAX_PAIRS = 2_000_000
"""Pairs of fogs that may touch; to test so many takes half a minute."""

_Pairs = set[tuple[int, int]]


def _contained(volumes: list[FogVolume], inner: list[Boundary]) -> tuple[_Pairs, _Pairs, _Pairs]:
    """Pairs (i, j) for which all surface points of `inner[i]` lie in volume j, and some or all of them in `inner[j]`.

    Only fogs whose boxes along the axes meet are tested, all that meet one of them together.

    Raises:
        FogError: more than `MAX_PAIRS` of them.
    """
    inside: _Pairs = set()
    partly: _Pairs = set()
    wholly: _Pairs = set()
    points = [boundary.surface_points() for boundary in inner]
    boxes = np.array([volume.boundary.extent() for volume in volumes]).reshape(-1, 2, 3)
    pairs = 0
    for j, volume in enumerate(volumes):
        meets = ((boxes[:, 0] <= boxes[j, 1]) & (boxes[:, 1] >= boxes[j, 0])).all(axis=1)
        meets[j] = False
        near = np.flatnonzero(meets)
        pairs += len(near)
        if pairs > 2 * MAX_PAIRS:
            raise FogError(
                "fog-crosses",
                volume.path,
                f"{volume.path}: more than {MAX_PAIRS} pairs of fog boundaries may touch; merge some, or move them "
                f"apart",
            )
        if not len(near):
            continue
        stacked = np.concatenate([points[i] for i in near])
        starts = np.cumsum([0, *(len(points[i]) for i in near[:-1])])
        in_volume, in_inner = volume.boundary.contains(stacked), inner[j].contains(stacked)
        for relation, mask in (
            (inside, np.logical_and.reduceat(in_volume, starts)),
            (partly, np.logical_or.reduceat(in_inner, starts)),
            (wholly, np.logical_and.reduceat(in_inner, starts)),
        ):
            relation.update((int(i), j) for i in near[mask])
    return inside, partly, wholly


def in_fog(volumes: tuple[FogVolume, ...], fog: Fog) -> tuple[FogVolume, ...]:
    """The same volumes with another fog in the outermost ones; none for clear air."""
    if fog.clear:
        return ()
    return tuple(
        volume if volume.parent is not None else replace(volume, medium=fog.over(volume.medium)) for volume in volumes
    )


def slab_around(fog: Fog, low: Array, high: Array, eye: Array) -> FogVolume:
    """A slab of fog around everything, for a stage that has no fog of its own.

    Args:
        fog: what fills it.
        low, high: (3,) corners [m] of what is drawn.
        eye: (3,) camera position [m].
    """
    bottom = min(float(low[2]), float(eye[2])) - 1.0
    top = bottom + max(SLAB_TOP_M, 2.0 * (float(eye[2]) - bottom))
    half = max(SLAB_HALF_WIDTH_M, float(np.abs(np.stack([low - eye, high - eye])[:, :2]).max()) * 1.01)
    to_world = scaled(half, half, (top - bottom) / 2.0)
    to_world[:3, 3] = eye[0], eye[1], (top + bottom) / 2.0
    return FogVolume("", Boundary("box", to_world), fog.over(FogMedium(1.0, base_height_m=bottom)))


def refuse_many(fog: Sequence[FogVolume]) -> None:
    """Refuse more fog volumes than a picture is drawn of.

    Raises:
        StageError: with their number and the limit.
    """
    if len(fog) > (most := budget.most_fogs()):
        raise StageError(
            f"{budget.amount(len(fog))} fog volumes, the first of them {fog[0].path}; a picture is drawn of at most "
            f"{most}: make one density grid of those that are alike, leave out what the camera does not "
            f"see{budget.trusting(budget.MAX_FOGS_TRUSTED)}",
        )


def refuse_cut(fog: tuple[FogVolume, ...], camera: Camera) -> None:
    """Refuse fog whose boundary passes between the camera and its near plane, within the view.

    A ray begins at the near plane in the fog that is around the lens; where these
    differ, all that it meets is drawn in the wrong fog.

    Raises:
        FogError: with the boundary's prim path and the camera's.
    """
    if camera.fisheye is not None:  # rays begin on a ball
        angles = np.linspace(0.0, np.pi, 13)
        ring = np.stack([np.cos(2.0 * angles[:-1]), np.sin(2.0 * angles[:-1])], axis=1)
        corners = [
            (camera.near_m * math.sin(t) * x, camera.near_m * math.sin(t) * y, -camera.near_m * math.cos(t))
            for t in angles[angles <= math.radians(camera.fov_x_deg) / 2.0 + angles[1]]
            for x, y in ring
        ]
    else:
        half = camera.near_m * math.tan(math.radians(camera.fov_x_deg) / 2.0)
        tall = half * camera.height_px / camera.width_px
        corners = [
            ((x + 2.0 * camera.shift[0]) * half, (y + 2.0 * camera.shift[1]) * tall, -camera.near_m)
            for x in (-1.0, 1.0)
            for y in (-1.0, 1.0)
        ]
    pyramid = apply(camera.to_world, np.array([(0.0, 0.0, 0.0), *corners]))
    for volume in fog:
        if volume.boundary.meets(pyramid):
            raise FogError(
                "fog-cut",
                volume.path,
                f"{volume.path}: the fog's boundary lies between the camera {camera.path} and its near plane at "
                f"{camera.near_m:g} m; "
                f"move one of them, or lower the camera's clippingRange",
            )


def _is_closed(mesh: Triangles) -> bool:
    """Whether each edge lies between two triangles that turn the same way round, points at one place being one."""
    return len(mesh.faces) >= 4 and _open_edges(_welded(mesh.positions, mesh.faces)) == 0


def _boundary(prim: Usd.Prim, matrix: Array, time: Usd.TimeCode, notes: Diagnostics) -> Boundary:
    kind, path = prim.GetTypeName(), prim.GetPath()
    try:
        if kind in ("Cube", "Sphere"):
            attribute = prim.GetAttribute("size" if kind == "Cube" else "radius")
            half = float(attribute.Get(time)) / (2.0 if kind == "Cube" else 1.0)
            if not abs(half) < _FAR:
                raise StageError(
                    f"{path}: its {attribute.GetName()} is {2.0 * half if kind == 'Cube' else half:g}; a fog boundary "
                    f"has a size that is a number"
                )
            return Boundary("box" if kind == "Cube" else "sphere", matrix @ scaled(half, half, half))
        if kind == "Volume":
            return _extent_box(prim, matrix, time)
        if kind == "Mesh":
            triangles = _triangles(prim, time, notes)
        elif kind in ("Cylinder", "Cylinder_1", "Cone", "Capsule", "Capsule_1"):
            triangles = read_implicit(prim, kind, time, notes)
        else:
            raise StageError(
                f"{path}: a {kind or 'prim without a type'} cannot hold fog; use a Cube, Sphere, Cylinder or closed "
                f"Mesh"
            )
        if triangles is None:
            raise StageError(f"{path}: a fog boundary without faces that can be used; make it a closed mesh")
        return _mesh_boundary(apply(matrix, triangles.positions), triangles.faces, path)
    except ParameterError as problem:
        raise StageError(f"{path}: {problem}") from problem


def _triangles(prim: Usd.Prim, time: Usd.TimeCode, notes: Diagnostics) -> Triangles | None:
    polygons = read_mesh(prim, time, notes)
    return None if polygons is None else part(polygons, None)


def _extent_box(prim: Usd.Prim, matrix: Array, time: Usd.TimeCode) -> Boundary:
    extent = UsdGeom.Boundable(prim).GetExtentAttr().Get(time)
    if extent is None or len(extent) != 2 or not np.abs(np.array(extent)).max() < _FAR:
        raise StageError(f"{prim.GetPath()}: a Volume holds fog only with an extent; author it, or use a Cube")
    return Boundary("box", matrix @ _box(np.array(extent[0], dtype=np.float64), np.array(extent[1], dtype=np.float64)))


def _box(low: Array, high: Array) -> Array:
    """Matrix (4, 4) from the cube of half size 1 to the box between two corners."""
    box = scaled(*((high - low) / 2.0))
    box[:3, 3] = (low + high) / 2.0
    return box


def _mesh_boundary(vertices: Array, faces: npt.NDArray[np.int64], path: object) -> Boundary:
    points, triangles = _welded(vertices, faces)
    count = _open_edges((points, triangles))
    if count:
        raise StageError(
            f"{path}: a fog boundary with {count} open or badly joined edges; close the mesh, so that inside and "
            f"outside are clear"
        )
    if (cuboid := _cuboid(points)) is not None:
        return Boundary("box", cuboid)
    a, b, c = (points[triangles[:, k]] for k in range(3))
    if np.einsum("ij,ij->", a - points[0], np.cross(b - points[0], c - points[0])) < 0.0:
        triangles = triangles[:, ::-1]
    return Boundary("mesh", np.eye(4), points, triangles)


def _cuboid(points: Array) -> Array | None:
    """Matrix from the cube of half size 1 to a box that a tool without cubes wrote as a mesh; None for other meshes."""
    if len(points) != 8:
        return None
    centre = points.mean(axis=0)
    by_distance = points[np.argsort(((points - points[0]) ** 2).sum(axis=1))]
    # the nearest corner is a neighbour, the second neighbour among the next three, the third among the five nearest
    for second in range(2, 5):
        for third in range(second + 1, 6):
            edges = by_distance[[1, second, third]] - points[0]
            signs = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, -1).T
            corners = points[0] + signs @ edges
            nearest = np.linalg.norm(corners[:, None] - points[None], axis=2)
            size = np.abs(edges).max()
            if nearest.min(axis=1).max() < 1e-5 * size and len(set(nearest.argmin(axis=1))) == 8:
                matrix = np.eye(4)
                matrix[:3, :3], matrix[:3, 3] = edges.T / 2.0, centre
                return matrix
    return None


def _welded(vertices: Array, faces: npt.NDArray[np.int64]) -> tuple[Array, npt.NDArray[np.int64]]:
    """Points at one place as one, unused ones and collapsed triangles dropped."""
    used, inverse = np.unique(faces, return_inverse=True)
    span = float(np.ptp(vertices[used], axis=0).max())
    grid = np.round((vertices[used] - vertices[used].min(axis=0)) / max(1e-7 * span, 1e-300))
    _, first, same = np.unique(grid, axis=0, return_index=True, return_inverse=True)
    triangles = same.reshape(-1)[inverse.reshape(-1)].reshape(-1, 3)
    whole = (
        (triangles[:, 0] != triangles[:, 1])
        & (triangles[:, 1] != triangles[:, 2])
        & (triangles[:, 2] != triangles[:, 0])
    )
    return vertices[used][first], triangles[whole].astype(np.int64)


def _open_edges(mesh: tuple[Array, npt.NDArray[np.int64]]) -> int:
    points, triangles = mesh
    edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    forward, backward = edges[:, 0] * len(points) + edges[:, 1], edges[:, 1] * len(points) + edges[:, 0]
    forward_only, backward_only = distinct(forward), distinct(backward)
    alone = 2 * len(distinct(np.concatenate([forward_only, backward_only]))) - len(forward_only) - len(backward_only)
    return alone // 2 + len(forward) - len(forward_only)


def fog_box(
    prim: Usd.Prim, material: UsdShade.Material, time: Usd.TimeCode, notes: Diagnostics, *, is_blender: bool
) -> bool | None:
    """Whether a mesh without fog attributes, whose material has no surface, is the box of an exported volume.

    Blender writes a box with a volume material as a mesh whose material has no output
    at all; other tools leave an output for volumes.  Elsewhere the name must say fog,
    because a mesh whose material was lost must not become fog.

    Returns:
        True for fog, False for a shape like others, None for a volume that is not
        closed: it is neither drawn nor fog.
    """
    words = f"{prim.GetPath()} {material.GetPath().name}".lower()
    named = any(word in words for word in ("fog", "mist", "haze")) or any(
        output.GetAttr().IsAuthored() for output in material.GetVolumeOutputs()
    )
    if not named and not is_blender:
        return False
    triangles = _triangles(prim, time, notes)
    if triangles is not None and _is_closed(triangles):
        return True
    if named:
        notes.warn(
            prim.GetPath(),
            "a volume's mesh that is not closed is left out: close it, and author synfog:fog:mor on it for fog",
        )
        return None
    return False


def rtx_fog(stage: Usd.Stage, notes: Diagnostics) -> None:
    """Note Omniverse's fog, a colour laid over the distance after rendering, which has no visibility."""
    settings = stage.GetRootLayer().customLayerData.get("renderSettings", {})
    fog = {name: settings[name] for name in settings if str(name).startswith("rtx:fog:")}
    where = ""
    for prim in stage.Traverse():
        if prim.GetTypeName() == "RenderSettings":
            named = {attribute.GetName(): attribute.Get() for attribute in prim.GetAuthoredAttributes()}
            on_prim = {name[name.index("rtx:fog:") :]: value for name, value in named.items() if "rtx:fog:" in name}
            where = str(prim.GetPath()) if on_prim else where
            fog |= on_prim
    if not fog or not fog.get("rtx:fog:enabled", True):
        return
    end = fog.get("rtx:fog:fogEndDist")
    metres = (
        float(end) * UsdGeom.GetStageMetersPerUnit(stage)
        if isinstance(end, (int, float)) and math.isfinite(end) and end > 0
        else 0.0
    )
    hint = f"mor{metres:.0f}" if metres >= 1.0 else "mor300"
    notes.warn(
        where,
        f"Omniverse's fog (rtx:fog) is a colour over the distance without a visibility, and is not drawn.  Bake with "
        f"--fog {hint}, or give a Cube {PREFIX}mor",
    )


# -- OpenVDB


def vdb_fault(prim: Usd.Prim) -> str | None:
    """Why a Volume cannot be fog, with the way out; None where a .npz stands beside its .vdb."""
    path = _vdb_path(prim)
    if path is None:
        return "it has no OpenVDB file that can be found; give it a field:density, or use a Cube with SynFogMediumAPI"
    if path.suffix.lower() != ".vdb":
        return f"{path.name} is no .vdb file; convert it to OpenVDB, or use a Cube with SynFogMediumAPI"
    if not path.with_suffix(".npz").is_file():
        return (
            f"{path.name} is OpenVDB; make {path.stem}.npz beside it: blender --background --python {VDB_TOOL} -- "
            f"{path}"
        )
    return None


def _vdb_path(prim: Usd.Prim) -> Path | None:
    """File of a Volume's density, or of its first field."""
    fields = prim.GetRelationships()
    for name in ("field:density", *[field.GetName() for field in fields if field.GetName().startswith("field:")]):
        for target in prim.GetRelationship(name).GetForwardedTargets() if prim.HasRelationship(name) else ():
            field = prim.GetStage().GetPrimAtPath(target)
            asset = field.GetAttribute("filePath").Get() if field and field.GetAttribute("filePath") else None
            if (
                isinstance(asset, Sdf.AssetPath)
                and asset.resolvedPath
                and not Ar.IsPackageRelativePath(asset.resolvedPath)
            ):
                return Path(asset.resolvedPath)
    return None


def _vdb(prim: Usd.Prim, matrix: Array, notes: Diagnostics) -> tuple[Boundary, DensityGrid, float]:
    """Box, densities and the largest of them of an OpenVDB volume, from the .npz that was made of it.

    Raises:
        StageError: there is none, or it is damaged.
    """
    path, file = prim.GetPath(), _vdb_path(prim)
    if (problem := vdb_fault(prim)) is not None or file is None:
        raise StageError(f"{path}: {problem}")
    file = file.with_suffix(".npz")
    if (problem := fence_of(prim.GetStage()).fault(file)) is not None:
        raise StageError(f"{path}: {problem}")
    try:
        grid, densest, low, high = read_vdb(file)
    except ParameterError as problem:
        raise StageError(f"{path}: {problem}") from problem
    notes.info(
        path,
        f"OpenVDB volume from {file.name}, {' x '.join(map(str, grid.values.shape[::-1]))} voxels; where its density "
        f"is 1 the extinction is that of its fog attributes",
    )
    return Boundary("box", matrix @ _box(low, high)), grid, densest


def _size(boundary: Boundary) -> float:
    """Volume [m3] of the box or of the mesh's bounding box."""
    if boundary.vertices is not None:
        return float(np.prod(np.ptp(boundary.vertices, axis=0)))
    return 8.0 * abs(float(np.linalg.det(boundary.to_world[:3, :3])))


def _shrunk(boundary: Boundary) -> Boundary:
    if boundary.vertices is not None:
        centre = boundary.vertices.mean(axis=0)
        return replace(boundary, vertices=centre + (boundary.vertices - centre) * (1.0 - _SLACK))
    return replace(boundary, to_world=boundary.to_world @ scaled(1.0 - _SLACK, 1.0 - _SLACK, 1.0 - _SLACK))
