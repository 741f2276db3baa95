"""Lamps of street and vehicles: how bright, of what colour, and in which directions.

`LAMPS` is the one table.  Beams with a shape of their own are IES files in
`assets/lamps` (LM-63-2002, type C).  `author_lamp` puts a lamp on a stage, in its light group.

A lamp looks along its -Z.  In its file the vertical angle counts from -Z and the
horizontal one from +X towards +Y.  A street lantern hangs with -Z down and +X across
the road, +Y along it.  A vehicle's lamp has -Z ahead, +X to the right, +Y up.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux

from synfog_usd.base.arrays import Array
from synfog_usd.base.colour import TO_XYZ
from synfog_usd.base.errors import ParameterError, did_you_mean
from synfog_usd.base.photometry import observer
from synfog_usd.base.spectra import EMISSION, emission

STREET, VEHICLE = "street_lamps", "headlights"
GROUP_ATTRIBUTE = "synfog:lightGroup"


@dataclass(frozen=True)
class LampType:
    """One kind of lamp.

    Attributes:
        about: one sentence.
        group: light group.
        spectrum: name of a CIE illuminant (CIE 015:2018), or of `spectra.LEDS`.
        source: where the figures are from.
        candela: on the axis for a signal, the greatest elsewhere [cd].
        limits_cd: least and greatest that the source allows for `candela`; the narrower where editions differ; None
            where no rule sets any.
        flux_lm: out of the lantern [lm].
        radius_m: of the luminous opening, taken as a ball, or as a disk without `ies`.
        watts: electrical power [W]; lamp_lm: flux of the bare lamp, -1 where it cannot be told apart.
        ies: whether its beam is the file of its name in `assets/lamps`; else it shines as a flat disk does, I cos.
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
    ies: bool = False

    @property
    def nits(self) -> float:
        """Luminance of the opening seen along the axis [cd m-2]."""
        return self.candela / (np.pi * self.radius_m**2)


def _signal(
    about: str, spectrum: str, candela: float, limits: tuple[float, float], radius_m: float, source: str
) -> LampType:
    return LampType(about, VEHICLE, spectrum, source, candela, limits, round(np.pi * candela, 1), radius_m)


