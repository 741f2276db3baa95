"""Skies as lat-long pictures: sixteen cloudy ones by name, and the two of the crossing.

`SKIES` is the one table: what each sky is, how much light it gives and of what
colour.  A picture of it holds linear Rec.709 in cd m-2, 1280 by 640 half floats: 0.3 degrees
a row, and none of them shows the sun's disc.  Row 0 is the zenith; how it lies on the
sphere says `synfog_usd.world.skies`, which reads what the files say of themselves.

The crossing's two (`overcast`, `dusk`) are older: relative to the dome's intensity.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import OpenImageIO
from PIL import Image, ImageDraw, ImageFont
from scipy import ndimage, optimize

from assets.builders.clouds import CELLS, CloudLayer, CloudLight, clouded
from assets.builders.daylight import LUMINANCE, colour_temperature, illuminance_per_zenith, relative_luminance, tint
from assets.builders.textures import ORIGIN, noise
from synfog_usd.base.arrays import Array
from synfog_usd.base.colour import srgb_encode
from synfog_usd.base.errors import OutputError, ParameterError, did_you_mean
from synfog_usd.base.files import write_whole
from synfog_usd.base.science import colour_science

SIZE = (512, 1024)


ROWS = 640  # of a cloudy sky, twice as many columns
FINER = 2  # rays per row: clouds near the horizon are much flatter than a row
CRISP = 0.5  # edge of a layer below which its outlines are sharper than a pixel
CAP_DEG = 20.0  # a sky is the standard sky on average over caps of about this radius
AUREOLE_DEG = 15.0  # nearer to the sun the standard sky rises no more: a cloud hides it
GLOW_DEG = 5.0  # by which the glow of a hidden sun falls to 1 / e
HAZE_DEG = 2.0  # below the horizon the air still shines
WARM_DEG, WARMTH = 45.0, 3.0  # sun through thin cloud shows around the sun, so much more than on average
GROUND = 0.12  # diffuse reflectance of what lies below


@dataclass(frozen=True)
class Sky:
    """One cloudy sky.

    Attributes:
        about: one sentence.
        cie: type of standard sky, ISO 15469:2004.
        sun_height_deg: of the sun, which no picture shows; below 0 the standard sky is
            taken with the sun at the horizon, where its definition ends.
        illuminance_lx: on level ground, from the whole sky.
        light: its colour: share from cloud, share of sun through thin cloud; or `lamps_k`.
        layers: of cloud, the highest first.
        sun: strength of the sun on the clouds over that of the sky.
        contrast: gain on the clouds' deviation from the standard sky.
        glow: of the sun behind thin cloud, over the sky there.
        sun_azimuth_deg: clockwise from ahead.
        lamps_k: colour temperature where a town lights the clouds from below.
    """

    about: str
    cie: int
    sun_height_deg: float
    illuminance_lx: float
    cloud_light: float
    layers: tuple[CloudLayer, ...]
    sun: float = 4.0
    through: float = 0.0
    contrast: float = 1.0
    glow: float = 0.0
    sun_azimuth_deg: float = 35.0
    lamps_k: float | None = None

    @property
    def cie_sun_height_deg(self) -> float:
        """Height of the sun in the standard sky's formula."""
        return max(self.sun_height_deg, 0.0)

    @property
    def zenith_nits(self) -> float:
        """Luminance of the standard sky at the zenith [cd m-2]; clouds deviate from it, a cap's mean does not."""
        return self.illuminance_lx / illuminance_per_zenith(self.cie, self.cie_sun_height_deg)

    @property
    def cct_k(self) -> float:
        """Correlated colour temperature of the light on level ground [K]."""
        return self.lamps_k or colour_temperature(self.sun_height_deg, cover=self.cloud_light, through=self.through)


