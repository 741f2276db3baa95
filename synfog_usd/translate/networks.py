"""Shader networks of other dialects: MaterialX images, OmniPBR's own textures.

Takes shader prims; gives texture nodes.  MaterialX nodes between a picture and a material are
evaluated in `nodes`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from pxr import Sdf, Usd, UsdShade

from synfog_usd.base.arrays import Array
from synfog_usd.base.colour import LUMINANCE
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.nodes import IMAGES, MOST_PIXELS, Graph, UnknownNodeError
from synfog_usd.translate.shader import (
    file_of,
    flag_of,
    number_of,
    numbers_in,
    numbers_of,
    producer,
    shader_id,
    value_of,
    word_of,
)
from synfog_usd.translate.texture import RAW, ImageReader, TextureNode, UvSource, as_measured, texture_node, tiled

_ADDRESS = {"periodic": "repeat", "clamp": "clamp", "mirror": "mirror", "constant": "black"}
_CHANNELS = {"outr": "r", "outx": "r", "outg": "g", "outy": "g", "outb": "b", "outz": "b", "outa": "a", "outw": "a"}
_STEPS = 12
"""Shaders that are followed one after the other."""

_ONES, _ZEROS = (1.0,) * 4, (0.0,) * 4


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
    one that other nodes change is evaluated pixel by pixel.

    Args:
        of_shape: from the output of a reader to the numbers of the shape's primvar.
    """
    channel = ""
    strength: tuple[float, ...] | None = None
    start = output
    for _ in range(_STEPS):
        prim, kind = output.GetPrim(), shader_id(output.GetPrim())
        node = UsdShade.Shader(prim)
        picture = _picture(output, kind, time, notes)
        if picture is not None:
            return _decoded(replace(picture, channel=channel) if channel else picture, strength)
        if kind.startswith("ND_separate"):
            channel = _CHANNELS.get(output.GetBaseName(), "r")
        elif kind.startswith("ND_extract"):
            channel = "rgba"[min(max(int(number_of(node, "index", time, 0.0)), 0), 3)]
        elif kind.startswith("ND_normalmap"):
            strength = numbers_in(value_of(node, "scale", time)) or (1.0,)
        elif not kind.startswith(("ND_convert", "ND_dot")):
            break
        following = producer(node, "in")
        if following is None:
            break
        output = following
        if strength is not None and kind.startswith("ND_normalmap"):
            start = output
    graph = Graph(time, images, lambda image, kind: _picture(image, kind, time, notes), of_shape)
    return _evaluated(graph, start, name, notes, shader, strength)


def _picture(output: Usd.Attribute, kind: str, time: Usd.TimeCode, notes: Diagnostics) -> TextureNode | None:
    if kind == "UsdUVTexture" or kind.startswith("ND_UsdUVTexture"):
        return texture_node(output, time, notes)
    return _image(output, kind.removesuffix("_1_0"), time, notes) if kind.startswith(IMAGES) else None


def _decoded(node: TextureNode, strength: tuple[float, ...] | None) -> TextureNode:
    """A picture of normals as directions, their slopes times `strength`; any other where that is None."""
    if strength is None:
        return node
    u, v = (strength * 2)[:2]
    return replace(node, scale=(2.0 * u, 2.0 * v, 2.0, 1.0), bias=(-u, -v, -1.0, 0.0))


def _evaluated(
    graph: Graph,
    output: Usd.Attribute,
    name: str,
    notes: Diagnostics,
    shader: Sdf.Path,
    strength: tuple[float, ...] | None,
) -> TextureNode | None:
    """The result of nodes on pictures and constants; where one of them is not known, the first picture behind them."""
    try:
        value = graph.value(output)
    except UnknownNodeError as unknown:
        return _passed_through(output, name, graph.time, notes, shader, str(unknown), strength)
    if value.means:
        notes.warn(shader, f"{name} is fed by {', '.join(sorted(value.means))}, which is drawn as its mean")
    if value.elsewhere:
        notes.warn(shader, f"{name} is fed by pictures with different coordinates; all but the first are their mean")
    pixels = value.pixels
    if value.picture is None or pixels.shape[:2] == (1, 1):
        mean = [float(c) for c in pixels.mean(axis=(0, 1))]
        four = mean[:4] if len(mean) == 4 else [*(mean * 3 if len(mean) == 1 else [*mean, 0.0, 0.0])[:3], 1.0]
        return TextureNode(str(shader), "", "", "rgb", "raw", "repeat", _ONES, _ZEROS, tuple(four), None)
    key = f"{output.GetPath()} of {output.GetPrim().GetStage().GetRootLayer().identifier}"
    colors = np.repeat(pixels, 3, axis=2) if pixels.shape[2] == 1 else pixels
    graph.images.keep(key, np.ascontiguousarray(colors))
    node = replace(
        value.picture, file=key, authored=key, channel="rgb", color_space="raw", scale=_ONES, bias=_ZEROS, tiles=()
    )
    return _decoded(node, strength)


