"""Lit surfaces by the thousand, joined with their neighbours."""

from dataclasses import replace

import numpy as np
import pytest
from support.parts import glow, rgb
from support.stats import assert_agree

from synfog_usd.render import models
from synfog_usd.render.flatten import flatten
from synfog_usd.render.lights import crowd
from synfog_usd.render.shot import load
from synfog_usd.scene.testing import black, scene, wall

pytestmark = pytest.mark.usefixtures("mi")

SIZE_M = 0.1
AREA_M2 = {"sphere": 4.0 * np.pi * SIZE_M**2, "disk": np.pi * SIZE_M**2, "rectangle": 4.0 * SIZE_M**2}
KINDS = tuple(AREA_M2)
GREY = {"type": "diffuse", "reflectance": rgb(0.5)}


def lamps(many):
    """Balls, disks and cards in rows that look at a wall behind them, every fourth mirrored; bright, and twice that."""
    world = {"mat_black": black()["bsdf"]}
    for n in range(many):
        place = np.eye(4)
        place[:3, 3] = 0.8 * (n % 10) - 3.6, 6.0 + 0.2 * (n // 50), 0.8 * (n // 10 % 5) - 1.6
        place[:3, :3] = SIZE_M * np.array([[-1.0 if n % 4 == 0 else 1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
        form = {"center": place[:3, 3].tolist(), "radius": SIZE_M} if n % 3 == 0 else {"to_world": place}
        light = glow(50.0 * (1 + n % 2))
        world[f"shape_{n}"] = {"type": KINDS[n % 3], **form, "bsdf": {"type": "ref", "id": "mat_black"}}
        world[f"shape_{n}"]["emitter"] = light
    world["shape_wall"] = wall(9.0, 6.0, bsdf=GREY)
    source = scene(world, width_px=8, height_px=6, fov_x_deg=50.0)
    return replace(source, group_of={f"shape_{n}": "left" if n % 10 < 5 else "right" for n in range(many)})


def lit(flat):
    return {key: part for key, part in flat.world.items() if "emitter" in part}


def area(mesh):
    corners = mesh["positions"][mesh["faces"]].astype(float)
    return 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()


def test_two_thousand_become_a_hundred_and_fifty():
    """The nearest stay; area by radiance and group, flux thereby, label ids and light groups are those of all."""
    source = lamps(2000)
    flat, instances, _ = flatten(source)
    made = lit(flat)
    joined = {key: part for key, part in made.items() if key in instances}
    assert len(made) <= crowd.NEAREST + crowd.BLOCKS and len(made) - len(joined) == crowd.NEAREST
    found, true = {}, {}
    for key, part in made.items():
        kind = part["emitter"]["radiance"]["value"][0], flat.group_of[key]
        found[kind] = found.get(kind, 0.0) + (area(part) if key in joined else AREA_M2[part["type"]])
    for key, part in lit(source).items():
        kind = part["emitter"]["radiance"]["value"][0], source.group_of[key]
        true[kind] = true.get(kind, 0.0) + AREA_M2[part["type"]]
    assert found == pytest.approx(true, rel=1e-4) and len(true) == 4
    ids = {int(one) for key in joined for one in instances[key]} | {
        flat.instance_of[(key,)] for key in made.keys() - joined
    }
    assert ids == {source.instance_of[(key,)] for key in lit(source)}


@pytest.mark.slow
def test_their_light_is_that_of_each_alone(monkeypatch):
    """Means of a wall behind 150 lamps, some of which the eye sees."""
    monkeypatch.setattr(crowd, "NEAREST", 20)
    source = lamps(150)
    found = []
    for many in (10, 1000):
        monkeypatch.setattr(crowd, "MANY_LIT", many)
        integrator = models.make("path", load(source, boundaries=False))
        found.append([integrator.accumulate(samples=512, seed=seed).mean() for seed in range(8)])
    assert_agree(*found, resolves=0.1)
