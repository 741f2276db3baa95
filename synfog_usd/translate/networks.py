"""Shader networks of other dialects: MaterialX images, OmniPBR's own textures, Mitsuba's plugins.

Takes shader prims; gives texture nodes, and native BSDFs.  MaterialX nodes that
change a colour on its way are passed through with a note.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from pxr import Gf, Sdf, Usd, UsdShade

from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.texture import ImageReader, TextureNode, UvSource, producer, shader_id, texture_node, value_of

_IMAGES = ("ND_image_", "ND_tiledimage_")
_ADDRESS = {"periodic": "repeat", "clamp": "clamp", "mirror": "mirror", "constant": "black"}
_CHANNELS = {"outr": "r", "outx": "r", "outg": "g", "outy": "g", "outb": "b", "outz": "b", "outa": "a", "outw": "a"}
_STEPS = 12

_TEXTURES = ("bitmap", "checkerboard", "mesh_attribute")
_METALS_AND_GLASS = ("conductor", "roughconductor", "dielectric", "roughdielectric", "thindielectric")
_COATED = ("diffuse", "plastic", "roughplastic", "principled", "principledthin")
PLUGINS = frozenset(
    (*_TEXTURES, *_METALS_AND_GLASS, *_COATED, "blendbsdf", "bumpmap", "mask", "normalmap", "null", "twosided")
)
"""Mitsuba's plugins that a material may name."""


def fed_by(
    output: Usd.Attribute, name: str, time: Usd.TimeCode, notes: Diagnostics, shader: Sdf.Path
) -> TextureNode | None:
    """The picture behind a shader output, or None with a note where there is none that is known."""
    channel, decoded, passed = "", False, ""
    for _ in range(_STEPS):
        prim, kind = output.GetPrim(), shader_id(output.GetPrim())
        node = UsdShade.Shader(prim)
        if kind in ("UsdUVTexture",) or kind.startswith("ND_UsdUVTexture"):
            found: TextureNode | None = texture_node(output, time, notes)
        elif kind.startswith(_IMAGES):
            found = _image(output, kind, time, notes)
        else:
            found = None
        if found is not None:
            if passed:
                notes.warn(shader, f"{name} is fed through {passed}, which is left out")
            found = replace(found, channel=channel) if channel else found
            return replace(found, scale=(2.0, 2.0, 2.0, 1.0), bias=(-1.0, -1.0, -1.0, 0.0)) if decoded else found
        if kind.startswith("ND_separate"):
            channel = _CHANNELS.get(output.GetBaseName(), "r")
        elif kind.startswith("ND_extract"):
            channel = "rgba"[min(max(int(value_of(node, "index", time, 0)), 0), 3)]
        elif kind.startswith("ND_normalmap"):
            decoded = True
        elif not kind.startswith(("ND_convert", "ND_dot")):
            passed = kind or "an unknown node"
        following = next(
            (upstream for source in node.GetInputs() if (upstream := producer(node, source.GetBaseName())) is not None),
            None,
        )
        if following is None:
            notes.warn(shader, f"{name} is fed by {kind or 'an unknown node'}, which is not known; its default is used")
            return None
        output = following
    notes.warn(shader, f"{name} is fed through more than {_STEPS} nodes; its default is used")
    return None


def _image(output: Usd.Attribute, kind: str, time: Usd.TimeCode, notes: Diagnostics) -> TextureNode:
    """A MaterialX image node."""
    shader = UsdShade.Shader(output.GetPrim())
    path, asset = str(shader.GetPath()), value_of(shader, "file", time)
    authored, file = getattr(asset, "path", "") or "", getattr(asset, "resolvedPath", "") or ""
    source = shader.GetInput("file")
    producers = UsdShade.Utils.GetValueProducingAttributes(source) if source else []
    space = next((attribute.GetColorSpace() for attribute in producers if attribute.HasColorSpace()), "")
    fallback = value_of(shader, "default", time, 0.0)
    values = [float(c) for c in (fallback if hasattr(fallback, "__len__") else (fallback,) * 3)]
    if not file:
        notes.warn(path, f"texture {authored or '(no file)'} is not found; its default is used")
    single = kind.endswith("_float")
    return TextureNode(
        path=path,
        file=file,
        authored=authored,
        channel="r" if single else "rgb",
        color_space="raw"
        if kind.endswith(("_float", "_vector2", "_vector3", "_vector4")) and space in ("", "auto")
        else _space(space),
        wrap=_ADDRESS.get(str(value_of(shader, "uaddressmode", time, "periodic")), "repeat"),
        wrap_v=_ADDRESS.get(str(value_of(shader, "vaddressmode", time, "periodic")), "repeat"),
        outside=(*(values + [0.0] * 3)[:3], 1.0),
        scale=(1.0,) * 4,
        bias=(0.0,) * 4,
        fallback=(*(values + [0.0] * 3)[:3], 1.0),
        uv=_coordinates(shader, time, notes, tiled=kind.startswith("ND_tiledimage")),
    )


def _space(name: str) -> str:
    if name in ("", "auto"):
        return "auto"
    return "sRGB" if "srgb" in name.lower() and not name.lower().startswith("lin") else "raw"


