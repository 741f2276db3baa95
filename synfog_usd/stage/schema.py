"""The fog schema: every `synfog:` name, its default, and how it is read from a prim.

Takes a prim; gives `FogAttributes` or None.  Reading does not need the plugin: a
stage keeps the applied schema's name and the authored values without it, and the
defaults stand here.  Knows nothing of geometry or units; the values are metres
and 1/m whatever the stage's metersPerUnit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from pxr import Plug, Sdf, Usd

from synfog_usd.base import resources
from synfog_usd.base.errors import StageError, did_you_mean

API_NAME = "SynFogMediumAPI"
PREFIX = "synfog:fog:"
MEDIUM_PREFIX = "synfog:medium:"
PLUGIN_FOLDER = resources.schema_plugin()
FOG_VARIANT_SET = "fog"
LIGHTING_VARIANT_SET = "lighting"

DEFAULTS: Mapping[str, Any] = MappingProxyType(
    {
        "enabled": True,
        "mor": 300.0,
        "sigma_t": None,
        "contrast": 0.05,
        "albedo": 1.0,
        "phase": "hg",
        "g": 0.87,
        "dropletDiameter": None,
        "angstrom": 0.0,
        "profile": "uniform",
        "densityGrid": None,
        "scaleHeight": 50.0,
        "outerScale": 8.0,
        "deviation": 0.5,
        "seed": 0,
        "priority": 0,
        "kind": "fog",
        "rate": None,
        "also": "",
        "sizes": "",
        "number": None,
        "alpha": None,
        "power": None,
        "mode": None,
        "median": None,
        "spread": None,
    }
)
"""Fallback values, the same as in the schema; None for none."""

OF_SIZES = ("number", "alpha", "power", "mode", "median", "spread")
"""Numbers of a size distribution that has no name."""

OF_MEDIUM = ("kind", "rate", "also", "sizes", *OF_SIZES)
"""Names of `DEFAULTS` that have the prefix `synfog:medium:`."""

_USER_PREFIXES = (
    *(f"userProperties:synfog:{part}:" for part in ("fog", "medium")),
    *(f"userProperties:synfog_{part}" for part in ("fog_", "medium_", "")),
)


@dataclass(frozen=True)
class FogAttributes:
    """Fog attributes of one prim, not yet checked against physics.

    Attributes:
        path: prim that the attributes stand on.
        values: name without prefix -> value; every name of `DEFAULTS`.
        attribute_of: name -> full name of the authored attribute; only authored ones.
    """

    path: str
    values: Mapping[str, Any]
    attribute_of: Mapping[str, str]


def register() -> bool:
    """Make the schema known to USD; False where it came too late or is known already.

    USD builds its schema registry at the first question about a prim's type, so
    this runs when `synfog_usd.stage` is imported.  Reading works either way.
    """
    return bool(Plug.Registry().RegisterPlugins(str(PLUGIN_FOLDER)))


def has_fog_attributes(prim: Usd.Prim, authored: Sequence[str] | None = None) -> bool:
    """Whether the prim carries the fog schema or one of its attributes.

    Args:
        prim: any prim.
        authored: its `GetAuthoredPropertyNames()`, where they are at hand.
    """
    if API_NAME in prim.GetPrimTypeInfo().GetAppliedAPISchemas():
        return True
    names = prim.GetAuthoredPropertyNames() if authored is None else authored
    return any(
        name.startswith((PREFIX, MEDIUM_PREFIX))
        or (name.startswith("userProperties:synfog") and _name_of(name) is not None)
        for name in names
    )


def read_fog(prim: Usd.Prim, time: Usd.TimeCode) -> FogAttributes | None:
    """The fog attributes that stand on a prim, or None where there are none.

    Numbers may be of any numeric type; `userProperties:synfog_*`, as Blender
    writes custom properties, counts where the proper name is absent.

    Raises:
        StageError: an attribute of that namespace that does not exist, or a value
            that is no number, truth value, word or file, as its name demands.
    """
    if not has_fog_attributes(prim):
        return None
    names: dict[str, str] = {}
    for prop in prim.GetAuthoredPropertiesInNamespace("userProperties"):
        name = _name_of(prop.GetName())
        if name is not None:
            names[name] = prop.GetName()
    for full_name in prim.GetAuthoredPropertyNames():
        name = full_name.rpartition(":")[2]
        if not full_name.startswith((PREFIX, MEDIUM_PREFIX)):
            continue
        if name not in DEFAULTS or full_name != full_name_of(name):
            raise StageError(
                f"{prim.GetPath()}: there is no attribute {full_name}; known are "
                f"{', '.join(DEFAULTS)}.{did_you_mean(name, DEFAULTS)}"
            )
        names[name] = full_name
    values = dict(DEFAULTS)
    authored: dict[str, str] = {}
    for name, full_name in names.items():
        attribute = prim.GetAttribute(full_name)
        value = attribute.Get(time) if attribute else None
        if value is None:
            continue
        value = _checked(prim, full_name, name, value)
        if isinstance(value, float) and attribute.GetTypeName() in ("float", "half"):
            value = float(f"{value:.7g}")  # 0.87 as it was typed, not 0.8700000047683716
        values[name] = value
        authored[name] = full_name
    return FogAttributes(str(prim.GetPath()), MappingProxyType(values), MappingProxyType(authored))


def full_name_of(name: str) -> str:
    """The attribute's name on a prim: `synfog:fog:mor`, `synfog:medium:kind`."""
    return (MEDIUM_PREFIX if name in OF_MEDIUM else PREFIX) + name


def _name_of(property_name: str) -> str | None:
    """The schema's name behind a user property, or None."""
    for prefix in _USER_PREFIXES:
        name = property_name.removeprefix(prefix)
        if name != property_name and name in DEFAULTS:
            return name
    return None


def _checked(prim: Usd.Prim, full_name: str, name: str, value: object) -> bool | int | float | str | Sdf.AssetPath:
    shown = " ".join(repr(value).split())
    shown = shown if len(shown) < 80 else f"{shown[:79]}…"
    if name in ("phase", "profile", "kind", "also", "sizes"):
        if not isinstance(value, str):
            raise StageError(
                f"{prim.GetPath()}: {full_name} = {shown} is not a word; it takes for example {DEFAULTS[name]!r}"
            )
        return value
    if name == "densityGrid":
        if not isinstance(value, Sdf.AssetPath):
            raise StageError(
                f"{prim.GetPath()}: {full_name} = {shown} is not a file; give the attribute the type asset"
            )
        return value
    if not isinstance(value, (bool, int, float)) or not math.isfinite(value):
        raise StageError(f"{prim.GetPath()}: {full_name} = {shown} is not a finite number")
    if name == "enabled":
        return bool(value)
    if name in ("priority", "seed"):
        return int(value)
    return float(value)
