"""The survey: what the layers of a stage would compose to, counted before they are composed.

Takes a stage's root file and its fence; gives its layers, or an error.  A file of 2 kB can ask
for 2^40 prims by referring to itself twice at forty levels: every target is counted once and its
number used again, so that counting takes the time of reading the files.
"""

from __future__ import annotations

import contextlib
import glob
import math
import re
from bisect import bisect_left
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pxr import Ar, Sdf, Tf

from synfog_usd.base import system
from synfog_usd.base.errors import StageError
from synfog_usd.base.fence import LAYERS, Fence
from synfog_usd.stage import budget, materialx

_MATTER = frozenset({"references", "payload", "inheritPaths", "specializes", "instanceable", "clips", "apiSchemas"})
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


def read_layers(root: Path, fence: Fence) -> tuple[list[Any], list[str]]:
    """Read all layers of a stage and compose none; refuse what would be too much, or lies outside the fence.

    Returns:
        the layers; while they are held, USD does not read their files again.  And what of their own metadata and of
        MaterialX files is of no use and left out: the path of a prim, or '', and behind a line break a sentence.

    Raises:
        StageError: with the prim or file, what was found and the limit.
    """
    found = _Survey(fence)
    start = found.add(str(root), "")
    if start is None:
        return [], []  # what is wrong with it, opening will say
    found.read_all()
    found.check_variables()
    for name in found.layers:
        most = max(budget.MAX_REPEATED, len(found.layers))  # a stack in which each stands once has no more
        if (many := found.sublayers(name, 0)) > most:
            raise StageError(
                f"{name}: its sublayers unfold to {budget.amount(many)} layers; at most {most} are composed: list each "
                f"once"
            )
    total = found.stack(start, "/", 0)
    for layer, target in found.prototypes():
        total += found.stack(layer, target, 0)
    if total > (most := budget.most_prims()):
        raise StageError(
            f"{root}: unfolds to {budget.amount(total)} prims and references; at most {most} are composed: refer to "
            f"fewer things, make what repeats instanceable{budget.trusting(budget.MAX_PRIMS_TRUSTED)}"
        )
    return list(found.open.values()), found.left_out


