"""The skies of the library: lat-long pictures in nits that say themselves what they show.

Reads the attributes `synfog:*` of the pictures in `assets/skies` and nothing else, so that a sky
of the user's own joins by lying in such a folder.  A picture holds linear Rec.709 in cd m-2; row 0
is the zenith, and no picture shows the sun's disc.  The dome's own axes: centre of the picture is
+Z, a quarter from the left is +X, up is +Y.  `author_dome` turns +Y to the zenith, so that the left
edge of the picture lies ahead (+Y of the stage) and azimuths run clockwise seen from above.

The crossing's two (`overcast`, `dusk`) are older: relative to the dome's intensity, and no part of `skies`.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import OpenImageIO
from pxr import Sdf, Usd, UsdGeom, UsdLux

from synfog_usd.base import resources
from synfog_usd.base.errors import ParameterError, did_you_mean

OVERCAST = {
    "day": ("rain", "overcast_noon", "stratus_winter", "storm_front", "overcast"),
    "dusk": ("dusk_overcast", "deep_dusk", "night_glow", "dusk"),
}
"""Skies from which rain and snow fall."""


@dataclass(frozen=True)
class Sky:
    """What a picture of a sky says of itself.

    Attributes:
        name: of its file.
        about: one sentence.
        cie: type of the standard sky that it follows, ISO 15469:2004.
        sun_height_deg: of the sun, -90 to 90; sun_azimuth_deg: clockwise from ahead.
        illuminance_lx: on level ground, from the whole sky.
        zenith_nits: of the standard sky [cd m-2].
        cct_k: correlated colour temperature of the light on level ground [K].
        path: of the picture.
    """

    name: str
    about: str
    cie: int
    sun_height_deg: float
    sun_azimuth_deg: float
    illuminance_lx: float
    zenith_nits: float
    cct_k: float
    path: Path


@functools.cache
def skies(folder: Path | None = None) -> Mapping[str, Sky]:
    """Every sky in nits below `folder` (the shipped ones if left out), the brightest first."""
    pictures = [read(path) for path in sorted((folder or resources.folder("assets") / "skies").glob("*.exr"))]
    return MappingProxyType(
        {
            sky.name: sky
            for sky in sorted((sky for sky in pictures if sky), key=lambda sky: (-sky.illuminance_lx, sky.name))
        }
    )


def read(path: Path) -> Sky | None:
    """What a picture says of itself, or None where it is no sky in nits."""
    file = OpenImageIO.ImageInput.open(str(path))
    if file is None:
        OpenImageIO.geterror()  # clears the error, which the process would print at its end
        return None
    spec = file.spec()
    file.close()
    values = [
        spec.getattribute(f"synfog:{key}")
        for key in ("about", "cieSky", "sunHeightDeg", "sunAzimuthDeg", "illuminanceLux", "zenithNits", "cctKelvin")
    ]
    if any(value is None for value in values):
        return None
    about, cie, *numbers = values
    height, azimuth, lux, zenith, cct = (float(f"{float(value):.6g}") for value in numbers)  # float32 in the file
    return Sky(path.stem, str(about), int(cie), height, azimuth, lux, zenith, cct, path)


def sky_of(name: str) -> Sky:
    """The shipped sky of this name.

    Raises:
        ParameterError: another name.
    """
    if name not in skies():
        raise ParameterError(
            f"sky {name!r} does not exist; it can be {', '.join(skies())}.{did_you_mean(name, skies())}"
        )
    return skies()[name]


def author_dome(
    stage: Usd.Stage,
    path: Sdf.Path | str,
    name: str,
    *,
    skies: str = "../assets/skies",
    heading_deg: float = 0.0,
    gain: float = 1.0,
) -> UsdLux.DomeLight:
    """A dome light with one of `skies()`, in nits.

    Args:
        stage: Z up.
        path: of the light.
        name: of the sky.
        skies: folder of the EXR files as the stage's layer refers to it.
        heading_deg: turns the sky clockwise seen from above; at 0 its azimuth 0 is +Y.
        gain: on the tabulated luminance.

    Raises:
        ParameterError: another name.
    """
    sky = sky_of(name)
    dome = UsdLux.DomeLight.Define(stage, path)
    prim = dome.GetPrim()
    prim.SetDocumentation(
        f"{sky.about} {sky.illuminance_lx:g} lx, {sky.cct_k:g} K, sun at {sky.sun_height_deg:g} degrees."
    )
    dome.CreateIntensityAttr(gain)
    dome.CreateTextureFileAttr(Sdf.AssetPath(f"{skies}/{name}.exr"))
    dome.CreateTextureFormatAttr(UsdLux.Tokens.latlong)
    if heading_deg:
        UsdGeom.Xformable(dome).AddRotateZOp().Set(-heading_deg)
    UsdGeom.Xformable(dome).AddRotateXOp().Set(90.0)  # the picture's pole to the zenith
    return dome
