"""A `SceneDict` in Mitsuba: what the renderer adds to it."""

from dataclasses import replace

import numpy as np

from synfog_usd.render.load import to_mitsuba
from synfog_usd.scene.testing import black, scene, sky, wall


def test_lights_are_chosen_by_the_root_of_their_flux_and_the_sky_keeps_its_share():
    """Lamps of 1 : 9 in flux are chosen 1 : 3, all of them together as often as the sky; of lamps without flux each as
    often as the other.
    """
    world = {**sky(), "shape_one": wall(10.0, 1.0, **black(1.0)), "shape_other": wall(20.0, 1.0, **black(9.0))}

    def weights(**flux):
        loaded = to_mitsuba(replace(scene(world), flux_of={"light_sky": np.inf, **flux}))
        lamps = [loaded.shapes[(key,)].emitter().sampling_weight() for key in ("shape_one", "shape_other")]
        return [*lamps, loaded.parts["light_sky"].sampling_weight()]

    np.testing.assert_allclose(weights(shape_one=1.0, shape_other=9.0), [0.25, 0.75, 1.0])
    np.testing.assert_allclose(weights(shape_one=0.0, shape_other=0.0), [0.5, 0.5, 1.0])
