"""Ops of the image signal processor: levels, white balance, colour and tone.

In the order of the SynFog paper: black level, white balance, demosaic
(`camera/demosaic.py`), colour correction, gamma; a tone curve may stand before the
gamma, and `camera/cleanup.py` has what may stand between.  A mosaic has one channel,
'CFA'; a picture has R, G and B, or the one channel Y of a sensor that sees no colour.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import STRIP_ROWS, Array, FloatArray, at_least, at_most, planar, strips
from synfog_usd.base.colour import LUMINANCE, srgb_decode, srgb_encode
from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import cfa, response
from synfog_usd.camera.distortion import source_of, warped_like
from synfog_usd.camera.graph import FromProfile, Port, Range
from synfog_usd.camera.optics import FalloffShape, cone_of, falloff_map, view_of
from synfog_usd.camera.profiles import SensorProfile
from synfog_usd.camera.registry import FOV, OPS

NUMBERS = Port(Quantity.DN, "mosaic")
MOSAIC = Port(Quantity.LINEAR_RGB, "mosaic")
SENSED = Port(Quantity.LINEAR_RGB, "mosaic", ("as sensed",))
UNBALANCED = Port(Quantity.LINEAR_RGB, "mosaic", ("as sensed", "shading corrected"))
SHADED = Port(Quantity.LINEAR_RGB, "mosaic", ("shading corrected",))
BALANCED = Port(Quantity.LINEAR_RGB, "mosaic", ("white-balanced",))
PICTURE = Port(Quantity.LINEAR_RGB, "picture")
DISPLAY = Port(Quantity.DISPLAY_RGB, "picture")

CORING_PX = 16
"""Side of the neighbourhood that says whether there is light [px]; even, so that every filter of a pattern counts
alike.
"""

CORING_OWN = 4.0
"""How steeply a pixel that stands alone comes back above the limit."""

MAX_DN = 2.0**24
"""float32 holds whole numbers up to here."""


@OPS.op("isp.decompand", takes=NUMBERS, gives=NUMBERS)
def decompand(image: Image) -> Image:
    """Companded numbers back to linear ones: the inverse of `sensor.compand`.

    Straight pieces between the knee points; below the first the first piece goes
    on, so that noise around black is kept.

    Args:
        image: whole numbers whose provenance says `companding` [[linear DN, code], ...],
            `linear_black_dn` and `linear_white_dn`.

    Raises:
        ImageError: the provenance says none, knees that do not rise, or a number
            above 65535.
    """
    _mosaic(image)
    metadata = dict(image.provenance)
    if not {"companding", "linear_black_dn", "linear_white_dn"} <= metadata.keys():
        raise ImageError(
            "the image does not say how it was companded; put sensor.compand before this node, or leave this node out"
        )
    knees = np.array(metadata.pop("companding"), dtype=np.float64)
    if knees.ndim != 2 or knees.shape[1] != 2 or len(knees) < 2 or not (np.diff(knees, axis=0) > 0.0).all():
        raise ImageError(f"companding is {knees.tolist()}; it takes two or more pairs [linear DN, code], both rising")
    highest = float(image.pixels.max())
    if highest > 65535.0:
        raise ImageError(f"the image holds {highest:g}; companded numbers go up to 65535")
    linear, codes = knees.T
    every = np.arange(max(highest, codes[-1]) + 1.0)
    below = linear[0] + (every - codes[0]) * (linear[1] - linear[0]) / (codes[1] - codes[0])
    table = np.where(every < codes[0], below, np.interp(every, codes, linear)).astype(np.float32)
    pixels = np.take(table, np.rint(image.pixels).astype(np.int32), mode="clip")
    black_dn, white_dn = metadata.pop("linear_black_dn"), metadata.pop("linear_white_dn")
    return image.with_pixels(
        pixels,
        provenance={
            **metadata,
            "black_level_dn": black_dn,
            "white_level_dn": white_dn,
            "bits": int(white_dn).bit_length(),
        },
    )


SHADES_POWER = 6
"""Of the Minkowski mean by which shades of grey guesses a light; the paper's best."""

SATURATED = 0.98
"""From here on a pixel says nothing of the light's colour."""


