"""The survey: prims and references of a stage, counted before they are composed.

Takes a stage's root file and its fence; gives its layers, or an error.  A file of 2 kB can ask
for 2^40 prims by referring to itself twice at forty levels: every target is counted once and its
number used again, so that counting takes the time of reading the files.
"""

from __future__ import annotations

import contextlib
import glob
import math
import re
from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from pxr import Ar, Sdf, Tf

from synfog_usd.base import system
from synfog_usd.base.errors import StageError
from synfog_usd.base.fence import LAYERS, Fence
from synfog_usd.stage import budget, materialx

_COUNTED = frozenset({"references", "payload", "inheritPaths", "specializes", "instanceable", "clips", "apiSchemas"})
"""Fields of a prim that decide how much it unfolds to."""


@dataclass(frozen=True)
class _Arc:
    """One reference, payload, inherit or specialise.

    Attributes:
        path: of the prim that has it, variants included.
        layer: identifier of the layer that it leads to.
        target: prim path there; '' for that layer's default prim.
        shared: whether the prim is an instance, so that the target is composed once.
    """

    path: str
    layer: str
    target: str
    shared: bool


@dataclass(frozen=True)
class _Layer:
    """What the count needs of one file, sorted by path so that a subtree is a range."""

    default: str
    prims: list[str]
    arcs: list[_Arc]
    arc_paths: list[str]
    sublayers: tuple[str, ...]
    instanceable: frozenset[str]


def read_layers(root: Path, fence: Fence) -> tuple[list[Sdf.Layer], list[str]]:
    """Read all layers of a stage and compose none; refuse what would be too much, or lies outside the fence.

    Returns:
        the layers, which USD does not read again while they are held; and lines about content that cannot be read and
        is left out: the path of a prim, or '', and behind a line break a sentence.

    Raises:
        StageError: with the prim or file, its size and the limit.
    """
    survey = _Survey(fence)
    start = survey.add(str(root), "")
    if start is None:
        return [], []  # USD says why when the stage is opened
    survey.read_all()
    most = max(budget.MAX_REPEATED, len(survey.layers))  # enough for a stack in which each stands once
    for name in survey.layers:
        if (many := survey.sublayers(name, 0)) > most:
            raise StageError(
                f"{name}: its sublayers unfold to {budget.amount(many)} layers; at most {most} are composed: list each "
                f"once"
            )
    total = survey.stack(start, "/", 0)
    for layer, target in survey.prototypes():
        total += survey.stack(layer, target, 0)
    if total > (most := budget.most_prims()):
        raise StageError(
            f"{root}: unfolds to {budget.amount(total)} prims and references; at most {most} are composed: refer to "
            f"fewer things, make what repeats instanceable{budget.trusting(budget.MAX_PRIMS_TRUSTED)}"
        )
    return list(survey.open.values()), survey.left_out


