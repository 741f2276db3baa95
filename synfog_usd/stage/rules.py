"""Our own rules: stages that are legal USD and still wrong for a photograph.

Takes a composed stage; gives findings.  Nothing is changed, and each prototype is
visited once.  Fog boundaries that cross, and a near plane that cuts one, are seen by the
translation alone.
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from pxr import Gf, Kind, Sdf, Usd, UsdGeom, UsdLux, UsdShade

from synfog_usd.base.colour import LUMINANCE
from synfog_usd.stage.labels import direct_label, official_name
from synfog_usd.stage.lightinputs import LightInputs
from synfog_usd.stage.open import cameras
from synfog_usd.stage.rulebook import Finding, finding
from synfog_usd.stage.schema import API_NAME, has_fog_attributes

SIZES_M: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "car": (2.0, 8.0),
        "truck": (3.0, 26.0),
        "bus": (4.0, 26.0),
        "person": (0.4, 2.6),
        "rider": (0.4, 2.6),
        "bicycle": (0.7, 3.2),
        "motorcycle": (0.9, 3.6),
    }
)
"""Longest edge [m] of road users, children's and articulated ones included."""

UNIT_FACTORS = (0.01, 100.0, 0.0254, 1 / 0.0254, 0.001, 1000.0, 1e-4, 1e4, 0.3048, 1 / 0.3048)
"""Ratios of units that are mistaken for each other: centimetres, inches, millimetres or feet, or one of them twice."""

_NAMES = {
    "car": "car", "sedan": "car", "suv": "car", "hatchback": "car", "taxi": "car", "van": "car", "vehicle": "car",
    "ambulance": "car", "automobile": "car", "jeep": "car",
    "truck": "truck", "lorry": "truck", "bus": "bus", "coach": "bus",
    "person": "person", "pedestrian": "person", "human": "person", "walker": "person",
    "cyclist": "rider", "motorcyclist": "rider",
    "bicycle": "bicycle", "bike": "bicycle", "motorcycle": "motorcycle", "motorbike": "motorcycle",
}  # fmt: skip

_ANY_NAME = re.compile("|".join(_NAMES), re.IGNORECASE)

MAX_LUMEN = 1e8
"""Luminous flux of one lamp [lm], a thousand times a stadium's floodlight."""

MAX_SKY_NIT = 1e6
"""Intensity of a dome [cd m-2], a hundred times the brightest sky."""

MAX_SUN_LUX = 1e6
"""Illuminance by a distant light [lx], eight times the sun's outside the atmosphere."""


def findings(stage: Usd.Stage) -> list[Finding]:
    """All findings of our own rules on a stage, as its variants stand."""
    context = _Context(stage)
    return [finding for rule in _RULES for finding in rule(context)]