@OPS.op("isp.black_level", takes=NUMBERS, gives=SENSED)
def black_level(
    image: Image,
    *,
    black_level_dn: Annotated[float | None, Range(0.0, MAX_DN)] = None,
    white_level_dn: Annotated[float | None, Range(1.0, MAX_DN)] = None,
    coring: Annotated[float, Range(0.0, 100.0)] = 4.0,
    sensor: Annotated[SensorProfile | None, FromProfile("sensor")] = None,
) -> Image:
    """DN to a scale on which black is 0 and saturation is 1, times the digital gain.

    Black is the black level and the mean dark signal that nothing took off before.
    What cannot be distinguished from black becomes 0, so that unlit places are black and not a mist
    of noise cut at 0: where the mean m of the 16 x 16 pixels around is within `coring`
    standard deviations s of black, and the pixel itself within `coring` of its own.  From
    2 coring s on, which is half a pixel's noise in the dark, nothing is changed.  Elsewhere noise below 0 is kept.

    Args:
        image: DN mosaic.
        black_level_dn, white_level_dn: what becomes 0 and 1 [DN].  Empty: what the
            image's provenance says (`sensor.adc` notes it), else the sensor profile.
        coring: what counts as black, in standard deviations of the noise in the dark
            that the provenance tells of (noise_profile); 0 keeps all noise.
        sensor: see above.

    Raises:
        ImageError: more than one channel, companded numbers, levels that nothing
            names, or black not below white.
    """
    _mosaic(image)
    if "companding" in image.provenance:
        raise ImageError("the numbers are companded; put isp.decompand before this node")
    black = _level(image, "black_level_dn", black_level_dn, sensor)
    white = _level(image, "white_level_dn", white_level_dn, sensor)
    if not black < white:
        raise ImageError(f"black_level_dn {black:g} is not below white_level_dn {white:g}")
    black += image.provenance.get("dark_signal_dn", 0.0) if black_level_dn is None else 0.0
    pixels = image.pixels - np.float32(black)
    pixels /= np.float32(white - black)  # white becomes exactly 1
    shot, dark = image.provenance.get("noise_profile", (0.0, 0.0))
    _core(pixels[..., 0], coring * math.sqrt(dark))
    gain = float(image.provenance.get("digital_gain", 1.0))
    if gain != 1.0:
        pixels *= np.float32(gain)
    noise = {"noise_profile": [shot * gain, dark * gain**2]} if "noise_profile" in image.provenance else {}
    return image.with_pixels(pixels, quantity=Quantity.LINEAR_RGB).with_metadata(**noise)


def _core(mosaic: FloatArray, limit: float) -> None:
    """Makes 0, in place, what is within `limit` of black, and whose neighbourhood is within what is left of that in its
    mean.
    """
    if limit < float(np.finfo(np.float32).eps):  # beneath what a number near white can tell
        return
    from scipy.ndimage import uniform_filter

    mean_limit = np.float32(limit / CORING_PX)
    if float(mosaic.min()) >= 2.0 * mean_limit:  # so is every mean
        return
    around = uniform_filter(mosaic, CORING_PX, mode="reflect")
    around /= mean_limit
    if float(around.min()) >= 2.0:
        return
    around -= np.float32(1.0)
    weight = mosaic * np.float32(CORING_OWN / limit)
    weight -= np.float32(CORING_OWN)
    np.maximum(around, weight, out=around)
    np.clip(around, 0.0, 1.0, out=around)
    mosaic *= around


@OPS.op("isp.lens_shading", takes=UNBALANCED, gives=SHADED)
def lens_shading(
    image: Image,
    *,
    strength: Annotated[float, Range(0.0, 1.0)] = 1.0,
    fov_x_deg: Annotated[float | None, Range(0.0, 179.0, above=True), FOV] = None,
) -> Image:
    """Brightens the corners that the lens left dark, and their noise with them.

    Divides by (the falloff that `optics.irradiance` applied, where `optics.distortion`
    put it) ^ strength.

    Args:
        image: mosaic, black 0 and saturation 1; its provenance names the falloff.
        strength: 1 takes all of it away.
        fov_x_deg: see `optics.irradiance`.

    Raises:
        ImageError: the provenance names no falloff, or no angle of view is known.
    """
    _mosaic(image)
    metadata = image.provenance
    if "falloff" not in metadata:
        raise ImageError("the image does not say its falloff; optics.irradiance notes it")
    if metadata["falloff"] == "none":
        return image.with_metadata(lens_shading=strength)
    view, fisheye = view_of(image, fov_x_deg)
    shape = FalloffShape(
        metadata["falloff"], cone_of(metadata["f_number"]), metadata.get("relative_illumination", ((), ()))
    )
    fade = falloff_map(source_of(metadata, view), fisheye, shape, power=strength)
    fade = warped_like(fade, metadata, view)
    pixels = np.empty_like(image.pixels)
    for rows in strips(image.height_px):
        np.divide(image.pixels[rows, :, 0], at_least(fade[rows], 1e-30), out=pixels[rows, :, 0])
    return image.with_pixels(pixels).with_metadata(lens_shading=strength)


