"""How often a bake translates its stage."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.stages import street

from synfog_usd import camera
from synfog_usd import stage as usd
from synfog_usd.dataset.plan import BakePlan, shots
from synfog_usd.dataset.scenes import Scenes
from synfog_usd.translate import assemble

EXPOSED_TOO = ('        "mor150" {', '        "mor150" {\nover "Sky"\n{\nfloat inputs:exposure = 1\n}\n')


@pytest.fixture
def translations(monkeypatch):
    """The number of translations so far, counted where they begin."""
    count = []
    built = assemble._Assembler.build
    monkeypatch.setattr(assemble._Assembler, "build", lambda self, found: (count.append(1), built(self, found))[1])
    return count


def scenes(tmp_path, text, graph=None, **plan):
    (tmp_path / "street.usda").write_text(text)
    wanted = BakePlan(tmp_path / "street.usda", tmp_path / "out", size=(32, 18), **plan)
    stage = usd.open_stage(wanted.stage)
    return Scenes(stage, wanted, graph), shots(wanted, usd.variants(stage))


def test_a_lighting_is_translated_once(tmp_path, translations):
    """Six shots of two lightings, one of them in a visibility that the stage does not offer: two translations, also
    when each is asked for again.
    """
    made, todo = scenes(tmp_path, street(lamp=True), fog=("clear", "mor600", "mor75"))
    made.survey(todo)
    found = [made.of(shot) for shot in todo]
    assert len(todo) == 6 and len(translations) == 2
    assert len({id(scene.world) for scene in found}) == 2
    assert [[round(part.medium.visibility_m) for part in scene.fog] for scene in found] == 2 * [[], [600], [75]]


def test_a_fog_that_touches_more_is_translated_anew(tmp_path, translations):
    """Its variant makes the sky brighter: that shot has a scene of its own, with that sky."""
    made, todo = scenes(tmp_path, street().replace(*EXPOSED_TOO, 1), lighting=("sky",))
    found = {shot.fog: made.of(shot) for shot in todo}
    assert len(translations) == 2  # clear and mor600 share one
    sky = {fog: scene.world["light_sky"]["radiance"]["value"] for fog, scene in found.items()}
    assert sky["mor600"] == sky["clear"] and sky["mor150"] == pytest.approx([2.0 * value for value in sky["clear"]])


def test_a_visibility_counts_in_the_variant_that_was_authored(tmp_path, translations):
    """mor75 replaces the visibility of the fog that the stage chooses itself, also after clear air, in which that fog
    is switched off.
    """
    alone, (shot,) = scenes(tmp_path, street(), fog=("mor75",), lighting=("sky",))
    only = alone.of(shot)
    after, todo = scenes(tmp_path, street(), fog=("clear", "mor75"), lighting=("sky",))
    second = [after.of(shot) for shot in todo][1]
    assert second.fog[0].path == only.fog[0].path == "/World/Fog"


def test_a_lens_that_distorts_is_rendered_for_wider_and_denser(tmp_path):
    """More than twice the pixels each way and a wider view; one world for all fogs still, and what the sensor takes is
    the stage's own.
    """
    made, todo = scenes(tmp_path, street(lamp=True), camera.load_graph(Path("dashcam")), fog=("clear", "mor600"))
    plain, _ = scenes(tmp_path, street(lamp=True), camera.load_graph(Path("phone")), fog=("clear", "mor600"))
    wide, narrow = made.of(todo[0]).camera, plain.of(todo[0]).camera
    assert (narrow.width_px, narrow.height_px) == (32, 18) and plain.taken is None
    assert wide.width_px > 64 and wide.height_px > 36 and wide.fov_x_deg > narrow.fov_x_deg
    assert made.taken == (18, 32, narrow.fov_x_deg, narrow.shift)
    assert len({id(made.of(shot).world) for shot in todo if shot.lighting == todo[0].lighting}) == 1
