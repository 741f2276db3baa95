"""What is legal USD and still wrong for a photograph: our own rules, each with its way out in the common tools.

Takes a composed stage; gives findings.  Nothing is changed, no prototype is looked
at twice.  What only the translation can see (fog boundaries that cross, a near plane
that cuts one) is found there and told with the rules that stand here.
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath
from types import MappingProxyType
from typing import Any

import numpy as np
from pxr import Gf, Kind, Sdf, Usd, UsdGeom, UsdLux, UsdShade

from synfog_usd.base.colour import LUMINANCE
from synfog_usd.stage.labels import direct_label, official_name
from synfog_usd.stage.open import cameras, up_axis
from synfog_usd.stage.rulebook import Finding, finding
from synfog_usd.stage.schema import API_NAME, FOG_VARIANT_SET, LIGHTING_VARIANT_SET, has_fog_attributes

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
"""Units that are taken for others: centimetres, inches, millimetres or feet, or one of them twice."""

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
"""Of one lamp: a thousand times a stadium's floodlight; a street lamp has 5 000 to 15 000."""

MAX_SKY_NIT = 1e6
"""Of a dome's intensity: a hundred times the brightest sky."""

MAX_SUN_LUX = 1e6
"""Of a distant light: eight times the sun's 130 000 outside the atmosphere."""

MIN_LUX = 0.3
"""Of everything: a full moon."""

_DOMES = ("DomeLight", "DomeLight_1")

POLE_DEG = 5.0
_PLAIN = "color_"
"""How Blender names the map of one colour that it writes for a plain world; such a map has no top."""


def findings(stage: Usd.Stage) -> list[Finding]:
    """All that our own rules find on a stage, as its variants stand."""
    context = _Context(stage)
    return [one for look in (*_FIXABLE, *_TOLD_ONLY) for one in look(context)]


def fixable(stage: Usd.Stage) -> tuple[list[Finding], list[RoadUser]]:
    """Those of `findings` that `stage.mend` can fix, and the road users that can be measured, outermost prims only."""
    context = _Context(stage)
    return [one for look in _FIXABLE for one in look(context) if one.fix], context.users


class _Context:
    """A stage with what several rules ask for."""

    def __init__(self, stage: Usd.Stage) -> None:
        self.stage = stage
        self.time = Usd.TimeCode.EarliestTime()
        self.metres = UsdGeom.GetStageMetersPerUnit(stage)
        self.prims = list(stage.Traverse())
        seen = [UsdGeom.Tokens.default_, UsdGeom.Tokens.render]
        self.solid = UsdGeom.BBoxCache(self.time, seen, False, True)
        self.whole = UsdGeom.BBoxCache(self.time, [*seen, UsdGeom.Tokens.guide, UsdGeom.Tokens.proxy], False, True)
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
        """Longest edge [m] of what is drawn of a prim, in its own axes; 0 where that is nothing."""
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
        yield finding(
            "no-fog",
            "",
            f"the stage has no fog; bake --fog mor150 adds some, and a closed prim with {API_NAME} says where",
        )
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
                ("purpose", "guide"),
            )


def _lights(context: _Context) -> Iterator[Finding]:
    lux, unknown, lamps = 0.0, False, 0
    for prim in _once(context):
        if not prim.HasAPI(UsdLux.LightAPI):
            continue
        lamps += 1
        path, kind = str(prim.GetPath()), str(prim.GetTypeName())
        nits = _emitted(prim, context.time)
        if not math.isfinite(nits):
            yield finding(
                "light-bright", path, f"its intensity is {nits}, which is no number; it stays dark", ("dark", "")
            )
        elif kind in ("DomeLight", "DomeLight_1"):
            textured = bool(getattr(_input(prim, "texture:file", context.time, None), "path", ""))
            unknown |= textured
            lux += 0.0 if textured else math.pi * nits
            if nits > MAX_SKY_NIT:
                yield finding("light-bright", path, f"a sky of {nits:.3g} nits; an overcast noon has 2 000 to 10 000")
        elif kind == "DistantLight":
            half = math.radians(float(_input(prim, "angle", context.time, 0.53))) / 2.0
            normalized = bool(_input(prim, "normalize", context.time, False)) or not 0.0 < half < math.inf
            here = nits if normalized else nits * math.pi * math.sin(half) ** 2
            lux += here
            if here > MAX_SUN_LUX:
                yield finding("light-bright", path, f"a sun of {here:.3g} lux; the real one gives 130 000 at most")
        else:
            unknown = True
            lumen = (
                math.pi
                * nits
                * (context.metres**2 if _input(prim, "normalize", context.time, False) else _area_m2(prim, context))
            )
            if lumen > MAX_LUMEN:
                yield finding(
                    "light-bright",
                    path,
                    f"a lamp of {lumen:.3g} lm; a street lamp has 5 000 to 15 000, a headlight 1 500",
                )
    if not lamps and not _anything_glows(context):
        yield finding("no-light", "", "the stage has no light and no emissive material; the picture would be black")
    elif lamps and not unknown and lux < MIN_LUX and not _anything_glows(context):
        yield finding(
            "light-dim",
            "",
            f"all lights together give {lux:.2g} lux; a full moon gives {MIN_LUX}, an overcast noon 10 000 to 30 000",
        )


