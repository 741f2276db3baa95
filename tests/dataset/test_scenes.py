"""How often a bake translates its stage."""

from __future__ import annotations

from pathlib import Path

from support.stages import street

from synfog_usd import camera
from synfog_usd import stage as usd
from synfog_usd.dataset.plan import BakePlan, shots
from synfog_usd.dataset.scenes import Scenes


def scenes(tmp_path, text, graph=None, **plan):
    (tmp_path / "street.usda").write_text(text)
    wanted = BakePlan(tmp_path / "street.usda", tmp_path / "out", size=(32, 18), **plan)
    stage = usd.open_stage(wanted.stage)
    return Scenes(stage, wanted, graph), shots(wanted, usd.variants(stage))


def test_a_lens_that_distorts_is_rendered_for_wider_and_denser(tmp_path):
    """More than twice the pixels each way and a wider view; one world for all fogs still, and what the sensor takes is
    the stage's own.
    """
    made, todo = scenes(tmp_path, street(lamp=True), camera.load_graph(Path("dashcam")), fog=("clear", "mor600"))
    plain, _ = scenes(tmp_path, street(lamp=True), camera.load_graph(Path("phone")), fog=("clear", "mor600"))
    wide, narrow = made.of(todo[0]).camera, plain.of(todo[0]).camera
    assert (narrow.width_px, narrow.height_px) == (32, 18) and plain.sensor is None
    assert wide.width_px > 64 and wide.height_px > 36 and wide.fov_x_deg > narrow.fov_x_deg
    assert made.sensor == (18, 32, narrow.fov_x_deg, narrow.shift)
    assert len({id(made.of(shot).world) for shot in todo if shot.lighting == todo[0].lighting}) == 1
