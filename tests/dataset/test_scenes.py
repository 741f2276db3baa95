"""How often a bake translates its stage."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from support.stages import street

from synfog_usd import camera
from synfog_usd import stage as usd
from synfog_usd.dataset.forecast import least_known_first
from synfog_usd.dataset.plan import BakePlan, shots
from synfog_usd.dataset.scenes import UNREAD_MOR_M, Scenes
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


def point(text):
    """The street with its lamp a point."""
    changed = re.sub(r"float inputs:radius = [0-9.]+", "bool treatAsPoint = true", text)
    assert changed != text
    return changed


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


@pytest.mark.parametrize("lights", ["sky", "surfaces", "lamps"])
def test_what_shines(tmp_path, lights):
    """A sky alone, a shining sphere too, or a lamp that is a point; one may be where nothing was read yet."""
    text = street(lamp=lights != "sky")
    made, todo = scenes(tmp_path, point(text) if lights == "lamps" else text, fog=("clear",), lighting=("sky",))
    assert made.lights("sky") == "lamps"
    made.survey(todo)
    assert made.lights("sky") == lights


def test_how_thick_a_fog_is(tmp_path):
    """The visibilities that were asked for, also in a lighting that was not read; about, where no such fog was."""
    made, todo = scenes(tmp_path, street(), fog=("clear", "mor600", "mor75"))
    assert [made.mor_m(shot) for shot in todo] == 2 * [None, UNREAD_MOR_M, UNREAD_MOR_M]
    made.survey([shot for shot in todo if shot.lighting == "sky"])
    assert [made.mor_m(shot) for shot in todo] == pytest.approx(2 * [None, 600.0, 75.0])


def test_what_tells_much_of_others_is_made_first(tmp_path):
    """Where shots stop by themselves: the middle one in fog without lamps, those before lamps, the rest; as they come
    where nothing is lit, or everything.
    """

    def order(fog, lit):
        _, todo = scenes(tmp_path, street(lamp=True), fog=fog)
        ordered = least_known_first(todo, lambda lighting: "lamps" if lighting in lit else "sky")
        return [todo.index(shot) for shot in ordered]

    fogs = "clear", "mor600", "mor300", "mor150"
    assert order(fogs, "active") == [2, 4, 5, 6, 7, 0, 1, 3]
    assert order(fogs[:2], "active") == [1, 2, 3, 0]
    assert order(fogs[:1], "active") == [0, 1]
    assert order(fogs, "") == order(fogs, "sky active") == list(range(8))
