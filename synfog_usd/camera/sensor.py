"""Ops of the sensor in the order of EMVA 1288: from irradiance to numbers.

Electrons and DN are mosaics of one channel, 'CFA', behind the filters of the
profile's pattern.  Temporal noise comes from the node's own stream; PRNU, DSNU and
the patterns of rows and columns from the specimen's serial number, the same in every frame.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np

from synfog_usd.base import photometry, seeds
from synfog_usd.base.arrays import STRIP_ROWS, FloatArray, at_least, at_most, strips
from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import PARALLEL_DEG, Image, Quantity
from synfog_usd.camera import cfa, noise, response
from synfog_usd.camera.graph import Auto, FromProfile, Port, Range
from synfog_usd.camera.profiles import SensorProfile
from synfog_usd.camera.registry import OPS

MEAN, COUNTED, READ_OUT = "mean", "with shot noise", "with read noise"
"""Stages of electrons: what light and heat free on average, what came in one exposure, and what the pixel's amplifier
made of it.
"""

ELECTRONS = Port(Quantity.ELECTRONS, "mosaic")
MEAN_ELECTRONS = Port(Quantity.ELECTRONS, "mosaic", (MEAN,))
HELD_ELECTRONS = Port(Quantity.ELECTRONS, "mosaic", (MEAN, COUNTED))
COUNTED_ELECTRONS = Port(Quantity.ELECTRONS, "mosaic", (COUNTED,))
READ_ELECTRONS = Port(Quantity.ELECTRONS, "mosaic", (READ_OUT,))
AMPLIFIED = Port(Quantity.DN, "analog")
NUMBERS = Port(Quantity.DN, "mosaic")

MAX_MEAN_E = 1e15
"""A million times any well; numpy draws Poisson numbers up to 9e18."""

TILE_PX = 256
"""Side of the parts in which fixed patterns are drawn [px]."""

SPECIMEN_MARK = ":"
"""Between a profile's serial number and the specimen of a rig."""


@OPS.op("sensor.expose", takes=Quantity.IRRADIANCE, gives=MEAN_ELECTRONS)
def expose(
    image: Image,
    *,
    exposure_s: Annotated[float, Range(0.0, 3600.0, above=True), Auto()],
    pixel_pitch_um: Annotated[float, Range(0.3, 50.0), FromProfile("sensor.pixel_pitch_um")],
    fill_factor: Annotated[float, Range(0.01, 1.0), FromProfile("sensor.fill_factor")],
    exposure_ratio: Annotated[float, Range(0.0, 1.0, above=True)] = 1.0,
    shutter: Literal["rolling", "global_reset"] = "rolling",
    readout_s: Annotated[float, Range(0.0, 10.0), FromProfile("sensor.readout_s")] = 0.0,
    sensor: Annotated[SensorProfile, FromProfile("sensor")],
) -> Image:
    """Mean number of electrons that light frees in each pixel behind its colour filter.

    mu = r t * A * integral of E QE lambda / (h c) d lambda.  One pixel of the image
    is one pixel of the sensor: a smaller picture is a crop, not a binned frame.

    Under global reset all rows begin together and end as they are read: a row at the height v of the picture, 0 to 1
    from the top, lasts r t + v * readout_s.  Automatic exposure meters the top row's time.

    Args:
        image: irradiance (H, W, C), R, G, B [lux] or bands [W m-2 nm-1].
        exposure_s: t [s].
        pixel_pitch_um: side of a pixel [um]; twice the sensor's for 2 x 2 binning.
        fill_factor: light-sensitive part [1]; for the small diode of a split pixel,
            its sensitivity relative to one that fills the pixel.
        exposure_ratio: r, the part of t that this exposure lasts [1]; for the short
            exposures of a high dynamic range.
        shutter: rolling, where rows last alike, or global_reset.
        readout_s: under global reset, from the top row's end to the bottom row's [s].
        sensor: its pattern and quantum efficiency count.

    Source: EMVA 1288 release 4.0, section 2.1; global reset release, as data sheets of onsemi's and Teledyne's
    rolling-shutter sensors define it.
    """
    rate = response.electrons_per_second(sensor, image.channels, pixel_pitch_um=pixel_pitch_um, fill_factor=fill_factor)
    time_s = exposure_s * exposure_ratio
    weights = (rate * time_s).astype(np.float32)
    mosaic = np.empty((image.height_px, image.width_px, 1), dtype=np.float32)
    first, *other_factors = (cfa.factors(sensor.cfa, column, STRIP_ROWS, image.width_px) for column in weights.T)
    for strip in strips(image.height_px):  # of whole patterns
        rows = image.pixels[strip]
        total = rows[..., 0] * first[: len(rows)]
        for channel, here in enumerate(other_factors, start=1):
            total += rows[..., channel] * here[: len(rows)]
        at_least(total, 0.0, out=mosaic[strip, :, 0])
    reset = {"global_reset_s": readout_s} if shutter == "global_reset" else {}
    if reset:
        mosaic *= row_times(reset | {"exposure_s": time_s}, image.height_px)
    return image.with_pixels(mosaic, channels=("CFA",), quantity=Quantity.ELECTRONS).with_metadata(
        **reset,
        exposure_s=time_s,
        gathered_um2_s=time_s * fill_factor * pixel_pitch_um**2,
        pixel_pitch_um=pixel_pitch_um,
        sensor=sensor.name,
        sensor_title=sensor.title,
        sensor_serial=serial_of(image, sensor.serial),
        cfa_pattern=sensor.cfa,
        spectra=photometry.spectra_of(image.channels),
        **_focal_length(image, pixel_pitch_um),
    )


