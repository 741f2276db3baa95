"""Budgets: how much a stage would unfold to, counted before it is unfolded.

Holds the limits; takes a composed stage and gives counts, or an error.  Instances of
instances can ask for 2^40 shapes in 2 kB: a prototype is counted once and its number used
again.  What stands before composition is counted in `synfog_usd.stage.survey`.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
from pxr import Usd, UsdGeom

from synfog_usd.base.errors import StageError

MAX_DEPTH = 256
"""Levels of nested prims; USD's own caches recurse and run out of stack at some thousands."""

MAX_CHAIN = 200
"""References that follow one another; composing them takes the square of their number, 0.5 s for 300."""

TRUSTED = "SYNFOG_USD_LARGE"
"""Environment variable that lifts `MAX_PRIMS`, `MAX_FOGS`, `MAX_LAMPS`: the user trusts the stage and waits."""

MAX_PRIMS = 100_000
"""Prims and references to compose, all variants counted; each takes up to 0.4 ms and 9 kB."""

MAX_PRIMS_TRUSTED = 2_000_000

MAX_FOGS = 200
"""Fog volumes of one picture: a kernel tests each of them for each stretch of a path."""

MAX_FOGS_TRUSTED = 1000

MAX_LAMPS = 5000
"""Lamps and lit surfaces, instances counted; each takes 1 to 3 ms of a bake."""

MAX_LAMPS_TRUSTED = 100_000

MAX_LIT_TRIANGLES = 4_000_000
"""Triangles of all lit surfaces; each can be asked for light, and takes 0.4 kB."""

MAX_LIT_KINDS = 1000
"""Kinds of lit surfaces: of different radiance, light group, spectrum or material; each that moves or shines by a
picture is one.  Those of one kind are drawn together where they are many; each kind takes 3 to 11 ms.
"""

MAX_LAYERS = 20_000
"""Files of scene description; also in one stack of sublayers, where one may stand many times."""

MAX_SHAPES = 800_000
"""Shapes and lights to draw, instances counted; each instance takes 1.7 kB while it is translated."""

MAX_REPEATED = 2000
"""Layers in a stack of sublayers in which some stand more than once: composing it takes the square of their number, 3 s
for 16 000.
"""

MAX_TRIANGLES = 100_000_000
"""Triangles to store, instances not counted: some 10 GB in memory."""

FEW_TRIANGLES, PER_POINT = 1_000_000, 20
"""Triangles of a mesh beyond these need a point for each `PER_POINT`: a closed surface has two for each, and equal
numbers in a small file unfold to any amount.
"""

MAX_ALIKE = 64
"""Equal shapes in one place that are drawn: no search tree parts them, so a ray tests each."""

MAX_SCHEMAS = 1000
"""Applied API schemas of one prim; USD composes a definition for each further one."""

MAX_CLIPS = 100_000
"""Files that one set of value clips may name; USD lists them all when it opens the stage, and a stride of 1e-9 s names
10^18.
"""

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


def most_prims() -> int:
    """Prims and references that may be composed, as the user trusts the stage."""
    return MAX_PRIMS_TRUSTED if _trusted() else MAX_PRIMS


def most_fogs() -> int:
    """Fog volumes that may be drawn, as the user trusts the stage."""
    return MAX_FOGS_TRUSTED if _trusted() else MAX_FOGS


def most_lamps() -> int:
    """Lamps and lit surfaces that may be drawn, as the user trusts the stage."""
    return MAX_LAMPS_TRUSTED if _trusted() else MAX_LAMPS


def trusting(limit: int) -> str:
    """End of an error at a limit that trust lifts; '' where it is lifted."""
    return "" if _trusted() else f", or set {TRUSTED}=1 if you trust the stage and can wait (at most {limit} then)"


def _trusted() -> bool:
    return os.environ.get(TRUSTED, "0") not in ("", "0")