class _Context:
    """A stage with values that several rules need."""

    def __init__(self, stage: Usd.Stage) -> None:
        self.stage = stage
        self.time = Usd.TimeCode.EarliestTime()
        self.metres = UsdGeom.GetStageMetersPerUnit(stage)
        self.prims = list(stage.Traverse())
        shown = [UsdGeom.Tokens.default_, UsdGeom.Tokens.render]
        self.solid = UsdGeom.BBoxCache(self.time, shown, False, True)
        self.whole = UsdGeom.BBoxCache(self.time, [*shown, UsdGeom.Tokens.guide, UsdGeom.Tokens.proxy], False, True)
        self.kinds: set[str] = set()
        """Names of all types that prims have, those of prototypes too."""
        self.purposes = False
        """Whether any prim has a purpose of its own."""
        self._foggy: set[Usd.Prim] = set()
        self._labels: dict[Usd.Prim, str] = {}
        for prim in _once(self):
            self.kinds.add(prim.GetTypeName())
            names = prim.GetAuthoredPropertyNames()
            if has_fog_attributes(prim, names):
                self._foggy.add(prim)
            if not names:  # most of many
                continue
            self.purposes |= "purpose" in names
            if (label := direct_label(prim, self.time, names)) is not None:
                self._labels[prim] = label

    @functools.cached_property
    def fog(self) -> list[Usd.Prim]:
        """Prims with fog attributes."""
        return [prim for prim in self.prims if self.has_fog(prim)] if self._foggy else []

    @functools.cached_property
    def users(self) -> list[RoadUser]:
        """Road users that can be measured."""
        return list(_measured(self))

    def has_fog(self, prim: Usd.Prim) -> bool:
        """`has_fog_attributes`, looked up once."""
        return bool(self._foggy) and prim in self._foggy

    def label(self, prim: Usd.Prim) -> str | None:
        """`direct_label`, looked up once."""
        return self._labels.get(prim) if self._labels else None

    def longest_m(self, prim: Usd.Prim) -> float:
        """Longest edge [m] of the drawn part of a prim, in its own axes; 0 for none."""
        box = self.solid.ComputeWorldBound(prim)
        if box.GetRange().IsEmpty():
            return 0.0
        size, matrix = box.GetRange().GetSize(), box.GetMatrix()
        edges = [size[axis] * Gf.Vec3d(*matrix.GetRow3(axis)).GetLength() for axis in range(3)]
        return max(edges) * self.metres if all(math.isfinite(edge) for edge in edges) else 0.0


def _camera_and_fog(context: _Context) -> Iterator[Finding]:
    eyes = cameras(context.stage)
    if not eyes:
        yield finding("no-camera", "", "the stage has no camera; add one, or nothing can be rendered")
    if not context.fog:
        if not any(prim.GetTypeName() == "Volume" for prim in context.prims):  # of which the translation tells
            text = f"the stage has no fog; bake --fog mor150 adds some, and a closed prim with {API_NAME} says where"
            yield finding("no-fog", "", text)
        return
    boxes = [context.whole.ComputeWorldBound(prim) for prim in context.fog]
    for path in eyes:
        eye = (
            UsdGeom.Xformable(context.stage.GetPrimAtPath(path))
            .ComputeLocalToWorldTransform(context.time)
            .ExtractTranslation()
        )
        if not any(box.GetRange().Contains(box.GetMatrix().GetInverse().Transform(eye)) for box in boxes):
            yield finding(
                "camera-outside-fog", path, "stands outside of every fog boundary; enlarge the fog or move the camera"
            )
    for prim in context.fog:
        imageable = UsdGeom.Imageable(prim)
        if prim.IsA(UsdGeom.Gprim) and imageable.ComputePurpose() != UsdGeom.Tokens.guide:
            yield finding(
                "fog-solid",
                str(prim.GetPath()),
                "other renderers draw this fog boundary as a solid; set its purpose to guide",
            )


def _lights(context: _Context) -> Iterator[Finding]:
    lamps = 0
    for prim in _once(context):
        if prim.HasAPI(UsdLux.LightAPI):
            lamps += 1
            if text := _fault_of_light(prim, context):
                yield finding("light-bright", str(prim.GetPath()), text)
    if not lamps and not _anything_glows(context):
        yield finding("no-light", "", "the stage has no light and no emissive material; the picture would be black")


def _fault_of_light(prim: Usd.Prim, context: _Context) -> str:
    """Why a light is brighter than any lamp, sky or sun; '' for a sensible one."""
    inputs, kind = LightInputs(prim, context.time), str(prim.GetTypeName())
    nits = _emitted(inputs, 50000.0 if kind == "DistantLight" else 1.0)
    if not math.isfinite(nits):
        return f"its intensity is {nits}, which is no number; it stays dark"
    if kind in ("DomeLight", "DomeLight_1"):
        return f"a sky of {nits:.3g} nits; an overcast noon has 2 000 to 10 000" if nits > MAX_SKY_NIT else ""
    normalized = inputs.flag("normalize")
    if kind == "DistantLight":
        half = math.radians(inputs.number("angle", 0.53)) / 2.0
        lux = nits if normalized or not 0.0 < half < math.inf else nits * math.pi * math.sin(half) ** 2
        return f"a sun of {lux:.3g} lux; the real one gives 130 000 at most" if lux > MAX_SUN_LUX else ""
    lumen = math.pi * nits * (context.metres**2 if normalized else _area_m2(prim, inputs, context))
    text = f"a lamp of {lumen:.3g} lm; a street lamp has 5 000 to 15 000, a headlight 1 500"
    return text if lumen > MAX_LUMEN else ""


