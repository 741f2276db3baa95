"""A stage as a scene: the order of the rooms of `translate`.

Takes a `Usd.Stage` and a few choices; gives a `SceneDict`.  Writes nothing to the
stage.
"""

from __future__ import annotations

import contextlib
import gc
import hashlib
import math
from collections import Counter
from collections.abc import Hashable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from pxr import Sdf, Usd, UsdGeom

from synfog_usd.base.arrays import Array, FloatArray, extent
from synfog_usd.base.errors import StageError
from synfog_usd.fog import Fog, FogVolume
from synfog_usd.scene import Camera, Instance, MovingPart, SceneDict, boxes
from synfog_usd.stage.budget import MAX_ALIKE
from synfog_usd.stage.labels import UNLABELED
from synfog_usd.stage.open import authored_path, composition_notes, plain_errors, unit_notes
from synfog_usd.stage.schema import PREFIX
from synfog_usd.translate import daylight, geometry, light, medium, spectrum, volume
from synfog_usd.translate.bindings import Bindings
from synfog_usd.translate.camera import at_mid_exposure, half_exposure, read_camera
from synfog_usd.translate.convention import Chooser
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.geometry import Triangles
from synfog_usd.translate.instanced import FEWEST_KINDS, MOST_KINDS, MOST_TRIANGLES, Around, InstancePrimvars
from synfog_usd.translate.lanes import lanes
from synfog_usd.translate.lasting import Lasting
from synfog_usd.translate.lightgroup import ATTRIBUTE, MOST, SKY, authored_group, group_by_label
from synfog_usd.translate.material import Materials
from synfog_usd.translate.motion import Mover
from synfog_usd.translate.pose import Poser
from synfog_usd.translate.primvars import PrimvarValue
from synfog_usd.translate.shapes import MOST_BALLS, Meshes, Part, Shapes
from synfog_usd.translate.skel import has_skeletons, posed
from synfog_usd.translate.space import Space, columns, stage_space
from synfog_usd.translate.texture import ImageReader
from synfog_usd.translate.walk import GroupInstance, Leaf, Owner, Walk, walk

_DOMES = ("DomeLight", "DomeLight_1")

_AHEAD = 4096
"""Meshes that are read together; small ones of one topology are then tested together too."""


@dataclass(frozen=True)
class StageView:
    """How a stage is looked at, for all fields see `translate`."""

    camera: str | None = None
    frame: float | None = None
    resolution: tuple[int, int] | None = None
    fog: Fog | None = None
    lights: str = "auto"
    light_scale: float = 1.0


def translate(
    stage: Usd.Stage,
    *,
    camera: str | None = None,
    frame: float | None = None,
    resolution: tuple[int, int] | None = None,
    fog: Fog | None = None,
    lights: str = "auto",
    light_scale: float = 1.0,
) -> SceneDict:
    """One frame of a stage in Mitsuba's vocabulary, in metres, Z up, near the origin.

    Args:
        stage: with its variants chosen.
        camera: prim path; None for the render settings' camera, else the first.
        frame: time code; None for the stage's startTimeCode, else the first
            with samples, else default values.
        resolution: (width, height) [px]; None for the render settings', else 1280
            pixels wide.
        fog: for the outermost fog instead of the authored one, or clear air.  A stage
            without fog gets a layer of it.
        lights: how intensities are meant: 'usd' (UsdLux 25.05), 'blender',
            'rtx-legacy', 'metric' (normalize divides by m2), or 'auto', by the
            program that wrote the layer in which they stand.
        light_scale: factor on all lights, > 0.

    Raises:
        ParameterError: `lights` is none of these.
        StageError: nothing to look with, fog that makes no sense, or a file that
            asks for more than a machine can hold; names the prim.
    """
    view = StageView(camera, frame, resolution, fog, lights, light_scale)
    return with_boundaries(stage, view, Reused())[0]


class Outlook(NamedTuple):
    """Where a stage is looked at from, as `looked_from` gives it, and everything on it."""

    stage: Usd.Stage
    time: Usd.TimeCode
    space: Space
    eye: Camera
    content: Walk


