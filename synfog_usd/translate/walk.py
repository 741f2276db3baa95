"""The one traversal: what is on a stage, where, and whose.

Takes a stage; gives leaves (things to draw, lights, fog) in stage coordinates and
placements (instances of leaves that are listed once).  Knows nothing of Mitsuba.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from pxr import Gf, Kind, Sdf, Tf, Usd, UsdGeom, UsdLux, UsdRender, UsdShade, UsdVol

from synfog_usd.base.arrays import Array, Flags
from synfog_usd.base.errors import StageError
from synfog_usd.stage.budget import MAX_DEPTH
from synfog_usd.stage.labels import LABEL_SOURCES, UNLABELED, direct_label, official_name
from synfog_usd.stage.schema import MEDIUM_PREFIX, PREFIX, has_fog_attributes
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.finite import is_finite
from synfog_usd.translate.lanes import TYPE as LANE_TYPE
from synfog_usd.translate.space import FAR, columns
from synfog_usd.translate.volume import vdb_fault

MAX_LEAVES = 5_000_000
"""Prims that are drawn, instances counted; a file of 2 kB can ask for more by doubling references."""

DRAWN = frozenset(
    {
        *("Mesh", "BasisCurves", "Points"),
        *("Cube", "Sphere", "Cylinder", "Cylinder_1", "Cone", "Capsule", "Capsule_1", "Plane"),
    }
)
_LIGHTS = frozenset(
    {"DomeLight", "DomeLight_1", "DistantLight", "SphereLight", "RectLight", "DiskLight", "CylinderLight"}
)
_PRUNED = frozenset(
    {
        "Material",
        "Shader",
        "NodeGraph",
        "Skeleton",
        "SkelAnimation",
        "BlendShape",
        "GeomSubset",
        "RenderSettings",
        "RenderProduct",
        "RenderVar",
    }
)
ALSO_OVERS = Usd.PrimIsActive & Usd.PrimIsLoaded & ~Usd.PrimIsAbstract
"""Prims that count within a prototype: artists keep prototypes under an `over`, which hides them from everything
else.
"""

_PASSED = frozenset({"", "Xform", "Scope", "SkelRoot", "Camera", "OpenVDBAsset", "Field3DAsset"})


_PURPOSES = ("default", "render", "proxy", "guide")
_USUAL = frozenset({"default", "render"})
_SHOWN = ("inherited", "visible", "invisible")
_READ = LABEL_SOURCES | {"visibility", "purpose", "primvars:displayOpacity", "model:drawMode"}
_READ_BEGINNINGS = (PREFIX, MEDIUM_PREFIX, "userProperties:synfog")
"""Properties that the walk reads, by their names and by the beginnings of these."""


@dataclass(frozen=True, slots=True)
class Owner:
    """A prim that a label or an id stands for."""

    path: str
    label: str
    splits: bool = False
    """Whether instances below are instances of their own: a group of them, not one."""


@dataclass(slots=True)
class Leaf:
    """One prim to draw, to shine or to hold fog.

    Attributes:
        prim: the prim, of the stage or of a prototype.
        path: its path.
        kind: name of its type.
        authored: names of its authored properties.
        schemas: names of the API schemas applied to it.
        matrix: (4, 4) float64, to stage coordinates or to the group's frame.
        owner: nearest labelled prim, within the group for a group's leaf.
        model: path of the nearest component or, in the world, the prim itself.
        fog: prim whose fog attributes hold for this one, or None.
        material: path of the material bound above the instance that the leaf is in, or None.
        stronger: whether that material comes before the leaf's own.
        unseen: whether it is invisible now, and not in all frames.
    """

    prim: Usd.Prim
    path: str
    kind: str
    authored: frozenset[str]
    schemas: tuple[str, ...]
    matrix: Array
    owner: Owner | None
    model: str | None
    fog: Usd.Prim | None = None
    material: str | None = None
    stronger: bool = False
    unseen: bool = False


@dataclass(slots=True)
class Group:
    """Leaves that are listed once and placed often.

    Attributes:
        root: path of the prototype, a prefix of its leaves' paths.
        leaves: what is drawn or shines.
        inner: instances within it, in its own frame.
        total: leaves and instances that placing it once makes.
    """

    root: str
    leaves: list[Leaf] = field(default_factory=list)
    inner: list[GroupInstance] = field(default_factory=list)
    total: int = 0


@dataclass(slots=True)
class GroupInstance:
    """One instance of a group.

    Attributes:
        group: index in `Walk.groups`.
        matrix: (4, 4) float64 to stage coordinates.
        path: prim path, with [n] behind a point instancer's.
        owner: labelled prim that the instance is part of, or None.
        model: path of the component around it, or the instance itself.
        source: the instance or the point instancer.
        number: of its point, -1 of an instance.
        outer: the instance in whose prototype it stands, or None.
    """

    group: int
    matrix: Array
    path: str
    owner: Owner | None
    model: str
    source: Usd.Prim
    number: int = -1
    outer: GroupInstance | None = None


@dataclass(slots=True)
class Walk:
    """Everything that a stage shows, and where."""

    leaves: list[Leaf] = field(default_factory=list)
    groups: list[Group] = field(default_factory=list)
    placements: list[GroupInstance] = field(default_factory=list)
    lanes: list[tuple[Usd.Prim, Array]] = field(default_factory=list)
    """Curves that are lanes, with their matrices to stage coordinates; outside of instances alone."""
    sheer: bool = False
    """Whether any prim has a displayOpacity."""
    clipped: bool = False
    """Whether any prim has value clips, by which prims have values that none of their specs holds."""


@dataclass(slots=True)
class _State:
    """What holds at a prim and below it."""

    depth: int
    shown: bool
    purpose: str = "default"
    hidden: frozenset[str] = frozenset()
    authored: frozenset[str] = frozenset()
    schemas: tuple[str, ...] = ()
    owner: Owner | None = None
    model: str | None = None
    fog: Usd.Prim | None = None
    material: str | None = None
    stronger: bool = False
    unseen: bool = False


def walk(stage: Usd.Stage, time: Usd.TimeCode, notes: Diagnostics) -> Walk:
    """Everything that can be seen, shines or is fog, once.

    Invisible and inactive prims are left out, and prims of a purpose that the render settings do not include; by
    default these are guide and proxy.  The purpose of a fog boundary does not count.  What is drawn in other frames
    alone is listed as unseen, but for instances.

    Raises:
        StageError: nested deeper than `MAX_DEPTH` or more than `MAX_LEAVES` prims.
    """
    return _Walker(stage, time, notes).run()


class _Walker:
    def __init__(self, stage: Usd.Stage, time: Usd.TimeCode, notes: Diagnostics) -> None:
        self.stage, self.time, self.notes = stage, time, notes
        self.transforms = UsdGeom.XformCache(time)
        self.result = Walk()
        self.properties: dict[tuple[str, ...], tuple[frozenset[str], bool, bool]] = {}
        self.schemas: dict[tuple[str, ...], tuple[str, ...]] = {}
        self.group_index: dict[tuple[object, ...], int] = {}
        self.open_groups: list[str] = []
        self.count = 0
        self.included = _included(stage, notes)

    def run(self) -> Walk:
        self.into(self.stage.GetPseudoRoot(), _State(-1, shown="default" in self.included), None, None)
        return self.result

    def into(self, root: Usd.Prim, start: _State, group: Group | None, frame: Usd.Prim | None) -> None:
        """Walk the subtree of `root`; leaves go to `group`, relative to `frame`, or to the world."""
        stack = [start]
        iterator = iter(
            Usd.PrimRange(root) if root.IsPseudoRoot() or root.IsDefined() else Usd.PrimRange(root, ALSO_OVERS)
        )
        for prim in iterator:
            path = prim.GetPath()
            depth = path.pathElementCount
            if not depth:
                continue
            if depth > MAX_DEPTH:
                raise StageError(
                    f"{str(path)[:60]}…: prims nested deeper than {MAX_DEPTH} levels; flatten the hierarchy"
                )
            while stack[-1].depth >= depth:
                stack.pop()
            kind = prim.GetTypeName()
            if kind in _PRUNED:
                iterator.PruneChildren()
                continue
            state = self.entered(prim, path, kind, depth, stack[-1], is_frame=frame is not None and prim == frame)
            if state is None or (state.unseen and (group is not None or prim.IsInstance() or kind == "PointInstancer")):
                iterator.PruneChildren()
                continue
            stack.append(state)
            if kind not in DRAWN and prim.IsInstance():
                self.instance(prim, state, group, frame)
                iterator.PruneChildren()
            elif kind == "PointInstancer":
                self.point_instancer(prim, state, group, frame)
                iterator.PruneChildren()
            elif state.unseen and kind not in DRAWN:
                continue
            elif kind == "BasisCurves" and group is None and LANE_TYPE in state.authored:
                self.result.lanes.append((prim, self.matrix(prim, frame)))
            elif kind not in _PASSED:
                self.leaf(prim, kind, state, stack[-2], group, frame)

    def names(self, prim: Usd.Prim) -> tuple[frozenset[str], bool, bool]:
        """The names of a prim's authored properties, whether the walk reads any of them, and whether any moves it."""
        authored = tuple(prim.GetAuthoredPropertyNames())
        names = self.properties.get(authored)
        if names is None:
            read = any(name in _READ or name.startswith(_READ_BEGINNINGS) for name in authored)
            moved = any(name.startswith("xformOp") for name in authored)
            names = self.properties[authored] = (frozenset(authored), read, moved)
        return names

    def entered(
        self, prim: Usd.Prim, at: Sdf.Path, kind: str, depth: int, above: _State, *, is_frame: bool
    ) -> _State | None:
        """The state below a prim, or None where nothing below can be seen."""
        authored, read, moved = self.names(prim)
        if moved:
            self.check_order(prim, at, authored)
        schemas = tuple(prim.GetPrimTypeInfo().GetAppliedAPISchemas())
        state = replace(
            above, depth=depth, authored=authored, schemas=self.schemas.setdefault(schemas, schemas), fog=None
        )
        if read and "visibility" in authored:
            visibility = prim.GetAttribute("visibility").Get(self.time)
            if self.notes.token(at, "visibility", visibility, ("inherited", "invisible"), "inherited") == "invisible":
                if not prim.GetAttribute("visibility").ValueMightBeTimeVarying():
                    return None
                state.unseen = True
        if read and "purpose" in authored:
            state.purpose = self.notes.token(at, "purpose", prim.GetAttribute("purpose").Get(), _PURPOSES, "guide")
        if schemas:
            state.hidden = self.by_schemas(prim, at, kind, schemas, state.hidden)
        state.shown = state.purpose in self.included and state.purpose not in state.hidden
        if prim.HasAuthoredMetadata("clips"):
            self.result.clipped = True
        prim_kind = prim.GetMetadata("kind") if prim.HasAuthoredMetadata("kind") else ""
        if prim_kind and not is_frame and Kind.Registry.IsA(prim_kind, Kind.Tokens.component):
            state.model = str(at)
        if read:
            self.read_properties(prim, at, kind, prim_kind, state)
        if (read or schemas) and has_fog_attributes(prim, tuple(authored)):
            state.fog = prim
        return state

    def read_properties(self, prim: Usd.Prim, at: Sdf.Path, kind: str, prim_kind: str, state: _State) -> None:
        """Label, opacity and draw mode of a prim, into the state below it."""
        label = None if LABEL_SOURCES.isdisjoint(state.authored) else direct_label(prim, self.time)
        if label is not None:
            path, official = str(at), official_name(label)
            if official is None:
                self.notes.warn(path, f"label {label!r} is not a Cityscapes name; it counts as {UNLABELED}")
            splits = kind == "Scope" or (bool(prim_kind) and Kind.Registry.IsA(prim_kind, Kind.Tokens.group))
            state.owner = Owner(path, official or UNLABELED, splits)
        if "primvars:displayOpacity" in state.authored:
            self.result.sheer = True
        if "model:drawMode" in state.authored:
            mode = prim.GetAttribute("model:drawMode").Get(self.time)
            if mode not in (None, "inherited", "default"):
                self.notes.info(at, f"draw mode {str(mode)[:40]!r} is not followed: the model itself is drawn")

    def by_schemas(
        self, prim: Usd.Prim, at: Sdf.Path, kind: str, schemas: tuple[str, ...], hidden: frozenset[str]
    ) -> frozenset[str]:
        """The purposes that are hidden at a prim, by its schemas and those hidden above it."""
        for name in schemas:
            if name == "VisibilityAPI":
                hidden = self.hidden_purposes(prim, at)
            elif (name == "MeshLightAPI" and kind not in DRAWN) or name == "VolumeLightAPI":
                self.notes.warn(at, f"{name} on a {kind or 'prim without type'} is not drawn: it is dark")
            elif name == "LightAPI" and "Light" not in kind:
                self.notes.warn(at, f"LightAPI alone makes no light of a {kind or 'prim without type'}: it is dark")
        return hidden

    def hidden_purposes(self, prim: Usd.Prim, at: Sdf.Path) -> frozenset[str]:
        """Purposes that a prim's VisibilityAPI hides; the nearest one alone counts, also where it says 'inherited'."""
        hidden = set()
        for purpose in ("render", "proxy", "guide"):
            attribute = prim.GetAttribute(f"{purpose}Visibility")
            value = attribute.Get(self.time) if attribute.HasAuthoredValue() else None
            if self.notes.token(at, attribute.GetName(), value, _SHOWN, "inherited") == "invisible":
                hidden.add(purpose)
        return frozenset(hidden)

    def check_order(self, prim: Usd.Prim, at: Sdf.Path, authored: frozenset[str]) -> None:
        """Note transforms that do not move a prim, and missing ones that its order names."""
        order = prim.GetAttribute("xformOpOrder").Get() if "xformOpOrder" in authored else None
        if order is None:
            self.notes.warn(at, "has xformOps and no xformOpOrder, without which USD moves nothing; author that too")
            return
        lost = [name for name in order if name != "!resetXformStack!" and name.removeprefix("!invert!") not in authored]
        if lost:
            self.notes.warn(at, f"xformOpOrder names {lost[0][:60]!r}, which is not there; the prim stands without it")
        for name in (op.removeprefix("!invert!") for op in order if "orient" in op):
            if not is_finite(_quaternion(prim.GetAttribute(name).Get(self.time))):
                self.notes.warn(at, f"{name} holds numbers that are not finite; the prim stands unturned")

    def matrix(self, prim: Usd.Prim, frame: Usd.Prim | None) -> Array:
        if frame is None:
            try:
                return columns(self.transforms.GetLocalToWorldTransform(prim))
            except Tf.ErrorException as problem:
                raise StageError(
                    f"{prim.GetPath()}: an xformOp of this prim, or of one above it, has a name or type that USD does "
                    f"not know; correct it"
                ) from problem
        if prim == frame:
            return np.eye(4)
        matrix, resets = self.transforms.ComputeRelativeTransform(prim, frame)
        if resets:
            self.notes.warn(
                prim.GetPath(),
                "!resetXformStack! within an instance is not followed: the prim stands where the instance has it",
            )
        return columns(matrix)

    def leaf(
        self, prim: Usd.Prim, kind: str, state: _State, above: _State, group: Group | None, frame: Usd.Prim | None
    ) -> None:
        """Add a prim that is drawn, shines or holds fog; note any other."""
        fog = state.fog
        if fog is None and kind in DRAWN and above.fog is not None:
            fog = self.fog_above(prim)
        if fog is None and kind == "Volume" and state.shown and vdb_fault(prim) is None:
            fog = prim
        if fog is None and kind not in _LIGHTS and kind not in DRAWN:
            self.unknown(prim, kind, state)
            return
        if (fog is None and not state.shown) or (fog is not None and state.unseen):
            return
        self.count += 1
        self.limit()
        matrix = self.matrix(prim, frame)
        if not np.abs(matrix).max() <= FAR:
            self.notes.warn(
                prim.GetPath(),
                "a prim placed or scaled by a number that is not finite, or of more than 10 digits, is left out",
            )
            return
        path = str(prim.GetPath())
        leaf = Leaf(
            prim,
            path,
            kind,
            state.authored,
            state.schemas,
            matrix,
            state.owner,
            state.model or (None if group is not None else path),
            fog,
            state.material,
            state.stronger,
            state.unseen,
        )
        (self.result.leaves if group is None else group.leaves).append(leaf)

    def fog_above(self, prim: Usd.Prim) -> Usd.Prim | None:
        """The Xform above a shape, whose fog attributes hold for it where it is the only one below."""
        parent = prim.GetParent()
        if parent.GetTypeName() != "Xform":
            return None
        children = parent.GetFilteredChildren(Usd.TraverseInstanceProxies())
        shapes = sum(bool(child.IsA(UsdGeom.Gprim)) for child in children)
        if shapes == 1:
            return parent
        self.notes.warn(
            parent.GetPath(), f"has fog attributes but {shapes} shapes below; put the attributes on the boundary itself"
        )
        return None

    def limit(self) -> None:
        if self.count > MAX_LEAVES:
            raise StageError(f"the stage draws more than {MAX_LEAVES} prims, instances counted; make it smaller")

    def unknown(self, prim: Usd.Prim, kind: str, state: _State) -> None:
        if not state.shown or UsdShade.Material(prim) or not prim.IsA(UsdGeom.Imageable):
            if prim.HasAPI(UsdLux.LightAPI):
                self.notes.warn(prim.GetPath(), f"light of type {kind} is not known; it is dark")
            return
        if prim.IsA(UsdVol.Volume):
            self.notes.warn(prim.GetPath(), f"Volume is not drawn: {vdb_fault(prim)}")
        elif prim.IsA(UsdGeom.Gprim):
            self.notes.warn(prim.GetPath(), f"{kind} is not drawn; convert it to a Mesh")
        elif kind == "PortalLight":
            self.notes.info(prim.GetPath(), "PortalLight is left out; it only guides the sampling of a dome light")
        elif prim.HasAPI(UsdLux.LightAPI):
            self.notes.warn(prim.GetPath(), f"light of type {kind} is not known; it is dark")

    def instance(self, prim: Usd.Prim, state: _State, group: Group | None, frame: Usd.Prim | None) -> None:
        prototype = prim.GetPrototype()
        path = str(prim.GetPath())
        index = self.group_of(prototype, state, self.bound(prim, state))
        placed = GroupInstance(index, self.matrix(prim, frame), path, state.owner, state.model or path, prim)
        own_instance = state.owner is not None and (state.owner.splits or state.owner.path == path)
        self.place([placed], group, own_instance=own_instance)

    def point_instancer(self, prim: Usd.Prim, state: _State, group: Group | None, frame: Usd.Prim | None) -> None:
        instancer = UsdGeom.PointInstancer(prim)
        path = str(prim.GetPath())
        targets = instancer.GetPrototypesRel().GetForwardedTargets()
        which = instancer.GetProtoIndicesAttr().Get(self.time)
        if not targets or which is None:
            self.notes.warn(path, "PointInstancer without prototypes or indices is left out")
            return
        which = np.asarray(which, dtype=np.int64)
        matrices = instancer.ComputeInstanceTransformsAtTime(
            self.time, self.time, UsdGeom.PointInstancer.IncludeProtoXform, UsdGeom.PointInstancer.IgnoreMask
        )
        if len(matrices) != len(which) or (which.size and not 0 <= which.min() <= which.max() < len(targets)):
            self.notes.warn(
                path, "PointInstancer whose positions, indices and prototypes do not fit each other is left out"
            )
            return
        mask = instancer.ComputeMaskAtTime(self.time)
        shown = np.asarray(mask, dtype=bool) if len(mask) == len(which) else np.ones(len(which), dtype=bool)
        groups = {}
        for number in sorted(set(which[shown].tolist())):
            prototype = self.stage.GetPrimAtPath(targets[number])
            if (
                not prototype
                or not (prototype.IsDefined() or prototype.HasDefiningSpecifier())
                or prototype.IsAbstract()
            ):
                self.notes.warn(path, f"prototype {targets[number]} is missing or abstract; its points are left out")
                continue
            groups[number] = self.group_of(prototype, state, self.bound(prim, state))
        own_instance = state.owner is None or state.owner.splits or state.owner.path == path or state.model is None
        all_matrices = np.array(matrices, dtype=np.float64).reshape(-1, 4, 4).transpose(0, 2, 1)
        with np.errstate(invalid="ignore"):
            products = self.matrix(prim, frame) @ all_matrices
        numbers = np.flatnonzero(shown)
        indices = [groups.get(kind) for kind in which[numbers].tolist()]
        placed = [
            GroupInstance(index, matrix, point := f"{path}[{number}]", state.owner, state.model or point, prim, number)
            for index, matrix, number in zip(indices, products[numbers], numbers.tolist(), strict=True)
            if index is not None
        ]
        self.place(placed, group, own_instance=own_instance)

    def bound(self, prim: Usd.Prim, state: _State) -> tuple[str | None, bool]:
        """Path of the material that leaves below an instance inherit from outside, and whether it comes before
        theirs.
        """
        if state.stronger:
            return state.material, True
        for purpose in (UsdShade.Tokens.full, UsdShade.Tokens.preview):
            material, relationship = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial(purpose)
            if material:
                strength = UsdShade.MaterialBindingAPI.GetMaterialBindingStrength(relationship)
                return str(material.GetPath()), strength == UsdShade.Tokens.strongerThanDescendants
        return state.material, False

    def group_of(self, prototype: Usd.Prim, state: _State, bound: tuple[str | None, bool]) -> int:
        """Index of the group of a prototype, walked at its first use."""
        root = str(prototype.GetPath())
        key = (root, bound, state.purpose, state.hidden)
        if key in self.group_index:
            return self.group_index[key]
        if root in self.open_groups:
            raise StageError(f"{root}: an instancer whose prototype holds the instancer itself")
        if len(self.open_groups) > 64:
            raise StageError(f"{root}: instances nested deeper than 64 levels; flatten some")
        self.open_groups.append(root)
        group = Group(root)
        depth = prototype.GetPath().pathElementCount
        material, stronger = bound
        start = _State(depth - 1, state.shown, state.purpose, state.hidden, material=material, stronger=stronger)
        self.into(prototype, start, group, prototype)
        self.open_groups.pop()
        group.total = len(group.leaves) + 1 + sum(self.result.groups[inner.group].total for inner in group.inner)
        self.group_index[key] = len(self.result.groups)
        self.result.groups.append(group)
        return self.group_index[key]

    def place(self, instances: list[GroupInstance], group: Group | None, *, own_instance: bool) -> None:
        """Add the instances of one prim or point instancer that stand somewhere.

        Args:
            own_instance: whether each is an instance of its own for labels, or part of what is labelled above.
        """
        standing = _stand(np.array([instance.matrix for instance in instances]).reshape(-1, 4, 4)).tolist()
        for instance, stands in zip(instances, standing, strict=True):
            if not stands:
                self.notes.warn(
                    instance.path,
                    "an instance scaled to nothing, or placed at no finite point or at one of more than 10 digits, is "
                    "left out",
                )
                continue
            if instance.owner is not None and own_instance:
                instance.owner = Owner(instance.path, instance.owner.label)
            if group is not None:
                group.inner.append(instance)
                continue
            self.count += self.result.groups[instance.group].total
            self.limit()
            self.put(instance)

    def put(self, outermost: GroupInstance) -> None:
        """An instance, and those within it, on the stage: Mitsuba knows one level of instances."""
        waiting = [outermost]
        while waiting:
            instance = waiting.pop()
            group = self.result.groups[instance.group]
            if group.leaves:
                self.result.placements.append(instance)
            waiting += [_within(instance, inner, group.root) for inner in reversed(group.inner)]


