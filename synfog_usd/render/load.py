"""A `SceneDict` as Mitsuba objects.

Every object is made one by one and kept under its key, so that a shape that a ray
hits can be traced back to the instance it belongs to.  Fog stays apart until a model
asks for it as null-material boundaries.
"""

from __future__ import annotations

import gc
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import ModuleType
from typing import TYPE_CHECKING, Any, cast

import drjit as dr
import numpy as np

from synfog_usd.base.colour import PRIMARIES_NM
from synfog_usd.base.errors import StageError
from synfog_usd.fog import Boundary, FogVolume
from synfog_usd.fog.phase import HenyeyGreenstein
from synfog_usd.render import backend, surface
from synfog_usd.render.flatten import FaceInstances, Joints, flatten
from synfog_usd.render.lights import photometric
from synfog_usd.render.lights.rows import is_sampled_light
from synfog_usd.render.media.phases import plugin
from synfog_usd.render.placed import Groups, PlacedScene, Prototypes
from synfog_usd.scene import Camera, SceneDict, taken_over

if TYPE_CHECKING:
    import numpy.typing as npt
    from drjit.auto.ad import Bool, Float
    from mitsuba import (
        BSDF,
        Color3f,
        Medium,
        Mesh,
        Normal3f,
        Object,
        Point2f,
        Ray3f,
        RayDifferential3f,
        Scene,
        Sensor,
        Shape,
        Texture,
    )

    from synfog_usd.base.arrays import Array, Indices, Pixels
    from synfog_usd.render.lights.sampler import LightSampler

LIGHTS = (
    "constant",
    "envmap",
    "sunsky",
    "directional",
    "point",
    "spot",
    "projector",
    "directionalarea",
    photometric.TYPE,
)

OURS = (surface.TYPE, photometric.TYPE)
"""Types that we register."""

GRID_SLICES = 512
"""Height steps of an exponential fog; linear between them.  Where a step is a tenth of the scale height, it errs by
0.13 %.
"""


@dataclass
class Earlier:
    """What was made of a frame's scene: for that of another frame, in which much of it stands.

    Attributes:
        world: the parts, with meshes joined.
        parts: key -> object.
        joints, groups: see `flatten` and `placed`.
    """

    world: Mapping[str, Any] = field(default_factory=dict)
    parts: dict[str, Any] = field(default_factory=dict)
    joints: Joints = field(default_factory=dict)
    groups: Groups = field(default_factory=dict)

    def keep(self, world: Mapping[str, Any]) -> dict[str, Any]:
        """The world, whose parts that did not change are those of before; what was made of the others is dropped."""
        world = taken_over(world, self.world)
        own = {key: part for key, part in world.items() if key != "type" and part["type"] != "shapegroup"}
        same = {key for key, part in own.items() if part is self.world.get(key)}
        before = len(same) + 1
        while len(same) < before:  # a part is what it was where all that it refers to is
            before = len(same)
            same -= {key for key in same if not _refers(world[key]) <= same}
        self.parts = {key: part for key, part in self.parts.items() if key in same}
        return world


def _refers(part: Any) -> set[str]:
    """Keys of the parts that a part of a world refers to."""
    if not isinstance(part, Mapping):
        return set()
    if part.get("type") == "ref":
        return {part["id"]}
    return set().union(*map(_refers, part.values()))


