"""Textures: image files as arrays that measure what the material asks for.

Takes the UsdUVTexture nodes of a material; gives constants or (H, W, C) arrays.
Each file is read once.
"""

from __future__ import annotations

import os
import tempfile
import weakref
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar

import numpy as np
import numpy.typing as npt
import OpenImageIO
from pxr import Ar, Usd, UsdShade

from synfog_usd.base import system
from synfog_usd.base.arrays import Array, Pixels
from synfog_usd.base.colour import SRGB_TO_LINEAR, srgb_decode, srgb_encode
from synfog_usd.base.errors import StageError
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.shader import file_of, number_of, numbers_of, producer, shader_id, word_of
from synfog_usd.translate.wrap import MODES, Wrapped, wrapped

P = ParamSpec("P")
R = TypeVar("R")
MAX_PIXELS = 1 << 26
"""Pixels of one texture, 8192 x 8192, by its header."""

MAX_BYTES = 1 << 33
"""Size of all textures of a stage as they are decoded [byte]."""

PICTURES = frozenset(
    {
        *(".png", ".jpg", ".jpeg", ".jpe", ".exr", ".hdr", ".pic", ".tif", ".tiff", ".tx", ".tga", ".bmp", ".webp"),
        *(".psd", ".gif", ".jp2", ".j2k", ".jxl", ".dds", ".sgi", ".rgb", ".rgba", ".pnm", ".ppm", ".pgm", ".heic"),
        ".avif",
    }
)
"""Endings of files that are opened as pictures; a library that tries whatever it knows on any file opens videos and raw
photographs too.
"""

_CHANNEL = {"r": 0, "g": 1, "b": 2, "a": 3}
_WRAPS = {"periodic": "repeat", "constant": "black"}
"""MaterialX's words for wrap modes."""

_MODES = ("useMetadata", *MODES)
_OUTPUTS = ("rgb", *_CHANNEL, "rgba", "out")
_SPACES = ("auto", "raw", "sRGB")
_SRGB = ("sRGB", "srgb_texture", "sRGB - Texture", "srgb_rec709_scene")
RAW = dict.fromkeys(("", "Raw", "none", "linear", "lin_rec709", "lin_rec709_scene", "Utility - Raw"), "raw")
"""Words of other tools for values that are read as they are."""

_IN_FILES = {"periodic": "repeat", "mirror": "mirror", "clamp": "clamp", "black": "black"}
"""OpenImageIO's words for wrap modes in a file."""


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
    """A UsdUVTexture as authored; `file` is '' where it cannot be found.

    `tiles` are the (number, file) of a tiled texture, from 1001 on; `file` is then
    its name with <UDIM> in it, and `uv` goes to the picture that `ImageReader.of`
    puts together.  `wrap` holds along u, and along v where `wrap_v` is ''; 'useMetadata'
    is what the file says.  `outside` is what 'black' shows before a channel is picked;
    None for `bias`, which is what black texels are.
    """

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
    tiles: tuple[tuple[int, str], ...] = ()
    wrap_v: str = ""
    outside: tuple[float, ...] | None = None