RED, AMBER = "LED 625 nm", "LED 592 nm"
LAMPS: Mapping[str, LampType] = {
    "street_sodium_150w": LampType(
        "Street lantern, high-pressure sodium 150 W behind flat glass, IES type II, medium, cut-off.",
        STREET,
        "HP1",
        "lamp 17 500 lm, light output ratio 0.78: usual catalogue figures",
        7500.0,
        None,
        13_650.0,
        0.12,
        150.0,
        17_500.0,
        ies=True,
    ),
    "street_led_60w": LampType(
        "Street lantern, white LED 60 W, IES type III, medium, full cut-off.",
        STREET,
        "LED-B3",
        "133 lm/W out of the lantern: usual catalogue figures",
        4570.0,
        None,
        8_000.0,
        0.12,
        60.0,
        -1.0,
        ies=True,
    ),
    "street_metal_halide_100w": LampType(
        "Post-top lantern, ceramic metal halide 100 W, the same all round (type V), full cut-off.",
        STREET,
        "HP4",
        "lamp 9 000 lm, light output ratio 0.75: usual catalogue figures",
        2040.0,
        None,
        6_750.0,
        0.15,
        100.0,
        9_000.0,
        ies=True,
    ),
    "low_beam_halogen": LampType(
        "Dipped beam for right-hand traffic, filament lamp, cut-off with a kink of 15 degrees.",
        VEHICLE,
        "A",
        "UN Regulation 112, class B",
        22_000.0,
        (10_100.0, 44_000.0),
        474.0,
        0.06,
        55.0,
        -1.0,
        ies=True,
    ),
    "low_beam_led": LampType(
        "Dipped beam for right-hand traffic, LED, cut-off with a kink of 15 degrees.",
        VEHICLE,
        "LED-B4",
        "UN Regulation 112, class B",
        26_000.0,
        (10_100.0, 44_000.0),
        560.0,
        0.04,
        25.0,
        -1.0,
        ies=True,
    ),
    "high_beam_halogen": LampType(
        "Driving beam, filament lamp.",
        VEHICLE,
        "A",
        "UN Regulation 112, class B",
        60_000.0,
        (40_500.0, 215_000.0),
        1365.0,
        0.07,
        60.0,
        -1.0,
        ies=True,
    ),
    "high_beam_led": LampType(
        "Driving beam, LED.",
        VEHICLE,
        "LED-B4",
        "UN Regulation 112, class B",
        75_000.0,
        (40_500.0, 215_000.0),
        1706.0,
        0.04,
        30.0,
        -1.0,
        ies=True,
    ),
    "daytime_running": _signal("Daytime running lamp.", "LED-B5", 600.0, (400.0, 1200.0), 0.04, "UN Regulation 87"),
    "front_position": _signal(
        "Front position lamp.", "LED-B5", 20.0, (4.0, 60.0), 0.025, "UN Regulation 7, category A"
    ),
    "tail": _signal("Rear position lamp.", RED, 8.0, (4.0, 12.0), 0.045, "UN Regulation 7, category R1"),
    "brake": _signal("Stop lamp.", RED, 100.0, (60.0, 185.0), 0.045, "UN Regulation 7, category S1"),
    "brake_centre": _signal(
        "High-mounted centre stop lamp.", RED, 50.0, (25.0, 80.0), 0.035, "UN Regulation 7, category S3"
    ),
    "indicator_front": _signal(
        "Front direction indicator.", AMBER, 300.0, (175.0, 400.0), 0.04, "UN Regulation 6, category 1"
    ),
    "indicator_rear": _signal(
        "Rear direction indicator.", AMBER, 150.0, (50.0, 200.0), 0.04, "UN Regulation 6, category 2a"
    ),
    "rear_fog": _signal("Rear fog lamp.", RED, 220.0, (150.0, 300.0), 0.045, "UN Regulation 38"),
    "reversing": _signal("Reversing lamp.", "LED-B5", 150.0, (80.0, 300.0), 0.035, "UN Regulation 23"),
    "side_marker": _signal("Amber side-marker lamp.", AMBER, 6.0, (4.0, 25.0), 0.02, "UN Regulation 91, category SM1"),
}
"""Every lamp by name; vehicle builders take candela, radius and tint from here."""


def lamp_of(name: str) -> LampType:
    """The lamp of this name.

    Raises:
        ParameterError: another name.
    """
    if name not in LAMPS:
        raise ParameterError(f"lamp {name!r} does not exist; it can be {', '.join(LAMPS)}.{did_you_mean(name, LAMPS)}")
    return LAMPS[name]


def spectrum(lamp: LampType) -> Array:
    """Relative spectral power of a lamp, (401,) on `photometry.WAVELENGTHS_NM`.

    Source: CIE 015:2018; single LEDs by the model of Ohno (2005); both from colour-science.
    """
    return emission(lamp.spectrum)


@functools.lru_cache(maxsize=32)
def tint(name: str) -> tuple[float, float, float]:
    """Linear Rec.709 of luminance 1 of a lamp's light; a hue that no Rec.709 mixes takes the nearest without negative
    light.

    Raises:
        ParameterError: another name.
    """
    xyz = observer() @ spectrum(lamp_of(name))
    rgb = np.maximum(np.linalg.inv(TO_XYZ) @ (xyz / xyz[1]), 0.0)
    rgb /= TO_XYZ[1] @ rgb
    r, g, b = (round(float(c), 4) for c in rgb)
    return r, g, b


def author_lamp(
    stage: Usd.Stage,
    path: Sdf.Path | str,
    name: str,
    place: npt.ArrayLike,
    *,
    lamps: str = "../assets/lamps",
    group: str | None = None,
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
    if not lamp.ies:
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
