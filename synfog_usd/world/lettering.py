"""Letters as flat triangles, and the strokes that signs and textures are drawn with.

Gives parts that lie in the plane y = 0 and are read from +Y; lengths in metres.
"""

from __future__ import annotations

import itertools

import numpy as np

from synfog_usd.base.arrays import Array
from synfog_usd.world.shapes import Part, quads

GLYPHS = {  # strokes on a grid of 4 by 6, points as digit pairs
    "A": "002640 1232",
    "B": "00062635443303 3342413000",
    "C": "4536160501103041",
    "D": "00062645412000",
    "E": "46060040 0333",
    "F": "460600 0333",
    "G": "45361605011030414323",
    "H": "0006 4046 0343",
    "I": "2026",
    "J": "011030414646",
    "K": "0006 4603 1440",
    "L": "060040",
    "M": "0006234640",
    "N": "0006 0640 4046",
    "O": "1030414536160501 0110",
    "P": "00063645443303",
    "Q": "1030414536160501 0110 2240",
    "R": "00063645443303 2340",
    "S": "453616050413334241301001",
    "T": "0646 2620",
    "U": "060110304146",
    "V": "062046",
    "W": "0610233046",
    "X": "0046 0640",
    "Y": "062346 2320",
    "Z": "06460040",
    "0": "1030414536160501 0110",
    "1": "152620",
    "2": "05163645440040",
    "3": "051636454433 13334241301001",
    "4": "30360242",
    "5": "460603334241301001",
    "6": "4536160501103041423303",
    "7": "064610",
    "8": "133342413010010213 130405163645443313",
    "9": "0110304145361605041343",
    "-": "1333",
    " ": "",
}


def strokes(letter: str) -> list[Array]:
    """(K, 2) points of each stroke, on a grid of 4 by 6."""
    return [np.array([*map(float, stroke)]).reshape(-1, 2) for stroke in GLYPHS[letter].split()]


def letters(word: str, height: float, material: str, *, align: str = "middle") -> list[Part]:
    """A word whose feet stand on z = 0.

    Args:
        word: capitals and digits that the textures' strokes have.
        height: of a capital [m].
        align: 'middle' of the word at x = 0, or its 'left' as the reader sees it.
    """
    unit, weight = height / 6, 0.13 * height
    lines, at = [], 0.0
    for letter in word:
        for stroke in strokes(letter):
            points = stroke * unit
            points[:, 0] += at
            lines += list(itertools.pairwise(points))
        at += 5.6 * unit
    width = at - 1.6 * unit
    corners = []
    for a, b in lines:
        along = (b - a) / np.linalg.norm(b - a) * weight / 2
        across = np.array([-along[1], along[0]])
        corners.append([a - along - across, b + along - across, b + along + across, a - along + across])
    flat = np.array(corners)
    x = flat[..., 0] - (width / 2 if align == "middle" else 0.0)
    # seen from +Y, what is on the right lies at -X
    return [quads(np.stack([-x, np.zeros_like(x), flat[..., 1]], axis=-1), material)]