def _emitted(prim: Usd.Prim, time: Usd.TimeCode) -> float:
    """Luminance of colour x intensity x 2^exposure, before any normalization."""
    color = np.array([float(c) for c in _input(prim, "color", time, (1.0, 1.0, 1.0))])
    intensity = float(_input(prim, "intensity", time, 50000.0 if prim.GetTypeName() == "DistantLight" else 1.0))
    exposure = float(_input(prim, "exposure", time, 0.0))
    with np.errstate(over="ignore", invalid="ignore"):
        return float(LUMINANCE @ color * intensity * np.exp2(exposure))


def _input(prim: Usd.Prim, name: str, time: Usd.TimeCode, default: Any) -> Any:
    attribute = prim.GetAttribute(f"inputs:{name}")
    value = attribute.Get(time) if attribute else None
    return default if value is None else value


def _area_m2(prim: Usd.Prim, context: _Context) -> float:
    """Surface of a lamp, its scale taken as even."""
    kind = str(prim.GetTypeName())
    number = {
        name: float(_input(prim, name, context.time, 1.0 if name != "radius" else 0.5))
        for name in ("radius", "width", "height", "length")
    }
    own = {
        "SphereLight": 4.0 * math.pi * number["radius"] ** 2,
        "DiskLight": math.pi * number["radius"] ** 2,
        "RectLight": number["width"] * number["height"],
        "CylinderLight": 2.0 * math.pi * number["radius"] * number["length"],
    }.get(kind, 0.0)
    matrix = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(context.time)
    return own * abs(matrix.GetDeterminant3()) ** (2.0 / 3.0) * context.metres**2


def _anything_glows(context: _Context) -> bool:
    for prim in _once(context) if "Shader" in context.kinds else ():
        if prim.GetTypeName() == "Shader":
            glow = UsdShade.Shader(prim).GetInput("emissiveColor") or UsdShade.Shader(prim).GetInput("emission")
            if glow and (
                glow.HasConnectedSource() or any(float(c) > 0.0 for c in np.atleast_1d(np.array(glow.Get() or 0.0)))
            ):
                return True
    return False


def _dome_pole(context: _Context) -> Iterator[Finding]:
    if context.kinds.isdisjoint(_DOMES):
        return
    up = up_axis(context.stage)
    axes = {"X": Gf.Vec3d(1, 0, 0), "Y": Gf.Vec3d(0, 1, 0), "Z": Gf.Vec3d(0, 0, 1)}
    for prim in context.prims:
        kind = str(prim.GetTypeName())
        file = getattr(_input(prim, "texture:file", context.time, None), "path", "") if kind in _DOMES else ""
        if not file or PurePosixPath(file).name.startswith(_PLAIN):
            continue
        axis = "Y"
        if kind == "DomeLight_1":
            asked = prim.GetAttribute("poleAxis").Get() if prim.GetAttribute("poleAxis") else "scene"
            axis = {"scene": up, None: up}.get(asked, str(asked))
        world = (
            UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(context.time).TransformDir(axes.get(axis, axes["Y"]))
        )
        if world.GetLength() == 0.0:
            continue
        angle = math.degrees(math.acos(max(-1.0, min(1.0, Gf.Dot(world.GetNormalized(), axes[up])))))
        if angle > POLE_DEG:
            text = f"the top of its map points {angle:.0f} degrees away from the stage's up axis {up}; rotate the light"
            yield finding("dome-pole", str(prim.GetPath()), text)


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
        """Whether such a thing is as long as this times a factor."""
        low, high = SIZES_M[self.kind]
        return low <= self.longest * factor <= high


