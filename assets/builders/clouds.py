"""Clouds for a sky picture: a layer of droplets over a round earth, lit and seen from below.

Takes a `Layer`, the sun and directions; gives the light of layer and clear sky
behind it, relative to the clear zenith.  `sky` keeps only its ratio to its own
mean over some 20 degrees, so that the large-scale luminance stays the standard
sky's.  Noise that tiles is thresholded for cover, finer noise frays its edges; light reaches a
droplet from the sun, from the sky above and from the ground, each dimmed by the cloud in between.
Knows nothing of files, nits or USD.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy import fft, ndimage

from synfog_usd.base.arrays import FloatArray
from synfog_usd.base.seeds import stream

EARTH_M = 6_371_000.0
CELLS, LEVELS = 768, 28  # of the layer's box, sideways and upwards
ASYMMETRY = 0.85  # of cloud droplets in the visible
FINER, FINE, THINNED, RELIEF = 7, 0.5, 0.6, 0.35
"""Lumps so much smaller than the box's own: how strongly they fray its edges, what they thin the rest by so that
the cover stays, and how strongly the sun brings them out.
"""


@dataclass(frozen=True)
class CloudLayer:
    """One layer of cloud.

    Attributes:
        base_m: height of its base; depth_m: its thickness.
        cover: share of the columns that hold cloud, 0 to 1.
        size_m: width of its larger features.
        extinction: of its densest parts [1/m].
        edge: width of the step from air to the densest part, in deviations of the noise; small is crisp.
        towers: how much the layer narrows upwards, 0 for a sheet, 2 for cumulus.
        billow: share of rounded lumps in its noise, 0 to 1.
        stretch: length over width of its features.
        turn_deg: compass direction of their length.
        thinnest: density of the thinnest column within the cover, over the densest.
        haze_m: distance over which the air takes its contrast down to 1 / e.
    """

    base_m: float
    depth_m: float
    cover: float
    size_m: float
    extinction: float
    edge: float = 0.8
    towers: float = 0.0
    billow: float = 0.4
    stretch: float = 1.0
    turn_deg: float = 70.0
    thinnest: float = 0.0
    haze_m: float = 25_000.0


@dataclass(frozen=True)
class CloudLight:
    """What falls on the layer; tints are linear Rec.709.

    Attributes:
        sun_height_deg, sun_azimuth_deg: where it comes from; azimuth clockwise from ahead.
        sun: tint times strength of the sun's light.
        sky: of the light from above.
        ground: of the light from below.
        behind: of the clear sky at the zenith; horizon: the same at the horizon.
    """

    sun_height_deg: float
    sun_azimuth_deg: float
    sun: npt.NDArray[np.float64]
    sky: npt.NDArray[np.float64]
    ground: npt.NDArray[np.float64]
    behind: npt.NDArray[np.float64]
    horizon: npt.NDArray[np.float64]


def clouded(
    layer: CloudLayer, light: CloudLight, azimuth: FloatArray, height: FloatArray, name: str, *, cells: int = CELLS
) -> tuple[FloatArray, FloatArray]:
    """Relative light from each direction, and how much of its contrast the air leaves.

    Args:
        azimuth, height: [rad], any shape; heights above 0.
        name: of the random stream.

    Returns:
        (..., 3) light relative to the clear zenith, and (...,) contrast left, 0 to 1.
    """
    cell = layer.size_m / 24.0 * CELLS / cells
    body, rim = _body(layer, cell, cells, name)
    density = np.clip(body, 0, 1) * rim
    like = replace(layer, stretch=1.0, depth_m=layer.depth_m * FINER)  # as deep as broad, seen so much larger
    fine = _noise(like, cell, cells, name, 2, low=0.7, high=5.0)
    rise = layer.depth_m / LEVELS
    thick = np.float32(layer.extinction * rise)
    sunward = _sunward(light, layer, cell)
    pixel = float(np.pi / 2 / azimuth.shape[0])
    tau = density * np.float32(layer.extinction * rise)  # of one level, upwards
    heap = np.cumsum(tau, axis=0, dtype=np.float32)
    above, below = heap[-1] - heap + tau / 2, heap - tau / 2
    slanted = _towards_sun(tau, light, rise, cell)
    toward = _phase_angle(light, azimuth, height)
    glow = np.zeros((*azimuth.shape, 3), dtype=np.float32)
    clear = np.ones(azimuth.shape, dtype=np.float32)
    seen = np.zeros(azimuth.shape, dtype=np.float32)
    cover = _two_stream(above), _two_stream(below)
    for level in range(LEVELS):
        near, far = (_distance(height, layer.base_m + (level + part) * rise) for part in (0.0, 1.0))
        middle = (near + far) / 2
        where = [middle * np.cos(height) * np.cos(azimuth) / cell, middle * np.cos(height) * np.sin(azimuth) / cell]
        blurred = 1 / (1 + (middle * pixel * FINER / (4 * cell)) ** 2)  # of lumps smaller than a ray's breadth
        small = [w * FINER for w in where]
        lump = _at(fine[level], small)
        raised = (lump - _at(fine[level], [w + d for w, d in zip(small, sunward, strict=True)])) * blurred
        frayed = np.float32(FINE / max(layer.edge, 1.0) ** 0.5) * blurred * (lump - np.float32(THINNED))
        dense = np.clip(_at(body[level], where) + frayed, 0, 1) * rim[level]
        step = dense * thick * (far - near) / np.float32(rise)
        weight = clear * -np.expm1(-step)
        sunny, from_above, from_below = (
            _sunlit(_at(slanted[level], where), toward) * np.clip(1 + np.float32(RELIEF) * raised, 0.3, 2.0),
            _at(cover[0][level], where),
            _at(cover[1][level], where),
        )
        for channel in range(3):
            source = light.sun[channel] * sunny + light.sky[channel] * from_above + light.ground[channel] * from_below
            glow[..., channel] += (weight * source).astype(np.float32)
        seen += weight * middle
        clear *= np.exp(-step)
    up = np.sin(height)
    blend = np.exp(-4.0 * up)[..., None]
    air = light.behind * (1 - blend) + light.horizon * blend
    seen = seen + clear * _distance(height, layer.base_m)
    return (glow + clear[..., None] * air).astype(np.float32), np.exp(-seen / layer.haze_m).astype(np.float32)


def _at(field: FloatArray, where: list[FloatArray]) -> FloatArray:
    return np.asarray(ndimage.map_coordinates(field, where, order=1, mode="grid-wrap", output=np.float32))


def _sunward(light: CloudLight, layer: CloudLayer, cell: float) -> npt.NDArray[np.float64]:
    """A step of a few cells of the fine lumps towards the sun, in x and y [cells]."""
    away = np.deg2rad(light.sun_azimuth_deg)
    return np.array([np.cos(away), np.sin(away)]) * layer.size_m / cell / 10.0


def _body(layer: CloudLayer, cell: float, cells: int, name: str) -> tuple[FloatArray, FloatArray]:
    """(LEVELS, cells, cells) density where it is between 0 and 1, and (LEVELS, 1, 1) what the layer's own base and top
    leave of it; the first axis goes up.
    """
    field = _noise(layer, cell, cells, name, 0, low=0.35)
    if layer.billow:
        lumps = np.abs(_noise(layer, cell, cells, name, 1, low=1.2))
        field = (1 - layer.billow) * field + layer.billow * (0.8 - lumps) / 0.6
    z = ((np.arange(LEVELS, dtype=np.float32) + 0.5) / LEVELS)[:, None, None]
    field = field - np.float32(layer.towers) * z**1.3
    edge = np.float32(np.quantile(field.max(axis=0), 1.0 - layer.cover) - layer.thinnest * layer.edge)
    rim = np.minimum(1, z * LEVELS / 2) * np.minimum(
        1, (1 - z) * LEVELS / 3
    )  # the layer's own base and top are no walls
    return np.asarray((field - edge) / np.float32(layer.edge), dtype=np.float32), np.asarray(rim, dtype=np.float32)


def _noise(
    layer: CloudLayer, cell: float, cells: int, name: str, index: int, *, low: float, high: float = np.inf
) -> FloatArray:
    """Noise that tiles sideways, deviation 1: a spectrum f^-11/3 from `low` to about `high` cycles per feature."""
    rng = stream(0, "sky", name, index)
    turn = np.deg2rad(layer.turn_deg)
    fx = (fft.fftfreq(cells, cell) * layer.size_m).astype(np.float32)[None, :, None]
    fy = (fft.rfftfreq(cells, cell) * layer.size_m).astype(np.float32)[None, None, :]
    fz = (fft.fftfreq(2 * LEVELS, layer.depth_m / LEVELS) * layer.size_m).astype(np.float32)[:, None, None]
    along, across = fx * np.cos(turn) + fy * np.sin(turn), fy * np.cos(turn) - fx * np.sin(turn)
    f = np.sqrt((along * layer.stretch) ** 2 + across**2 + fz**2)
    power = np.where(f > low, np.maximum(f, low) ** np.float32(-11 / 6), 0)
    power = power * np.exp(-((f / np.float32(high)) ** 2))
    spectrum = power * (
        rng.standard_normal(f.shape, dtype=np.float32) + 1j * rng.standard_normal(f.shape, dtype=np.float32)
    )
    field = fft.irfftn(spectrum.astype(np.complex64), s=(2 * LEVELS, cells, cells))[:LEVELS]
    return np.asarray((field - field.mean()) / field.std(), dtype=np.float32)


def _towards_sun(tau: FloatArray, light: CloudLight, rise: float, cell: float) -> FloatArray:
    """Optical depth from the middle of each cell to the sun; a sun at the horizon shines up from below the layer."""
    upwards = light.sun_height_deg > 2.0
    slope = np.deg2rad(max(light.sun_height_deg, 7.0) if upwards else 8.0)
    away = np.deg2rad(light.sun_azimuth_deg)
    step = rise / np.tan(slope) / cell
    shift = np.array([np.cos(away), np.sin(away)]) * step
    result = np.empty_like(tau)
    carried = np.zeros_like(tau[0])
    order = range(LEVELS - 1, -1, -1) if upwards else range(LEVELS)
    for level in order:
        own = tau[level] / np.float32(np.sin(slope))
        result[level] = carried + own / 2
        carried = _rolled(carried + own, shift)  # what stands towards the sun shades what lies one level on
    return result


def _rolled(field: FloatArray, shift: npt.NDArray[np.float64]) -> FloatArray:
    """field(x + shift), wrapped, linear between cells."""
    for axis in (0, 1):
        whole = int(np.floor(shift[axis]))
        part = np.float32(shift[axis] - whole)
        field = np.roll(field, -whole, axis) * (1 - part) + np.roll(field, -whole - 1, axis) * part
    return field


def _two_stream(tau: FloatArray) -> FloatArray:
    """Share of diffuse light that comes through droplets that absorb nothing."""
    return np.asarray(1.0 / (1.0 + 0.75 * (1 - ASYMMETRY) * tau), dtype=np.float32)


def _sunlit(tau: FloatArray, toward: tuple[FloatArray, ...]) -> FloatArray:
    """Sunlight turned towards the eye: once, and in orders that forget where they came from (Wrenninge et al. 2013)."""
    result = 0.35 * _two_stream(tau)
    for order, phase in enumerate(toward):
        result = result + 0.5**order * phase * np.exp(-(0.35**order) * tau)
    return np.asarray(result, dtype=np.float32)


def _phase_angle(light: CloudLight, azimuth: FloatArray, height: FloatArray) -> tuple[FloatArray, ...]:
    """Phase function over that of even scattering, for three orders, each flatter."""
    sun = np.deg2rad(light.sun_height_deg)
    cosine = np.sin(height) * np.sin(sun) + np.cos(height) * np.cos(sun) * np.cos(
        azimuth - np.deg2rad(light.sun_azimuth_deg)
    )

    def lobe(g: float) -> FloatArray:
        return np.asarray((1 - g * g) / (1 + g * g - 2 * g * cosine) ** 1.5, dtype=np.float32)

    return tuple(
        np.asarray(0.85 * lobe(0.7 * 0.6**k) + 0.15 * lobe(-0.25 * 0.6**k), dtype=np.float32) for k in range(3)
    )


def _distance(height: FloatArray, level_m: float) -> FloatArray:
    """How far off a ray meets a level of the air [m], over a round earth."""
    rise = EARTH_M * np.sin(height)
    return np.asarray(np.sqrt(rise * rise + 2 * EARTH_M * level_m + level_m * level_m) - rise, dtype=np.float32)