def _emitted(inputs: LightInputs, intensity: float) -> float:
    """Luminance of colour x intensity x 2^exposure, before any normalization."""
    color = np.array(inputs.numbers("color", (1.0, 1.0, 1.0)))
    with np.errstate(over="ignore", invalid="ignore"):
        stops = np.exp2(inputs.number("exposure", 0.0))
        return float(LUMINANCE @ color * inputs.number("intensity", intensity) * stops)


def _area_m2(prim: Usd.Prim, inputs: LightInputs, context: _Context) -> float:
    """Surface of a lamp, its scale taken as even."""
    radius, length = inputs.number("radius", 0.5), inputs.number("length", 1.0)
    area = {
        "SphereLight": 4.0 * math.pi * radius**2,
        "DiskLight": math.pi * radius**2,
        "RectLight": inputs.number("width", 1.0) * inputs.number("height", 1.0),
        "CylinderLight": 2.0 * math.pi * radius * length,
    }.get(str(prim.GetTypeName()), 0.0)
    matrix = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(context.time)
    return float(area * abs(matrix.GetDeterminant3()) ** (2.0 / 3.0) * context.metres**2)


def _anything_glows(context: _Context) -> bool:
    for prim in _once(context) if "Shader" in context.kinds else ():
        if prim.GetTypeName() == "Shader":
            glow = UsdShade.Shader(prim).GetInput("emissiveColor") or UsdShade.Shader(prim).GetInput("emission")
            if glow and (
                glow.HasConnectedSource() or any(float(c) > 0.0 for c in np.atleast_1d(np.array(glow.Get() or 0.0)))
            ):
                return True
    return False


@dataclass(frozen=True)
class RoadUser:
    """A prim that is a road user by its label, or, without one, by its name.

    Attributes:
        prim: on which label or name stands.
        label: as written, or None.
        kind: name of `SIZES_M`.
        longest: edge [m], as the stage is read.
    """

    prim: Usd.Prim
    label: str | None
    kind: str
    longest: float

    def fits(self, factor: float = 1.0) -> bool:
        """Whether road users of this kind are as long as this times a factor."""
        low, high = SIZES_M[self.kind]
        return low <= self.longest * factor <= high


def _measured(context: _Context) -> Iterator[RoadUser]:
    skipped: Sdf.Path | None = None
    for prim in context.prims:
        if skipped is not None and prim.GetPath().HasPrefix(skipped):
            continue
        label = context.label(prim)
        kind = official_name(label) if label is not None else _class_by_name(prim)
        if (label is None and kind is None) or _is_many(prim):
            continue
        skipped = prim.GetPath()
        if kind is not None and kind in SIZES_M and (longest := context.longest_m(prim)) > 0.0:
            yield RoadUser(prim, label, kind, longest)


