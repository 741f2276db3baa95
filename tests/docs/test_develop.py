"""The developer's page: its example runs."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from synfog_usd import camera
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.graph import Registry

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/develop.md").read_text(encoding="utf-8")


def test_the_example_of_an_op_runs():
    """A filter of density 1 lets a tenth through; the op's page knows its range."""
    (block,) = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
    registry = Registry(camera.OPS)
    names: dict[str, object] = {"OPS": registry}  # a registry of its own
    exec(
        compile(
            block.replace("from synfog_usd.camera.registry import OPS\n", ""), "develop.md", "exec", dont_inherit=True
        ),
        names,
    )
    grey = Image(np.full((2, 3, 3), 5.0, dtype=np.float32), ("R", "G", "B"), Quantity.RADIANCE)
    np.testing.assert_allclose(names["grey_filter"](grey, density=1.0).pixels, 0.5, rtol=1e-6)
    assert str(registry.ops["optics.filter"].parameters["density"]) == "a number from 0 to 6"
