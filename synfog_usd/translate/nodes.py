"""MaterialX nodes between a picture and a material, evaluated pixel by pixel.

Takes a shader output; gives a constant or a picture.  What varies in space without a picture, such as noise and ramps,
is its mean, and is named.
Source: MaterialX specification 1.39, standard nodes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from pxr import Usd, UsdShade

from synfog_usd.base.arrays import Array, FloatArray
from synfog_usd.translate.shader import number_of, numbers_in, producer, shader_id, value_of, word_of
from synfog_usd.translate.texture import ImageReader, TextureNode, as_measured, resized

MOST_NODES = 2000
"""Nodes that one input may be fed by."""

MOST_PIXELS = 1 << 24
"""Pixels of a picture that nodes change; larger ones are halved."""

IMAGES = ("ND_image_", "ND_tiledimage_", "ND_gltf_image_", "ND_gltf_colorimage", "ND_gltf_normalmap")
"""How MaterialX's nodes begin that are pictures."""

READERS = ("UsdPrimvarReader", "ND_UsdPrimvarReader", "ND_geompropvalue", "ND_geomcolor")
"""How the shaders begin that give a primvar of the shape; the last one gives its displayColor."""

ImageOf = Callable[[Usd.Attribute, str], TextureNode | None]


class UnknownNodeError(Exception):
    """A node that cannot be evaluated, by its name."""


@dataclass
class Value:
    """Result of a node.

    Attributes:
        pixels: (H, W, C) float32; (1, 1, C) for a constant.
        picture: a texture node with the coordinates and wrap modes of the picture in it, or None.
        means: kinds of nodes that are drawn as their mean.
        elsewhere: whether pictures with other coordinates went in too.
    """

    pixels: FloatArray
    picture: TextureNode | None = None
    means: set[str] = field(default_factory=set)
    elsewhere: bool = False


def constant(*numbers: float) -> Value:
    """A value that is the same everywhere."""
    return Value(np.array(numbers, dtype=np.float32).reshape(1, 1, -1))


