"""Ops between the scene and the lens: from radiance to irradiance on the sensor.

Units of radiance are those of `Quantity`.  Irradiance keeps the channels, in lux or W m-2 nm-1.  What the lens does
to the picture after that stands in `distortion`, `blur` and `flare`.
"""

from __future__ import annotations

import functools
import math
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np

from synfog_usd.base.arrays import Array, FloatArray, planar, strips
from synfog_usd.base.errors import ImageError
from synfog_usd.base.fisheye import Fisheye
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.distortion import source_of, warped_like
from synfog_usd.camera.fisheye import angles_rad, of_picture
from synfog_usd.camera.graph import FromProfile, Range
from synfog_usd.camera.pinhole import Pinhole
from synfog_usd.camera.profiles import LensProfile
from synfog_usd.camera.registry import FOV, OPS

Falloff = Literal["cos4", "foote", "table", "projection", "none"]

Aperture = Literal["disc", "sine"]


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
    lens: Annotated[LensProfile | None, FromProfile("lens")] = None,
) -> Image:
    """Light that the lens puts on the sensor.

    E = tau * pi * L sin^2, sin^2 = 1 / (1 + 4 (N (1 + |m|))^2) of a disc or 1 / (2 N (1 + |m|))^2
    by the sine condition, times cos^4 of the field angle, Foote's exact formula for a disc, or the lens's own table.

    Args:
        image: radiance (H, W, C).
        f_number: N [1].
        transmission: tau [1].
        magnification: m [1], <= 0 (the picture is upside down); 0 for a far scene.
        falloff: how light fades towards the corners.  table is what the lens was measured to do, vignetting included,
            by the angle before distortion.  projection is the solid angle that a pixel sees: all that is left of a lens
            whose pupil turns towards the light, as a fisheye's does, where cos4 and foote do not hold.
        aperture: what the f-number means.  disc: a flat pupil of diameter f / N, seen from the distance f, as ISETCam
            and the SynFog paper have it.  sine: N = 1 / (2 sin), which a lens corrected for coma has, and from which
            ISO 12232 has H = 0.65 L t / N^2; it is brighter by 1 / (4 N^2).
        fov_x_deg: horizontal angle of view [degrees]; needed unless falloff is none, or the picture a fisheye's.
        lens: whose relative illumination the table is.

    Raises:
        ImageError: falloff without an angle of view; no table, or one that ends before the corner; cos4 or foote behind
            a fisheye.

    Source: ISO 12232; Foote, "Illumination from a radiating disk", Scientific Papers of the Bureau of Standards 12
    (1915).
    """
    cone = cone_of(f_number, magnification)
    shape = FalloffShape(falloff, cone, (lens.field_deg, lens.relative_illumination) if lens is not None else ((), ()))
    if aperture == "sine":
        cone = min(1.0, cone / (1.0 - cone))  # sin^2 of the angle whose tangent the disc has, as its sine
    fade = None if falloff == "none" else falloff_map(*view_of(image, fov_x_deg), shape)
    metadata: dict[str, Any] = {"f_number": f_number, "falloff": falloff}
    if falloff == "table":
        metadata["relative_illumination"] = [list(column) for column in shape.table]
    if fov_x_deg is not None:
        metadata["fov_x_deg"] = fov_x_deg
    if lens is not None:
        metadata["focal_length_mm"] = lens.focal_length_mm  # `sensor.expose` notes the one that an angle of view needs
    pixels = _scaled(image.pixels, np.float32(transmission * math.pi * cone), fade)
    return image.with_pixels(pixels, quantity=Quantity.IRRADIANCE).with_metadata(**metadata)


def _scaled(pixels: FloatArray, factor: np.float32, fade: FloatArray | None) -> FloatArray:
    """(H, W, C) times a factor and a map, in planes."""
    result = planar(pixels.shape)
    for rows in strips(pixels.shape[0]):
        here = factor if fade is None else factor * fade[rows]
        for channel in range(pixels.shape[2]):
            np.multiply(pixels[rows, :, channel], here, out=result[rows, :, channel])
    return result


def view_of(image: Image, fov_x_deg: float | None) -> tuple[Pinhole, Fisheye | None]:
    """The geometry of a picture: a pinhole's, or a fisheye's, of which the pinhole tells the size and axis alone.

    Raises:
        ImageError: no angle of view.
    """
    fisheye = of_picture(image.provenance)
    if fov_x_deg is None and fisheye is None:
        raise ImageError(f"the angle of view is not known: give fov_x_deg a number, or {FOV.hint}")
    return Pinhole.of(image, fov_x_deg or 0.0), fisheye


class FalloffShape(NamedTuple):
    """How light fades from the axis to the corners; see `optics.irradiance`.

    Attributes:
        kind: of falloff.
        cone: sin^2 of the half angle under which the pixel on the axis sees the exit pupil.
        table: field angles [degrees], rising from 0, and the relative illumination [1] there.
    """

    kind: Falloff
    cone: float
    table: tuple[tuple[float, ...], tuple[float, ...]] = ((), ())


