"""The one import of colour-science: it takes over a second, and speaks up where Matplotlib is missing."""

from __future__ import annotations

import warnings
from typing import Any


def colour_science() -> Any:
    """The module `colour`; imported on the first call, without its remark on plotting."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message='"Matplotlib" related API features are not available')
        import colour
    return colour
