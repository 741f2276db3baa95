"""The tables of `assets/spectra` for haze, mist, smoke, dust, spray and rain, written again; needs miepython.

python -m docs.studies.media

Small spheres are summed by the theory of Lorenz and Mie.  Drops of rain are traced as rays: their diffraction bends
light by less than a pixel, and is no part of a picture's medium (`fog.drops.PICTURE`).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from synfog_usd.base import resources
from synfog_usd.base.arrays import Array
from synfog_usd.fog import mie
from synfog_usd.fog.drops import GammaSizes, LogNormalSizes, Sizes, rain_sizes

WAVELENGTHS_NM = (
    380, 400, 420, 440, 460, 480, 500, 520, 550, 580, 600, 620, 640, 660, 680, 700, 750, 800, 900, 1000, 1250, 1500,
    1700,
)  # fmt: skip


@dataclass(frozen=True)
class Spheres:
    """Spheres of one size distribution, with 1 or 100 of them in a cm^3, and the radii [um] that count."""

    sizes: Sizes
    material: str
    radii_um: tuple[float, float]

    def index_at(self, wavelength_nm: float) -> complex:
        """n - ik."""
        return mie.index(self.material, wavelength_nm)


SPHERES = {
    "haze": Spheres(GammaSizes.of_radii(100.0, 2.0, 0.5, 0.07), "water", (0.005, 20.0)),
    "mist": Spheres(GammaSizes.of_radii(200.0, 6.0, 1.0, 2.0), "water", (0.05, 20.0)),
    "smoke": Spheres(LogNormalSizes(1e6, 2.0 * 0.0118e-3, 2.0), "soot", (0.005, 20.0)),
    "dust": Spheres(LogNormalSizes(1e6, 2.0 * 0.5e-3, 2.2), "mineral", (0.02, 5.0)),
    "spray": Spheres(GammaSizes.of_radii(100.0, 6.0, 1.0, 4.0), "water", (0.05, 40.0)),
}
"""Kind -> its spheres, see `synfog_usd.fog.kinds`."""

ANGLES_DEG: Array = np.r_[np.arange(0.0, 10.0, 0.05), np.arange(10.0, 180.25, 0.25)]
"""Rows of the phase functions."""

RAIN = rain_sizes(10.0)
ORDERS = 20
"""Ways of a ray out of a drop: reflected, through, after one and more reflections inside."""

BOW_DEG = 0.27
"""Deviation by which a bow is smoothed: the sun's radius."""


def rain(wavelength_nm: float, angles_deg: Array) -> tuple[float, Array]:
    """(albedo, phase function to any scale at angles) of drops of rain of 10 mm/h, as rays.

    Source: van de Hulst (1957), chapter 12.
    """
    water = mie.index("water", wavelength_nm)
    real, imaginary = water.real, -water.imag
    u = (np.arange(200000) + 0.5) / 200000  # square of the impact parameter: equal areas
    sine = np.sqrt(u)
    incident, refracted = np.arcsin(sine), np.arcsin(sine / real)
    s = (np.sin(incident - refracted) / np.sin(incident + refracted)) ** 2
    p = (np.tan(incident - refracted) / np.tan(incident + refracted)) ** 2
    diameters = np.linspace(0.05, 8.0, 200)
    areas = diameters**2 * RAIN.density(diameters)
    per_mm = 4.0 * np.pi * imaginary / (wavelength_nm * 1e-6)
    cosine = np.linspace(0.0, 1.0, 129)  # of the refracted angle; a chord is this times the diameter
    along = (np.exp(-per_mm * diameters[:, None] * cosine) * areas[:, None]).sum(axis=0) / areas.sum()
    kept = np.interp(np.cos(refracted), cosine, along)
    edges = np.linspace(0.0, np.pi, 3601)
    power, clear = np.zeros(3600), 0.0
    for order in range(ORDERS):
        if order == 0:
            turned, sent = np.pi - 2.0 * incident, (s + p) / 2.0
        else:
            turned = 2.0 * (incident - refracted) + (order - 1) * (np.pi - 2.0 * refracted)
            sent = sum((1.0 - r) ** 2 * r ** (order - 1) for r in (s, p)) / 2.0
        clear += sent.mean()
        power += np.histogram(np.arccos(np.cos(turned)), edges, weights=sent * kept**order)[0] / len(u)
    steps = np.arange(-40, 41)
    blur = np.exp(-((steps * 0.05 / BOW_DEG) ** 2) / 2.0)
    mirrored = np.pad(power, 40, mode="symmetric")
    smooth = np.convolve(mirrored, blur / blur.sum(), mode="valid")
    solid = 2.0 * np.pi * -np.diff(np.cos(edges))
    middle = np.degrees((edges[:-1] + edges[1:]) / 2.0)
    return float(power.sum() / clear), np.interp(angles_deg, middle, smooth / solid)


def columns() -> tuple[dict[str, Array], dict[str, Array]]:
    """(optics by wavelength, phase functions at 550 nm by angle)."""
    by_wavelength: dict[str, Array] = {"wavelength_nm": np.array(WAVELENGTHS_NM, float)}
    by_angle: dict[str, Array] = {"angle_deg": ANGLES_DEG}
    cosines = np.cos(np.radians(ANGLES_DEG))
    for name, spheres in SPHERES.items():
        rows = [mie.optics(spheres.sizes, spheres.index_at(nm), nm, spheres.radii_um) for nm in WAVELENGTHS_NM]
        by_wavelength[f"{name}_per_km"] = np.array([1e3 * row.extinction_per_m for row in rows])
        by_wavelength[f"{name}_albedo"] = np.array([row.albedo for row in rows])
        x, numbers = mie.weighted(spheres.sizes, 550.0, spheres.radii_um)
        by_angle[name] = mie.intensity(spheres.index_at(550.0), x, numbers, cosines)
    by_wavelength["rain_albedo"] = np.array([rain(nm, ANGLES_DEG)[0] for nm in WAVELENGTHS_NM])
    by_angle["rain"] = rain(550.0, ANGLES_DEG)[1]
    for name in [*SPHERES, "rain"]:
        by_angle[name] /= 2.0 * np.pi * np.trapezoid(by_angle[name][::-1], cosines[::-1])
    return by_wavelength, by_angle


def write(folder: Path) -> None:
    """Write both tables, numbers to six digits."""
    for name, table in zip(("media", "media_phase"), columns(), strict=True):
        rows = [",".join(f"{value:.6g}" for value in row) for row in zip(*table.values(), strict=True)]
        (folder / f"{name}.csv").write_text("\n".join([",".join(table), *rows]) + "\n", encoding="ascii")


if __name__ == "__main__":
    write(resources.folder("assets") / "spectra")
