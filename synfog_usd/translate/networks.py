"""Shader networks of other dialects: MaterialX images, OmniPBR's own textures.

Takes shader prims; gives texture nodes.  What MaterialX nodes make
of a picture on its way is worked out in `nodes`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from pxr import Gf, Sdf, Usd, UsdShade

from synfog_usd.base.arrays import Array
from synfog_usd.base.colour import LUMINANCE
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.nodes import IMAGES, MOST_PIXELS, Graph, UnknownNodeError
from synfog_usd.translate.texture import (
    RAW,
    ImageReader,
    TextureNode,
    UvSource,
    as_measured,
    numbers_in,
    producer,
    shader_id,
    texture_node,
    tiled,
    value_of,
)

_ADDRESS = {"periodic": "repeat", "clamp": "clamp", "mirror": "mirror", "constant": "black"}
_CHANNELS = {"outr": "r", "outx": "r", "outg": "g", "outy": "g", "outb": "b", "outz": "b", "outa": "a", "outw": "a"}
_STEPS = 12


def fed_by(
    output: Usd.Attribute,
    name: str,
    time: Usd.TimeCode,
    notes: Diagnostics,
    shader: Sdf.Path,
    images: ImageReader,
    of_shape: Callable[[Usd.Attribute], tuple[float, ...] | None],
) -> TextureNode | None:
    """The picture or constant behind a shader output, or None with a note where there is none that is known.

    A picture that comes straight, or by its channels alone, stays as its file has it;
    one that other nodes change is worked out.

    Args:
        of_shape: from the output of a reader to what a primvar of the shape gives.
    """
    channel, strength = "", None
    start = output
    for _ in range(_STEPS):
        prim, kind = output.GetPrim(), shader_id(output.GetPrim())
        node = UsdShade.Shader(prim)
        found = _picture(output, kind, time, notes)
        if found is not None:
            return _decoded(replace(found, channel=channel) if channel else found, strength)
        if kind.startswith("ND_separate"):
            channel = _CHANNELS.get(output.GetBaseName(), "r")
        elif kind.startswith("ND_extract"):
            channel = "rgba"[min(max(int(value_of(node, "index", time, 0)), 0), 3)]
        elif kind.startswith("ND_normalmap"):
            strength = 1.0 if (given := value_of(node, "scale", time)) is None else numbers_in(given) or 1.0
        elif not kind.startswith(("ND_convert", "ND_dot")):
            break
        following = producer(node, "in")
        if following is None:
            break
        output = following
        if strength is not None and kind.startswith("ND_normalmap"):
            start = output
    graph = Graph(time, images, lambda one, kind: _picture(one, kind, time, notes), of_shape)
    return _worked_out(graph, start, name, notes, shader, strength)


def _picture(output: Usd.Attribute, kind: str, time: Usd.TimeCode, notes: Diagnostics) -> TextureNode | None:
    if kind == "UsdUVTexture" or kind.startswith("ND_UsdUVTexture"):
        return texture_node(output, time, notes)
    return _image(output, kind.removesuffix("_1_0"), time, notes) if kind.startswith(IMAGES) else None


def _decoded(node: TextureNode, strength: Any) -> TextureNode:
    """A picture of normals as directions, their slopes times `strength`; any other where that is None."""
    if strength is None:
        return node
    u, v = (strength * 2)[:2] if isinstance(strength, tuple) else (float(strength),) * 2
    return replace(node, scale=(2.0 * u, 2.0 * v, 2.0, 1.0), bias=(-u, -v, -1.0, 0.0))


def _worked_out(
    graph: Graph, output: Usd.Attribute, name: str, notes: Diagnostics, shader: Sdf.Path, strength: Any
) -> TextureNode | None:
    """What nodes make of pictures and constants; where one of them is not known, the first picture behind them."""
    try:
        value = graph.value(output)
    except UnknownNodeError as unknown:
        return _passed_through(output, name, graph.time, notes, shader, str(unknown), strength)
    if value.means:
        notes.warn(shader, f"{name} is fed by {', '.join(sorted(value.means))}, which is drawn as its mean")
    if value.others:
        notes.warn(shader, f"{name} is fed by pictures with different coordinates; all but the first are their mean")
    pixels = value.pixels
    if value.picture is None or pixels.shape[:2] == (1, 1):
        mean = [float(c) for c in pixels.mean(axis=(0, 1))]
        four = mean[:4] if len(mean) == 4 else [*(mean * 3 if len(mean) == 1 else [*mean, 0.0, 0.0])[:3], 1.0]
        return TextureNode(str(shader), "", "", "rgb", "raw", "repeat", _ONES, _ZEROS, tuple(four), None)
    key = f"{output.GetPath()} of {output.GetPrim().GetStage().GetRootLayer().identifier}"
    spread: Any = np.repeat(pixels, 3, axis=2) if pixels.shape[2] == 1 else pixels
    graph.images.keep(key, np.ascontiguousarray(spread))
    made = replace(
        value.picture, file=key, authored=key, channel="rgb", color_space="raw", scale=_ONES, bias=_ZEROS, tiles=()
    )
    return _decoded(made, strength)


_ONES, _ZEROS = (1.0,) * 4, (0.0,) * 4


def _passed_through(
    output: Usd.Attribute,
    name: str,
    time: Usd.TimeCode,
    notes: Diagnostics,
    shader: Sdf.Path,
    passed: str,
    strength: Any,
) -> TextureNode | None:
    """The first picture behind nodes that are not known, which are left out."""
    for _ in range(_STEPS):
        found = _picture(output, shader_id(output.GetPrim()), time, notes)
        if found is not None:
            notes.warn(shader, f"{name} is fed through {passed}, which is left out")
            return _decoded(found, strength)
        node = UsdShade.Shader(output.GetPrim())
        following = next(
            (upstream for source in node.GetInputs() if (upstream := producer(node, source.GetBaseName())) is not None),
            None,
        )
        if following is None:
            break
        output = following
    notes.warn(shader, f"{name} is fed by {passed}, which is not known; its default is used")
    return None


def _image(output: Usd.Attribute, kind: str, time: Usd.TimeCode, notes: Diagnostics) -> TextureNode:
    """A MaterialX image node; one of glTF's is multiplied by its factor, or holds normals."""
    shader = UsdShade.Shader(output.GetPrim())
    path, asset = str(shader.GetPath()), value_of(shader, "file", time)
    authored, file = getattr(asset, "path", "") or "", getattr(asset, "resolvedPath", "") or ""
    source = shader.GetInput("file")
    producers = UsdShade.Utils.GetValueProducingAttributes(source) if source else []
    space = next((attribute.GetColorSpace() for attribute in producers if attribute.HasColorSpace()), "")
    fallback = numbers_in(value_of(shader, "default", time)) or (0.0,)
    values = list(fallback * 3 if len(fallback) == 1 else fallback)
    single = kind.endswith("_float")
    uv: UvSource | None = _coordinates(shader, kind, time, notes)
    tiles, file, uv = tiled(shader, authored, file, uv)
    if not file:
        notes.warn(path, f"texture {authored or '(no file)'} is not found; its default is used")
    if "_color" in kind and _space(space) == "raw" and space not in RAW:
        notes.warn(path, f"a picture in colour space {space[:40]!r} is read as linear Rec.709")

    def address(name: str) -> str:
        return _ADDRESS[notes.token(path, name, value_of(shader, name, time, "periodic"), _ADDRESS, "periodic")]

    made = TextureNode(
        path=path,
        file=file,
        authored=authored,
        channel="r" if single else "a" if output.GetBaseName() == "outa" else "rgb",
        color_space="raw"
        if kind.endswith(("_float", "_vector2", "_vector3", "_vector4")) and space in ("", "auto")
        else _space(space),
        wrap="clamp" if tiles else address("uaddressmode"),
        wrap_v="clamp" if tiles else address("vaddressmode"),
        outside=(*(values + [0.0] * 3)[:3], 1.0),
        scale=(1.0,) * 4,
        bias=(0.0,) * 4,
        fallback=(*(values + [0.0] * 3)[:3], 1.0),
        uv=uv,
        tiles=tiles,
    )
    if kind == "ND_gltf_normalmap_vector3":
        return _decoded(made, 1.0)
    return replace(made, scale=_factor(shader, time)) if kind.startswith("ND_gltf") else made


