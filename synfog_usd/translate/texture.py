"""Textures: image files as arrays that measure what the material asks for.

Takes the UsdUVTexture nodes of a material; gives constants or (H, W, C) arrays.
Each file is read once.
"""

from __future__ import annotations

import os
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import OpenImageIO
from pxr import Ar, Gf, Usd, UsdShade

from synfog_usd.translate.notes import Notebook

MAX_PIXELS = 1 << 27
"""Pixels of one texture; 8k x 16k."""

_CODES = np.arange(256) / 255.0
SRGB_TO_LINEAR = np.where(_CODES <= 0.04045, _CODES / 12.92, ((_CODES + 0.055) / 1.055) ** 2.4).astype(np.float32)
"""Linear value of each 8-bit sRGB code, IEC 61966-2-1."""

_CHANNEL = {"r": 0, "g": 1, "b": 2, "a": 3}
_WRAP = {"repeat": "repeat", "mirror": "mirror", "clamp": "clamp", "black": "clamp", "useMetadata": "repeat"}

Pixels = npt.NDArray[Any]


@dataclass(frozen=True)
class UvSource:
    """Where a texture's coordinates come from: a primvar under an affine map.

    Attributes:
        primvar: name without 'primvars:'.
        matrix: ((a, b, c), (d, e, f)): u' = a u + b v + c, v' = d u + e v + f.
    """

    primvar: str
    matrix: tuple[tuple[float, float, float], tuple[float, float, float]] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))


@dataclass(frozen=True)
class TextureNode:
    """A UsdUVTexture as authored; `file` is '' where it cannot be found."""

    path: str
    file: str
    authored: str
    channel: str
    color_space: str
    wrap: str
    scale: tuple[float, ...]
    bias: tuple[float, ...]
    fallback: tuple[float, ...]
    uv: UvSource | None


class ImageReader:
    """Image files by resolved path, also inside .usdz; each read once."""

    def __init__(self, notes: Notebook) -> None:
        self.notes = notes
        self._images: dict[str, Pixels | None] = {}
        self.sampled: dict[tuple[Any, ...], Pixels | tuple[float, ...]] = {}

    def read(self, file: str, path: str) -> Pixels | None:
        """(H, W, C) uint8 or float32, row 0 at the top, alpha not multiplied in; None where it cannot be read."""
        if file not in self._images:
            self._images[file] = self._read(file, path)
        return self._images[file]

    def _read(self, file: str, path: str) -> Pixels | None:
        if not Ar.IsPackageRelativePath(file):
            return self._decode(file, file, path)
        asset = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(file))
        if asset is None:
            self.notes.warn(path, f"texture {file} cannot be read")
            return None
        handle, name = tempfile.mkstemp(suffix=Path(Ar.SplitPackageRelativePathInner(file)[1]).suffix)
        try:
            with os.fdopen(handle, "wb") as out:
                out.write(bytes(asset.GetBuffer()))
            return self._decode(name, file, path)
        finally:
            Path(name).unlink(missing_ok=True)

    def _decode(self, name: str, shown: str, path: str) -> Pixels | None:
        hints = OpenImageIO.ImageSpec()
        hints.attribute("oiio:UnassociatedAlpha", 1)
        image = OpenImageIO.ImageInput.open(name, hints)
        if image is None:
            self.notes.warn(path, f"texture {shown} cannot be read ({OpenImageIO.geterror().strip() or 'unknown format'})")
            return None
        spec = image.spec()
        if spec.width * spec.height > MAX_PIXELS or spec.depth > 1:
            image.close()
            self.notes.warn(path, f"texture {shown} of {spec.width} x {spec.height} pixels is too large; at most {MAX_PIXELS} are read")
            return None
        eight_bit = spec.format == OpenImageIO.TypeUInt8
        pixels = image.read_image(0, 0, 0, min(spec.nchannels, 4), "uint8" if eight_bit else "float")
        problem = image.geterror()
        image.close()
        if pixels is None:
            self.notes.warn(path, f"texture {shown} cannot be read ({problem.strip()})")
            return None
        array = np.asarray(pixels)
        if not eight_bit and not np.isfinite(array).all():
            self.notes.warn(path, f"texture {shown} holds values that are no finite numbers; they are 0")
            array = np.nan_to_num(array, nan=0.0, posinf=0.0, neginf=0.0)
        return array


