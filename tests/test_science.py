"""The import of colour-science."""

from __future__ import annotations

import subprocess
import sys


def test_colour_science_comes_without_matplotlib_and_with_its_numbers():
    """A process of its own, since others here draw: the standard observer is there, Matplotlib is not."""
    text = (
        "import sys\nfrom synfog_usd.base.science import colour_science\nfound = colour_science()\n"
        "print('matplotlib' in sys.modules, found is colour_science(), "
        "round(float(found.MSDS_CMFS['CIE 1931 2 Degree Standard Observer'][555.0][1]), 3))"
    )
    told = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True)
    assert told.stdout.split() == ["False", "True", "1.0"] and not told.stderr
