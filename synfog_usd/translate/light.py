"""Lights: UsdLux as Mitsuba emitters, in nits.

Takes light prims and their place in metres; gives emitters, and shapes for those
that have a surface.  Follows the UsdLux specification since 25.05, but for what a
`Convention` says.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdLux

from synfog_usd.base.arrays import Array
from synfog_usd.base.colour import LUMINANCE
from synfog_usd.base.errors import StageError
from synfog_usd.base.notes import Note
from synfog_usd.scene import MANY_LIT, SceneDict, lit_kind
from synfog_usd.stage import budget
from synfog_usd.stage.lightinputs import LightInputs
from synfog_usd.translate.convention import USD, Convention
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.geometry import Triangles, area, placed
from synfog_usd.translate.implicit import ROUND, frustum, sphere_mesh
from synfog_usd.translate.inputs import rgb
from synfog_usd.translate.shaping import Shaping, as_ball, as_card, as_tube, luminous_flux, read_shaping, table_of
from synfog_usd.translate.space import FAR, is_similarity, rotation_of, scaled
from synfog_usd.translate.texture import ImageReader, is_srgb, linear

TURN = np.diag([-1.0, 1.0, -1.0, 1.0])
"""Half a turn about Y: USD's lights look along -Z, Mitsuba's along +Z."""

POLE_TO_Z = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""A quarter turn about X, as DomeLight_1 asks for a pole along Z."""


_SUN_DEG = 0.53
"""Width of the sun, which is UsdLux's own fallback."""

MAX_NIT = 1e16
"""Highest luminance [cd m-2], ten million times the sun's disc; sums of squares of more leave single precision."""


@dataclass
class Lamp:
    """One emitter, and the surface it shines from.

    Attributes:
        emitter: Mitsuba's emitter; for a surface an 'area' one.
        flux_lm: luminous flux [lm]; inf for sky and sun, whose light has no end.
        shape: Mitsuba's native shape, or triangles in scene metres, or None.
    """

    emitter: dict[str, Any]
    flux_lm: float
    shape: dict[str, Any] | Triangles | None = None


@dataclass
class Dome:
    """A light from all around.

    Attributes:
        path: prim path.
        radiance: (3,) RGB, or (H, W, 3) float32 latitude-longitude map [cd m-2].
        to_world: rotation of the map.
    """

    path: str
    radiance: npt.NDArray[np.float32]
    to_world: Array = field(default_factory=lambda: np.eye(4))


_SIZES = {
    "SphereLight": ("radius",),
    "DiskLight": ("radius",),
    "RectLight": ("width", "height"),
    "CylinderLight": ("length", "radius"),
    "DistantLight": ("angle",),
}
"""Inputs for the size of a light."""


def emitted(
    prim: Usd.Prim, time: Usd.TimeCode, *, default_intensity: float = 1.0, convention: Convention = USD
) -> Array:
    """(3,) RGB of color x intensity x 2^exposure x blackbody tint, before any normalization."""
    inputs = LightInputs(prim, time)
    color = np.array(inputs.numbers("color", (1.0, 1.0, 1.0)))
    if inputs.flag("enableColorTemperature"):
        kelvin = inputs.number("colorTemperature", 6500.0)
        if not math.isfinite(kelvin):  # the library's table ends the process at NaN
            return np.full(3, np.nan)
        if not (convention.plain_6500 and kelvin == 6500.0):
            color = color * np.array(UsdLux.BlackbodyTemperatureAsRgb(kelvin))
    exposure = inputs.number("exposure", 0.0)
    with np.errstate(over="ignore", invalid="ignore"):  # the caller notes a result that is not finite
        stops = np.exp2(exposure) if exposure != -math.inf else math.nan
        return color * (inputs.number("intensity", default_intensity) * stops)


