"""Beams of lamps by formula, and the IES files of `assets/lamps` (LM-63-2002, type C) written from them.

They describe no maker's product.  What each lamp is stands in `synfog_usd.world.lamps.LAMPS`, and which way
its angles count in that module's head.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import Array
from synfog_usd.base.errors import ParameterError
from synfog_usd.base.files import write_bytes
from synfog_usd.world.lamps import STREET, lamp_of

Beam = Callable[[Array, Array], Array]
"""Relative intensity by (vertical, horizontal) angle [rad]."""


def _lobes(vertical: float, horizontal: float, width: float, share: float, cut: float, sharp: float) -> Beam:
    """A street lantern: a lobe up and one down the road over a spread of light below, little above `cut`.

    Args:
        vertical, horizontal: direction of the lobe [deg]; 0 is straight down, and across the road.
        width: its deviation [deg].
        share: of the spread, over the lobe's peak.
        cut: angle from which little light goes [deg], within about `sharp`.
    """
    v0, h0, w = np.deg2rad([vertical, horizontal, width])

    def beam(v: Array, h: Array) -> Array:
        total = share * np.cos(np.minimum(v, np.pi / 2)) ** 0.5 * (0.75 + 0.25 * np.sin(v) * np.cos(h))
        for side in (h0, -h0):
            cosine = np.cos(v) * np.cos(v0) + np.sin(v) * np.sin(v0) * np.cos(h - side)
            total = total + np.exp((cosine - 1) / w**2)
        return total / (1 + np.exp((np.rad2deg(v) - cut) / sharp)) * (v < np.pi / 2)

    return beam


def _round(vertical: float, width: float, share: float) -> Beam:
    """A post-top lantern, the same all round: a ring of light at `vertical` [deg], nothing upwards."""

    def beam(v: Array, h: Array) -> Array:
        angle = np.rad2deg(v)
        ring = np.exp(-0.5 * ((angle - vertical) / width) ** 2)
        down = share * np.cos(np.minimum(v, np.pi / 2))
        return (ring + down) / (1 + np.exp((angle - 76.0) / 1.2)) * (v < np.pi / 2) + 0 * h

    return beam


def _ahead(v: Array, h: Array) -> tuple[Array, Array]:
    """Angles to the right and upwards [deg] of a direction about -Z."""
    x, y, z = np.sin(v) * np.cos(h), np.sin(v) * np.sin(h), np.cos(v)
    return np.rad2deg(np.arctan2(x, z)), np.rad2deg(np.arcsin(np.clip(y, -1, 1)))


CUT_OFF_DEG = -0.57  # left of the kink: one in a hundred below the horizon


KINK_DEG = 15.0


STRAY = 0.008  # of the hot spot, above the cut-off


def cut_off(right: npt.ArrayLike) -> Array:
    """Height of the low beam's cut-off [deg] by the angle to the right [deg]: level, from the kink up at 15 degrees."""
    return CUT_OFF_DEG + np.tan(np.deg2rad(KINK_DEG)) * np.clip(right, 0.0, 8.0)


def _low_beam(v: Array, h: Array) -> Array:
    """A dipped beam for right-hand traffic, aimed as it is measured: its axis level and straight ahead."""
    right, up = _ahead(v, h)
    under = cut_off(right) - up
    step = 1 / (1 + np.exp(-np.clip(under / 0.12, -60, 60)))
    spread = np.where(right < 1.5, 3.5, 6.5)
    hot = np.exp(-0.5 * ((right - 1.5) / spread) ** 2) * np.exp(-np.maximum(under, 0) / 1.7)
    wide = 0.22 * np.exp(-0.5 * (right / 17.0) ** 2) * np.exp(-np.maximum(under, 0) / 4.5)
    stray = STRAY * np.exp(-0.5 * (right / 25.0) ** 2) * np.exp(-0.5 * (np.maximum(-under, 0) / 8.0) ** 2)
    return ((hot + wide) * step + stray * (1 - step)) * (v < np.pi / 2)


def _high_beam(v: Array, h: Array) -> Array:
    """A driving beam: a narrow peak straight ahead on a wider one."""
    right, up = _ahead(v, h)
    narrow = np.exp(-0.5 * (right / 3.0) ** 2 - 0.5 * (up / 1.6) ** 2)
    wide = np.exp(-0.5 * (right / 10.0) ** 2 - 0.5 * ((up + 0.5) / 3.0) ** 2)
    return (0.72 * narrow + 0.28 * wide) * (v < np.pi / 2)


_STREET_V = (*np.arange(0.0, 90.1, 2.5), 100.0, 110.0, 120.0, 140.0, 160.0, 180.0)


_STREET_H = tuple(np.arange(0.0, 180.1, 5.0))


_FRONT_V = (
    *np.arange(0.0, 6.0, 0.25),
    *np.arange(6.0, 12.0, 0.5),
    *np.arange(12.0, 30.0, 2.0),
    *np.arange(30.0, 90.1, 5.0),
)


_LEVEL = (
    0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0, 17.0, 20.0,
    25.0, 30.0, 40.0, 50.0, 60.0, 75.0,
)  # fmt: skip