@OPS.op("isp.white_balance", takes=UNBALANCED, gives=BALANCED)
def white_balance(
    image: Image,
    *,
    illuminant: Literal["d65", "a", "hps", "led", "grey_world", "shades_of_grey", "as_shot", "none"] = "d65",
    clip: bool = True,
    sensor: Annotated[SensorProfile | None, FromProfile("sensor")] = None,
) -> Image:
    """Gains of the filters that make white neutral, the smallest being 1.

    A pattern of one or two filters (MONO, RCCC) has no colour to balance and keeps
    its numbers.

    Args:
        image: mosaic, black 0 and saturation 1.
        illuminant: the light whose white becomes neutral: daylight (d65), tungsten
            (a), high-pressure sodium (hps), a white LED (led), or the neutral in the
            image's provenance (as_shot).  As a camera left to itself guesses it: grey_world from the means of the
            filters, shades_of_grey from their means of the sixth power, saturated pixels left out.  A known one by
            default: both take the airlight's tint for a tint of the light.
        clip: cut at 1 afterwards, so that saturated pixels are white, not tinted.
        sensor: its neutral is used, but for as_shot, grey_world and shades_of_grey.

    Raises:
        ImageError: a filter without signal (grey_world on a black picture), as_shot
            without a neutral, or one for other filters.

    Source: shades of grey: Finlayson and Trezzi, "Shades of gray and colour constancy" (2004).
    """
    _mosaic(image)
    pattern = pattern_of(image, sensor)
    letters = cfa.filters(pattern)
    signal = (
        np.ones(len(letters))
        if illuminant == "none" or len(letters) < 3
        else _white(image, pattern, illuminant, sensor)
    )
    if signal.size != len(letters):
        raise ImageError(
            f"a neutral of {signal.size} numbers does not fit the filters {', '.join(letters)} of {pattern}; the image "
            f"is from another sensor"
        )
    if not (signal > 0.0).all():
        raise ImageError(
            f"{illuminant} cannot balance signals of {signal.tolist()} behind {', '.join(letters)}; set illuminant: d65"
        )
    gains = signal.max() / signal
    factors = cfa.factors(pattern, gains, STRIP_ROWS, image.width_px)
    pixels = np.empty_like(image.pixels)
    for strip in strips(image.height_px):  # of whole patterns
        rows = pixels[strip, :, 0]
        np.multiply(image.pixels[strip, :, 0], factors[: len(rows)], out=rows)
        if clip:
            at_most(rows, 1.0, out=rows)
    return image.with_pixels(pixels).with_metadata(white_balance=illuminant, wb_gains=[float(value) for value in gains])


@OPS.op("isp.colour_correct", takes=PICTURE, gives=PICTURE)
def colour_correct(
    image: Image,
    *,
    illuminant: Literal["d65", "a", "hps", "led", "as_shot"] = "d65",
    sensor: Annotated[SensorProfile | None, FromProfile("sensor")] = None,
) -> Image:
    """Camera colours to linear Rec.709 by the matrix fitted for one light; white stays.

    Args:
        image: white-balanced camera colours (H, W, F), a channel per filter of the
            sensor; or Y alone, which stays as it is.
        illuminant: the light of the fit; see `isp.white_balance`.  as_shot takes the
            matrix that came with a RAW file.
        sensor: whose colours, but for as_shot.

    The error of the fit over a ColorChecker goes into the provenance (CIEDE2000).

    Raises:
        ImageError: other channels than the sensor's filters; as_shot without a matrix;
            no sensor where one is needed.
    """
    if image.channels == ("Y",):
        return image
    if illuminant == "as_shot":
        if "camera_to_rec709" not in image.provenance:
            raise ImageError(
                "the image does not say its camera_to_rec709; a RAW file has it. Name the light and a sensor instead, "
                "such as illuminant: d65"
            )
        rows = np.array(image.provenance["camera_to_rec709"])
        if image.channels != ("R", "G", "B"):
            raise ImageError(f"the matrix of a RAW file is for R, G, B; the picture has {', '.join(image.channels)}")
        return image.with_pixels(_mixed(image.pixels, rows)).with_metadata(colour_matrix=rows.tolist())
    sensor = _named(sensor, illuminant)
    letters = cfa.filters(sensor.cfa)
    if image.channels != letters:
        raise ImageError(
            f"the picture has {', '.join(image.channels)}; sensor {sensor.name} has the filters {', '.join(letters)}, "
            f"as isp.demosaic gives them"
        )
    matrix = response.colour_matrix(sensor, illuminant.upper())
    return image.with_pixels(_mixed(image.pixels, np.array(matrix.rows)), channels=("R", "G", "B")).with_metadata(
        colour_matrix=[list(row) for row in matrix.rows],
        colour_matrix_mean_de00=matrix.mean_de00,
        colour_matrix_max_de00=matrix.max_de00,
    )