@dataclass(frozen=True)
class MitsubaScene:
    """Mitsuba's side of a scene.

    Attributes:
        scene: `mi.Scene` with surfaces, lights and fog boundaries; with the lights alone where `tree` is another.
        tree: what rays are to be asked of: the scene, or a `placed.PlacedScene`.
        sensor: `mi.Sensor` or `FisheyeRays`; its film is not used.
        camera_medium: `mi.Medium` around the camera, or None in clear air.
        shapes: key -> shape object; shapes of a group under (group key, inner key).
        boundaries: index of the fog volume -> its null-material shape object.
        offset: (u, v) to add to a film position; a thin lens cannot shift its axis by itself.
        source: the scene it was made from, with its meshes joined.
        face_instances: key of a joined mesh -> number of each face, see `SceneDict.number_of`.
        parts: key -> object, of all that `source` names but what stands inside of groups.
        spectral_bsdfs: key of a material -> the object that takes its place where paths carry bands, see
            `spectra.bsdfs`; made when it is first asked for.
        light_samplers: (the phase function's mean cosine, kinds of light) -> `LightSampler`, once it was asked for;
            none where things move.
        guide_surfaces: (width, height [px], rays of a pixel) -> albedo, normal and distance that the last rays of
            `denoise.guides` met.
        known: for the scene of another frame.
    """

    scene: Scene
    tree: Scene | PlacedScene
    sensor: Any
    camera_medium: Medium | None
    shapes: Mapping[tuple[str, ...], Shape]
    boundaries: Mapping[int, Shape]
    offset: tuple[float, float]
    source: SceneDict
    face_instances: FaceInstances
    parts: Mapping[str, Any] = field(default_factory=dict)
    spectral_bsdfs: dict[str, BSDF] = field(default_factory=dict)
    light_samplers: dict[tuple[float, int], LightSampler] = field(default_factory=dict)
    guide_surfaces: dict[tuple[int, int, int], tuple[Color3f, Normal3f, Float]] = field(default_factory=dict)
    known: Earlier = field(default_factory=Earlier)


def to_mitsuba(
    source: SceneDict,
    *,
    size: tuple[int, int] | None = None,
    boundaries: bool = True,
    known: Earlier | None = None,
) -> MitsubaScene:
    """Build the scene in the variant in force.

    Args:
        source: what `translate` made.
        size: (width, height) in pixels instead of the camera's own.
        boundaries: whether the fog is in the scene as null-material shapes with media.
            Without them, lamps that `LightSampler` holds are left out of Mitsuba's own choice of lights.
        known: of another frame, whose own scene is let go.

    Raises:
        StageError: Mitsuba refuses a part; names its key.
    """
    mi = backend.mitsuba()
    photometric.register()
    surface.register()
    known = known or Earlier()
    gc.collect()  # a scene before this one must give its ids back, else every kernel is compiled anew
    if size is not None:
        source = replace(source, camera=replace(source.camera, width_px=size[0], height_px=size[1]))
    source, face_instances, prototypes = _joined(source, boundaries=boundaries, joints=known.joints)
    source = replace(source, world=known.keep(source.world))
    gc.collect()
    objects = _Objects(mi, source.world, known.parts)
    objects.build_all()
    parts, shapes = objects.parts, objects.shapes
    top = {key: parts[key] for key in source.world if key != "type" and not key.startswith("mat_")}
    backend.let_go()  # what boxes of meshes took, before the search tree takes most memory of all
    placed = None
    if prototypes is not None:
        placed = PlacedScene(shapes, source.world, prototypes, source.moving, known.groups)
    if placed is not None:
        top = {key: item for key, item in top.items() if (key,) not in shapes or "emitter" in source.world[key]}
        top["extent"] = _extent(mi, placed)
    media, fog_shapes = _fog(mi, source.fog if boundaries else ())
    surrounding = camera_fog(source) if media else None
    if media and source.camera.width_m > 0.0:
        _check_lens(source, surrounding)
    medium = None if surrounding is None else media[surrounding]
    scene = mi.load_dict({"type": "scene", **top, **{f"fog_{index}": shape for index, shape in fog_shapes.items()}})
    return MitsubaScene(
        scene,
        placed or scene,
        make_sensor(source.camera, medium),
        medium,
        shapes,
        fog_shapes,
        _offset(source.camera),
        source,
        face_instances,
        parts,
        known=replace(known, world=source.world, parts=parts) if source.moving else Earlier(),
    )


def _joined(
    source: SceneDict, *, boundaries: bool, joints: Joints
) -> tuple[SceneDict, FaceInstances, Prototypes | None]:
    """The scene with few shapes, see `flatten`, and with the lights that Mitsuba is to choose among."""
    face_instances: FaceInstances = {}
    prototypes = None
    if not backend.is_scalar():  # which has no kernels to keep small
        placing = not boundaries and not backend.is_cuda() and not source.motion_of
        source, face_instances, prototypes = flatten(source, placing=placing, joints=joints)
    world = _weighted(source)
    if not boundaries and any(_is_light(part) and not is_sampled_light(part) for part in world.values()):
        # Mitsuba wants one to choose
        world = {key: _left_out(part) if is_sampled_light(part) else part for key, part in world.items()}
    return replace(source, world=world), face_instances, prototypes


