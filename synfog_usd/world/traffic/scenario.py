"""The environment of an OpenSCENARIO file (.xosc, versions 1.0 to 1.3): fog, sun and time of day for a drawn street.

Takes a file; gives numbers, and writes them into a stage.  The axes of the file are those of the stage.
Source: ASAM OpenSCENARIO XML 1.3.1, asam.net/standards/detail/openscenario-xml.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, replace
from pathlib import Path

from pxr import Gf, Sdf

from synfog_usd.base.errors import RecipeError
from synfog_usd.world.language import Distribution, Recipe
from synfog_usd.world.spec import WorldSpec
from synfog_usd.world.traffic.safe_xml import ParserPlace, parse
from synfog_usd.world.traffic.samples import KINDS, attribute, order

FOG = "scenario"
"""Variant of the fog that a file says."""
CLEAR_M = 1e5
"""Visual ranges from here on are clear air."""
DAY_H = (6.0, 20.0)
"""Where a file has no sun, it is day between these hours."""
SUN = "/World/Sky/Sun"
SUN_DEG = 0.53


@dataclass(frozen=True)
class Box:
    """A box along the axes: its middle, and its length along x, width along y and height [m]."""

    middle: tuple[float, float, float]
    size: tuple[float, float, float]


@dataclass(frozen=True)
class Environment:
    """What a file says; None where it says nothing.

    Attributes:
        visual_range_m: at which fog leaves 5 % of a contrast [m].
        box: within which the fog is; None for everywhere.
        sun_lux: illuminance across the sun's rays [lx]; azimuth, elevation: of the sun, clockwise from +Y, and over
            the horizon [rad].
        hour: time of day [h].
    """

    visual_range_m: float | None = None
    box: Box | None = None
    sun_lux: float | None = None
    azimuth: float = 0.0
    elevation: float = 0.0
    hour: float | None = None

    @property
    def night(self) -> bool:
        """Whether lamps are on: by the sun, else by the hour."""
        if self.sun_lux is not None:
            return self.elevation <= 0.0
        return self.hour is not None and not DAY_H[0] <= self.hour < DAY_H[1]


def read(path: Path) -> Environment:
    """The first environment of a file.

    Raises:
        RecipeError: it cannot be read, has none, is of another version, or lacks a number; says where.
    """
    reader = _EnvironmentReader()
    parse(path, "OpenSCENARIO", reader)
    if not reader.begun:
        raise RecipeError(f"{path}: no Environment in it; an EnvironmentAction of its Init has one, or its catalog")
    return reader.environment


@dataclass
class _EnvironmentReader:
    """Takes a file's elements as they are parsed; keeps what the first environment says.

    Attributes:
        parameters: declared so far, by name.
        above: elements that are open, from the outermost.
        begun, done: whether an environment was begun, and read to its end.
    """

    environment: Environment = field(default_factory=Environment)
    parameters: dict[str, str] = field(default_factory=dict)
    above: list[str] = field(default_factory=list)
    begun: bool = False
    done: bool = False
    middle: tuple[float, float, float] | None = None

    def start(self, place: ParserPlace, tag: str, attributes: dict[str, str]) -> None:
        """An element opens."""
        if not self.above and tag != "OpenSCENARIO":
            raise place.fault(f"{tag[:40]} is not OpenSCENARIO; its root is called so")
        self.above.append(tag)
        if tag == "FileHeader":
            version = attributes.get("revMajor"), attributes.get("revMinor")
            if version[0] != "1" or version[1] not in ("0", "1", "2", "3"):
                raise place.fault(f"version {version[0]}.{version[1]}; versions 1.0 to 1.3 are read")
        elif tag == "ParameterDeclaration" and "name" in attributes:
            self.parameters[attributes["name"]] = attributes.get("value", "")
        elif tag == "Environment" and not self.done:
            self.begun = True
        elif self.begun and not self.done:
            values = {key: self._value(place, text) for key, text in attributes.items()}
            self._read(place, tag, values)

    def end(self, place: ParserPlace, tag: str) -> None:
        """An element closes."""
        self.above.pop()
        self.done = self.done or (tag == "Environment" and self.begun)

    def _value(self, place: ParserPlace, text: str) -> str:
        """A value, or that of the parameter which it names."""
        if not text.startswith("$"):
            return text
        name = text[1:]
        if name not in self.parameters:
            raise place.fault(f"{text[:40]!r} is no parameter that is declared before; write the value in its place")
        return self.parameters[name]

    def _read(self, place: ParserPlace, tag: str, values: dict[str, str]) -> None:
        if tag == "Fog":
            visual = place.number(values, "visualRange", tag)
            if not visual > 0.0:
                raise place.fault(f"Fog: visualRange is {visual:g}; it takes a length over 0 [m]")
            self.environment = replace(self.environment, visual_range_m=visual)
        elif tag == "Center" and "Fog" in self.above:
            x, y, z = (place.number(values, key, tag) for key in "xyz")
            self.middle = x, y, z
        elif tag == "Dimensions" and "Fog" in self.above:
            length, width, height = (place.number(values, key, tag) for key in ("length", "width", "height"))
            if self.middle is None or min(length, width, height) <= 0.0:
                raise place.fault("BoundingBox of the fog: it takes a Center, and then Dimensions over 0")
            self.environment = replace(self.environment, box=Box(self.middle, (length, width, height)))
        elif tag == "Sun":
            lux = "illuminance" if "illuminance" in values else "intensity"
            sun_lux = place.number(values, lux, tag, "add illuminance, or intensity before version 1.2, in lux")
            if sun_lux < 0.0:
                raise place.fault(f"Sun: {lux} is {sun_lux:g}; it takes a number from 0 [lx]")
            self.environment = replace(
                self.environment, sun_lux=sun_lux,
                azimuth=place.number(values, "azimuth", tag), elevation=place.number(values, "elevation", tag),
            )  # fmt: skip
        elif tag == "TimeOfDay":
            clock = re.fullmatch(r"[^T]*T(\d\d):(\d\d)(?::(\d\d))?.*", values.get("dateTime", ""))
            if clock is None:
                raise place.fault(
                    f"TimeOfDay: dateTime is {values.get('dateTime', '')[:40]!r}; write 2026-11-27T18:30:00"
                )
            h, m, s = (int(part or 0) for part in clock.groups())
            self.environment = replace(self.environment, hour=h + m / 60.0 + s / 3600.0)


# -- into a street


def at_its_hour(recipe: Recipe, environment: Environment) -> Recipe:
    """A recipe at the time of day of a file, where both have one."""
    if environment.hour is None or "traffic.hour" not in recipe.distributions:
        return recipe
    hour = Distribution("fixed", (environment.hour,))
    return replace(recipe, distributions={**recipe.distributions, "traffic.hour": hour})


def around(spec: WorldSpec, environment: Environment) -> WorldSpec:
    """A street in the fog of a file, where it says any."""
    visual = environment.visual_range_m
    if visual is None:
        return spec
    return replace(spec, fog={"clear": None, FOG: None if visual >= CLEAR_M else visual}, fog_selected=FOG)


def author(layer: Sdf.Layer, environment: Environment) -> None:
    """Put the fog's box, the sun and the lighting into a stage that `roads.stage.author` made."""
    if environment.box is not None:
        fog = layer.GetPrimAtPath("/World/Fog/Global")
        fog.attributes["xformOp:translate"].default = Gf.Vec3d(*environment.box.middle)
        fog.attributes["xformOp:scale"].default = Gf.Vec3f(*(size / 2.0 for size in environment.box.size))
        fog.SetInfo("documentation", "Boundary of the fog, as the scenario has it.")
    if environment.sun_lux and environment.elevation > 0.0:
        _author_sun(layer, environment)
    if environment.sun_lux is not None or environment.hour is not None:
        layer.GetPrimAtPath("/World").variantSelections["lighting"] = "active" if environment.night else "sky"


def _author_sun(layer: Sdf.Layer, environment: Environment) -> None:
    """A distant light, normalized: its intensity is the illuminance [lx].  It shines in both lightings."""
    prim = Sdf.CreatePrimInLayer(layer, SUN)
    prim.specifier, prim.typeName = Sdf.SpecifierDef, "DistantLight"
    for name, kind, value in (
        ("inputs:intensity", KINDS.Float, environment.sun_lux),
        ("inputs:angle", KINDS.Float, SUN_DEG),
        ("inputs:normalize", KINDS.Bool, True),
        ("xformOp:rotateZ", KINDS.Float, -math.degrees(environment.azimuth)),
        ("xformOp:rotateX", KINDS.Float, math.degrees(environment.elevation) - 90.0),
    ):
        attribute(prim, name, kind, value)
    order(prim, ["xformOp:rotateZ", "xformOp:rotateX"])
