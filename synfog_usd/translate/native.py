"""Mitsuba's own materials, written in USD as shaders named 'mitsuba_<plugin>'.

Takes shader prims; gives BSDFs in the scene's words.  What a plugin does not take is told
and left out; whether the renderer draws what is left, only the renderer can say.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from pxr import Gf, Sdf, Usd, UsdShade

from synfog_usd.base.errors import did_you_mean
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.texture import ImageReader, producer, shader_id, value_of

FIRST_SQUARE = 0.4
"""What the square of a checkerboard reflects that lies at (0, 0), where nothing is authored."""

VERTEX_COLOR = "vertex_color"
"""The one attribute that meshes carry for materials."""

_DEEPEST, _MOST_HELD = 8, 3

_IORS, _LOBES = ("int_ior", "ext_ior"), ("distribution", "alpha", "sample_visible")
_REFLECTED, _BENT = ("specular_reflectance", "specular_transmittance"), ("flip_invalid_normals",)
_DISNEY = (
    *("base_color", "roughness", "anisotropic", "spec_trans", "eta"),
    *("spec_tint", "sheen", "sheen_tint", "flatness"),
)
_HOLDERS: Mapping[str, tuple[str, ...]] = {
    "twosided": ("allow_transmission",),
    "mask": ("opacity",),
    "blendbsdf": ("weight",),
    "bumpmap": ("scale", *_BENT, "use_shadowing_function"),
    "normalmap": ("normalmap", *_BENT, "use_shadowing_function"),
}
"""What surfaces take that hold others; those may be connected to inputs of any name."""

_TEXTURES: Mapping[str, tuple[str, ...]] = {
    "bitmap": ("filename", "filter_type", "wrap_mode", "raw", "format", "accel"),
    "checkerboard": ("color0", "color1"),
    "mesh_attribute": ("name", "scale"),
}
_PARAMETERS: Mapping[str, tuple[str, ...]] = {
    **_HOLDERS,
    **_TEXTURES,
    "diffuse": ("reflectance",),
    "plastic": ("diffuse_reflectance", "nonlinear", _REFLECTED[0], *_IORS),
    "roughplastic": ("diffuse_reflectance", "nonlinear", _REFLECTED[0], *_IORS, *_LOBES),
    "conductor": ("eta", "k", "material", _REFLECTED[0]),
    "roughconductor": ("eta", "k", "material", _REFLECTED[0], *_LOBES, "alpha_u", "alpha_v"),
    "dielectric": (*_IORS, *_REFLECTED),
    "thindielectric": (*_IORS, *_REFLECTED),
    "roughdielectric": (*_IORS, *_REFLECTED, *_LOBES, "alpha_u", "alpha_v"),
    "principled": (
        *(*_DISNEY, "metallic", "specular", "clearcoat", "clearcoat_gloss", "diffuse_reflectance_sampling_rate"),
        *("main_specular_sampling_rate", "clearcoat_sampling_rate"),
    ),
    "principledthin": (
        *(*_DISNEY, "diff_trans", "diffuse_reflectance_sampling_rate", "specular_reflectance_sampling_rate"),
        "specular_transmittance_sampling_rate",
    ),
    "null": (),
}
"""Mitsuba's plugins that a material may name, and what they take."""

_NEEDED = {"bitmap": "bitmap", "blendbsdf": "weight", "mesh_attribute": "name", "normalmap": "normalmap"}
"""What a plugin cannot do without, as the scene has it."""

_MEDIA = (
    *("vacuum", "helium", "hydrogen", "air", "carbon dioxide", "water", "acetone", "ethanol", "carbon tetrachloride"),
    *("glycerol", "benzene", "silicone oil", "bromine", "water ice", "fused quartz", "pyrex", "acrylic glass"),
    *("polypropylene", "bk7", "sodium chloride", "amber", "pet", "diamond"),
)
"""Words for an index of refraction."""

_FLAGS = ("nonlinear", "sample_visible", "raw", "accel", "allow_transmission", *_BENT, "use_shadowing_function")
_WORDS: Mapping[str, tuple[str, ...] | None] = {
    "distribution": ("beckmann", "ggx"),
    "filter_type": ("bilinear", "nearest"),
    "wrap_mode": ("repeat", "mirror", "clamp"),
    "format": ("variant", "fp16", "auto"),
    "material": None,
    "name": None,
}
"""Parameters that are true or false, and those that are words, with the words where they are few."""

_ALONE = frozenset({*_IORS, "scale", ("roughplastic", "alpha"), ("principled", "eta"), ("principled", "specular")})
"""Parameters, or those of a plugin, that are one number and no colour."""

_MOST = {**dict.fromkeys(("eta", "k", "scale", "alpha", "alpha_u", "alpha_v", *_IORS), math.inf), "diff_trans": 2.0}
"""The greatest value of a parameter; of all others, which are shares of light, 1."""


class RefusedError(Exception):
    """A native material that is not drawn, and why."""


