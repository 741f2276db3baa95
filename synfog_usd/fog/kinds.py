"""Kinds of medium: fog, haze, mist, smoke, dust, spray, rain and snow, each as a `FogMedium`, and several in one place.

Takes a kind with a visibility or a rate; gives extinction, albedo and phase function, from tables that
`docs/studies/media.py` computes.  Knows nothing of USD or Mitsuba.

>>> medium_of("rain", rate_mm_h=10.0).visibility_m > medium_of("dust", mor_m=500.0).visibility_m
True
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from synfog_usd.base import tables
from synfog_usd.base.arrays import Array
from synfog_usd.base.errors import ParameterError, did_you_mean
from synfog_usd.fog import drops, mie
from synfog_usd.fog.drops import Sizes
from synfog_usd.fog.medium import Colours, FogMedium, extinction_from_visibility
from synfog_usd.fog.phase import HenyeyGreenstein, Phase, Tabulated

FOG = "fog"
"""The kind that its own attributes shape."""

SNOW_G = 0.55
"""Mean cosine [1] of a flake without its diffraction: 2 g - 1 with g = 0.775 of measured blowing snow.
Raisanen et al., The Cryosphere 9, 1277 (2015)."""


@dataclass(frozen=True)
class Kind:
    """A kind of medium.

    Attributes:
        name: one of `KINDS`.
        about: what of, with source.
        rated: whether it is asked for by a rate [mm/h of water] too.
    """

    name: str
    about: str
    rated: bool = False


KINDS = {
    kind.name: kind
    for kind in (
        Kind(FOG, "droplets as g, phase and dropletDiameter say"),
        Kind("haze", "droplets of 0.07 um radius: haze L, Deirmendjian (1969)"),
        Kind("mist", "droplets of 2 um radius: moderate radiation fog, Shettle and Fenn (1979)"),
        Kind("smoke", "soot: OPAC, Hess et al. (1998)"),
        Kind("dust", "transported mineral dust: OPAC, Hess et al. (1998)"),
        Kind("spray", "droplets of 4 um radius: strong spray, Rasshofer et al. (2011); cloud C1, Deirmendjian (1969)"),
        Kind("rain", "Marshall and Palmer (1948), drops as rays", rated=True),
        Kind("snow", "Sekhon and Srivastava (1970), dry flakes", rated=True),
    )
}


def medium_of(
    kind: str, *, mor_m: float | None = None, rate_mm_h: float | None = None, sizes: Sizes | None = None
) -> FogMedium:
    """A uniform medium of a kind, as a picture shows it.

    Args:
        kind: one of `KINDS`.
        mor_m: meteorological optical range [m].
        rate_mm_h: of rain or snow [mm/h of water], 0.01 to 1000; instead of `mor_m`.
        sizes: other ones than the kind has by itself, by the theory of Lorenz and Mie, or of rain and snow as the rest
            of it; where there is neither of the two, as many as they say.

    Raises:
        ParameterError: no such kind, a value outside its range, both values or none, or miepython is missing.
    """
    _check(kind, mor_m, rate_mm_h, sizes)
    if kind == FOG and sizes is None:
        return FogMedium(_extinction(mor_m))
    rated = KINDS[kind].rated
    if rated and sizes is None and rate_mm_h is not None:
        sizes = drops.rain_sizes(rate_mm_h) if kind == "rain" else drops.snow_sizes(rate_mm_h)
    if sizes is None:
        of_sizes, colours, phase = 0.0, _colours(kind), _phase(kind)
    elif rated:
        of_sizes, colours, phase = drops.extinction(kind, sizes, drops.PICTURE), _colours(kind), _phase(kind)
    else:
        of_sizes, colours, phase = _of_spheres(MATERIALS[kind], sizes)
    albedo = 1.0 if colours is None else float(colours.albedo_at(550.0))
    if mor_m is not None:  # as dense as one sees: no single drop is known
        return FogMedium(_extinction(mor_m), albedo, phase=phase, colours=colours)
    falls = ((kind, sizes),) if rated and sizes is not None else ()
    return FogMedium(of_sizes, albedo, phase=phase, colours=colours, falls=falls)


def _check(kind: str, mor_m: float | None, rate_mm_h: float | None, sizes: Sizes | None) -> None:
    if kind not in KINDS:
        raise ParameterError(f"kind {kind!r}: it takes {', '.join(KINDS)}.{did_you_mean(kind, KINDS)}")
    measures = [value for value in (mor_m, rate_mm_h) if value is not None]
    if len(measures) == 2 or (not measures and sizes is None):
        raise ParameterError(f"{kind}: it takes a visibility [m] or a rate [mm/h], and one of them")
    if rate_mm_h is not None and not KINDS[kind].rated:
        raise ParameterError(f"{kind}: it takes a visibility [m]; rain and snow take a rate [mm/h]")


def _extinction(mor_m: float | None) -> float:
    assert mor_m is not None
    return float(extinction_from_visibility(mor_m))


def joined(media: Sequence[FogMedium]) -> FogMedium:
    """Several media in one place as one: extinctions add, phase functions mix by what each scatters.

    Raises:
        ParameterError: media whose extinctions go differently from place to place.
    """
    first = media[0]
    if len(media) == 1:
        return first
    if len({(medium.profile, medium.base_height_m, medium.scale_height_m, medium.grid) for medium in media}) > 1:
        raise ParameterError(
            "media in one place are all uniform, or of one scale height, or of one grid: name the same profile, scale "
            "or patches for each"
        )
    extinction = np.array([medium.sigma_t_per_m for medium in media])
    scattering = extinction * [medium.albedo for medium in media]
    total = float(extinction.sum())
    if total == 0.0:  # of no density anywhere
        return first
    colours = None
    if any(medium.colours is not None or medium.angstrom != 0.0 for medium in media):
        nm = tables.table("media")["wavelength_nm"]
        by_nm = extinction[:, None] * np.stack([medium.extinction_at(nm) for medium in media])
        scattered = (by_nm * np.stack([medium.albedo_at(nm) for medium in media])).sum(axis=0)
        by_nm = by_nm.sum(axis=0)
        colours = Colours(tuple(nm), tuple(by_nm / total), tuple(np.minimum(scattered / by_nm, 1.0)))
    return replace(
        first,
        sigma_t_per_m=total,
        albedo=min(float(scattering.sum()) / total, 1.0),
        phase=_mixed([medium.phase_function for medium in media], scattering),
        colours=colours,
        angstrom=0.0,
        falls=tuple(part for medium in media for part in medium.falls),
    )


def _mixed(phases: Sequence[Phase], scattering: Array) -> Phase:
    if len(set(phases)) == 1 or not scattering.any():
        return phases[0]
    cosines = np.unique(np.concatenate([phase.table()[0] for phase in phases]))
    shares = scattering / scattering.sum()
    values = sum(share * phase.value(cosines) for share, phase in zip(shares, phases, strict=True))
    return Tabulated(cosines, np.asarray(values), "a mixture")


MATERIALS = {FOG: "water", "haze": "water", "mist": "water", "spray": "water", "smoke": "soot", "dust": "mineral"}
"""Kind -> what its spheres are of, see `mie.index`."""

_MIE_NM = (380.0, 420.0, 460.0, 500.0, 550.0, 600.0, 650.0, 700.0, 800.0, 1000.0, 1250.0, 1500.0, 1700.0)


@functools.lru_cache(maxsize=16)
def _of_spheres(material: str, sizes: Sizes) -> tuple[float, Colours, Phase]:
    """(extinction [1/m] at 550 nm, colours, phase function at 550 nm) of spheres, as `docs/studies/media.py` has the
    tables; takes ten seconds.
    """
    radii_um = mie.radii_of(sizes)
    rows = [mie.optics(sizes, mie.index(material, nm), nm, radii_um) for nm in _MIE_NM]
    per_m = np.array([row.extinction_per_m for row in rows])
    at_550 = float(per_m[_MIE_NM.index(550.0)])
    colours = Colours(_MIE_NM, tuple((per_m / at_550).tolist()), tuple(row.albedo for row in rows))
    cosines = np.cos(np.radians(tables.table("media_phase")["angle_deg"]))[::-1]
    x, numbers = mie.weighted(sizes, 550.0, radii_um)
    values = mie.intensity(mie.index(material, 550.0), x, numbers, cosines)
    return at_550, colours, Tabulated(cosines, values, f"{material} of stated sizes")


@functools.cache
def _colours(kind: str) -> Colours | None:
    """How a kind depends on wavelength; None for snow, which is white."""
    table = tables.table("media")
    nm = table["wavelength_nm"]
    if kind == "snow":
        return None
    per_km = table.get(f"{kind}_per_km", np.ones_like(nm))
    ratio = per_km / np.interp(550.0, nm, per_km)
    return Colours(tuple(nm.tolist()), tuple(ratio.tolist()), tuple(table[f"{kind}_albedo"].tolist()))


@functools.cache
def _phase(kind: str) -> Phase:
    if kind == "snow":
        return HenyeyGreenstein(SNOW_G)
    table = tables.table("media_phase")
    cosines = np.cos(np.radians(table["angle_deg"]))[::-1]
    return Tabulated(cosines, table[kind][::-1], KINDS[kind].about)