class _Survey:
    """All layers that a root layer leads to, each read once."""

    def __init__(self, fence: Fence) -> None:
        self.fence = fence
        self.layers: dict[str, _Layer] = {}
        self.open: dict[str, Sdf.Layer] = {}  # held, so that USD does not read their files again
        self.waiting: list[str] = []
        self.counted: dict[tuple[str, str], int] = {}
        self.shared: dict[tuple[str, str], None] = {}
        self.variables: dict[str, str] = {}  # of the root layer, which win everywhere
        self.counted_files: set[str] = set()
        self.in_memory: dict[str, dict[tuple[str, str], str]] = {}  # layer -> (prim, .mtlx file) -> layer instead
        self.left_out: list[str] = []

    def add(self, file: str, who: str) -> str | None:
        """Note a layer for reading.

        Args:
            file: path, which may lie in a package.
            who: prim or layer that refers to it; '' for the root.

        Returns:
            its identifier, or None where it is not there or is no layer of ours.

        Raises:
            StageError: it lies outside the fence or is of another format.
        """
        identifier = materialx.file_of(Sdf.Layer.SplitIdentifier(file)[0])
        resolved = str(Ar.GetResolver().Resolve(identifier))
        if not resolved:
            return None
        outer, inner = resolved, resolved
        if Ar.IsPackageRelativePath(resolved):
            outer, inner = Ar.SplitPackageRelativePathOuter(resolved)[0], Ar.SplitPackageRelativePathInner(resolved)[1]
        if who and (fault := self.fence.fault(outer)):
            raise StageError(f"{who}: {fault}")
        suffix = Path(inner).suffix.lower()
        if suffix == ".mtlx" and who:
            layer = materialx.layer_of(resolved, self.fence)
            self.left_out += [f"{who}\n{line}" for line in materialx.left_out_of(resolved)]
            if layer is None:
                return None
            return self._wait(str(layer.identifier), layer)
        if suffix not in LAYERS:
            raise StageError(
                f"{who}: refers to {identifier}, which is not USD by its name; a reference leads to one of "
                f"{', '.join((*LAYERS, '.mtlx'))}"
            )
        if resolved in self.open:
            return resolved
        if len(self.open) >= budget.MAX_LAYERS:
            raise StageError(f"{who}: more than {budget.MAX_LAYERS} layers; merge some")
        if outer not in self.counted_files:
            self.counted_files.add(outer)
            system.allow(system.PER_BYTE * Path(outer).stat().st_size)
        layer = Sdf.Layer.FindOrOpen(resolved)
        if layer is None:
            return None
        self.left_out += [f"\n{line}" for line in _retyped(layer)]
        if not self.open:
            self.variables = dict(layer.expressionVariables)
        return self._wait(resolved, layer)

    def _wait(self, name: str, layer: Sdf.Layer) -> str:
        if name not in self.open:
            self.open[name] = layer
            self.waiting.append(name)
        return name

    def file(self, layer: Sdf.Layer, asset: str) -> str:
        """The file of an asset path of a layer, its expression evaluated; '' where that fails, which USD reports."""
        if Sdf.VariableExpression.IsExpression(asset):
            result = Sdf.VariableExpression(asset).Evaluate({**layer.expressionVariables, **self.variables})
            asset = result.value if isinstance(result.value, str) else ""
        return str(Sdf.ComputeAssetPathRelativeToLayer(layer, asset)) if asset else ""

    def check_clips(self, layer: Sdf.Layer, path: str, sets: object) -> None:
        """Refuse value clips that name too many files, or one outside of the fence; USD lists them when the stage is
        opened.

        Raises:
            StageError: with the prim.
        """
        for clips in sets.values() if isinstance(sets, dict) else ():
            if not isinstance(clips, dict):
                continue
            assets = [*(clips.get("assetPaths") or ()), clips.get("manifestAssetPath")]
            files = [self.file(layer, str(asset.path)) for asset in assets if isinstance(asset, Sdf.AssetPath)]
            template = clips.get("templateAssetPath")
            if isinstance(template, str) and template:
                begin, end, stride = (clips.get(f"template{name}") for name in ("StartTime", "EndTime", "Stride"))
                if isinstance(begin, float) and isinstance(end, float) and isinstance(stride, float):
                    many = (end - begin) / stride if stride else math.inf
                    if not many <= budget.MAX_CLIPS:
                        raise StageError(
                            f"{path}: its clips from {begin:g} to {end:g} by {stride:g} are {many:.3g} files; at most "
                            f"{budget.MAX_CLIPS} are listed: raise templateStride, or shorten their time"
                        )
                file = self.file(layer, template)
                pattern = re.sub(r"#+", "*", glob.escape(file))
                files += [file, *sorted(glob.glob(pattern))]  # noqa: PTH207 - the folder may be absolute
            for file in files:
                if file and (fault := self.fence.fault(Ar.SplitPackageRelativePathOuter(file)[0])):
                    raise StageError(f"{path}: value clip {fault}")

    def read_all(self) -> None:
        """Read the layers that wait, and all that these lead to."""
        while self.waiting:
            name = self.waiting.pop()
            self.layers[name] = self.read(name, self.open[name])

    def read(self, name: str, layer: Sdf.Layer) -> _Layer:
        """Count one layer."""
        prims: list[str] = []
        arcs: list[_Arc] = []
        instanceable: list[str] = []
        for path in _prim_paths(layer):
            spec = layer.GetPrimAtPath(path)
            if spec is None and layer.GetObjectAtPath(path) is None:  # listing the stage's files would end the process
                raise StageError(f"{name}: {path} is named and not there; the file is damaged: export it again")
            if path.IsPrimPath():
                prims.append(str(path))
            keys = spec.ListInfoKeys() if spec is not None else ()
            if _COUNTED.isdisjoint(keys):
                continue
            if "clips" in keys:
                self.check_clips(layer, str(path), spec.GetInfo("clips"))
            if "apiSchemas" in keys:
                _check_schemas(name, str(path), spec.GetInfo("apiSchemas"))
            shared = "instanceable" in keys and bool(spec.instanceable)
            if shared:
                instanceable.append(str(path))
            arcs.extend(self.arcs_of(name, layer, spec, shared=shared))
        _lead_to_memory(layer, self.in_memory.pop(name, {}))
        prims.sort()
        arcs.sort(key=lambda arc: arc.path)
        return _Layer(
            layer.defaultPrim and f"/{layer.defaultPrim.lstrip('/')}",
            prims,
            arcs,
            [arc.path for arc in arcs],
            tuple(self.sublayers_of(name, layer)),
            frozenset(instanceable),
        )

    def sublayers_of(self, name: str, layer: Sdf.Layer) -> Iterator[str]:
        """Identifiers of the layers below a layer; those of .mtlx files lead to memory from now on."""
        for number, asset in enumerate(list(layer.subLayerPaths)):
            file = self.file(layer, str(asset))
            below = self.add(file, name) if file else None
            if below is None:
                continue
            if materialx.is_materialx(below):
                with _editable(layer):
                    layer.subLayerPaths[number] = below
            yield below

    def arcs_of(self, name: str, layer: Sdf.Layer, spec: Sdf.PrimSpec, *, shared: bool) -> Iterator[_Arc]:
        """References, payloads, inherits and specialises of a prim."""
        path = str(spec.path)
        if spec.HasInfo("references") or spec.HasInfo("payload"):
            for item in [*_items(spec.referenceList), *_items(spec.payloadList)]:
                target = name
                if item.assetPath:
                    file = self.file(layer, item.assetPath)
                    referred = self.add(file, path) if file else None
                    if referred is None:
                        continue
                    target = referred
                    if materialx.is_materialx(target):
                        self.in_memory.setdefault(name, {})[path, item.assetPath] = target
                yield _Arc(path, target, str(item.primPath), shared)
        if spec.HasInfo("inheritPaths") or spec.HasInfo("specializes"):
            for inherited in [*_items(spec.inheritPathList), *_items(spec.specializesList)]:
                yield _Arc(path, name, str(inherited), shared)

    def stack(self, name: str, root: str, depth: int) -> int:
        """Prims and references that composing the subtree `root` of a layer and its sublayers takes."""
        key = (name, root)
        if key in self.counted:
            return self.counted[key]
        if depth > budget.MAX_CHAIN:
            raise StageError(
                f"{root} in {name}: references follow one another more than {budget.MAX_CHAIN} deep; flatten some"
            )
        self.counted[key] = 0  # of a cycle, which USD reports
        layer = self.layers.get(name)
        total = 0
        if layer is not None:
            subtree = root or layer.default
            total = sum(last - first for first, last in _ranges(layer.prims, subtree))
            for first, last in _ranges(layer.arc_paths, subtree):
                for arc in layer.arcs[first:last]:
                    if arc.shared or self.is_instance(arc.layer, arc.target, 0):
                        self.shared[(arc.layer, arc.target)] = None
                    else:
                        total += self.stack(arc.layer, arc.target, depth + 1)
            for below in layer.sublayers:
                total += self.stack(below, root, depth + 1)
        self.counted[key] = total
        return total

    def sublayers(self, name: str, depth: int) -> int:
        """Layers in the stack of a layer, itself included, each as often as it stands there."""
        key = (name, "sublayers")
        if key not in self.counted:
            if depth > budget.MAX_CHAIN:
                raise StageError(f"{name}: sublayers nested more than {budget.MAX_CHAIN} deep; merge some")
            self.counted[key] = 0
            layer = self.layers.get(name)
            self.counted[key] = 1 + sum(
                self.sublayers(below, depth + 1) for below in (layer.sublayers if layer else ())
            )
        return self.counted[key]

    def is_instance(self, name: str, root: str, depth: int) -> bool:
        """Whether the target of an arc makes an instance of whatever refers to it."""
        layer = self.layers.get(name)
        if layer is None or depth > 8:
            return False
        subtree = root or layer.default
        if subtree in layer.instanceable:
            return True
        first = bisect_left(layer.arc_paths, subtree)
        return any(
            self.is_instance(arc.layer, arc.target, depth + 1)
            for arc in layer.arcs[first : first + 4]
            if arc.path == subtree and (arc.layer, arc.target) != (name, root)
        )

    def prototypes(self) -> Iterator[tuple[str, str]]:
        """Targets of instances, each once; counting one may bring more."""
        done = 0
        while done < len(self.shared):
            for key in list(self.shared)[done:]:
                done += 1
                yield key