def native(
    shader: UsdShade.Shader, time: Usd.TimeCode, images: ImageReader, notes: Diagnostics, depth: int = 0
) -> dict[str, Any]:
    """A BSDF or texture of Mitsuba's from shaders named 'mitsuba_<plugin>', inputs named as the plugin's parameters.
    An input that the plugin does not take is told and left out.

    Raises:
        RefusedError: a plugin that is no material, a picture that cannot be read, or surfaces without end.
    """
    kind, path = shader_id(shader.GetPrim()).removeprefix("mitsuba_"), shader.GetPath()
    if kind not in _PARAMETERS:
        raise RefusedError(f"{path}: {kind or 'a shader without id'} is none of Mitsuba's materials and textures")
    fed = {name: output for source in shader.GetInputs() if (output := producer(shader, name := source.GetBaseName()))}
    if depth > _DEEPEST or (kind in _HOLDERS and len(fed) > _MOST_HELD):
        raise RefusedError(f"{path}: {kind} holds too many others, or stands too deep in others")
    made: dict[str, Any] = {"type": kind}
    for source in shader.GetInputs():
        name = source.GetBaseName()
        value = None if name in fed else value_of(shader, name, time)
        if (wrong := _misfit(kind, name, value, fed=name in fed)) is not None:
            notes.warn(path, f"{name} {wrong}; drawn without it")
        elif name in fed:
            made[name] = native(UsdShade.Shader(fed[name].GetPrim()), time, images, notes, depth + 1)
        elif name == "filename":
            file = value.resolvedPath if isinstance(value, Sdf.AssetPath) else ""
            pixels = images.read(file, str(path)) if file else None
            if pixels is None:
                raise RefusedError(f"{path}: filename {getattr(value, 'path', value)} cannot be read as a picture")
            made["bitmap"] = np.ascontiguousarray(pixels)
        elif isinstance(value, (bool, str)):
            made[name] = value
        elif isinstance(value, (int, float)):
            made[name] = float(value)
        elif value is not None:
            made[name] = {"type": "rgb", "value": [float(c) for c in value]}
    if (needed := _NEEDED.get(kind)) is not None and needed not in made:
        raise RefusedError(f"{path}: {kind} is without its {'filename' if needed == kind else needed}")
    if kind in _HOLDERS and not any(map(is_surface, made.values())):
        raise RefusedError(f"{path}: {kind} holds no surface")
    return made


def _misfit(kind: str, name: str, value: Any, *, fed: bool) -> str | None:
    """Why a plugin does not take a parameter's value, or the parameter; None where it does."""
    known = _PARAMETERS[kind]
    if name not in known:
        if fed and kind in _HOLDERS and name not in ("type", "id"):
            return None
        meant = did_you_mean(name, known).strip()
        return f"is no parameter of {kind}, which takes {', '.join(known) or 'none'}{f' ({meant})' if meant else ''}"
    alone = name.endswith("_rate") or not _ALONE.isdisjoint((name, (kind, name)))
    if fed:
        wants_value = alone or name in (*_FLAGS, *_WORDS, "filename")
        return "is connected to a shader, and a value is wanted" if wants_value else None
    if value is None or name == "filename" or (name in _IORS and isinstance(value, str) and value in _MEDIA):
        return None
    if name in _FLAGS:
        return None if isinstance(value, bool) else f"is {value!r}, and true or false is wanted"
    if name in _WORDS:
        words = _WORDS[name]
        fits = isinstance(value, str) and (words is None or value in words)
        return None if fits else f"is {value!r}, and {' or '.join(words or ('a word',))} is wanted"
    most = math.inf if name.endswith("_rate") else _MOST.get(name, 1.0)
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        least = -math.inf if name == "scale" else 0.0
        fits = math.isfinite(value) and least <= value <= most and not (name in _IORS and value == 0.0)
        return None if fits else f"is {value:g}, which cannot be drawn"
    if not isinstance(value, (Gf.Vec3f, Gf.Vec3d, Gf.Vec3h)) or alone:
        return f"is {value!r}, and a number{'' if alone else ' or a colour'} is wanted"
    return None if all(0.0 <= c <= most for c in value) else f"is {tuple(value)}, and 0 to {most:g} can be drawn"


def is_surface(part: Any) -> bool:
    """Whether a part of a native material is a surface, and no texture, colour or number."""
    return isinstance(part, Mapping) and part["type"] not in (*_TEXTURES, "rgb")


def parts(part: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """A BSDF and all surfaces and textures in it."""
    yield part
    for value in part.values():
        if isinstance(value, Mapping):
            yield from parts(value)


def is_textured(part: Mapping[str, Any]) -> bool:
    """Whether a native material holds a texture with coordinates."""
    return any(one["type"] in ("bitmap", "checkerboard") for one in parts(part))


def reads_vertices(part: Mapping[str, Any]) -> bool:
    """Whether a native material reads the colours of vertices.

    Raises:
        RefusedError: it reads another attribute, which no mesh carries.
    """
    names = {one.get("name") for one in parts(part) if one["type"] == "mesh_attribute"}
    if names - {VERTEX_COLOR}:
        raise RefusedError(f"a mesh_attribute reads {VERTEX_COLOR}, which meshes carry, and nothing else")
    return bool(names)