def _coordinates(shader: UsdShade.Shader, time: Usd.TimeCode, notes: Diagnostics, *, tiled: bool) -> UvSource:
    output, primvar = producer(shader, "texcoord"), "st"
    if output is not None:
        node, kind = UsdShade.Shader(output.GetPrim()), shader_id(output.GetPrim())
        if kind.startswith("ND_geompropvalue"):
            primvar = str(value_of(node, "geomprop", time, "st"))
        elif kind.startswith("UsdPrimvarReader") or kind.startswith("ND_UsdPrimvarReader"):
            primvar = str(value_of(node, "varname", time, "st"))
        elif not kind.startswith("ND_texcoord"):
            notes.warn(
                node.GetPath(),
                f"texture coordinates through {kind or 'an unknown node'} are drawn as primvar 'st' without it",
            )
    if not tiled:
        return UvSource(primvar)
    tiling, offset = value_of(shader, "uvtiling", time, (1.0, 1.0)), value_of(shader, "uvoffset", time, (0.0, 0.0))
    return UvSource(primvar, ((float(tiling[0]), 0.0, -float(offset[0])), (0.0, float(tiling[1]), -float(offset[1]))))


# -- OmniPBR -------------------------------------------------------------------------------------------------------


def omni_texture(shader: UsdShade.Shader, name: str, time: Usd.TimeCode, notes: Diagnostics) -> TextureNode | None:
    """The picture that an OmniPBR shader names for one of a preview surface's inputs, or None."""

    def asset(word: str) -> Any:
        value = value_of(shader, word, time)
        return value if getattr(value, "path", "") else None

    def number(word: str, default: float) -> float:
        return float(value_of(shader, word, time, default))

    orm = asset("ORM_texture") if number("enable_ORM_texture", 0.0) else None
    found, channel, space, scale = None, "rgb", "auto", (1.0, 1.0, 1.0)
    if name == "diffuseColor":
        found = asset("diffuse_texture")
        tint = value_of(shader, "diffuse_tint", time, Gf.Vec3f(1, 1, 1))
        scale = (float(tint[0]), float(tint[1]), float(tint[2]))
    elif name == "roughness":
        separate = (
            asset("reflectionroughness_texture")
            if number("reflection_roughness_texture_influence", 0.0) > 0.0
            else None
        )
        found, channel, space = (orm, "g", "raw") if orm else (separate, "r", "raw")
    elif name == "metallic":
        separate = asset("metallic_texture") if number("metallic_texture_influence", 0.0) > 0.0 else None
        found, channel, space = (orm, "b", "raw") if orm else (separate, "r", "raw")
    elif name == "opacity" and number("enable_opacity", 0.0) and number("enable_opacity_texture", 0.0):
        found, channel, space = asset("opacity_texture"), "r", "raw"
    elif name == "normal":
        found, space = asset("normalmap_texture"), "raw"
    if found is None:
        return None
    if not found.resolvedPath:
        notes.warn(shader.GetPath(), f"texture {found.path} is not found; the constant is used")
        return None
    stretch, shift = (
        value_of(shader, "texture_scale", time, (1.0, 1.0)),
        value_of(shader, "texture_translate", time, (0.0, 0.0)),
    )
    usual = name == "normal"
    return TextureNode(
        path=str(shader.GetPath()),
        file=found.resolvedPath,
        authored=found.path,
        channel=channel,
        color_space=space,
        wrap="repeat",
        scale=(2.0, 2.0, 2.0, 1.0) if usual else (*scale, 1.0),
        bias=(-1.0, -1.0, -1.0, 0.0) if usual else (0.0,) * 4,
        fallback=(0.0, 0.0, 0.0, 1.0),
        uv=UvSource("st", ((float(stretch[0]), 0.0, float(shift[0])), (0.0, float(stretch[1]), float(shift[1])))),
    )


# -- Mitsuba's own --------------------------------------------------------------------------------------------------


class RefusedError(Exception):
    """A native material that is not drawn, and why."""


def native(shader: UsdShade.Shader, time: Usd.TimeCode, images: ImageReader, depth: int = 0) -> dict[str, Any]:
    """A BSDF or texture of Mitsuba's from shaders named 'mitsuba_<plugin>', inputs named as the plugin's parameters.

    Raises:
        RefusedError: a plugin that is no material, or a picture that cannot be read.
    """
    kind = shader_id(shader.GetPrim()).removeprefix("mitsuba_")
    if kind not in PLUGINS or depth > 8:
        raise RefusedError(
            f"{shader.GetPath()}: {kind or 'a shader without id'} is none of Mitsuba's materials and textures"
        )
    made: dict[str, Any] = {"type": kind}
    for source in shader.GetInputs():
        name = source.GetBaseName()
        output = producer(shader, name)
        if output is not None:
            made[name] = native(UsdShade.Shader(output.GetPrim()), time, images, depth + 1)
            continue
        value = value_of(shader, name, time)
        if isinstance(value, Sdf.AssetPath):
            pixels = images.read(value.resolvedPath, str(shader.GetPath())) if value.resolvedPath else None
            if pixels is None or name != "filename":
                raise RefusedError(f"{shader.GetPath()}: {name} {value.path} cannot be read as a picture")
            made["bitmap"] = np.ascontiguousarray(pixels)
        elif isinstance(value, (bool, int, float, str)):
            made[name] = value
        elif isinstance(value, (Gf.Vec3f, Gf.Vec3d, Gf.Vec3h)):
            made[name] = {"type": "rgb", "value": [float(c) for c in value]}
        elif value is not None:
            raise RefusedError(f"{shader.GetPath()}: {name} of type {type(value).__name__} is not known")
    if kind == "bitmap" and "bitmap" not in made:
        raise RefusedError(f"{shader.GetPath()}: a bitmap without a filename")
    return made


def is_textured(part: Any) -> bool:
    """Whether a native material holds a texture with coordinates."""
    return isinstance(part, dict) and (
        part.get("type") in ("bitmap", "checkerboard") or any(is_textured(value) for value in part.values())
    )
