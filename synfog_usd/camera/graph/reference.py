"""Pages about ops, made from their signatures and docstrings."""

from __future__ import annotations

from synfog_usd.base.errors import GraphError, did_you_mean
from synfog_usd.camera.graph.op import MISSING, Op, Parameter, Port, Registry


def page(registry: Registry, name: str) -> str:
    """The page of one op, as Markdown.

    Raises:
        GraphError: no such op.
    """
    op = registry.ops.get(name)
    if op is None:
        names = sorted(registry.ops)
        raise GraphError(f"no op {name!r}; there are {', '.join(names)}.{did_you_mean(name, names)}")
    return "\n".join(section(op))


def section(op: Op) -> list[str]:
    """Lines of an op's page, in Markdown."""
    text = _without_arguments(op.doc)
    lines = [
        f"## {op.name}",
        "",
        *text,
        "",
        f"Takes {takes(op)}; gives "
        f"{gives(op)}.{' Draws random numbers from a stream named by the node.' if op.draws else ''}",
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


def takes(op: Op) -> str:
    """What it reads, in words."""
    several = " (any number of images)" if op.variadic else ""
    return ", ".join(map(str, op.takes)) + several


def gives(op: Op) -> str:
    """What comes out, in words."""
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