class _Objects:
    """Makes Mitsuba's objects of a world, each once.

    Attributes:
        parts: key of the world -> its object; those that are known from the beginning are not made again.
        shapes: names as in `SceneDict.instance_of` -> shape.
    """

    def __init__(self, mi: ModuleType, world: Mapping[str, Any], known: Mapping[str, Any]) -> None:
        self.parts = dict(known)
        self.shapes: dict[tuple[str, ...], Shape] = {
            (key,): part for key, part in known.items() if key.startswith(_SHAPES)
        }
        self._mi, self._world = mi, world
        self._textures: dict[tuple[int, tuple[tuple[str, bytes], ...]], tuple[Pixels, Texture]] = {}

    def build_all(self) -> None:
        """Make them all.

        Raises:
            StageError: Mitsuba refuses a part; names its key.
        """
        for key, value in self._world.items():
            if key == "type" or key in self.parts:
                continue
            if value["type"] == "shapegroup":
                forms = {name: form for name, form in value.items() if name != "type"}
                inner = {name: cast("Shape", self._build(form, f"{key}.{name}")) for name, form in forms.items()}
                self.shapes.update({(key, name): shape for name, shape in inner.items()})
                group = {"type": "shapegroup", **inner}
                self.parts[key] = self._mi.load_dict(group) if inner else self._build(group, key)
            else:
                self.parts[key] = self._build(value, key)
                if key.startswith(_SHAPES):
                    self.shapes[(key,)] = self.parts[key]

    def _build(self, value: Mapping[str, Any], key: str) -> Object:
        try:
            converted = self._convert(value, key)
            return self._mi.load_dict(converted) if isinstance(converted, dict) else converted
        except (RuntimeError, TypeError, ValueError) as error:
            raise StageError(
                f"scene part {key!r} ({value.get('type')}) is refused by the renderer: "
                f"{str(error).strip().splitlines()[-1]}"
            ) from error

    def _convert(self, value: Mapping[str, Any], key: str) -> Object | dict[str, Any]:
        if value.get("type") == "ref":
            if value["id"] not in self.parts:
                self.parts[value["id"]] = self._build(self._world[value["id"]], value["id"])
            return self.parts[value["id"]]
        if value.get("type") == "mesh":
            inner = {name: self._convert(value[name], f"{key}.{name}") for name in ("bsdf", "emitter") if name in value}
            return _mesh(self._mi, value, key, **inner)
        value = surface.for_mitsuba(value)
        leaves = {
            name: self._convert(item, f"{key}.{name}") if isinstance(item, Mapping) else _leaf(self._mi, name, item)
            for name, item in value.items()
            if name != "bitmap"
        }
        if "bitmap" not in value:
            return leaves
        if value["type"] != "bitmap":
            return leaves | {"bitmap": _leaf(self._mi, "bitmap", value["bitmap"])}
        return self._texture(value, leaves)

    def _texture(self, value: Mapping[str, Any], leaves: dict[str, Any]) -> Texture:
        """Of one picture in many surfaces one copy."""
        pixels = value["bitmap"]
        key = id(pixels), tuple((name, np.asarray(value[name]).tobytes()) for name in sorted(leaves))
        if key not in self._textures:
            texture = self._mi.load_dict(leaves | {"bitmap": _leaf(self._mi, "bitmap", pixels)})
            self._textures[key] = pixels, texture  # the pixels are kept, so that no other array gets their id
        return self._textures[key][1]


_SHAPES = ("shape_", "instance_")
"""How keys of what a ray may meet begin."""


def _fog(mi: ModuleType, fog: Sequence[FogVolume]) -> tuple[list[Medium], dict[int, Shape]]:
    """Media of fogs, and the null-material shapes that hold them by index."""
    media = [_medium(mi, volume) for volume in fog]
    shapes = {}
    for index, volume in enumerate(fog):
        sides = {"interior": media[index]} | ({} if volume.parent is None else {"exterior": media[volume.parent]})
        shapes[index] = _boundary(mi, volume.boundary, sides)
    return media, shapes


