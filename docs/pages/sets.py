"""The JSON Schema of a set's file, by which editors complete and underline.

It knows every key, the names that ship and what a value looks like; what one section asks of another is for
`definition` to say.
"""

from __future__ import annotations

import json
from typing import Any

from synfog_usd.base import resources
from synfog_usd.base.numbers import BANDS, MOST_EV, QUALITIES, RGB, SAMPLES
from synfog_usd.dataset.plan import AS_AUTHORED, CLEAR, METERS
from synfog_usd.dataset.sets.definition import RECIPE_LIGHTINGS
from synfog_usd.dataset.sets.load import HELD_OUT, MOST_SCENES, OWN_CAMERA, SCHEMA, SECTIONS, shipped
from synfog_usd.render.models import AUTO, MODELS
from synfog_usd.world.language import FOG


def schema() -> dict[str, Any]:
    """JSON Schema, draft 7, of a set."""
    sections = _sections()
    assert set(sections) == set(SECTIONS)
    return {
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": "synfog-usd set",
        "type": "object",
        "required": ["synfog"],
        "properties": sections,
        "additionalProperties": False,
    }


SHARE: dict[str, Any] = {"anyOf": [{"type": "number", "exclusiveMinimum": 0}, {"type": "string"}]}
NAMES: dict[str, Any] = {"type": "array", "minItems": 1, "items": {"type": "string"}}


def _sections() -> dict[str, Any]:
    return {**_sources(), **_light(), **_cameras(), **_quality(), **_splits()}


def _sources() -> dict[str, Any]:
    recipes = _stems("stages", "recipes")
    return {
        "synfog": {"const": SCHEMA, "description": "The format of this file."},
        "about": {"type": "string", "description": "One sentence."},
        "extends": {**_name(list(shipped())), "description": "A set that this one changes, section by section."},
        "seed": {"type": "integer", "minimum": 0, "default": 0, "description": "All scenes follow from it."},
        "scenes": {"type": "integer", "minimum": 1, "maximum": MOST_SCENES, "description": "How many."},
        "recipes": _shares(_name(recipes), SHARE, "Recipes that ship, or files (.yaml), with their shares.", recipes),
        "stages": _shares({"type": "string"}, SHARE, "Patterns of USD files, with their shares of the scenes."),
        "changes": {"type": "object", "description": "section.key: value, over what recipes say."},
    }


def _light() -> dict[str, Any]:
    weights = {"type": "object", "minProperties": 1, "additionalProperties": {"type": "number", "exclusiveMinimum": 0}}
    lighting: dict[str, Any] = {"type": "string", "examples": [*RECIPE_LIGHTINGS, AS_AUTHORED]}
    return {
        "lightings": {
            "type": "array",
            "items": {"anyOf": [lighting, _one("choice", weights)]},
            "description": "Every scene has each; of a choice, one by chance. All that it has if left out.",
        },
        "fogs": {
            "type": "array",
            "minItems": 1,
            "items": {"anyOf": [{"type": "string", "examples": [CLEAR, AS_AUTHORED]}, *_visibility()]},
            "description": "Visibilities (MOR) in metres, fixed or drawn, or names of fogs that the stages have.",
        },
    }


def _cameras() -> dict[str, Any]:
    pipelines = _stems("pipeline", "")
    return {
        "cameras": {**NAMES, "default": [OWN_CAMERA], "description": "Prim paths, or the stage's own."},
        "pipelines": {
            "type": "array",
            "minItems": 1,
            "items": _name(pipelines),
            "description": "Cameras that develop the same radiance; it is rendered for the first.",
        },
        "asm_estimated": {
            "type": "array",
            "items": {"type": "string"},
            "description": "Pipelines that also develop the clear frame in fog by the atmospheric scattering model.",
        },
        "meter": {
            "enum": list(METERS),
            "default": METERS[0],
            "description": "Whether the cameras are exposed together, by what all of them see, or each by itself.",
        },
        "same_noise": {
            "type": "boolean",
            "default": False,
            "description": "Whether the fogs of a lighting have the temporal noise of its clear frame.",
        },
        "size": {
            "type": "array",
            "items": {"type": "integer", "minimum": 1, "maximum": 16384},
            "minItems": 2,
            "maxItems": 2,
            "description": "Width and height in pixels; the stage's own if left out.",
        },
    }


def _quality() -> dict[str, Any]:
    return {
        "quality": {
            "type": ["string", "object"],
            "additionalProperties": False,
            "description": "When a shot is good enough: a word of bake's --quality, or options of bake.",
            "properties": {
                "word": {"enum": list(QUALITIES)},
                "model": {"enum": [AUTO, *MODELS]},
                "samples": {"type": "integer", "minimum": SAMPLES[0], "maximum": SAMPLES[1]},
                "target_error": {"type": "number", "exclusiveMinimum": 0, "maximum": 1},
                "bands": {"enum": [RGB, *BANDS]},
            },
        },
        "exposure": {
            "type": "object",
            "additionalProperties": False,
            "description": "As options of bake: exposure time in seconds, as 1/200, ISO, stops over the meter.",
            "properties": {
                "time": {"anyOf": [{"type": "number", "exclusiveMinimum": 0}, {"type": "string"}]},
                "iso": {"type": "number", "exclusiveMinimum": 0},
                "ev": {"type": "number", "minimum": -MOST_EV, "maximum": MOST_EV},
            },
        },
    }


def _splits() -> dict[str, Any]:
    held = {key: {**NAMES, "description": f"{key.capitalize()} that no other split shows."} for key in HELD_OUT}
    split = {"type": "object", "properties": {"share": SHARE, **held}, "required": ["share"]}
    return {
        "splits": {
            "type": "object",
            "minProperties": 1,
            "additionalProperties": {"anyOf": [SHARE, {**split, "additionalProperties": False}]},
            "description": "Name: share of the scenes, or share with what only this split may show.",
        },
    }


def _visibility() -> list[dict[str, Any]]:
    whole = {"type": "integer", "minimum": FOG.low, "maximum": FOG.high}
    pair = {"type": "array", "items": whole, "minItems": 2, "maxItems": 2}
    keys = ("mean", "deviation", "low", "high")
    normal = {"type": "object", "properties": {key: {"type": "number"} for key in keys}, "required": list(keys)}
    return [whole, _one("integer", pair), _one("normal", {**normal, "additionalProperties": False})]


def _one(word: str, value: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": {word: value}, "required": [word], "additionalProperties": False}


def _shares(
    item: dict[str, Any], share: dict[str, Any], about: str, shipped_names: list[str] | None = None
) -> dict[str, Any]:
    mapping: dict[str, Any] = {"type": "object", "minProperties": 1, "additionalProperties": share}
    if shipped_names:
        mapping["properties"] = dict.fromkeys(shipped_names, share)
    return {"anyOf": [{"type": "array", "minItems": 1, "items": item}, mapping], "description": about}


def _name(shipped_names: list[str]) -> dict[str, Any]:
    return {"anyOf": [{"enum": shipped_names}, {"type": "string", "pattern": r"\.yaml$"}]}


def _stems(folder: str, inside: str) -> list[str]:
    return [path.stem for path in sorted((resources.folder(folder) / inside).glob("*.yaml"))]


def text() -> str:
    """The schema as a file has it."""
    return json.dumps(schema(), indent=1) + "\n"