def falloff_map(view: Pinhole, fisheye: Fisheye | None, shape: FalloffShape, *, power: float = 1.0) -> FloatArray:
    """(H, W) light of a pixel relative to one on the axis, to a `power`; errors as in `optics.irradiance`."""
    if shape.kind == "cos4" and fisheye is None:
        return _cos4(view, power)
    fade = _falloff(view, fisheye, shape)
    return fade if power == 1.0 else fade**power


def _falloff(view: Pinhole, fisheye: Fisheye | None, shape: FalloffShape) -> FloatArray:
    kind, cone, table = shape
    if kind == "none":
        return np.ones((view.height_px, view.width_px), dtype=np.float32)
    if fisheye is not None:
        if kind not in ("table", "projection"):
            raise ImageError(
                f"falloff {kind} is a pinhole's, and the picture a fisheye's; set falloff: projection or table"
            )
        angles = angles_rad(fisheye, view.height_px, view.width_px, view.shift)
        return _tabled(angles, table) if kind == "table" else fisheye.solid_angle(angles).astype(np.float32)
    tan2 = _tan2_of_field(view)
    if kind == "projection":
        return np.asarray((1.0 + tan2) ** -1.5, dtype=np.float32)
    if kind == "table":
        return _tabled(np.arctan(np.sqrt(tan2)), table)
    return np.asarray(_foote(tan2, cone) / cone, dtype=np.float32)


def field_angles_rad(image: Image, fov_x_deg: float | None) -> Array:
    """(H, W) angle to the axis [rad] of what each pixel of a picture sees, distorted or not, or of a fisheye.

    Raises:
        ImageError: no angle of view.
    """
    view, fisheye = view_of(image, fov_x_deg)
    if fisheye is not None:
        return angles_rad(fisheye, view.height_px, view.width_px, view.shift)
    angles = np.arctan(np.sqrt(_tan2_of_field(source_of(image.provenance, view))))
    return np.asarray(warped_like(angles, image.provenance, view), dtype=np.float64)


def cone_of(f_number: float, magnification: float = 0.0) -> float:
    """sin^2 of the half angle under which the pixel on the axis sees the exit pupil."""
    return 1.0 / (1.0 + 4.0 * (f_number * (1.0 + abs(magnification))) ** 2)


@functools.lru_cache(maxsize=2)
def _cos4(view: Pinhole, power: float) -> FloatArray:
    """Read-only: what the lens takes away and lens shading gives back are computed once for pictures of one size."""
    x2, y2 = _tan2_of_axes(view)
    fade = np.empty((view.height_px, view.width_px), dtype=np.float32)
    for rows in strips(view.height_px):
        fade[rows] = (1.0 + x2 + y2[rows, None]) ** (-2.0 * power)
    fade.flags.writeable = False
    return fade


def _tabled(field_rad: Array, table: tuple[tuple[float, ...], tuple[float, ...]]) -> FloatArray:
    field_deg, values = table
    if not field_deg:
        raise ImageError(
            "falloff is table, but the lens has no relative_illumination; add it to the lens profile, or set falloff: "
            "cos4"
        )
    angles = np.degrees(field_rad)
    if (corner := float(angles.max())) > field_deg[-1]:
        raise ImageError(
            f"relative_illumination ends at {field_deg[-1]:g} degrees, but the picture goes out to {corner:.1f}; "
            f"measure further, or set falloff: cos4"
        )
    return np.interp(angles, field_deg, values).astype(np.float32)


def _tan2_of_field(view: Pinhole) -> Array:
    """(H, W) squared tangent of the angle between each pixel's centre and the optical axis."""
    x2, y2 = _tan2_of_axes(view)
    return np.asarray(x2 + y2[:, None])


def _tan2_of_axes(view: Pinhole) -> tuple[Array, Array]:
    """(W,) and (H,) parts of it by columns and by rows."""
    height, width, _, (right, up) = view
    x = (np.arange(width) + 0.5 - width / 2 - right * width) / view.focal_px
    y = (np.arange(height) + 0.5 - height / 2 + up * height) / view.focal_px
    return np.square(x, dtype=np.float64), np.square(y, dtype=np.float64)


def _foote(tan2_field: Array, cone: float) -> Array:
    """E / (pi L) of a disc that fills `cone` = sin^2 of its half angle, seen off its axis."""
    tan2_cone = cone / (1.0 - cone)
    root = np.sqrt(tan2_field**2 + 2.0 * tan2_field * (1.0 - tan2_cone) + (1.0 + tan2_cone) ** 2)
    return np.asarray(0.5 * (1.0 - (1.0 - tan2_cone + tan2_field) / root))
