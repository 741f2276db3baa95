"""The schema of a set's file is of one mind with the reader."""

import jsonschema
import pytest
import yaml

from docs.pages import sets
from synfog_usd.base.errors import SynfogError
from synfog_usd.dataset.sets.load import define_set, shipped


@pytest.fixture(scope="module")
def validator():
    found = sets.schema()
    jsonschema.Draft7Validator.check_schema(found)
    return jsonschema.Draft7Validator(found)


@pytest.mark.parametrize("name, path", shipped().items())
def test_shipped_sets_are_valid(validator, name, path):
    said = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert [error.message for error in validator.iter_errors(said)] == []


@pytest.mark.parametrize(
    "words, good",
    [
        ({}, True),
        ({"recipes": {"tunnel": 2}, "fogs": ["clear", {"integer": [50, 100]}]}, True),
        ({"lightings": [{"choice": {"sky": 1, "active": 2}}]}, True),
        ({"splits": {"train": 9, "test": {"share": 1, "models": ["bus"]}}}, True),
        ({"recipes": ["tunel"]}, False),
        ({"fogs": [5]}, False),
        ({"quality": {"samples": 0}}, False),
        ({"quality": {"time": 3}}, False),
        ({"more": 1}, False),
    ],
)
def test_schema_and_reader_agree(validator, words, good):
    said = {"synfog": "set/1", "scenes": 3, "recipes": ["tunnel"], **words}
    assert validator.is_valid(said) == good
    try:
        define_set(**{key: value for key, value in said.items() if key != "synfog"})
        read = True
    except SynfogError:
        read = False
    assert read == good
