"""Spectra that are kept as files: they are colour-science's to a rounding, and a picture needs no more of it."""

from __future__ import annotations

import subprocess
import sys

import numpy as np

from docs.studies import spectra_tables
from synfog_usd.base import tables


def test_the_files_hold_what_colour_science_has():
    """Made again by `python -m docs.studies.spectra_tables`; exponentials differ between processors."""
    for name, columns in spectra_tables.from_colour_science().items():
        kept = tables.table(name)
        assert list(kept) == list(columns)
        for key, values in columns.items():
            np.testing.assert_allclose(kept[key], values, rtol=1e-14, atol=0.0, err_msg=f"{name} {key}")


def test_metering_needs_no_heavy_library():
    """Loading a graph and metering, in a fresh interpreter."""
    code = (
        "import sys; import numpy as np; from pathlib import Path; from synfog_usd import camera; from "
        "synfog_usd.base.image import Image, Quantity; "
        "graph = camera.load_graph(Path('phone')); "
        "camera.meter(Image(np.ones((8, 8, 3), np.float32), ('R', 'G', 'B'), Quantity.RADIANCE, "
        "provenance={'fov_x_deg': 60.0}), graph); "
        "print({'colour', 'matplotlib', 'scipy.interpolate', 'scipy.optimize', 'tifffile'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout == "set()\n"
