"""Meshes of one material, or of materials alike, as one mesh; instances written out.

Mitsuba's just-in-time variants trace every shape and every instance on their own:
an instance costs 20 ms and 0.6 MB of every kernel, which no street of a thousand
parts can pay.  One big mesh a material costs nothing of the kind, and memory only
by the triangle.  Where there are more than `MAX_TRIANGLES`, instances that are far away have their vertices merged
below half a pixel.  If there are still more, those of the largest prototypes stay instances.

Trees are an exception where our own path tracer asks: 60 of 9 kinds were four of five triangles of a street.  A
prototype of which `WORTH_A_PROTOTYPE` triangles would be written out again is joined once, in its own coordinates, and
`placed` knows where it stands.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import Array, Flags, Indices, Pixels, extent
from synfog_usd.render import detail, surface
from synfog_usd.render.lights.crowd import crowded
from synfog_usd.render.placed import Piece, Prototypes, Standing
from synfog_usd.scene import Placements, SceneDict, placements, shapes_of

MAX_TRIANGLES = 28_000_000
"""3.8 GB at most, while Mitsuba builds its search tree, where meshes have positions alone."""

WORTH_A_PROTOTYPE = 50_000
"""Triangles in the instances of a prototype after the first, from which on it is joined once; they take 0.06 s."""

LEAST_TRIANGLES = 64
"""Of a prototype that is left to places: a place takes 11 kB, and a triangle that is written out 0.1 kB."""

FAR_M = 50.0
"""Distance from the camera [m] up to which instances are written out all the same.

