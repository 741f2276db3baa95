"""The sky as surfaces ask it: densities are of what is drawn, a picture's mean is that of another way to find the sky,
and it takes fewer samples.
"""

import drjit as dr
import numpy as np
import pytest
from support.parts import rgb, squares
from support.renders import pictures
from support.stats import assert_agree

from synfog_usd.render.integrators import next_event
from synfog_usd.render.lights.sky import SkyTable
from synfog_usd.render.sampling.sobol import Sobol
from synfog_usd.scene.testing import scene, sky

DRAWN = 400_000
UPRIGHT = np.eye(4)[[0, 2, 1, 3]] * np.array([[1.0], [-1.0], [1.0], [1.0]])
"""From Y up to Z up."""


def one_sided(rows=64):
    """A sky that is bright in the west up to 60 degrees, and dim elsewhere; Y up, as pictures of skies are."""
    polar = np.pi * (np.arange(rows) + 0.5)[:, None] / rows
    around = 2.0 * np.pi * (np.arange(2 * rows) + 0.5)[None] / (2 * rows)
    light = 0.3 + 4.0 * np.exp(-0.5 * ((polar - 1.2) / 0.4) ** 2) * np.maximum(np.cos(around - 1.0), 0.0)
    light = np.where(polar < 0.5 * np.pi, light, 0.05)
    return np.repeat(light[..., None], 3, axis=2).astype(np.float32)


def overcast(rows=64):
    """Three times as bright overhead as at the horizon (CIE 1955), and dark below."""
    height = np.cos(np.pi * (np.arange(rows) + 0.5) / rows)[:, None, None]
    light = np.where(height > 0.0, (1.0 + 2.0 * height) / 3.0, 0.02)
    return np.broadcast_to(light, (rows, 2 * rows, 3)).astype(np.float32)


def environment(mi, part):
    return mi.load_dict({"type": "scene", "sky": part}).environment()


def made(mi, part):
    if part["type"] == "envmap":
        part = {**part, "bitmap": mi.Bitmap(part["bitmap"])}
    return environment(mi, part)


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.0, -0.6, -0.8)])
def test_irradiance_is_the_skys(mi, normal):
    """Mean of light x cosine over density, against the sum over the sky's picture."""
    picture = one_sided(256)
    found = SkyTable(made(mi, {"type": "envmap", "bitmap": picture}))
    row = found.row(mi.Vector3f(*normal))
    direction, density = found.draw(row, Sobol(7, dr.arange(mi.UInt32, DRAWN), 0).next_2d())
    cosine = dr.maximum(dr.dot(direction, mi.Vector3f(*normal)), 0.0)
    drawn = np.asarray(found.radiance(direction).x * cosine / density, dtype=np.float64)
    rows = len(picture)
    polar = np.pi * (np.arange(rows) + 0.5)[:, None] / rows
    around = 2.0 * np.pi * (np.arange(2 * rows) + 0.5)[None] / (2 * rows)
    # Mitsuba's pictures of skies have Y up, begin at -Z and turn to +X
    ways = np.stack(
        [np.sin(polar) * np.sin(around), np.cos(polar) + 0.0 * around, -np.sin(polar) * np.cos(around)], axis=-1
    )
    facing = np.maximum(ways @ np.array(normal), 0.0)
    truth = (picture[..., 0] * facing * np.sin(polar)).sum() * (np.pi / rows) ** 2
    error = drawn.std() / np.sqrt(DRAWN)
    assert error < 2e-3 * truth
    assert abs(drawn.mean() - truth) < 4.0 * error + 2e-3 * truth


def yard(picture) -> dict:
    """Ground between two walls, one of them leaning over it, under a sky."""
    parts = {}
    for name, corners, value in (
        ("ground", [(-4, -2, -1.5), (4, -2, -1.5), (4, 30, -1.5), (-4, 30, -1.5)], 0.5),
        ("left", [(-4, -2, -1.5), (-4, 30, -1.5), (-3, 30, 6), (-3, -2, 6)], 0.3),
        ("right", [(4, 30, -1.5), (4, -2, -1.5), (4, -2, 4), (4, 30, 4)], 0.7),
    ):
        paint = {"type": "preview_surface", "base_color": rgb(value), "roughness": 0.5}
        parts[f"shape_{name}"] = squares(corners, bsdf=paint)
    if picture is not None:
        parts["light_sky"] = {"type": "envmap", "bitmap": picture, "to_world": UPRIGHT}
    return parts


@pytest.mark.slow
def test_a_picture_is_that_of_the_scenes_own_choice_with_less_noise(mi, monkeypatch):
    """Means agree, and variance is less; both rule out that the table is not asked."""
    how = {"samples": 64, "model": "path", "denoise": False}
    seen = scene(yard(overcast()), width_px=24, height_px=16, fov_x_deg=80.0)
    ours = pictures(seen, 16, **how)
    monkeypatch.setattr(next_event.SkyTable, "of", staticmethod(lambda loaded: None))
    theirs = pictures(seen, 16, **how)
    assert_agree(ours, theirs, resolves=0.01)
    gain = theirs.var(axis=0, ddof=1).mean() / ours.var(axis=0, ddof=1).mean()
    assert gain > 1.15, gain


def test_skies_that_send_nothing_or_the_same_everywhere(mi):
    black = environment(mi, {"type": "constant", "radiance": 0.0})
    assert np.all(np.isfinite(np.asarray(SkyTable(black).draw(mi.UInt32(0), mi.Point2f(0.3, 0.6))[0])))
    found = pictures(scene(sky(2.0) | yard(None), width_px=8, height_px=8), 2, samples=4, model="path")
    assert np.all(np.isfinite(found))