def _mixed(pixels: FloatArray, matrix: Array) -> FloatArray:
    """(H, W, N): each channel a sum of channels of (H, W, C), by (N, C) weights."""
    mixed = planar((*pixels.shape[:2], len(matrix)))
    rows = np.ascontiguousarray(np.moveaxis(pixels, 2, 0)).swapaxes(0, 1)  # in one order, so that it adds in one
    np.matmul(matrix.astype(np.float32), rows, out=mixed.swapaxes(1, 2))
    return mixed


@OPS.op("isp.tone", takes=PICTURE, gives=PICTURE)
def tone(
    image: Image,
    *,
    brighten_ev: Annotated[float, Range(0.0, 4.0)] = 1.0,
    shoulder: Annotated[float, Range(0.0, 0.95)] = 0.4,
) -> Image:
    """Brighter middle, highlights rolled off; black, white and the slope below the shoulder stay.

    y = 2^ev x up to y = shoulder; above it y = s + (1 - s)(1 - (1 - u)^p), which
    meets the straight part with the same slope and reaches 1 flat.

    Args:
        image: linear Rec.709 or Y; what is above 1 becomes 1.
        brighten_ev: slope of the straight part [EV].
        shoulder: s [1].

    Raises:
        ImageError: the channels are not R, G, B or Y.
    """
    _picture(image)
    gain = 2.0**brighten_ev
    power = (gain - shoulder) / (1.0 - shoulder)
    pixels = np.empty_like(image.pixels)
    for rows in strips(image.height_px):
        straight = np.multiply(image.pixels[rows], np.float32(gain), out=pixels[rows])
        if straight.max() <= shoulder:
            continue
        rest = straight * np.float32(-1.0 / (gain - shoulder))  # 1 - u: 1 below the shoulder, 0 from saturation on
        rest += np.float32(gain / (gain - shoulder))
        np.clip(rest, np.float32(1e-30 ** (1.0 / power)), np.float32(1.0), out=rest)
        np.log2(rest, out=rest)  # a power, as in `colour.srgb_encode`
        rest *= np.float32(power)
        np.exp2(rest, out=rest)
        rest *= np.float32(shoulder - 1.0)
        rest += np.float32(1.0 - shoulder)
        at_most(straight, shoulder, out=straight)
        straight += rest
    return image.with_pixels(pixels)


@OPS.op("isp.tone_hdr", takes=PICTURE, gives=PICTURE)
def tone_hdr(image: Image, *, range_ev: Annotated[float, Range(1.0, 24.0)] = 12.0) -> Image:
    """Shadows and lamps of a wide range in one picture: brightness on the screen is the logarithm of luminance.

    The sRGB code of Y becomes ln(1 + m Y) / ln(1 + m), m = 2^range_ev: every doubling of
    light gets the same step on the screen, down to where m Y = 1; below that the curve runs
    straight into black.  Colours keep R : G : B; one that would need more than 1 of a
    channel is darkened, not bleached.  The curve does not look at the picture, so a clear
    and a foggy frame get the same one.

    Args:
        image: linear Rec.709 or Y, saturation 1.
        range_ev: how far below saturation the straight part begins [EV].  Too large lifts
            noise, too small loses shadows.

    Raises:
        ImageError: the channels are not R, G, B or Y.

    Source: the curve: Kalantari and Ramamoorthi, "Deep high dynamic range imaging of
    dynamic scenes" (2017), section 4 (there m = 5000, 12.3 EV), from the mu-law of ITU-T G.711.
    """
    _picture(image)
    steepness = 2.0**range_ev
    bright = np.clip(luminance_of(image.pixels), np.float32(1e-3 / steepness), np.float32(1.0))
    factor = np.log1p(bright * np.float32(steepness))
    factor *= np.float32(1.0 / np.log1p(steepness))
    factor = srgb_decode(factor)
    factor /= bright
    if len(image.channels) == 3:
        top = np.maximum(np.maximum(image.pixels[..., 0:1], image.pixels[..., 1:2]), image.pixels[..., 2:3])
        np.minimum(factor, np.float32(1.0) / np.maximum(top, bright), out=factor)
    return image.with_pixels(image.pixels * factor)