class ImageReader:
    """Image files by resolved path, also inside .usdz; each read once.

    Args:
        notes: for what cannot be read.
        before: of an earlier translation of the same stage, whose pictures are used again.
    """

    def __init__(self, notes: Diagnostics, before: ImageReader | None = None) -> None:
        self.notes = notes
        self._images: dict[str, Pixels | None] = {}
        self._bytes = 0
        self.sampled: dict[tuple[Any, ...], Pixels | tuple[float, ...]] = {}
        self._modes: dict[str, tuple[str, str]] = {}
        self._wrapped: dict[tuple[Any, ...], tuple[Pixels, Wrapped]] = {}
        self._answers: dict[tuple[Any, ...], tuple[weakref.ref[Pixels], Any]] = {}
        self._for_once: set[str] = set()  # pictures with a note, and those that no file holds
        if before is not None:
            lasting = (key for key, value in before.sampled.items() if isinstance(value, np.ndarray))
            self.sampled = {key: before.sampled[key] for key in lasting if key[0] not in before._for_once}
            self._modes, self._wrapped = dict(before._modes), dict(before._wrapped)
            self._answers = dict(before._answers)

    def read(self, file: str, path: str) -> Pixels | None:
        """(H, W, C) uint8 or float32, row 0 at the top, alpha not multiplied in; None where it cannot be read."""
        return self._remembered(file, lambda: self._read(file, path))

    def of(self, node: TextureNode) -> Pixels | None:
        """The picture of a texture node, its tiles side by side; None where there is none."""
        if not node.tiles:
            return self.read(node.file, node.path) if node.file else None
        return self._remembered(node.file, lambda: self._joined(node))

    def _remembered(self, name: str, make: Callable[[], Pixels | None]) -> Pixels | None:
        if name not in self._images:
            before = self.notes.count
            self._images[name] = make()
            if self.notes.count != before:
                self._for_once.add(name)
        return self._images[name]

    def let_go(self) -> None:
        """Let the files' own pixels go, of which `sampled` has what is drawn."""
        self._images.clear()

    def once(self, compute: Callable[Concatenate[Pixels, P], R], pixels: Pixels, *more: P.args, **named: P.kwargs) -> R:
        """compute(pixels, *more), once for an array as long as it lives: every instance of a model needs it again."""
        key = (compute, id(pixels), *more)
        if key not in self._answers or self._answers[key][0]() is not pixels:
            self._answers[key] = weakref.ref(pixels), compute(pixels, *more, **named)
        answer: R = self._answers[key][1]
        return answer

    def keep(self, name: str, pixels: Pixels) -> None:
        """Let a picture that no file holds be read by a name of its own."""
        self._images[name] = pixels
        self._for_once.add(name)

    def wraps(self, node: TextureNode) -> tuple[str, str]:
        """Modes along u and v, with those of the file where the node leaves it to it; black where nobody says."""
        in_file = self._modes.get(node.file, ("black", "black"))
        authored = (node.wrap, node.wrap_v or node.wrap)
        along_u, along_v = (wrap if wrap in MODES else mode for wrap, mode in zip(authored, in_file, strict=True))
        return along_u, along_v

    def wrapped(self, pixels: Pixels, node: TextureNode) -> Wrapped:
        """What `sampled` gave for a node as a picture of one wrap mode; the same array for the same question."""
        wraps = self.wraps(node)
        if wraps[0] == wraps[1] != "black":
            return Wrapped(pixels, wraps[0])
        black = np.array(node.bias if node.outside is None else node.outside, dtype=np.float32)
        outside: Pixels = np.maximum(_picked(black.reshape(1, 1, 4), node, pixels.shape[2]).reshape(-1), 0.0)
        if pixels.dtype == np.uint8:
            outside = np.rint(255.0 * srgb_encode(outside)).astype(np.uint8)
        key = (id(pixels), wraps, tuple(outside.tolist()))
        if key not in self._wrapped:
            self._wrapped[key] = pixels, wrapped(pixels, wraps, outside)  # kept, so that no other array gets its id
        return self._wrapped[key][1]

    def _joined(self, node: TextureNode) -> Pixels | None:
        """Tiles in one picture, each scaled to the largest; what no tile covers is black."""
        first_column, first_row, columns, rows = tile_range(node.tiles)
        read = [(number, self.read(file, node.path)) for number, file in node.tiles]
        tiles = [(number, pixels) for number, pixels in read if pixels is not None]
        if not tiles:
            return None
        tall, wide = max(pixels.shape[0] for _, pixels in tiles), max(pixels.shape[1] for _, pixels in tiles)
        height, width = tall, wide
        while height * width * columns * rows > MAX_PIXELS:
            height, width = max(height // 2, 1), max(width // 2, 1)
        if height < tall:
            self.notes.warn(
                node.path,
                f"{columns} x {rows} tiles are drawn with {width} x {height} pixels each: together at most "
                f"{MAX_PIXELS} are",
            )
        channels = max(pixels.shape[2] for _, pixels in tiles)
        eight_bit = all(pixels.dtype == np.uint8 for _, pixels in tiles)
        result: Pixels = np.zeros(
            (height * rows, width * columns, channels), dtype=np.uint8 if eight_bit else np.float32
        )
        for number, tile in tiles:
            values: Pixels = (
                tile if eight_bit or tile.dtype != np.uint8 else tile.astype(np.float32) / np.float32(255.0)
            )
            values = np.concatenate([values, *[values[..., -1:]] * (channels - values.shape[2])], axis=2)
            values = _scaled(values, height, width)
            column, row = (number - 1001) % 10 - first_column, rows - 1 - ((number - 1001) // 10 - first_row)
            result[row * height : (row + 1) * height, column * width : (column + 1) * width] = values
        return result

    def _read(self, file: str, path: str) -> Pixels | None:
        inner = Ar.SplitPackageRelativePathInner(file)[1] if Ar.IsPackageRelativePath(file) else file
        if Path(inner).suffix.lower() not in PICTURES:
            self.notes.warn(
                path, f"texture {file} is no picture by its name, and is not opened; convert it to PNG or EXR"
            )
            return None
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
            self.notes.warn(
                path, f"texture {shown} cannot be read ({OpenImageIO.geterror().strip() or 'unknown format'})"
            )
            return None
        spec = image.spec()
        if spec.width * spec.height > MAX_PIXELS or spec.depth > 1:
            image.close()
            self.notes.warn(
                path,
                f"texture {shown} of {spec.width} x {spec.height} pixels is too large; at most {MAX_PIXELS} are read",
            )
            return None
        eight_bit = spec.format == OpenImageIO.TypeUInt8
        size = spec.width * spec.height * min(spec.nchannels, 4) * (1 if eight_bit else 4)
        self._bytes += size
        system.allow(4 * size)  # it is decoded, and may be converted
        if self._bytes > MAX_BYTES:
            image.close()
            raise StageError(
                f"{path}: with texture {shown} all textures take {self._bytes >> 20} MiB decoded; at most "
                f"{MAX_BYTES >> 20} are read: shrink some"
            )
        modes = [_IN_FILES.get(word.strip(), "black") for word in str(spec.getattribute("wrapmodes") or "").split(",")]
        if modes != ["black"]:
            self._modes[shown] = (modes[0], modes[-1])
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


def _scaled(pixels: Pixels, height: int, width: int) -> Pixels:
    """A picture in another size: means of blocks where those are whole, which is quick for a hundred large tiles."""
    tall, wide, channels = pixels.shape
    if (tall, wide) == (height, width):
        return pixels
    if tall % height == 0 and wide % width == 0:
        blocks = pixels.reshape(height, tall // height, width, wide // width, channels)
        mean = blocks.mean(axis=(1, 3), dtype=np.float32)
        return np.asarray(np.rint(mean).astype(np.uint8) if pixels.dtype == np.uint8 else mean)
    region = OpenImageIO.ROI(0, width, 0, height, 0, 1, 0, channels)
    scaled = OpenImageIO.ImageBufAlgo.resize(OpenImageIO.ImageBuf(np.ascontiguousarray(pixels)), roi=region)
    return np.asarray(scaled.get_pixels("uint8" if pixels.dtype == np.uint8 else "float"))


def tile_range(tiles: tuple[tuple[int, str], ...]) -> tuple[int, int, int, int]:
    """(first column, first row, columns, rows) that tiles cover; 1001 is column 0 of row 0, ten to a row."""
    places = [divmod(number - 1001, 10) for number, _ in tiles]
    rows, columns = [row for row, _ in places], [column for _, column in places]
    return min(columns), min(rows), max(columns) - min(columns) + 1, max(rows) - min(rows) + 1


def is_srgb(color_space: str, pixels: Pixels) -> bool:
    """Whether a file's codes are sRGB: as authored, else for 8-bit images of 3 or 4 channels.

    Source: UsdPreviewSurface specification, UsdUVTexture, sourceColorSpace.
    """
    if color_space in _SRGB:
        return True
    return color_space == "auto" and pixels.dtype == np.uint8 and pixels.shape[2] >= 3


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
    color = srgb_decode(pixels).astype(np.float32)
    if pixels.shape[2] == 4:
        color[..., 3] = pixels[..., 3]
    return color


def texture_node(output: Usd.Attribute, time: Usd.TimeCode, notes: Diagnostics) -> TextureNode:
    """What a UsdUVTexture says, from the output that a material is connected to."""
    shader = UsdShade.Shader(output.GetPrim())
    path = str(shader.GetPath())
    authored, file = file_of(shader, "file", time)
    scale, bias, fallback = (numbers_of(shader, name, time, default) for name, default in _TUPLES)
    wraps = []
    for name in ("wrapS", "wrapT"):
        mode = word_of(shader, name, time, "useMetadata")
        wraps.append(notes.token(path, name, _WRAPS.get(mode, mode), _MODES, _MODES[0]))
    space = word_of(shader, "sourceColorSpace", time, "auto")
    if space not in _SRGB:
        space = notes.token(path, "sourceColorSpace", RAW.get(space, space), _SPACES, "raw")
    uv = _uv_source(shader, time, notes)
    tiles, file, uv = tiled(shader, authored, file, uv)
    if tiles and uv is not None:
        wraps = ["clamp", "clamp"]
    if not file:
        numbers = ", ".join(f"{c:.4g}" for c in fallback)
        notes.warn(path, f"texture {authored or '(no file)'} is not found; its fallback ({numbers}) is used")
    return TextureNode(
        path=path,
        file=file,
        authored=authored,
        channel=notes.token(path, "its output", output.GetBaseName(), _OUTPUTS, "rgb"),
        color_space=space,
        wrap=wraps[0],
        scale=scale,
        bias=bias,
        fallback=fallback,
        uv=uv,
        tiles=tiles,
        wrap_v=wraps[1],
    )


def tiled(
    shader: UsdShade.Shader, authored: str, file: str, uv: UvSource | None
) -> tuple[tuple[tuple[int, str], ...], str, UvSource | None]:
    """Tiles of a texture with <UDIM> in its name, the name that stands for them together, and its coordinates on them
    all; for any other texture (), and file and coordinates as they are.
    """
    if "<UDIM>" not in authored:
        return (), file, uv
    tiles = _tiles(shader, authored, file)
    if not tiles or uv is None:
        return tiles, (file or authored) if tiles else "", uv
    column, row, columns, rows = tile_range(tiles)
    onto = np.array([[1.0 / columns, 0.0, -column / columns], [0.0, 1.0 / rows, -row / rows]]) @ np.vstack(
        [np.array(uv.matrix), [0.0, 0.0, 1.0]]
    )
    (a, b, c), (d, e, f) = onto.tolist()
    return tiles, file or authored, UvSource(uv.primvar, ((a, b, c), (d, e, f)))


def _tiles(shader: UsdShade.Shader, authored: str, file: str) -> tuple[tuple[int, str], ...]:
    """The tiles of a texture with <UDIM> in its name, by number."""
    for attribute in UsdShade.Utils.GetValueProducingAttributes(shader.GetInput("file")):
        for spec in attribute.GetPropertyStack(Usd.TimeCode.Default()):
            resolve = UsdShade.UdimUtils.ResolveUdimTilePaths
            paths = resolve(authored, spec.layer) or resolve(file, spec.layer)
            numbered = [
                (int(tile), str(path)) for path, tile in paths if str(tile).isdigit() and 1001 <= int(tile) <= 1100
            ]
            if numbered:
                return tuple(sorted(numbered))
    return ()


_TUPLES = (("scale", (1.0,) * 4), ("bias", (0.0,) * 4), ("fallback", (0.0, 0.0, 0.0, 1.0)))


def _uv_source(shader: UsdShade.Shader, time: Usd.TimeCode, notes: Diagnostics) -> UvSource | None:
    """The primvar behind 'st' and the transforms between, or None where 'st' is not connected."""
    matrix = np.eye(3)
    output = producer(shader, "st")
    for _ in range(8):
        if output is None:
            return None
        node = UsdShade.Shader(output.GetPrim())
        kind = shader_id(output.GetPrim()).removeprefix("ND_")  # as MaterialX names the same nodes
        if kind.startswith("UsdTransform2d"):
            angle = np.radians(number_of(node, "rotation", time, 0.0))
            scale = numbers_of(node, "scale", time, (1.0, 1.0))
            shift = numbers_of(node, "translation", time, (0.0, 0.0))
            turn = np.array(
                [[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]]
            )
            step = turn @ np.diag([*scale, 1.0])
            step[:2, 2] = shift
            matrix = matrix @ step
            output = producer(node, "in")
        elif kind.startswith("UsdPrimvarReader"):
            (a, b, c), (d, e, f) = matrix[:2].tolist()
            return UvSource(word_of(node, "varname", time, "st"), ((a, b, c), (d, e, f)))
        else:
            notes.warn(
                node.GetPath(),
                f"texture coordinates from {kind or 'an unknown node'} are not known; primvar 'st' is used",
            )
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
    pixels = images.of(node)
    if pixels is None:
        return _fallback(node, channels)
    if node.uv is None:
        pixels = pixels[-1:, :1]
    elif pixels.size > 4 and (pixels == pixels[:1, :1]).all():
        pixels = pixels[:1, :1]
    srgb = is_srgb(node.color_space, pixels)
    plain = all(s == 1.0 for s in node.scale) and not any(node.bias)
    if (
        srgb
        and plain
        and channels == 3
        and node.channel == "rgb"
        and pixels.dtype == np.uint8
        and pixels.shape[:2] != (1, 1)
    ):
        return np.ascontiguousarray(pixels[..., :3])
    picked = _measured(pixels, node, channels, srgb=srgb)
    return tuple(float(x) for x in picked.reshape(-1)) if picked.shape[:2] == (1, 1) else picked


def _measured(pixels: Pixels, node: TextureNode, channels: int, *, srgb: bool) -> npt.NDArray[np.float32]:
    """`_picked` of linear values with scale and bias, without the channels that are not picked."""
    count, channel = pixels.shape[2], _CHANNEL.get(node.channel)

    def column(c: int) -> npt.NDArray[np.float32]:
        source = c if count > 2 else c // 3  # as `_four` has it
        if source < count:
            values = linear(pixels[..., source : source + 1], srgb=srgb and not source == count - 1 == 3)
        else:
            values = np.ones((*pixels.shape[:2], 1), dtype=np.float32)
        return np.asarray(values * np.float32(node.scale[c]) + np.float32(node.bias[c]))

    if channels == 1 or channel is not None:
        return np.ascontiguousarray(np.repeat(column(channel or 0), channels, axis=2))
    return np.concatenate([column(c) for c in range(3)], axis=2)


def normals(
    node: TextureNode, images: ImageReader, scale: Array, bias: Array, *, untouched: bool
) -> npt.NDArray[np.float32] | None:
    """(H, W, 3) normals as Mitsuba takes them, halved and 0.5 added; None where there is no picture of three channels.

    The same array for the same question, as of `sampled`.

    Args:
        node: the texture.
        images: where it is read.
        scale, bias: (3,) what makes of its codes a normal.
        untouched: whether a float file holds numbers from -1 to 1.
    """
    key = (node.file, "normal", *scale.tolist(), *bias.tolist(), untouched)
    if key not in images.sampled:
        pixels = images.of(node)
        if pixels is None or pixels.shape[2] < 3:
            return None
        images.sampled[key] = _normals(pixels, scale, bias, untouched=untouched)
    return np.asarray(images.sampled[key])


def _normals(pixels: Pixels, scale: Array, bias: Array, *, untouched: bool) -> npt.NDArray[np.float32]:
    values = linear(pixels[..., :3], srgb=False)
    if untouched and pixels.dtype != np.uint8:
        values = values * np.float32(0.5) + np.float32(0.5)
    if np.allclose(scale, 2.0):
        return values
    # green turned is DirectX's handedness; two thirds of the slope, a weaker map
    turned = values * scale.astype(np.float32) + bias.astype(np.float32)
    turned /= np.maximum(np.linalg.norm(turned, axis=-1, keepdims=True), 1e-6)
    return np.asarray(turned * 0.5 + 0.5, dtype=np.float32)


def as_measured(node: TextureNode, images: ImageReader, most: int) -> npt.NDArray[np.float32]:
    """(H, W, 4) linear values of a texture with its scale and bias; those of its fallback where it has no file.

    It is halved until it has at most `most` pixels.
    """
    pixels = images.of(node)
    if pixels is None:
        return np.array(node.fallback, dtype=np.float32).reshape(1, 1, 4)
    if node.uv is None:
        pixels = pixels[-1:, :1]
    srgb = is_srgb(node.color_space, pixels)
    height, width = pixels.shape[:2]
    values = linear(pixels, srgb=srgb)
    while height * width > most:
        height, width = max(height // 2, 1), max(width // 2, 1)
    if (height, width) != values.shape[:2]:
        values = resized(values, (height, width))
    return _four(values) * np.array(node.scale, dtype=np.float32) + np.array(node.bias, dtype=np.float32)


def resized(pixels: npt.NDArray[np.float32], size: tuple[int, int]) -> npt.NDArray[np.float32]:
    """A float picture of another (height, width)."""
    source = OpenImageIO.ImageBuf(np.ascontiguousarray(pixels, dtype=np.float32))
    region = OpenImageIO.ROI(0, size[1], 0, size[0], 0, 1, 0, pixels.shape[2])
    values = OpenImageIO.ImageBufAlgo.resize(source, roi=region).get_pixels("float")
    return np.asarray(values, dtype=np.float32).reshape(*size, pixels.shape[2])


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
        return np.ascontiguousarray(
            pixels[..., :3] if channel is None else np.repeat(pixels[..., channel : channel + 1], 3, axis=2)
        )
    return np.ascontiguousarray(pixels[..., channel or 0][..., None])
