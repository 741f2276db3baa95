"""Budgets: how much a stage would unfold to, counted before it is unfolded.

Takes the layers of a stage that is not composed yet, or a composed stage; gives
counts, or an error.  A file of 2 kB can ask for 2^40 prims by referring to itself
twice at forty levels: every target is counted once and its number used again, so
that counting takes the time of reading the files.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Ar, Sdf, Usd, UsdGeom

from synfog_usd.errors import StageError
from synfog_usd.stage.fence import LAYERS, UNREAD_LAYERS, Fence

MAX_DEPTH = 256
"""Levels of nested prims; USD's own caches recurse and run out of stack at some thousands."""

MAX_CHAIN = 200
"""References that follow one another; composing them takes the square of their number, 0.5 s for 300."""

MAX_PRIMS = 2_000_000
"""Prims and references to compose, all variants counted; USD composes some 50 000 a second."""

MAX_LAYERS = 20_000
"""Files of scene description; also in one stack of sublayers, where one may stand many times."""

MAX_SHAPES = 5_000_000
"""Shapes and lights to draw, instances counted."""

MAX_TRIANGLES = 100_000_000
"""Triangles to store, instances not counted: some 10 GB in memory."""

MAX_BRACES = 10_000
"""Levels of braces in a text file; USD's parser calls itself for each and runs out of stack between 20 000 and 100 000."""

MAX_NESTED = 64
"""Levels of instances within instances."""


@dataclass(frozen=True)
class Size:
    """What a stage unfolds to.

    Attributes:
        prims: composed, each prototype once.
        shapes: geometry and lights, every instance counted.
        triangles: stored, each prototype's once.
    """

    prims: int
    shapes: int
    triangles: int


# -- before composition

_MATTER = frozenset({"references", "payload", "inheritPaths", "specializes", "instanceable"})
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


def read_layers(root: Path, fence: Fence) -> list[Any]:
    """Read all layers of a stage and compose none; refuse what would be too much, or lies outside the fence.

    Returns:
        the layers; while they are held, USD does not read their files again.

    Raises:
        StageError: with the prim or file, what was found and the limit.
    """
    found = _Survey(fence)
    start = found.add(str(root), "")
    if start is None:
        return []  # what is wrong with it, opening will say
    found.read_all()
    for name in found.layers:
        if (many := found.sublayers(name, 0)) > MAX_LAYERS:
            raise StageError(f"{name}: its sublayers unfold to {_amount(many)} layers; at most {MAX_LAYERS} are composed: list each once")
    total = found.stack(start, "/", 0)
    for layer, target in found.prototypes():
        total += found.stack(layer, target, 0)
    if total > MAX_PRIMS:
        raise StageError(
            f"{root}: unfolds to {_amount(total)} prims and references; at most {MAX_PRIMS} are composed: "
            f"refer to fewer things, or make what repeats instanceable"
        )
    return list(found.open.values())


class _Survey:
    """All layers that a root layer leads to, each read once."""

    def __init__(self, fence: Fence) -> None:
        self.fence = fence
        self.layers: dict[str, _Layer] = {}
        self.open: dict[str, Any] = {}  # Sdf.Layer, kept so that USD finds them read
        self.waiting: list[str] = []
        self.counted: dict[tuple[str, str], int] = {}
        self.shared: dict[tuple[str, str], None] = {}

    def add(self, file: str, who: str) -> str | None:
        """Note a layer for reading; its identifier, or None where it is not there or is no layer of ours.

        Raises:
            StageError: it lies outside the fence or is of another format.
        """
        identifier = Sdf.Layer.SplitIdentifier(file)[0]
        resolved = str(Ar.GetResolver().Resolve(identifier))
        if not resolved:
            return None
        outer = Ar.SplitPackageRelativePathOuter(resolved)[0] if Ar.IsPackageRelativePath(resolved) else resolved
        if who and (fault := self.fence.fault(outer)):
            raise StageError(f"{who}: {fault}")
        suffix = Path(Ar.SplitPackageRelativePathInner(resolved)[1] if Ar.IsPackageRelativePath(resolved) else resolved).suffix.lower()
        if suffix in UNREAD_LAYERS:
            return None
        if suffix not in LAYERS:
            raise StageError(f"{who}: refers to {identifier}, which is not USD by its name; a reference leads to one of {', '.join(LAYERS)}")
        if resolved not in self.open:
            if len(self.open) >= MAX_LAYERS:
                raise StageError(f"{who}: more than {MAX_LAYERS} layers; merge some")
            if outer == resolved:
                _check_braces(Path(resolved))
            layer = Sdf.Layer.FindOrOpen(resolved)
            if layer is None:
                return None
            self.open[resolved] = layer
            self.waiting.append(resolved)
        return resolved

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
            if path.IsPrimPath():
                if path.pathElementCount > MAX_DEPTH:
                    raise StageError(f"{str(path)[:60]}…: prims nested deeper than {MAX_DEPTH} levels; flatten the hierarchy")
                prims.append(str(path))
            keys = spec.ListInfoKeys() if spec is not None else ()
            if _MATTER.isdisjoint(keys):
                return
            shared = "instanceable" in keys and bool(spec.instanceable)
            if shared:
                instanceable.append(str(path))
            arcs.extend(self.arcs_of(name, layer, str(path), spec, shared=shared))

        _traverse(layer, visit)
        prims.sort()
        arcs.sort(key=lambda arc: arc.path)
        below = [self.add(Sdf.ComputeAssetPathRelativeToLayer(layer, str(path)), str(name)) for path in layer.subLayerPaths if str(path)]
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
                    found = self.add(Sdf.ComputeAssetPathRelativeToLayer(layer, item.assetPath), path)
                    if found is None:
                        continue
                    target = found
                yield _Arc(path, target, str(item.primPath), shared)
        if spec.HasInfo("inheritPaths") or spec.HasInfo("specializes"):
            for item in [*_items(spec.inheritPathList), *_items(spec.specializesList)]:
                yield _Arc(path, name, str(item), shared)

    def stack(self, name: str, root: str, depth: int) -> int:
        """Prims and references that composing the subtree `root` of a layer and its sublayers takes."""
        key = (name, root)
        if key in self.counted:
            return self.counted[key]
        if depth > MAX_CHAIN:
            raise StageError(f"{root} in {name}: references follow one another more than {MAX_CHAIN} deep; flatten some")
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
            if depth > MAX_CHAIN:
                raise StageError(f"{name}: sublayers nested more than {MAX_CHAIN} deep; merge some")
            self.counted[key] = 0
            layer = self.layers.get(name)
            self.counted[key] = 1 + sum(self.sublayers(below, depth + 1) for below in (layer.sublayers if layer else ()))
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