def _measured(context: _Context) -> Iterator[RoadUser]:
    skipped: Sdf.Path | None = None
    for prim in context.prims:
        if skipped is not None and prim.GetPath().HasPrefix(skipped):
            continue
        label = context.label(prim)
        known = official_name(label) if label is not None else None
        kind = known if label is not None else _class_by_name(prim)
        if (label is None and kind is None) or _is_many(prim):
            continue
        skipped = prim.GetPath()
        if kind is not None and kind in SIZES_M and (longest := context.longest_m(prim)) > 0.0:
            yield RoadUser(prim, label, kind, longest)


def _road_users(context: _Context) -> Iterator[Finding]:
    """Sizes of labelled things, and names that speak of things without a label."""
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
                    ("label", kind),
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
                meant = _NAMES.get(label.lower())
                yield finding(
                    "label-unknown",
                    str(prim.GetPath()),
                    f"label {label!r} is not a Cityscapes name; it counts as unlabeled",
                    ("label", meant) if meant else None,
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
    """(prim, label) of prims outside of what is labelled; a prototype once, where an instance without label has it."""
    waiting, met = [context.stage.GetPseudoRoot()], set()
    while waiting:
        iterator = iter(Usd.PrimRange(waiting.pop()))
        for prim in iterator:
            label = None if prim.IsPseudoRoot() else context.label(prim)
            yield prim, label
            if label is not None:
                iterator.PruneChildren()
            elif prim.IsInstance() and (name := str(prim.GetPrototype().GetPath())) not in met:
                met.add(name)
                waiting.append(prim.GetPrototype())


def _once(context: _Context) -> Iterator[Usd.Prim]:
    """All prims, those of prototypes once."""
    yield from context.prims
    for prototype in context.stage.GetPrototypes():
        yield from Usd.PrimRange(prototype)


def _shadowed_variants(context: _Context) -> Iterator[Finding]:
    """Values of variants that a value on the prim itself, in the same layer, always beats."""
    switched = [prim.GetPath() for prim in context.stage.GetPseudoRoot().GetAllChildren() if prim.HasVariantSets()]
    for layer in context.stage.GetLayerStack(includeSessionLayers=False):
        for root in filter(None, map(layer.GetPrimAtPath, switched)):
            for set_name in (FOG_VARIANT_SET, LIGHTING_VARIANT_SET):
                variant_set = root.variantSets.get(set_name)
                if variant_set is None:
                    continue
                shadowed = {
                    value.StripAllVariantSelections()
                    for variant in variant_set.variants
                    for value in _authored(layer, variant.primSpec.path)
                }
                for local in sorted(shadowed & set(_authored(layer, root.path))):
                    text = (
                        f"variants of {set_name!r} set it, and the value on the prim itself wins over them; remove "
                        f"that one"
                    )
                    yield finding("variant-shadowed", str(local), text)


def _authored(layer: Sdf.Layer, root: Sdf.Path) -> list[Sdf.Path]:
    """Attributes with a value, and prims that are switched on or off, of a subtree; of no other variants within it."""
    found: list[Sdf.Path] = []

    def visit(path: Sdf.Path) -> None:
        if path.StripAllVariantSelections() != path and not root.ContainsPrimVariantSelection():
            return
        if path.IsPrimPropertyPath():
            attribute = layer.GetAttributeAtPath(path)
            if attribute is not None and attribute.HasDefaultValue():
                found.append(path)
        elif path.IsPrimPath() and layer.GetPrimAtPath(path).HasInfo("active"):
            found.append(path)

    layer.Traverse(root, visit)
    return found


_Looks = tuple[Callable[["_Context"], Iterator[Finding]], ...]

_FIXABLE: _Looks = (_camera_and_fog, _lights, _road_users, _labels)
"""Rules of which some findings have a fix."""

_TOLD_ONLY: _Looks = (_dome_pole, _shadowed_variants)