_STRATUS = CloudLayer(
    600, 400, 1.0, 2000, 0.03, edge=1.8, towers=1.2, billow=0.35, stretch=1.2, thinnest=0.3, haze_m=12_000
)
_ALTOSTRATUS = CloudLayer(3200, 900, 1.0, 5000, 0.006, edge=3.5, billow=0.0, stretch=1.5, haze_m=60_000)
_STRATOCUMULUS = CloudLayer(1100, 450, 0.97, 1500, 0.035, edge=1.2, towers=0.6, billow=0.5, stretch=1.15, haze_m=25_000)
_CUMULUS = CloudLayer(1200, 1300, 0.5, 2400, 0.05, edge=0.35, towers=1.6, billow=0.45, haze_m=30_000)
_ALTOCUMULUS = CloudLayer(3600, 300, 0.7, 1000, 0.02, edge=0.9, towers=0.5, billow=0.5, stretch=1.1, haze_m=32_000)
_NIMBOSTRATUS = CloudLayer(
    900, 900, 1.0, 3000, 0.05, edge=1.7, towers=1.3, billow=0.35, stretch=1.2, thinnest=0.2, haze_m=14_000
)
_SCUD = CloudLayer(400, 300, 0.45, 1100, 0.03, edge=1.0, towers=0.8, billow=0.3, stretch=1.3, haze_m=8_000)


def _like(layer: CloudLayer, **changes: float) -> CloudLayer:
    return replace(layer, **changes)


SKIES: Mapping[str, Sky] = {
    "overcast_noon": Sky(
        "A closed layer of cloud at noon.",
        1,
        45.0,
        12_000.0,
        1.0,
        (_like(_STRATOCUMULUS, cover=1.0, edge=1.7, size_m=2300, depth_m=700),),
        contrast=0.9,
    ),
    "bright_overcast": Sky(
        "High thin altostratus; one sees where the sun is.",
        4,
        50.0,
        20_000.0,
        0.95,
        (_like(_ALTOSTRATUS, extinction=0.003),),
        through=0.15,
        glow=1.4,
    ),
    "stratocumulus_noon": Sky("Stratocumulus with a few gaps.", 3, 40.0, 14_000.0, 0.95, (_STRATOCUMULUS,), glow=0.5),
    "stratus_winter": Sky(
        "Low stratus over a winter noon.", 5, 14.0, 5_000.0, 1.0, (_STRATUS,), contrast=2.2, glow=0.3
    ),
    "rain": Sky(
        "Nimbostratus with scud below it; steady rain.", 1, 30.0, 3_500.0, 1.0, (_NIMBOSTRATUS, _SCUD), contrast=2.2
    ),
    "storm_front": Sky(
        "Dark shower clouds, thinner light between them.",
        3,
        25.0,
        1_800.0,
        1.0,
        (_like(_NIMBOSTRATUS, cover=0.995, edge=1.0, towers=1.7, depth_m=1500, thinnest=0.0),),
        contrast=0.55,
        glow=0.4,
    ),
    "broken_noon": Sky(
        "Broken cumulus, the sun behind one of them.",
        8,
        48.0,
        24_000.0,
        0.7,
        (_like(_CUMULUS, cover=0.62),),
        through=0.1,
        glow=0.2,
    ),
    "broken_afternoon": Sky(
        "Scattered cumulus in the afternoon.", 7, 25.0, 13_000.0, 0.5, (_CUMULUS,), through=0.1, glow=0.25
    ),
    "altocumulus_morning": Sky(
        "A mackerel sky of altocumulus in the morning.", 6, 18.0, 8_000.0, 0.7, (_ALTOCUMULUS,), glow=0.2
    ),
    "morning_mist": Sky(
        "Mist and thin stratus soon after sunrise, near to white.",
        6,
        8.0,
        4_500.0,
        0.95,
        (_like(_STRATUS, base_m=250, extinction=0.01, haze_m=4_000),),
        through=0.2,
        glow=1.5,
    ),
    "low_sun_stratus": Sky(
        "A low sun behind stratus, a warm glow over the road.",
        4,
        5.0,
        1_800.0,
        0.9,
        (_like(_STRATUS, edge=1.8, extinction=0.012),),
        through=0.25,
        contrast=1.5,
        glow=2.2,
    ),
    "evening_cumulus": Sky(
        "Cumulus in the last sunlight.",
        7,
        3.0,
        1_100.0,
        0.45,
        (_like(_CUMULUS, cover=0.45),),
        through=0.25,
        sun=3.0,
        glow=0.6,
    ),
    "sunset_altocumulus": Sky(
        "Altocumulus lit from below at sunset.", 9, 0.0, 350.0, 0.6, (_ALTOCUMULUS,), sun=0.9, through=0.25, glow=1.0
    ),
    "dusk_overcast": Sky(
        "Blue dusk under closed stratocumulus.", 4, -3.0, 25.0, 1.0, (_like(_STRATOCUMULUS, cover=0.995),), sun=0.0
    ),
    "deep_dusk": Sky(
        "The end of civil twilight behind broken cloud.",
        9,
        -6.0,
        2.0,
        0.6,
        (_like(_STRATOCUMULUS, cover=0.7),),
        sun=0.0,
        through=0.06,
    ),
    "night_glow": Sky(
        "Night over a town, whose lamps light the clouds from below.",
        9,
        -25.0,
        0.15,
        1.0,
        (_like(_STRATUS, edge=2.0, extinction=0.01, thinnest=0.06),),
        sun=0.0,
        lamps_k=3200.0,
        contrast=1.3,
    ),
}
"""The sixteen, from noon to night."""


