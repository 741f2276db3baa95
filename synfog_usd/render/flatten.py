"""Meshes of one material, or of materials alike, as one mesh; instances written out.

Mitsuba's just-in-time variants trace every shape and every instance on their own:
an instance costs 20 ms and 0.6 MB of every kernel, which no street of a thousand
parts can pay.  One big mesh a material costs nothing of the kind, and memory only
by the triangle.  Where there are more than `MAX_TRIANGLES`, instances that are far away have their vertices merged
below half a pixel, and what is still above stays instances, those of the largest prototypes.

Trees are an exception where our own path tracer asks: 60 of 9 kinds were four of five triangles of a street.  A
prototype of which `WORTH_A_PROTOTYPE` triangles would be written out again is joined once, in its own coordinates, and
`placed` knows where it stands.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from synfog_usd.arrays import Array, Indices
from synfog_usd.render import detail, surface
from synfog_usd.render.lights.crowd import crowded
from synfog_usd.render.placed import Piece, Prototypes, Standing
from synfog_usd.scene import SceneDict

MAX_TRIANGLES = 28_000_000
"""3.8 GB at most, while Mitsuba builds its search tree, where meshes have positions alone."""

WORTH_A_PROTOTYPE = 50_000
"""Triangles in the instances of a prototype after the first, from which on it is joined once; they take 0.06 s."""

LEAST_TRIANGLES = 64
"""Of a prototype that is left to places.  Each of 750 000 places took some 11 kB and 0.1 ms, a triangle that is written
out takes 0.1 kB.
"""

FAR_M = 50.0
"""Distance from the camera [m] up to which instances are written out all the same: many rays go by what is near, and
each that goes by an instance pays for it.  On the crossing all trees placed cost rays 10 %, those beyond 70 m 5 %.
"""

ARRAYS = ("normals", "texcoords", "vertex_color")

UNMOVED = np.eye(4)[None]
AT_ONCE = 1_000_000
"""Points that are put to their places at once: 24 MB."""

FaceInstances = Mapping[str, npt.NDArray[np.int32]]


def flatten(source: SceneDict, *, placing: bool = False) -> tuple[SceneDict, FaceInstances, Prototypes | None]:
    """Join meshes by material.

    Args:
        source: any scene.
        placing: whether instances may be left to a `placed.PlacedScene`.

    Returns:
        the scene with fewer shapes; for each joined mesh its key -> the label id of every face; and where prototypes
        stand whose instances are not written out, None where there are none.  Shapes that are not joined keep their
        place in `instance_of`.
    """
    world, taken = source.world, set[str]()
    kinds = _kinds(source)
    parts: dict[tuple[Any, ...], list[_Member]] = {}
    sorts: dict[int, tuple[Any, ...]] = {}  # by mesh: those of instances are asked for again and again

    def take(
        mesh: Mapping[str, Any],
        matrix: Array | None,
        instance: int,
        key: str,
        piece: tuple[str, str] | None = None,
        block: int | None = None,
    ) -> None:
        if (sort := sorts.get(id(mesh))) is None:
            material = mesh["bsdf"]["id"]
            smooth = *(name in mesh for name in ARRAYS), bool(mesh.get("face_normals", False))
            sort = sorts[id(mesh)] = kinds.get(material, material), *smooth
        motion = source.motion_of.get(key)
        parts.setdefault((*sort, block, motion is not None), []).append(
            _Member(key, mesh, matrix, instance, motion, piece)
        )

    placed = _placed(source) if placing else {}
    written = {key: value for key, value in world.items() if key not in placed}
    finer = _Detail(replace(source, world=written))
    expanded = _expanded(written, finer)
    crowd = crowded(source)
    for key, value in world.items():
        if key in crowd:
            mesh, block = crowd[key]
            take(mesh, None, source.instance_of.get((key,), 0), key, block=block)
            taken.add(key)
        elif key.startswith("shape_") and _plain(value):
            take(value, None, source.instance_of.get((key,), 0), key)
            taken.add(key)
        elif key in expanded:
            for name, shape in finer.prototype(key, value).items():
                take(
                    shape, np.asarray(value["to_world"], dtype=np.float64), source.instance_of.get((key, name), 0), key
                )
            taken.add(key)
    for group in dict.fromkeys(placed.values()):  # after all others: the last of the joined meshes
        for name, shape in _shapes(world, group).items():
            take(shape, None, 0, "", (group, name))
    taken |= set(placed)
    left = {_group_id(value) for key, value in world.items() if key.startswith("instance_") and key not in taken}
    if left and placed:  # which stay Mitsuba's own, that know nothing of our places
        return flatten(source)
    taken |= {
        key
        for key, value in world.items()
        if isinstance(value, Mapping) and value.get("type") == "shapegroup" and key not in left
    }

    joined, instances = {}, {}
    where: dict[tuple[str, str], Piece] = {}
    motions = {key: ways for key, ways in source.motion_of.items() if key not in taken}
    groups, fluxes, emissions = dict(source.group_of), dict(source.flux_of), dict(source.emission_of)
    for index, ((*_, block, moving), members) in enumerate(parts.items()):
        key = f"shape_joined_{index}"
        joined[key] = {**_joined(members), "bsdf": _bsdf(world, members)}
        if block is not None:
            joined[key]["emitter"] = members[0].mesh["emitter"]
            fluxes[key] = sum(fluxes.get(one.key, 0.0) for one in members)
            for values in (groups, emissions):
                if members[0].key in values:
                    values[key] = values[members[0].key]
        instances[key] = np.concatenate(
            [np.full(len(one.mesh["faces"]), one.instance, dtype=np.int32) for one in members]
        )
        where |= _pieces(key, members)
        if moving:
            joined[key]["motion"], motions[key] = _ways(members)
    rest = {key: value for key, value in world.items() if key not in taken}
    asked = _asked([*rest.values(), *joined.values()])
    rest = {key: value for key, value in rest.items() if key not in kinds or key in asked}
    return (
        replace(
            source,
            world={**rest, **joined},
            instance_of={key: instance for key, instance in source.instance_of.items() if key[0] not in taken},
            motion_of=motions,
            group_of=groups,
            flux_of=fluxes,
            emission_of=emissions,
        ),
        instances,
        _prototypes(source, placed, where) if placed else None,
    )


class _Member(NamedTuple):
    """A mesh that is joined with others: its key, where it stands, whose it is, how it moves, as `SceneDict.motion_of`,
    and of what prototype it is which piece, where it stands in many places.
    """

    key: str
    mesh: Mapping[str, Any]
    matrix: Array | None
    instance: int
    motion: Array | None
    piece: tuple[str, str] | None


def _pieces(key: str, members: list[_Member]) -> dict[tuple[str, str], Piece]:
    """Where the pieces of prototypes lie in a joined mesh."""
    found, face, vertex = {}, 0, 0
    for one in members:
        faces, vertices = len(one.mesh["faces"]), len(one.mesh["positions"])
        if one.piece is not None:
            found[one.piece] = Piece(key, face, vertex, faces, vertices)
        face, vertex = face + faces, vertex + vertices
    return found


def _placed(source: SceneDict) -> dict[str, str]:
    """Instances of the prototypes that are worth it -> which they are of."""
    keys, found = dict[str, list[str]](), dict[str, str]()
    for key, value in source.world.items():
        if key.startswith("instance_"):
            keys.setdefault(_group_id(value), []).append(key)
    for group, instances in keys.items():
        shapes = _shapes(source.world, group)
        plain = all(_plain(shape) and len(shape["faces"]) for shape in shapes.values())
        faces = _faces(shapes) if plain else 0
        if faces < LEAST_TRIANGLES:
            continue
        places = np.array([source.world[key]["to_world"] for key in instances])[:, :3, 3]
        far = np.linalg.norm(places - source.camera.to_world[:3, 3], axis=1) > FAR_M
        if (np.count_nonzero(far) - 1) * faces >= WORTH_A_PROTOTYPE:
            found |= {key: group for key, yes in zip(instances, far, strict=True) if yes}
    return found


def _prototypes(source: SceneDict, placed: Mapping[str, str], where: Mapping[tuple[str, str], Piece]) -> Prototypes:
    """Where the instances `placed` stand, of the pieces that are found `where` (prototype, key in it) says."""
    names = {group: tuple(_shapes(source.world, group)) for group in placed.values()}
    places = [
        Standing(
            group,
            np.asarray(source.world[key]["to_world"], dtype=np.float64),
            tuple(source.instance_of.get((key, name), 0) for name in names[group]),
        )
        for key, group in placed.items()
    ]
    return Prototypes({group: tuple(where[group, name] for name in own) for group, own in names.items()}, tuple(places))


def _kinds(source: SceneDict) -> dict[str, tuple[Any, ...]]:
    """Materials that can be drawn together with others -> what those have in common."""
    found = {
        key: surface.alike(value)
        for key, value in source.world.items()
        if key.startswith("mat_") and key not in source.reflectance_of
    }
    return {key: kind for key, kind in found.items() if kind is not None}


def _bsdf(world: Mapping[str, Any], members: list[_Member]) -> dict[str, Any]:
    """The material of joined meshes, or all of theirs as one."""
    materials = [one.mesh["bsdf"]["id"] for one in members]
    each = list(dict.fromkeys(materials))
    if len(each) == 1:
        return {"type": "ref", "id": each[0]}
    counts = [len(one.mesh["faces"]) for one in members]
    return surface.together([world[name] for name in each], np.repeat([each.index(name) for name in materials], counts))


def _asked(parts: list[Any]) -> set[str]:
    """What parts of a scene refer to."""
    found = set[str]()
    for part in parts:
        if isinstance(part, Mapping):
            found |= {part["id"]} if part.get("type") == "ref" else _asked(list(part.values()))
    return found


def _ways(members: list[_Member]) -> tuple[Indices, Array]:
    """(N,) way in which each vertex of joined meshes moves, and the ways (M, K, 4, 4): parts of one thing share one."""
    known: dict[bytes, int] = {}
    ways: list[Array] = []
    numbers = []
    for one in members:
        assert one.motion is not None
        number = known.setdefault(one.motion.tobytes(), len(ways))
        if number == len(ways):
            ways.append(one.motion[0])
        numbers.append(np.full(len(one.mesh["positions"]), number, dtype=np.int64))
    return np.concatenate(numbers), np.stack(ways)


def _plain(shape: Mapping[str, Any]) -> bool:
    """Whether a shape is a mesh that can be joined: no lamp, no placement of its own, a shared material."""
    return (
        shape.get("type") == "mesh"
        and "emitter" not in shape
        and "to_world" not in shape
        and shape["bsdf"].get("type") == "ref"
    )


def _group_id(instance: Mapping[str, Any]) -> str:
    for value in instance.values():  # asked some millions of times
        if isinstance(value, dict) and value.get("type") == "ref":
            return str(value["id"])
    raise KeyError("an instance of no group")


def _shapes(world: Mapping[str, Any], group: str) -> dict[str, Mapping[str, Any]]:
    return {name: shape for name, shape in world[group].items() if name != "type"}


def _prototype(world: Mapping[str, Any], instance: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    return _shapes(world, _group_id(instance))


class _Detail:
    """The prototypes of instances as their distance wants them, where there is no room for all in full."""

    def __init__(self, source: SceneDict) -> None:
        self.world = source.world
        self.level: dict[str, int] = {}
        self.made: dict[tuple[str, int], dict[str, Mapping[str, Any]]] = {}
        placed: dict[str, list[str]] = {}
        for key, value in source.world.items():
            if key.startswith("instance_"):
                placed.setdefault(_group_id(value), []).append(key)
        prototypes = {group: _prototype(self.world, self.world[keys[0]]) for group, keys in placed.items()}
        plain = {
            group: shapes for group, shapes in prototypes.items() if all(_plain(shape) for shape in shapes.values())
        }
        total = _direct(self.world) + sum(len(placed[group]) * _faces(shapes) for group, shapes in plain.items())
        if total <= MAX_TRIANGLES:
            return
        for group, shapes in plain.items():
            points = [np.asarray(shape["positions"]) for shape in shapes.values() if len(shape["positions"])]
            if not points or _faces(shapes) <= detail.FEWEST:
                continue
            low, high = np.min([p.min(axis=0) for p in points], axis=0), np.max([p.max(axis=0) for p in points], axis=0)
            matrices = np.array([self.world[key]["to_world"] for key in placed[group]], dtype=np.float64)
            found = detail.levels(source.camera, matrices, low.astype(np.float64), high.astype(np.float64))
            self.level |= dict(zip(placed[group], found.tolist(), strict=True))

    def prototype(self, key: str, instance: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
        """The shapes of an instance's prototype, as it is drawn."""
        if key not in self.level:
            return _prototype(self.world, instance)
        place = _group_id(instance), self.level[key]
        if place not in self.made:
            self.made[place] = {
                name: detail.merged(shape, place[1]) for name, shape in _prototype(self.world, instance).items()
            }
        return self.made[place]