def lamp(
    prim: Usd.Prim,
    kind: str,
    matrix: Array,
    time: Usd.TimeCode,
    notes: Diagnostics,
    images: ImageReader,
    *,
    metres_per_unit: float,
    convention: Convention = USD,
) -> Lamp | None:
    """A light other than a dome, or None where it is dark.

    Args:
        matrix: (4, 4) of the light to scene metres.
        convention: how its numbers are meant.
    """
    path = prim.GetPath()
    inputs = LightInputs(prim, time)
    _unsupported(prim, inputs, notes)
    radiance = emitted(prim, time, default_intensity=50000.0 if kind == "DistantLight" else 1.0, convention=convention)
    if not _shines(radiance, path, notes):
        return None
    radiance = np.maximum(radiance, 0.0)
    inputs.turn_positive(_SIZES.get(kind, ()), notes.warn)
    normalize = inputs.flag("normalize")
    if kind == "DistantLight":
        angle = inputs.number("angle", _SUN_DEG) * convention.sun_angle
        return _distant(radiance * convention.sun, angle, normalize or convention.sun_normalized, matrix, path, notes)
    if abs(np.linalg.det(matrix[:3, :3])) < 1e-30:
        notes.warn(path, "light scaled to nothing is left out")
        return None
    if not all(abs(inputs.number(name, 1.0)) <= FAR for name in ("radius", "width", "height", "length")):
        notes.warn(path, "light whose size is no finite number, or of more than 10 digits, is left out")
        return None
    if convention.square_metres:
        metres_per_unit = 1.0
    if normalize and metres_per_unit != 1.0:
        notes.info(
            path, f"'normalize' divides by the area in stage units of {metres_per_unit:g} m, as UsdLux specifies"
        )
    per_area = metres_per_unit**2 if normalize else 0.0  # area in stage units = area in m2 / metres_per_unit^2
    if kind == "SphereLight":
        return _sphere(inputs, radiance, per_area, matrix, path, notes)
    if kind in ("RectLight", "DiskLight"):
        return _flat(inputs, kind, radiance, per_area, matrix, path, notes, images)
    return _cylinder(inputs, radiance, per_area, matrix, path, notes)


def _shines(radiance: Array, path: object, notes: Diagnostics) -> bool:
    """Whether there is light of use, with a note where it is not what the author meant."""
    if not np.isfinite(radiance).all():
        notes.warn(path, "light whose intensity is no finite number is dark")
        return False
    if radiance.min() < 0.0:
        notes.warn(path, "negative light is not drawn; it is taken as 0 in that channel")
    return bool(radiance.max() > 0.0)


def mesh_light(
    prim: Usd.Prim,
    time: Usd.TimeCode,
    surface_m2: float,
    notes: Diagnostics,
    *,
    metres_per_unit: float,
    convention: Convention = USD,
) -> Array:
    """(3,) radiance [cd m-2] of a mesh with MeshLightAPI, of a given area [m2]."""
    inputs = LightInputs(prim, time)
    _unsupported(prim, inputs, notes)
    radiance = emitted(prim, time, convention=convention)
    radiance = np.maximum(radiance, 0.0) if _shines(radiance, prim.GetPath(), notes) else np.zeros(3)
    if convention.square_metres:
        metres_per_unit = 1.0
    return radiance * metres_per_unit**2 / surface_m2 if inputs.flag("normalize") and surface_m2 > 0.0 else radiance


def dome(
    prim: Usd.Prim, kind: str, matrix: Array, time: Usd.TimeCode, notes: Diagnostics, images: ImageReader, *, z_up: bool
) -> Dome | None:
    """A dome light, or None where it is dark.

    The map's top is the light's local +Y; `DomeLight_1` may ask for the stage's up
    axis or Z instead.
    """
    path = str(prim.GetPath())
    inputs = LightInputs(prim, time)
    _unsupported(prim, inputs, notes)
    tint = emitted(prim, time)
    if not _shines(tint, path, notes):
        return None
    tint = np.maximum(tint, 0.0)
    refuse_blinding(path, tint)
    turn = rotation_of(matrix)
    if kind == "DomeLight_1":
        pole = notes.token(path, "poleAxis", inputs.word("poleAxis", "scene"), ("scene", "Y", "Z"), "scene")
        if pole == "Z" or (pole == "scene" and z_up):
            turn = turn @ POLE_TO_Z
    texels = _texels(inputs, path, notes, images)
    if texels is None:
        return Dome(path, tint.astype(np.float32), turn)
    values = np.maximum(texels * tint.astype(np.float32), 0.0)
    layout = inputs.word("texture:format", "automatic")
    if layout not in ("automatic", "latlong"):
        notes.warn(path, f"texture format {layout!r} is not known; the light has the mean colour of the picture")
        return Dome(path, values.mean(axis=(0, 1)), turn)
    if (values == values[:1, :1]).all():
        return Dome(path, values[0, 0].copy(), turn)
    return Dome(path, np.ascontiguousarray(values), turn)


