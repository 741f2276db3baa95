"""Lights drawn by what they matter: the weights know where a light shines, the draws follow them, and the estimate
stays that of all lights.
"""

import drjit as dr
import numpy as np
import pytest
from support.parts import squares

from synfog_usd.fog import FogMedium, FogVolume
from synfog_usd.render.lights.importance import Importance
from synfog_usd.render.lights.sampler import LightSampler
from synfog_usd.render.media.medium import Medium
from synfog_usd.render.sampling.sobol import Sobol
from synfog_usd.scene.testing import box

COUNT = 30
FEW = 12
"""Lights where each is asked by a kernel of its own: three of each kind, three times as many as are drawn."""
FOG = FogVolume("/Fog", box((200.0, 200.0, 200.0)), FogMedium(0.02, albedo=0.95, g=0.8))


def lopsided(polar, around):
    """A beam of 20 degrees and a bump at 60 degrees on one side, as a share of its peak."""
    return np.exp(-0.5 * (polar / 0.35) ** 2) + 0.4 * np.exp(-0.5 * ((polar - 1.05) / 0.3) ** 2) * (
        0.5 + 0.5 * np.cos(around - 0.6)
    )


def world(count=COUNT):
    """Spots, points, lamps with tables and lit faces at random, each 2 to 40 m off."""
    draw, parts = np.random.default_rng(3), {}
    for number in range(count):
        place, turn = draw.normal(size=3) * (15.0, 15.0, 4.0), np.linalg.qr(draw.normal(size=(3, 3)))[0]
        turn[:, 0] *= np.linalg.det(turn)
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = turn, place
        colour = {"type": "rgb", "value": (draw.uniform(0.2, 1.0, 3) * 10.0 ** draw.uniform(0, 2)).tolist()}
        if number % 4 == 0:
            parts[f"light_{number}"] = {"type": "spot", "intensity": colour, "to_world": matrix, "cutoff_angle": 35.0}
        elif number % 4 == 1:
            polar, around = np.arange(91)[:, None] * np.pi / 90, np.arange(72)[None] * np.pi / 36
            table = (lopsided(polar, around) / 1.5).astype(np.float32)
            parts[f"light_{number}"] = {"type": "photometric", "intensity": colour, "bitmap": table, "to_world": matrix}
        elif number % 4 == 2:
            parts[f"light_{number}"] = {"type": "point", "intensity": colour, "position": place.tolist()}
        else:
            corners = place + 0.2 * np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]) @ turn.T
            emitter = {"type": "area", "radiance": colour}
            parts[f"shape_{number}"] = squares(corners, emitter=emitter, bsdf={"type": "diffuse"})
    return parts


@pytest.fixture
def both(mi):
    return among(COUNT)


def among(count):
    """`count` lights, the fog, and the weights of the lights in it."""
    lights, medium = LightSampler(world(count), {}, 0.8), Medium((FOG,))
    return lights, medium, Importance(lights, medium)


def rays(mi, count, seed=11):
    """(origin, direction, begin, end) of `count` stretches through the lamps."""
    draw = np.random.default_rng(seed)
    way = draw.normal(size=(3, count))
    begin = draw.uniform(0.0, 20.0, count)
    origin = draw.normal(size=(3, count)) * 10.0
    arrays = (origin, way / np.linalg.norm(way, axis=0), begin, begin + 10.0 ** draw.uniform(-2, 2, count))
    return (
        mi.Point3f(arrays[0].astype(np.float32)),
        mi.Vector3f(arrays[1].astype(np.float32)),
        *(mi.Float(a.astype(np.float32)) for a in arrays[2:]),
    )


def test_no_light_is_left_out_anywhere(mi, both):
    """A weight of 0 where a light shines would be a bias: on 10^5 stretches and points none is."""
    _, _, importance = both
    origin, direction, begin, end = rays(mi, 100_000)
    for number in range(COUNT):
        assert np.array(importance.along(dr.opaque(mi.UInt32, number), origin, direction, begin, end)).min() > 0.0
        assert np.array(importance.at(dr.opaque(mi.UInt32, number), origin, lambda way: mi.Float(1.0))).min() > 0.0


@pytest.mark.parametrize("kind", [pytest.param("along", marks=pytest.mark.slow), "at"])
def test_many_lights_drawn_are_all_lights_asked(mi, kind):
    """The mean over 2^20 draws of four against the sum over lights asked one by one, each a sampler of its own; within
    five standard errors, 2 % resolved.
    """
    lights, medium, importance = among(FEW)
    count = 1 << 20
    sampler = Sobol(21, dr.arange(mi.UInt32, count), mi.UInt32(0))
    origin, direction, begin, end = rays(mi, 1, seed=8)

    def response(way):
        return dr.abs(way.z) + 0.05

    def mean(these, known):
        if kind == "along":
            _, _, colour, _ = these.along(
                origin,
                direction,
                begin,
                end,
                medium,
                sampler,
                mi.Bool(True) & (dr.arange(mi.UInt32, count) < count),
                known,
            )
        else:
            _, colour, _, _ = these.at(origin, response, sampler, dr.arange(mi.UInt32, count) < count, known)
        value = np.array(colour, dtype=np.float64).sum(axis=0)
        return value.mean(), value.std() / np.sqrt(count)

    if kind == "along":
        picks = importance.draw(lambda i: importance.along(i, origin, direction, begin, end), sampler, mi.Bool(True))
    else:
        picks = importance.draw(lambda i: importance.at(i, origin, response), sampler, mi.Bool(True))
    ours, error = mean(lights, picks)
    one_by_one = [mean(LightSampler({key: part}, {}, 0.8), None) for key, part in world(FEW).items()]
    truth = sum(value for value, _ in one_by_one)
    error = np.hypot(error, np.sqrt(sum(e**2 for _, e in one_by_one)))
    assert 5 * error < 0.02 * truth, f"cannot see 2 %: error is {error / truth:.2%}"
    assert abs(ours - truth) < 5 * error
