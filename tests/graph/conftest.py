"""A registry of toy ops: arithmetic with quantities, so that the engine is tested without a camera."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pytest

from synfog_usd.base.errors import ParameterError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.graph import Auto, FromProfile, Port, Range, Registry


@dataclass(frozen=True)
class Chip:
    name: str
    noise_e: float

    @property
    def content_hash(self) -> str:
        return hashlib.sha256(repr(self).encode()).hexdigest()


def load_chip(reference: str, folder: Path) -> Chip:
    if reference.endswith(".yaml"):
        return Chip(reference, float((folder / reference).read_text()))
    if reference != "good":
        raise ParameterError("no such chip; there is good")
    return Chip("good", 2.0)


@pytest.fixture
def registry() -> Registry:
    ops = Registry()
    ops.profile("chip", load_chip)

    @ops.op("lens.pass", takes=Quantity.RADIANCE, gives=Quantity.IRRADIANCE)
    def lens(
        image: Image,
        *,
        scale: Annotated[float, Range(0.0, 10.0, above=True)] = 1.0,
        shape: Literal["round", "square"] = "round",
    ) -> Image:
        return image.with_pixels(image.pixels * np.float32(scale), quantity=Quantity.IRRADIANCE).with_metadata(
            shape=shape
        )

    @ops.op("chip.expose", takes=Quantity.IRRADIANCE, gives=Port(Quantity.ELECTRONS, "mosaic"))
    def expose(image: Image, *, time_s: Annotated[float, Range(0.0, above=True), Auto()]) -> Image:
        return image.with_pixels(
            image.pixels[..., :1] * np.float32(time_s), channels=("CFA",), quantity=Quantity.ELECTRONS
        )

    @ops.op("chip.noise", takes=Quantity.ELECTRONS, gives=Quantity.ELECTRONS)
    def noise(
        image: Image, *, rng: np.random.Generator, sigma_e: Annotated[float, Range(0.0), FromProfile("chip.noise_e")]
    ) -> Image:
        return image.with_pixels(
            image.pixels + np.float32(sigma_e) * rng.standard_normal(image.pixels.shape, dtype=np.float32)
        )

    @ops.op("chip.adc", takes=Port(Quantity.ELECTRONS, "mosaic"), gives=Port(Quantity.DN, "mosaic"))
    def adc(image: Image, *, bits: Annotated[int, Range(8, 16)] = 10, invert: bool = False) -> Image:
        return image.with_pixels(np.clip(np.rint(image.pixels), 0, 2**bits - 1), quantity=Quantity.DN).with_metadata(
            invert=invert
        )

    @ops.op("screen.show", takes=Quantity.DN, gives=Port(Quantity.DISPLAY_RGB, "rgb"))
    def show(image: Image, *, tint: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> Image:
        return image.with_pixels(
            image.pixels * np.array(tint, dtype=np.float32), channels=("R", "G", "B"), quantity=Quantity.DISPLAY_RGB
        )

    @ops.op("light.sum", takes=Quantity.RADIANCE, gives=Quantity.RADIANCE)
    def total(*images: Image) -> Image:
        return images[0].with_pixels(sum(image.pixels for image in images))

    @ops.op("light.difference", takes=(Quantity.RADIANCE, Quantity.RADIANCE), gives=Quantity.RADIANCE)
    def difference(one: Image, other: Image) -> Image:
        return one.with_pixels(one.pixels - other.pixels)

    return ops


@pytest.fixture
def radiance() -> Image:
    pixels = np.arange(4 * 6 * 3, dtype=np.float32).reshape(4, 6, 3)
    return Image(pixels, ("R", "G", "B"), Quantity.RADIANCE)
