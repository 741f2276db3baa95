"""The tables of `assets/spectra` that colour-science has, written again.

python -m docs.studies.spectra_tables
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from synfog_usd.base import resources, tables
from synfog_usd.base.arrays import Array
from synfog_usd.base.science import colour_science
from synfog_usd.base.spectra import LEDS


def from_colour_science() -> dict[str, dict[str, Array]]:
    """All tables, by name, as colour-science has them; values between its own wavelengths are on straight lines."""
    colour = colour_science()

    def on_grid(wavelengths_nm: Array, values: Array) -> Array:
        return np.interp(tables.GRID_NM, wavelengths_nm, values)

    lights = {
        name: on_grid(colour.SDS_ILLUMINANTS[name].wavelengths, colour.SDS_ILLUMINANTS[name].values)
        for name in tables.LIGHTS
    }
    grid = colour.SpectralShape(float(tables.GRID_NM[0]), float(tables.GRID_NM[-1]), 1.0)
    lights |= {
        name: colour.sd_single_led(peak, grid, half_spectral_width=half).values for name, (peak, half) in LEDS.items()
    }
    observer, basis = (
        colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"],
        colour.recovery.MSDS_BASIS_FUNCTIONS_sRGB_MALLETT2019,
    )
    observer_curves = {
        f"{axis}_bar": on_grid(observer.wavelengths, observer.values[:, index]) for index, axis in enumerate("xyz")
    }
    shapes = {
        f"basis_{letter}": on_grid(basis.wavelengths, basis.values[:, index]) for index, letter in enumerate("rgb")
    }
    result = {tables.STANDARD: {"wavelength_nm": tables.GRID_NM, **lights, **observer_curves, **shapes}}
    for camera, name in tables.CAMERAS.items():
        measured = colour.MSDS_CAMERA_SENSITIVITIES[camera]
        result[name] = {
            "wavelength_nm": measured.wavelengths,
            **{letter: measured.values[:, index] for index, letter in enumerate("RGB")},
        }
    return result


def write(folder: Path) -> None:
    """Write every table; numbers as their shortest text that gives the same float64 back."""
    for name, columns in from_colour_science().items():
        rows = [",".join(repr(float(value)) for value in row) for row in zip(*columns.values(), strict=True)]
        (folder / f"{name}.csv").write_text("\n".join([",".join(columns), *rows]) + "\n", encoding="ascii")


if __name__ == "__main__":
    write(resources.folder("assets") / "spectra")