@OPS.op("sensor.prnu", takes=MEAN_ELECTRONS, gives=MEAN_ELECTRONS)
def prnu(
    image: Image,
    *,
    prnu_percent: Annotated[float, Range(0.0, 20.0), FromProfile("sensor.prnu_percent")],
    serial: Annotated[str, FromProfile("sensor.serial")],
) -> Image:
    """Photo response non-uniformity: every pixel has a gain of its own, for ever.

    Args:
        image: mean electrons.
        prnu_percent: standard deviation of the gain [%].
        serial: which specimen.

    Source: EMVA 1288 release 4.0, section 4.
    """
    pattern_values, pixels = pattern_of(image, serial, "prnu"), np.empty_like(image.pixels)
    for rows in strips(image.height_px):
        gain = pattern_values[rows] * np.float32(prnu_percent / 100.0)
        gain += np.float32(1.0)
        gain *= image.pixels[rows]
        at_least(gain, 0.0, out=pixels[rows])
    return image.with_pixels(pixels)


@OPS.op("sensor.dark_current", takes=MEAN_ELECTRONS, gives=MEAN_ELECTRONS)
def dark_current(
    image: Image,
    *,
    dark_current_e_s: Annotated[float, Range(0.0, 1e7), FromProfile("sensor.dark_current_e_s")],
    temperature_c: Annotated[float, Range(-60.0, 150.0)] = 25.0,
    doubling_k: Annotated[float, Range(1.0, 50.0)] = 8.0,
) -> Image:
    """Electrons that heat frees during the exposure, before shot noise.

    mu_dark = t * I * 2^((T - 25) / T_d), t that of each row.

    Args:
        image: mean electrons; its provenance holds the exposure time.
        dark_current_e_s: I, at 25 degrees C [e-/s].
        temperature_c: T of the sensor [degrees C].
        doubling_k: T_d, the warming that doubles it [K].

    Source: EMVA 1288 release 4.0, section 7.
    """
    dark_e = (
        dark_current_e_s * 2.0 ** ((temperature_c - 25.0) / doubling_k) * _fact(image, "exposure_s", "sensor.expose")
    )
    by_row = np.float32(dark_e) * row_times(image.provenance, image.height_px)
    return image.with_pixels(image.pixels + by_row).with_metadata(dark_e=dark_e)