@dataclass
class Reused:
    """Of a stage's last translation, for the next with other variants or of another frame."""

    meshes: Meshes = field(default_factory=dict)
    images: ImageReader | None = None
    lasting: Lasting | None = None


@plain_errors
def with_boundaries(stage: Usd.Stage, view: StageView, reused: Reused) -> tuple[SceneDict, tuple[str, ...], Outlook]:
    """The scene of a stage, the paths of all its fog boundaries, whatever the fog of the view, and its outlook.

    Args:
        stage: with its variants chosen.
        view: how it is looked at.
        reused: of earlier translations; what is new is added.
    """
    notes, authored = Diagnostics(), stage
    notes.extend([*composition_notes(stage), *unit_notes(stage)])
    stage, time, space, eye = looked_from(stage, view, notes)
    reused = reused if stage is authored else Reused()  # a pose is on layers of its own
    reused.lasting = lasting = reused.lasting or Lasting(stage)
    mover = Mover(stage, space, time, half_exposure(stage, time, eye.path), notes, lasting)
    images = ImageReader(notes, reused.images)
    materials = Materials(time, notes, images, lasting)
    scene = _Assembler(stage, space, time, notes, Chooser(stage, view.lights), mover, materials, reused.meshes)
    with _uncollected():
        content = walk(stage, time, notes)
        scene.build(content)
    images.let_go()
    reused.images, reused.meshes = images, scene.drawer.drawn
    scene.tell_motion()
    scene.tell_left_out()
    scene.chooser.report(notes)
    volume.rtx_fog(stage, notes)
    bounds = scene.bounds(eye.to_world[:3, 3])
    around = fog_around(scene.fog, view.fog, eye, bounds, notes)
    if len(names := sorted(set(scene.group_of.values()))) > MOST:
        raise StageError(
            f"{len(names)} light groups ({', '.join(names[:4])}, ...); at most {MOST} can be told apart: give lamps "
            f"the same {ATTRIBUTE}"
        )
    world = scene.world()
    if view.light_scale != 1.0:
        notes.info("", f"all lights are multiplied by {view.light_scale:.6g}")
        world = daylight.brightened(world, view.light_scale)
    present = set(scene.instance_of.values())
    complete = SceneDict(
        world=world,
        camera=eye,
        fog=around,
        instances=tuple(each if each.id in present else replace(each, shown=False) for each in scene.instances),
        instance_of=scene.instance_of,
        parts=tuple(scene.moving_parts.values()),
        part_of=scene.part_of,
        group_of=scene.group_of,
        flux_of={name: view.light_scale * lumen for name, lumen in scene.flux_of.items()},
        reflectance_of={key: curve for key, curve in scene.materials.reflectance_of.items() if key in world},
        emission_of=scene.emission_of,
        motion_of=scene.motion_of,
        moving=frozenset(scene.moving),
        route_m=_route(stage, space, time, eye),
        bounds_m=bounds,
        lanes=lanes(content.lanes, space, time, notes),
        origin_m=(float(space.origin_m[0]), float(space.origin_m[1]), float(space.origin_m[2])),
        notes=notes.closed(lambda path: authored_path(stage, path)),  # USD numbers its prototypes anew each time
    )
    boundaries = tuple(boundary.path for boundary in scene.fog)
    return light.with_note_on_crowd(complete), boundaries, Outlook(stage, time, space, eye, content)