def _included(stage: Usd.Stage, notes: Diagnostics) -> frozenset[str]:
    """The purposes that are drawn: default and render, or what the render settings include."""
    settings = UsdRender.Settings.GetStageRenderSettings(stage)
    authored = frozenset(settings.GetIncludedPurposesAttr().Get() or ()) if settings else frozenset()
    purposes = authored & frozenset(_PURPOSES)
    if purposes != authored:
        notes.warn(
            settings.GetPath(),
            f"includedPurposes has {', '.join(sorted(authored - purposes))[:60]!r}; it takes {', '.join(_PURPOSES)}",
        )
    if not purposes or purposes == _USUAL:
        return _USUAL
    notes.info(settings.GetPath(), f"prims of the purposes {', '.join(sorted(purposes))} are drawn (includedPurposes)")
    return purposes


def _quaternion(value: object) -> list[float] | None:
    """The four numbers of a quaternion; None for anything else."""
    return [value.real, *value.imaginary] if isinstance(value, (Gf.Quatd, Gf.Quatf, Gf.Quath)) else None


def _stand(matrices: Array) -> Flags:
    """(N,) whether places (N, 4, 4) are finite, within `FAR`, and not flat."""
    with np.errstate(over="ignore", invalid="ignore"):
        return (np.abs(matrices).max(axis=(1, 2), initial=0.0) <= FAR) & (
            np.abs(np.linalg.det(matrices[:, :3, :3])) >= 1e-300
        )


def _within(outer: GroupInstance, inner: GroupInstance, root: str) -> GroupInstance:
    """An instance of a prototype as it stands on the stage by an instance of that prototype."""
    owner = outer.owner
    if inner.owner is not None:
        owner = replace(inner.owner, path=outer.path + inner.owner.path.removeprefix(root))
    path = outer.path + inner.path.removeprefix(root)
    model = outer.model if inner.model == inner.path else outer.path + inner.model.removeprefix(root)
    return GroupInstance(
        inner.group, outer.matrix @ inner.matrix, path, owner, model, inner.source, inner.number, outer
    )