def merged_dome(domes: list[Dome], notes: Diagnostics) -> dict[str, Any] | None:
    """One emitter for all domes, which add up; the largest map is drawn, others as their mean colour."""
    if not domes:
        return None
    maps = sorted(
        (dome for dome in domes if dome.radiance.ndim == 3), key=lambda dome: dome.radiance.size, reverse=True
    )
    constant = sum((dome.radiance for dome in domes if dome.radiance.ndim == 1), start=np.zeros(3, dtype=np.float32))
    if len(domes) > 1:
        notes.info(domes[0].path, f"{len(domes)} dome lights are added up")
    if not maps:
        return {"type": "constant", "radiance": rgb(constant)}
    for dome in maps[1:]:
        notes.warn(dome.path, f"a second map of the sky is drawn as its mean colour, beside that of {maps[0].path}")
        rows = np.sin(np.pi * (np.arange(len(dome.radiance)) + 0.5) / len(dome.radiance))
        constant = constant + np.average(dome.radiance.mean(axis=1), axis=0, weights=rows)
    pixels = np.ascontiguousarray(maps[0].radiance + constant, dtype=np.float32)
    return {"type": "envmap", "bitmap": pixels, "to_world": maps[0].to_world}


def refuse_blinding(path: object, light: Array | npt.NDArray[np.float32]) -> None:
    """Refuse light that cannot be counted.

    Args:
        path: where it stands.
        light: radiance, irradiance or intensity in nits, lux or candela, any shape.

    Raises:
        StageError: with what it gives.
    """
    if not (most := float(np.max(light, initial=0.0))) <= MAX_NIT:
        raise StageError(
            f"{path}: gives {most:.3g} (in nits, lux or candela); at most {MAX_NIT:g} can be counted: lower its "
            f"intensity or exposure"
        )


def refuse_many(path: object, number: int) -> None:
    """Refuse one lamp or lit surface more than are drawn, before it is made.

    Args:
        path: of the one that would be too many.
        number: of those before it.

    Raises:
        StageError: with the limit.
    """
    if number >= (most := budget.most_lamps()):
        raise StageError(
            f"{path}: one more than the {budget.amount(most)} lamps and lit surfaces that are drawn, instances "
            f"counted: leave out those that the camera does not "
            f"see{budget.trusting(budget.MAX_LAMPS_TRUSTED)}"
        )


def with_note_on_crowd(scene: SceneDict) -> SceneDict:
    """The scene, with a note where its lit surfaces are so many that those alike are drawn as one.

    Raises:
        StageError: too many for the renderer even so, with their number and the limit.
    """
    shining = {key: part for key, part in scene.world.items() if isinstance(part, Mapping) and "emitter" in part}
    triangles = sum(len(part.get("faces", ())) for part in shining.values())
    if triangles > budget.MAX_LIT_TRIANGLES:
        raise StageError(
            f"{budget.amount(len(shining))} lit surfaces of {budget.amount(triangles)} triangles; at most "
            f"{budget.amount(budget.MAX_LIT_TRIANGLES)} can shine: make these surfaces coarser"
        )
    kinds = {key if key in scene.motion_of else lit_kind(scene, key) or key for key in shining}
    if len(kinds) > budget.MAX_LIT_KINDS:
        raise StageError(
            f"{budget.amount(len(shining))} lit surfaces of {budget.amount(len(kinds))} kinds; at most "
            f"{budget.amount(budget.MAX_LIT_KINDS)} are drawn: give those that may shine alike the same colour, "
            f"intensity and material, or lamps 'treatAsPoint'"
        )
    if len(shining) <= MANY_LIT:
        return scene
    text = (
        f"{budget.amount(len(shining))} lit surfaces are more than {MANY_LIT}: far ones that shine alike are drawn "
        f"together, balls and disks in a few dozen faces of the same area"
    )
    return replace(scene, notes=(*scene.notes, Note("info", "", text)))