class _Survey:
    """All layers that a root layer leads to, each read once."""

    def __init__(self, fence: Fence) -> None:
        self.fence = fence
        self.layers: dict[str, _Layer] = {}
        self.open: dict[str, Any] = {}  # Sdf.Layer, kept so that USD finds them read
        self.waiting: list[str] = []
        self.counted: dict[tuple[str, str], int] = {}
        self.shared: dict[tuple[str, str], None] = {}
        self.variables: dict[str, Any] = {}  # of the root layer, which win everywhere
        self.relied: dict[str, Any] = {}  # of other layers, where a path depended on them
        self.counted_files: set[str] = set()
        self.lead: dict[str, dict[tuple[str, str], str]] = {}  # layer -> its (prim, .mtlx file), and what stands for it
        self.left_out: list[str] = []

    def add(self, file: str, who: str) -> str | None:
        """Note a layer for reading; its identifier, or None where it is not there or is no layer of ours.

        Raises:
            StageError: it lies outside the fence or is of another format.
        """
        identifier = Sdf.Layer.SplitIdentifier(file)[0]
        identifier = materialx.file_of(identifier)
        resolved = str(Ar.GetResolver().Resolve(identifier))
        if not resolved:
            return None
        outer = Ar.SplitPackageRelativePathOuter(resolved)[0] if Ar.IsPackageRelativePath(resolved) else resolved
        if who and (fault := self.fence.fault(outer)):
            raise StageError(f"{who}: {fault}")
        suffix = Path(
            Ar.SplitPackageRelativePathInner(resolved)[1] if Ar.IsPackageRelativePath(resolved) else resolved
        ).suffix.lower()
        if suffix == ".mtlx" and who:
            made = materialx.layer_of(resolved, self.fence)
            self.left_out += [f"{who}\n{line}" for line in materialx.left_out_of(resolved)]
            if made is None:
                return None
            if made.identifier not in self.open:
                self.open[made.identifier] = made
                self.waiting.append(made.identifier)
            return str(made.identifier)
        if suffix not in LAYERS:
            raise StageError(
                f"{who}: refers to {identifier}, which is not USD by its name; a reference leads to one of "
                f"{', '.join((*LAYERS, '.mtlx'))}"
            )
        if resolved not in self.open:
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
            self.open[resolved] = layer
            self.waiting.append(resolved)
        return resolved

    def file(self, layer: Any, asset: str) -> str:
        """The file that an asset path of a layer means, its expression evaluated; '' where that cannot be, which USD
        tells itself.
        """
        if Sdf.VariableExpression.IsExpression(asset):
            known = {**layer.expressionVariables, **self.variables}
            made = Sdf.VariableExpression(asset).Evaluate(known)
            self.relied |= {
                name: known[name] for name in made.usedVariables if name in known and name not in self.variables
            }
            asset = made.value if isinstance(made.value, str) else ""
        return str(Sdf.ComputeAssetPathRelativeToLayer(layer, asset)) if asset else ""

    def check_variables(self) -> None:
        """Refuse a variable on which a file depends and that layers set differently: which one wins, only composing
        would tell.

        Raises:
            StageError: with the layer and the variable.
        """
        for name, layer in self.open.items():
            for variable in set(self.relied) & set(layer.expressionVariables):
                if layer.expressionVariables[variable] != self.relied[variable]:
                    raise StageError(
                        f"{name}: expression variable {variable!r} names files and has another value in another layer; "
                        f"set it in the root layer"
                    )

    def check_clips(self, layer: Any, path: str, sets: Any) -> None:
        """Refuse value clips that name too many files, or one outside of the fence; USD lists them when the stage is
        opened.

        Raises:
            StageError: with the prim.
        """
        for clips in (one for one in sets.values() if isinstance(one, dict)) if isinstance(sets, dict) else ():
            named = [
                str(item.path)
                for item in [*(clips.get("assetPaths") or ()), clips.get("manifestAssetPath")]
                if isinstance(item, Sdf.AssetPath)
            ]
            files = [self.file(layer, name) for name in named]
            template = clips.get("templateAssetPath")
            if isinstance(template, str) and template:
                begin, end, stride = (clips.get(f"template{name}") for name in ("StartTime", "EndTime", "Stride"))
                if isinstance(begin, float) and isinstance(end, float) and isinstance(stride, float):
                    many = (end - begin) / stride if stride else math.inf
                    if not many <= budget.MAX_CLIPS:
                        raise StageError(
                            f"{path}: its clips from {begin:g} to {end:g} by {stride:g} are {many:.3g} files; at most "
                            f"{budget.MAX_CLIPS} are listed: "
                            f"raise templateStride, or shorten their time"
                        )
                whole = self.file(layer, template)
                pattern = re.sub(r"#+", "*", glob.escape(whole))
                files += [whole, *sorted(glob.glob(pattern))]  # noqa: PTH207 - the folder may be absolute
            for file in files:
                if file and (fault := self.fence.fault(Ar.SplitPackageRelativePathOuter(file)[0])):
                    raise StageError(f"{path}: value clip {fault}")

    def read_all(self) -> None:
        while self.waiting:
            name = self.waiting.pop()
            self.layers[name] = self.read(name, self.open[name])

    def read(self, name: str, layer: Any) -> _Layer:
        prims: list[str] = []
        arcs: list[_Arc] = []
        instanceable: list[str] = []

        def visit(path: Any) -> None:
            if not (path.IsPrimPath() or path.IsPrimVariantSelectionPath()):
                return
            spec = layer.GetPrimAtPath(path)
            if spec is None and layer.GetObjectAtPath(path) is None:  # listing the stage's files would end the process
                raise StageError(f"{name}: {path} is named and not there; the file is damaged: export it again")
            if path.IsPrimPath():
                prims.append(str(path))
            keys = spec.ListInfoKeys() if spec is not None else ()
            if _MATTER.isdisjoint(keys):
                return
            if "clips" in keys:
                self.check_clips(layer, str(path), spec.GetInfo("clips"))
            if "apiSchemas" in keys:
                _check_schemas(name, str(path), spec.GetInfo("apiSchemas"))
            shared = "instanceable" in keys and bool(spec.instanceable)
            if shared:
                instanceable.append(str(path))
            arcs.extend(self.arcs_of(name, layer, str(path), spec, shared=shared))

        _traverse(layer, visit)
        _lead_to_memory(layer, self.lead.pop(name, {}))
        prims.sort()
        arcs.sort(key=lambda arc: arc.path)
        below = []
        for number, asset in enumerate(list(layer.subLayerPaths)):
            file = self.file(layer, str(asset))
            found = self.add(file, str(name)) if file else None
            below.append(found)
            if found and materialx.is_materialx(found):
                with _in_memory(layer):
                    layer.subLayerPaths[number] = found
        return _Layer(
            layer.defaultPrim and f"/{layer.defaultPrim.lstrip('/')}",
            prims,
            arcs,
            [arc.path for arc in arcs],
            tuple(path for path in below if path is not None),
            frozenset(instanceable),
        )

    def arcs_of(self, name: str, layer: Any, path: str, spec: Any, *, shared: bool) -> Iterator[_Arc]:
        if spec.HasInfo("references") or spec.HasInfo("payload"):
            for item in [*_items(spec.referenceList), *_items(spec.payloadList)]:
                target = name
                if item.assetPath:
                    file = self.file(layer, item.assetPath)
                    found = self.add(file, path) if file else None
                    if found is None:
                        continue
                    target = found
                    if materialx.is_materialx(found):
                        self.lead.setdefault(name, {})[path, item.assetPath] = found
                yield _Arc(path, target, str(item.primPath), shared)
        if spec.HasInfo("inheritPaths") or spec.HasInfo("specializes"):
            for item in [*_items(spec.inheritPathList), *_items(spec.specializesList)]:
                yield _Arc(path, name, str(item), shared)

    def stack(self, name: str, root: str, depth: int) -> int:
        """Prims and references that composing the subtree `root` of a layer and its sublayers takes."""
        key = (name, root)
        if key in self.counted:
            return self.counted[key]
        if depth > budget.MAX_CHAIN:
            raise StageError(
                f"{root} in {name}: references follow one another more than {budget.MAX_CHAIN} deep; flatten some"
            )
        self.counted[key] = 0  # of a cycle, which USD reports itself
        layer = self.layers.get(name)
        total = 0
        if layer is not None:
            subtree = root or layer.default
            total = sum(_ranges(layer.prims, subtree, lambda first, last: last - first))
            for first, last in _ranges(layer.arc_paths, subtree, lambda first, last: (first, last)):
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


