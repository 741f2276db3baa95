"""A JSON Schema of the graph format, by which editors complete and underline.

Made from the ops, so that it knows every parameter with its range.  It cannot see
what flows along an edge: that is for `graph check`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from synfog_usd.base.image import Quantity
from synfog_usd.camera.graph.compose import SCHEMA
from synfog_usd.camera.graph.op import FRACTION, MISSING, NUMBER, Op, Parameter, Registry
from synfog_usd.camera.graph.outputs import FORMATS, NODE, OPTIONS, Option

NAME = "^[a-z][a-z0-9_]*$"
FILE = r"\.ya?ml$"


def schema(
    registry: Registry, *, profiles: Mapping[str, Sequence[str]] | None = None, graphs: Sequence[str] = ()
) -> dict[str, Any]:
    """JSON Schema, draft 7, of a graph file.

    Args:
        registry: the ops that a node may name.
        profiles: kind -> shipped names, to be completed.
        graphs: shipped graphs, to be completed behind 'extends'.
    """
    headers = {
        kind: {
            "description": f"A shipped {kind} profile, or the path of an own one that ends in .yaml.",
            "anyOf": _named((profiles or {}).get(kind, ())),
        }
        for kind in registry.profiles
    }
    return {
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": "synfog-usd node graph",
        "type": "object",
        "required": ["synfog"],
        "additionalProperties": False,
        "properties": {
            "synfog": {"const": SCHEMA, "description": "The format of this file."},
            "title": {"type": "string"},
            "extends": {
                "description": "A shipped graph, or the path of an own one, whose nodes and outputs are changed here.",
                "anyOf": _named(graphs),
            },
            "inputs": _inputs(),
            **headers,
            "nodes": {
                "description": "Steps, each reading the one before it unless 'in' names others.",
                "type": "array",
                "minItems": 1,
                "items": _node(registry),
            },
            "outputs": _outputs(),
        },
    }


def _inputs() -> dict[str, Any]:
    return {
        "description": "Pictures that go in: a list of names (radiance), or names with what they measure.",
        "anyOf": [
            {"type": "array", "items": {"type": "string", "pattern": NAME}, "minItems": 1, "uniqueItems": True},
            {
                "type": "object",
                "minProperties": 1,
                "propertyNames": {"pattern": NAME},
                "additionalProperties": {"enum": _quantities()},
            },
        ],
    }


def _outputs() -> dict[str, Any]:
    suffixes = "|".join(suffix[1:] for suffix in FORMATS)
    return {
        "description": "Files and the nodes that they are made of; {node: NAME, ...} says also how a file is written.",
        "type": "object",
        "minProperties": 1,
        "propertyNames": {"pattern": rf"^[A-Za-z0-9][A-Za-z0-9._-]*\.({suffixes})$"},
        "patternProperties": {
            rf"\.{suffix[1:]}$": {"anyOf": [{"type": ["string", "null"]}, _output(options)]}
            for suffix, options in OPTIONS.items()
        },
    }


def _choices(option: Option) -> dict[str, Any]:
    if isinstance(option.choices, range):
        return {"type": "integer", "minimum": option.choices[0], "maximum": option.choices[-1]}
    return {"enum": list(option.choices)}


def _output(options: Mapping[str, Option]) -> dict[str, Any]:
    """An output with 'node' and options; a graph that extends another may leave 'node' out."""
    return {
        "type": "object",
        "minProperties": 1,
        "properties": {
            NODE: {"type": "string", "description": "The node that it is made of."},
            **{name: {**_choices(option), "description": option.help} for name, option in options.items()},
        },
        "additionalProperties": False,
    }


def _quantities() -> list[str | None]:
    return [*(quantity.value for quantity in Quantity), None]


def _named(names: Sequence[str]) -> list[dict[str, Any]]:
    return [{"enum": list(names)}, {"type": "string", "pattern": FILE}] if names else [{"type": "string"}]


def _node(registry: Registry) -> dict[str, Any]:
    ops = sorted(registry, key=lambda op: op.name)
    return {
        "type": "object",
        "anyOf": [{"required": ["op"]}, {"required": ["name"]}, {"required": ["include"]}],
        "properties": {
            "op": {
                "description": "What the node does.",
                "enum": [op.name for op in ops],
                "markdownEnumDescriptions": [op.summary for op in ops],
            },
            **_WORDS,
        },
        "allOf": [
            {
                "if": {"properties": {"op": {"const": op.name}}, "required": ["op"]},
                "then": {"properties": _properties(op), "additionalProperties": False},
            }
            for op in ops
        ],
    }


_WORDS: dict[str, Any] = {
    "name": {
        "type": "string",
        "pattern": NAME,
        "description": "What other nodes and the outputs call it; the verb of the op if left out.",
    },
    "in": {
        "description": "The node or input that it reads, or a list of them; the node before it if left out.",
        "type": ["string", "array"],
        "items": {"type": "string"},
    },
    "include": {"type": "string", "description": "A file with nodes that stand here."},
    "after": {
        "type": "string",
        "description": "In a graph that extends another: the node behind which this one stands.",
    },
    "before": {
        "type": "string",
        "description": "In a graph that extends another: the node before which this one stands.",
    },
    "remove": {"const": True, "description": "In a graph that extends another: takes the node away."},
}


def _properties(op: Op) -> dict[str, Any]:
    parameters = {parameter.name: _parameter(parameter) for parameter in op.parameters.values() if parameter.can_be_set}
    return {**dict.fromkeys(("op", "name", "in", "after", "before"), True), **parameters}


def _parameter(parameter: Parameter) -> dict[str, Any]:
    forms = _forms(parameter)
    if parameter.auto is not None:
        forms.append({"const": "auto", "description": "Found by the run."})
    if parameter.optional:
        forms.append({"type": "null"})
    entry: dict[str, Any] = {"description": " ".join(part for part in (parameter.help, f"Takes {parameter}.") if part)}
    if parameter.default is not MISSING and parameter.default is not None:
        entry["default"] = list(parameter.default) if isinstance(parameter.default, tuple) else parameter.default
    return entry | (forms[0] if len(forms) == 1 else {"anyOf": forms})


def _forms(parameter: Parameter) -> list[dict[str, Any]]:
    if parameter.kind == "choice":
        return [{"enum": list(parameter.choices)}]
    if parameter.kind == "switch":
        return [{"type": "boolean"}]
    if parameter.kind == "text":
        return [{"type": "string"}]
    number = {"type": "integer" if parameter.kind == "integer" else "number", **_limits(parameter)}
    written = {"type": "string", "pattern": f"^({NUMBER}|{FRACTION})$"}
    if parameter.kind == "numbers":
        length = {"minItems": parameter.length, "maxItems": parameter.length} if parameter.length else {"minItems": 1}
        return [{"type": "array", "items": {"anyOf": [number, written]}, **length}]
    return [number, written]


def _limits(parameter: Parameter) -> dict[str, float]:
    low, high = parameter.limits.low, parameter.limits.high
    limits = {} if low is None else {"exclusiveMinimum" if parameter.limits.above else "minimum": low}
    return limits if high is None else {**limits, "maximum": high}