def _road_users(context: _Context) -> Iterator[Finding]:
    """Sizes of labelled road users, and names that speak of road users without a label."""
    for user in context.users:
        path, kind = str(user.prim.GetPath()), user.kind
        low, high = SIZES_M[kind]
        factor = next((factor for factor in UNIT_FACTORS if user.fits(factor)), None)
        if user.fits():
            if user.label is None:
                yield finding(
                    "road-user-unlabelled",
                    path,
                    f"a {kind} by its name and size, and without a label (semantics:labels:cityscapes)",
                )
        elif user.label is not None or factor:
            what = f"this {kind}" if user.label is not None else f"this prim, a {kind} by its name,"
            advice = f"; times {factor:g} it would be {user.longest * factor:.3g} m" if factor else ""
            text = (
                f"{what} is {user.longest:.3g} m long, and a {kind} {low:g} to {high:g} m{advice} (metersPerUnit is "
                f"{context.metres:g}, as the stage is read)"
            )
            yield finding("units", path, text)


def _class_by_name(prim: Usd.Prim) -> str | None:
    """Class of a road user that a prim's name begins or ends with, numbers aside."""
    if not _speaks((name := prim.GetName()).rstrip("0123456789")):  # most by far
        return None
    if not prim.IsA(UsdGeom.Xformable) or prim.IsA(UsdGeom.Camera) or prim.HasAPI(UsdLux.LightAPI):
        return None
    words = [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)]
    return (_NAMES.get(words[-1]) or _NAMES.get(words[0])) if words else None


@functools.lru_cache(maxsize=4096)
def _speaks(name: str) -> bool:
    """Whether there is any road user's name in a name; those of many prims differ by their numbers alone."""
    return bool(_ANY_NAME.search(name))


def _is_many(prim: Usd.Prim) -> bool:
    """Whether a label on a prim is that of several things below it."""
    if prim.GetTypeName() in ("Scope", "PointInstancer"):
        return True
    kind = Usd.ModelAPI(prim).GetKind()
    return bool(kind) and Kind.Registry.IsA(kind, Kind.Tokens.group)


def _labels(context: _Context) -> Iterator[Finding]:
    unlabelled: list[Usd.Prim] = []
    for prim, label in _unlabelled(context):
        if label is not None:
            if official_name(label) is None:
                hint = f"; did you mean {_NAMES[label.lower()]!r}?" if label.lower() in _NAMES else ""
                yield finding(
                    "label-unknown",
                    str(prim.GetPath()),
                    f"label {label!r} is not a Cityscapes name; it counts as unlabeled{hint}",
                )
        elif (
            prim.IsA(UsdGeom.Gprim)
            and not (context.has_fog(prim) or context.has_fog(prim.GetParent()))
            and not (context.purposes and _is_guide(prim))
        ):
            unlabelled.append(prim)
    if unlabelled:
        yield finding(
            "unlabelled",
            str(unlabelled[0].GetPath()),
            f"{len(unlabelled)} prims have no label (semantics:labels:cityscapes), this is the first",
        )


def _is_guide(prim: Usd.Prim) -> bool:
    """Whether a prim is never drawn, as a lane's curve."""
    return bool(UsdGeom.Imageable(prim).ComputePurpose() == UsdGeom.Tokens.guide)


def _unlabelled(context: _Context) -> Iterator[tuple[Usd.Prim, str | None]]:
    """(prim, label) of prims that are not below a label; a prototype once, where an instance without label has it."""
    waiting, visited = [context.stage.GetPseudoRoot()], set[str]()
    while waiting:
        iterator = iter(Usd.PrimRange(waiting.pop()))
        for prim in iterator:
            label = None if prim.IsPseudoRoot() else context.label(prim)
            yield prim, label
            if label is not None:
                iterator.PruneChildren()
            elif prim.IsInstance() and (name := str(prim.GetPrototype().GetPath())) not in visited:
                visited.add(name)
                waiting.append(prim.GetPrototype())


def _once(context: _Context) -> Iterator[Usd.Prim]:
    """All prims, those of prototypes once."""
    yield from context.prims
    for prototype in context.stage.GetPrototypes():
        yield from Usd.PrimRange(prototype)


_RULES: tuple[Callable[[_Context], Iterator[Finding]], ...] = (_camera_and_fog, _lights, _road_users, _labels)