Many rays go by what is near, and each that goes by an instance pays for it.
"""

ARRAYS = ("normals", "texcoords", "vertex_color")

TOGETHER = 1_000_000
"""Points that are put to their places in one step: 24 MB."""

FULL = 1000
"""Level of an instance that is drawn as it is; see `detail.levels` for others."""

FaceInstances = Mapping[str, npt.NDArray[np.int32]]


Joints: TypeAlias = dict[tuple[Any, ...], tuple[tuple[Any, ...], dict[str, Any]]]
"""By what was joined: that itself, so that no other part gets its id, and what became of it."""


def flatten(
    source: SceneDict, *, placing: bool = False, joints: Joints | None = None
) -> tuple[SceneDict, FaceInstances, Prototypes | None]:
    """Join meshes by material; what moves from frame to frame apart from what stands.

    Args:
        source: any scene.
        placing: whether instances may be left to a `placed.PlacedScene`.
        joints: of another frame's scene; what consists of the same parts is taken from them, and they become those of
            this scene.

    Returns:
        the scene with fewer shapes; for each joined mesh its key -> the number of every face, see
        `SceneDict.number_of`; and where prototypes stand whose instances are not written out, None where there are
        none.  Shapes that are not joined keep their place in `instance_of`.
    """
    world = source.world
    gathered = _Gathered(source)
    standing = placements(world)
    placed = _placed(source, standing) if placing else np.zeros(len(standing.keys), dtype=bool)
    of_places = {group: rows[placed[rows]] for group, rows in standing.rows.items() if placed[rows].any()}
    gathered.take_shapes()
    expanded = gathered.take_instances(standing, placed)
    gathered.take_prototypes(of_places)  # after all others: the last of the joined meshes
    gathered.gone.update(standing.keys[row] for row in np.flatnonzero(placed))
    unjoined = {group for group, rows in standing.rows.items() if not (expanded | placed)[rows].all()}
    if unjoined and of_places:  # which stay Mitsuba's own, that know nothing of our places
        return flatten(source, joints=joints)
    gathered.gone |= {
        key
        for key, value in world.items()
        if isinstance(value, Mapping) and value.get("type") == "shapegroup" and key not in unjoined
    }
    joined, instances, where = gathered.joined({} if joints is None else joints)
    apart = of_places or (placing and source.moving and not unjoined)  # else one search tree holds all
    return joined, instances, _prototypes(source, standing, of_places, where) if apart else None


class _Gathered:
    """Meshes of a scene that are to be joined, by what they must have in common.

    Attributes:
        gone: keys of `SceneDict.world` that the joined scene has not.
    """

    def __init__(self, source: SceneDict) -> None:
        self.gone = set[str]()
        self._source, self._kinds = source, _kinds(source)
        self._parts: dict[tuple[Any, ...], list[_Member]] = {}

    def take_shapes(self) -> None:
        """What stands by itself."""
        source, crowd = self._source, crowded(self._source)
        for key, value in source.world.items():
            if key in crowd or (key.startswith("shape_") and _plain(value)):
                mesh, block = crowd.get(key, (value, None))
                label = np.array([[source.number_of((key,))]])
                self._take(_Member(key, ("",), (mesh,), None, label, source.motion_of.get(key)), block)
                self.gone.add(key)

    def take_instances(self, standing: Placements, placed: Flags) -> Flags:
        """Write out instances, but not those that are placed; (N,) which are written out."""
        source = self._source
        finer = _Detail(source, standing, ~placed)
        expanded = _expanded(source.world, standing, finer, ~placed)
        for group, rows in _runs(source, standing, finer, expanded):
            shapes, keys = finer.prototype(group, finer.level[rows[0]]), [standing.keys[row] for row in rows]
            labels, motion = _labels(source, keys, shapes), source.motion_of.get(keys[0])
            names, meshes = tuple(shapes), tuple(shapes.values())
            self._take(_Member(keys[0], names, meshes, standing.to_world[rows], labels, motion))
            self.gone.update(keys)
        return expanded

    def take_prototypes(self, groups: Iterable[str]) -> None:
        """What stands in many places, once each."""
        for group in groups:
            shapes = shapes_of(self._source.world, group)
            labels = np.zeros((1, len(shapes)), dtype=np.int64)
            self._take(_Member(group, tuple(shapes), tuple(shapes.values()), None, labels, None, placed=True))

    def _take(self, member: _Member, block: int | None = None) -> None:
        sorts: dict[tuple[Any, ...], list[int]] = {}
        for place, mesh in enumerate(member.meshes):
            material = mesh["bsdf"]["id"]
            smooth = *(name in mesh for name in ARRAYS), bool(mesh.get("face_normals", False))
            sorts.setdefault((self._kinds.get(material, material), *smooth), []).append(place)
        for sort, places in sorts.items():
            meshes = tuple(member.meshes[place] for place in places)
            names = tuple(member.names[place] for place in places)
            some = member._replace(meshes=meshes, labels=member.labels[:, places], names=names)
            moves = member.key in self._source.moving
            self._parts.setdefault((*sort, block, member.motion is not None, moves), []).append(some)

    def joined(self, joints: Joints) -> tuple[SceneDict, FaceInstances, dict[tuple[str, str], Piece]]:
        """The scene with them joined, the number of every face, and where each prototype's mesh lies in them."""
        source, gone = self._source, self.gone
        joined: dict[str, dict[str, Any]] = {}
        instances: dict[str, npt.NDArray[np.int32]] = {}
        moving, known = set(source.moving) - gone, _Joiner(source.world, joints)
        where: dict[tuple[str, str], Piece] = {}
        motions = {key: ways for key, ways in source.motion_of.items() if key not in gone}
        groups, fluxes, emissions = dict(source.group_of), dict(source.flux_of), dict(source.emission_of)
        for index, ((*_, block, in_motion, moves), members) in enumerate(self._parts.items()):
            key = f"shape_joined_{index}"
            joined[key] = known.joined(members, lit=block is not None)
            if moves:
                moving.add(key)
            if block is not None:
                fluxes[key] = sum(fluxes.get(member.key, 0.0) for member in members)
                first = members[0].key
                groups |= {key: groups[first]} if first in groups else {}
                emissions |= {key: emissions[first]} if first in emissions else {}
            instances[key] = np.concatenate(
                [np.repeat(some.labels.ravel(), some.faces * len(some.labels)).astype(np.int32) for some in members]
            )
            where |= _pieces(key, members)
            if in_motion:
                joined[key] = dict(joined[key])
                joined[key]["motion"], motions[key] = _ways(members)
        joints.clear()
        joints.update(known.asked)
        rest = {key: value for key, value in source.world.items() if key not in gone}
        needed = _references([*rest.values(), *joined.values()])
        rest = {key: value for key, value in rest.items() if key not in self._kinds or key in needed}
        flat = replace(
            source,
            world={**rest, **joined},
            instance_of={key: instance for key, instance in source.instance_of.items() if key[0] not in gone},
            motion_of=motions,
            moving=frozenset(moving),
            group_of=groups,
            flux_of=fluxes,
            emission_of=emissions,
        )
        return flat, instances, where


