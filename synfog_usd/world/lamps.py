"""Lamps of street and vehicles: how bright, of what colour, and in which directions.

`LAMPS` is the one table.  Beams with a shape of their own are IES files in
`assets/lamps` (LM-63-2002, type C), written here from formulas; they describe no
maker's product.  `author_lamp` puts a lamp on a stage, in its light group.

A lamp looks along its -Z.  In its file the vertical angle counts from -Z and the
horizontal one from +X towards +Y.  A street lantern hangs with -Z down and +X across
the road, +Y along it.  A vehicle's lamp has -Z ahead, +X to the right, +Y up.

    python -m synfog_usd.world.lamps write [FOLDER]   # the IES files
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux

from synfog_usd.errors import ParameterError, did_you_mean
from synfog_usd.files import write_bytes
from synfog_usd.photometry import observer
from synfog_usd.science import colour_science
from synfog_usd.spectra import EMISSION, emission

Array = npt.NDArray[np.float64]
Beam = Callable[[Array, Array], Array]

STREET, VEHICLE = "street_lamps", "headlights"
GROUP_ATTRIBUTE = "synfog:lightGroup"


@dataclass(frozen=True)
class LampType:
    """One kind of lamp.

    Attributes:
        about: what it is.
        group: light group.
        spectrum: name of a CIE illuminant (CIE 015:2018), or of `spectra.LEDS`.
        source: where the figures are from.
        candela: on the axis for a signal, the greatest elsewhere [cd].
        limits_cd: least and greatest that the source allows for `candela`; the narrower where editions differ; None where no rule sets any.
        flux_lm: out of the lantern [lm].
        radius_m: of the luminous opening, taken as a ball, or as a disk without `beam`.
        watts: electrical power [W]; lamp_lm: flux of the bare lamp, -1 where it cannot be told apart.
        beam: relative intensity by (vertical, horizontal) angle [rad]; None shines as a flat disk does, I cos.
        verticals_deg, horizontals_deg: angles of its IES file.
    """

    about: str
    group: str
    spectrum: str
    source: str
    candela: float
    limits_cd: tuple[float, float] | None
    flux_lm: float
    radius_m: float
    watts: float = 0.0
    lamp_lm: float = -1.0
    beam: Beam | None = None
    verticals_deg: tuple[float, ...] = ()
    horizontals_deg: tuple[float, ...] = ()

    @property
    def nits(self) -> float:
        """Luminance of the opening seen along the axis [cd m-2]."""
        return self.candela / (np.pi * self.radius_m**2)


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
_FRONT_V = (*np.arange(0.0, 6.0, 0.25), *np.arange(6.0, 12.0, 0.5), *np.arange(12.0, 30.0, 2.0), *np.arange(30.0, 90.1, 5.0))
_LEVEL = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0, 17.0, 20.0, 25.0, 30.0, 40.0, 50.0, 60.0, 75.0)
_FRONT_H = tuple(sorted({round(x % 360, 2) for q in _LEVEL for x in (q, -q, 180 - q, 180 + q)} | {90.0, 270.0, 360.0}))


def _signal(about: str, spectrum: str, candela: float, limits: tuple[float, float], radius_m: float, source: str) -> LampType:
    return LampType(about, VEHICLE, spectrum, source, candela, limits, round(np.pi * candela, 1), radius_m)


RED, AMBER = "LED 625 nm", "LED 592 nm"
LAMPS: Mapping[str, LampType] = {
    "street_sodium_150w": LampType(
        "Street lantern, high-pressure sodium 150 W behind flat glass, IES type II, medium, cut-off.", STREET, "HP1",
        "lamp 17 500 lm, light output ratio 0.78: usual catalogue figures", 7500.0, None, 13_650.0, 0.12,
        150.0, 17_500.0, _lobes(71.0, 79.0, 10.5, 0.75, 77.5, 1.4), _STREET_V, _STREET_H,
    ),
    "street_led_60w": LampType(
        "Street lantern, white LED 60 W, IES type III, medium, full cut-off.", STREET, "LED-B3",
        "133 lm/W out of the lantern: usual catalogue figures", 4570.0, None, 8_000.0, 0.12,
        60.0, -1.0, _lobes(71.5, 65.0, 10.5, 0.75, 76.5, 1.2), _STREET_V, _STREET_H,
    ),
    "street_metal_halide_100w": LampType(
        "Post-top lantern, ceramic metal halide 100 W, the same all round (type V), full cut-off.", STREET, "HP4",
        "lamp 9 000 lm, light output ratio 0.75: usual catalogue figures", 2040.0, None, 6_750.0, 0.15,
        100.0, 9_000.0, _round(58.0, 14.0, 0.45), _STREET_V, (0.0,),
    ),
    "low_beam_halogen": LampType(
        "Dipped beam for right-hand traffic, filament lamp, cut-off with a kink of 15 degrees.", VEHICLE, "A",
        "UN Regulation 112, class B", 22_000.0, (10_100.0, 44_000.0), 474.0, 0.06, 55.0, -1.0, _low_beam, _FRONT_V, _FRONT_H,
    ),
    "low_beam_led": LampType(
        "Dipped beam for right-hand traffic, LED, cut-off with a kink of 15 degrees.", VEHICLE, "LED-B4",
        "UN Regulation 112, class B", 26_000.0, (10_100.0, 44_000.0), 560.0, 0.04, 25.0, -1.0, _low_beam, _FRONT_V, _FRONT_H,
    ),
    "high_beam_halogen": LampType(
        "Driving beam, filament lamp.", VEHICLE, "A", "UN Regulation 112, class B", 60_000.0, (40_500.0, 215_000.0), 1365.0, 0.07, 60.0, -1.0,
        _high_beam, _FRONT_V, _FRONT_H,
    ),
    "high_beam_led": LampType(
        "Driving beam, LED.", VEHICLE, "LED-B4", "UN Regulation 112, class B", 75_000.0, (40_500.0, 215_000.0), 1706.0, 0.04, 30.0, -1.0,
        _high_beam, _FRONT_V, _FRONT_H,
    ),
    "daytime_running": _signal("Daytime running lamp.", "LED-B5", 600.0, (400.0, 1200.0), 0.04, "UN Regulation 87"),
    "front_position": _signal("Front position lamp.", "LED-B5", 20.0, (4.0, 60.0), 0.025, "UN Regulation 7, category A"),
    "tail": _signal("Rear position lamp.", RED, 8.0, (4.0, 12.0), 0.045, "UN Regulation 7, category R1"),
    "brake": _signal("Stop lamp.", RED, 100.0, (60.0, 185.0), 0.045, "UN Regulation 7, category S1"),
    "brake_centre": _signal("High-mounted centre stop lamp.", RED, 50.0, (25.0, 80.0), 0.035, "UN Regulation 7, category S3"),
    "indicator_front": _signal("Front direction indicator.", AMBER, 300.0, (175.0, 400.0), 0.04, "UN Regulation 6, category 1"),
    "indicator_rear": _signal("Rear direction indicator.", AMBER, 150.0, (50.0, 200.0), 0.04, "UN Regulation 6, category 2a"),
    "rear_fog": _signal("Rear fog lamp.", RED, 220.0, (150.0, 300.0), 0.045, "UN Regulation 38"),
    "reversing": _signal("Reversing lamp.", "LED-B5", 150.0, (80.0, 300.0), 0.035, "UN Regulation 23"),
    "side_marker": _signal("Amber side-marker lamp.", AMBER, 6.0, (4.0, 25.0), 0.02, "UN Regulation 91, category SM1"),
}  # fmt: skip
"""Every lamp by name; vehicle builders take candela, radius and tint from here."""


def lamp_of(name: str) -> LampType:
    """The lamp of this name.

    Raises:
        ParameterError: another name.
    """
    if name not in LAMPS:
        raise ParameterError(f"lamp {name!r} does not exist; it can be {', '.join(LAMPS)}.{did_you_mean(name, LAMPS)}")
    return LAMPS[name]


def candela(lamp: LampType, vertical_deg: npt.ArrayLike, horizontal_deg: npt.ArrayLike) -> Array:
    """Intensity of a lamp [cd] by its formula.

    Args:
        vertical_deg: from the axis, 0 to 180; horizontal_deg: from +X towards +Y; they broadcast.
    """
    v, h = np.broadcast_arrays(np.deg2rad(np.asarray(vertical_deg, float)), np.deg2rad(np.asarray(horizontal_deg, float)))
    if lamp.beam is None:
        return lamp.candela * np.maximum(np.cos(v), 0.0)
    scale = lamp.flux_lm / _flux_of_unit(lamp.beam) if lamp.group == STREET else lamp.candela / _greatest(lamp.beam)
    return scale * lamp.beam(v, h)


def spectrum(lamp: LampType) -> Array:
    """Relative spectral power of a lamp, (401,) on `photometry.WAVELENGTHS_NM`.

    Source: CIE 015:2018; single LEDs by the model of Ohno (2005); both from colour-science.
    """
    return emission(lamp.spectrum)


@functools.lru_cache(maxsize=32)
def tint(name: str) -> tuple[float, float, float]:
    """Linear Rec.709 of luminance 1 of a lamp's light; a hue that no Rec.709 mixes takes the nearest without negative light.

    Raises:
        ParameterError: another name.
    """
    colour = colour_science()
    xyz = observer() @ spectrum(lamp_of(name))
    space = colour.RGB_COLOURSPACES["ITU-R BT.709"]
    rgb = np.maximum(np.linalg.inv(space.matrix_RGB_to_XYZ) @ (xyz / xyz[1]), 0.0)
    rgb /= space.matrix_RGB_to_XYZ[1] @ rgb
    r, g, b = (round(float(c), 4) for c in rgb)
    return r, g, b


def author_lamp(
    stage: Usd.Stage, path: Sdf.Path | str, name: str, place: npt.ArrayLike, *, lamps: str = "../assets/lamps", group: str | None = None
) -> UsdLux.BoundableLightBase:
    """A lamp on a stage in metres.

    A lamp with a beam is a small ball with its IES file: intensity 1 / (pi r^2), not
    normalized, so that the ball's candelas are the file's.  A signal is a disk.

    Args:
        stage: where.
        path: of the light.
        name: of the lamp.
        place: (4, 4) local matrix for columns, the lamp along its -Z.
        lamps: folder of the IES files as the stage's layer refers to it.
        group: light group, where it is not the lamp's own.

    Raises:
        ParameterError: another name.
    """
    lamp = lamp_of(name)
    area = np.pi * lamp.radius_m**2
    if lamp.beam is None:
        light: UsdLux.BoundableLightBase = UsdLux.DiskLight.Define(stage, path)
        light.CreateIntensityAttr(round(lamp.candela / area, 3))
    else:
        light = UsdLux.SphereLight.Define(stage, path)
        light.CreateIntensityAttr(1.0 / area)
        shaping = UsdLux.ShapingAPI.Apply(light.GetPrim())
        shaping.CreateShapingIesFileAttr(Sdf.AssetPath(f"{lamps}/{name}.ies"))
        shaping.CreateShapingIesNormalizeAttr(False)
        shaping.CreateShapingConeAngleAttr(180.0)  # the API's own cone would cut off at 90 degrees
    light.CreateRadiusAttr(lamp.radius_m)
    light.CreateColorAttr(Gf.Vec3f(*tint(name)))
    prim = light.GetPrim()
    prim.SetDocumentation(f"{lamp.about} {lamp.source}.")
    prim.CreateAttribute(GROUP_ATTRIBUTE, Sdf.ValueTypeNames.String).Set(group or lamp.group)
    prim.CreateAttribute(EMISSION, Sdf.ValueTypeNames.String).Set(lamp.spectrum)
    UsdGeom.Xformable(light).AddTransformOp().Set(Gf.Matrix4d(np.round(np.asarray(place, float).T, 6).tolist()))
    light.CreateExtentAttr(UsdGeom.Boundable.ComputeExtentFromPlugins(light, Usd.TimeCode.Default()))
    return light


def write_lamps(folder: Path) -> list[Path]:
    """Write the IES file of every lamp with a beam into `folder`; gives the files."""
    written = []
    for name, lamp in LAMPS.items():
        if lamp.beam is not None:
            written.append(folder / f"{name}.ies")
            write_bytes(written[-1], ies_text(name).encode("ascii"))
    return written


def ies_text(name: str) -> str:
    """An IES file, LM-63-2002, type C, in metres, absolute candelas.

    Raises:
        ParameterError: another name, or a lamp without a beam.
    """
    lamp = lamp_of(name)
    if lamp.beam is None:
        raise ParameterError(f"lamp {name!r} shines as a flat disk does and has no IES file; {', '.join(n for n, one in LAMPS.items() if one.beam)} have one")
    v, h = np.array(lamp.verticals_deg), np.array(lamp.horizontals_deg)
    table = candela(lamp, v[None, :], h[:, None])
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


def main(arguments: list[str]) -> int:
    """The command in the module's head."""
    if arguments[:1] != ["write"] or len(arguments) > 2:
        print("usage: python -m synfog_usd.world.lamps write [FOLDER]", file=sys.stderr)
        return 2
    for path in write_lamps(Path(arguments[1]) if len(arguments) > 1 else Path("assets/lamps")):
        print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
