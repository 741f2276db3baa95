"""What a DNG's reader may do about the lens: straighten its lines and brighten its corners.

Takes the provenance that `optics.irradiance`, `optics.distortion` and `optics.fisheye` left; gives the bytes of
OpcodeList3, whose opcodes a reader applies to the picture it has demosaiced.  All are marked optional.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from synfog_usd.base.fisheye import Fisheye

WARP_RECTILINEAR, WARP_FISHEYE, FIX_VIGNETTE_RADIAL = 1, 2, 3
SINCE = 0x01030000
"""DNG 1.3 brought them."""

OPTIONAL = 1
FIT_POINTS = 400


def opcode_list(height_px: int, width_px: int, metadata: Mapping[str, Any]) -> bytes:
    """OpcodeList3, big-endian as in every DNG; b'' where the provenance says of no lens, or of one of numbers that are
    not finite.

    Args:
        height_px, width_px: of the picture.
        metadata: provenance: `distortion_coefficients` and `camera_matrix_px`, `falloff`, `fov_x_deg`, `f_number`,
            `shift_x`, `shift_y`, `relative_illumination`, `fisheye_coefficients` and `fisheye_fov_x_deg`, as far as
            known.

    Source: Adobe, Digital Negative Specification 1.7.1, chapter 7.
    """
    codes = []
    for opcode in (_warp, _vignette):
        try:
            with np.errstate(all="ignore"):
                codes.append(opcode(height_px, width_px, metadata))
        except (ArithmeticError, ValueError, np.linalg.LinAlgError):  # what is not finite cannot be fitted
            continue
    codes = [code for code in codes if code]
    return struct.pack(">I", len(codes)) + b"".join(codes) if codes else b""


def _warp(height_px: int, width_px: int, metadata: Mapping[str, Any]) -> bytes:
    """WarpRectilinear of one set of coefficients: where each straight place lies in the bent picture.

    Its polynomial is OpenCV's with radii in parts of the farthest corner's; of OpenCV's quotient the one that misses
    it least within the picture.
    """
    if "fisheye_coefficients" in metadata:
        return _unfold(height_px, width_px, metadata)
    coefficients = metadata.get("distortion_coefficients")
    if not coefficients:
        return b""
    focal_px, centre = metadata["camera_matrix_px"][0][0], _centre(metadata["camera_matrix_px"])
    corner_px = _corner(height_px, width_px, centre)
    k1, k2, p1, p2, k3, k4, k5, k6 = (*coefficients, 0.0, 0.0, 0.0, 0.0)[:8]
    r = np.linspace(0.0, 1.0, FIT_POINTS)
    square = (r * corner_px / focal_px) ** 2
    radial = (1.0 + square * (k1 + square * (k2 + square * k3))) / (1.0 + square * (k4 + square * (k5 + square * k6)))
    terms = np.stack([np.ones_like(r), r**2, r**4, r**6], axis=1) * r[:, None]
    radial_terms = np.linalg.lstsq(terms, radial * r, rcond=None)[0]
    scale = corner_px / focal_px
    numbers = [*radial_terms, p1 * scale, p2 * scale, *_relative(height_px, width_px, centre)]
    return _opcode(WARP_RECTILINEAR, struct.pack(">I", 1), numbers)


def _unfold(height_px: int, width_px: int, metadata: Mapping[str, Any]) -> bytes:
    """WarpFisheye of one set of coefficients: where each straight place lies in the fisheye's picture.

    By the specification the straight picture has its farthest corner at 45 degrees.  Radii in the fisheye's picture are
    parts of that corner's distance, kr0 t + kr1 t^3 + kr2 t^5 + kr3 t^7 of the angle t.  The coefficients are fitted.
    """
    lens, centre = _fisheye(metadata), _axis(height_px, width_px, metadata)
    corner_px = _corner(height_px, width_px, centre)
    angles = np.linspace(0.0, math.pi / 4.0, FIT_POINTS)
    terms = np.stack([angles**power for power in (1, 3, 5, 7)], axis=1)
    numbers = np.linalg.lstsq(terms, lens.radius(angles) * (width_px / corner_px), rcond=None)[0]
    relative = _relative(height_px, width_px, centre)
    return _opcode(WARP_FISHEYE, struct.pack(">I", 1), [*numbers, *relative])


def _fisheye(metadata: Mapping[str, Any]) -> Fisheye:
    return Fisheye(tuple(metadata["fisheye_coefficients"]), float(metadata["fisheye_fov_x_deg"]))


def _axis(height_px: int, width_px: int, metadata: Mapping[str, Any]) -> tuple[float, float]:
    return (
        (width_px - 1) / 2.0 + float(metadata.get("shift_x") or 0.0) * width_px,
        (height_px - 1) / 2.0 - float(metadata.get("shift_y") or 0.0) * height_px,
    )


def _vignette(height_px: int, width_px: int, metadata: Mapping[str, Any]) -> bytes:
    """FixVignetteRadial: 1 + k0 r^2 + ... + k4 r^10, r 1 at the farthest corner, over what the lens left there.

    Foote's disc is taken for its cos^4, which it is within some per cent at f/2 and behind it nearly exactly.
    """
    kind, fov_x_deg = metadata.get("falloff", "none"), metadata.get("fov_x_deg")
    curved = "fisheye_coefficients" in metadata
    if kind == "none" or (fov_x_deg is None and not curved):
        return b""
    centre = _axis(height_px, width_px, metadata)
    if curved:
        focal_px = _corner(height_px, width_px, centre)  # of the picture that WarpFisheye makes
    else:
        focal_px = width_px / 2.0 / math.tan(math.radians(float(fov_x_deg or 0.0)) / 2.0)
    if "camera_matrix_px" in metadata:
        focal_px, centre = metadata["camera_matrix_px"][0][0], _centre(metadata["camera_matrix_px"])
    r = np.linspace(0.0, 1.0, FIT_POINTS)
    tangent = r * _corner(height_px, width_px, centre) / focal_px
    if "relative_illumination" in metadata:
        angles, values = metadata["relative_illumination"]
        light = np.interp(np.degrees(np.arctan(tangent)), angles, values)
    elif kind == "projection":
        light = _fisheye(metadata).solid_angle(np.arctan(tangent)) if curved else (1.0 + tangent**2) ** -1.5
    else:
        light = (1.0 + tangent**2) ** -2
    terms = np.stack([r ** (2 * power) for power in range(1, 6)], axis=1)
    weights = light[:, None]  # a relative error counts alike in the middle and in the corner
    numbers = np.linalg.lstsq(terms * weights, (1.0 / light - 1.0) * light, rcond=None)[0]
    return _opcode(FIX_VIGNETTE_RADIAL, b"", [*numbers, *_relative(height_px, width_px, centre)])


def _opcode(number: int, head: bytes, numbers: Sequence[float]) -> bytes:
    if not np.isfinite(numbers).all():
        return b""
    parameters = head + struct.pack(f">{len(numbers)}d", *numbers)
    return struct.pack(">IIII", number, SINCE, OPTIONAL, len(parameters)) + parameters


def _centre(matrix: Sequence[Sequence[float]]) -> tuple[float, float]:
    return float(matrix[0][2]), float(matrix[1][2])


def _corner(height_px: int, width_px: int, centre: tuple[float, float]) -> float:
    """Distance of the axis to the farthest corner pixel [px]."""
    return max(math.hypot(x - centre[0], y - centre[1]) for x in (0, width_px - 1) for y in (0, height_px - 1))


def _relative(height_px: int, width_px: int, centre: tuple[float, float]) -> tuple[float, float]:
    return centre[0] / max(width_px - 1, 1), centre[1] / max(height_px - 1, 1)