def make_bsdf(part: Mapping[str, Any]) -> BSDF:
    """A surface of a `SceneDict` by itself."""
    mi = backend.mitsuba()
    surface.register()

    def convert(value: Mapping[str, Any]) -> dict[str, Any]:
        return {
            name: convert(item) if isinstance(item, Mapping) else _leaf(mi, name, item)
            for name, item in surface.for_mitsuba(value).items()
        }

    return mi.load_dict(convert(part))


def resized(loaded: MitsubaScene, size: tuple[int, int]) -> MitsubaScene:
    """The same scene seen in (width, height) pixels; by the same sensor where nothing but a kernel asks it, so that the
    kernel stays the same.
    """
    camera = replace(loaded.source.camera, width_px=size[0], height_px=size[1])
    sensor = make_sensor(camera, loaded.camera_medium) if backend.is_scalar() else loaded.sensor
    return replace(loaded, source=replace(loaded.source, camera=camera), sensor=sensor)


def seen_by(loaded: MitsubaScene, camera: Camera) -> MitsubaScene:
    """The same scene from another camera, in the same medium; what was computed for the view is forgotten."""
    return replace(
        loaded,
        sensor=make_sensor(camera, loaded.camera_medium),
        offset=_offset(camera),
        source=replace(loaded.source, camera=camera),
        light_samplers={},
        guide_surfaces={},
    )


def in_fog(loaded: MitsubaScene, fog: tuple[FogVolume, ...]) -> MitsubaScene:
    """The same scene in other fog; for one without boundaries, where nothing of the fog is in the renderer."""
    if loaded.boundaries:
        raise ValueError("the scene was loaded with the boundaries of its fog")
    return replace(loaded, source=replace(loaded.source, fog=fog))


def camera_fog(source: SceneDict) -> int | None:
    """Index of the innermost fog volume around the camera, or None.

    Without it on the camera ray Mitsuba renders clear air and says nothing.
    """
    position = source.camera.to_world[:3, 3]
    around = [index for index, volume in enumerate(source.fog) if volume.boundary.contains(position)[0]]
    depth = {index: _depth(source, index) for index in around}
    return max(around, key=lambda index: depth[index]) if around else None


def _check_lens(source: SceneDict, surrounding: int | None) -> None:
    """Refuse an orthographic camera whose rays begin in different fogs: Mitsuba's sensor stands in one."""
    camera = source.camera
    half = 0.5 * camera.width_m * np.array([1.0, camera.height_px / camera.width_px])
    for x, y in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        place = camera.to_world.copy()
        place[:3, 3] += camera.to_world[:3, :2] @ (half * (np.array([x, y]) + 2.0 * np.array(camera.shift)))
        if camera_fog(replace(source, camera=replace(camera, to_world=place))) != surrounding:
            raise StageError(
                f"{camera.path}: the orthographic camera's rays begin in different fogs, which this model cannot tell "
                f"apart; "
                "move it wholly into or out of the fog, or use --model path"
            )


def _depth(source: SceneDict, index: int) -> int:
    count, parent = 0, source.fog[index].parent
    while parent is not None:
        count, parent = count + 1, source.fog[parent].parent
    return count


def _is_light(part: Mapping[str, Any] | str) -> bool:
    return isinstance(part, Mapping) and ("emitter" in part or part.get("type") in LIGHTS)


def _weighted(source: SceneDict) -> dict[str, Any]:
    """The world with a weight in the scene's own choice of lights for each of which the flux is known.

    The sky and each sun get 1, all lamps together 1, shared by the square root of
    their flux: a lamp that is far brighter than another is often farther away.
    """
    flux_of = {key: flux for key, flux in source.flux_of.items() if key in source.world}
    local = {key: flux for key, flux in flux_of.items() if math.isfinite(flux)}
    total = sum(map(math.sqrt, local.values()))
    world = dict(source.world)
    for key, flux in flux_of.items():
        weight = 1.0 if key not in local else math.sqrt(flux) / total if total > 0.0 else 1.0 / len(local)
        world[key] = _with_weight(world[key], weight)
    return world


def _with_weight(part: Mapping[str, Any], weight: float) -> dict[str, Any]:
    if "emitter" in part:
        return {**part, "emitter": {**part["emitter"], "sampling_weight": weight}}
    return {**part, "sampling_weight": weight}