def _passed_through(
    output: Usd.Attribute,
    name: str,
    time: Usd.TimeCode,
    notes: Diagnostics,
    shader: Sdf.Path,
    passed: str,
    strength: tuple[float, ...] | None,
) -> TextureNode | None:
    """The first picture behind nodes that are not known, which are left out."""
    for _ in range(_STEPS):
        picture = _picture(output, shader_id(output.GetPrim()), time, notes)
        if picture is not None:
            notes.warn(shader, f"{name} is fed through {passed}, which is left out")
            return _decoded(picture, strength)
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
    path, (authored, file) = str(shader.GetPath()), file_of(shader, "file", time)
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
        return _ADDRESS[notes.token(path, name, word_of(shader, name, time, "periodic"), _ADDRESS, "periodic")]

    node = TextureNode(
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
        return _decoded(node, (1.0,))
    return replace(node, scale=_factor(shader, time)) if kind.startswith("ND_gltf") else node


def _factor(shader: UsdShade.Shader, time: Usd.TimeCode) -> tuple[float, ...]:
    """(4,) factors on one of glTF's images."""
    times = np.ones(4)
    for name in ("factor", "color", "geomcolor"):
        numbers = np.array(numbers_in(value_of(shader, name, time)) or (1.0,))[:4]
        times[: len(numbers)] *= numbers
        if len(numbers) == 1:
            times[1:3] *= numbers
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
            -number_of(shader, "rotate", time, 0.0),
            (-shift[0], shift[1]),
            offset_first=flag_of(shader, "operationorder", time),
        )
    if kind.startswith("ND_tiledimage"):
        tiling, offset = _pair(shader, "uvtiling", time, 1.0), _pair(shader, "uvoffset", time, 0.0)
        matrix = _affine(tiling, shift=(-offset[0], -offset[1]))
    output, primvar = producer(shader, "texcoord"), "st"
    for _ in range(_STEPS):
        if output is None:
            break
        node, kind = UsdShade.Shader(output.GetPrim()), shader_id(output.GetPrim())
        if kind.startswith("ND_geompropvalue"):
            primvar = word_of(node, "geomprop", time, "st")
            break
        if kind.startswith(("UsdPrimvarReader", "ND_UsdPrimvarReader")):
            primvar = word_of(node, "varname", time, "st")
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
    matrix = np.eye(3)
    matrix[:2, :2], matrix[:2, 2] = turn @ np.diag(scale), shift
    return matrix


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
            number_of(node, "rotate", time, 0.0),
            _pair(node, "offset", time, 0.0),
            offset_first=flag_of(node, "operationorder", time),
        ), "texcoord"
    if kind.startswith("ND_rotate2d"):
        return _affine((1.0, 1.0), degrees=number_of(node, "amount", time, 0.0)), "in"
    category = kind.removeprefix("ND_").split("_")[0]
    if category in ("add", "subtract", "multiply", "divide") and kind.split("_")[-1].startswith("vector2"):
        first = "in1" if producer(node, "in1") is not None else "in2"
        if first == "in2" and category in ("subtract", "divide"):
            return None, ""
        second = "in2" if first == "in1" else "in1"
        if producer(node, second) is not None:
            return None, ""
        x, y = _pair(node, second, time, 1.0 if category in ("multiply", "divide") else 0.0)
        if category == "multiply":
            return _affine((x, y)), first
        if category == "divide":
            return (_affine((1.0 / x, 1.0 / y)) if x and y else None), first
        sign = 1.0 if category == "add" else -1.0
        return _affine((1.0, 1.0), shift=(sign * x, sign * y)), first
    return None, ""


# -- OmniPBR -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _OmniPicture:
    """A picture of an OmniPBR shader: what of it counts, and how its values become the input's."""

    authored: str
    file: str
    channel: str = "rgb"
    space: str = "auto"
    scale: tuple[float, ...] = _ONES
    bias: tuple[float, ...] = _ZEROS


