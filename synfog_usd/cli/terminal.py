"""A picture in the terminal: sixels where it has them, else two pixels a letter, else nothing.

Takes a PIL image; gives text with control sequences.  What the terminal can do is asked of the
terminal itself (sixels) and of the variables that it sets (colours).
"""

from __future__ import annotations

import contextlib
import os
import re
import select
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from PIL import Image

Kind = Literal["sixel", "colours", "256", "none"]
KINDS: tuple[Kind, ...] = ("sixel", "colours", "256", "none")

ANSWER_S = 0.3
"""How long a terminal is given to tell what it can; a far one over ssh takes 0.1 s."""

_CUBE = np.array([0, 95, 135, 175, 215, 255])
"""Levels of the 6 x 6 x 6 colours 16 to 231 of xterm's palette."""


def kind(environment: Mapping[str, str] = os.environ, *, source: int = 0, target: int = 1) -> Kind:
    """What the terminal can show.

    Args:
        environment: TERM, COLORTERM, NO_COLOR and, of Windows Terminal, WT_SESSION.
        source, target: file descriptors of its keyboard and its screen.
    """
    term = environment.get("TERM", "")
    if not os.isatty(target) or term == "dumb" or environment.get("NO_COLOR"):
        return "none"
    if os.isatty(source) and "4" in _attributes(source, target):
        return "sixel"
    if environment.get("COLORTERM") in ("truecolor", "24bit") or environment.get("WT_SESSION"):
        return "colours"
    return "256" if "256color" in term else "none"


def drawn(picture: Image.Image, how: Kind, columns: int) -> str:
    """The picture as text that a terminal draws, with a line's end.

    Args:
        picture: any size; shown by pixels as sixels, else made small enough for the columns.
        how: see `kind`.
        columns: letters that go into a line.
    """
    if how == "none":
        return ""
    picture = picture.convert("RGB")
    return f"{sixels(picture)}\n" if how == "sixel" else blocks(picture, columns, palette=how == "256")


def sixels(picture: Image.Image) -> str:
    """The picture by up to 256 colours, six rows at a time (DEC STD 070, chapter 9; VT330/VT340 manual)."""
    indexed = picture.quantize(256)
    numbers = np.asarray(indexed)
    table = np.asarray(indexed.getpalette(), dtype=np.float64).reshape(-1, 3)
    text = [f'\x1bP0;1q"1;1;{picture.width};{picture.height}']
    for colour in np.unique(numbers):
        red, green, blue = np.rint(table[colour] * (100.0 / 255.0)).astype(int)
        text.append(f"#{colour};2;{red};{green};{blue}")
    for top in range(0, picture.height, 6):
        band = numbers[top : top + 6]
        rows = (1 << np.arange(len(band)))[:, None]
        for colour in np.unique(band):
            signs = bytes((63 + ((band == colour) * rows).sum(axis=0)).astype(np.uint8)).decode("ascii")
            runs = re.sub(r"(.)\1{3,}", lambda run: f"!{len(run[0])}{run[1]}", signs.rstrip("?"))
            text.append(f"#{colour}{runs}$")
        text.append("-")
    return "".join([*text, "\x1b\\"])


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


def _attributes(source: int, target: int) -> set[str]:
    """What a terminal answers to "primary device attributes"; nothing where it does not, or on Windows."""
    with contextlib.suppress(OSError, ImportError), _key_by_key(source):
        os.write(target, b"\x1b[c")
        answer, ends = b"", time.monotonic() + ANSWER_S
        while not answer.endswith(b"c") and select.select([source], [], [], max(0.0, ends - time.monotonic()))[0]:
            if not (more := os.read(source, 64)):
                break
            answer += more
        found = re.search(rb"\x1b\[\?([\d;]+)c", answer)
        return set(found[1].decode("ascii").split(";")[1:]) if found else set()
    return set()


@contextlib.contextmanager
def _key_by_key(source: int) -> Iterator[None]:
    """Without an echo, and without waiting for the end of a line; Ctrl-C works on."""
    import termios

    before = termios.tcgetattr(source)
    changed = [*before[:3], before[3] & ~(termios.ICANON | termios.ECHO), *before[4:]]
    termios.tcsetattr(source, termios.TCSANOW, changed)
    try:
        yield
    finally:
        termios.tcsetattr(source, termios.TCSANOW, before)


def columns() -> int:
    """Letters that go into a line of the terminal that is written to; 80 where it does not say."""
    with contextlib.suppress(OSError, ValueError):
        return os.get_terminal_size(sys.stdout.fileno()).columns or 80
    return 80