def _left_out(part: Mapping[str, Any]) -> dict[str, Any]:
    """A lamp that Mitsuba never chooses by itself."""
    return _with_weight(part, 0.0)


def _leaf(mi: ModuleType, name: str, value: Any) -> Any:
    if name == "to_world":
        return mi.ScalarTransform4f(np.asarray(value, dtype=np.float64))
    if name == "to_uv":
        flip = np.diag([1.0, -1.0, 1.0])  # Mitsuba's v runs down
        flip[1, 2] = 1.0
        return mi.ScalarTransform3f(flip @ np.asarray(value, dtype=np.float64) @ flip)
    if name == "bitmap" and isinstance(value, np.ndarray):
        return mi.Bitmap(np.ascontiguousarray(value))
    if name == "rows":
        return backend.floats(value.ravel())
    if name == "type" and value in OURS:
        return backend.plugin_name(value)
    if name in ("row_of_face", "begin_of_row", "texels"):
        return backend.numbers(value)
    return value.tolist() if isinstance(value, np.ndarray) else value


def _mesh(mi: ModuleType, value: Mapping[str, Any], key: str, **parts: Object | dict[str, Any]) -> Mesh:
    properties = mi.Properties()
    for name, part in parts.items():
        properties[name] = mi.load_dict(part) if isinstance(part, dict) else part
    properties["face_normals"] = bool(value.get("face_normals", "normals" not in value))
    positions, faces = np.asarray(value["positions"], dtype=np.float32), np.asarray(value["faces"], dtype=np.uint32)
    mesh = mi.Mesh(
        key,
        len(positions),
        len(faces),
        has_vertex_normals="normals" in value,
        has_vertex_texcoords="texcoords" in value,
        props=properties,
    )
    if "vertex_color" in value:
        mesh.add_attribute("vertex_color", 3, np.asarray(value["vertex_color"], dtype=np.float32).ravel())
    arrays: dict[str, npt.ArrayLike] = {"vertex_positions": positions, "faces": faces}
    if "normals" in value:
        arrays["vertex_normals"] = value["normals"]
    if "texcoords" in value:
        arrays["vertex_texcoords"] = np.asarray(value["texcoords"]) * (1.0, -1.0) + (0.0, 1.0)  # Mitsuba's v runs down
    return _filled(mesh, arrays, mi)


def _filled(mesh: Mesh, arrays: Mapping[str, npt.ArrayLike], mi: ModuleType) -> Mesh:
    parameters = mi.traverse(mesh)
    for name, array in arrays.items():
        numbers = np.asarray(array, dtype=np.uint32 if name == "faces" else np.float32).ravel()
        in_pairs = name == "vertex_texcoords"  # Dr.Jit reads them so where they are aligned; all else it shares with us
        parameters[name] = backend.aligned(numbers) if in_pairs else numbers
    parameters.update()
    return mesh


def _medium(mi: ModuleType, volume: FogVolume) -> Medium:
    medium, boundary = volume.medium, volume.boundary
    record = medium.phase_function
    mitsubas = {"type": "hg", "g": medium.g} if medium.g != 0.0 else {"type": "isotropic"}
    phase = mitsubas if isinstance(record, HenyeyGreenstein) else plugin(record)
    coloured = {"type": "rgb", "value": medium.albedo_at(PRIMARIES_NM).tolist()}
    albedo = medium.albedo if medium.colours is None else coloured
    parts = {"albedo": albedo, "phase": phase, "has_spectral_extinction": False}
    empty = medium.grid is not None and not medium.grid.values.any()  # delta tracking in nothing would divide by 0
    if medium.profile == "uniform" or empty:
        return mi.load_dict({"type": "homogeneous", "sigma_t": 0.0 if empty else medium.sigma_t_per_m, **parts})
    if medium.grid is not None:
        values, frame = volume.covered()
        grid = mi.VolumeGrid((medium.sigma_t_per_m * values)[..., None])
        place = mi.ScalarTransform4f(frame) @ mi.ScalarTransform4f().translate(-1.0).scale(2.0)
    else:
        points = boundary.surface_points()
        low, high = points.min(axis=0) - 1.0, points.max(axis=0) + 1.0
        if boundary.kind == "sphere":
            reach = np.abs(boundary.to_world[:3, :3]).sum(axis=1)
            low, high = boundary.to_world[:3, 3] - reach - 1.0, boundary.to_world[:3, 3] + reach + 1.0
        heights = low[2] + (np.arange(GRID_SLICES) + 0.5) / GRID_SLICES * (high[2] - low[2])
        grid = mi.VolumeGrid(medium.sigma_t(heights).astype(np.float32).reshape(-1, 1, 1, 1))
        place = mi.ScalarTransform4f().translate(low.tolist()).scale((high - low).tolist())
    density = {"type": "gridvolume", "grid": grid, "to_world": place, "filter_type": "trilinear", "wrap_mode": "clamp"}
    return mi.load_dict({"type": "heterogeneous", "sigma_t": density, **parts})


