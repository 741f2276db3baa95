"""BSDFs in wavelength bands, for materials that have a reflectance spectrum of their own.

Mitsuba's RGB variants give every BSDF three colour channels.  Here a material gets a second BSDF, its spectral one,
whose three
channels are not R, G and B: each says how much of a basis spectrum a texel reflects.  Reflectance in any band then
follows from the three numbers by a fixed matrix.

The basis of a material is
    1. its own spectrum, scaled to HEIGHT;
    2. what that lacks of white (reflectance 1) in the long waves;
    3. what it lacks in the short waves.
The three add up to 1.  So a texel of the material's mean colour shows its own spectrum.  Others are mixtures of all
three.  Gloss stays white, and no band reflects more than it gets.

Why three channels suffice: in every channel c of its base colour a BSDF of ours is A + B c, with A the gloss and B the
matte part.  How it is sampled does not depend on c.  Paths in R, G and B never use these BSDFs.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, cast

import drjit as dr
import numpy as np
import numpy.typing as npt

from synfog_usd.base import photometry, spectra
from synfog_usd.base.arrays import Array, FloatArray, Indices
from synfog_usd.base.colour import LUMINANCE
from synfog_usd.render import backend
from synfog_usd.render.load import MitsubaScene, make_bsdf
from synfog_usd.scene import base_colour, mean_colour, recoloured, texels

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float
    from mitsuba import BSDFPtr

LONG_NM, LONG_WIDTH_NM = 580.0, 20.0
"""Where what the own spectrum lacks of white is cut in two, and how softly."""

CHECKED_NM = 16
"""Steps of wavelength at which a texel is kept between black and white."""

HEIGHT = 0.5
"""Top of a texture's first spectrum: the others have the other half at least to make hues of."""


def basis(curve: Array, rgb: npt.ArrayLike, height: float = HEIGHT) -> Array:
    """(3, 401) the spectra of which the texels of a material are made; they add up to 1.

    Args:
        curve: (401,) reflectance of the material, of any level.
        rgb: its mean colour, linear Rec.709, as bright as it is under D65.
        height: top of the first one.
    """
    scaled = spectra.scaled(curve, rgb)
    first = scaled * (height / max(float(scaled.max()), 1e-12))
    long = 1.0 / (1.0 + np.exp(-(photometry.WAVELENGTHS_NM - LONG_NM) / LONG_WIDTH_NM))
    return np.stack([first, (1.0 - first) * long, (1.0 - first) * (1.0 - long)])


def basis_weights(pixels: FloatArray, curve: Array, rgb: npt.ArrayLike) -> FloatArray:
    """How much of each spectrum of `basis` the texels have.

    Under D65 a texel differs from what the material's spectrum shows by the ratio by which it differs from the mean; a
    hue that would need a reflectance below 0 or above 1 fades towards the mean's.

    Args:
        pixels: (H, W, 3) linear Rec.709.
        curve, rgb: as `basis` takes them.
    """
    parts, mean = basis(curve, rgb), np.maximum(np.asarray(rgb, dtype=np.float64), 1e-6)
    scaled = spectra.scaled(curve, rgb)
    level = float(scaled.max()) / HEIGHT
    shown = spectra.rgb_of(parts).T  # (3, 3): its columns are what D65 shows of each
    target = (spectra.rgb_of(scaled) / mean)[:, None]
    to_shares = np.linalg.inv(shown) @ (target * np.eye(3))
    weights = LUMINANCE
    along = np.outer([level, 0.0, 0.0], weights / float(weights @ mean))  # what a texel of the mean's hue has
    sides = parts[:, ::CHECKED_NM].astype(np.float32)
    texel, where = _distinct(pixels.reshape(-1, 3))
    grey = np.minimum(texel @ along.T.astype(np.float32), 1.0 / HEIGHT)
    hue = texel @ to_shares.T.astype(np.float32) - grey
    base, change = grey @ sides, hue @ sides
    room = np.minimum(base / np.maximum(-change, 1e-12), (1.0 - base) / np.maximum(change, 1e-12)).min(axis=1)
    return np.asarray((grey + np.clip(room, 0.0, 1.0)[:, None] * hue)[where].reshape(pixels.shape), dtype=np.float32)


