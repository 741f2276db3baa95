"""Lamps with a table of their light: what they send, in clear air and scattered once in fog, by numpy alone."""

import numpy as np
import pytest
from support.stats import assert_mean

from synfog_usd.fog import FogMedium, FogVolume
from synfog_usd.render import backend, models
from synfog_usd.render.film.accumulator import LAMPS, new_accumulator
from synfog_usd.render.film.launches import add_samples
from synfog_usd.render.lights import photometric
from synfog_usd.render.lights.sampler import LightSampler
from synfog_usd.render.shot import load
from synfog_usd.scene.testing import black, box, scene, wall

SIGMA_T, G = 0.002, 0.8


def candela(polar, around):
    """A lopsided lamp: a beam of 12 degrees, a bump at 40 degrees on one side, and a little behind [cd]."""
    beam = 900.0 * np.exp(-0.5 * (polar / 0.2) ** 2)
    bump = 250.0 * np.exp(-0.5 * ((polar - 0.7) / 0.25) ** 2) * (1.0 + np.cos(around - 0.6))
    return beam + bump + 15.0 * (1.0 - np.cos(polar))


def lamp(to_world, rows=721, columns=180, scale=(1.0, 1.0, 1.0)):
    polar, around = np.arange(rows)[:, None] * np.pi / (rows - 1), np.arange(columns)[None] * 2.0 * np.pi / columns
    table = candela(polar, around)
    colour = {"type": "rgb", "value": list(scale)}
    return {"type": "photometric", "intensity": colour, "bitmap": table.astype(np.float32), "to_world": to_world}


def frame(place, axis, x):
    """A lamp at a place that looks along `axis`, its +X as near to `x` as can be."""
    axis = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    x = np.asarray(x, dtype=float) - np.dot(x, axis) * axis
    matrix = np.eye(4)
    matrix[:3, 0] = x / np.linalg.norm(x)
    matrix[:3, 1], matrix[:3, 2], matrix[:3, 3] = np.cross(axis, matrix[:3, 0]), axis, place
    return matrix


def sent(matrix, way):
    """Candela of `lamp(matrix)` in unit directions (N, 3) of the world."""
    local = way @ matrix[:3, :3]
    return candela(np.arctan2(np.hypot(local[:, 0], local[:, 1]), local[:, 2]), np.arctan2(local[:, 1], local[:, 0]))


def scattered_once(matrix, direction, length):
    """Radiance along a ray from the origin: midpoints over its length, Henyey and Greenstein's phase function."""
    place = matrix[:3, 3]
    nearest = place @ direction
    height = np.linalg.norm(place - nearest * direction)
    low, high = np.arctan((0.0 - nearest) / height), np.arctan((length - nearest) / height)
    angle = low + (np.arange(20_000) + 0.5) / 20_000 * (high - low)
    t = nearest + height * np.tan(angle)
    step = height / np.cos(angle) ** 2 * (high - low) / 20_000
    between = t[:, None] * direction - place
    away = np.linalg.norm(between, axis=1)
    way = between / away[:, None]
    cosine = way @ -direction
    phase = (1 - G**2) / (4 * np.pi * (1 + G**2 - 2 * G * cosine) ** 1.5)
    return float((SIGMA_T * phase * sent(matrix, way) / away**2 * np.exp(-SIGMA_T * (t + away)) * step).sum())


PLACES = {
    "towards the eye": frame((3.0, 40.0, 1.0), (-0.1, -1.0, -0.05), (1, 0, 0)),
    "from above": frame((1.0, 15.0, 6.0), (0.0, 0.0, -1.0), (0, 1, 0)),
}


@pytest.mark.parametrize("name", PLACES)
def test_a_lamp_scatters_once_what_its_table_says(name):
    """Thin fog (tau 0.12 over 60 m) before a black wall, one pixel of 0.1 degrees, against midpoints over the ray; 1.5
    % is resolved.
    """
    matrix = PLACES[name]
    fog = FogVolume("/Fog", box(200.0), FogMedium(SIGMA_T, albedo=1.0, g=G))
    world = scene(
        {"light_lamp": lamp(matrix), "shape_wall": wall(60.0, 30.0, **black(0.0))},
        [fog],
        width_px=2,
        height_px=2,
        fov_x_deg=0.1,
    )
    integrator, means = models.make("path", load(world, boundaries=False)), []
    for seed in range(8):
        accumulated = new_accumulator(integrator, 4)
        add_samples(accumulated, integrator, np.arange(4), {LAMPS: 32768}, seed)
        means.append(accumulated.estimators[LAMPS].mean().mean())
    assert_mean(np.array(means), scattered_once(matrix, np.array([0.0, 1.0, 0.0]), 60.0), resolves=0.015)


def test_the_emitter_and_the_table_agree_in_all_directions():
    """Mitsuba's emitter and our own sampling of it: candela over distance squared, over the whole sphere."""
    import drjit as dr

    backend.start("auto")
    mi = backend.mitsuba()
    photometric.register()
    matrix = frame((1.0, 2.0, 3.0), (0.3, 0.8, -0.5), (0, 0, 1))
    draw = np.random.default_rng(5)
    way = draw.normal(size=(4000, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    part = lamp(matrix, columns=720, scale=(1.0, 2.0, 0.5))
    parts = {
        **part,
        "type": backend.plugin_name(photometric.TYPE),
        "bitmap": mi.Bitmap(part["bitmap"]),
        "to_world": mi.ScalarTransform4f(matrix),
    }
    it = dr.zeros(mi.SurfaceInteraction3f, len(way))
    it.p = mi.Point3f((matrix[:3, 3] + 3.0 * way).T)
    _, found = mi.load_dict(parts).sample_direction(it, mi.Point2f(0.5), True)
    wanted = sent(matrix, way)
    np.testing.assert_allclose(
        np.array(found), np.array([[1.0], [2.0], [0.5]]) * wanted / 9.0, rtol=2e-3
    )  # linear between nodes 0.25 and 0.5 degrees apart
    lamps = LightSampler({"light_lamp": part}, {})
    ours = lamps.rows[0]["colour"][0, 0] * np.array(lamps.sent(lamps.columns.at(mi.UInt32(0)), mi.Vector3f(way.T)))
    np.testing.assert_allclose(ours.ravel(), wanted, rtol=2e-3)
    assert photometric.ring_weights(91).sum() == pytest.approx(4 * np.pi, rel=1e-12)