def _faces(shapes: Mapping[str, Mapping[str, Any]]) -> int:
    return sum(len(shape["faces"]) for shape in shapes.values())


def _direct(world: Mapping[str, Any]) -> int:
    """Triangles of the meshes that are no instances."""
    return sum(
        len(value["faces"]) for key, value in world.items() if key.startswith("shape_") and value.get("type") == "mesh"
    )


def _expanded(world: Mapping[str, Any], finer: _Detail) -> set[str]:
    """Keys of the instances that are written out: those of the smallest prototypes first, as many as go into
    `MAX_TRIANGLES`.

    Each instance that is left costs the same, whatever it holds: so as few as can be are left.
    """
    room = MAX_TRIANGLES - _direct(world)
    sizes: dict[tuple[str, int | None], int | None] = {}
    placed: list[tuple[int, str]] = []
    for key, value in world.items():
        if key.startswith("instance_"):
            which = _group_id(value), finer.level.get(key)
            if which not in sizes:
                inner = finer.prototype(key, value)
                sizes[which] = _faces(inner) if all(_plain(shape) for shape in inner.values()) else None
            size = sizes[which]
            if size is not None:
                placed.append((size, key))
    found: set[str] = set()
    for size, key in sorted(placed, key=lambda one: one[0]):  # stable: of one size in the order of the scene
        if size > room:
            break
        room -= size
        found.add(key)
    return found


