"""Where the streets of the crossing run: widths, kerbs, zebras, and the ground's height.

The main street runs along Y, the side street along X; they cross at the origin.
The carriageway is z = 0, pavements lie `KERB_M` above.  Lengths in metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import Array

LANE_M = 3.4  # of the main street
MAIN_HALF = 5.6  # lane and parking 2.2
SIDE_HALF = 4.4
CORNER = 6.5  # radius of the kerb
KERB_M = 0.12
NORTH, SOUTH, SIDE = 268.0, 150.0, 150.0  # where the streets end
WALL_X, WALL_Y = 9.9, 8.7  # where the houses begin
ZEBRA = 11.3  # near edge of the crossings of the main street, from the middle
ZEBRA_DEPTH = 3.2
ZEBRA_SIDE = 12.5
TREE_X = 6.85
BAY_M, BAYS_Y = 5.8, ((-60.6, -20.0), (20.0, 240.4))  # of the main street: length, and from where to where they are


def ground_height(x: float, y: float) -> float:
    """Height of the ground [m] within the streets: 0 on the carriageway, `KERB_M` on the pavement."""
    return float(Crossing().height(x, y))


@dataclass(frozen=True)
class Crossing:
    """The crossing as what everything stands at; its ground is a model of the library."""

    def height(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Array:
        """Height of the ground [m] at places within the streets."""
        ax, ay = np.abs(np.asarray(x, dtype=np.float64)), np.abs(np.asarray(y, dtype=np.float64))
        dx, dy = MAIN_HALF + CORNER - ax, SIDE_HALF + CORNER - ay
        road = (ax < MAIN_HALF) | (ay < SIDE_HALF) | ((dx > 0) & (dy > 0) & (np.hypot(dx, dy) > CORNER))
        return np.where(road, 0.0, KERB_M)
