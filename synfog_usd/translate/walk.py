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
from synfog_usd.stage.schema import PREFIX, has_fog_attributes
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.drawmode import MODES, replaces
from synfog_usd.translate.finite import is_finite
from synfog_usd.translate.lanes import TYPE as LANE_TYPE
from synfog_usd.translate.space import FAR, columns
from synfog_usd.translate.volume import vdb_fault

MAX_LEAVES = 5_000_000
"""Prims that are drawn, instances counted; a file of 2 kB can ask for more by doubling references."""

MESHES = frozenset({"Mesh", "TetMesh"})
CURVES = frozenset({"BasisCurves", "HermiteCurves", "NurbsCurves"})
DRAWN = (
    frozenset({"Cube", "Sphere", "Cylinder", "Cylinder_1", "Cone", "Capsule", "Capsule_1", "Plane"})
    | MESHES
    | CURVES
    | {"NurbsPatch", "Points"}
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
_SAID = LABEL_SOURCES | {"visibility", "purpose", "primvars:displayOpacity", "model:drawMode"}
_SAID_BEGINNINGS = (PREFIX, "userProperties:synfog")
"""Properties that mean something to the walk, by their names and by how these begin."""


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
        kind: name of its type, or the draw mode by which it stands for a model.
        authored: names of its authored properties.
        schemas: names of the API schemas applied to it.
        matrix: (4, 4) float64, to stage coordinates or to the group's frame.
        owner: nearest labelled prim, within the group for a group's leaf.
        model: path of the nearest component or, in the world, the prim itself.
        fog: prim whose fog attributes hold for this one, or None.
        material: path of the material bound above the instance that the leaf is in, or None.
        stronger: whether that material comes before the leaf's own.
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
    """All that was found."""

    leaves: list[Leaf] = field(default_factory=list)
    groups: list[Group] = field(default_factory=list)
    placements: list[GroupInstance] = field(default_factory=list)
    lanes: list[tuple[Usd.Prim, Array]] = field(default_factory=list)
    """Curves that are lanes, with their matrices to stage coordinates; outside of instances alone."""
    sheer: bool = False
    """Whether any prim has a displayOpacity."""
    clipped: bool = False
    """Whether any prim has value clips, by which others hold what no spec of theirs says."""


@dataclass(slots=True)
class _State:
    """What holds at a prim and below it."""

    depth: int
    drawn: bool
    purpose: str = "default"
    hidden: frozenset[str] = frozenset()
    authored: frozenset[str] = frozenset()
    schemas: tuple[str, ...] = ()
    owner: Owner | None = None
    model: str | None = None
    fog: Usd.Prim | None = None
    material: str | None = None
    stronger: bool = False
    mode: str = ""


def walk(stage: Usd.Stage, time: Usd.TimeCode, notes: Diagnostics) -> Walk:
    """Everything that can be seen, shines or is fog, once.

    Invisible and inactive prims and those of purpose guide and proxy, or of what the render settings do not include,
    are left out, except for fog boundaries, whose purpose does not count.

    Raises:
        StageError: nested deeper than `MAX_DEPTH` or more than `MAX_LEAVES` prims.
    """
    return _Walker(stage, time, notes).run()


class _Walker:
    def __init__(self, stage: Usd.Stage, time: Usd.TimeCode, notes: Diagnostics) -> None:
        self.stage, self.time, self.notes = stage, time, notes
        self.transforms = UsdGeom.XformCache(time)
        self.result = Walk()
        self.known_names: dict[tuple[str, ...], tuple[frozenset[str], bool, bool]] = {}
        self.known_schemas: dict[tuple[str, ...], tuple[str, ...]] = {}
        self.group_index: dict[tuple[object, ...], int] = {}
        self.open_groups: list[str] = []
        self.count = 0
        self.included = _included(stage, notes)

    def run(self) -> Walk:
        self.into(self.stage.GetPseudoRoot(), _State(-1, drawn="default" in self.included), None, None)
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
            if state is None:
                iterator.PruneChildren()
                continue
            stack.append(state)
            if state.mode in MODES and not prim.IsPrototype() and replaces(prim, state.mode):
                if state.drawn:
                    self.leaf(prim, path, state.mode, state, stack[-2], group, frame)
                iterator.PruneChildren()
            elif kind not in DRAWN and prim.IsInstance():
                self.instance(prim, state, group, frame)
                iterator.PruneChildren()
            elif kind == "PointInstancer":
                self.point_instancer(prim, state, group, frame)
                iterator.PruneChildren()
            elif kind == "BasisCurves" and group is None and LANE_TYPE in state.authored:
                self.result.lanes.append((prim, self.matrix(prim, frame)))
            elif kind not in _PASSED:
                self.leaf(prim, path, kind, state, stack[-2], group, frame)

    def names(self, prim: Usd.Prim) -> tuple[frozenset[str], bool, bool]:
        """The names of a prim's authored properties, whether any of them means something to the walk, and whether any
        moves it.
        """
        authored = tuple(prim.GetAuthoredPropertyNames())
        known = self.known_names.get(authored)
        if known is None:
            said = any(name in _SAID or name.startswith(_SAID_BEGINNINGS) for name in authored)
            moved = any(name.startswith("xformOp") for name in authored)
            known = self.known_names[authored] = (frozenset(authored), said, moved)
        return known

    def entered(
        self, prim: Usd.Prim, at: Sdf.Path, kind: str, depth: int, above: _State, *, is_frame: bool
    ) -> _State | None:
        """The state below a prim, or None where nothing below can be seen."""
        purpose, hidden, owner, model, fog = above.purpose, above.hidden, above.owner, above.model, None
        authored, says, moved = self.names(prim)
        if moved:
            self.check_order(prim, at, authored)
        schemas = tuple(prim.GetPrimTypeInfo().GetAppliedAPISchemas())
        schemas = self.known_schemas.setdefault(schemas, schemas)
        if says and "visibility" in authored:
            visibility = prim.GetAttribute("visibility").Get(self.time)
            if self.notes.token(at, "visibility", visibility, ("inherited", "invisible"), "inherited") == "invisible":
                return None
        if says and "purpose" in authored:
            purpose = self.notes.token(at, "purpose", prim.GetAttribute("purpose").Get(), _PURPOSES, "guide")
        if schemas:
            hidden = self.by_schemas(prim, at, kind, schemas, hidden)
        drawn = purpose in self.included and purpose not in hidden
        if prim.HasAuthoredMetadata("clips"):
            self.result.clipped = True
        prim_kind = prim.GetMetadata("kind") if prim.HasAuthoredMetadata("kind") else ""
        if prim_kind and not is_frame and Kind.Registry.IsA(prim_kind, Kind.Tokens.component):
            model = str(at)
        label = direct_label(prim, self.time) if says and not LABEL_SOURCES.isdisjoint(authored) else None
        if label is not None:
            path, official = str(at), official_name(label)
            if official is None:
                self.notes.warn(path, f"label {label!r} is not a Cityscapes name; it counts as {UNLABELED}")
            splits = kind == "Scope" or (bool(prim_kind) and Kind.Registry.IsA(prim_kind, Kind.Tokens.group))
            owner = Owner(path, official or UNLABELED, splits)
        if says and "primvars:displayOpacity" in authored:
            self.result.sheer = True
        mode = above.mode
        if says and "model:drawMode" in authored:
            own_mode = self.notes.token(
                at,
                "model:drawMode",
                prim.GetAttribute("model:drawMode").Get(self.time) or "inherited",
                ("inherited", "default", *MODES),
                "default",
            )
            mode = mode if own_mode == "inherited" else own_mode
        if (says or schemas) and has_fog_attributes(prim, tuple(authored)):
            fog = prim
        return _State(
            depth,
            drawn,
            purpose,
            hidden,
            authored,
            schemas,
            owner,
            model,
            fog,
            above.material,
            above.stronger,
            mode,
        )

    def by_schemas(
        self, prim: Usd.Prim, at: Sdf.Path, kind: str, schemas: tuple[str, ...], hidden: frozenset[str]
    ) -> frozenset[str]:
        """The purposes that are hidden at a prim, by its schemas and what is hidden above; lights of no kind are
        told.
        """
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
        """Tell of transforms that do not move a prim, and of those that are named and not there."""
        order = prim.GetAttribute("xformOpOrder").Get() if "xformOpOrder" in authored else None
        if order is None:
            self.notes.warn(at, "has xformOps and no xformOpOrder, without which USD moves nothing; author that too")
            return
        lost = [name for name in order if name != "!resetXformStack!" and name.removeprefix("!invert!") not in authored]
        if lost:
            self.notes.warn(at, f"xformOpOrder names {lost[0][:60]!r}, which is not there; the prim stands without it")
        for name in (one.removeprefix("!invert!") for one in order if "orient" in one):
            if not is_finite(_turn(prim.GetAttribute(name).Get(self.time))):
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
        self,
        prim: Usd.Prim,
        at: Sdf.Path,
        kind: str,
        state: _State,
        above: _State,
        group: Group | None,
        frame: Usd.Prim | None,
    ) -> None:
        is_light = kind in _LIGHTS
        fog = state.fog
        if fog is None and kind in DRAWN:
            parent = prim.GetParent()
            if above.fog is not None and parent.GetTypeName() == "Xform":
                siblings = [
                    child
                    for child in parent.GetFilteredChildren(Usd.TraverseInstanceProxies())
                    if child.IsA(UsdGeom.Gprim)
                ]
                if len(siblings) == 1:
                    fog = parent
                else:
                    self.notes.warn(
                        parent.GetPath(),
                        f"has fog attributes but {len(siblings)} shapes below; put the attributes on the boundary "
                        f"itself",
                    )
        if fog is None and kind == "Volume" and state.drawn and vdb_fault(prim) is None:
            fog = prim
        if fog is None and not is_light and kind not in DRAWN and kind not in MODES:
            self.unknown(prim, kind, state)
            return
        if fog is None and not state.drawn:
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
        path = str(at)
        model = state.model or (None if group is not None else path)
        found = Leaf(
            prim,
            path,
            kind,
            state.authored,
            state.schemas,
            matrix,
            state.owner,
            model,
            fog,
            state.material,
            state.stronger,
        )
        (self.result.leaves if group is None else group.leaves).append(found)

    def limit(self) -> None:
        if self.count > MAX_LEAVES:
            raise StageError(f"the stage draws more than {MAX_LEAVES} prims, instances counted; make it smaller")

    def unknown(self, prim: Usd.Prim, kind: str, state: _State) -> None:
        if not state.drawn or UsdShade.Material(prim) or not prim.IsA(UsdGeom.Imageable):
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
        self.place(
            [index],
            self.matrix(prim, frame)[None],
            [path],
            prim,
            [-1],
            state,
            group,
            own_instance=state.owner is not None and (state.owner.splits or state.owner.path == path),
        )

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
        own = state.owner is None or state.owner.splits or state.owner.path == path or state.model is None
        place = self.matrix(prim, frame)
        all_matrices = np.array(matrices, dtype=np.float64).reshape(-1, 4, 4).transpose(0, 2, 1)
        with np.errstate(invalid="ignore"):
            products = place @ all_matrices
        numbers = np.flatnonzero(shown)
        indices = [groups.get(kind) for kind in which[numbers].tolist()]
        paths = [f"{path}[{number}]" for number in numbers.tolist()]
        self.place(indices, products[numbers], paths, prim, numbers.tolist(), state, group, own_instance=own)

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

    def group_of(
        self,
        prototype: Usd.Prim,
        state: _State,
        bound: tuple[str | None, bool],
    ) -> int:
        """Index of the group of a prototype, walked at its first use."""
        root = str(prototype.GetPath())
        key = (root, bound, state.purpose, state.hidden, state.mode)
        known = self.group_index.get(key)
        if known is not None:
            return known
        if root in self.open_groups:
            raise StageError(f"{root}: an instancer whose prototype holds the instancer itself")
        if len(self.open_groups) > 64:
            raise StageError(f"{root}: instances nested deeper than 64 levels; flatten some")
        self.open_groups.append(root)
        group = Group(root)
        depth = prototype.GetPath().pathElementCount
        self.into(
            prototype,
            _State(
                depth - 1,
                state.drawn,
                state.purpose,
                state.hidden,
                material=bound[0],
                stronger=bound[1],
                mode=state.mode,
            ),
            group,
            prototype,
        )
        self.open_groups.pop()
        group.total = len(group.leaves) + 1 + sum(self.result.groups[one.group].total for one in group.inner)
        self.group_index[key] = len(self.result.groups)
        self.result.groups.append(group)
        return self.group_index[key]

    def place(
        self,
        indices: list[int | None],
        matrices: Array,
        paths: list[str],
        source: Usd.Prim,
        numbers: list[int],
        state: _State,
        group: Group | None,
        *,
        own_instance: bool,
    ) -> None:
        """Instances of groups, None for none, at (N, 4, 4) places, by an instance or the points of an instancer."""
        owner, model = state.owner, state.model
        standing = _stand(matrices).tolist()
        for index, matrix, path, number, stands in zip(indices, matrices, paths, numbers, standing, strict=True):
            if index is None:
                continue
            if not stands:
                self.notes.warn(
                    path,
                    "an instance scaled to nothing, or placed at no finite point or at one of more than 10 digits, is "
                    "left out",
                )
                continue
            whose = Owner(path, owner.label) if owner is not None and own_instance else owner
            placed = GroupInstance(index, matrix, path, whose, model or path, source, number)
            if group is not None:
                group.inner.append(placed)
                continue
            self.count += self.result.groups[index].total
            self.limit()
            self.put(placed)

    def put(self, placed: GroupInstance) -> None:
        """An instance, and those within it, on the stage: Mitsuba knows one level of instances."""
        waiting = [placed]
        while waiting:
            one = waiting.pop()
            found = self.result.groups[one.group]
            if found.leaves:
                self.result.placements.append(one)
            waiting += [_within(one, inner, found.root) for inner in reversed(found.inner)]


def _included(stage: Usd.Stage, notes: Diagnostics) -> frozenset[str]:
    """The purposes that are drawn: default and render, or what the render settings include."""
    settings = UsdRender.Settings.GetStageRenderSettings(stage)
    asked = list(settings.GetIncludedPurposesAttr().Get() or ()) if settings else []
    known = frozenset(asked) & frozenset(_PURPOSES)
    if settings and known != frozenset(asked):
        notes.warn(
            settings.GetPath(),
            f"includedPurposes has {', '.join(sorted(set(asked) - known))[:60]!r}; it takes {', '.join(_PURPOSES)}",
        )
    if not known or known == _USUAL:
        return _USUAL
    notes.info(settings.GetPath(), f"prims of the purposes {', '.join(sorted(known))} are drawn (includedPurposes)")
    return known


def _turn(value: object) -> list[float] | None:
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