def omni_texture(
    shader: UsdShade.Shader, name: str, time: Usd.TimeCode, notes: Diagnostics, images: ImageReader
) -> TextureNode | None:
    """The picture that an OmniPBR shader names for one of a preview surface's inputs, or None."""
    picture = _omni_picture(shader, name, time)
    if picture is None or not picture.authored:
        return None
    if not picture.file:
        notes.warn(shader.GetPath(), f"texture {picture.authored} is not found; the constant is used")
        return None
    if number_of(shader, "texture_rotate", time, 0.0):
        notes.warn(shader.GetPath(), "texture_rotate is not drawn")
    stretch = numbers_of(shader, "texture_scale", time, (1.0, 1.0))
    shift = numbers_of(shader, "texture_translate", time, (0.0, 0.0))
    node = TextureNode(
        path=str(shader.GetPath()),
        file=picture.file,
        authored=picture.authored,
        channel=picture.channel,
        color_space=picture.space,
        wrap="repeat",
        scale=picture.scale,
        bias=picture.bias,
        fallback=(0.0, 0.0, 0.0, 1.0),
        uv=UvSource("st", ((stretch[0], 0.0, shift[0]), (0.0, stretch[1], shift[1]))),
    )
    grey = number_of(shader, "albedo_desaturation", time, 0.0) if name == "diffuseColor" else 0.0
    if not grey:
        return node
    return _desaturated(node, grey, numbers_of(shader, "diffuse_tint", time, (1.0, 1.0, 1.0)), images)


def _omni_picture(shader: UsdShade.Shader, name: str, time: Usd.TimeCode) -> _OmniPicture | None:
    """The picture for one input, or None; its file is '' where it was not found."""

    def number(word: str, default: float) -> float:
        return number_of(shader, word, time, default)

    if name == "diffuseColor":
        tint = numbers_of(shader, "diffuse_tint", time, (1.0, 1.0, 1.0))
        times, more = number("albedo_brightness", 1.0), number("albedo_add", 0.0)
        scale, bias = (*(times * c for c in tint), 1.0), (*(more * c for c in tint), 0.0)
        return _OmniPicture(*file_of(shader, "diffuse_texture", time), scale=scale, bias=bias)
    if name in ("roughness", "metallic"):
        return _omni_share(shader, name, time)
    if name == "opacity" and number("enable_opacity", 0.0) and number("enable_opacity_texture", 0.0):
        return _OmniPicture(*file_of(shader, "opacity_texture", time), "r", "raw")
    if name == "emissiveColor":
        light = numbers_of(shader, "emissive_color", time, (1.0, 0.1, 0.1))
        scale = (*(number("emissive_intensity", 40.0) * c for c in light), 1.0)
        return _OmniPicture(*file_of(shader, "emissive_mask_texture", time), scale=scale)
    if name == "normal":
        slope = number("bump_factor", 1.0)
        scale, bias = (2.0 * slope, 2.0 * slope, 2.0, 1.0), (-slope, -slope, -1.0, 0.0)
        return _OmniPicture(*file_of(shader, "normalmap_texture", time), space="raw", scale=scale, bias=bias)
    return None


def _omni_share(shader: UsdShade.Shader, name: str, time: Usd.TimeCode) -> _OmniPicture | None:
    """The picture of roughness or metalness, mixed with its constant; None where the constant alone counts."""
    word, texture, default, orm_channel = {
        "roughness": ("reflection_roughness", "reflectionroughness_texture", 0.5, "g"),
        "metallic": ("metallic", "metallic_texture", 0.0, "b"),
    }[name]
    orm = ("", "")
    if number_of(shader, "enable_ORM_texture", time, 0.0):
        orm = file_of(shader, "ORM_texture", time)
    weight = number_of(shader, f"{word}_texture_influence", time, 1.0 if orm[0] else 0.0)
    if weight <= 0.0:
        return None
    files, channel = (orm, orm_channel) if orm[0] else (file_of(shader, texture, time), "r")
    rest = (1.0 - weight) * number_of(shader, f"{word}_constant", time, default)
    return _OmniPicture(*files, channel, "raw", (weight,) * 4, (rest,) * 4)


def _desaturated(node: TextureNode, share: float, tint: tuple[float, ...], images: ImageReader) -> TextureNode:
    """A picture of which a share is grey of the same luminance, before its tint."""
    pixels = as_measured(replace(node, scale=_ONES, bias=_ZEROS), images, MOST_PIXELS)[..., :3]
    ratio = [node.scale[k] / tint[k] if tint[k] else 0.0 for k in range(3)]
    more = [node.bias[k] / tint[k] if tint[k] else 0.0 for k in range(3)]
    bright = pixels * np.array(ratio, dtype=np.float32) + np.array(more, dtype=np.float32)
    grey = (bright @ LUMINANCE.astype(np.float32))[..., None]
    tinted = (bright + np.float32(share) * (grey - bright)) * np.array(tint, dtype=np.float32)
    key = f"{node.file} for {node.path}"
    images.keep(key, np.ascontiguousarray(tinted, dtype=np.float32))
    return replace(node, file=key, color_space="raw", scale=_ONES, bias=_ZEROS)