def _factor(shader: UsdShade.Shader, time: Usd.TimeCode) -> tuple[float, ...]:
    """(4,) by which one of glTF's images is multiplied."""
    times = np.ones(4)
    for name in ("factor", "color", "geomcolor"):
        given = np.array(numbers_in(value_of(shader, name, time)) or (1.0,))[:4]
        times[: len(given)] *= given
        if len(given) == 1:
            times[1:3] *= given
    return tuple(times.tolist())


def _space(name: str) -> str:
    if name in ("", "auto"):
        return "auto"
    return "sRGB" if "srgb" in name.lower() and not name.lower().startswith("lin") else "raw"


def _coordinates(shader: UsdShade.Shader, kind: str, time: Usd.TimeCode, notes: Diagnostics) -> UvSource:
    """The primvar behind an image's texcoord, and the transforms by constants between."""
    matrix = np.eye(3)
    if kind.startswith("ND_gltf"):  # KHR_texture_transform, from the upper left corner
        stretch, shift = _pair(shader, "scale", time, 1.0), _pair(shader, "offset", time, 0.0)
        matrix = _placed(
            _pair(shader, "pivot", time, (0.0, 1.0)),
            stretch,
            -float(value_of(shader, "rotate", time, 0.0)),
            (-shift[0], shift[1]),
            offset_first=bool(value_of(shader, "operationorder", time, 0)),
        )
    if kind.startswith("ND_tiledimage"):
        tiling, offset = value_of(shader, "uvtiling", time, (1.0, 1.0)), value_of(shader, "uvoffset", time, (0.0, 0.0))
        matrix = _affine((float(tiling[0]), float(tiling[1])), shift=(-float(offset[0]), -float(offset[1])))
    output, primvar = producer(shader, "texcoord"), "st"
    for _ in range(_STEPS):
        if output is None:
            break
        node, kind = UsdShade.Shader(output.GetPrim()), shader_id(output.GetPrim())
        if kind.startswith("ND_geompropvalue"):
            primvar = str(value_of(node, "geomprop", time, "st"))
            break
        if kind.startswith(("UsdPrimvarReader", "ND_UsdPrimvarReader")):
            primvar = str(value_of(node, "varname", time, "st"))
            break
        if kind.startswith("ND_texcoord"):
            break
        step, following = _step(node, kind, time)
        if step is None:
            notes.warn(
                node.GetPath(),
                f"texture coordinates through {kind or 'an unknown node'} are drawn as primvar 'st' without it",
            )
            break
        matrix, output = matrix @ step, producer(node, following)
    (a, b, c), (d, e, f) = matrix[:2].tolist()
    return UvSource(primvar, ((a, b, c), (d, e, f)))