class Graph:
    """The nodes behind one input; each is worked out once.

    Args:
        image_of: from an output and its kind to the picture that it is, or None where it is none.
        of_shape: from the output of a reader to what a primvar gives, or None where that is no number or colour.
    """

    def __init__(
        self,
        time: Usd.TimeCode,
        images: ImageReader,
        image_of: ImageOf,
        of_shape: Callable[[Usd.Attribute], tuple[float, ...] | None],
    ) -> None:
        self.time, self.images, self.image_of, self.of_shape = time, images, image_of, of_shape
        self.values: dict[str, Value] = {}

    def value(self, output: Usd.Attribute) -> Value:
        """What a shader output gives; nodes are followed without recursion.

        Raises:
            UnknownNodeError: of a kind that is not known, too many, or in a circle.
        """
        waiting, opened = [output], set[str]()
        while waiting:
            attribute = waiting[-1]
            path = str(attribute.GetPath())
            if path in self.values:
                waiting.pop()
                continue
            shader, kind = UsdShade.Shader(attribute.GetPrim()), shader_id(attribute.GetPrim())
            sources = [producer(shader, name) for name in self.reads(shader, kind)]
            missing = [source for source in sources if source and str(source.GetPath()) not in self.values]
            if missing:
                if path in opened:
                    raise UnknownNodeError(f"{kind} in a circle")
                if len(opened) >= MOST_NODES:
                    raise UnknownNodeError(f"more than {MOST_NODES} nodes")
                opened.add(path)
                waiting += missing
                continue
            self.values[path] = self.evaluated(shader, kind, attribute)
            waiting.pop()
        return self.values[str(output.GetPath())]

    @staticmethod
    def is_image(kind: str) -> bool:
        """Whether a node is a picture, whose own inputs are no colours."""
        return kind.startswith((*IMAGES, "UsdUVTexture", "ND_UsdUVTexture"))

    def reads(self, shader: UsdShade.Shader, kind: str) -> list[str]:
        """Names of the inputs whose values a node needs."""
        category = kind.removeprefix("ND_").split("_")[0]
        for table in (_NODES, _MEANS):
            if category in table:
                return [name for name, _ in table[category][0]]
        if self.is_image(kind) or kind.startswith(READERS):
            return []
        return [source.GetBaseName() for source in shader.GetInputs()]

    def evaluated(self, shader: UsdShade.Shader, kind: str, output: Usd.Attribute) -> Value:
        """What one node gives, where all that feeds it is known."""
        if self.is_image(kind):
            return self.picture(output, kind)
        if kind.startswith(READERS):
            numbers = self.of_shape(output)
            if numbers is None:
                raise UnknownNodeError(kind)
            return constant(*numbers[: _CHANNELS.get(kind.split("_")[-1], 3)])
        category = kind.removeprefix("ND_").split("_")[0]

        def argument(name: str, *default: float) -> Value:
            feeding = producer(shader, name)
            if feeding is not None:
                return self.values[str(feeding.GetPath())]
            authored = value_of(shader, name, self.time)
            if authored is None:
                return constant(*default)
            numbers = numbers_in(authored)
            if numbers is None:
                raise UnknownNodeError(kind)
            return constant(*numbers)

        if category in _MEANS:
            inputs, mean = _MEANS[category]
            value = _combined([argument(name, *default) for name, default in inputs], mean)
            value.means |= {category}
            return value
        if category in _NODES:
            inputs, function = _NODES[category]
            return _combined([argument(name, *default) for name, default in inputs], function)
        if category in ("dot", "convert", "separate2", "separate3", "separate4", "extract", "swizzle", "constant"):
            value = argument("value" if category == "constant" else "in", 0.0)
            return replaced(value, _chosen(value.pixels, category, kind, shader, output, self.time))
        if category.startswith("combine") and category[7:] in ("2", "3", "4"):
            parts = [argument(f"in{number}", 0.0) for number in range(1, int(category[7:]) + 1)]
            return _combined(parts, lambda *arrays: np.concatenate(arrays, axis=2), together=True)
        if category in ("ifgreater", "ifgreatereq", "ifequal"):
            operands = [argument("value1", 1.0), argument("value2", 0.0), argument("in1", 0.0), argument("in2", 0.0)]
            compared = {"ifgreater": np.greater, "ifgreatereq": np.greater_equal, "ifequal": np.equal}[category]
            return _combined(operands, lambda a, b, yes, no: np.asarray(np.where(compared(a, b), yes, no)))
        if category == "switch":
            which = argument("which", 0.0)
            number = int(np.clip(which.pixels.mean(), 0.0, 9.0)) + 1
            return argument(f"in{number}", 0.0)
        raise UnknownNodeError(kind or "an unknown node")

    def picture(self, output: Usd.Attribute, kind: str) -> Value:
        """A picture as it measures, its channels those of the node's type."""
        node = self.image_of(output, kind)
        if node is None:
            raise UnknownNodeError(kind)
        pixels = as_measured(node, self.images, MOST_PIXELS)
        single = {"r": 0, "g": 1, "b": 2, "a": 3}.get(node.channel)
        if single is not None:
            pixels = pixels[..., single : single + 1]
        else:
            pixels = pixels[..., : _CHANNELS.get(kind.split("_")[-1], 3)]
        varies = node.uv is not None and pixels.shape[:2] != (1, 1)
        return Value(pixels, node if varies else None)


def replaced(value: Value, pixels: FloatArray) -> Value:
    """The same picture with other pixels."""
    return Value(pixels, value.picture, set(value.means), value.elsewhere)


def _combined(values: list[Value], function: Callable[..., Array], *, together: bool = False) -> Value:
    """A function of several values, pixel by pixel; pictures that lie otherwise than the first one are their mean.

    Args:
        together: whether all arrays have to have the same size, as when channels are put together.
    """
    first = next((value.picture for value in values if value.picture is not None), None)
    means: set[str] = set().union(*[value.means for value in values])
    elsewhere = any(value.elsewhere for value in values)
    arrays, size = [], (1, 1)
    for value in values:
        pixels = value.pixels
        if value.picture is not None and first is not None:
            if (value.picture.uv, value.picture.wrap, value.picture.wrap_v) == (first.uv, first.wrap, first.wrap_v):
                size = (max(size[0], pixels.shape[0]), max(size[1], pixels.shape[1]))
            else:
                pixels, elsewhere = pixels.mean(axis=(0, 1), keepdims=True), True
        arrays.append(pixels)
    arrays = [resized(pixels, size) if pixels.shape[:2] not in ((1, 1), size) else pixels for pixels in arrays]
    if together:
        arrays = [np.broadcast_to(pixels, (*size, pixels.shape[2])) for pixels in arrays]
    elif len({pixels.shape[2] for pixels in arrays} - {1}) > 1:
        raise UnknownNodeError("a node whose inputs have different numbers of channels")
    with np.errstate(all="ignore"):
        combined = np.nan_to_num(np.asarray(function(*arrays), dtype=np.float32), nan=0.0, posinf=1e30, neginf=-1e30)
    return Value(combined, first, means, elsewhere)