def _prim_paths(layer: Sdf.Layer) -> list[Sdf.Path]:
    """Paths of all prims of a layer, and of their variants."""
    paths: list[Sdf.Path] = []

    def visit(path: Sdf.Path) -> None:
        if path.IsPrimPath() or path.IsPrimVariantSelectionPath():
            paths.append(path)

    layer.Traverse(Sdf.Path.absoluteRootPath, visit)
    return paths


def _ranges(paths: list[str], root: str) -> list[tuple[int, int]]:
    """First and last of the sorted paths that are `root` or below it, also within its variants."""
    if root == "/":
        return [(0, len(paths))]
    bounds = [(bisect_left(paths, root), bisect_right(paths, root))]
    for mark in ("/", "{"):
        bounds.append((bisect_left(paths, root + mark), bisect_left(paths, root + chr(ord(mark) + 1))))
    return [(first, last) for first, last in bounds if last > first]


@contextlib.contextmanager
def _editable(layer: Sdf.Layer) -> Iterator[None]:
    """Within it a layer may be changed in memory; one that was changed cannot be saved afterwards."""
    editable, savable = layer.permissionToEdit, layer.permissionToSave
    layer.SetPermissionToEdit(True)
    try:
        yield
    finally:
        layer.SetPermissionToEdit(editable)
        layer.SetPermissionToSave(savable and not layer.dirty)