def is_srgb(node: TextureNode, pixels: Pixels) -> bool:
    """Whether a file's codes are sRGB: as said, else for 8-bit images of 3 or 4 channels.

    Source: UsdPreviewSurface specification, UsdUVTexture, sourceColorSpace.
    """
    if node.color_space in ("sRGB", "srgb_texture", "sRGB - Texture", "srgb_rec709_scene"):
        return True
    return node.color_space == "auto" and pixels.dtype == np.uint8 and pixels.shape[2] >= 3


def linear(pixels: Pixels, *, srgb: bool) -> npt.NDArray[np.float32]:
    """Values as float32; colour channels decoded from sRGB, alpha never."""
    if pixels.dtype == np.uint8:
        if not srgb:
            return pixels.astype(np.float32) / np.float32(255.0)
        result = SRGB_TO_LINEAR[pixels]
        if pixels.shape[2] == 4:
            result[..., 3] = pixels[..., 3] / np.float32(255.0)
        return result
    if not srgb:
        return pixels.astype(np.float32)
    color = np.where(pixels <= 0.04045, pixels / 12.92, ((np.maximum(pixels, 0.0) + 0.055) / 1.055) ** 2.4).astype(np.float32)
    if pixels.shape[2] == 4:
        color[..., 3] = pixels[..., 3]
    return color


def texture_node(output: Usd.Attribute, time: Usd.TimeCode, notes: Notebook) -> TextureNode:
    """What a UsdUVTexture says, from the output that a material is connected to."""
    shader = UsdShade.Shader(output.GetPrim())
    path = str(shader.GetPath())
    asset = value_of(shader, "file", time)
    scale, bias, fallback = (tuple(value_of(shader, name, time, default)) for name, default in _TUPLES)
    wraps = [str(value_of(shader, name, time, "useMetadata")) for name in ("wrapS", "wrapT")]
    if wraps[0] != wraps[1] and _WRAP.get(wraps[0]) != _WRAP.get(wraps[1]):
        notes.warn(path, f"wrapS {wraps[0]!r} and wrapT {wraps[1]!r} differ; {wraps[0]!r} is used for both")
    if "black" in wraps:
        notes.info(path, "wrap mode 'black' is drawn as 'clamp'")
    authored = getattr(asset, "path", "") or ""
    file = getattr(asset, "resolvedPath", "") or ""
    if "<UDIM>" in authored:
        notes.warn(path, f"tiled texture {authored} is not read; its fallback is used")
        file = ""
    elif not file:
        notes.warn(path, f"texture {authored or '(no file)'} is not found; its fallback {fallback[:3]} is used")
    return TextureNode(
        path=path,
        file=file,
        authored=authored,
        channel=output.GetBaseName(),
        color_space=str(value_of(shader, "sourceColorSpace", time, "auto")),
        wrap=_WRAP.get(wraps[0], "repeat"),
        scale=scale,
        bias=bias,
        fallback=fallback,
        uv=_uv_source(shader, time, notes),
    )


_TUPLES = (("scale", Gf.Vec4f(1, 1, 1, 1)), ("bias", Gf.Vec4f(0, 0, 0, 0)), ("fallback", Gf.Vec4f(0, 0, 0, 1)))


def value_of(shader: UsdShade.Shader, name: str, time: Usd.TimeCode, default: Any = None) -> Any:
    """Constant value of an input through its connections, or `default`."""
    source = shader.GetInput(name)
    if not source:
        return default
    for attribute in UsdShade.Utils.GetValueProducingAttributes(source):
        if UsdShade.Utils.GetType(attribute.GetName()) == UsdShade.AttributeType.Input:
            value = attribute.Get(time)
            if value is None:
                value = attribute.Get(Usd.TimeCode.EarliestTime())
            if value is not None:
                return value
    return default


def producer(shader: UsdShade.Shader, name: str) -> Usd.Attribute | None:
    """The shader output that feeds an input, or None where it is a constant."""
    source = shader.GetInput(name)
    if not source:
        return None
    for attribute in UsdShade.Utils.GetValueProducingAttributes(source):
        if UsdShade.Utils.GetType(attribute.GetName()) == UsdShade.AttributeType.Output:
            return attribute
    return None