def _affine(scale: tuple[float, float], *, shift: tuple[float, float] = (0.0, 0.0), degrees: float = 0.0) -> Array:
    """(3, 3) that scales, then turns clockwise as MaterialX's rotate2d does, then shifts."""
    angle = np.radians(degrees)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    made = np.eye(3)
    made[:2, :2], made[:2, 2] = turn @ np.diag(scale), shift
    return made


def _placed(
    pivot: tuple[float, float],
    times: tuple[float, float],
    degrees: float,
    offset: tuple[float, float],
    *,
    offset_first: bool,
) -> Array:
    """(3, 3) that, about a pivot, multiplies, turns clockwise and takes an offset away, or does so the other way
    round.
    """
    turn, scale = _affine((1.0, 1.0), degrees=degrees), _affine(times)
    back, away = _affine((1.0, 1.0), shift=pivot), _affine((1.0, 1.0), shift=(-pivot[0], -pivot[1]))
    less = _affine((1.0, 1.0), shift=(-offset[0], -offset[1]))
    return back @ (scale @ turn @ less if offset_first else less @ turn @ scale) @ away


def _pair(
    node: UsdShade.Shader, name: str, time: Usd.TimeCode, default: float | tuple[float, float]
) -> tuple[float, float]:
    """Two numbers of an input; one stands for both."""
    numbers = numbers_in(value_of(node, name, time)) or numbers_in(default) or (0.0,)
    return (numbers[0], numbers[1]) if len(numbers) > 1 else (numbers[0], numbers[0])


def _step(node: UsdShade.Shader, kind: str, time: Usd.TimeCode) -> tuple[Array | None, str]:
    """What a node does to texture coordinates, and the input that they come by; None where it is not known."""
    if kind.startswith("ND_place2d"):  # MaterialX divides by the scale
        sx, sy = _pair(node, "scale", time, 1.0)
        return _placed(
            _pair(node, "pivot", time, 0.0),
            (1.0 / sx if sx else 0.0, 1.0 / sy if sy else 0.0),
            float(value_of(node, "rotate", time, 0.0)),
            _pair(node, "offset", time, 0.0),
            offset_first=bool(value_of(node, "operationorder", time, 0)),
        ), "texcoord"
    if kind.startswith("ND_rotate2d"):
        return _affine((1.0, 1.0), degrees=float(value_of(node, "amount", time, 0.0))), "in"
    category = kind.removeprefix("ND_").split("_")[0]
    if category in ("add", "subtract", "multiply", "divide") and kind.split("_")[-1].startswith("vector2"):
        first = "in1" if producer(node, "in1") is not None else "in2"
        if first == "in2" and category in ("subtract", "divide"):
            return None, ""
        other = "in2" if first == "in1" else "in1"
        if producer(node, other) is not None:
            return None, ""
        x, y = _pair(node, other, time, 1.0 if category in ("multiply", "divide") else 0.0)
        if category == "multiply":
            return _affine((x, y)), first
        if category == "divide":
            return (_affine((1.0 / x, 1.0 / y)) if x and y else None), first
        sign = 1.0 if category == "add" else -1.0
        return _affine((1.0, 1.0), shift=(sign * x, sign * y)), first
    return None, ""