def _retyped(layer: Sdf.Layer) -> list[str]:
    """Give a layer's own metadata the types of their schema: USD reads units that an exporter stored as float instead
    of double, and fails where their value is asked for.

    Returns:
        a line on each that has no such type and is removed.
    """
    root, faults = layer.pseudoRoot, []
    with _editable(layer):
        for key in sorted(set(root.ListInfoKeys()) & set(root.GetMetaDataInfoKeys())):
            try:
                root.SetInfo(key, root.GetInfo(key))  # changes nothing where the type is right
            except UnicodeDecodeError:  # of a word that nothing asks for
                continue
            except (TypeError, Tf.ErrorException):
                value = f"{str(root.GetInfo(key))[:40]!r}, which is of no use"
                faults.append(f"{key} of {Path(layer.realPath).name} is {value}")
                root.ClearInfo(key)
    return faults


def _lead_to_memory(layer: Sdf.Layer, replacements: dict[tuple[str, str], str]) -> None:
    """Let references to .mtlx files lead to the layers in memory that stand for them.

    Args:
        replacements: (prim, file as it is authored) -> identifier of the layer.
    """
    if not replacements:
        return
    with _editable(layer), Sdf.ChangeBlock():
        for path in dict.fromkeys(path for path, _ in replacements):
            spec = layer.GetPrimAtPath(path)
            for field, kind in (("references", Sdf.ReferenceListOp), ("payload", Sdf.PayloadListOp)):
                if not spec.HasInfo(field):
                    continue
                old, new = spec.GetInfo(field), kind()
                for items in ("explicitItems", "prependedItems", "appendedItems", "addedItems", "deletedItems"):
                    listed = [_replaced(item, replacements.get((path, item.assetPath))) for item in getattr(old, items)]
                    if listed or (items == "explicitItems" and old.isExplicit):
                        setattr(new, items, listed)
                spec.SetInfo(field, new)


def _replaced(item: Sdf.Reference | Sdf.Payload, file: str | None) -> Sdf.Reference | Sdf.Payload:
    """The same reference or payload of another file; as it is for None."""
    if file is None:
        return item
    if isinstance(item, Sdf.Payload):
        return Sdf.Payload(file, item.primPath, item.layerOffset)
    return Sdf.Reference(file, item.primPath, item.layerOffset, item.customData)


def _check_schemas(name: str, path: str, schemas: object) -> None:
    """Refuse a prim of a layer with more applied schemas than are composed, or with something else instead of them.

    Raises:
        StageError: with the prim.
    """
    if not isinstance(schemas, Sdf.TokenListOp):
        raise StageError(f"{name}: the apiSchemas of {path} are no list; the file is damaged: export it again")
    if (many := len(schemas.GetAddedOrExplicitItems())) > budget.MAX_SCHEMAS:
        raise StageError(
            f"{path}: {many} applied schemas; at most {budget.MAX_SCHEMAS} are composed: remove those that nothing uses"
        )


def _items(edits: Sdf.ListEditorProxy_SdfReferenceTypePolicy | None) -> Sequence[Sdf.Reference]:
    return edits.GetAddedOrExplicitItems() if edits is not None else ()