def check_stage(stage: Usd.Stage) -> Size:
    """Count a composed stage as its variants stand; refuse it where it is too much to draw.

    Raises:
        StageError: with the prim, what was found and the limit.
    """
    counter = _Counter(stage)
    shapes = counter.shapes(stage.GetPseudoRoot(), 0)
    if shapes > MAX_SHAPES:
        path, most = counter.largest
        where = f"{path}: its instances unfold to {amount(most)}" if path else f"the stage unfolds to {amount(shapes)}"
        raise StageError(f"{where} shapes; at most {MAX_SHAPES} are drawn: place fewer instances, or nest them less")
    if counter.triangles > MAX_TRIANGLES:
        path, most = counter.heaviest
        raise StageError(
            f"{path}: {amount(most)} triangles, {amount(counter.triangles)} with the rest of the stage; at most "
            f"{MAX_TRIANGLES} are read"
        )
    return Size(counter.prims, shapes, counter.triangles)


class _Counter:
    def __init__(self, stage: Usd.Stage) -> None:
        self.stage = stage
        self.prims = self.triangles = 0
        self.counts: dict[str, int] = {}
        self.largest: tuple[str, int] = ("", 0)
        self.heaviest: tuple[str, int] = ("", 0)

    def shapes(self, root: Usd.Prim, depth: int) -> int:
        """Shapes and lights below `root`, instances counted; a prototype is walked once."""
        name = str(root.GetPath())
        if name in self.counts:
            return self.counts[name]
        if depth > MAX_NESTED:
            raise StageError(f"{name}: instances nested deeper than {MAX_NESTED} levels; flatten some")
        self.counts[name] = 0  # of an instancer within its own prototype, which the walk reports
        total = 0
        for prim in Usd.PrimRange(root):
            path = prim.GetPath()
            if path.pathElementCount > MAX_DEPTH:
                raise StageError(
                    f"{str(path)[:60]}…: prims nested deeper than {MAX_DEPTH} levels; flatten the hierarchy"
                )
            self.prims += 1
            kind = str(prim.GetTypeName())
            count = 0
            if prim.IsInstance():
                count = self.shapes(prim.GetPrototype(), depth + 1)
            elif kind == "PointInstancer":
                count = self.instances(prim, depth)
            elif kind == "Mesh":
                count = 1
                self.mesh(prim)
            elif prim.IsA(UsdGeom.Gprim) or kind.endswith("Light"):
                count = 1
            total += count
            if depth == 0 and count > self.largest[1]:
                self.largest = (str(path), count)
        self.counts[name] = total
        return total

    def instances(self, prim: Usd.Prim, depth: int) -> int:
        """Shapes of a point instancer: for each prototype, its own times the points that show it."""
        instancer = UsdGeom.PointInstancer(prim)
        which = instancer.GetProtoIndicesAttr().Get(Usd.TimeCode.EarliestTime())
        targets = instancer.GetPrototypesRel().GetForwardedTargets()
        if which is None or not targets:
            return 0
        if len(which) > MAX_SHAPES:  # not counted by prototype: the numbers alone may fill the memory
            return len(which)
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
        many = len(counts) > MAX_TRIANGLES  # not counted by face: their number is enough
        triangles = len(counts) if many else int(np.maximum(np.asarray(counts, dtype=np.int64) - 2, 0).sum())
        if triangles > FEW_TRIANGLES + PER_POINT * (points := _points_of(prim)):
            raise StageError(
                f"{prim.GetPath()}: {amount(triangles)} triangles of {amount(points)} points; the file is damaged: "
                f"export it again"
            )
        self.triangles += triangles
        if triangles > self.heaviest[1]:
            self.heaviest = (str(prim.GetPath()), triangles)


def _points_of(prim: Usd.Prim) -> int:
    return len(UsdGeom.Mesh(prim).GetPointsAttr().Get(Usd.TimeCode.EarliestTime()) or ())


def amount(number: int) -> str:
    """A count with spaces between thousands; a large one as a power of ten.

    >>> amount(1_234_567), amount(2**80)
    ('1 234 567', '10^24')
    """
    return f"{number:,}".replace(",", " ") if number < 10**12 else f"10^{len(str(number)) - 1}"