@contextlib.contextmanager
def _uncollected() -> Iterator[None]:
    """No garbage collection within it: nothing of a translation is freed, and a tenth of the time would go there."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def own_frame(stage: Usd.Stage) -> float | None:
    """Time code that is drawn where none is named; None where nothing on the stage changes with time."""
    moment = _moment(stage, None, Diagnostics())
    return None if moment.IsDefault() else float(moment.GetValue())


def _moment(stage: Usd.Stage, frame: float | None, notes: Diagnostics) -> Usd.TimeCode:
    if frame is not None:
        if not math.isfinite(frame):
            raise StageError(f"frame {frame} is no finite number")
        return Usd.TimeCode(frame)
    if stage.HasAuthoredMetadata("startTimeCode") and not math.isfinite(stage.GetStartTimeCode()):
        notes.warn("", f"startTimeCode is {stage.GetStartTimeCode():g}, which is no time; it does not count")
    elif stage.HasAuthoredMetadata("startTimeCode"):
        notes.info("", f"frame {stage.GetStartTimeCode():g}, the stage's first, is drawn; choose another with --frames")
        return Usd.TimeCode(stage.GetStartTimeCode())
    if has_skeletons(stage):
        notes.info(
            "",
            "frame 0 is drawn, because the stage names no first frame and its characters need one; choose another "
            "with --frames",
        )
        return Usd.TimeCode(0.0)
    samples = [layer_samples[0] for layer in stage.GetUsedLayers() if (layer_samples := layer.ListAllTimeSamples())]
    if samples:
        notes.info(
            "",
            f"frame {min(samples):g}, the first with samples, is drawn, because the stage names no first frame; "
            f"choose another with --frames",
        )
        return Usd.TimeCode(min(samples))
    return Usd.TimeCode.Default()


def looked_from(stage: Usd.Stage, view: StageView, notes: Diagnostics) -> tuple[Usd.Stage, Usd.TimeCode, Space, Camera]:
    """The stage with its skeletons posed, the moment, the space around the camera, and the camera in it."""
    time = at_mid_exposure(stage, _moment(stage, view.frame, notes), notes, path=view.camera)
    stage = posed(stage, time, notes)
    space = stage_space(stage, notes)
    eye = read_camera(stage, space, time, notes, path=view.camera, resolution=view.resolution)
    space = replace(space, origin_m=np.round(_home(stage, space, time, eye)) + 0.0)
    to_world = eye.to_world.copy()
    to_world[:3, 3] -= space.origin_m
    return stage, time, space, replace(eye, to_world=to_world)


HOME_M = 1000.0
"""Way of a camera from its place in the stage's first frame [m] beyond which a scene has its origin near the camera:
there float32 resolves 0.06 mm.
"""


ROUTE = 33
"""Places of a camera that goes somewhere in the stage's frames."""


def _route(stage: Usd.Stage, space: Space, time: Usd.TimeCode, eye: Camera) -> Array:
    """(K, 3) places of a camera in the scene over the stage's frames; none where it stands."""
    prim, first, last = stage.GetPrimAtPath(eye.path), stage.GetStartTimeCode(), stage.GetEndTimeCode()
    moves = not time.IsDefault() and stage.HasAuthoredTimeCodeRange() and first < last
    if not moves or not math.isfinite(last - first):
        return np.zeros((0, 3))
    caches = [UsdGeom.XformCache(Usd.TimeCode(code)) for code in np.linspace(first, last, ROUTE).tolist()]
    places = np.stack([(space.matrix @ columns(cache.GetLocalToWorldTransform(prim)))[:3, 3] for cache in caches])
    return places if np.isfinite(places).all() and np.ptp(places, axis=0).any() else np.zeros((0, 3))


def _home(stage: Usd.Stage, space: Space, time: Usd.TimeCode, eye: Camera) -> Array:
    """The place [m] near which the origin of a camera's scene is: of all frames the same, so that what stands keeps its
    numbers.
    """
    place: Array = eye.to_world[:3, 3]
    if (
        time.IsDefault()
        or not stage.HasAuthoredMetadata("startTimeCode")
        or not math.isfinite(stage.GetStartTimeCode())
    ):
        return place
    start = at_mid_exposure(stage, Usd.TimeCode(stage.GetStartTimeCode()), Diagnostics(), path=eye.path)
    matrix = UsdGeom.XformCache(start).GetLocalToWorldTransform(stage.GetPrimAtPath(eye.path))
    first: Array = (space.matrix @ columns(matrix))[:3, 3]
    return first if np.linalg.norm(place - first) <= HOME_M else place


