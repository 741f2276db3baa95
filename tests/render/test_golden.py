"""The same seed gives the same picture for ever: tiny pictures whose values lie in `golden.json`.

Values, not bytes: another LLVM or processor may round a sum otherwise.  Who changes an estimator on purpose writes
them anew, `python tests/render/test_golden.py`, and says so; the change is then seen in the review.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from synfog_usd.fog import FogMedium, FogVolume
from synfog_usd.render import backend
from synfog_usd.render.shot import render
from synfog_usd.testing import box, scene, sky, wall

FILE = Path(__file__).with_name("golden.json")

GREY = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.4, 0.3, 0.2]}}
GLOSS = {"type": "preview_surface", "base_color": {"type": "rgb", "value": [0.3, 0.4, 0.5]}, "roughness": 0.3}


def world(lit):
    """A street's ground, a block and a slab of fog; a sky, and lamps of three kinds."""
    side = 150.0
    down = np.diag([1.0, -1.0, -1.0, 1.0])
    down[:3, 3] = -2.0, 9.0, 4.0
    lamps = {
        "light_spot": {
            "type": "spot",
            "to_world": down,
            "intensity": {"type": "rgb", "value": [500.0, 400.0, 300.0]},
            "cutoff_angle": 60.0,
        },
        "light_bulb": {
            "type": "point",
            "position": [3.0, 14.0, 1.0],
            "intensity": {"type": "rgb", "value": [50.0] * 3},
        },
        "shape_lamp": wall(
            12.0, 0.3, bsdf=GREY, emitter={"type": "area", "radiance": {"type": "rgb", "value": [900.0, 900.0, 700.0]}}
        ),
    }
    ground = np.array([[-side, -side, -1.5], [side, -side, -1.5], [side, side, -1.5], [-side, side, -1.5]])
    parts = {
        **sky(100.0 if not lit else 0.1),
        "shape_ground": {"type": "mesh", "positions": ground, "faces": np.array([[0, 1, 2], [0, 2, 3]]), "bsdf": GREY},
        "shape_block": wall(20.0, 3.0, bsdf=GLOSS),
        **(lamps if lit else {}),
    }
    fog = FogVolume("/Fog", box((side, side, 20.0), (0.0, 0.0, 15.0)), FogMedium.from_visibility(80.0))
    return scene(parts, [fog], width_px=6, height_px=4, fov_x_deg=60.0)


CASES = {
    "path by day": (False, {"model": "path"}),
    "path by night": (True, {"model": "path"}),
    "path+slab": (False, {"model": "path+slab"}),
    "field by night": (True, {"model": "field"}),
    "single by night": (True, {"model": "single"}),
    "volpath by night": (True, {"model": "volpath"}),
    "path in 8 bands": (True, {"model": "path", "bands": 8}),
}


def picture(name):
    """(4, 6, C) of eight paths a pixel; Neyman's allocation does not yet speak."""
    lit, settings = CASES[name]
    return render(world(lit), samples=8, seed=2024, **settings).radiance.pixels


@pytest.mark.parametrize("name", CASES)
def test_the_same_seed_gives_the_same_picture_for_ever(name):
    """To 1e-4 of each value, or 1e-7 of the brightest."""
    if backend.mitsuba().variant() != "llvm_ad_rgb":
        pytest.skip("another variant, other numbers")
    wanted = np.array(json.loads(FILE.read_text())[name])
    np.testing.assert_allclose(picture(name), wanted, rtol=1e-4, atol=1e-7 * wanted.max())


def test_another_seed_gives_another_picture():
    """Else the golden pictures would prove nothing."""
    one, other = (render(world(True), samples=8, seed=seed, model="path").radiance.pixels for seed in (2024, 2025))
    assert (np.abs(one - other) > 1e-3 * one.max()).mean() > 0.3


if __name__ == "__main__":
    rows = {name: picture(name).astype(float) for name in CASES}
    lines = [
        f" {json.dumps(name)}: {json.dumps([[[float(f'{v:.7g}') for v in p] for p in row] for row in pixels])}"
        for name, pixels in rows.items()
    ]
    FILE.write_text("{\n" + ",\n".join(lines) + "\n}\n")
