"""Spectra of colour-science that every picture needs, kept as files: importing the whole of it takes seconds.

`python -m synfog_usd.base.tables` writes `assets/spectra` again, from colour-science.
"""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np

from synfog_usd.base import resources
from synfog_usd.base.arrays import Array
from synfog_usd.base.errors import ParameterError
from synfog_usd.base.science import colour_science

GRID_NM: Array = np.arange(380.0, 781.0, 1.0)
"""Wavelengths of the tables that a picture's integrals use [nm]."""

LIGHTS = ("D65", "A", "HP1", "LED-B3")
"""CIE illuminants of the table, by the names of CIE 015:2018."""

STANDARD = "cie"
"""Name of the table of `GRID_NM`: lights, observer, and the basis of Mallett and Yuksel."""

CAMERAS = {"Nikon 5100 (NPL)": "nikon_5100_npl", "Sigma SDMerill (NPL)": "sigma_sdmerill_npl"}
"""Measured sensitivities in colour-science's `MSDS_CAMERA_SENSITIVITIES` -> name of their table."""


@functools.lru_cache(maxsize=8)
def table(name: str) -> dict[str, Array]:
    """The columns of a table by their names, 'wavelength_nm' among them; read-only float64.

    Raises:
        ParameterError: no such table.
    """
    path = resources.folder("assets") / "spectra" / f"{name}.csv"
    if not path.is_file():
        raise ParameterError(
            f"{path}: no such table; there are {', '.join(sorted(file.stem for file in path.parent.glob('*.csv')))}"
        )
    header, *lines = path.read_text(encoding="ascii").splitlines()
    columns = np.array([line.split(",") for line in lines], dtype=np.float64).T
    columns.flags.writeable = False
    return dict(zip(header.split(","), columns, strict=True))


def from_colour_science() -> dict[str, dict[str, Array]]:
    """All tables, by name, as colour-science has them; values between its own wavelengths are on straight lines."""
    colour = colour_science()

    def on_grid(wavelengths_nm: Array, values: Array) -> Array:
        return np.interp(GRID_NM, wavelengths_nm, values)

    lights = {
        name: on_grid(colour.SDS_ILLUMINANTS[name].wavelengths, colour.SDS_ILLUMINANTS[name].values) for name in LIGHTS
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
    tables = {STANDARD: {"wavelength_nm": GRID_NM, **lights, **observer_curves, **shapes}}
    for camera, name in CAMERAS.items():
        measured = colour.MSDS_CAMERA_SENSITIVITIES[camera]
        tables[name] = {
            "wavelength_nm": measured.wavelengths,
            **{letter: measured.values[:, index] for index, letter in enumerate("RGB")},
        }
    return tables


def write(folder: Path) -> None:
    """Write every table; numbers as their shortest text that gives the same float64 back."""
    for name, columns in from_colour_science().items():
        rows = [",".join(repr(float(value)) for value in row) for row in zip(*columns.values(), strict=True)]
        (folder / f"{name}.csv").write_text("\n".join([",".join(columns), *rows]) + "\n", encoding="ascii")


if __name__ == "__main__":
    write(resources.folder("assets") / "spectra")
