"""Lamps with a table of their light: what they send, in clear air and scattered once in fog, by numpy alone."""

import numpy as np
import pytest
from support.renders import by_seed
from support.stats import assert_agree, assert_mean

from synfog_usd.fog import FogMedium, FogVolume
from synfog_usd.render import backend, models
from synfog_usd.render.film.accumulator import LAMPS, add_samples, new_accumulator
from synfog_usd.render.integrators import next_event
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
    "across": frame((-6.0, 20.0, 0.5), (1.0, 0.1, 0.0), (0, 0, 1)),
    "from above": frame((1.0, 15.0, 6.0), (0.0, 0.0, -1.0), (0, 1, 0)),
    "away": frame((2.0, 10.0, -1.0), (0.0, 1.0, 0.0), (0, 0, -1)),
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


def test_three_channels_of_a_table_keep_their_colours():
    """A table that is red ahead and green behind: each channel is held as a row of its own."""
    part = lamp(np.eye(4))
    table = np.stack([part["bitmap"], part["bitmap"][::-1], 0.0 * part["bitmap"]], axis=2)
    lamps = LightSampler({"light_lamp": {**part, "bitmap": table}}, {})
    rows = lamps.rows[0]
    assert (
        len(rows) == 2
        and rows["colour"][0, 0] > 0
        and rows["colour"][0, 1] == 0
        and rows["colour"][1, 1] > 0
        and rows["colour"][1, 0] == 0
    )
    assert len({int(number) for number in rows["table"]}) == 2


def street_at_night(count):
    """A ground, a wall and `count` lamps along both sides, 1.5 m above a slab of fog: beside a lamp in fog `volpath`
    has no finite variance.
    """
    draw = np.random.default_rng(1)
    world = {}
    for number in range(count):
        side, along = (-1) ** number, 6.0 + 5.0 * (number // 2)
        axis = draw.normal(size=3) * 0.2 + ((0, 0, -1) if number % 3 else (0.3 * -side, -1.0, -0.1))
        world[f"light_{number}"] = lamp(frame((5.0 * side, along, 3.0), axis, (1, 0.1, 0)), columns=36, rows=181)
    flat = np.array([[-40, -5, -1.5], [40, -5, -1.5], [40, 75, -1.5], [-40, 75, -1.5]])
    grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.3] * 3}}
    world["shape_ground"] = {
        "type": "mesh",
        "positions": flat,
        "faces": np.array([[0, 1, 2], [0, 2, 3]]),
        "bsdf": {"type": "twosided", "bsdf": grey},
    }
    world["shape_wall"] = wall(50.0, 10.0, bsdf=grey)
    fog = FogVolume("/Fog", box((30.0, 40.0, 2.5), (0, 30, -1.0)), FogMedium(0.03, albedo=0.95, g=0.8))
    return scene(world, [fog], fov_x_deg=60.0)


@pytest.mark.slow
def test_lamps_that_are_weighed_and_lamps_drawn_by_flux_give_the_same_light(monkeypatch):
    """20 lamps with tables: four drawn by what all matter to a place, or by flux and peak; the same mean within five
    standard errors, 5 % resolved.
    """
    weighed = by_seed(street_at_night(20), range(6), samples=256, model="path")
    monkeypatch.setattr(next_event, "MOST_WEIGHED", 0)
    drawn = by_seed(street_at_night(20), range(6), samples=1024, model="path")
    assert_agree(*([run.radiance.pixels for run in runs] for runs in (weighed, drawn)), resolves=0.05)


@pytest.mark.physics
@pytest.mark.parametrize("count", [4, 20])
def test_path_agrees_with_volpath_among_lamps_with_tables(count):
    """A few lamps, which are all asked, and many, of which some are drawn: the same mean within five standard
    errors, 3 % resolved.
    """
    runs = {
        model: by_seed(street_at_night(count), range(12), samples=samples, model=model)
        for model, samples in (("path", 400), ("volpath", 2000))
    }
    ours, theirs = (
        np.array([run.radiance.pixels.mean(dtype=np.float64) for run in runs[model]]) for model in ("path", "volpath")
    )
    error = np.hypot(ours.std(ddof=1), theirs.std(ddof=1)) / np.sqrt(12)
    assert 2 * 5 * error < 0.03 * ours.mean(), f"cannot see 3 %: error is {error / ours.mean():.2%}"
    assert abs(ours.mean() - theirs.mean()) < 5 * error