def _chosen(
    pixels: FloatArray, category: str, kind: str, shader: UsdShade.Shader, output: Usd.Attribute, time: Usd.TimeCode
) -> FloatArray:
    """Channels of a value, by the node that takes it apart or converts it."""
    count: int = pixels.shape[2]
    if category.startswith("separate"):
        number = _OUTPUTS.get(str(output.GetBaseName()), 0)
        return pixels[..., min(number, count - 1)][..., None]
    if category == "extract":
        return pixels[..., min(max(int(number_of(shader, "index", time, 0.0)), 0), count - 1)][..., None]
    if category == "swizzle":
        letters = word_of(shader, "channels", time, "")[:4]
        places = [_LETTERS.get(letter, 0) for letter in letters] or list(range(count))
        return np.concatenate([pixels[..., min(place, count - 1)][..., None] for place in places], axis=2)
    if category == "convert":
        channels = int(_CHANNELS.get(kind.split("_")[-1], count))
        if count == 1 and channels > 1:
            spread = np.repeat(pixels, min(channels, 3), axis=2)
            return spread if channels <= 3 else np.concatenate([spread, np.ones_like(pixels)], axis=2)
        if channels > count:
            return np.concatenate([pixels, *[np.ones_like(pixels[..., :1])] * (channels - count)], axis=2)
        return pixels[..., :channels]
    return pixels


_OUTPUTS = {"outr": 0, "outx": 0, "outg": 1, "outy": 1, "outb": 2, "outz": 2, "outa": 3, "outw": 3}
_LETTERS = {"r": 0, "x": 0, "g": 1, "y": 1, "b": 2, "z": 2, "a": 3, "w": 3}
_CHANNELS = {"float": 1, "vector2": 2, "color3": 3, "vector3": 3, "color4": 4, "vector4": 4}
_LUMA = (0.2722287, 0.6740818, 0.0536895)
"""Of MaterialX's own nodes, where nothing else is authored: the primaries of ACEScg."""


def _remapped(x: Array, low: Array, high: Array, out_low: Array, out_high: Array) -> Array:
    return out_low + (x - low) * (out_high - out_low) / np.where(high == low, 1.0, high - low)


def _ranged(x: Array, low: Array, high: Array, gamma: Array, out_low: Array, out_high: Array, clamp: Array) -> Array:
    t = (x - low) / np.where(high == low, 1.0, high - low)
    t = np.sign(t) * np.abs(t) ** (1.0 / np.where(gamma == 0.0, 1.0, gamma))
    mapped = out_low + t * (out_high - out_low)
    return np.where(clamp > 0.0, np.clip(mapped, np.minimum(out_low, out_high), np.maximum(out_low, out_high)), mapped)


