"""Inputs of a surface shader as numbers, colours and pictures, under the names of a preview surface.

Takes one shader, the names of its inputs and a shape's primvars; gives constants and Mitsuba's textures.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from pxr import Usd, UsdShade

from synfog_usd.base.arrays import Pixels
from synfog_usd.base.colour import LUMINANCE
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.finite import ROUNDED
from synfog_usd.translate.networks import fed_by, omni_texture
from synfog_usd.translate.nodes import READERS
from synfog_usd.translate.primvars import PrimvarValue
from synfog_usd.translate.shader import (
    flag_of,
    number_of,
    numbers_in,
    numbers_of,
    producer,
    shader_id,
    value_of,
    word_of,
)
from synfog_usd.translate.shading import GREY, InputNames
from synfog_usd.translate.texture import ImageReader, TextureNode, UvSource, linear, sampled
from synfog_usd.translate.wrap import MODES

DISPLAY = "displayColor"
"""The primvar of a shape's own colours."""

VERTEX_COLOR: Mapping[str, str] = {"type": "mesh_attribute", "name": "vertex_color"}
"""Texture that reads the colours of vertices."""

_MIN_IOR, _UNUSUAL_IOR = 1.001, 10.0

Bsdf: TypeAlias = dict[str, Any]
"""A BSDF, texture or colour in the scene's words."""

Lookup: TypeAlias = Callable[[str], PrimvarValue | None]
"""From the name of a primvar to its value on a shape."""


@dataclass(frozen=True)
class PrimvarUse:
    """A primvar that a material reads.

    Attributes:
        name: of the primvar.
        input: what it goes to.
        colour: whether it has to be a colour, or else a number.
        needed: whether its reader has no fallback for a shape without it.
    """

    name: str
    input: str
    colour: bool
    needed: bool


@dataclass(frozen=True)
class Read:
    """What a reader of a primvar gives.

    Attributes:
        name: of the primvar.
        value: of the shape, or else the reader's fallback; None where there is neither.
        fallback: of the reader.
    """

    name: str
    value: PrimvarValue | None
    fallback: PrimvarValue | None

    @property
    def colour(self) -> tuple[float, float, float] | None:
        """The value as a colour; None where it is none."""
        return self.value.colour if self.value is not None else None

    @property
    def number(self) -> float | None:
        """The value as a number; None where it is none."""
        return self.value.number if self.value is not None else None