def _boundary(mi: ModuleType, boundary: Boundary, media: Mapping[str, Medium]) -> Shape:
    """A null-material shape with `media` on its two sides."""
    null = {"bsdf": mi.load_dict({"type": "null"}), **media}
    if boundary.kind == "mesh":
        assert boundary.vertices is not None and boundary.faces is not None
        return _boundary_mesh(mi, boundary.vertices, boundary.faces, null)
    matrix = boundary.to_world.copy()
    if np.linalg.det(matrix[:3, :3]) < 0:
        matrix[:3, 0] *= -1.0
    lengths = np.linalg.norm(matrix[:3, :3], axis=0)
    if boundary.kind == "sphere" and np.ptp(lengths) > 1e-6 * lengths.max():
        import trimesh

        ball = trimesh.creation.icosphere(subdivisions=5)
        vertices = (matrix @ np.c_[ball.vertices, np.ones(len(ball.vertices))].T).T[:, :3]
        return _boundary_mesh(mi, vertices, ball.faces, null)
    return mi.load_dict(
        {"type": "cube" if boundary.kind == "box" else "sphere", "to_world": mi.ScalarTransform4f(matrix), **null}
    )


def _boundary_mesh(mi: ModuleType, vertices: Array, faces: Indices, parts: Mapping[str, Object]) -> Mesh:
    properties = mi.Properties()
    for name, part in {**parts, "face_normals": True}.items():
        properties[name] = part
    return _filled(
        mi.Mesh("fog", len(vertices), len(faces), props=properties), {"vertex_positions": vertices, "faces": faces}, mi
    )


def _extent(mi: ModuleType, placed: PlacedScene) -> Mesh:
    """A mesh that nothing meets and that reaches as far as all shapes: skies ask the scene how large it is."""
    box = placed.scene.bbox()
    return _filled(
        mi.Mesh("extent", 2, 2),
        {"vertex_positions": [list(box.min), list(box.max)], "faces": [[0, 0, 0], [1, 1, 1]]},
        mi,
    )


def _offset(camera: Camera) -> tuple[float, float]:
    """By how much a picture is moved whose sensor of Mitsuba's has no principal point."""
    return (camera.shift[0], -camera.shift[1]) if is_thin_lens(camera) else (0.0, 0.0)


def is_thin_lens(camera: Camera) -> bool:
    """Whether the camera blurs what is out of focus."""
    return camera.f_number > 0.0 and camera.focus_m > 0.0 and camera.focal_length_m > 0.0 and camera.plane