def shader_id(prim: Usd.Prim) -> str:
    """The node type of a shader prim, or ''."""
    attribute = prim.GetAttribute("info:id")
    return str(attribute.Get() or "") if attribute else ""


def _uv_source(shader: UsdShade.Shader, time: Usd.TimeCode, notes: Notebook) -> UvSource | None:
    """The primvar behind 'st' and the transforms between, or None where 'st' is not connected."""
    matrix = np.eye(3)
    output = producer(shader, "st")
    for _ in range(8):
        if output is None:
            return None
        node = UsdShade.Shader(output.GetPrim())
        kind = shader_id(output.GetPrim())
        if kind == "UsdTransform2d":
            angle = np.radians(float(value_of(node, "rotation", time, 0.0)))
            scale, shift = value_of(node, "scale", time, (1.0, 1.0)), value_of(node, "translation", time, (0.0, 0.0))
            turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
            step = turn @ np.diag([float(scale[0]), float(scale[1]), 1.0])
            step[:2, 2] = float(shift[0]), float(shift[1])
            matrix = matrix @ step
            output = producer(node, "in")
        elif kind.startswith("UsdPrimvarReader"):
            rows = tuple(tuple(float(x) for x in row) for row in matrix[:2])
            return UvSource(str(value_of(node, "varname", time, "st")), rows)
        else:
            notes.warn(node.GetPath(), f"texture coordinates from {kind or 'an unknown node'} are not known; primvar 'st' is used")
            return UvSource("st")
    return UvSource("st")


def sampled(node: TextureNode, images: ImageReader, *, channels: int) -> Pixels | tuple[float, ...]:
    """What a texture node gives: an (H, W, channels) array, or a constant tuple.

    Args:
        channels: 3 for a colour, 1 for a number.

    Returns:
        uint8 for sRGB colours as they stand in the file; else float32, linear,
        with scale and bias; a tuple where the file is missing, of one value
        throughout, or without texture coordinates (the texel at (0, 0), by the
        specification).
    """
    key = (node.file, node.channel, node.color_space, node.scale, node.bias, node.fallback, node.uv is None, channels)
    if key not in images.sampled:
        images.sampled[key] = _sampled(node, images, channels)
    return images.sampled[key]


def _sampled(node: TextureNode, images: ImageReader, channels: int) -> Pixels | tuple[float, ...]:
    pixels = images.read(node.file, node.path) if node.file else None
    if pixels is None:
        return _fallback(node, channels)
    if node.uv is None:
        pixels = pixels[-1:, :1]
    elif pixels.size > 4 and (pixels == pixels[:1, :1]).all():
        pixels = pixels[:1, :1]
    srgb = is_srgb(node, pixels)
    plain = all(s == 1.0 for s in node.scale) and not any(node.bias)
    if srgb and plain and channels == 3 and node.channel == "rgb" and pixels.dtype == np.uint8 and pixels.shape[:2] != (1, 1):
        return np.ascontiguousarray(pixels[..., :3])
    picked = _picked(_four(linear(pixels, srgb=srgb)) * np.float32(node.scale) + np.float32(node.bias), node, channels)
    return tuple(float(x) for x in picked.reshape(-1)) if picked.shape[:2] == (1, 1) else picked


def _fallback(node: TextureNode, channels: int) -> tuple[float, ...]:
    picked = _picked(np.array(node.fallback, dtype=np.float32).reshape(1, 1, 4), node, channels)
    return tuple(float(x) for x in picked.reshape(-1))


def _four(pixels: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """RGBA: grey is spread, a missing alpha is 1."""
    height, width, count = pixels.shape
    result = np.ones((height, width, 4), dtype=np.float32)
    if count <= 2:
        result[..., :3] = pixels[..., :1]
        if count == 2:
            result[..., 3] = pixels[..., 1]
    else:
        result[..., :count] = pixels
    return result


def _picked(pixels: npt.NDArray[np.float32], node: TextureNode, channels: int) -> npt.NDArray[np.float32]:
    channel = _CHANNEL.get(node.channel)
    if channels == 3:
        return np.ascontiguousarray(pixels[..., :3] if channel is None else np.repeat(pixels[..., channel : channel + 1], 3, axis=2))
    return np.ascontiguousarray(pixels[..., channel or 0][..., None])