def area_emitter(radiance: Array) -> dict[str, Any]:
    """A surface that shines with one radiance [cd m-2] in all directions of its front."""
    return {"type": "area", "radiance": rgb(radiance)}


def _distant(
    radiance: Array, angle_deg: float, normalize: bool, matrix: Array, path: object, notes: Diagnostics
) -> Lamp:
    """Irradiance E = L pi sin^2(angle / 2), or the intensity itself where normalized."""
    if not math.isfinite(angle_deg):
        notes.warn(path, f"inputs:angle is {angle_deg:g}, which is no angle; {_SUN_DEG} is taken")
        angle_deg = _SUN_DEG
    half = math.radians(min(max(angle_deg, 0.0), 180.0)) / 2.0
    factor = math.pi * math.sin(half) ** 2 if half > 0.0 else 1.0
    irradiance = radiance if normalize else radiance * factor
    if angle_deg > 1.0:
        notes.info(
            path, f"a distant light {angle_deg:g} degrees wide is drawn as a point at infinity: its shadows are sharp"
        )
    return Lamp(
        {"type": "directional", "irradiance": rgb(irradiance), "to_world": rotation_of(matrix) @ TURN}, math.inf
    )


def _shaped(
    intensity: Array,
    shaping: Shaping,
    matrix: Array,
    path: object,
    notes: Diagnostics,
    *,
    extent: Callable[[Array], Array] = as_ball,
) -> Lamp | None:
    """A lamp at a point, which far from its surface it is, with a table of its light.

    Args:
        intensity: (3,) along a direction in which `extent` is 1, without shaping [cd].
        extent: of the surface in directions (..., 3) of the light's own frame, as a share of its largest.
    """
    table = table_of(shaping, extent)
    flux = float(luminous_flux(table @ (LUMINANCE * intensity)))
    if not flux > 0.0:
        notes.warn(path, "a light whose shaping leaves nothing of it is dark")
        return None
    tinted = shaping.focus > 0.0 and any(shaping.tint)
    to_world = rotation_of(matrix) @ TURN
    to_world[:3, 3] = matrix[:3, 3]
    bitmap = np.ascontiguousarray(table if tinted else table[..., 0], dtype=np.float32)
    return Lamp({"type": "photometric", "intensity": rgb(intensity), "bitmap": bitmap, "to_world": to_world}, flux)


def _spot(intensity: Array, cone: tuple[float, float], matrix: Array) -> Lamp:
    """Mitsuba's own spot for a disk with a cone and nothing else, as the shipped stages have been baked.

    It is even up to the beam width and falls to the cutoff in a straight line, where UsdLux has the cosine of a card
    and a smoothstep: off by a tenth of the beam in a soft edge, and by 1 - cos(angle).
    """
    cutoff, beam = (math.radians(a) for a in cone)
    solid_angle = 2.0 * math.pi * (1.0 - (math.cos(cutoff) + math.cos(beam)) / 2.0)
    place = rotation_of(matrix) @ TURN
    place[:3, 3] = matrix[:3, 3]
    emitter = {
        "type": "spot",
        "intensity": rgb(intensity),
        "cutoff_angle": cone[0],
        "beam_width": cone[1],
        "to_world": place,
    }
    return Lamp(emitter, float(LUMINANCE @ intensity) * solid_angle)