@OPS.op("sensor.shot_noise", takes=MEAN_ELECTRONS, gives=COUNTED_ELECTRONS)
def shot_noise(image: Image, *, rng: np.random.Generator) -> Image:
    """The count of electrons that really came: a Poisson number.

    Exact below 64 electrons; from there on by a series that is off by one electron in 3e-5 of the pixels at most.

    Args:
        image: mean electrons, >= 0.
        rng: the node's stream.

    Raises:
        ImageError: a negative mean.

    Source: Giles, "Algorithm 955: approximation of the inverse Poisson cumulative distribution function" (2016).
    """
    if (lowest := float(image.pixels.min())) < 0.0:
        raise ImageError(f"a mean of {lowest:g} electrons is below 0; shot noise comes before offsets and read noise")
    counts = noise.poisson(rng, at_most(image.pixels, MAX_MEAN_E))
    return image.with_pixels(counts).with_metadata(shot_noise=True)


@OPS.op("sensor.full_well", takes=HELD_ELECTRONS, gives=ELECTRONS)
def full_well(
    image: Image,
    *,
    full_well_e: Annotated[float, Range(1.0, 1e9), FromProfile("sensor.full_well_e")],
    blooming: Annotated[float, Range(0.0, 1.0)] = 0.0,
) -> Image:
    """No pixel holds more than its full well; what is over drains away, or spills along the column.

    Half of what spills goes up and half down, and fills one pixel after the other;
    what passes the edge of the picture is lost.

    Args:
        image: electrons.
        full_well_e: what a pixel holds [e-].
        blooming: part of the charge over the well that spills [1]; 0 for a sensor
            whose drains take all of it, 1 for one without drains.
    """
    held = at_most(image.pixels, full_well_e)
    if blooming > 0.0 and image.pixels.max() > full_well_e:
        spilt = (0.5 * blooming) * (image.pixels.astype(np.float64) - full_well_e).clip(min=0.0)
        filled = held.astype(np.float64)
        for rows in (range(image.height_px), range(image.height_px - 1, -1, -1)):
            carried = np.zeros_like(spilt[0])
            for row in rows:
                moved = np.minimum(carried, full_well_e - filled[row])
                filled[row] += moved
                carried += spilt[row] - moved
        held = filled.astype(np.float32)
    return image.with_pixels(held).with_metadata(full_well_e=full_well_e)


@OPS.op("sensor.dsnu", takes=ELECTRONS, gives=READ_ELECTRONS)
def dsnu(
    image: Image,
    *,
    dsnu_e: Annotated[float, Range(0.0, 1e4), FromProfile("sensor.dsnu_e")],
    serial: Annotated[str, FromProfile("sensor.serial")],
) -> Image:
    """Dark signal non-uniformity: every pixel has an offset of its own, for ever.

    Args:
        image: electrons.
        dsnu_e: standard deviation of the offset [e-].
        serial: which specimen.
    """
    return image.with_pixels(image.pixels + np.float32(dsnu_e) * pattern_of(image, serial, "dsnu"))


def _noisy(pixels: FloatArray, sigma: float, rng: np.random.Generator) -> FloatArray:
    drawn = rng.standard_normal(pixels.shape, dtype=np.float32)
    drawn *= np.float32(sigma)
    drawn += pixels
    return drawn


@OPS.op("sensor.read_noise", takes=ELECTRONS, gives=READ_ELECTRONS)
def read_noise(
    image: Image,
    *,
    rng: np.random.Generator,
    sigma_e: Annotated[float, Range(0.0, 1e4), FromProfile("sensor.read_noise_e")],
) -> Image:
    """Noise of the pixel's own amplifier, before the gain: the ISO setting multiplies it.

    Args:
        image: electrons.
        rng: the node's stream.
        sigma_e: standard deviation [e-].
    """
    return image.with_pixels(_noisy(image.pixels, sigma_e, rng)).with_metadata(read_noise_e=sigma_e)


