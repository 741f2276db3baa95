"""Light near the axis of a lens that is drawn face by face: focal length, and where two faces reflect it to."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from synfog_usd.base.arrays import Array


class Ghost(NamedTuple):
    """Where the light of a lamp goes that is reflected by two faces.

    Attributes:
        place: offset of its middle from the axis, over that of the lamp's image [1].
        diameter_mm: of its disc on the sensor [mm]; < 0 where the aperture stands upside down.
        fraction: of the lamp's light [1].
    """

    place: float
    diameter_mm: float
    fraction: float


class Drawing:
    """A lens, face by face from the front; slopes are along the axis, and indices of light that goes back are negative.

    Args:
        radius_mm: > 0 where the middle lies behind the face, 0 for a plane [mm].
        thickness_mm: to the next face [mm].
        index: behind the face [1]; the stop is the face where it does not change.
        clear_mm: free diameter [mm]; not used of the stop.

    Attributes:
        focal_length_mm: [mm].

    Raises:
        ValueError: lists of unlike length, no stop or several, a lens that does not gather light.

    >>> round(Drawing((50.0, 0.0, 0.0), (0.0, 1.0, 1.0), (1.5, 1.0, 1.0), (9.0, 9.0, 9.0)).focal_length_mm, 6)
    100.0
    """

    def __init__(
        self,
        radius_mm: Sequence[float],
        thickness_mm: Sequence[float],
        index: Sequence[float],
        clear_mm: Sequence[float],
    ) -> None:
        counts = {len(radius_mm), len(thickness_mm), len(index), len(clear_mm)}
        if len(counts) > 1:
            raise ValueError(f"a lens's drawing with lists of {' and '.join(map(str, sorted(counts)))} numbers")
        self._curvature = np.array([1.0 / r if r else 0.0 for r in radius_mm])
        self._z = np.concatenate([[0.0], np.cumsum(thickness_mm)[:-1]])
        self._behind = np.array(index)
        self._before = np.concatenate([[1.0], self._behind[:-1]])
        self._clear = np.array(clear_mm)
        stops = np.flatnonzero(self._behind == self._before)
        if len(stops) != 1:
            raise ValueError(f"a lens's drawing with {len(stops)} stops; the stop is the one face without a new index")
        self._stop = int(stops[0])
        self._heights, last = self.path(range(len(self._z)), ())
        if not last[0, 1] < 0.0 or self._behind[-1] != 1.0:
            raise ValueError("a lens's drawing that does not gather light in air behind it")
        self.focal_length_mm = float(-1.0 / last[0, 1])
        self.focus_mm = float(-last[0, 0] / last[0, 1])

    def path(self, faces: Sequence[int], mirrors: Sequence[int]) -> tuple[Array, Array]:
        """(heights at the faces met (N, 2), last height and slope (2, 2)) of two rays: one comes in at height 1 along
        the axis, one at height 0 with slope 1; `mirrors` are the places in `faces` where light turns back.
        """
        height, slope, way = np.array([1.0, 0.0]), np.array([0.0, 1.0]), 1.0
        heights = []
        for place, face in enumerate(faces):
            if place:
                height = height + slope * (self._z[face] - self._z[faces[place - 1]])
            heights.append(height)
            here, there = (self._before, self._behind) if way > 0 else (self._behind, self._before)
            old = way * here[face]
            way = -way if place in mirrors else way
            new = way * (here if place in mirrors else there)[face]
            slope = (old * slope - height * (new - old) * self._curvature[face]) / new
        return np.array(heights), np.stack([height, slope], axis=1)

    def ghosts(self, f_number: float, face_reflectance: float) -> list[Ghost]:
        """Those of all pairs of faces, first those whose discs are brightest; faces between glass and air reflect
        `face_reflectance` [1], cemented ones what Fresnel says.
        """
        pupil = 0.5 * self.focal_length_mm / f_number
        free = 0.5 * self._clear
        free[self._stop] = pupil * abs(self._heights[self._stop, 0])
        bare = ((self._behind - self._before) / (self._behind + self._before)) ** 2
        in_air = np.minimum(self._behind, self._before) == 1.0
        mirrors = np.where(in_air & (bare > 0.0), face_reflectance, bare)
        faces = np.flatnonzero(mirrors).tolist()
        result = []
        for first in faces:
            for second in (face for face in faces if face > first):
                path = [*range(second + 1), *range(second - 1, first - 1, -1), *range(first + 1, len(self._z))]
                heights, last = self.path(path, (second, 2 * second - first))
                on_sensor = last[:, 0] + last[:, 1] * self.focus_mm
                with np.errstate(divide="ignore"):
                    comes_in = free[path] / np.abs(heights[:, 0])
                edge = int(np.argmin(comes_in))  # the face that ends the beam
                per_height = on_sensor[0] / heights[edge, 0]
                between = np.prod((1.0 - mirrors[first + 1 : second]) ** 2)
                result.append(
                    Ghost(
                        float((on_sensor[1] - per_height * heights[edge, 1]) / self.focal_length_mm),
                        float(2.0 * per_height * free[path[edge]]),
                        float(mirrors[first] * mirrors[second] * between * (comes_in[edge] / pupil) ** 2),
                    )
                )
        return sorted(result, key=lambda ghost: -ghost.fraction / max(ghost.diameter_mm**2, 1e-12))
