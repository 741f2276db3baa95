"""What a path carries: three colours, or the light in each of several wavelength bands.

Mitsuba's RGB variants know every light and surface by three numbers.  A band's share
of them follows from spectra.  Lights get those of `photometry.channel_spectra`.  Surfaces
get the same basis without the illuminant (Mallett and Yuksel 2019).  So white stays
white, and D65 shows a surface in its own colour.  Fog may thin with wavelength: then
paths are drawn in the clearest band, and the others weigh them by what is left.

Where a lamp or a material has a spectrum of its own, that is what counts: see `Bands.light` and `spectra.bsdfs`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any, TypeAlias, cast

import drjit as dr
import numpy as np

from synfog_usd.base import photometry
from synfog_usd.base.arrays import Array
from synfog_usd.base.colour import LUMINANCE, PRIMARIES_NM
from synfog_usd.base.errors import ParameterError
from synfog_usd.base.numbers import RGB, check_bands
from synfog_usd.fog import FogMedium, FogVolume
from synfog_usd.render import backend
from synfog_usd.render.load import MitsubaScene
from synfog_usd.render.spectra.bsdfs import SpectralBsdfs

if TYPE_CHECKING:
    from drjit.auto.ad import ArrayXf, Bool, Float, UInt32
    from mitsuba import BSDFPtr, Color3f, Point3f, Spectrum

    from synfog_usd.render.media.medium import Medium

    SampledSpectrum: TypeAlias = ArrayXf
    """Light, or what a path leaves of it, in all of its bands; R, G and B are a `Color3f`."""

CENTRES_NM: dict[int, tuple[float, ...]] = {
    8: tuple(410.0 + 40.0 * index for index in range(8)),
    16: tuple(400.0 + 20.0 * index for index in range(16)),
    31: tuple(400.0 + 10.0 * index for index in range(31)),
}
"""Number of bands -> their centres; each reaches half-way to the next.  Luminance outside of them is 1e-4 of
white's.
"""

GREY = 0.03
"""Span of extinctions and albedos over wavelength below which a kind of medium is drawn grey."""


def is_finite(light: SampledSpectrum) -> Bool:
    """Whether light is finite in all bands."""
    return dr.all(dr.isfinite(light))  # type: ignore[arg-type] # Dr.Jit's stub takes no mask of several parts


@lru_cache(maxsize=8)
def matrices(count: int) -> tuple[Array, Array]:
    """How R, G and B become N bands: light [W m-2 sr-1 nm-1], and reflectance; (3, N) each.

    The columns of the second add up to 1.
    """
    spectra = photometry.channel_spectra(("R", "G", "B"))
    boxes = photometry.channel_spectra(names(count))
    light = box_means(spectra, boxes)
    return light, light / light.sum(axis=0)


def box_means(spectrum: Array, boxes: Array) -> Array:
    """(..., N) means over bands (N, 401) of spectra (..., 401)."""
    return np.asarray(spectrum @ boxes.T / boxes.sum(axis=1))


def names(count: int) -> tuple[str, ...]:
    """Channel names of an image."""
    return ("R", "G", "B") if count == RGB else tuple(map(photometry.band_name, CENTRES_NM[count]))


def to_rgb(pixels: Array, count: int) -> Array:
    """(..., 3) linear Rec.709 in cd m-2 of what an eye sees of (..., N) bands.

    The CIE observer's integral over the bands, then the matrix of sRGB (IEC 61966-2-1).
    """
    if count == RGB:
        return pixels
    boxes = photometry.channel_spectra(names(count))
    xyz = photometry.observer() @ boxes.T
    primaries = photometry.observer() @ photometry.channel_spectra(("R", "G", "B")).T
    return np.asarray(pixels @ (np.linalg.inv(primaries) @ xyz).T)


class Bands:
    """The light that paths carry.

    Args:
        count: RGB, or a key of `CENTRES_NM`.
        fog: the scene's, for how it depends on wavelength; of an Angstrom exponent R, G and B see nothing.
        emissions: (401,) spectra of lamps that have one of their own; the first is kind 1 of light, colours are kind 0.

    Attributes:
        kinds: of light, 1 where there are colours alone.
        spectral_bsdfs: materials with a spectrum of their own, or None.
        weights: (N,) such that pixels @ weights is a luminance [cd m-2]; for R, G, B their plain mean.
        clearest: extinction of the clearest band over that at 550 nm.
        coloured: whether extinction or albedo differs between bands.

    Raises:
        ParameterError: fogs whose wavelength bands differ in different ways; R, G and B have one extinction then.
    """

    def __init__(self, count: int = RGB, fog: Sequence[FogVolume] = (), emissions: Sequence[Array] = ()) -> None:
        check_bands(count)
        self.kinds = 1
        self.spectral_bsdfs: SpectralBsdfs | None = None
        self.count, self.names, self.is_rgb = count, names(count), count == RGB
        self.type: type[SampledSpectrum] = backend.mitsuba().Color3f if self.is_rgb else backend.mitsuba().ArrayXf
        self._colour(fog)
        if self.is_rgb:
            self.weights = np.full(3, 1.0 / 3.0)
            return
        self.light_of, self.reflectance_of = matrices(count)
        boxes = photometry.channel_spectra(self.names)
        self.weights = np.array([photometry.luminance_of(box) for box in boxes])
        if emissions:
            self.kinds = 1 + len(emissions)
            self.lit = np.array([box_means(curve / photometry.luminance_of(curve), boxes) for curve in emissions])
            self._lit = backend.floats(np.concatenate([np.zeros((1, count)), self.lit]).ravel())
            dr.make_opaque(self._lit)

    def _colour(self, fog: Sequence[FogVolume]) -> None:
        """What each band loses and scatters, beside the clearest one."""
        self.clearest, self.coloured, self._by_volume = 1.0, False, dict[int, Any]()
        media = [volume.medium for volume in fog if volume.medium.sigma_t_per_m > 0.0]
        if self.is_rgb and all(medium.colours is None for medium in media):
            return
        curves, number = {self._curve(medium) for medium in media}, backend.mitsuba().Float
        if len(curves) > 1 and not self.is_rgb:
            raise ParameterError(
                "fogs that differ in their Angstrom exponents or kinds: wavelength bands take one; R, G and B take any"
            )
        if not curves or curves == {(1.0,) * 2 * self.count}:
            return
        extinction, tint = np.array(curves.pop()).reshape(2, -1)
        if curves:  # one extinction for all
            extinction, tint = np.ones((2, self.count))
            for volume in fog:
                albedo = self._curve(volume.medium)[self.count :]
                self._by_volume[id(volume)] = self.of([dr.opaque(number, value) for value in albedo])
        self.clearest, self.coloured = float(extinction.min()), True
        self.ratio = extinction / self.clearest
        self._more = [dr.opaque(number, value) for value in self.ratio - 1.0]
        self._tint = [] if np.all(tint == 1.0) else [dr.opaque(number, value) for value in tint]

    def _curve(self, medium: FogMedium) -> tuple[float, ...]:
        """Extinction of each band, and then its albedo, over those at 550 nm."""
        centres = PRIMARIES_NM if self.is_rgb else CENTRES_NM[self.count]
        extinction, albedo = medium.extinction_at(centres), medium.albedo_at(centres) / (medium.albedo or 1.0)
        if self.is_rgb and medium.grid is not None:  # flights through a grid have one extinction
            extinction = np.ones(self.count)
        if medium.colours is not None and max(np.ptp(extinction), np.ptp(albedo)) < GREY:
            return (1.0,) * 2 * self.count
        return (*extinction.tolist(), *albedo.tolist())

    def black(self) -> SampledSpectrum:
        """No light."""
        mi = backend.mitsuba()
        return mi.Color3f(0.0) if self.is_rgb else self._array([mi.Float(0.0)] * self.count)

    def of(self, parts: Sequence[Float]) -> SampledSpectrum:
        """Light, of its numbers in all bands."""
        return backend.mitsuba().Color3f(*parts) if self.is_rgb else self._array(list(parts))

    def even(self, value: Color3f) -> SampledSpectrum:
        """A throughput that is the same in all bands."""
        mi = backend.mitsuba()
        return mi.Color3f(value) if self.is_rgb else self._array([mi.Float(value[0])] * self.count)

    def assign_spectral_bsdfs(self, loaded: MitsubaScene) -> None:
        """Give the materials of a scene the spectra that they have."""
        if not self.is_rgb and loaded.source.reflectance_of:
            bsdfs = SpectralBsdfs(loaded, self.reflectance_of, photometry.channel_spectra(self.names))
            self.spectral_bsdfs = bsdfs if bsdfs.count else None

    def light(self, colour: Color3f | Spectrum, kind: UInt32 | None = None) -> SampledSpectrum:
        """Radiance or intensity in R, G, B [cd m-2, cd] in all bands; of a kind above 0 its luminance counts."""
        if self.is_rgb:
            return cast("SampledSpectrum", colour)
        mixed = self._mixed(colour, self.light_of)
        if kind is None:
            return mixed
        r, g, b = colour
        of_r, of_g, of_b = LUMINANCE.tolist()
        luminance = r * of_r + g * of_g + b * of_b
        return dr.select(kind > 0, self.gather(self._lit, kind, kind > 0) * luminance, mixed)

    def surface(self, bsdf: BSDFPtr, active: Bool) -> tuple[BSDFPtr, Sequence[Float] | None]:
        """The BSDF to ask, and how `reflectance` reads what it answers."""
        return (bsdf, None) if self.spectral_bsdfs is None else self.spectral_bsdfs.of(bsdf, active)

    def reflectance(self, colour: Color3f | Spectrum, reading: Sequence[Float] | None = None) -> SampledSpectrum:
        """What a surface leaves of R, G and B, or of what else `reading` says it tells, in all bands."""
        if self.is_rgb:
            return cast("SampledSpectrum", colour)
        if reading is None:
            return self._mixed(colour, self.reflectance_of)
        r, g, rest = colour
        first, second = r - rest, g - rest
        return self._array(
            [rest + first * a + second * b for a, b in zip(reading[: self.count], reading[self.count :], strict=True)]
        )

    def fade(self, optical_depth: Float) -> SampledSpectrum:
        """What each band loses over an optical depth beyond the clearest band's exp(-tau)."""
        return self._array([dr.exp(-more * optical_depth) for more in self._more])

    def scattered(self, medium: Medium, place: Point3f) -> SampledSpectrum:
        """What each band scatters at points in fog over what the clearest would with the albedo at 550 nm."""
        if self._by_volume:
            return cast("SampledSpectrum", medium.by_volume(place, [self._by_volume[id(v)] for v in medium.volumes]))
        ratios = [more + 1.0 for more in self._more]
        return self._array(
            [ratio * tint for ratio, tint in zip(ratios, self._tint, strict=True)] if self._tint else ratios
        )

    def gather(self, table: Float, index: UInt32, active: Bool) -> SampledSpectrum:
        """A row of a table with a column for each band."""
        mi = backend.mitsuba()
        if self.is_rgb:
            return dr.gather(mi.Color3f, table, index, active)
        return self._array(
            [dr.gather(mi.Float, table, index * self.count + band, active) for band in range(self.count)]
        )

    def _mixed(self, colour: Color3f | Spectrum, matrix: Array) -> SampledSpectrum:
        r, g, b = colour
        return self._array([r * float(of_r) + g * float(of_g) + b * float(of_b) for of_r, of_g, of_b in matrix.T])

    def _array(self, values: Sequence[Float]) -> SampledSpectrum:
        return self.type(values)