def _ranges(paths: list[str], root: str, made: Any) -> list[Any]:
    """`made(first, last)` for the sorted paths that are `root` or below it, also within its variants."""
    if root == "/":
        return [made(0, len(paths))]
    at = bisect_left(paths, root)
    same = at
    while same < len(paths) and paths[same] == root:
        same += 1
    bounds = [(at, same)]
    for mark in ("/", "{"):
        bounds.append((bisect_left(paths, root + mark), bisect_left(paths, root + chr(ord(mark) + 1))))
    return [made(first, last) for first, last in bounds if last > first]


@contextlib.contextmanager
def _in_memory(layer: Any) -> Iterator[None]:
    """A layer may be changed meanwhile; one that was can be saved no more."""
    editable, savable = layer.permissionToEdit, layer.permissionToSave
    layer.SetPermissionToEdit(True)
    try:
        yield
    finally:
        layer.SetPermissionToEdit(editable)
        layer.SetPermissionToSave(savable and not layer.dirty)


def _retyped(layer: Any) -> list[str]:
    """Give a layer's own metadata the types of their schema: USD reads units that an exporter stored as float where
    double is wanted, and whatever asks for them falls over it.

    Returns:
        what cannot be such a type and is taken out, a line each.
    """
    root, fault = layer.pseudoRoot, []
    with _in_memory(layer):
        for key in sorted(set(root.ListInfoKeys()) & set(root.GetMetaDataInfoKeys())):
            try:
                root.SetInfo(key, root.GetInfo(key))  # changes nothing where the type is right
            except UnicodeDecodeError:  # of a word that nothing asks for
                continue
            except (TypeError, Tf.ErrorException):
                what = f"{str(root.GetInfo(key))[:40]!r}, which is of no use"
                fault.append(f"{key} of {Path(layer.realPath).name} is {what}")
                root.ClearInfo(key)
    return fault


def _lead_to_memory(layer: Any, known: dict[tuple[str, str], str]) -> None:
    """Let references to .mtlx files lead to the layers that were made of them.

    Args:
        known: (prim, file as it stands there) -> identifier of the layer, so that it is found from any folder.
    """
    if not known:
        return
    with _in_memory(layer), Sdf.ChangeBlock():
        for path in dict.fromkeys(path for path, _ in known):
            spec = layer.GetPrimAtPath(path)
            for field, kind, made in (
                ("references", Sdf.ReferenceListOp, Sdf.Reference),
                ("payload", Sdf.PayloadListOp, Sdf.Payload),
            ):
                if not spec.HasInfo(field):
                    continue
                old, new = spec.GetInfo(field), kind()
                for items in ("explicitItems", "prependedItems", "appendedItems", "addedItems", "deletedItems"):
                    listed = [_led(item, made, known.get((path, item.assetPath))) for item in getattr(old, items)]
                    if listed or (items == "explicitItems" and old.isExplicit):
                        setattr(new, items, listed)
                spec.SetInfo(field, new)


def _led(item: Any, made: Any, to: str | None) -> Any:
    if to is None:
        return item
    more = (item.customData,) if made is Sdf.Reference else ()
    return made(to, item.primPath, item.layerOffset, *more)


def _check_schemas(name: str, path: str, schemas: Any) -> None:
    """Refuse a prim of a layer with more applied schemas than are composed, or with something else in their place.

    Raises:
        StageError: with the prim.
    """
    if not isinstance(schemas, Sdf.TokenListOp):
        raise StageError(f"{name}: the apiSchemas of {path} are no list; the file is damaged: export it again")
    if (many := len(list(_items(schemas)))) > budget.MAX_SCHEMAS:
        raise StageError(
            f"{path}: {many} applied schemas; at most {budget.MAX_SCHEMAS} are composed: remove those that nothing uses"
        )


def _items(edits: Any) -> Iterable[Any]:
    return edits.GetAddedOrExplicitItems() if edits is not None else ()


def _traverse(layer: Any, visit: Any) -> None:
    """Every spec of a layer; an error in `visit` comes out after the traversal, which USD does not let it end."""
    problem: list[Exception] = []

    def guarded(path: Any) -> None:
        if not problem:
            try:
                visit(path)
            except Exception as error:  # MemoryError too: USD would print it and call on
                problem.append(error)

    layer.Traverse(Sdf.Path.absoluteRootPath, guarded)
    if problem:
        raise problem[0]
