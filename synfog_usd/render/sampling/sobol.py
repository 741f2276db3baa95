"""Random numbers that fill the square evenly: Sobol's points, scrambled by hash.

Takes the number of a sample and of the dimension; gives points in [0, 1)^2.  Every pair of dimensions is
Sobol's first two, shuffled and scrambled apart (Owen 1995, by the hash of Laine and Karras 2011 as Burley 2020 does
it): any 2^k samples from a multiple of 2^k on fall one into each of 2^k equal boxes, of every shape that bits allow.
Means over them are unbiased, and for what changes little between neighbouring points nearer than those of independent
points.  Their scatter is no measure of the error, though: that takes scramblings that are independent of each other, as
those of a picture's halves, and of each half's runs of `RUN` samples, are.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import drjit as dr

from synfog_usd.render import backend

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float, UInt32
    from mitsuba import Point2f

RUN = 64
"""Samples that share a scrambling, a power of 2: one run is one independent draw.

It is half of the most samples that a bake makes by itself.
"""


class Sobol:
    """The random numbers of one sample after the other, the same whatever else is in flight.

    Args:
        seed: of the image.
        pixel: number of the pixel.
        number: of the sample in its pixel.
    """

    DRJIT_STRUCT: ClassVar[dict[str, type]] = {}

    def __init__(
        self, seed: UInt32 | int | None = None, pixel: UInt32 | None = None, number: UInt32 | None = None
    ) -> None:
        mi = backend.mitsuba()
        type(self).DRJIT_STRUCT = {
            "index": mi.UInt32,
            "key": mi.UInt32,
        }  # what a loop carries; known only once a variant is chosen
        self.index, self.key = mi.UInt32(0), mi.UInt32(0)
        if pixel is not None:
            self.index = mi.UInt32(number) & (RUN - 1)
            self.key = hashed(hashed(mi.UInt32(seed), mi.UInt32(pixel)), mi.UInt32(number) // RUN)

    def next_1d(self, active: Bool | bool = True) -> Float:
        """A number in [0, 1)."""
        self.key = self.key + 1
        return unit(_scrambled(_radical(_shuffled(self.index, hashed(self.key, 0))), hashed(self.key, 1)))

    def next_2d(self, active: Bool | bool = True) -> Point2f:
        """A point in [0, 1)^2."""
        self.key = self.key + 1
        return point(self.index, self.key)

    def stream(self) -> UInt32:
        """A key for as many further numbers as one likes, by `hashed`: independent ones, not spread evenly."""
        self.key = self.key + 1
        return hashed(self.key, self.index)

    def restarted(self, again: Bool, fresh: Sobol) -> Sobol:
        """`fresh` where `again`, else as it is."""
        after = Sobol()
        after.index, after.key = dr.select(again, fresh.index, self.index), dr.select(again, fresh.key, self.key)
        return after


def point(index: UInt32, key: UInt32) -> Point2f:
    """A point in [0, 1)^2 of the sequence that `key` scrambles and shuffles; both 32 bits."""
    mi = backend.mitsuba()
    index = _shuffled(index, hashed(key, 0))
    return mi.Point2f(
        unit(_scrambled(_radical(index), hashed(key, 1))), unit(_scrambled(second(index), hashed(key, 2)))
    )


def _radical(index: UInt32) -> UInt32:
    """Sobol's first dimension as 32 bits after the point: van der Corput's."""
    return dr.brev(index)


def second(index: UInt32) -> UInt32:
    """Sobol's second dimension as 32 bits after the point: Pascal's triangle modulo 2 over the bits, as a butterfly."""
    for shift, mask in ((16, 0x0000FFFF), (8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        index = index ^ ((index >> shift) & mask)
    return dr.brev(index)


def _scrambled(bits: UInt32, key: UInt32) -> UInt32:
    """Owen's scrambling of bits after the point: whether one is turned over depends on those before it."""
    return dr.brev(_laine_karras(dr.brev(bits), key))


def _shuffled(index: UInt32, key: UInt32) -> UInt32:
    """An order in which every run of 2^k, from a multiple of 2^k on, keeps its members together: Owen's scrambling of
    the number.
    """
    return _scrambled(index, key)


def _laine_karras(bits: UInt32, key: UInt32) -> UInt32:
    """A permutation whose every bit depends on the lower ones alone."""
    bits = bits + key
    for factor in (0x6C50B47C, 0xB82F1E52, 0xC7AFE638, 0x8D22F6E6):
        bits = bits ^ (bits * factor)
    return bits


def hashed(key: UInt32, number: UInt32 | int) -> UInt32:
    """32 bits that tell nothing of either (the finish of MurmurHash3, Appleby 2011)."""
    mi = backend.mitsuba()
    bits = mi.UInt32(key) ^ (mi.UInt32(number) * 0x9E3779B9 + 0x7F4A7C15)
    bits = (bits ^ (bits >> 16)) * 0x85EBCA6B
    bits = (bits ^ (bits >> 13)) * 0xC2B2AE35
    return bits ^ (bits >> 16)


def unit(bits: UInt32) -> Float:
    """A number in [0, 1)."""
    mi = backend.mitsuba()
    return mi.Float(bits >> 8) * (1.0 / (1 << 24))