_FRONT_H = tuple(sorted({round(x % 360, 2) for q in _LEVEL for x in (q, -q, 180 - q, 180 + q)} | {90.0, 270.0, 360.0}))


@dataclass(frozen=True)
class BeamTable:
    """The beam of a lamp and the angles of its IES file [deg]."""

    beam: Beam
    verticals_deg: tuple[float, ...]
    horizontals_deg: tuple[float, ...]


BEAMS: Mapping[str, BeamTable] = {
    "street_sodium_150w": BeamTable(_lobes(71.0, 79.0, 10.5, 0.75, 77.5, 1.4), _STREET_V, _STREET_H),
    "street_led_60w": BeamTable(_lobes(71.5, 65.0, 10.5, 0.75, 76.5, 1.2), _STREET_V, _STREET_H),
    "street_metal_halide_100w": BeamTable(_round(58.0, 14.0, 0.45), _STREET_V, (0.0,)),
    "low_beam_halogen": BeamTable(_low_beam, _FRONT_V, _FRONT_H),
    "low_beam_led": BeamTable(_low_beam, _FRONT_V, _FRONT_H),
    "high_beam_halogen": BeamTable(_high_beam, _FRONT_V, _FRONT_H),
    "high_beam_led": BeamTable(_high_beam, _FRONT_V, _FRONT_H),
}
"""Lamp -> beam; all others are flat disks."""


def candela(name: str, vertical_deg: npt.ArrayLike, horizontal_deg: npt.ArrayLike) -> Array:
    """Intensity of a lamp with a beam [cd] by its formula.

    Args:
        vertical_deg: from the axis, 0 to 180; horizontal_deg: from +X towards +Y; they broadcast.
    """
    v, h = np.broadcast_arrays(
        np.deg2rad(np.asarray(vertical_deg, float)), np.deg2rad(np.asarray(horizontal_deg, float))
    )
    lamp, beam = lamp_of(name), BEAMS[name].beam
    scale = lamp.flux_lm / _flux_of_unit(beam) if lamp.group == STREET else lamp.candela / _greatest(beam)
    return scale * beam(v, h)


def write_lamps(folder: Path) -> list[Path]:
    """Write the IES file of every lamp with a beam into `folder`; gives the files."""
    written = []
    for name in BEAMS:
        written.append(folder / f"{name}.ies")
        write_bytes(written[-1], ies_text(name).encode("ascii"))
    return written


def ies_text(name: str) -> str:
    """An IES file, LM-63-2002, type C, in metres, absolute candelas.

    Raises:
        ParameterError: another name, or a lamp without a beam.
    """
    lamp = lamp_of(name)
    if name not in BEAMS:
        raise ParameterError(
            f"lamp {name!r} shines as a flat disk does and has no IES file; {', '.join(BEAMS)} have one"
        )
    v, h = np.array(BEAMS[name].verticals_deg), np.array(BEAMS[name].horizontals_deg)
    table = candela(name, v[None, :], h[:, None])
    diameter = 2 * lamp.radius_m
    lines = [
        "IESNA:LM-63-2002",
        "[TEST] none: computed by synfog_usd.world.lamps, licence CC0-1.0",
        "[TESTLAB] none",
        "[ISSUEDATE] 01-JAN-2000",
        "[MANUFAC] none",
        f"[LUMCAT] {name}",
        f"[LUMINAIRE] {lamp.about}",
        f"[LAMP] spectrum {lamp.spectrum}; {lamp.source}",
        f"[OTHER] luminaire flux {lamp.flux_lm:g} lm",
        "TILT=NONE",
        f"1 {lamp.lamp_lm:g} 1 {len(v)} {len(h)} 1 2 {-diameter:g} {-diameter:g} 0",
        f"1 1 {lamp.watts:g}",
        *_wrapped(v, 2),
        *_wrapped(h, 2),
    ]
    for row in table:
        lines += _wrapped(row, 2)
    return "\r\n".join(lines) + "\r\n"


def _wrapped(values: Array, decimals: int) -> list[str]:
    """Numbers in lines of ten."""
    words = [f"{x:.{decimals}f}".rstrip("0").rstrip(".") for x in values]
    return [" ".join(words[i : i + 10]) for i in range(0, len(words), 10)]


@functools.lru_cache(maxsize=16)
def _flux_of_unit(beam: Beam) -> float:
    """Flux [lm] of a beam as it stands, midpoint rule in 0.25 by 1 degree."""
    v = np.deg2rad((np.arange(720) + 0.5) / 4)[:, None]
    h = np.deg2rad(np.arange(360) + 0.5)[None, :]
    return float(np.sum(beam(*np.broadcast_arrays(v, h)) * np.sin(v)) * np.deg2rad(0.25) * np.deg2rad(1.0))


@functools.lru_cache(maxsize=16)
def _greatest(beam: Beam) -> float:
    """Greatest value of a beam within 12 degrees of its axis."""
    v, h = np.meshgrid(np.deg2rad(np.arange(0, 12, 0.05)), np.deg2rad(np.arange(0, 360, 1.0)))
    return float(beam(v, h).max())