@OPS.op("isp.gamma", takes=PICTURE, gives=DISPLAY)
def gamma(image: Image) -> Image:
    """Linear Rec.709, or Y, to sRGB, cut to 0 to 1.

    Raises:
        ImageError: the channels are not R, G, B or Y.

    Source: IEC 61966-2-1.
    """
    _picture(image)
    pixels = np.empty_like(image.pixels)
    for rows in strips(image.height_px):
        srgb_encode(image.pixels[rows], out=pixels[rows])
    return image.with_pixels(pixels, quantity=Quantity.DISPLAY_RGB)


def luminance_of(pixels: FloatArray) -> FloatArray:
    """(H, W, 1) luminance of (H, W, 3) linear Rec.709; (H, W, 1) as it is."""
    return pixels if pixels.shape[2] == 1 else (pixels @ LUMINANCE.astype(np.float32))[..., None]


def pattern_of(image: Image, sensor: SensorProfile | None) -> str:
    """The colour filters of a mosaic: as its provenance says, else as the sensor profile says.

    Raises:
        ImageError: neither says, or the pattern is not known.
    """
    pattern = image.provenance.get("cfa_pattern", sensor.cfa if sensor else None)
    if pattern not in cfa.PATTERNS:
        fault = "the image does not say its cfa_pattern" if pattern is None else f"cfa_pattern {pattern!r} is not known"
        raise ImageError(
            f"{fault}; it can be {', '.join(cfa.PATTERNS)}. sensor.expose notes it, and a sensor profile names it"
        )
    return str(pattern)


def _named(sensor: SensorProfile | None, illuminant: str) -> SensorProfile:
    if sensor is None:
        raise ImageError(
            f"illuminant {illuminant} is about a sensor's own colours; name one at the top with 'sensor: ...', or set "
            f"illuminant: as_shot"
        )
    return sensor


def _white(image: Image, pattern: str, illuminant: str, sensor: SensorProfile | None) -> npt.NDArray[np.float64]:
    """(F,) signal of a white surface behind each filter, to any scale."""
    if illuminant == "as_shot":
        if "as_shot_neutral" not in image.provenance:
            raise ImageError(
                "the image does not say its as_shot_neutral; sensor.adc notes it. Name the light instead, such as "
                "illuminant: d65"
            )
        return np.array(image.provenance["as_shot_neutral"], dtype=np.float64)
    if illuminant not in ("grey_world", "shades_of_grey"):
        return np.array(response.neutral(_named(sensor, illuminant), illuminant.upper()))
    power = SHADES_POWER if illuminant == "shades_of_grey" else 1
    sums, counts = np.zeros(len(cfa.filters(pattern))), np.zeros(len(cfa.filters(pattern)))
    for where, number in cfa.sites(pattern):
        site = image.pixels[where].astype(np.float64)
        if power > 1:
            site = site[(site > 0.0) & (site < SATURATED)] ** power
        sums[number] += site.sum()
        counts[number] += site.size
    return np.asarray((sums / np.maximum(counts, 1.0)) ** (1.0 / power))


def _level(image: Image, name: str, level: float | None, sensor: SensorProfile | None) -> float:
    if level is not None:
        return level
    if name in image.provenance:
        return float(image.provenance[name])
    if sensor is None:
        raise ImageError(
            f"the image does not say its {name}; sensor.adc notes it. Give {name} a number, or name a sensor"
        )
    return float(getattr(sensor, name))


def _mosaic(image: Image) -> None:
    if len(image.channels) != 1:
        raise ImageError(f"a mosaic has one channel; this image has {', '.join(image.channels)}")


def _picture(image: Image) -> None:
    if image.channels not in (("R", "G", "B"), ("Y",)):
        raise ImageError(
            f"a picture has R, G, B, or Y; this image has {', '.join(image.channels)}. isp.demosaic and "
            f"isp.colour_correct make one"
        )
