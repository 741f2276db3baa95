"""The language of recipes as a page and as a JSON Schema, made from the parameters themselves.

The schema knows every key, name and range; it cannot see what one value asks of another (that low is below high, that
arms find room): that is for `compose`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from synfog_usd.world.language import FOG, FOG_DEFAULT, SCHEMA, Categorical, Continuous, Parameter
from synfog_usd.world.parameters import LANE, WORLDS, World, named
from synfog_usd.world.roads.lane_section import DRIVEN, KINDS

HEAD = """\
# Recipes

Every parameter of every world. This page is made from the parameters themselves, and `recipe.schema.json` beside it, by
which editors complete and underline: `python -m docs.pages`. How they are drawn stands in [worlds](../worlds.md).

- A number is fixed, `{uniform: [low, high]}`, `{normal: {mean, deviation, low, high}}` (cut at both ends) or `{by_hour: [[hour, value], ...]}`.
- A whole number is fixed, `{integer: [low, high]}` with both ends, `{normal: ...}` or `{by_hour: ...}`, both rounded.
- A name is fixed or `{choice: {name: weight, ...}}`; weights are above 0.
"""  # noqa: E501
LANES = """\
Lanes from left to right, `{KIND: width}` each; those that are driven also say their `way`: 1 away from the camera, -1 towards it.
Lanes of way -1 lie left of those of way 1."""  # noqa: E501
ROWS = "A list of rows of props; earlier rows go first where there is no room."
STARS = {
    "*": "any model",
    "*sky": "any sky in nits",
    "*vehicle": "any vehicle",
    "*person": "any person",
    "*plant": "any plant",
}


def page() -> str:
    """The page, as Markdown."""
    lines = [HEAD]
    for name, world in WORLDS.items():
        keys = ", ".join(f"`{key}`" for key in world.keys)
        lines += [f"## world: {name}", "", f"{world.about} Keys of the recipe: {keys}.", ""]
        for section, parameters in _by_section(world).items():
            lines += [f"### {section} ({name})", "", *_table(parameters), ""]
        if world.lanes:
            kinds, driven = (", ".join(f"`{kind}`" for kind in group) for group in (KINDS, DRIVEN))
            lines += [f"### lane_section ({name})", "", LANES, "", f"Kinds: {kinds}; driven: {driven}.", ""]
            lines += [*_table({"KIND": LANE}), ""]
        if world.row:
            lines += [f"### rows ({name})", "", ROWS, "", *_table(world.row), ""]
    names = "`rain10`, or `{choice: {rain10: 2, snow2: 1}}`"
    lines += ["## fog", "", f"A list of visibilities, and weather by name ({names}): one variant each, in every world."]
    lines += ["Clear air is always there.", ""]
    lines += [*_table({"fog": FOG}, left_out=str(list(FOG_DEFAULT))), ""]
    return "\n".join(lines)


def _by_section(world: World) -> dict[str, dict[str, Parameter]]:
    """Parameters by section and key."""
    result: dict[str, dict[str, Parameter]] = {}
    for name, parameter in world.parameters.items():
        section, _, key = name.partition(".")
        result.setdefault(section, {})[key] = parameter
    return result


def schema() -> dict[str, Any]:
    """JSON Schema, draft 7, of a recipe."""
    first, *further = WORLDS
    of_worlds = [p for world in WORLDS.values() for p in (*world.parameters.values(), *world.row.values())]
    chosen: dict[str, Any] = {"properties": {"world": {"enum": further}}, "required": ["world"]}
    rules = [{"if": {"not": chosen}, "then": _world(WORLDS[first])}]
    rules += [
        {"if": {"properties": {"world": {"const": name}}, "required": ["world"]}, "then": _world(WORLDS[name])}
        for name in further
    ]
    return {
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": "synfog-usd recipe",
        "type": "object",
        "required": ["synfog"],
        "properties": {
            "synfog": {"const": SCHEMA, "description": "The format of this file."},
            "world": {"enum": list(WORLDS), "default": first, "description": "What is drawn."},
        },
        "allOf": rules,
        "definitions": {_form(parameter): _forms(parameter) for parameter in [FOG, LANE, *of_worlds]},
    }


WEATHER: list[dict[str, Any]] = [
    {"type": "string"},
    {
        "type": "object",
        "properties": {"choice": {"type": "object", "additionalProperties": {"type": "number"}}},
        "required": ["choice"],
        "additionalProperties": False,
    },
]
"""Forms of a fog by name."""


def _world(world: World) -> dict[str, Any]:
    properties: dict[str, Any] = {
        "synfog": True,
        "world": True,
        "about": {
            "type": "string",
            "default": world.about,
            "description": "One sentence, for the stage's documentation.",
        },
        "fog": {
            "type": "array",
            "minItems": 1,
            "items": {"anyOf": [_value(FOG), *WEATHER]},
            "default": list(FOG_DEFAULT),
            "description": "Visibilities (MOR) in metres, and weather by name.",
        },
    }
    properties |= {section: _mapping(parameters) for section, parameters in _by_section(world).items()}
    if world.row:
        row = _mapping(world.row) | {"required": ["models"]}
        properties["rows"] = {"type": "array", "items": row, "description": "Props along the road."}
    if world.lanes:
        lanes = {"anyOf": [_lane(kind) for kind in KINDS]}
        properties["lane_section"] = {"type": "array", "minItems": 1, "items": lanes}
        properties["lane_section"]["description"] = "Lanes from left to right."
    needed = {"required": ["lane_section"]} if world.lanes else {}
    return {"properties": properties, "additionalProperties": False} | needed


def _lane(kind: str) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": {
            kind: _value(LANE),
            "way": {"enum": [1, -1], "description": "1 away from the camera, -1 towards it."},
        },
        "required": [kind, "way"] if kind in DRIVEN else [kind],
        "additionalProperties": False,
    }


def _mapping(parameters: Mapping[str, Parameter]) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": {key: _value(parameter) for key, parameter in parameters.items()},
        "additionalProperties": False,
    }


def _value(parameter: Parameter) -> dict[str, Any]:
    """A parameter, in every form that it takes, which stand among the definitions."""
    about = {"description": parameter.about} | (
        {} if parameter.default is None else {"default": named(parameter).default}
    )
    return about | {"allOf": [{"$ref": f"#/definitions/{_form(parameter)}"}]}


def _form(parameter: Parameter) -> str:
    """Name of a definition."""
    if isinstance(parameter, Continuous):
        return f"{'whole' if parameter.whole else 'number'}_{parameter.low:g}_to_{parameter.high:g}"
    return "one_of_" + "_".join(name.replace("*", "library ").strip().replace(" ", "_") for name in parameter.allowed)


def _forms(parameter: Parameter) -> dict[str, Any]:
    """A number fixed or drawn; a name fixed or chosen."""
    parameter = named(parameter)
    if isinstance(parameter, Categorical):
        names = {"enum": list(parameter.allowed)}
        weights = {
            "type": "object",
            "minProperties": 1,
            "propertyNames": names,
            "additionalProperties": {"type": "number", "exclusiveMinimum": 0},
        }
        return {"anyOf": [names, _one("choice", weights)]}
    number = {"type": "integer" if parameter.whole else "number", "minimum": parameter.low, "maximum": parameter.high}
    loose = {"type": "number", "minimum": parameter.low, "maximum": parameter.high}
    pair = {"type": "array", "items": number, "minItems": 2, "maxItems": 2}
    hours = {
        "type": "array",
        "items": [{"type": "number", "minimum": 0, "maximum": 24}, number],
        "minItems": 2,
        "maxItems": 2,
    }
    shape = {
        "mean": {"type": "number"},
        "deviation": {"type": "number", "exclusiveMinimum": 0},
        "low": loose,
        "high": loose,
    }
    normal = {"type": "object", "properties": shape, "required": list(shape), "additionalProperties": False}
    forms = [
        _one("integer" if parameter.whole else "uniform", pair),
        _one("normal", normal),
        _one("by_hour", {"type": "array", "items": hours, "minItems": 1}),
    ]
    return {"anyOf": [number, *forms]}


def _one(word: str, value: Mapping[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": {word: value}, "required": [word], "additionalProperties": False}


def _table(parameters: Mapping[str, Parameter], *, left_out: str = "") -> list[str]:
    lines = ["| key | value | if left out | meaning |", "|---|---|---|---|"]
    return lines + [
        f"| `{key}` | {_range(parameter)} | {left_out or _default(parameter)} | {parameter.about} |"
        for key, parameter in parameters.items()
    ]


def _range(parameter: Parameter) -> str:
    if isinstance(parameter, Continuous):
        return f"{'whole, ' if parameter.whole else ''}{parameter.low:g} to {parameter.high:g}"
    return ", ".join(
        STARS.get(name, f"any of {name[1:]}") if name.startswith("*") else f"`{name}`" for name in parameter.allowed
    )


def _default(parameter: Parameter) -> str:
    if parameter.default is None:
        return ""
    if isinstance(parameter.default, Mapping):
        return ", ".join(f"`{name}` {weight:g}" for name, weight in parameter.default.items())
    return f"{parameter.default:g}" if isinstance(parameter, Continuous) else f"`{parameter.default}`"


def text() -> str:
    """The schema as a file has it: one definition a line."""
    whole = schema()
    rows = [f"  {json.dumps(key)}: {json.dumps(value)}" for key, value in whole.pop("definitions").items()]
    return json.dumps(whole, indent=1).removesuffix("\n}") + ',\n "definitions": {\n' + ",\n".join(rows) + "\n }\n}\n"
