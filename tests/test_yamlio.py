"""Words and numbers of YAML as people write them: off is a word, and 1e-5 a number."""

from __future__ import annotations

import pytest

from synfog_usd import camera
from synfog_usd.base import yamlio
from synfog_usd.base.errors import GraphError, SetError
from synfog_usd.camera.profiles import load_sensor
from synfog_usd.camera.template import sensor_template
from synfog_usd.dataset.sets.load import load_set
from synfog_usd.world import compose

ON, OFF = ("true", "True", "on", "On", "yes", "YES"), ("false", "FALSE", "off", "Off", "no", "No")


def plain(text):
    return yamlio.load_text(text).plain()


@pytest.mark.parametrize("word", ["on", "Off", "yes", "NO", "y", "n"])
def test_words_stay_words(word):
    """As a value, in a list and as a key; true and false alone are booleans (YAML 1.2, chapter 10.3.2)."""
    assert plain(f"a: {word}\nb: [{word}, true, False]\n{word}: 1") == {"a": word, "b": [word, True, False], word: 1}


@pytest.mark.parametrize(
    ("text", "number"),
    [("5e-05", 5e-5), ("1e6", 1e6), ("-2E3", -2e3), (".5e1", 5.0), ("1.e2", 100.0), ("1.5e-3", 1.5e-3)],
)
def test_numbers_may_have_an_exponent_alone(text, number):
    """Chapter 10.3.2 of YAML 1.2; in quotes they are text."""
    assert plain(f"a: {text}\nb: '{text}'") == {"a": number, "b": text}
    assert isinstance(plain(f"a: {text}")["a"], float)


@pytest.mark.parametrize("word", [*ON, *OFF])
def test_a_switch_takes_each_word_for_true_and_false(word, tmp_path):
    """Of a graph's node and output, behind --set, of a set's quality and same_noise."""
    wanted = word in ON
    (tmp_path / "g.yaml").write_text(
        f"synfog: graph/1\nextends: phone\nnodes: [{{name: white_balance, clip: {word}}}]\n"
        f"outputs: {{linear.exr: {{node: colour, half: {word}}}}}\n"
    )
    graph = camera.load_graph(tmp_path / "g.yaml")
    assert graph.options_of("linear.exr") == {"half": wanted}
    for found in (graph, graph.with_overrides({"white_balance.clip": word})):
        assert found.nodes["white_balance"].params["clip"].value is wanted
    (tmp_path / "s.yaml").write_text(f"synfog: set/1\nextends: mini\nquality: {{samples: 4}}\nsame_noise: {word}\n")
    read = load_set(tmp_path / "s.yaml")
    assert read.same_noise is wanted


def test_a_switch_takes_no_other_word(tmp_path):
    (tmp_path / "g.yaml").write_text(
        "synfog: graph/1\nextends: phone\nnodes: []\noutputs: {linear.exr: {node: colour, half: perhaps}}\n"
    )
    with pytest.raises(GraphError, match="half is 'perhaps'; it takes true or false"):
        camera.load_graph(tmp_path / "g.yaml")
    (tmp_path / "s.yaml").write_text("synfog: set/1\nextends: mini\nsame_noise: 1\n")
    with pytest.raises(SetError, match="same_noise is 1; it takes true or false"):
        load_set(tmp_path / "s.yaml")


@pytest.mark.parametrize("how", ["option", "file", "mixed"])
def test_the_cameras_headlights_can_be_off(how, tmp_path):
    """By --set, in a recipe, and as one of two in a choice; the stage has no dipped beams of the camera's car then."""
    text = "synfog: recipe/1\nworld: road\nlane_section: [{lane: 3.5, way: -1}, {lane: 3.5, way: 1}]\n"
    more = {"option": "", "file": "camera: {headlights: off}\n", "mixed": "camera: {headlights: {choice: {off: 1}}}\n"}
    (tmp_path / "r.yaml").write_text(text + more[how])
    changes = ("camera.headlights=off",) if how == "option" else ()
    spec = compose.draw(compose.load(tmp_path / "r.yaml", changes), seed=1)
    assert spec.built["headlights"] == "off"


def test_a_sensor_may_have_an_exponent(tmp_path):
    text = sensor_template()
    assert "shortest_exposure_s: {value: 5e-05," in text
    (tmp_path / "mine.yaml").write_text(text)
    assert load_sensor("mine.yaml", tmp_path).shortest_exposure_s == 5e-5