@OPS.op("sensor.gain", takes=ELECTRONS, gives=AMPLIFIED)
def gain(
    image: Image,
    *,
    iso: Annotated[float, Range(1.0, 1e7), Auto()],
    iso_base: Annotated[float, Range(1.0, 1e5), FromProfile("sensor.iso_base")],
    gain_dn_e: Annotated[float, Range(0.0, 1e4, above=True), FromProfile("sensor.gain_dn_e")],
    analog_gain_max: Annotated[float, Range(1.0, 1e4), FromProfile("sensor.analog_gain_max")] = 1e4,
    factor: Annotated[float, Range(1e-4, 1e4)] = 1.0,
) -> Image:
    """Electrons to DN, not yet whole numbers: K = factor * gain_dn_e * min(iso / iso_base, analog_gain_max).

    What the ISO speed asks for beyond the amplifiers is noted as `digital_gain`;
    `isp.black_level` applies it once black is gone, and a DNG says it as BaselineExposure.

    Args:
        image: electrons.
        iso: ISO speed.
        iso_base: ISO speed at a gain of 1.
        gain_dn_e: K at `iso_base` [DN/e-].
        analog_gain_max: the most that the amplifiers do, relative to `iso_base` [1].
        factor: of another conversion gain of the same pixel [1], such as 0.25 for the low one.
    """
    analog = min(iso / iso_base, analog_gain_max)
    total = factor * gain_dn_e * analog
    return image.with_pixels(image.pixels * np.float32(total), quantity=Quantity.DN).with_metadata(
        iso=iso, system_gain_dn_e=total, digital_gain=iso / iso_base / analog
    )


@OPS.op("sensor.adc_noise", takes=AMPLIFIED, gives=AMPLIFIED)
def adc_noise(
    image: Image,
    *,
    rng: np.random.Generator,
    sigma_dn: Annotated[float, Range(0.0, 1e4), FromProfile("sensor.adc_noise_dn")],
) -> Image:
    """Noise behind the gain: the same in DN at every ISO setting.

    Args:
        image: amplified signal [DN].
        rng: the node's stream.
        sigma_dn: standard deviation [DN].
    """
    return image.with_pixels(_noisy(image.pixels, sigma_dn, rng)).with_metadata(adc_noise_dn=sigma_dn)


@OPS.op("sensor.row_column", takes=AMPLIFIED, gives=AMPLIFIED)
def row_column(
    image: Image,
    *,
    rng: np.random.Generator,
    row_noise_dn: Annotated[float, Range(0.0, 1e4), FromProfile("sensor.row_noise_dn")],
    column_noise_dn: Annotated[float, Range(0.0, 1e4), FromProfile("sensor.column_noise_dn")],
    temporal_row_noise_dn: Annotated[float, Range(0.0, 1e4)] = 0.0,
    serial: Annotated[str, FromProfile("sensor.serial")],
) -> Image:
    """Offsets of whole rows and columns, whose amplifiers and converters they share.

    Args:
        image: amplified signal [DN].
        rng: the node's stream.
        row_noise_dn, column_noise_dn: standard deviation of the offsets that stay for
            ever [DN].
        temporal_row_noise_dn: of one that every row draws anew in every frame [DN].
        serial: which specimen.

    Source: EMVA 1288 release 4.0, section 4 (row and column spatial nonuniformity).
    """
    height, width = image.height_px, image.width_px
    serial = serial_of(image, serial)
    rows = np.float32(row_noise_dn) * pattern(serial, "row", height, 1)
    rows = rows + np.float32(temporal_row_noise_dn) * rng.standard_normal((height, 1, 1), dtype=np.float32)
    pixels = image.pixels + rows
    pixels += np.float32(column_noise_dn) * pattern(serial, "column", 1, width)
    return image.with_pixels(pixels).with_metadata(temporal_row_noise_dn=temporal_row_noise_dn)