def _smooth_step(x: Array, low: Array, high: Array) -> Array:
    t = np.clip((x - low) / np.where(high == low, 1.0, high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def _mixed(blend: Callable[[Array, Array], Array]) -> Callable[[Array, Array, Array], Array]:
    """A blend of a foreground over a background, as far as `mix` says."""
    return lambda fg, bg, mix: mix * blend(fg, bg) + (1.0 - mix) * bg


def _luma(x: Array, weights: Array) -> Array:
    return np.sum(x[..., :3] * weights[..., :3], axis=2, keepdims=True) if x.shape[2] >= 3 else x


def _to_hsv(rgb: Array) -> Array:
    most, least = rgb.max(axis=2), rgb.min(axis=2)
    spread = np.where(most > least, most - least, 1.0)
    r, g, b = (rgb[..., k] for k in range(3))
    hue = np.where(most == r, (g - b) / spread, np.where(most == g, 2.0 + (b - r) / spread, 4.0 + (r - g) / spread))
    hue = np.where(most > least, (hue / 6.0) % 1.0, 0.0)
    return np.stack([hue, np.where(most > 0.0, (most - least) / np.where(most > 0.0, most, 1.0), 0.0), most], axis=2)


def _to_rgb(hsv: Array) -> Array:
    k = (np.array([5.0, 3.0, 1.0]) + 6.0 * hsv[..., :1]) % 6.0
    return hsv[..., 2:3] * (1.0 - hsv[..., 1:2] * np.clip(np.minimum(k, 4.0 - k), 0.0, 1.0))


def _adjusted(rgb: Array, amount: Array) -> Array:
    if rgb.shape[2] != 3 or amount.shape[2] != 3:
        raise UnknownNodeError("ND_hsvadjust of other than colours")
    hsv = _to_hsv(rgb)
    return _to_rgb(
        np.stack([hsv[..., 0] + amount[..., 0], hsv[..., 1] * amount[..., 1], hsv[..., 2] * amount[..., 2]], 2)
    )


_IN = ("in", (0.0,))
_PAIR = (("in1", (0.0,)), ("in2", (0.0,)))
_PAIR_1 = (("in1", (0.0,)), ("in2", (1.0,)))
_LAYERS = (("fg", (0.0,)), ("bg", (0.0,)), ("mix", (1.0,)))
_NODES: dict[str, tuple[tuple[tuple[str, tuple[float, ...]], ...], Callable[..., Array]]] = {
    "add": (_PAIR, np.add),
    "subtract": (_PAIR, np.subtract),
    "multiply": (_PAIR_1, np.multiply),
    "divide": (_PAIR_1, lambda a, b: np.where(b == 0.0, 0.0, a / np.where(b == 0.0, 1.0, b))),
    "modulo": (_PAIR_1, lambda a, b: a - np.where(b == 0.0, 0.0, b * np.floor(a / np.where(b == 0.0, 1.0, b)))),
    "power": (_PAIR_1, lambda a, b: np.maximum(a, 0.0) ** b),
    "safepower": (_PAIR_1, lambda a, b: np.sign(a) * np.abs(a) ** b),
    "min": (_PAIR, np.minimum),
    "max": (_PAIR, np.maximum),
    "dotproduct": (_PAIR, lambda a, b: np.sum(a * b, axis=2, keepdims=True)),
    "absval": ((_IN,), np.abs),
    "floor": ((_IN,), np.floor),
    "ceil": ((_IN,), np.ceil),
    "round": ((_IN,), np.round),
    "fract": ((_IN,), lambda x: x - np.floor(x)),
    "sign": ((_IN,), np.sign),
    "sqrt": ((_IN,), lambda x: np.sqrt(np.maximum(x, 0.0))),
    "sin": ((_IN,), np.sin),
    "cos": ((_IN,), np.cos),
    "exp": ((_IN,), np.exp),
    "ln": ((("in", (1.0,)),), lambda x: np.log(np.maximum(x, 1e-30))),
    "magnitude": ((_IN,), lambda x: np.linalg.norm(x, axis=2, keepdims=True)),
    "normalize": ((_IN,), lambda x: x / np.maximum(np.linalg.norm(x, axis=2, keepdims=True), 1e-30)),
    "invert": ((_IN, ("amount", (1.0,))), lambda x, amount: amount - x),
    "clamp": ((_IN, ("low", (0.0,)), ("high", (1.0,))), lambda x, low, high: np.minimum(np.maximum(x, low), high)),
    "contrast": ((_IN, ("amount", (1.0,)), ("pivot", (0.5,))), lambda x, amount, pivot: (x - pivot) * amount + pivot),
    "remap": ((_IN, ("inlow", (0.0,)), ("inhigh", (1.0,)), ("outlow", (0.0,)), ("outhigh", (1.0,))), _remapped),
    "range": (
        (
            _IN,
            ("inlow", (0.0,)),
            ("inhigh", (1.0,)),
            ("gamma", (1.0,)),
            ("outlow", (0.0,)),
            ("outhigh", (1.0,)),
            ("doclamp", (0.0,)),
        ),
        _ranged,
    ),
    "smoothstep": ((_IN, ("low", (0.0,)), ("high", (1.0,))), _smooth_step),
    "luminance": ((_IN, ("lumacoeffs", _LUMA)), lambda x, w: np.repeat(_luma(x, w), x.shape[2], axis=2)),
    "saturate": (
        (_IN, ("amount", (1.0,)), ("lumacoeffs", _LUMA)),
        lambda x, amount, w: _luma(x, w) + amount * (x - _luma(x, w)),
    ),
    "hsvadjust": ((_IN, ("amount", (0.0, 1.0, 1.0))), _adjusted),
    "rgbtohsv": ((_IN,), _to_hsv),
    "hsvtorgb": ((_IN,), _to_rgb),
    "mix": ((("fg", (0.0,)), ("bg", (0.0,)), ("mix", (0.0,))), lambda fg, bg, mix: mix * fg + (1.0 - mix) * bg),
    "plus": (_LAYERS, _mixed(np.add)),
    "minus": (_LAYERS, _mixed(lambda fg, bg: bg - fg)),
    "difference": (_LAYERS, _mixed(lambda fg, bg: np.abs(bg - fg))),
    "screen": (_LAYERS, _mixed(lambda fg, bg: 1.0 - (1.0 - fg) * (1.0 - bg))),
    "overlay": (
        _LAYERS,
        _mixed(lambda fg, bg: np.where(fg < 0.5, 2.0 * fg * bg, 1.0 - 2.0 * (1.0 - fg) * (1.0 - bg))),
    ),
    "inside": ((_IN, ("mask", (1.0,))), np.multiply),
    "outside": ((_IN, ("mask", (0.0,))), lambda x, mask: x * (1.0 - mask)),
}
"""Node -> its inputs with their defaults, and what it makes of them."""


def _half(a: Array, b: Array) -> Array:
    return 0.5 * (a + b)


_MEANS: dict[str, tuple[tuple[tuple[str, tuple[float, ...]], ...], Callable[..., Array]]] = {
    "noise2d": ((("pivot", (0.0,)), ("amplitude", (1.0,))), lambda pivot, amplitude: pivot + 0.0 * amplitude),
    "noise3d": ((("pivot", (0.0,)), ("amplitude", (1.0,))), lambda pivot, amplitude: pivot + 0.0 * amplitude),
    "fractal2d": ((("amplitude", (1.0,)),), lambda amplitude: 0.0 * amplitude),
    "fractal3d": ((("amplitude", (1.0,)),), lambda amplitude: 0.0 * amplitude),
    "cellnoise2d": ((), lambda: np.full((1, 1, 1), 0.5)),
    "cellnoise3d": ((), lambda: np.full((1, 1, 1), 0.5)),
    "worleynoise2d": ((), lambda: np.full((1, 1, 1), 0.43)),  # nearest of one point a cell; 400 000 draws
    "worleynoise3d": ((), lambda: np.full((1, 1, 1), 0.52)),
    "unifiednoise2d": ((("outmin", (0.0,)), ("outmax", (1.0,))), _half),
    "unifiednoise3d": ((("outmin", (0.0,)), ("outmax", (1.0,))), _half),
    "randomfloat": ((("min", (0.0,)), ("max", (1.0,))), _half),
    "ramplr": ((("valuel", (0.0,)), ("valuer", (0.0,))), _half),
    "ramptb": ((("valuet", (0.0,)), ("valueb", (0.0,))), _half),
    "ramp4": (
        (("valuetl", (0.0,)), ("valuetr", (0.0,)), ("valuebl", (0.0,)), ("valuebr", (0.0,))),
        lambda a, b, c, d: 0.25 * (a + b + c + d),
    ),
    "splitlr": (
        (("valuel", (0.0,)), ("valuer", (0.0,)), ("center", (0.5,))),
        lambda left, right, center: center * left + (1.0 - center) * right,
    ),
    "splittb": (
        (("valuet", (0.0,)), ("valueb", (0.0,)), ("center", (0.5,))),
        lambda top, bottom, center: (1.0 - center) * top + center * bottom,
    ),
    "checkerboard": ((("color1", (1.0, 1.0, 1.0)), ("color2", (0.0, 0.0, 0.0))), _half),
}
"""Node that varies in space -> the inputs that its mean depends on, and that mean over a unit square or cube."""
