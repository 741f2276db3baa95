"""Ops between the scene and the lens: from radiance to irradiance on the sensor.

Radiance is R, G, B in cd m-2 or bands in W m-2 sr-1 nm-1; irradiance keeps the
channels, in lux or W m-2 nm-1.  What the lens does to the picture after that stands
in `distortion`, `blur` and `flare`.
"""

from __future__ import annotations

import functools
import math
from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import FloatArray, planar, strips
from synfog_usd.base.errors import ImageError
from synfog_usd.base.fisheye import Fisheye
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.fisheye import angles_rad, of_picture
from synfog_usd.camera.graph import Auto, FromProfile, Range
from synfog_usd.camera.registry import FOV, OPS

Falloff = Literal["cos4", "foote", "table", "projection", "none"]

Aperture = Literal["disc", "sine"]

Table = tuple[tuple[float, ...], tuple[float, ...]]
"""Field angles [degrees], rising from 0, and the relative illumination [1] there."""


@OPS.op("light.mix", takes=Quantity.RADIANCE, gives=Quantity.RADIANCE)
def mix(*images: Image, weights: Annotated[tuple[float, ...], Range(0.0)]) -> Image:
    """Sum of pictures of the same view under several lights, each dimmed or brightened.

    Light is additive: L = sum of w_i L_i.

    Args:
        images: radiance of one size and with the same channels.
        weights: one per image [1], >= 0.

    Raises:
        ImageError: sizes, channels or counts differ.
    """
    first = images[0]
    if len(weights) != len(images):
        raise ImageError(f"{len(images)} images, but {len(weights)} weights")
    for image in images[1:]:
        if image.pixels.shape != first.pixels.shape or image.channels != first.channels:
            raise ImageError(
                f"an image of shape {image.pixels.shape} with {image.channels} cannot be added to one of "
                f"{first.pixels.shape} with {first.channels}"
            )
    total = sum(np.float32(weight) * image.pixels for weight, image in zip(weights, images, strict=True))
    return first.with_pixels(np.asarray(total))


@OPS.op("optics.irradiance", takes=Quantity.RADIANCE, gives=Quantity.IRRADIANCE)
def irradiance(
    image: Image,
    *,
    f_number: Annotated[float, Range(0.5, 64.0), FromProfile("lens.f_number")],
    transmission: Annotated[float, Range(0.0, 1.0, above=True), FromProfile("lens.transmission")],
    magnification: Annotated[float, Range(-1.0, 0.0)] = 0.0,
    falloff: Falloff = "cos4",
    aperture: Aperture = "disc",
    fov_x_deg: Annotated[float | None, Range(0.0, 179.0, above=True), FOV] = None,
    shift_x: Annotated[float, Range(-10.0, 10.0), Auto()] = 0.0,
    shift_y: Annotated[float, Range(-10.0, 10.0), Auto()] = 0.0,
    focal_length_mm: Annotated[float | None, Range(0.0, above=True), FromProfile("lens.focal_length_mm")] = None,
    field_deg: Annotated[tuple[float, ...] | None, Range(0.0, 180.0), FromProfile("lens.field_deg")] = None,
    relative_illumination: Annotated[
        tuple[float, ...] | None, Range(0.0, 2.0), FromProfile("lens.relative_illumination")
    ] = None,
) -> Image:
    """Light that the lens puts on the sensor.

    E = tau * pi * L sin^2, sin^2 = 1 / (1 + 4 (N (1 + |m|))^2) of a disc or 1 / (2 N (1 + |m|))^2
    by the sine condition, times cos^4 of the field angle,
    Foote's exact formula for a disc, or the lens's own table.

    Args:
        image: radiance (H, W, C).
        f_number: N [1].
        transmission: tau [1].
        magnification: m [1], <= 0 (the picture is upside down); 0 for a far scene.
        falloff: how light fades towards the corners; table is what the lens was
            measured to do, vignetting included; projection is the solid angle that a pixel sees, which is all
            that is left of a lens whose pupil turns towards the light: a fisheye's, where cos4 and foote do not hold.
        aperture: what the f-number means.  disc: a flat pupil of diameter f / N, seen from the distance f, as in
            ISETCam
            and the SynFog paper.  sine: N = 1 / (2 sin), which a lens corrected for coma has, and from which
            ISO 12232 has H = 0.65 L t / N^2; brighter by 1 / (4 N^2), 6 % at f/2.
        fov_x_deg: horizontal angle of view [degrees]; needed unless falloff is none, or the picture a fisheye's.
        shift_x, shift_y: offset of the axis from the centre, in image widths and
            heights, right and up.
        focal_length_mm: noted for the RAW file where no field of view is known; else
            `sensor.expose` notes the one that such a view needs.
        field_deg: angles to the axis, before distortion, rising from 0, of the table.
        relative_illumination: light there, relative to the axis [1]; straight lines
            between them.

    Raises:
        ImageError: falloff without an angle of view; no table, or one that does not
            rise from 0 or ends before the corner; cos4 or foote behind a fisheye.

    Source: ISO 12232; Foote, "Illumination from a radiating disk", Scientific
    Papers of the Bureau of Standards 12 (1915).
    """
    cone = _cone(f_number, magnification)
    if aperture == "sine":
        cone = min(1.0, cone / (1.0 - cone))  # sin^2 of the angle whose tangent the disc has, as its sine
    table = (tuple(field_deg or ()), tuple(relative_illumination or ()))
    metadata: dict[str, Any] = {"f_number": f_number, "falloff": falloff}
    lens, fade = of_picture(image.provenance), None
    if falloff != "none":
        if fov_x_deg is None and lens is None:
            raise ImageError(
                f"falloff needs the angle of view: give fov_x_deg a number, or {FOV.hint}, or set falloff: none"
            )
        fade = falloff_map(
            image.height_px,
            image.width_px,
            kind=falloff,
            f_number=f_number,
            fov_x_deg=fov_x_deg,
            shift=(shift_x, shift_y),
            magnification=magnification,
            table=table,
            lens=lens,
        )
    if falloff == "table":
        metadata["relative_illumination"] = [list(column) for column in table]
    pixels = _scaled(image.pixels, np.float32(transmission * math.pi * cone), fade)
    if fov_x_deg is not None:
        metadata["fov_x_deg"] = fov_x_deg
    if focal_length_mm is not None:
        metadata["focal_length_mm"] = focal_length_mm
    return image.with_pixels(pixels, quantity=Quantity.IRRADIANCE).with_metadata(**metadata)