def _check_braces(path: Path) -> None:
    """Refuse a text layer whose braces nest too deeply to be parsed; those within strings count too.

    Raises:
        StageError: with the file.
    """
    level = 0
    with path.open("rb") as file:
        if file.read(5) != b"#usda":
            return
        while block := file.read(1 << 24):
            text = np.frombuffer(block, np.uint8)
            marks = text[(text == ord("{")) | (text == ord("}"))]
            if len(marks):
                levels = level + np.cumsum(np.where(marks == ord("{"), 1, -1))
                if int(levels.max()) > MAX_BRACES:
                    raise StageError(f"{path}: braces nested deeper than {MAX_BRACES} levels; flatten the hierarchy")
                level = int(levels[-1])


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


# -- of a composed stage


def check_stage(stage: Usd.Stage) -> Size:
    """Count a composed stage as its variants stand; refuse it where it is too much to draw.

    Raises:
        StageError: with the prim, what was found and the limit.
    """
    counter = _Counter(stage)
    shapes = counter.shapes(stage.GetPseudoRoot(), 0)
    if shapes > MAX_SHAPES:
        path, most = counter.largest
        where = f"{path}: its instances unfold to {_amount(most)}" if path else f"the stage unfolds to {_amount(shapes)}"
        raise StageError(f"{where} shapes; at most {MAX_SHAPES} are drawn: place fewer instances, or nest them less")
    if counter.triangles > MAX_TRIANGLES:
        path, most = counter.heaviest
        raise StageError(f"{path}: {_amount(most)} triangles, {_amount(counter.triangles)} with the rest of the stage; at most {MAX_TRIANGLES} are read")
    return Size(counter.prims, shapes, counter.triangles)


class _Counter:
    def __init__(self, stage: Usd.Stage) -> None:
        self.stage = stage
        self.prims = self.triangles = 0
        self.known: dict[str, int] = {}
        self.largest: tuple[str, int] = ("", 0)
        self.heaviest: tuple[str, int] = ("", 0)

    def shapes(self, root: Usd.Prim, depth: int) -> int:
        """Shapes and lights below `root`, instances counted; a prototype is walked once."""
        name = str(root.GetPath())
        if name in self.known:
            return self.known[name]
        if depth > MAX_NESTED:
            raise StageError(f"{name}: instances nested deeper than {MAX_NESTED} levels; flatten some")
        self.known[name] = 0  # of an instancer within its own prototype, which the walk reports
        total = 0
        for prim in Usd.PrimRange(root):
            path = prim.GetPath()
            if path.pathElementCount > MAX_DEPTH:
                raise StageError(f"{str(path)[:60]}…: prims nested deeper than {MAX_DEPTH} levels; flatten the hierarchy")
            self.prims += 1
            kind = str(prim.GetTypeName())
            count = 0
            if prim.IsInstance():
                count = self.shapes(prim.GetPrototype(), depth + 1)
            elif kind == "PointInstancer":
                count = self.points(prim, depth)
            elif kind == "Mesh":
                count = 1
                self.mesh(prim)
            elif prim.IsA(UsdGeom.Gprim) or kind.endswith("Light"):
                count = 1
            total += count
            if depth == 0 and count > self.largest[1]:
                self.largest = (str(path), count)
        self.known[name] = total
        return total

    def points(self, prim: Usd.Prim, depth: int) -> int:
        instancer = UsdGeom.PointInstancer(prim)
        which = instancer.GetProtoIndicesAttr().Get(Usd.TimeCode.EarliestTime())
        targets = instancer.GetPrototypesRel().GetForwardedTargets()
        if which is None or not targets:
            return 0
        numbers = np.asarray(which, dtype=np.int64)
        total = 0
        for number, target in enumerate(targets):
            prototype = self.stage.GetPrimAtPath(target)
            if prototype and (times := int((numbers == number).sum())):
                total += times * self.shapes(prototype, depth + 1)
        return total

    def mesh(self, prim: Usd.Prim) -> None:
        counts = UsdGeom.Mesh(prim).GetFaceVertexCountsAttr().Get(Usd.TimeCode.EarliestTime())
        if counts is None or not len(counts):
            return
        triangles = int(np.maximum(np.asarray(counts, dtype=np.int64) - 2, 0).sum())
        self.triangles += triangles
        if triangles > self.heaviest[1]:
            self.heaviest = (str(prim.GetPath()), triangles)


def _amount(number: int) -> str:
    """A count as a person reads it: 2 000 000, and above 10^12 as a power of ten.

    >>> _amount(1_234_567), _amount(2**80)
    ('1 234 567', '10^24')
    """
    return f"{number:,}".replace(",", " ") if number < 10**12 else f"10^{len(str(number)) - 1}"
