"""Letters as flat triangles, from the strokes that the textures are drawn with.

Gives parts that lie in the plane y = 0 and are read from +Y; lengths in metres.
"""

from __future__ import annotations

import itertools

import numpy as np

from assets.builders.textures import GLYPHS
from synfog_usd.world.shapes import Part, quads


def letters(word: str, height: float, material: str, *, align: str = "middle") -> list[Part]:
    """A word whose feet stand on z = 0.

    Args:
        word: capitals and digits that the textures' strokes have.
        height: of a capital [m].
        align: 'middle' of the word at x = 0, or its 'left' as the reader sees it.
    """
    unit, weight = height / 6, 0.13 * height
    strokes, at = [], 0.0
    for letter in word:
        for line in GLYPHS[letter].split():
            points = (
                np.array([(int(line[i]), int(line[i + 1])) for i in range(0, len(line), 2)], dtype=np.float64) * unit
            )
            points[:, 0] += at
            strokes += list(itertools.pairwise(points))
        at += 5.6 * unit
    width = at - 1.6 * unit
    corners = []
    for a, b in strokes:
        along = (b - a) / np.linalg.norm(b - a) * weight / 2
        across = np.array([-along[1], along[0]])
        corners.append([a - along - across, b + along - across, b + along + across, a - along + across])
    flat = np.array(corners)
    x = flat[..., 0] - (width / 2 if align == "middle" else 0.0)
    # seen from +Y, what is on the right lies at -X
    return [quads(np.stack([-x, np.zeros_like(x), flat[..., 1]], axis=-1), material)]
