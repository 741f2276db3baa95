"""Spectra of colour-science that every picture needs, kept as files: importing the whole of it takes seconds.

`python -m docs.studies.spectra_tables` writes `assets/spectra` again, from colour-science.
"""

from __future__ import annotations

import functools

import numpy as np

from synfog_usd.base import resources
from synfog_usd.base.arrays import Array
from synfog_usd.base.errors import ParameterError

GRID_NM: Array = np.arange(380.0, 781.0, 1.0)
"""Wavelengths of the tables that a picture's integrals use [nm]."""

STANDARD = "cie"
"""Name of the table of `GRID_NM`: lights, observer, and the basis of Mallett and Yuksel."""

LIGHTS = ("D65", "A", "HP1", "HP4", "LED-B3", "LED-B4", "LED-B5")
"""Lights of that table by the names of CIE 015:2018; it has those of `spectra.LEDS` too."""

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
