"""The schema of recipes is of one mind with the reader."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import pytest
import yaml

from docs.pages import recipes
from synfog_usd.base.errors import RecipeError
from synfog_usd.world import parameters
from synfog_usd.world.compose import load
from synfog_usd.world.language import Continuous

ROOT = Path(__file__).resolve().parents[2]
HEAD = "synfog: recipe/1\n"
ROAD = HEAD + "world: road\nlane_section: [{lane: 3.5, way: -1}, {lane: 3.5, way: 1}]\n"


@pytest.fixture(scope="module")
def validator():
    schema = recipes.schema()
    jsonschema.Draft7Validator.check_schema(schema)
    return jsonschema.Draft7Validator(schema)


@pytest.mark.parametrize("path", sorted((ROOT / "stages" / "recipes").glob("*.yaml")), ids=lambda path: path.stem)
def test_shipped_recipes_are_valid(validator, path):
    assert [error.message for error in validator.iter_errors(yaml.safe_load(path.read_text(encoding="utf-8")))] == []


@pytest.mark.parametrize(
    "text",
    [
        HEAD + "world: rode",
        HEAD + "world: road",
        ROAD + "traffic: {bodies: tank}",
        ROAD + "fog: []",
        ROAD + "rows: [{side: left}]",
        ROAD + "circle: {diameter_m: 30}",
        HEAD + "world: road\nlane_section: [{lane: 3.5}]",
        HEAD + "sky: {day: {choice: {overcast: 0}}}",
    ],
)
def test_what_the_reader_refuses_the_schema_refuses(validator, tmp_path, text):
    (tmp_path / "mine.yaml").write_text(text)
    with pytest.raises(RecipeError):
        load(tmp_path / "mine.yaml")
    assert not validator.is_valid(yaml.safe_load(text))


@pytest.mark.parametrize("name", parameters.WORLDS)
def test_both_ends_of_every_range_are_in_and_what_lies_beyond_is_out(validator, tmp_path, name):
    """Number by number, for the reader and for the schema alike."""
    world = parameters.WORLDS[name]
    base = {"synfog": "recipe/1", "world": name, **({"lane_section": [{"lane": 3.5, "way": 1}]} if world.lanes else {})}
    path = tmp_path / "mine.yaml"
    for key, one in world.parameters.items():
        if not isinstance(one, Continuous):
            continue
        section, _, word = key.partition(".")
        beyond = 1 if one.whole else 1e-3
        for value, right in ((one.low, True), (one.high, True), (one.low - beyond, False), (one.high + beyond, False)):
            text = json.dumps({**base, section: {word: value}})
            path.write_text(text)
            assert validator.is_valid(json.loads(text)) == right, (key, value)
            try:
                load(path)
                taken = True
            except RecipeError:
                taken = False
            assert taken == right, (key, value)