def fog_around(
    volumes: list[FogVolume], fog: Fog | None, eye: Camera, bounds_m: Array, notes: Diagnostics
) -> tuple[FogVolume, ...]:
    """Fog volumes within each other, with another fog in the outermost where one is given, and checked against the
    camera.
    """
    volume.refuse_many(volumes)
    nested = volume.nested(volumes)
    if fog is not None:
        nested = _overridden(nested, fog, eye.to_world[:3, 3], bounds_m, notes)
    volume.refuse_cut(nested, eye)
    medium.warn_of_night(nested, eye.to_world[:3, 3], notes)
    if nested and not any(part.boundary.contains(eye.to_world[:3, 3])[0] for part in nested):
        notes.info(eye.path, "the camera stands outside of every fog boundary")
    return nested


def _overridden(
    volumes: tuple[FogVolume, ...], fog: Fog, eye: Array, bounds_m: Array, notes: Diagnostics
) -> tuple[FogVolume, ...]:
    medium.warn_beyond("", fog.kinds, notes)
    if volumes or fog.clear:
        return volume.in_fog(volumes, fog)
    slab = volume.slab_around(fog, bounds_m[0], bounds_m[1], eye)
    size = 2.0 * np.diag(slab.boundary.to_world)[:3]
    notes.info(
        "",
        f"the stage has no fog; a layer of {size[0]:.0f} x {size[1]:.0f} x {size[2]:.0f} m around the camera is made "
        f"for it",
    )
    return (slab,)