def _distinct(texel: FloatArray) -> tuple[FloatArray, Indices]:
    """The colours among (N, 3) texels, and which of them each is: a picture of a million has some ten thousand."""
    bits = np.ascontiguousarray(texel, dtype=np.float32).view(np.uint32).astype(np.uint64)
    word = (bits * np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], dtype=np.uint64)).sum(
        axis=1, dtype=np.uint64
    )
    first, where = np.unique(word, return_index=True, return_inverse=True)[1:]
    return texel[first], where.ravel()


class SpectralBsdfs:
    """All materials of a scene that have a spectrum.

    Args:
        loaded: the scene; keeps the spectral BSDFs.
        plain: (3, N) how R, G and B of any other material become bands; its columns add up to 1.
        boxes: (N, 401) of the bands.

    Attributes:
        count: of materials with a spectrum.
    """

    def __init__(self, loaded: MitsubaScene, plain: Array, boxes: Array) -> None:
        world = loaded.source.world
        keys = [
            key for key in loaded.source.reflectance_of if key in loaded.parts and base_colour(world[key]) is not None
        ]
        self.count = len(keys)
        if not keys:
            return
        mi = backend.mitsuba()
        width = boxes.sum(axis=1)
        table, pairs = [plain[:2]], []
        for key in keys:
            colour, curve = base_colour(world[key]), loaded.source.reflectance_of[key]
            assert colour is not None
            mean, height = mean_colour(colour), 1.0 if colour["type"] == "rgb" else HEIGHT
            if key not in loaded.spectral_bsdfs:
                loaded.spectral_bsdfs[key] = make_bsdf(recoloured(world[key], _carried(colour, curve, mean)))
            bsdfs = loaded.parts[key], loaded.spectral_bsdfs[key]
            pairs.append(tuple(backend.index_of(mi.BSDFPtr(bsdf)) for bsdf in bsdfs))
            table.append((basis(curve, mean, height) @ boxes.T / width)[:2])
        self.bands = boxes.shape[0]
        self.size = max(index for index, _ in pairs) + 1
        row, spectral = np.zeros(self.size, dtype=np.uint32), np.arange(self.size, dtype=np.uint32)
        for number, (index, in_bands) in enumerate(pairs):
            row[index], spectral[index] = number + 1, in_bands
        self.row, self.spectral = mi.UInt32(row), mi.UInt32(spectral)
        self.table = backend.floats(np.concatenate(table).ravel())
        dr.make_opaque(self.row, self.spectral, self.table)

    def of(self, bsdf: BSDFPtr, active: Bool) -> tuple[BSDFPtr, list[Float]]:
        """What to ask instead of a BSDF, and two numbers a band with which `Bands.reflectance` reads the answer."""
        mi = backend.mitsuba()
        index = backend.indices_of(bsdf)
        row = dr.gather(mi.UInt32, self.row, index, active & (index < self.size))
        spectral = dr.select(row > 0, dr.gather(mi.UInt32, self.spectral, index, row > 0), index)
        return cast("BSDFPtr", dr.reinterpret_array(mi.BSDFPtr, spectral)), [
            dr.gather(mi.Float, self.table, row * (2 * self.bands) + k, active) for k in range(2 * self.bands)
        ]


def _carried(colour: Mapping[str, Any], curve: Array, mean: tuple[float, float, float]) -> dict[str, Any]:
    """The shares of three spectra in place of a colour."""
    if colour["type"] == "rgb":
        return {"type": "rgb", "value": [float(spectra.scaled(curve, mean).max()), 0.0, 0.0]}
    return {**colour, "bitmap": basis_weights(texels(colour), curve, mean), "raw": True}