def _alike(members: list[_Member]) -> Iterator[tuple[Mapping[str, Any], Array]]:
    """Meshes in their order, and the (N, 4, 4) places at which each stands one after the other; `UNMOVED` where it
    stands as it is.
    """
    for (_, moved), run in itertools.groupby(members, key=lambda one: (id(one.mesh), one.matrix is not None)):
        some = list(run)
        if not moved:
            yield from ((one.mesh, UNMOVED) for one in some)
            continue
        step = max(AT_ONCE // max(len(some[0].mesh["positions"]), 1), 1)
        for first in range(0, len(some), step):
            yield some[0].mesh, np.array([one.matrix for one in some[first : first + step]])


def _joined(members: list[_Member]) -> dict[str, Any]:
    positions, faces, more, start = [], [], {name: [] for name in ARRAYS if name in members[0].mesh}, 0
    for mesh, matrices in _alike(members):
        points, corners = np.asarray(mesh["positions"]), np.asarray(mesh["faces"], dtype=np.uint32)
        turns = matrices[:, :3, :3]
        count, each = len(matrices), len(points)
        if matrices is not UNMOVED:
            points = points @ turns.transpose(0, 2, 1) + matrices[:, None, :3, 3]
            mirrored = np.linalg.det(turns) < 0.0
            corners = np.where(mirrored[:, None, None], corners[:, ::-1], corners)
        positions.append(points.astype(np.float32).reshape(-1, 3))
        starts = (start + each * np.arange(count)).astype(np.uint32)
        faces.append((corners + starts[:, None, None]).reshape(-1, 3))
        for name, arrays in more.items():
            array = np.asarray(mesh[name])
            if name == "normals" and matrices is not UNMOVED:
                array = array @ np.linalg.inv(turns)  # not to unit length: their ratio is what interpolation needs
            elif count > 1:
                array = np.broadcast_to(array, (count, *array.shape))
            arrays.append(array.astype(np.float32).reshape(-1, array.shape[-1]))
        start += count * each
    arrays = {"positions": positions, "faces": faces, **more}
    first = members[0].mesh
    kept = {"face_normals": first["face_normals"]} if "face_normals" in first else {}
    return {
        "type": "mesh",
        **{name: np.concatenate(parts) for name, parts in arrays.items()},
        **kept,
    }