def _sphere(
    inputs: LightInputs, radiance: Array, per_area: float, matrix: Array, path: object, notes: Diagnostics
) -> Lamp | None:
    radius = inputs.number("radius", 0.5)
    mean_scale = abs(float(np.linalg.det(matrix[:3, :3]))) ** (1.0 / 3.0)
    shaping = read_shaping(inputs, path, notes)
    if radius <= 0.0 or inputs.flag("treatAsPoint"):
        if radius <= 0.0 and not per_area:
            notes.warn(
                path,
                "a light without size and without 'normalize' has no defined power; its intensity is taken as with "
                "'normalize'",
            )
            per_area = 1.0
        if per_area:
            stage_units = per_area  # (metres per unit)^2: I = L pi r^2 with L = intensity / (4 pi r^2)
            intensity = radiance * stage_units / 4.0
        else:
            intensity = radiance * math.pi * (radius * mean_scale) ** 2
        if shaping is not None:
            return _shaped(intensity, shaping, matrix, path, notes)
        emitter = {"type": "point", "intensity": rgb(intensity), "position": [float(x) for x in matrix[:3, 3]]}
        return Lamp(emitter, 4.0 * math.pi * float(LUMINANCE @ intensity))
    if is_similarity(matrix):
        surface = 4.0 * math.pi * (radius * mean_scale) ** 2
        shape: dict[str, Any] | Triangles = {
            "type": "sphere",
            "center": [float(x) for x in matrix[:3, 3]],
            "radius": radius * mean_scale,
        }
    else:
        triangles = placed(sphere_mesh(radius), matrix)
        shape, surface = triangles, area(triangles)
    L = radiance * per_area / surface if per_area else radiance
    if shaping is not None:
        return _shaped(L * math.pi * (radius * mean_scale) ** 2, shaping, matrix, path, notes)
    return Lamp(area_emitter(L), math.pi * surface * float(LUMINANCE @ L), shape)


def _flat(
    inputs: LightInputs,
    kind: str,
    radiance: Array,
    per_area: float,
    matrix: Array,
    path: object,
    notes: Diagnostics,
    images: ImageReader,
) -> Lamp | None:
    """A rectangle or disk in its XY plane that shines along -Z; a rectangle's picture has its left at +X and its top at
    +Y.
    """
    picture = None
    if kind == "RectLight":
        half_x, half_y = inputs.number("width", 1.0) / 2.0, inputs.number("height", 1.0) / 2.0
        unit_area, native = 4.0, "rectangle"
        texels = _texels(inputs, path, notes, images)
        picture = None if texels is None else np.maximum(texels.astype(np.float64), 0.0)
    else:
        half_x = half_y = inputs.number("radius", 0.5)
        unit_area, native = math.pi, "disk"
    place = matrix @ TURN @ scaled(half_x, half_y, 1.0)
    surface = unit_area * float(np.linalg.norm(np.cross(place[:3, 0], place[:3, 1])))
    if not surface > 0.0:
        notes.warn(path, "light without area is left out")
        return None
    L = radiance * per_area / surface if per_area else radiance
    shaping = read_shaping(inputs, path, notes)
    if shaping is not None and shaping.plain and shaping.cone is not None and shaping.cone[1] >= 90.0:
        shaping = None  # ShapingAPI as many programs apply it: nothing lies beyond 90 degrees anyway
    if shaping is not None:
        simple = kind == "DiskLight" and shaping.plain and picture is None
        notes.info(
            path,
            f"{kind} with a cone is drawn as a spot at its centre"
            if simple
            else f"the shaped {kind} is drawn at its centre",
        )
        if simple and shaping.cone is not None:
            return _spot(L * surface, shaping.cone, matrix)
        mean = L if picture is None else L * picture.reshape(-1, 3).mean(axis=0)
        return _shaped(mean * surface, shaping, matrix, path, notes, extent=as_card)
    if picture is not None:
        radiance_map = np.ascontiguousarray(
            (picture * L)[::-1], dtype=np.float32
        )  # its top is at +Y; Mitsuba's v runs from -Y
        nits = float(LUMINANCE @ radiance_map.mean(axis=(0, 1), dtype=np.float64))
        emitter = {
            "type": "area",
            "radiance": {"type": "bitmap", "bitmap": radiance_map, "raw": True, "wrap_mode": "clamp"},
        }
        return Lamp(emitter, math.pi * surface * nits, {"type": native, "to_world": place})
    # its normal stays along the light's -Z: Mitsuba takes a normal with the inverse transpose, so thickness along Z
    # does not matter
    return Lamp(area_emitter(L), math.pi * surface * float(LUMINANCE @ L), {"type": native, "to_world": place})