def sky_of(name: str) -> Sky:
    """The sky of this name.

    Raises:
        ParameterError: another name.
    """
    if name not in SKIES:
        raise ParameterError(f"sky {name!r} does not exist; it can be {', '.join(SKIES)}.{did_you_mean(name, SKIES)}")
    return SKIES[name]


def write_cloudy(folder: Path, only: Sequence[str] = ()) -> Iterator[Path]:
    """Write all of `SKIES`, or those named, into `folder`, one a core at a time; gives the files."""
    names = [name for name in SKIES if not only or name in only]
    with ProcessPoolExecutor(os.cpu_count(), multiprocessing.get_context("spawn")) as pool:
        yield from pool.map(_write_nits, (folder / f"{name}.exr" for name in names), names)


def paint(name: str, *, rows: int = ROWS, cells: int = CELLS) -> Array:
    """A sky as (rows, 2 rows, 3) linear Rec.709 [cd m-2].

    The standard sky gives the luminance of each cap of some 20 degrees, the clouds the
    deviations within it; one factor then sets the illuminance, gains from red to blue its colour.

    Args:
        name: of the sky.
        rows: of the picture, which shows the same clouds at any number of them.
        cells: of the clouds' box; another number makes other clouds, in less time.

    Raises:
        ParameterError: another name.
    """
    sky = sky_of(name)
    half = rows // 2
    height = np.pi / 2 - (np.arange(half * FINER) + 0.5) / (half * FINER) * np.pi / 2
    azimuth = (np.arange(2 * rows) + 0.5) / (2 * rows) * 2 * np.pi
    a, h = np.meshgrid(azimuth, height)
    sun = np.deg2rad(sky.sun_azimuth_deg)
    light = _light(sky, a)
    for index, layer in enumerate(sky.layers):
        seen, left = clouded(layer, light, a.astype(np.float32), h.astype(np.float32), f"{name} {index}", cells=cells)
        light = _in_front(light, seen)
    seen, left = (x.astype(np.float64).reshape(half, FINER, *x.shape[1:]).mean(axis=1) for x in (seen, left))
    if min(layer.edge for layer in sky.layers) < CRISP:
        seen, left = _softened(seen), _softened(left)
    height = height.reshape(half, FINER).mean(axis=1)
    a, h = np.meshgrid(azimuth, height)
    mean = _smooth(seen, h, a)
    level = (mean @ LUMINANCE)[..., None]
    low = np.deg2rad(sky.cie_sun_height_deg)
    chi = np.arccos(np.clip(np.sin(h) * np.sin(low) + np.cos(h) * np.cos(low) * np.cos(a - sun), -1, 1))
    standard = relative_luminance(sky.cie, np.pi / 2 - h, np.maximum(chi, np.deg2rad(AUREOLE_DEG)), np.pi / 2 - low)[
        ..., None
    ]
    ratio = _tempered(mean / level + sky.contrast * left[..., None] * (seen - mean) / level)
    ratio /= (_smooth(ratio, h, a) @ LUMINANCE)[..., None]  # tempering and contrast have moved the mean
    share = np.clip(sky.through * WARMTH * np.exp(-((chi / np.deg2rad(WARM_DEG)) ** 2)), 0, 0.9)[..., None]
    upper = standard * ratio * (1 - share + share * _sunlight(sky))
    upper *= 1 + sky.glow * np.exp(-np.rad2deg(chi) / GLOW_DEG)[..., None] * np.minimum(ratio, 1.6)
    weight = (np.sin(h) * np.cos(h))[..., None] * (np.pi / 2 / half) * (2 * np.pi / (2 * rows))
    upper *= _balance((upper * weight).sum(axis=(0, 1)), sky.cct_k)
    on_ground = (upper * weight).sum(axis=(0, 1))
    upper *= sky.illuminance_lx / float(on_ground @ LUMINANCE)
    ground = GROUND * sky.illuminance_lx / np.pi * on_ground / float(on_ground @ LUMINANCE)
    below = np.exp(-np.rad2deg((np.arange(rows - half) + 0.5) * np.pi / rows) / HAZE_DEG)[:, None, None]
    rim = ndimage.uniform_filter1d(upper[-1], rows // 4, axis=0, mode="wrap")
    return np.concatenate([upper, ground + (rim - ground) * below])


def _balance(rgb: Array, cct_k: float) -> Array:
    """Gains from red to blue that bring light to a correlated colour temperature; how pink or green it is stays.

    Source of CCT: Hernandez-Andres, Lee and Romero (1999), from colour-science.
    """
    colour = colour_science()
    matrix = colour.RGB_COLOURSPACES["ITU-R BT.709"].matrix_RGB_to_XYZ

    def gains(slope: float) -> Array:
        return np.exp([slope, 0.0, -slope])

    def excess(slope: float) -> float:
        xyz = matrix @ (rgb * gains(slope))
        return float(colour.temperature.xy_to_CCT_Hernandez1999(xyz[:2] / xyz.sum())) - cct_k

    return gains(float(optimize.brentq(excess, -0.4, 0.4, xtol=1e-6)))


def _sunlight(sky: Sky) -> Array:
    """Tint of the sun at its height; below 2000 K there is no blue left."""
    return np.array(
        tint(float(np.interp(sky.sun_height_deg, [-6, 0, 3, 10, 30, 60], [1900, 2000, 2500, 3800, 5000, 5500])))
    )


def _tempered(ratio: Array) -> Array:
    """Deviation from the standard sky, kept between 0.04 and 2.2, gently above 1.3."""
    over = np.maximum(ratio - 1.3, 0)
    return np.maximum(np.minimum(ratio, 1.3) + over / (1 + over / 0.9), 0.04)


def _light(sky: Sky, azimuth: Array) -> CloudLight:
    """What falls on the clouds, by the height of the sun."""
    if sky.lamps_k:
        town, dark = np.array(tint(sky.lamps_k)), np.array(tint(6000.0))
        return CloudLight(sky.sun_height_deg, sky.sun_azimuth_deg, 0 * dark, 0.1 * dark, town, 0.12 * dark, 0.4 * town)
    h = max(sky.sun_height_deg, -6.0)
    warm = _sunlight(sky)
    closed = any(layer.cover >= 0.95 for layer in sky.layers)  # a thick layer mixes sun and sky
    sun = 0.15 * warm + 0.85 if closed else warm
    dome = float(np.interp(h, [-6, -3, 0, 10], [0.6, 1.0, 1.6, 2.0]))
    blue = np.array(tint(float(np.interp(h, [-6, 0, 20], [20000, 14000, 14000]))))
    above = np.array(tint(float(np.interp(h, [-6, 0, 20], [14000, 9000, 7500]))))
    pale = np.array(tint(float(np.interp(h, [-6, 0, 20], [9500, 7500, 8000]))))
    towards = np.exp(-((1 - np.cos(azimuth - np.deg2rad(sky.sun_azimuth_deg))) / 0.35))[..., None]
    glow = float(np.interp(h, [-6, -3, 0, 5, 20], [1.2, 2.0, 2.5, 1.5, 0.0]))
    horizon = 1.6 * pale + glow * towards * warm
    return CloudLight(
        sky.sun_height_deg,
        sky.sun_azimuth_deg,
        sky.sun * sun,
        dome * above,
        0.12 * dome * (above + sun) / 2,
        blue,
        horizon,
    )


def _in_front(light: CloudLight, seen: Array) -> CloudLight:
    """The light on a lower layer: in the shade of the upper, which stands behind it."""
    mean = seen.mean(axis=(0, 1))
    return replace(light, sun=0 * light.sun, sky=mean, ground=0.1 * mean, behind=seen, horizon=seen)


def _softened(picture: Array) -> Array:
    """Edges over two pixels instead of none: a camera shows a pixel of a sky six pixels wide, and its corners."""
    rows = ndimage.convolve1d(picture, (0.25, 0.5, 0.25), axis=0, mode="nearest")
    return ndimage.convolve1d(rows, (0.25, 0.5, 0.25), axis=1, mode="wrap")


def _smooth(light: Array, height: Array, azimuth: Array) -> Array:
    """Mean over a cap around each direction, a von Mises-Fisher kernel on the upper half sphere."""
    towards = np.stack([np.cos(height) * np.cos(azimuth), np.cos(height) * np.sin(azimuth), np.sin(height)], axis=-1)
    step = max(light.shape[0] // 32, 1)
    sharp = 1.0 / np.deg2rad(CAP_DEG) ** 2
    few = np.array(
        [
            light[i : i + step, j : j + step].mean(axis=(0, 1))
            for i in range(0, light.shape[0], step)
            for j in range(0, light.shape[1], step)
        ]
    )
    where = np.array(
        [
            towards[i : i + step, j : j + step].mean(axis=(0, 1))
            for i in range(0, light.shape[0], step)
            for j in range(0, light.shape[1], step)
        ]
    )
    area = np.hypot(where[:, 0], where[:, 1])  # of a cell, to a factor
    where /= np.linalg.norm(where, axis=1, keepdims=True)
    result = np.empty_like(light)
    for row in range(light.shape[0]):
        kernel = np.exp(sharp * (towards[row] @ where.T - 1)) * area
        result[row] = kernel @ few / kernel.sum(axis=1, keepdims=True)
    return result


def _write_nits(path: Path, name: str) -> Path:
    sky = sky_of(name)
    metadata: dict[str, object] = {
        "synfog:sky": name,
        "synfog:about": sky.about,
        "synfog:cieSky": sky.cie,
        "synfog:zenithNits": float(f"{sky.zenith_nits:.4g}"),
        "synfog:illuminanceLux": sky.illuminance_lx,
        "synfog:cctKelvin": sky.cct_k,
        "synfog:sunHeightDeg": sky.sun_height_deg,
        "synfog:sunAzimuthDeg": sky.sun_azimuth_deg,
        "synfog:spectrum": "linear Rec.709 in cd m-2, (1, 1, 1) is 1 nit of D65",
    }
    return _write_pixels(path, _shorter(paint(name)), metadata)


def _shorter(pixels: Array) -> Array:
    """Seven bits of mantissa: steps of 0.4 % at most, and files a third shorter."""
    mantissa, exponent = np.frexp(pixels)
    return np.ldexp(np.round(mantissa * 256) / 256, exponent)


def write_skies(folder: Path) -> list[Path]:
    """Write both skies into `folder` as half-float EXR; gives the files."""
    skies = {"overcast.exr": overcast(), "dusk.exr": dusk()}
    return [_write(folder / name, picture) for name, picture in skies.items()]


def overcast() -> Array:
    """CIE overcast sky, L = Lz (1 + 2 sin h) / 3, under a textured layer of cloud; 1 at the zenith on average."""
    azimuth, height = _directions()
    base = (1 + 2 * np.sin(np.maximum(height, 0))) / 3
    cloud = _layer(azimuth, height, "overcast", 0, 2.6) * 0.75 + _layer(azimuth, height, "overcast", 1, 1.9) * 0.25
    luminance = base * np.clip(1 + 0.15 * cloud, 0.6, 1.5)
    brighter = 1 + 0.14 * np.cos(azimuth - 0.7) * np.cos(height)  # where the sun is behind the cloud
    tint = np.stack([0.975 + 0.02 * cloud, np.ones_like(cloud), 1.06 - 0.03 * cloud], axis=-1)
    sky = (luminance * brighter)[..., None] * np.clip(tint, 0.8, 1.2)
    return np.where(height[..., None] > 0, sky, 0.035 * np.ones(3))


def dusk() -> Array:
    """A quarter of an hour after sunset ahead: blue above, a low band of orange, thin streaks of cloud."""
    azimuth, height = _directions()
    up = np.clip(np.sin(np.maximum(height, 0)), 0, 1)
    towards = 0.5 + 0.5 * np.cos(azimuth)
    zenith, rim = np.array([0.34, 0.52, 1.12]), np.array([0.72, 0.78, 1.05])
    sky = zenith + (rim - zenith) * (np.exp(-4.0 * up) * (0.45 + 0.75 * towards))[..., None]
    sky = sky + np.array([2.7, 1.15, 0.36]) * (np.exp(-9.0 * up) * towards**3)[..., None] * 1.2
    streak = _layer(azimuth, height, "dusk", 0, 2.5)
    cover = np.clip(0.35 + 0.5 * streak, 0, 1)[..., None] * (1 - np.exp(-8 * up))[..., None]
    cloud = np.array([0.42, 0.44, 0.62]) + np.array([1.2, 0.5, 0.35]) * (towards**2 * np.exp(-3 * up))[..., None]
    sky = sky * (1 - 0.65 * cover) + 0.65 * cover * cloud
    return np.where(height[..., None] > 0, sky, 0.03 * np.ones(3))


def _directions() -> tuple[Array, Array]:
    """Angle from straight ahead (the picture's left edge) and height above the horizon [rad]."""
    h, w = SIZE
    height = np.pi / 2 - (np.arange(h) + 0.5) / h * np.pi
    azimuth = (np.arange(w) + 0.5) / w * 2 * np.pi
    grid = np.meshgrid(height, azimuth, indexing="ij")
    return grid[1], grid[0]


def _layer(azimuth: Array, height: Array, name: str, index: int, beta: float) -> Array:
    """Noise on a flat layer overhead, seen in perspective; fades to its mean at the horizon."""
    field = noise((512, 512), beta, "sky", name, index, low=2, high=120)
    flat = 1.0 / (np.sin(np.maximum(height, 0.0)) + 0.09)
    x, y = 62 * flat * np.cos(azimuth) * np.cos(height), 62 * flat * np.sin(azimuth) * np.cos(height)
    value = ndimage.map_coordinates(field, [x, y], order=1, mode="grid-wrap")
    return value * np.clip(height / 0.25, 0, 1)


def _write(path: Path, picture: Array) -> Path:
    return _write_pixels(path, np.round(picture * 512) / 512, {})  # fewer bits to store; 0.2 % of the zenith


def _write_pixels(path: Path, picture: Array, metadata: Mapping[str, object]) -> Path:
    pixels = np.ascontiguousarray(picture.astype(np.float16))

    def put(target: Path) -> None:
        spec = OpenImageIO.ImageSpec(pixels.shape[1], pixels.shape[0], 3, "half")
        spec.attribute("compression", "zip")
        spec.attribute("whiteLuminance", 1.0)
        spec.attribute("ImageDescription", ORIGIN)
        spec.attribute("DateTime", "2000:01:01 00:00:00")  # else the hour of writing would change the bytes
        for key, value in metadata.items():
            spec.attribute(key, value)
        output = OpenImageIO.ImageOutput.create(str(target))
        if output is None or not output.open(str(target), spec) or not output.write_image(pixels) or not output.close():
            raise OutputError(f"{path}: cannot be written; choose another output folder")

    write_whole(path, put)
    return path


def sheet(path: Path, folder: Path) -> Path:
    """All of `SKIES` as one PNG: looking up (ahead is at the top), and all round from the horizon to 60 degrees.

    Each is exposed by its own mean and balanced for D65; its figures stand below.

    Args:
        path: of the PNG; folder: with the EXR files.

    Raises:
        ParameterError: a file is missing or is no such sky.
    """
    disc, strip, text, gap = 110, 330, 18, 8
    cell = disc + gap + strip
    columns = 2
    lines = -(-len(SKIES) // columns)
    picture = Image.new("RGB", (columns * cell + (columns + 1) * gap, lines * (disc + text) + gap), (24, 24, 26))
    draw = ImageDraw.Draw(picture)
    font = ImageFont.load_default(11)
    for index, (name, sky) in enumerate(SKIES.items()):
        x, y = gap + index // lines * (cell + gap), gap + index % lines * (disc + text)
        shown = _exposed(_read(folder / f"{name}.exr"))
        picture.paste(Image.fromarray(_looking_up(shown, disc)), (x, y))
        upper = Image.fromarray(shown[len(shown) // 6 : len(shown) // 2])
        picture.paste(
            upper.resize((strip, strip // 6), Image.Resampling.LANCZOS), (x + disc + gap, y + disc - strip // 6)
        )
        draw.text((x + disc + gap, y), name.replace("_", " "), (235, 235, 235), ImageFont.load_default(15))
        for line, words in enumerate(_figures(sky)):
            draw.text((x + disc + gap, y + 20 + 14 * line), words, (170, 170, 175), font)

    def put(target: Path) -> None:
        picture.save(target, optimize=True)

    write_whole(path, put)
    return path


def _figures(sky: Sky) -> tuple[str, str]:
    sun = "lit by the town" if sky.lamps_k else f"sun {sky.sun_height_deg:g}°"
    nits = f"{sky.zenith_nits:,.0f}" if sky.zenith_nits >= 100 else f"{sky.zenith_nits:.2g}"
    return (
        f"{sky.illuminance_lx:,g} lx on the ground, zenith {nits} nits",
        f"{sky.cct_k:,.0f} K, {sun}, CIE sky {sky.cie}",
    )


def _read(path: Path) -> Array:
    pixels = OpenImageIO.ImageBuf(str(path)).get_pixels(OpenImageIO.FLOAT) if path.is_file() else None
    if pixels is None or pixels.ndim != 3 or pixels.shape[2] != 3:
        raise ParameterError(f"{path}: is not a sky; write them with 'python -m assets.builders skies'")
    return np.asarray(pixels, dtype=np.float64)


def _exposed(pixels: Array) -> npt.NDArray[np.uint8]:
    """8-bit sRGB with the mean of the upper half at middle grey and the highlights rolled off."""
    light = 0.5 * pixels / (pixels[: len(pixels) // 2] @ LUMINANCE).mean()
    light = light * (1 + light / 9.0) / (1 + light)  # Reinhard et al. (2002), white at 3 times the mean
    return np.asarray(np.round(srgb_encode(light * 1.15) * 255), dtype=np.uint8)


def _looking_up(shown: npt.NDArray[np.uint8], size: int) -> npt.NDArray[np.uint8]:
    """The upper half sphere as an equidistant disc, ahead at the top, right at the left as one sees it lying down."""
    y, x = np.meshgrid(*[(np.arange(size) + 0.5) / size * 2 - 1] * 2, indexing="ij")
    angle, turn = np.hypot(x, y), np.arctan2(-x, -y) / (2 * np.pi)
    rows = angle * len(shown) / 2 - 0.5
    columns = turn % 1.0 * shown.shape[1] - 0.5
    disc = np.stack(
        [
            ndimage.map_coordinates(shown[..., c].astype(float), [rows, columns], order=1, mode="grid-wrap")
            for c in range(3)
        ],
        axis=-1,
    )
    return np.where(angle[..., None] < 1, disc, 24).astype(np.uint8)