class _Assembler:
    """Shapes, materials, lights, fog and labels of one scene, as they come."""

    def __init__(
        self,
        stage: Usd.Stage,
        space: Space,
        time: Usd.TimeCode,
        notes: Diagnostics,
        chooser: Chooser,
        mover: Mover,
        materials: Materials,
        meshes: Meshes,
    ) -> None:
        self.stage, self.space, self.time, self.notes, self.chooser = stage, space, time, notes, chooser
        self.images, self.materials = materials.images, materials
        self.bindings = Bindings(stage, time, notes, self.materials)
        self.drawer = Shapes(time, notes, self.materials, self.bindings, chooser, space.metres_per_unit, meshes)
        self.is_blender = str(stage.GetMetadata("documentation") or "").startswith("Blender")
        self.shapes: dict[str, dict[str, Any]] = {}
        self.groups: dict[str, dict[str, Any]] = {}
        self.placed: dict[str, dict[str, Any]] = {}
        self.lights: dict[str, dict[str, Any]] = {}
        self.domes: list[light.Dome] = []
        self.fog: list[FogVolume] = []
        self.instances: list[Instance] = []
        self.poser, self.mover = Poser(stage, space, time, notes), mover
        self.motion_of: dict[str, Array] = {}
        self.moving = set[str]()
        self.deforming: list[str] = []
        self.instance_of: dict[tuple[str, ...], int] = {}
        self.instance_ids: dict[str, int] = {}
        self.moving_parts: dict[str, MovingPart] = {}
        self.part_of: dict[tuple[str, ...], int] = {}
        self.group_of: dict[str, str] = {}
        self.flux_of: dict[str, float] = {}
        self.emission_of: dict[str, Array] = {}
        self.fog_boxes: dict[str, bool | None] = {}
        self.roots: list[str] = []
        self.spread: list[Array | FloatArray] = []
        self.alike: Counter[Hashable] = Counter()
        self.left_out: list[str] = []
        self.of_instances = InstancePrimvars(time, notes, self.bindings.inherited)

    def build(self, content: Walk) -> None:
        self.roots = [group.root for group in content.groups]
        self.bindings.sheer = content.sheer
        if content.clipped:
            self.drawer.meshes = None
        visible = [leaf for leaf in content.leaves if not leaf.unseen]
        self.bindings.look_up([*visible, *[leaf for group in content.groups for leaf in group.leaves]])
        to_scene = self.space.matrix
        for start in range(0, len(content.leaves), _AHEAD):
            some = content.leaves[start : start + _AHEAD]
            self.drawer.look_ahead(leaf for leaf in some if not leaf.unseen)
            for leaf in some:
                self.put(leaf, None, to_scene)
        placements: dict[int, list[GroupInstance]] = {}
        for placement in content.placements:
            placements.setdefault(placement.group, []).append(placement)
        for number, places in placements.items():
            self.put_group(content.groups[number].leaves, places)
        sky = light.merged_dome(self.domes, self.notes)
        if sky is not None:
            self.lights["light_sky"] = sky
            self.group_of["light_sky"] = SKY
            self.flux_of["light_sky"] = math.inf
            self.note_emission(
                "light_sky",
                *[self.stage.GetPrimAtPath(dome.path) for dome in self.domes],
                plain=sky["type"] == "constant",
            )

    def world(self) -> dict[str, Any]:
        shapes = [
            *self.shapes.values(),
            *[shape for group in self.groups.values() for name, shape in group.items() if name != "type"],
        ]
        worn = {shape["bsdf"]["id"] for shape in shapes}
        materials = {key: bsdf for key, bsdf in self.materials.bsdfs.items() if key in worn}
        return {"type": "scene", **materials, **self.shapes, **self.groups, **self.placed, **self.lights}

    def is_fog_box(self, leaf: Leaf) -> bool | None:
        """Whether a mesh without fog attributes is the box of an exported volume, see `volume.fog_box`."""
        material = self.bindings.bound.get(leaf.path)
        if material is None or leaf.kind != "Mesh":
            return False
        path = leaf.path
        if path not in self.fog_boxes:
            self.fog_boxes[path] = self.materials.is_empty(material) and volume.fog_box(
                leaf.prim, material, self.time, self.notes, is_blender=self.is_blender
            )
        return self.fog_boxes[path]

    # -- placing

    def put(self, leaf: Leaf, placement: GroupInstance | None, around: Array) -> None:
        """A leaf in the scene itself; `around` is (4, 4) to the scene of the instance that it is part of, or of the
        stage.  One that is invisible in this frame has an id alone, so that others keep theirs.
        """
        if leaf.unseen:
            self.instance(leaf, placement, around)
            return
        kind, matrix = leaf.kind, around @ leaf.matrix
        if kind in _DOMES:
            dome = light.dome(
                leaf.prim,
                kind,
                matrix,
                self.time,
                self.notes,
                self.images,
                z_up=bool((self.space.axes == np.eye(4)).all()),
            )
            if dome is not None:
                self.domes.append(dome)
            return
        if leaf.fog is not None:
            self.put_fog(leaf, leaf.fog, matrix)
            return
        if kind.endswith("Light"):
            self.put_lamp(leaf, matrix, placement, around)
            return
        fog_box = self.is_fog_box(leaf)
        if fog_box is None:
            return
        if fog_box:
            self.notes.warn(
                leaf.path,
                f"a closed mesh whose material has no surface is taken as fog of {medium.DEFAULT_MOR_M:g} m "
                f"visibility; "
                f"author {PREFIX}mor on it or on its parent for another value",
            )
            self.put_fog(leaf, None, matrix)
            return
        context = self.context(placement) if placement is not None else None
        for part in self.drawer.parts(leaf, matrix, context):
            self.add_shape(part, leaf, placement, around)

    def context(self, placement: GroupInstance, names: set[str] | None = None) -> Around:
        """Primvars that an instance gives to its leaves; names that are read are added to `names`."""

        def value(name: str) -> PrimvarValue | None:
            if names is not None:
                names.add(name)
            return self.of_instances.value(placement, name)

        return Around(Sdf.Path(self.roots[placement.group]), value)

    def put_fog(self, leaf: Leaf, source: Usd.Prim | None, matrix: Array) -> None:
        fog = volume.fog_volume(leaf.prim, source, matrix, self.time, self.notes)
        if fog is not None:
            self.fog.append(fog)

    def put_lamp(self, leaf: Leaf, matrix: Array, placement: GroupInstance | None, around: Array) -> None:
        light.refuse_many(leaf.path, len(self.flux_of))
        kind = leaf.kind
        convention = self.chooser.of(leaf.prim)
        lamp = light.lamp(
            leaf.prim,
            kind,
            matrix,
            self.time,
            self.notes,
            self.images,
            metres_per_unit=self.space.metres_per_unit,
            convention=convention,
        )
        if lamp is None:
            return
        for name in ("radiance", "irradiance", "intensity"):
            if name in lamp.emitter:
                light.refuse_blinding(leaf.path, np.asarray(lamp.emitter[name].get("value", 0.0)))
        group = SKY if kind == "DistantLight" else self.light_group(leaf, placement)
        entries = self.lights if lamp.shape is None else self.shapes
        key = f"{'light' if lamp.shape is None else 'shape'}_{len(entries)}"
        self.note_emission(key, leaf.prim)
        self.note_motion(key, leaf, placement)
        self.group_of[key], self.flux_of[key] = group, lamp.flux_lm
        if lamp.shape is None:
            self.lights[key] = lamp.emitter
            return
        black = self.materials.black().key
        if isinstance(lamp.shape, Triangles):
            shape = geometry.mesh_shape(lamp.shape, black, textured=False, colored=False)
        else:
            shape = {**lamp.shape, "bsdf": {"type": "ref", "id": black}}
        labelled = leaf.owner is not None or (placement is not None and placement.owner is not None)
        self.new_shape({**shape, "emitter": lamp.emitter}, self.instance(leaf, placement, around) if labelled else None)

    def note_emission(self, key: str, *prims: Usd.Prim, plain: bool = True) -> None:
        """Keep the spectrum that is authored on a light; that of several lights, or of a picture, is not drawn."""
        curves = [
            (prim, curve) for prim in prims if (curve := spectrum.emission(prim, self.time, self.notes)) is not None
        ]
        if curves and (len(prims) > 1 or not plain):
            self.notes.warn(
                curves[0][0].GetPath(),
                "its emission spectrum is not drawn: the sky is of a picture, or of several domes",
            )
        elif curves:
            self.emission_of[key] = curves[0][1]

    def note_motion(self, key: str, leaf: Leaf, placement: GroupInstance | None) -> None:
        """Whether a shape or lamp moves from frame to frame, and how while the shutter is open; what deforms is only
        told.
        """
        path = leaf.path
        if placement is not None:
            path = placement.path + leaf.path.removeprefix(self.roots[placement.group])
        if self.mover.elsewhere(path):
            self.moving.add(key)
        if not self.mover.open or leaf.kind == "DistantLight":
            return
        if (motion := self.mover.of(path)) is not None:
            self.motion_of[key] = motion
        if leaf.kind == "Mesh" and leaf.prim.GetAttribute("points").ValueMightBeTimeVarying():
            self.deforming.append(path)

    def note_part(self, key: str, path: str, instance: int) -> None:
        """Whether a shape belongs to what moves by itself within its instance."""
        part = self.mover.part(path, self.instances[instance - 1].path)
        if part is None:
            return
        if part not in self.moving_parts:
            frame, _ = self.poser.pose(part, self.space.matrix)
            self.moving_parts[part] = MovingPart(len(self.moving_parts) + 1, part, instance, frame)
        self.part_of[(key,)] = self.moving_parts[part].id

    def tell_motion(self) -> None:
        """Note what moves, or should, while the shutter is open."""
        if self.motion_of:
            first = next(iter(self.mover.moving))
            self.notes.info(first, f"{len(self.mover.moving)} prims move while the shutter is open, as rigid bodies")
        if self.deforming:
            self.notes.info(
                self.deforming[0],
                f"{len(self.deforming)} meshes may change their shape while the shutter is open; they are drawn in the "
                f"shape of mid-exposure",
            )

    def are_many(self, key: Hashable) -> bool:
        """Count one more of a key: whether there are more than may be."""
        self.alike[key] += 1
        return self.alike[key] > MAX_ALIKE

    def is_one_too_many(self, shape: dict[str, Any]) -> bool:
        """Whether a shape stands where too many equal ones do; all numbers are looked at where the first are equal."""
        if shape["type"] == "sphere":
            return self.are_many((*shape["center"], shape["radius"]))
        points = shape["positions"]
        ends = (shape["bsdf"]["id"], len(points), points[:1].tobytes(), points[-1:].tobytes())
        return self.are_many(ends) and self.are_many((ends, hashlib.sha256(points).digest()))

    def tell_left_out(self) -> None:
        """Note what stands too often in one place."""
        if self.left_out:
            self.notes.warn(
                self.left_out[0],
                f"{len(self.left_out)} shapes are left out: more than {MAX_ALIKE} equal ones stand in one place",
            )

    def light_group(self, leaf: Leaf, placement: GroupInstance | None) -> str:
        """Light group of a lamp: as authored on it or above it, else by the label of the thing that it belongs to."""
        above = self.stage.GetPrimAtPath(placement.path) if placement is not None else None
        owner = leaf.owner or (placement.owner if placement is not None else None)
        return (
            authored_group(leaf.prim)
            or (authored_group(above) if above else None)
            or group_by_label(owner.label if owner is not None else UNLABELED)
        )

    def add_shape(self, part: Part, leaf: Leaf, placement: GroupInstance | None, around: Array) -> None:
        """A shape in the scene itself, with its label, motion and light."""
        shape, emission, nits = part
        key = f"shape_{len(self.shapes)}"
        if emission is None and self.is_one_too_many(shape):
            self.left_out.append(leaf.path)
            return
        instance = self.instance(leaf, placement, around)
        self.note_motion(key, leaf, placement)
        if placement is None and key in self.moving:
            self.note_part(key, leaf.path, instance)
        if emission is not None:
            light.refuse_many(leaf.path, len(self.flux_of))
            material = None if light.is_light_mesh(leaf.prim) else self.bindings.bound.get(leaf.path)
            self.note_emission(key, material.GetPrim() if material else leaf.prim)
            self.group_of[key] = self.light_group(leaf, placement)
            light.refuse_blinding(leaf.path, np.asarray(nits))
            self.flux_of[key] = math.pi * _area_of(shape) * nits
            shape = {**shape, "emitter": {"type": "area", "radiance": emission}}
        self.spread.append(_corners(shape))
        self.new_shape(shape, instance)

    def new_shape(self, shape: dict[str, Any], instance: int | None) -> None:
        key = f"shape_{len(self.shapes)}"
        self.shapes[key] = shape
        if instance is not None:
            self.instance_of[(key,)] = instance

    def put_group(self, leaves: list[Leaf], places: list[GroupInstance]) -> None:
        """A group's leaves once, and its placements as instances; what shines, and few balls, are placed one by one."""
        alone = [leaf for leaf in leaves if self.stands_alone(leaf, len(places))]
        for leaf in alone:
            for place in places:
                self.put(leaf, place, self.space.matrix @ place.matrix)
        apart = {id(leaf) for leaf in alone}
        rest = [leaf for leaf in leaves if id(leaf) not in apart]
        if not rest:
            return
        names = set[str]()
        context = self.context(places[0], names)
        first = [(leaf, self.drawer.parts(leaf, leaf.matrix, context, places=len(places))) for leaf in rest]
        faces = sum(len(shape.get("faces", ())) for _, parts in first for shape, _, _ in parts)
        most = min(max(MOST_TRIANGLES // max(faces, 1), FEWEST_KINDS), MOST_KINDS)
        kinds = self.of_instances.kinds(places, sorted(names), most) if names else []
        if len(kinds) < 2:
            self.put_kind(first, places, None)
            return
        contexts = [Around(Sdf.Path(self.roots[places[0].group]), values.get) for values, _ in kinds]
        of_kinds: list[list[tuple[Leaf, list[Part]]]] = [[] for _ in kinds]
        for leaf in rest:
            with self.drawer.one_mesh():
                for parts, context in zip(of_kinds, contexts, strict=True):
                    parts.append((leaf, self.drawer.parts(leaf, leaf.matrix, context, places=len(places))))
        for parts, context, (_, rows) in zip(of_kinds, contexts, kinds, strict=True):
            self.put_kind(parts, [places[row] for row in rows.tolist()], context)

    def stands_alone(self, leaf: Leaf, places: int) -> bool:
        """Whether a leaf of a prototype is placed one by one: the only place of it, few balls, lights and fog."""
        return (
            places == 1
            or (places <= MOST_BALLS and leaf.kind == "Sphere")
            or leaf.kind.endswith("Light")
            or leaf.kind in _DOMES
            or leaf.fog is not None
            or self.is_fog_box(leaf) is not False
        )

    def put_kind(
        self, leaves: list[tuple[Leaf, list[Part]]], places: list[GroupInstance], context: Around | None
    ) -> None:
        """Instances of one group that inherit the same primvars."""
        matrices = list(self.space.matrix @ np.array([place.matrix for place in places]))
        shared = [(leaf, shape) for leaf, parts in leaves for shape, emission, _ in parts if emission is None]
        for leaf, parts in leaves:
            if all(emission is None for _, emission, _ in parts):
                continue
            for place, around in zip(places, matrices, strict=True):
                for part in self.drawer.parts(leaf, around @ leaf.matrix, context or self.context(place)):
                    if part[1] is not None:
                        self.add_shape(part, leaf, place, around)
        if not shared:
            return
        key = f"group_{len(self.groups)}"
        names = [f"shape_{n}" for n in range(len(shared))]
        shapes = {name: shape for name, (_, shape) in zip(names, shared, strict=True)}
        self.groups[key] = {"type": "shapegroup", **shapes}
        group = {"type": "ref", "id": key}
        for place, matrix in zip(places, matrices, strict=True):
            if self.are_many((key, matrix.tobytes())):
                self.left_out.append(place.path)
                continue
            instance = f"instance_{len(self.placed)}"
            self.placed[instance] = {"type": "instance", "to_world": matrix, "shapegroup": group}
            if self.mover.elsewhere(place.path):
                self.moving.add(instance)
            if (motion := self.mover.of(place.path)) is not None:
                self.motion_of[instance] = motion
            for name, (leaf, _) in zip(names, shared, strict=True):
                self.instance_of[(instance, name)] = self.instance(leaf, place, matrix)
        meshes = [shape["positions"] for _, shape in shared if "positions" in shape]
        if meshes:
            lowest, highest = boxes(*extent(*meshes), np.array(matrices))
            self.spread.append(np.stack([lowest.min(axis=0), highest.max(axis=0)]))

    def bounds(self, eye: Array) -> Array:
        """(2, 3) corners of the box around the camera and all that is drawn."""
        return np.array(extent(eye[None], *self.spread))

    # -- labels

    def instance(self, leaf: Leaf, placement: GroupInstance | None, around: Array) -> int:
        """Label id of a leaf; a new one for an owner that has none."""
        if placement is None:
            owner = leaf.owner or Owner(leaf.model or leaf.path, UNLABELED)
            return self.instance_id(owner.path, owner.label, around)
        root = self.roots[placement.group]
        if leaf.owner is not None:
            return self.instance_id(placement.path + leaf.owner.path.removeprefix(root), leaf.owner.label, around)
        if placement.owner is not None:
            return self.instance_id(placement.owner.path, placement.owner.label, around)
        path = placement.model if leaf.model is None else placement.path + leaf.model.removeprefix(root)
        return self.instance_id(path, UNLABELED, around)

    def instance_id(self, path: str, label: str, around: Array) -> int:
        if path not in self.instance_ids:
            frame, velocity = self.poser.pose(path, around)
            self.instances.append(Instance(len(self.instances) + 1, path, label, frame, velocity))
            self.instance_ids[path] = len(self.instances)
        return self.instance_ids[path]


def _corners(shape: dict[str, Any]) -> Array | FloatArray:
    """(N, 3) points in whose box a sphere or mesh of the scene lies."""
    if shape["type"] == "sphere":
        return np.array(shape["center"]) + np.array([[-1.0], [1.0]]) * shape["radius"]
    return np.asarray(shape["positions"])


def _area_of(shape: dict[str, Any]) -> float:
    """Surface [m2] of a sphere or mesh of the scene."""
    if shape["type"] == "sphere":
        return 4.0 * math.pi * shape["radius"] ** 2
    return geometry.area(Triangles(shape["positions"].astype(np.float64), shape["faces"].astype(np.int64)))