class FisheyeRays:
    """The rays of a fisheye, asked for as Mitsuba's sensors are.

    The angle to the axis is read from a table, so that a kernel holds no lens.
    """

    def __init__(self, camera: Camera) -> None:
        assert camera.fisheye is not None
        mi = backend.mitsuba()
        self.camera = camera
        if backend.is_scalar():
            return
        angles, most = camera.fisheye.table
        self.angles, rows = backend.floats(angles), len(angles) - 1
        self.rows, self.a_width = dr.opaque(mi.UInt32, rows), dr.opaque(mi.Float, rows / most)
        self.at_axis = dr.opaque(mi.Float, 1.0 / float(camera.fisheye.slope(np.zeros(()))))
        self.middle = mi.Point2f(0.5 - camera.shift[0], 0.5 + camera.shift[1])
        self.tall = dr.opaque(mi.Float, camera.height_px / camera.width_px)
        self.near, self.eye = dr.opaque(mi.Float, camera.near_m), mi.Point3f(*camera.to_world[:3, 3].tolist())
        self.axes = [mi.Vector3f(*(camera.to_world[:3, k] * sign).tolist()) for k, sign in enumerate((1.0, -1.0, -1.0))]
        dr.make_opaque(self.middle, self.eye, self.axes)

    def sample_ray(
        self, _time: float, _wavelength: float, place: Point2f, _aperture: Point2f, _active: Bool | bool = True
    ) -> tuple[Ray3f, Color3f]:
        """A ray through (u, v) of the picture, 0 to 1 from the top left, from the near plane on, which is a ball here;
        and its weight.
        """
        mi = backend.mitsuba()
        if backend.is_scalar():
            way = self.camera.directions(np.array([place.x, place.y]))
            start = self.camera.to_world[:3, 3] + self.camera.near_m * way
            return mi.Ray3f(mi.Point3f(start), mi.Vector3f(way)), mi.Color3f(1.0)
        x, y = place.x - self.middle.x, (place.y - self.middle.y) * self.tall
        radius = dr.sqrt(x * x + y * y)
        at = radius * self.a_width
        row = dr.minimum(mi.UInt32(at), self.rows - 1)
        low, high = dr.gather(mi.Float, self.angles, row), dr.gather(mi.Float, self.angles, row + 1)
        sine, cosine = dr.sincos(dr.fma(at - mi.Float(row), high - low, low))
        scale = dr.select(radius > 1e-6, sine / radius, self.at_axis)
        right, down, ahead = self.axes
        way = dr.normalize(right * (x * scale) + down * (y * scale) + ahead * cosine)
        return mi.Ray3f(self.eye + way * self.near, way), mi.Color3f(1.0)

    def sample_ray_differential(self, *given: Any) -> tuple[RayDifferential3f, Color3f]:
        """As `sample_ray`."""
        ray, weight = self.sample_ray(*given)
        return backend.mitsuba().RayDifferential3f(ray), weight


def make_sensor(camera: Camera, medium: Medium | None, *, pinhole: bool = False) -> Sensor | FisheyeRays:
    """Mitsuba's sensor for a camera inside `medium` (None in clear air); of a fisheye what makes its rays alone."""
    mi = backend.mitsuba()
    if camera.fisheye is not None:
        return FisheyeRays(camera)
    turn = np.diag([-1.0, 1.0, -1.0, 1.0])  # Mitsuba looks along +Z with +X to the left
    least = (
        1 if backend.is_scalar() else math.gcd(camera.width_px, camera.height_px)
    )  # kernels have the film's size in their text, and need its shape alone
    sensor: dict[str, Any] = {
        "to_world": mi.ScalarTransform4f(camera.to_world @ turn),
        "fov": camera.fov_x_deg,
        "fov_axis": "x",
        "near_clip": camera.near_m,
        "far_clip": 1e7,
        "film": {
            "type": "hdrfilm",
            "width": camera.width_px // least,
            "height": camera.height_px // least,
            "rfilter": {"type": "box"},
        },
    }
    if medium is not None:
        sensor["medium"] = medium
    if camera.width_m > 0.0:
        place = camera.to_world @ turn
        place[:3, 3] += camera.to_world[:3, :2] @ (
            np.array(camera.shift) * camera.width_m * np.array([1.0, camera.height_px / camera.width_px])
        )
        sensor["to_world"] = mi.ScalarTransform4f(
            place @ np.diag([0.5 * camera.width_m, 0.5 * camera.width_m, 1.0, 1.0])
        )
        return mi.load_dict(
            {"type": "orthographic", **{name: part for name, part in sensor.items() if name not in ("fov", "fov_axis")}}
        )
    if is_thin_lens(camera) and not pinhole:
        radius = camera.focal_length_m / (2.0 * camera.f_number)
        return mi.load_dict({"type": "thinlens", "aperture_radius": radius, "focus_distance": camera.focus_m, **sensor})
    shift = {"principal_point_offset_x": camera.shift[0], "principal_point_offset_y": -camera.shift[1]}
    return mi.load_dict({"type": "perspective", **shift, **sensor})
