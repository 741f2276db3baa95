"""A picture in the terminal: two pixels a letter, or nothing.

Takes a PIL image; gives text with control sequences.  The variables that a terminal sets say which colours it has.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from PIL import Image

Kind = Literal["colours", "256", "none"]
KINDS: tuple[Kind, ...] = ("colours", "256", "none")

_CUBE = np.array([0, 95, 135, 175, 215, 255])
"""Levels of the 6 x 6 x 6 colours 16 to 231 of xterm's palette."""


def kind(environment: Mapping[str, str] = os.environ, *, target: int = 1) -> Kind:
    """What the terminal can show.

    Args:
        environment: TERM, COLORTERM, NO_COLOR and, of Windows Terminal, WT_SESSION.
        target: file descriptor of its screen.
    """
    term = environment.get("TERM", "")
    if not os.isatty(target) or term == "dumb" or environment.get("NO_COLOR"):
        return "none"
    if environment.get("COLORTERM") in ("truecolor", "24bit") or environment.get("WT_SESSION"):
        return "colours"
    return "256" if "256color" in term else "none"


def as_text(picture: Image.Image, how: Kind, columns: int) -> str:
    """The picture as text that a terminal draws, with a line's end.

    Args:
        picture: any size; made small enough for the columns.
        how: see `kind`.
        columns: letters that go into a line.
    """
    if how == "none":
        return ""
    return blocks(picture.convert("RGB"), columns, palette=how == "256")


def blocks(picture: Image.Image, columns: int, *, palette: bool = False) -> str:
    """The picture by upper half blocks: a letter is two pixels, one above the other.

    Args:
        picture: RGB.
        columns: letters that go into a line.
        palette: by xterm's 256 colours instead of 24 bits.
    """
    from PIL import Image

    width = max(1, min(columns, picture.width))
    height = 2 * max(1, round(picture.height * width / picture.width / 2))
    numbers = np.asarray(picture.resize((width, height), Image.Resampling.BOX))
    code: Callable[[np.ndarray], str] = _nearest if palette else lambda one: "2;" + ";".join(map(str, one))
    lines = []
    for upper, lower in zip(numbers[0::2], numbers[1::2], strict=True):
        line, before = [], ""
        for above, below in zip(upper, lower, strict=True):
            colours = f"\x1b[38;{code(above)};48;{code(below)}m"
            line.append(("" if colours == before else colours) + "▀")
            before = colours
        lines.append("".join(line) + "\x1b[0m\n")
    return "".join(lines)


def _nearest(colour: np.ndarray) -> str:
    """The colour of the cube, or the grey of xterm's ramp 232 to 255, that is nearest."""
    cube = np.abs(_CUBE[:, None] - colour[None, :].astype(int)).argmin(axis=0)
    grey = int(np.clip(np.rint((colour.mean() - 8.0) / 10.0), 0, 23))
    far = [np.square(value - colour.astype(float)).sum() for value in (_CUBE[cube], 8 + 10 * grey)]
    number = 232 + grey if far[1] < far[0] else 16 + int(cube @ [36, 6, 1])
    return f"5;{number}"


def columns() -> int:
    """Letters that go into a line of the terminal that is written to; 80 where it does not say."""
    with contextlib.suppress(OSError, ValueError):
        return os.get_terminal_size(sys.stdout.fileno()).columns or 80
    return 80