@OPS.op("sensor.black_clamp", takes=AMPLIFIED, gives=AMPLIFIED)
def black_clamp(
    image: Image,
    *,
    rng: np.random.Generator,
    optical_black_rows: Annotated[int, Range(1, 1024), FromProfile("sensor.optical_black_rows")],
) -> Image:
    """Takes off what rows without light show: dark current, but for what noise leaves in their mean.

    The mean of N = rows * columns dark pixels is K mu_dark, and misses it by
    sqrt((K^2 (sigma_read^2 + mu_dark) + sigma_adc^2) / N + sigma_row^2 / rows).
    All pixels of a frame are moved alike, so that black lies at the black level.

    Args:
        image: amplified signal [DN], whose provenance says what noise is in it.
        rng: the node's stream.
        optical_black_rows: how many rows are averaged.
    """
    metadata = image.provenance
    dark_dn, variance = _dark_signal(metadata)
    variance = (
        variance / (optical_black_rows * image.width_px)
        + metadata.get("temporal_row_noise_dn", 0.0) ** 2 / optical_black_rows
    )
    found_dn = dark_dn + math.sqrt(variance) * rng.standard_normal()
    return image.with_pixels(image.pixels - np.float32(found_dn)).with_metadata(dark_signal_dn=0.0)


def levels_fault(bits: int, black_level_dn: int, white_level_dn: int) -> str:
    """What is wrong with a converter's levels, or ''."""
    if black_level_dn < white_level_dn <= 2**bits - 1:
        return ""
    return (
        f"black_level_dn {black_level_dn} < white_level_dn {white_level_dn} <= {2**bits - 1}, the most of {bits} "
        f"bits, does not hold"
    )


@OPS.op("sensor.adc", takes=AMPLIFIED, gives=NUMBERS, fault=levels_fault)
def adc(
    image: Image,
    *,
    bits: Annotated[int, Range(8, 16), FromProfile("sensor.bits")],
    black_level_dn: Annotated[int, Range(0, 65535), FromProfile("sensor.black_level_dn")],
    white_level_dn: Annotated[int, Range(1, 65535), FromProfile("sensor.white_level_dn")],
    illuminant: Literal["d65", "a", "hps", "led"] = "d65",
    sensor: Annotated[SensorProfile, FromProfile("sensor")],
) -> Image:
    """Whole numbers: black level added, rounded, clipped to 0 to white level.

    Notes in the provenance all that a RAW file needs besides: levels, mean dark
    signal that no `sensor.black_clamp` took off, colour matrices, neutral and noise profile.

    Args:
        image: amplified signal [DN].
        bits: of the converter; white_level_dn is at most 2^bits - 1.
        black_level_dn, white_level_dn: DN of no light, and the highest DN.
        illuminant: the light whose white is noted as the neutral: daylight (d65),
            tungsten (a), high-pressure sodium (hps) or a white LED (led).
        sensor: its colour goes into the RAW file.

    Raises:
        ImageError: levels that do not fit the bits.
    """
    if fault := levels_fault(bits, black_level_dn, white_level_dn):
        raise ImageError(fault)
    numbers = image.pixels + np.float32(black_level_dn)
    np.clip(np.rint(numbers, out=numbers), 0.0, np.float32(white_level_dn), out=numbers)
    metadata = image.provenance
    gain_dn_e = _fact(image, "system_gain_dn_e", "sensor.gain")
    span = white_level_dn - black_level_dn
    dark_dn, dark_variance = _dark_signal(metadata)
    dark_variance += metadata.get("temporal_row_noise_dn", 0.0) ** 2 + 1.0 / 12.0
    return image.with_pixels(numbers).with_metadata(
        bits=bits,
        black_level_dn=black_level_dn,
        white_level_dn=white_level_dn,
        dark_signal_dn=metadata.get("dark_signal_dn", dark_dn),
        noise_profile=[gain_dn_e / span if metadata.get("shot_noise") else 0.0, dark_variance / span**2],
        total_dark_noise_dn=math.sqrt(dark_variance),
        cfa_pattern=sensor.cfa,
        sensor_title=sensor.title,
        sensor_serial=serial_of(image, sensor.serial),
        **_colour_metadata(sensor, illuminant.upper()),
    )