def _scaled(pixels: FloatArray, factor: np.float32, fade: FloatArray | None) -> FloatArray:
    """(H, W, C) times a factor and a map, in planes."""
    result = planar(pixels.shape)
    for rows in strips(pixels.shape[0]):
        here = factor if fade is None else factor * fade[rows]
        for channel in range(pixels.shape[2]):
            np.multiply(pixels[rows, :, channel], here, out=result[rows, :, channel])
    return result


def falloff_map(
    height: int,
    width: int,
    *,
    kind: Falloff,
    f_number: float,
    fov_x_deg: float | None,
    shift: tuple[float, float] = (0.0, 0.0),
    magnification: float = 0.0,
    table: Table = ((), ()),
    lens: Fisheye | None = None,
    power: float = 1.0,
) -> FloatArray:
    """(H, W) light of a pixel relative to one on the axis, to a `power`; arguments and errors as in
    `optics.irradiance`, `lens` of a fisheye's picture.
    """
    if kind == "cos4" and lens is None:
        assert fov_x_deg is not None
        return _cos4(height, width, fov_x_deg, shift, power)
    fade = _falloff(height, width, kind, f_number, fov_x_deg, shift, magnification, table, lens)
    return fade if power == 1.0 else fade**power


def _falloff(
    height: int,
    width: int,
    kind: Falloff,
    f_number: float,
    fov_x_deg: float | None,
    shift: tuple[float, float],
    magnification: float,
    table: Table,
    lens: Fisheye | None,
) -> FloatArray:
    if kind == "none":
        return np.ones((height, width), dtype=np.float32)
    if lens is not None:
        if kind not in ("table", "projection"):
            raise ImageError(
                f"falloff {kind} is a pinhole's, and the picture a fisheye's; set falloff: projection or table"
            )
        angles = angles_rad(lens, height, width, shift)
        return _tabled(angles, table) if kind == "table" else lens.solid_angle(angles).astype(np.float32)
    assert fov_x_deg is not None
    tan2 = _tan2_of_field(height, width, fov_x_deg, *shift)
    if kind == "projection":
        return np.asarray((1.0 + tan2) ** -1.5, dtype=np.float32)
    if kind == "table":
        return _tabled(np.arctan(np.sqrt(tan2)), table)
    cone = _cone(f_number, magnification)
    return np.asarray(_foote(tan2, cone) / cone, dtype=np.float32)


