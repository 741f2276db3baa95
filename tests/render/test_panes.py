"""Panes: shadow rays pass them, and paths that do find no light a second time; against closed forms and `volpath`."""

import numpy as np
import pytest
from support.parts import rgb, squares
from support.renders import by_seed, means
from support.stats import assert_agree

from synfog_usd.render import backend
from synfog_usd.render.lights.panes import MOST_PASSED, Panes
from synfog_usd.render.shot import load
from synfog_usd.scene.testing import black, scene, sky, uniform_fog, wall

pytestmark = pytest.mark.usefixtures("mi")

OPACITY = 0.35
GREY = {"type": "diffuse", "reflectance": rgb(0.5)}
GLASS = {"type": "preview_surface", "base_color": rgb(0.02), "roughness": 0.6, "eta": 2.83}
DARK = {"type": "diffuse", "reflectance": rgb(0.0)}
LAMPS = {"one": 1, "many": 20}


def pane(bsdf, opacity=OPACITY):
    return {"type": "mask", "opacity": opacity, "bsdf": bsdf}


def behind(panes, fog=(), lamps=1, bsdf=DARK, light=None):
    """The eye looks at a grey wall, 4 m away, that lamps behind the eye shine at; panes stand between."""
    world = {"shape_wall": wall(4.0, 3.0, bsdf=GREY)}
    for number in range(panes):
        world[f"shape_pane_{number}"] = wall(2.0 - 0.4 * number, 1000.0, bsdf=pane(bsdf))
    for number in range(lamps):
        at = -3.0 + 0.7 * (number - lamps // 2)
        corners = np.array([(0, 0, 0), (0, 0, 1), (1, 0, 1), (1, 0, 0)]) * 0.3 + (at, -6.0, 1.0)
        world[f"shape_lamp_{number}"] = squares(corners, **black(1000.0))
    return scene({**world, **(light or {})}, fog, width_px=8, height_px=6, fov_x_deg=30.0)


@pytest.mark.parametrize("lamps, panes", [("one", 3), pytest.param("many", 1, marks=pytest.mark.slow)])
def test_light_that_passes_panes_twice_is_as_much_less_and_no_noisier(lamps, panes):
    """Black panes before eye and lamps: 0.65 to the power of twice their number of what arrives without. Of the scatter
    three times as much is allowed as paths that end at a pane would make alone.
    """
    seeds, samples = 8, 512
    bare, paned = (
        means(behind(count, lamps=LAMPS[lamps]), seeds, model="path", samples=samples) for count in (0, panes)
    )
    through = (1.0 - OPACITY) ** (2 * panes)
    assert_agree(paned / through, bare, resolves=0.06)
    played = np.sqrt((1.0 / (1.0 - OPACITY)) ** panes - 1.0)  # of a path that goes on with this chance
    assert paned.std() / paned.mean() < 3.0 * np.hypot(bare.std() / bare.mean(), played / np.sqrt(samples * 48))


@pytest.mark.slow
@pytest.mark.parametrize("foggy, lamps, under_sky", [(False, "many", False), (True, "one", True)])
def test_glass_has_the_light_of_volpath(foggy, lamps, under_sky):
    """A pane that mirrors, too: Mitsuba's path tracer passes panes in its own way.  In fog, where that is noisy, a
    fifth is resolved: light that is counted twice, or not at all, is half of it.
    """
    fog = [uniform_fog(visibility_m=100.0, g=0.0)] if foggy else []
    place = behind(1, fog, LAMPS[lamps], GLASS, sky(20.0) if under_sky else None)
    samples, resolves = (1024, 0.2) if foggy else (256, 0.05)
    theirs = means(place, 6, model="volpath", samples=2 * samples)
    assert_agree(means(place, 6, model="path", samples=samples), theirs, resolves=resolves, systematic=0.003)


def test_what_is_no_pane_stops_shadow_rays():
    """Opaque surfaces, pictures of opacity, and what shines; behind more panes than are passed it is dark."""
    leaf = {"type": "mask", "opacity": {"type": "bitmap", "bitmap": np.full((2, 2, 1), 0.5, np.float32), "raw": True}}
    card = wall(2.0, bsdf={**leaf, "bsdf": DARK})
    shining = wall(2.0, bsdf=pane(DARK), emitter=black(9.0)["emitter"])
    assert Panes.of(load(behind(0, light={"shape_card": card, "shape_neon": shining}), boundaries=False)) is None
    mi = backend.mitsuba()
    for count in (1, MOST_PASSED, MOST_PASSED + 1):
        world = {f"shape_{n}": wall(1.0 + 0.1 * n, bsdf=pane(DARK)) for n in range(count)}
        loaded = load(scene({**world, "shape_end": wall(5.0)}), boundaries=False)
        found, met, ray, through = Panes.of(loaded).beyond(
            loaded.tree, mi.Ray3f(mi.Point3f(0.0), mi.Vector3f(0.0, 1.0, 0.0)), mi.Bool(True)
        )
        wanted = (1.0 - OPACITY) ** count if count <= MOST_PASSED else 0.0
        assert through[0] == pytest.approx(wanted, rel=1e-5) and bool(found[0]) == (count <= MOST_PASSED)
        if found[0]:
            assert ray.o.y[0] + met.t[0] == pytest.approx(5.0, abs=1e-4)


def test_a_lamp_that_the_eye_sees_through_panes_is_as_bright_as_they_let_it_be():
    """A wall that shines, behind two: by any estimator, once."""
    world = {f"shape_pane_{n}": wall(1.0 + n, bsdf=pane(DARK)) for n in range(2)}
    for number in range(13):  # so many that their light on the first surface is an estimator of its own
        world[f"shape_lamp_{number}"] = wall(9.0 + 0.01 * number, 3.0, **black(100.0))
    run = by_seed(scene(world, width_px=4, height_px=3), [0, 1, 2, 3], model="path", samples=4096)
    seen = np.array([one.radiance.pixels.mean() for one in run])
    assert seen.mean() == pytest.approx(100.0 * (1.0 - OPACITY) ** 2, rel=0.01)