def _dark_signal(metadata: Mapping[str, Any]) -> tuple[float, float]:
    """Mean [DN] and variance [DN^2] of what a pixel without light gives, but for noise of whole rows."""
    if "system_gain_dn_e" not in metadata:
        raise ImageError(
            "the image does not say its system_gain_dn_e; put sensor.gain before this node, or add it to the image's "
            "provenance"
        )
    gain_dn_e, dark_e = float(metadata["system_gain_dn_e"]), float(metadata.get("dark_e", 0.0))
    counted_e = dark_e if metadata.get("shot_noise") else 0.0
    return gain_dn_e * dark_e, gain_dn_e**2 * (metadata.get("read_noise_e", 0.0) ** 2 + counted_e) + metadata.get(
        "adc_noise_dn", 0.0
    ) ** 2


def _colour_metadata(sensor: SensorProfile, illuminant: str) -> dict[str, list[float] | list[list[float]]]:
    """What a RAW file says of colour; nothing for a sensor of fewer than three filters."""
    if len(cfa.filters(sensor.cfa)) < 3:
        return {}
    metadata = {"as_shot_neutral": list(response.neutral(sensor, illuminant))}
    if illuminant != "D65":  # readers know daylight and tungsten at best, and few look which of them it was
        return {"xyz_to_camera": response.xyz_to_camera(sensor, illuminant, as_daylight=True).tolist(), **metadata}
    return {
        "xyz_to_camera": response.xyz_to_camera(sensor, "D65").tolist(),
        "xyz_to_camera_a": response.xyz_to_camera(sensor, "A").tolist(),
        **metadata,
    }


def _focal_length(image: Image, pixel_pitch_um: float) -> dict[str, float | None]:
    """Focal length [mm] that puts the image's field of view on so many pixels; what is noted already where no field of
    view is known, and None of a parallel projection.
    """
    if "fov_x_deg" not in image.provenance:
        return {}
    if float(image.provenance["fov_x_deg"]) <= PARALLEL_DEG:
        return {"focal_length_mm": None}
    half = math.tan(math.radians(float(image.provenance["fov_x_deg"])) / 2.0)
    return {"focal_length_mm": image.width_px * pixel_pitch_um * 1e-3 / 2.0 / half}


def row_times(provenance: Mapping[str, Any], height_px: int) -> FloatArray:
    """How long each row is exposed over `exposure_s`, for (H, W, C) pixels; one number where rows last alike."""
    if not (readout_s := provenance.get("global_reset_s", 0.0)):
        return np.ones((1, 1, 1), dtype=np.float32)
    down = (np.arange(height_px) + 0.5) / height_px
    return (1.0 + down * (readout_s / provenance["exposure_s"])).astype(np.float32)[:, None, None]


def _fact(image: Image, key: str, op: str) -> float:
    if key not in image.provenance:
        raise ImageError(
            f"the image does not say its {key}; put {op} before this node, or add it to the image's provenance"
        )
    return float(image.provenance[key])


def serial_of(image: Image, serial: str) -> str:
    """Serial number of the sensor that took an image.

    A rig has several cameras of one make.  An image's provenance tells its `specimen` where it is not the first of
    them: that stands behind the serial number of the profile.
    """
    return f"{serial}{SPECIMEN_MARK}{image.provenance['specimen']}" if image.provenance.get("specimen") else serial


def pattern_of(image: Image, serial: str, kind: str) -> FloatArray:
    """(H, W, 1) what `pattern` gives for the sensor that took an image."""
    return pattern(serial_of(image, serial), kind, image.height_px, image.width_px)


@functools.lru_cache(maxsize=6)
def pattern(serial: str, kind: str, height: int, width: int) -> FloatArray:
    """(H, W, 1) standard normal numbers that belong to the pixels of a specimen, counted from its upper left corner;
    read-only.

    Drawn in tiles, each with a stream of its own, so that a smaller picture is a part of a larger one.
    """
    result = np.empty((height, width, 1), dtype=np.float32)
    for down in range(0, height, TILE_PX):
        for right in range(0, width, TILE_PX):
            stream = seeds.stream(0, "sensor", serial, kind, down, right)
            part = result[down : down + TILE_PX, right : right + TILE_PX]
            size = (TILE_PX if height > 1 else 1, TILE_PX if width > 1 else 1, 1)
            part[...] = stream.standard_normal(size, dtype=np.float32)[: part.shape[0], : part.shape[1]]
    result.flags.writeable = False
    return result