def field_angles_rad(image: Image, fov_x_deg: float | None, shift: tuple[float, float]) -> npt.NDArray[np.float64]:
    """(H, W) angle to the axis [rad] of what each pixel of a picture sees, distorted or not, or of a fisheye.

    Raises:
        ImageError: no angle of view.
    """
    from synfog_usd.camera.distortion import Pinhole, source_of, warped_like

    if (lens := of_picture(image.provenance)) is not None:
        return angles_rad(lens, image.height_px, image.width_px, shift)
    if fov_x_deg is None:
        raise ImageError(f"the angle of view is not known: give fov_x_deg a number, or {FOV.hint}")
    pinhole = Pinhole(image.height_px, image.width_px, fov_x_deg, shift)
    height, width, fov_deg, source_shift = source_of(image.provenance, pinhole)
    angles = np.arctan(np.sqrt(_tan2_of_field(height, width, fov_deg, *source_shift)))
    return np.asarray(warped_like(angles, image.provenance, pinhole), dtype=np.float64)


def _cone(f_number: float, magnification: float) -> float:
    """sin^2 of the half angle under which the pixel on the axis sees the exit pupil."""
    return 1.0 / (1.0 + 4.0 * (f_number * (1.0 + abs(magnification))) ** 2)


@functools.lru_cache(maxsize=2)
def _cos4(height: int, width: int, fov_x_deg: float, shift: tuple[float, float], power: float) -> FloatArray:
    """Read-only: what the lens takes away and lens shading gives back are made once for pictures of one size."""
    x2, y2 = _tan2_of_axes(height, width, fov_x_deg, *shift)
    fade = np.empty((height, width), dtype=np.float32)
    for rows in strips(height):
        fade[rows] = (1.0 + x2 + y2[rows, None]) ** (-2.0 * power)
    fade.flags.writeable = False
    return fade


def _tabled(field_rad: npt.NDArray[np.float64], table: Table) -> FloatArray:
    field_deg, values = table
    if not field_deg:
        raise ImageError(
            "falloff is table, but the lens has no relative_illumination; add it to the lens profile, or set falloff: "
            "cos4"
        )
    if len(field_deg) != len(values) or len(field_deg) < 2 or field_deg[0] != 0.0 or (np.diff(field_deg) <= 0.0).any():
        raise ImageError(
            f"a table of {len(field_deg)} field_deg and {len(values)} relative_illumination: it takes two or more of "
            f"each, field_deg rising from 0"
        )
    angles = np.degrees(field_rad)
    if (corner := float(angles.max())) > field_deg[-1]:
        raise ImageError(
            f"relative_illumination ends at {field_deg[-1]:g} degrees, but the picture goes out to {corner:.1f}; "
            f"measure further, or set falloff: cos4"
        )
    return np.interp(angles, field_deg, values).astype(np.float32)


def _tan2_of_field(
    height: int, width: int, fov_x_deg: float, shift_x: float, shift_y: float
) -> npt.NDArray[np.float64]:
    """(H, W) squared tangent of the angle between each pixel's centre and the optical axis."""
    x2, y2 = _tan2_of_axes(height, width, fov_x_deg, shift_x, shift_y)
    return np.asarray(x2 + y2[:, None])


def _tan2_of_axes(
    height: int, width: int, fov_x_deg: float, shift_x: float, shift_y: float
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """(W,) and (H,) parts of it by columns and by rows."""
    focal_px = width / 2 / math.tan(math.radians(fov_x_deg) / 2)
    x = (np.arange(width) + 0.5 - width / 2 - shift_x * width) / focal_px
    y = (np.arange(height) + 0.5 - height / 2 + shift_y * height) / focal_px
    return np.square(x, dtype=np.float64), np.square(y, dtype=np.float64)


def _foote(tan2_field: npt.NDArray[np.float64], cone: float) -> npt.NDArray[np.float64]:
    """E / (pi L) of a disc that fills `cone` = sin^2 of its half angle, seen off its axis."""
    tan2_cone = cone / (1.0 - cone)
    root = np.sqrt(tan2_field**2 + 2.0 * tan2_field * (1.0 - tan2_cone) + (1.0 + tan2_cone) ** 2)
    return np.asarray(0.5 * (1.0 - (1.0 - tan2_cone + tan2_field) / root))