class _Joiner:
    """Joins members, each set of the same ones once.

    Attributes:
        asked: what was joined, or taken from before.
    """

    def __init__(self, world: Mapping[str, Any], before: Joints) -> None:
        self.asked: Joints = {}
        self._world, self._before = world, before

    def joined(self, members: list[_Member], *, lit: bool) -> dict[str, Any]:
        """Meshes as one, with their material."""
        parts = tuple(
            part for one in members for part in (*one.meshes, *(self._world[key] for key in _materials([one])))
        )
        places = tuple(None if one.to_world is None else one.to_world.tobytes() for one in members)
        more = {"emitter": members[0].meshes[0]["emitter"]} if lit else {}
        return self._once(
            ("mesh", lit, places, *map(id, parts)),
            parts,
            lambda: {**_joined(members), "bsdf": self._bsdf(members), **more},
        )

    def _bsdf(self, members: list[_Member]) -> dict[str, Any]:
        """The material of joined meshes, or all of theirs as one."""
        number = {key: place for place, key in enumerate(dict.fromkeys(_materials(members)))}
        if len(number) == 1:
            return {"type": "ref", "id": next(iter(number))}
        of_faces = np.concatenate(
            [
                np.tile(np.repeat([number[key] for key in _materials([one])], one.faces), len(one.labels))
                for one in members
            ]
        )
        parts = tuple(self._world[key] for key in number)
        return self._once(
            ("bsdf", of_faces.tobytes(), *map(id, parts)), parts, lambda: surface.together(list(parts), of_faces)
        )

    def _once(self, key: tuple[Any, ...], parts: tuple[Any, ...], make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        known = self._before.get(key) or (parts, make())
        self.asked[key] = known
        return known[1]


class _Member(NamedTuple):
    """A mesh that is joined with others, or those of a prototype with all places at which they are written out.

    Attributes:
        key: of the mesh, of the first of the instances, or of a prototype that is not written out.
        names: keys of the meshes in their prototype.
        meshes: M of them.
        to_world: (N, 4, 4) of the places, one after the other; None for what stands as it is, once.
        labels: (N, M) label ids.
        motion: as `SceneDict.motion_of`, of all of it.
        placed: whether it is of a prototype that is not written out.
    """

    key: str
    names: tuple[str, ...]
    meshes: tuple[Mapping[str, Any], ...]
    to_world: Array | None
    labels: Indices
    motion: Array | None
    placed: bool = False

    @property
    def faces(self) -> list[int]:
        """Number of each mesh's faces."""
        return [len(mesh["faces"]) for mesh in self.meshes]

    @property
    def vertices(self) -> list[int]:
        """Number of each mesh's vertices."""
        return [len(mesh["positions"]) for mesh in self.meshes]


def _labels(source: SceneDict, keys: list[str], names: Iterable[str]) -> Indices:
    """(N, M) label ids of N instances of a prototype with M shapes."""
    names = list(names)
    labels = [source.instance_of.get((key, name), 0) for key in keys for name in names]
    return np.array(labels, dtype=np.int64).reshape(len(keys), len(names))


def _runs(source: SceneDict, standing: Placements, finer: _Detail, some: Flags) -> Iterator[tuple[str, Indices]]:
    """The instances that are asked for, by prototype as they follow one another; those of one run have one level of
    detail and stand or move from frame to frame, and what moves in the exposure is a run of its own.
    """
    groups, rows = list(standing.rows), np.flatnonzero(some)
    number = np.zeros(len(standing.keys), dtype=np.int64)
    for place, of_group in enumerate(standing.rows.values()):
        number[of_group] = place
    alone = np.array([standing.keys[row] in source.motion_of for row in rows], dtype=bool)
    moves = np.array([standing.keys[row] in source.moving for row in rows], dtype=bool)
    sort = np.stack([number[rows], finer.level[rows], moves, np.where(alone, 1 + np.arange(len(rows)), 0)])
    for run in np.split(rows, 1 + np.flatnonzero((sort[:, 1:] != sort[:, :-1]).any(axis=0))):
        if len(run):
            yield groups[number[run[0]]], run


def _pieces(key: str, members: list[_Member]) -> dict[tuple[str, str], Piece]:
    """Where the pieces of prototypes lie in a joined mesh."""
    pieces, face, vertex = {}, 0, 0
    for member in members:
        for name, faces, vertices in zip(member.names, member.faces, member.vertices, strict=True):
            if member.placed:
                pieces[member.key, name] = Piece(key, face, vertex, faces, vertices)
            face, vertex = face + faces * len(member.labels), vertex + vertices * len(member.labels)
    return pieces


def _placed(source: SceneDict, standing: Placements) -> Flags:
    """(N,) which instances are left to places: those far away of the prototypes that are worth it."""
    placed = np.zeros(len(standing.keys), dtype=bool)
    for group, rows in standing.rows.items():
        shapes = shapes_of(source.world, group)
        plain = all(_plain(shape) and len(shape["faces"]) for shape in shapes.values())
        faces = _faces(shapes) if plain else 0
        if faces < LEAST_TRIANGLES:
            continue
        far = source.away_m(standing.to_world[rows, :3, 3]) > FAR_M
        if (np.count_nonzero(far) - 1) * faces >= WORTH_A_PROTOTYPE:
            placed[rows] = far
    return placed


def _prototypes(
    source: SceneDict,
    standing: Placements,
    of_places: Mapping[str, Indices],
    where: Mapping[tuple[str, str], Piece],
) -> Prototypes:
    """Where the instances `of_places` stand, by prototype, of the pieces that `where` has by (prototype, key in it)."""
    pieces, places = dict[str, tuple[Piece, ...]](), list[Standing]()
    for group, rows in of_places.items():
        shapes = shapes_of(source.world, group)
        pieces[group] = tuple(where[group, name] for name in shapes)
        labels = _labels(source, [standing.keys[row] for row in rows], shapes)
        places += [
            Standing(group, standing.to_world[row], tuple(ids)) for row, ids in zip(rows, labels.tolist(), strict=True)
        ]
    return Prototypes(pieces, tuple(places))


def _kinds(source: SceneDict) -> dict[str, tuple[Any, ...]]:
    """Materials that can be drawn together with others -> what those have in common."""
    kinds = {
        key: surface.kind_of(value)
        for key, value in source.world.items()
        if key.startswith("mat_") and key not in source.reflectance_of
    }
    return {key: kind for key, kind in kinds.items() if kind is not None}


def _materials(members: list[_Member]) -> list[str]:
    return [mesh["bsdf"]["id"] for member in members for mesh in member.meshes]


def _references(parts: list[Any]) -> set[str]:
    """What parts of a scene refer to."""
    keys = set[str]()
    for part in parts:
        if isinstance(part, Mapping):
            keys |= {part["id"]} if part.get("type") == "ref" else _references(list(part.values()))
    return keys


def _ways(members: list[_Member]) -> tuple[Indices, Array]:
    """(N,) way in which each vertex of joined meshes moves, and the ways (M, K, 4, 4): parts of one thing share one."""
    number_of: dict[bytes, int] = {}
    ways: list[Array] = []
    numbers = []
    for member in members:
        assert member.motion is not None
        number = number_of.setdefault(member.motion.tobytes(), len(ways))
        if number == len(ways):
            ways.append(member.motion[0])
        numbers.append(np.full(sum(member.vertices) * len(member.labels), number, dtype=np.int64))
    return np.concatenate(numbers), np.stack(ways)


def _plain(shape: Mapping[str, Any]) -> bool:
    """Whether a shape is a mesh that can be joined: no lamp, no placement of its own, a shared material."""
    return (
        shape.get("type") == "mesh"
        and "emitter" not in shape
        and "to_world" not in shape
        and shape["bsdf"].get("type") == "ref"
    )


class _Detail:
    """The prototypes of instances as their distance wants them, where there is no room for all in full."""

    def __init__(self, source: SceneDict, standing: Placements, written: Flags) -> None:
        self.world = source.world
        self.level = np.full(len(standing.keys), FULL, dtype=np.int64)
        self._shapes: dict[tuple[str, int], dict[str, Mapping[str, Any]]] = {}
        plain = {
            group: rows[written[rows]]
            for group, rows in standing.rows.items()
            if all(_plain(shape) for shape in self.prototype(group).values())
        }
        total = _direct(self.world) + sum(len(rows) * _faces(self.prototype(group)) for group, rows in plain.items())
        if total <= MAX_TRIANGLES:
            return
        for group, rows in plain.items():
            shapes = self.prototype(group)
            points = [np.asarray(shape["positions"]) for shape in shapes.values() if len(shape["positions"])]
            if not points or not len(rows) or _faces(shapes) <= detail.FEWEST:
                continue
            low, high = extent(*points)
            box = low.astype(np.float64), high.astype(np.float64)
            eyes = (source.camera, *source.further_cameras)
            self.level[rows] = np.min([detail.levels(eye, standing.to_world[rows], *box) for eye in eyes], axis=0)

    def prototype(self, group: str, level: int = FULL) -> dict[str, Mapping[str, Any]]:
        """The shapes of a prototype, as an instance of that level is drawn."""
        if (group, level) not in self._shapes:
            shapes = shapes_of(self.world, group)
            self._shapes[group, level] = {
                name: shape if level == FULL else detail.merged(shape, level) for name, shape in shapes.items()
            }
        return self._shapes[group, level]


def _faces(shapes: Mapping[str, Mapping[str, Any]]) -> int:
    return sum(len(shape["faces"]) for shape in shapes.values())


def _direct(world: Mapping[str, Any]) -> int:
    """Triangles of the meshes that are no instances."""
    return sum(
        len(value["faces"]) for key, value in world.items() if key.startswith("shape_") and value.get("type") == "mesh"
    )


def _expanded(world: Mapping[str, Any], standing: Placements, finer: _Detail, written: Flags) -> Flags:
    """(N,) which of the instances that may be `written` out are: those of the smallest prototypes first, as many as go
    into `MAX_TRIANGLES`.

    Each instance that is left costs the same, whatever it holds: so as few as can be are left.
    """
    sizes, expanded = np.zeros(len(standing.keys), dtype=np.int64), written.copy()
    for group, rows in standing.rows.items():
        for level in np.unique(finer.level[rows]).tolist():
            shapes, of_level = finer.prototype(group, level), rows[finer.level[rows] == level]
            if all(_plain(shape) for shape in shapes.values()):
                sizes[of_level] = _faces(shapes)
            else:
                expanded[of_level] = False
    candidates = np.flatnonzero(expanded)
    candidates = candidates[np.argsort(sizes[candidates], kind="stable")]  # of one size in the order of the scene
    expanded[candidates[np.cumsum(sizes[candidates]) > MAX_TRIANGLES - _direct(world)]] = False
    return expanded


def _whole(meshes: tuple[Mapping[str, Any], ...]) -> Mapping[str, Any]:
    """Meshes that have the same arrays as one."""
    if len(meshes) == 1:
        return meshes[0]
    starts = np.cumsum([0, *(len(mesh["positions"]) for mesh in meshes[:-1])])
    faces = [np.asarray(mesh["faces"], dtype=np.int64) + start for mesh, start in zip(meshes, starts, strict=True)]
    arrays = {
        name: np.concatenate([mesh[name] for mesh in meshes]) for name in ("positions", *ARRAYS) if name in meshes[0]
    }
    return {**meshes[0], **arrays, "faces": np.concatenate(faces)}


def _at_places(members: list[_Member]) -> Iterator[tuple[Mapping[str, Any], Array | None]]:
    """Meshes in their order, and the (N, 4, 4) places at which each stands, not too many in one step; None of what
    stands as it is.
    """
    for member in members:
        mesh = _whole(member.meshes)
        if member.to_world is None:
            yield mesh, None
            continue
        step = max(TOGETHER // max(len(mesh["positions"]), 1), 1)
        for first in range(0, len(member.to_world), step):
            yield mesh, member.to_world[first : first + step]


def _joined(members: list[_Member]) -> dict[str, Any]:
    names = [name for name in ARRAYS if name in members[0].meshes[0]]
    arrays: dict[str, list[Pixels]] = {name: [] for name in ("positions", "faces", *names)}
    start = 0
    for mesh, matrices in _at_places(members):
        points, corners = np.asarray(mesh["positions"]), np.asarray(mesh["faces"], dtype=np.uint32)
        count, each = 1 if matrices is None else len(matrices), len(points)
        if matrices is not None:
            turns = matrices[:, :3, :3]
            points = points @ turns.transpose(0, 2, 1) + matrices[:, None, :3, 3]
            mirrored = np.linalg.det(turns) < 0.0
            corners = np.where(mirrored[:, None, None], corners[:, ::-1], corners)
        arrays["positions"].append(points.astype(np.float32).reshape(-1, 3))
        starts = (start + each * np.arange(count)).astype(np.uint32)
        arrays["faces"].append((corners + starts[:, None, None]).reshape(-1, 3))
        for name in names:
            array = np.asarray(mesh[name])
            if name == "normals" and matrices is not None:
                array = array @ np.linalg.inv(turns)  # not to unit length: their ratio is what interpolation needs
            elif count > 1:
                array = np.broadcast_to(array, (count, *array.shape))
            arrays[name].append(array.astype(np.float32).reshape(-1, array.shape[-1]))
        start += count * each
    first = members[0].meshes[0]
    shading = {"face_normals": first["face_normals"]} if "face_normals" in first else {}
    return {
        "type": "mesh",
        **{name: np.concatenate(parts) for name, parts in arrays.items()},
        **shading,
    }
