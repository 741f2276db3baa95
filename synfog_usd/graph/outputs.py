"""Which picture fits into which file: checked when a graph is loaded.

The writers check again what they are given; this table is what a graph can know
before it runs.
"""

from __future__ import annotations

import re

from synfog_usd.graph.op import Port
from synfog_usd.image import Quantity

FORMATS = {
    ".dng": Port(Quantity.DN, "mosaic"),
    ".exr": Port(),
    ".png": Port(Quantity.DISPLAY_RGB),
}
"""File suffix -> what it can hold."""

TAKEN = frozenset({"radiance.exr", "layers.exr", "labels.exr"})
"""Names under which a bake leaves files of its own in the same folder."""


def fault(file_name: str) -> str:
    """What is wrong with an output's file name, or ''.

    >>> fault("srgb.png")
    ''
    >>> fault("../srgb.png")
    'it is not a plain file name; use letters, digits, . _ - only'
    >>> fault("srgb.jpg")
    "its format '.jpg' is not known; it can be .dng, .exr, .png"
    """
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}", file_name):
        return "it is not a plain file name; use letters, digits, . _ - only"
    suffix = suffix_of(file_name)
    if suffix not in FORMATS:
        return f"its format {suffix!r} is not known; it can be {', '.join(FORMATS)}"
    if file_name.lower() in TAKEN:
        return "a bake writes a file of that name itself; choose another"
    return ""


def suffix_of(file_name: str) -> str:
    """The lower-case suffix with its dot; '' where there is none."""
    stem, dot, end = file_name.rpartition(".")
    return f".{end.lower()}" if dot and stem else ""
