"""Pages about ops, made from their signatures and docstrings."""

from __future__ import annotations

from synfog_usd.base.errors import GraphError, did_you_mean
from synfog_usd.base.image import Quantity
from synfog_usd.camera.graph.op import MISSING, Op, Parameter, Port, Registry

HEAD = """\
# Ops

Every step that a graph can name. This page is made from the functions themselves: `synfog-usd graph explain --all`.
What an op takes and gives is checked when a graph is loaded; a range that a value leaves is refused with its line.
"""


def page(registry: Registry, name: str) -> str:
    """The page of one op, as Markdown.

    Raises:
        GraphError: no such op.
    """
    op = registry.ops.get(name)
    if op is None:
        names = sorted(registry.ops)
        raise GraphError(f"no op {name!r}; there are {', '.join(names)}.{did_you_mean(name, names)}")
    return "\n".join(_lines(op))


def pages(registry: Registry) -> str:
    """One page with all ops: families as light meets them, each in the order of its declaration."""
    quantities = [None, *Quantity]
    first: dict[str, int] = {}
    for op in registry:
        first[op.family] = min(first.get(op.family, len(quantities)), quantities.index(op.takes[0].quantity))
    ordered = sorted(registry, key=lambda op: (first[op.family], op.family))
    contents = ["| op | takes | gives | does |", "|---|---|---|---|"]
    contents += [
        f"| [{op.name}](#{op.name.replace('.', '')}) | {_takes(op)} | {_gives(op)} | {op.summary} |" for op in ordered
    ]
    return "\n".join([HEAD, *contents, "", *("\n".join(_lines(op)) for op in ordered)])


def _lines(op: Op) -> list[str]:
    text = _without_arguments(op.doc)
    lines = [
        f"## {op.name}",
        "",
        *text,
        "",
        f"Takes {_takes(op)}; gives "
        f"{_gives(op)}.{' Draws random numbers from a stream named by the node.' if op.draws else ''}",
        "",
    ]
    rows = [parameter for parameter in op.parameters.values() if parameter.can_be_set]
    if rows:
        lines += ["| parameter | value | if left out | meaning |", "|---|---|---|---|"]
        lines += [f"| `{row.name}` | {_cell(str(row))} | {_default(row)} | {_cell(row.help)} |" for row in rows]
        lines.append("")
    needs = [
        parameter.name
        for parameter in op.parameters.values()
        if not parameter.can_be_set and parameter.default is MISSING
    ]
    if needs:
        lines += [f"Needs a {' and a '.join(needs)} profile at the top of the graph.", ""]
    return lines


def _takes(op: Op) -> str:
    several = " (any number of images)" if op.variadic else ""
    return ", ".join(map(str, op.takes)) + several


def _gives(op: Op) -> str:
    return "what it takes" if op.gives == Port() else str(op.gives)


def _default(parameter: Parameter) -> str:
    ways = []
    if parameter.profile is not None:
        ways.append(f"`{parameter.profile.path}` of the profile")
    if parameter.auto is not None:
        ways.append("auto")
    if parameter.default is not MISSING and parameter.default is not None:
        value = parameter.default
        ways.append(
            f"`{str(value).lower() if isinstance(value, bool) else f'{value:g}' if isinstance(value, float) else value}`"  # noqa: E501
        )
    return ", else ".join(ways) or ("nothing" if parameter.default is None else "needed")


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def _without_arguments(doc: str) -> list[str]:
    """The docstring without its 'Args:', which the table of parameters tells; headings of other sections in bold."""
    lines: list[str] = []
    inside = False
    for line in doc.splitlines():
        if line and not line.startswith(" "):
            inside = line == "Args:"
        if not inside:
            lines.append(
                f"**{line[:-1]}**"
                if line in ("Raises:", "Returns:")
                else f"- {line.strip()}"
                if line.startswith("    ") and ":" in line
                else line.strip()
            )
    while lines and not lines[-1]:
        lines.pop()
    return lines
