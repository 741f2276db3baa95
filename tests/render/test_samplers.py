"""Every sampler of ours against the density that it states: chi-squared over cells.

Phase functions are in `test_phases`, BSDFs are Mitsuba's.  Expected numbers are integrals of the stated density, or a
closed form that shares no code with the sampler; `test_support` shows that two percent would be seen.
"""

from typing import ClassVar

import drjit as dr
import numpy as np
from support.parts import bulb
from support.stats import assert_draws

from synfog_usd.fog import FogMedium, FogVolume
from synfog_usd.fog.volume import optical_depth
from synfog_usd.render import backend
from synfog_usd.render.lights.sampler import LightSampler
from synfog_usd.render.media.medium import Medium
from synfog_usd.scene.testing import box

COUNT = 400_000
EYE = np.array([0.0, 0.0, 1.5])


def uniform(mi, seed, dimensions=1):
    """(N,) or (2, N) random numbers of a kernel."""
    numbers = np.random.default_rng(seed).random((dimensions, COUNT), dtype=np.float32)
    return mi.Float(numbers[0]) if dimensions == 1 else mi.Point2f(numbers)


class Draws:
    """A sampler of a kernel: independent numbers, a stream for each lane."""

    DRJIT_STRUCT: ClassVar[dict[str, type]] = {}

    def __init__(self, seed=0):
        mi = backend.mitsuba()
        type(self).DRJIT_STRUCT = {"state": mi.PCG32}
        self.state = mi.PCG32(COUNT, seed)

    def next_1d(self, active=True):
        return self.state.next_float32(active)

    def next_2d(self, active=True):
        first = self.state.next_float32(active)
        return backend.mitsuba().Point2f(first, self.state.next_float32(active))


def test_resampling_keeps_a_lamp_in_proportion_to_what_it_sends(mi):
    """Four bulbs before a surface: the one that is kept is drawn in proportion to I cos / r^2, and its estimate is the
    sum of all I / r^2 in the mean.
    """
    places, intensity = (
        np.array([[-4.0, 6.0, 3.0], [0.0, 9.0, 5.0], [5.0, 4.0, 1.0], [2.0, -7.0, 4.0]]),
        np.array([10.0, 80.0, 5.0, 40.0]),
    )
    bulbs = {
        f"light_{index}": bulb(place, power) for index, (place, power) in enumerate(zip(places, intensity, strict=True))
    }
    here, normal = np.array([0.5, 0.0, 0.0]), np.array([0.0, 0.6, 0.8])
    lane = dr.zeros(mi.Float, COUNT)
    place, facing = mi.Point3f(lane + here[0], lane + here[1], lane + here[2]), mi.Normal3f(normal.tolist())
    found = LightSampler(bulbs, {}).at(
        place, lambda way: dr.abs(dr.dot(facing, way)) + 1e-3, Draws(11), dr.full(mi.Bool, True, COUNT)
    )
    between = places - here
    sent = intensity / (between**2).sum(axis=1)
    target = sent * (np.abs(between @ normal) / np.linalg.norm(between, axis=1) + 1e-3)
    kept = np.argmin(((np.array(found[0]).T[:, None] - places[None]) ** 2).sum(axis=2), axis=1)
    assert_draws(np.bincount(kept, minlength=4), target)
    value = np.array(found[1], dtype=np.float64)[0]
    assert abs(value.mean() - sent.sum()) < 4.5 * value.std() / np.sqrt(COUNT)


def test_flights_end_as_transmittance_says(mi, banks=6):
    """A bank in fog that thins with height: 200 cells of the same chance, by the optical depth of `fog.volume`, which
    is numpy's.
    """
    fog = [
        FogVolume(
            "/Fog",
            box((300.0, 300.0, 40.0), (0.0, 0.0, 20.0)),
            FogMedium(0.03, profile="exponential", base_height_m=2.0, scale_height_m=9.0),
        ),
        *(
            FogVolume(
                f"/Bank{n}", box((50.0, 8.0, 3.0), (0.0, 30.0 + 20.0 * n, 3.0)), FogMedium(0.15), priority=1, parent=0
            )
            for n in range(banks)
        ),
    ]
    medium = Medium(fog)
    way = np.array([0.1, 0.99, 0.06])
    way /= np.linalg.norm(way)
    origin, direction = mi.Point3f(EYE.tolist()), mi.Vector3f(way.tolist())
    near, far = medium.intersect(origin, direction)
    reach = medium.sample_distance(origin, direction, -dr.log(1.0 - uniform(mi, 13)), near, far)
    length = float(far[0])
    places = np.linspace(0.0, length, 200_001)
    count = len(places)
    tau = optical_depth(tuple(fog), np.broadcast_to(EYE, (count, 3)), np.broadcast_to(way, (count, 3)), places)
    below = -np.expm1(-tau)  # what is scattered up to a place; the rest leaves the fog
    edges = np.r_[np.interp(np.linspace(0.0, below[-1], 201), below, places)[:-1], length * (1.0 - 1e-6)]
    drawn = np.array(reach, dtype=np.float64)
    counts = np.histogram(drawn, edges)[0]
    assert_draws(np.r_[counts, (drawn >= edges[-1]).sum()], np.r_[np.full(200, below[-1] / 200.0), 1.0 - below[-1]])