class SurfaceInputs:
    """The inputs of one surface shader, and the one set of texture coordinates that they read.

    Args:
        lookup: from the name of a primvar to the shape's value.
        uses: where the primvars that it reads are listed.
    """

    def __init__(
        self,
        shader: UsdShade.Shader,
        names: InputNames,
        time: Usd.TimeCode,
        notes: Diagnostics,
        images: ImageReader,
        lookup: Lookup,
        uses: dict[PrimvarUse, None],
    ) -> None:
        self.shader, self.names, self.lookup, self.uses = shader, names, lookup, uses
        self.time, self.notes, self.images = time, notes, images
        self.uv: UvSource | None = None
        self.vertex_color = False
        self.reads = DISPLAY
        self.fallback: tuple[float, float, float] | None = None
        self.unwrapped = False

    def has(self, name: str) -> bool:
        """Whether the shader has such an input, and it is not switched off."""
        switch = self.names.switches.get(name)
        return bool(self.names[name]) and (switch is None or flag_of(self.shader, switch, self.time))

    def producer(self, name: str) -> Usd.Attribute | None:
        """The shader output that feeds an input, or None where it is a constant."""
        return producer(self.shader, self.names[name]) if self.has(name) else None

    def read(self, name: str, *, colour: bool) -> Read | None:
        """What a reader of a primvar gives to an input that it feeds; None for an input without one."""
        output = None if self.names.omni else self.producer(name)
        return None if output is None else self._read_by(output, name, colour=colour)

    def _read_by(self, output: Usd.Attribute, name: str, *, colour: bool) -> Read | None:
        """What a reader of a primvar gives; None where the output is of another shader."""
        if not (kind := shader_id(output.GetPrim())).startswith(READERS):
            return None
        reader, is_materialx = UsdShade.Shader(output.GetPrim()), kind.startswith("ND_geom")
        varname = word_of(reader, "geomprop" if is_materialx else "varname", self.time, "")
        primvar = varname.removeprefix("primvars:") or DISPLAY
        numbers = numbers_in(value_of(reader, "default" if is_materialx else "fallback", self.time))
        fallback = PrimvarValue(numbers) if numbers is not None else None
        self.uses[PrimvarUse(primvar, name, colour, fallback is None)] = None
        value = self.lookup(primvar)
        fits = value is not None and (value.colour if colour else value.number) is not None
        return Read(primvar, value if fits else fallback, fallback)

    def _weight(self, name: str) -> float:
        """Product of the inputs by which an input is multiplied."""
        times = 1.0
        for factor, default in self.names.weights.get(name, {}).items():
            output = producer(self.shader, factor)
            times *= (
                number_of(self.shader, factor, self.time, default)
                if output is None
                else self._fed(output, factor, default)
            )
        return times

    def constant(self, name: str, default: float) -> float:
        """An input as one number; a picture's in the mean."""
        if not self.has(name):
            return default
        output = producer(self.shader, self.names[name])
        if output is None:
            return number_of(self.shader, self.names[name], self.time, default)
        return self._fed(output, name, default)

    def _fed(self, output: Usd.Attribute, name: str, default: float) -> float:
        """The number that other shaders give, a picture's in the mean; `default` where they give none."""
        if (read := self._read_by(output, name, colour=False)) is not None:
            return default if read.number is None else read.number
        node = self._behind(output, name)
        if node is None:
            return default
        value = sampled(node, self.images, channels=1)
        if isinstance(value, tuple):
            return value[0]
        self.notes.warn(self.shader.GetPath(), f"a picture of {name} is drawn as its mean")
        return float(linear(value, srgb=value.dtype == np.uint8).mean())

    def _behind(self, output: Usd.Attribute, name: str) -> TextureNode | None:
        """`fed_by`, with the primvars of the shape in it."""

        def of_shape(reader: Usd.Attribute) -> tuple[float, ...] | None:
            read = self._read_by(reader, f"a node behind {name}", colour=True)
            value = read.value if read is not None else None
            return None if value is None or isinstance(value.value, str) or value.colour is None else value.value

        return fed_by(output, name, self.time, self.notes, self.shader.GetPath(), self.images, of_shape)

    def constant_color(self, name: str, default: tuple[float, ...]) -> tuple[float, ...]:
        """An input as one colour with its weight and tint; a picture's in the mean."""
        weight = self._weight(name)
        if (read := self.read(name, colour=True)) is not None:
            return tuple(c * weight for c in read.colour or (0.0, 0.0, 0.0))
        node = self.texture(name)
        if node is not None:
            value = sampled(node, self.images, channels=3)
            if isinstance(value, tuple):
                return value
            return tuple(linear(value, srgb=value.dtype == np.uint8).mean(axis=(0, 1)).tolist())
        color = numbers_of(self.shader, self.names[name], self.time, default) if self.has(name) else default
        tint = numbers_of(self.shader, self.names.tints.get(name, ""), self.time, (1.0, 1.0, 1.0))
        return tuple(float(c) * float(t) * weight for c, t in zip(color, tint, strict=True))

    def texture(self, name: str) -> TextureNode | None:
        """The texture that feeds an input, with its weight; None for a constant."""
        if self.names.omni:
            return omni_texture(self.shader, name, self.time, self.notes, self.images)
        output = self.producer(name)
        if output is None or (name != "normal" and shader_id(output.GetPrim()).startswith(READERS)):
            return None
        node = self._behind(output, name)
        weight = self._weight(name) if node is not None else 1.0
        if node is not None and weight != 1.0:
            scale, bias = (tuple(c * weight for c in values[:3]) for values in (node.scale, node.bias))
            node = replace(node, scale=(*scale, node.scale[3]), bias=(*bias, node.bias[3]))
        return node

    def bitmap(self, pixels: Pixels, node: TextureNode, *, raw: bool) -> Bsdf:
        """A picture as Mitsuba's texture, looked up where the node says.

        A shape carries the coordinates of the first texture; those of another one
        are reached from there by an affine map.
        """
        shown = self.images.wrapped(pixels, node)
        self.unwrapped |= any(
            authored not in MODES and mode == "black"
            for authored, mode in zip((node.wrap, node.wrap_v or node.wrap), self.images.wraps(node), strict=True)
        )
        bitmap: Bsdf = {"type": "bitmap", "bitmap": shown.pixels, "raw": raw, "wrap_mode": shown.mode}
        if node.uv is None:
            return bitmap
        onto = np.array([[shown.scale[0], 0.0, shown.shift[0]], [0.0, shown.scale[1], shown.shift[1]], [0.0, 0.0, 1.0]])
        if self.uv is None:
            self.uv = node.uv
        first, this = (np.vstack([np.array(uv.matrix), [0.0, 0.0, 1.0]]) for uv in (self.uv, node.uv))
        if self.uv.primvar != node.uv.primvar or abs(np.linalg.det(first)) < 1e-12:
            self.notes.warn(
                self.shader.GetPath(),
                f"textures with different coordinates; all are drawn with {self.uv.primvar!r} as the first one is",
            )
            this = first
        between = onto if self.uv == node.uv or this is first else onto @ this @ np.linalg.inv(first)
        return bitmap if (between == np.eye(3)).all() else bitmap | {"to_uv": between}

    def shares(self, name: str, values: Sequence[float]) -> list[float]:
        """A colour or number kept within 0 to 1, with a note where it was outside."""
        shares = [min(max(float(c), 0.0), 1.0) for c in values]
        if any(abs(share - value) > ROUNDED for share, value in zip(shares, values, strict=True)):
            authored, nearest = (", ".join(f"{c:.4g}" for c in numbers) for numbers in (values, shares))
            self.notes.warn(
                self.shader.GetPath(), f"{self.names[name]} is {authored}, and 0 to 1 can be drawn; {nearest} is taken"
            )
        return shares

    def _limited(self, name: str, pixels: Pixels) -> Pixels:
        """A picture kept within 0 to 1, with a note where it was outside."""
        limited = self.images.once(_limited, pixels)
        if limited is not pixels and np.abs(limited - pixels).max() > ROUNDED:
            self.notes.warn(
                self.shader.GetPath(),
                f"the picture of {self.names[name]} has values from {pixels.min():.4g} to {pixels.max():.4g}, and 0 to "
                f"1 can be drawn; what is outside is taken as 0 or 1",
            )
        return limited

    def index(self, name: str, default: float) -> float:
        """An index of refraction, with a note on one that nothing clear has."""
        index = self.constant(name, default)
        text = f"{self.names[name]} is {index:g}"
        if index < 1.0:
            self.notes.warn(self.shader.GetPath(), f"{text}, and an index of refraction is 1 or more; 1 is taken")
        elif index > _UNUSUAL_IOR:
            self.notes.warn(
                self.shader.GetPath(), f"{text}, and nothing clear has more than 5; it is drawn as it stands"
            )
        return max(index, _MIN_IOR)

    def lets_straight_through(self) -> bool:
        """Whether what is not opaque is clear, instead of absent."""
        modes = ("transparent", "presence")
        constant = self.has("opacityMode") and self.producer("opacityMode") is None
        mode = value_of(self.shader, self.names["opacityMode"], self.time) if constant else None
        if not isinstance(mode, str):
            return True
        return self.notes.token(self.shader.GetPath(), "opacityMode", mode, modes, modes[0]) == modes[0]

    def color(self, name: str, default: tuple[float, ...]) -> Bsdf:
        """An input as a colour or a picture of colours."""
        output = self.producer(name)
        if (read := self.read(name, colour=True)) is not None:
            weight = self._weight(name)
            varies = read.value is not None and read.value.varies and name == "diffuseColor"
            if varies and weight != 1.0:
                self.notes.warn(self.shader.GetPath(), f"{name} varies and has a weight; it is drawn as its mean")
            elif varies:
                self.reads, self.fallback = read.name, read.fallback.colour if read.fallback is not None else None
                self.vertex_color = True
                return dict(VERTEX_COLOR)
            unknown = GREY if read.name == DISPLAY else (0.0, 0.0, 0.0)
            return rgb(self.shares(name, [c * weight for c in read.colour or unknown]))
        node = self.texture(name)
        if node is None:
            return rgb(self.shares(name, self.constant_color(name, default)) if output is None else list(default))
        value = sampled(node, self.images, channels=3)
        if isinstance(value, tuple):
            return rgb(self.shares(name, value))
        return self.bitmap(self._limited(name, value), node, raw=False)

    def number(self, name: str, default: float) -> float | Bsdf:
        """An input as a number from 0 to 1 or a picture of numbers."""
        if (read := self.read(name, colour=False)) is not None:
            return self.shares(name, [0.0 if read.number is None else read.number])[0]
        node = self.texture(name)
        if node is None:
            if self.producer(name) is not None or not self.has(name):
                return default
            numbers = numbers_in(value_of(self.shader, self.names[name], self.time))
            return default if numbers is None else self.shares(name, [sum(numbers) / len(numbers)])[0]
        value = sampled(node, self.images, channels=1)
        if isinstance(value, tuple):
            return self.shares(name, value[:1])[0]
        return self.bitmap(self._limited(name, value), node, raw=True)

    def opacity(self) -> float | Bsdf | None:
        """Opacity as a number or bitmap, or None where the surface is opaque."""
        value = self.number("opacity", 1.0)
        threshold = self.constant("opacityThreshold", self.names.cutoff)
        if self.names.masks and word_of(self.shader, self.names.masks, self.time, "0") not in ("MASK", "1"):
            threshold = 0.0
        elif self.names.masks and threshold <= 0.0:
            return None
        if isinstance(value, dict):
            if threshold > 0.0:
                value["bitmap"] = self.images.once(_cut, value["bitmap"], threshold)
            return value
        if threshold > 0.0:
            value = 1.0 if value >= threshold else 0.0
        return None if value >= 1.0 else value

    def emission(self) -> tuple[Bsdf | None, float]:
        """Radiance and its mean luminance, or (None, 0) for a dark surface."""
        if not self.has("emissiveColor"):
            return None, 0.0
        node = self.texture("emissiveColor")
        if node is not None:
            value = sampled(node, self.images, channels=3)
            if not isinstance(value, tuple):
                decoded, luminance = self.images.once(_shining, value)
                return (None, 0.0) if decoded is None else (self.bitmap(decoded, node, raw=True), luminance)
        else:
            dark = self.names.glow if self.names.weights else (0.0, 0.0, 0.0)  # where a weight switches it on
            value = self.constant_color("emissiveColor", dark)
        strength = [max(float(c), 0.0) for c in value]
        if min(value) < -ROUNDED:
            self.notes.warn(
                self.shader.GetPath(), f"{self.names['emissiveColor']} is below 0, where nothing shines; 0 is taken"
            )
        return (rgb(strength), float(LUMINANCE @ strength)) if max(strength) > 0.0 else (None, 0.0)


def rgb(value: Iterable[float]) -> Bsdf:
    """A colour in the scene's words."""
    return {"type": "rgb", "value": [float(c) for c in value]}


def _limited(pixels: Pixels) -> Pixels:
    """Values from 0 to 1; the same array where they are."""
    if pixels.dtype == np.uint8 or (pixels.min() >= 0.0 and pixels.max() <= 1.0):
        return pixels
    return np.clip(pixels, 0.0, 1.0)


def _shining(pixels: Pixels) -> tuple[Pixels | None, float]:
    """A picture as radiance, with its mean luminance; (None, 0) where it is dark throughout."""
    decoded = np.maximum(linear(pixels, srgb=pixels.dtype == np.uint8), 0.0)
    return (decoded, float(LUMINANCE @ decoded.mean(axis=(0, 1)))) if decoded.any() else (None, 0.0)


def _cut(pixels: Pixels, threshold: float) -> Pixels:
    """1 where a picture reaches a threshold, else 0."""
    return np.asarray((pixels >= threshold).astype(np.float32))