def _texels(
    inputs: LightInputs, path: object, notes: Diagnostics, images: ImageReader
) -> npt.NDArray[np.float32] | None:
    """(H, W, 3) linear values of the picture on a light; None for none, with a note where it cannot be read."""
    authored, file = inputs.file("texture:file")
    if not authored:
        return None
    pixels = images.read(file, str(path)) if file else None
    if pixels is None:
        notes.warn(
            path, f"texture {authored} {'cannot be read' if file else 'is not found'}; the light is of one colour"
        )
        return None
    values = linear(pixels, srgb=is_srgb("auto", pixels))
    return np.repeat(values[..., :1], 3, axis=2) if values.shape[2] < 3 else values[..., :3]


def _cylinder(
    inputs: LightInputs, radiance: Array, per_area: float, matrix: Array, path: object, notes: Diagnostics
) -> Lamp | None:
    """A cylinder along X that shines from its side, not from its ends."""
    length, radius = inputs.number("length", 1.0), inputs.number("radius", 0.5)
    if inputs.flag("treatAsLine") or radius <= 0.0 or length <= 0.0:
        notes.warn(path, "a cylinder light without thickness is drawn 1 mm thick")
        radius, length = max(radius, 0.001), max(length, 0.001)
    side = _side(length, radius)
    shape = placed(side, matrix)
    surface = (
        area(shape)
        if not is_similarity(matrix)
        else 2.0 * math.pi * radius * length * abs(float(np.linalg.det(matrix[:3, :3]))) ** (2.0 / 3.0)
    )
    L = radiance * per_area / surface if per_area else radiance
    shaping = read_shaping(inputs, path, notes)
    if shaping is not None:
        notes.info(path, "the shaped CylinderLight is drawn at its centre")
        return _shaped(
            L * surface / math.pi, shaping, matrix, path, notes, extent=as_tube
        )  # broadside a tube shows 2 r l of its side 2 pi r l
    return Lamp(area_emitter(L), math.pi * surface * float(LUMINANCE @ L), shape)


def _side(length: float, radius: float) -> Triangles:
    """The side of a cylinder along X, of `ROUND` segments that keep its area."""
    fit = math.pi / (ROUND * math.sin(math.pi / ROUND))  # chord of a segment -> its arc
    whole = frustum(length, radius * fit, radius * fit)
    assert whole.normals is not None
    side = np.abs(whole.normals[whole.faces[:, 0], 2]) < 0.5
    turn = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    return Triangles(whole.positions @ turn.T, whole.faces[side], whole.normals @ turn.T)


def _unsupported(prim: Usd.Prim, inputs: LightInputs, notes: Diagnostics) -> None:
    path = prim.GetPath()
    for name in ("diffuse", "specular"):
        if inputs.number(name, 1.0) != 1.0:
            notes.warn(path, f"the multiplier inputs:{name} is not drawn; light is the same for all surfaces")
    if not inputs.flag("shadow:enable", default=True):
        notes.warn(path, "a light without shadows is drawn with them")
    if prim.HasRelationship("light:filters") and prim.GetRelationship("light:filters").GetTargets():
        notes.warn(path, "light filters are not drawn")
    if any(c > 0.0 for c in inputs.numbers("shadow:color", (0.0, 0.0, 0.0))) or any(
        inputs.number(f"shadow:{name}", -1.0) > 0.0 for name in ("distance", "falloff")
    ):
        notes.warn(
            path, "the colour, reach and falloff of shadows are not drawn; a shadow is what light does not reach"
        )
    for name in ("lightLink", "shadowLink"):
        root = prim.GetAttribute(f"collection:{name}:includeRoot")
        excluded = prim.GetRelationship(f"collection:{name}:excludes")
        if (root and root.HasAuthoredValue() and not root.Get()) or (excluded and excluded.GetTargets()):
            notes.warn(path, f"{name} is not drawn; the light reaches everything")


def is_light_mesh(prim: Usd.Prim) -> bool:
    """Whether a mesh shines by MeshLightAPI."""
    return "MeshLightAPI" in prim.GetAppliedSchemas()
