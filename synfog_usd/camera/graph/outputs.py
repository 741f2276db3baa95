"""Which picture fits into which file: checked when a graph is loaded.

The writers trust this table: what is wrong with an option is found before a graph runs.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

from synfog_usd.base.errors import did_you_mean
from synfog_usd.base.image import Quantity
from synfog_usd.base.yamlio import switch
from synfog_usd.camera.graph.op import Port

Value = bool | int | str

T = TypeVar("T")


@dataclass(frozen=True)
class Option:
    """A word that may stand beside an output's node.

    Attributes:
        choices: what it may be; the first is what the writer does without the word,
            unless `help` says otherwise.
        help: what it does.
    """

    choices: Sequence[Value]
    help: str

    def __str__(self) -> str:
        if isinstance(self.choices, range):
            return f"a whole number from {self.choices[0]} to {self.choices[-1]}"
        if self.switches:
            return "true or false"
        return "one of " + ", ".join(str(choice) for choice in self.choices)

    @property
    def switches(self) -> bool:
        """Whether it is true or false."""
        return isinstance(self.choices[0], bool)

    def read(self, value: T) -> T | bool:
        """The value as the writer wants it; what it may not be stays as it is."""
        return switch(value) if self.switches else value

    def holds(self, value: object) -> bool:
        """Whether it may be that; 1 is not true, and 8.0 is not 8."""
        return any(type(value) is type(choice) and value == choice for choice in self.choices)


SCREEN = Port(Quantity.DISPLAY_RGB)

_MOSAIC = Port(Quantity.DN, "mosaic")

FORMATS = {
    ".dng": _MOSAIC,
    ".exr": Port(),
    ".png": SCREEN,
    ".jpg": SCREEN,
    ".raw10": _MOSAIC,
    ".raw12": _MOSAIC,
    ".raw14": _MOSAIC,
}
"""File suffix -> what it can hold."""

_MIPI = {"embedded_lines": Option((0, 1, 2), "Lines of MIPI CCS data before the picture.")}

OPTIONS: dict[str, dict[str, Option]] = {
    ".dng": {
        "compression": Option(
            ("none", "lossless"),
            "none: 16 bits a pixel, which every reader takes; lossless: lossless JPEG, about 40 % of the size.",
        ),
        "corrections": Option((True, False), "Say how readers may straighten lines and brighten corners."),
    },
    ".exr": {
        "compression": Option(("zip", "zips", "piz", "rle", "none"), "All of them lossless."),
        "half": Option((False, True), "16-bit floats, to 65504, for 32-bit ones."),
    },
    ".png": {"bits": Option((8, 16), "Bits a channel.")},
    ".jpg": {
        "quality": Option(range(1, 101), "libjpeg's; if left out 95."),
        "subsampling": Option(("4:2:0", "4:2:2", "4:4:4"), "Of colour."),
    },
    ".raw10": _MIPI,
    ".raw12": _MIPI,
    ".raw14": _MIPI,
}
"""File suffix -> the words that may stand beside 'node', by name: those of the writer of that format."""

NODE = "node"

TAKEN = frozenset({"radiance.exr", "layers.exr", "labels.exr"})
"""Names under which a bake leaves files of its own in the same folder."""


def fault(file_name: str) -> str:
    """What is wrong with an output's file name, or ''.

    >>> fault("srgb.png")
    ''
    >>> fault("../srgb.png")
    'it is not a plain file name; use letters, digits, . _ - only'
    >>> fault("srgb.gif")
    "its format '.gif' is not known; it can be .dng, .exr, .png, .jpg, .raw10, .raw12, .raw14"
    """
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}", file_name):
        return "it is not a plain file name; use letters, digits, . _ - only"
    suffix = suffix_of(file_name)
    if suffix not in FORMATS:
        return f"its format {suffix!r} is not known; it can be {', '.join(FORMATS)}"
    if file_name.lower() in TAKEN:
        return "a bake writes a file of that name itself; choose another"
    return ""


def option_fault(file_name: str, word: str, value: object) -> tuple[bool, str]:
    """What is wrong with a word beside an output's node: whether it is the word itself, and what; (False, '') where
    nothing is.

    >>> option_fault("raw.dng", "compresion", "lossless")
    (True, "has no 'compresion'; it takes node, compression, corrections. Did you mean 'compression'?")
    >>> option_fault("raw.dng", "compression", "zip")
    (False, "compression is 'zip'; it takes one of none, lossless")
    """
    options = OPTIONS[suffix_of(file_name)]
    if word not in options:
        names = [NODE, *options]
        return True, f"has no {word!r}; it takes {', '.join(names)}.{did_you_mean(word, names)}"
    if not options[word].holds(options[word].read(value)):
        hint = (
            did_you_mean(value, [choice for choice in options[word].choices if isinstance(choice, str)])
            if isinstance(value, str)
            else ""
        )
        return False, f"{word} is {value!r}; it takes {options[word]}{'.' if hint else ''}{hint}"
    return False, ""


def suffix_of(file_name: str) -> str:
    """The lower-case suffix with its dot; '' where there is none."""
    stem, dot, end = file_name.rpartition(".")
    return f".{end.lower()}" if dot and stem else ""