# -- OmniPBR -------------------------------------------------------------------------------------------------------


def omni_texture(
    shader: UsdShade.Shader, name: str, time: Usd.TimeCode, notes: Diagnostics, images: ImageReader
) -> TextureNode | None:
    """The picture that an OmniPBR shader names for one of a preview surface's inputs, or None."""

    def asset(word: str) -> Any:
        value = value_of(shader, word, time)
        return value if getattr(value, "path", "") else None

    def number(word: str, default: float) -> float:
        return float(value_of(shader, word, time, default))

    orm = asset("ORM_texture") if number("enable_ORM_texture", 0.0) else None
    found, channel, space, scale, bias = None, "rgb", "auto", _ONES, _ZEROS
    if name == "diffuseColor":
        found = asset("diffuse_texture")
        tint = [float(c) for c in value_of(shader, "diffuse_tint", time, Gf.Vec3f(1, 1, 1))]
        times, more = number("albedo_brightness", 1.0), number("albedo_add", 0.0)
        scale, bias = (*(times * c for c in tint), 1.0), (*(more * c for c in tint), 0.0)
    elif name in ("roughness", "metallic"):
        word, constant, default, orm_channel = {
            "roughness": ("reflection_roughness", "reflection_roughness_constant", 0.5, "g"),
            "metallic": ("metallic", "metallic_constant", 0.0, "b"),
        }[name]
        own = asset("reflectionroughness_texture" if name == "roughness" else "metallic_texture")
        weight = number(f"{word}_texture_influence", 1.0 if orm else 0.0)
        found, channel, space = (orm, orm_channel, "raw") if orm else (own, "r", "raw")
        if weight <= 0.0:
            return None
        scale, bias = (weight,) * 4, ((1.0 - weight) * number(constant, default),) * 4
    elif name == "opacity" and number("enable_opacity", 0.0) and number("enable_opacity_texture", 0.0):
        found, channel, space = asset("opacity_texture"), "r", "raw"
    elif name == "emissiveColor":
        found = asset("emissive_mask_texture")
        light = value_of(shader, "emissive_color", time, Gf.Vec3f(1.0, 0.1, 0.1))
        scale = (*(number("emissive_intensity", 40.0) * float(c) for c in light), 1.0)
    elif name == "normal":
        found, space = asset("normalmap_texture"), "raw"
        slope = number("bump_factor", 1.0)
        scale, bias = (2.0 * slope, 2.0 * slope, 2.0, 1.0), (-slope, -slope, -1.0, 0.0)
    if found is None:
        return None
    if not found.resolvedPath:
        notes.warn(shader.GetPath(), f"texture {found.path} is not found; the constant is used")
        return None
    if number("texture_rotate", 0.0):
        notes.warn(shader.GetPath(), "texture_rotate is not drawn")
    stretch, shift = (
        value_of(shader, "texture_scale", time, (1.0, 1.0)),
        value_of(shader, "texture_translate", time, (0.0, 0.0)),
    )
    node = TextureNode(
        path=str(shader.GetPath()),
        file=found.resolvedPath,
        authored=found.path,
        channel=channel,
        color_space=space,
        wrap="repeat",
        scale=scale,
        bias=bias,
        fallback=(0.0, 0.0, 0.0, 1.0),
        uv=UvSource("st", ((float(stretch[0]), 0.0, float(shift[0])), (0.0, float(stretch[1]), float(shift[1])))),
    )
    grey = number("albedo_desaturation", 0.0) if name == "diffuseColor" else 0.0
    return _desaturated(node, grey, [float(c) for c in tint], images) if grey else node


def _desaturated(node: TextureNode, share: float, tint: list[float], images: ImageReader) -> TextureNode:
    """A picture of which a share is grey of the same luminance, before its tint."""
    pixels = as_measured(replace(node, scale=_ONES, bias=_ZEROS), images, MOST_PIXELS)[..., :3]
    ratio = [node.scale[k] / tint[k] if tint[k] else 0.0 for k in range(3)]
    more = [node.bias[k] / tint[k] if tint[k] else 0.0 for k in range(3)]
    bright = pixels * np.array(ratio, dtype=np.float32) + np.array(more, dtype=np.float32)
    grey = (bright @ LUMINANCE.astype(np.float32))[..., None]
    made = (bright + np.float32(share) * (grey - bright)) * np.array(tint, dtype=np.float32)
    key = f"{node.file} for {node.path}"
    images.keep(key, np.ascontiguousarray(made, dtype=np.float32))
    return replace(node, file=key, color_space="raw", scale=_ONES, bias=_ZEROS)
