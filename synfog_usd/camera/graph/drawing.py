"""A graph for people: as a text table, and as Mermaid text.

Takes a graph and, where it has run, how long each node took.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping
from typing import Any

from synfog_usd.camera.graph.engine import AUTO, Bound, GraphRun, Node, NodeGraph
from synfog_usd.camera.graph.op import Port

MERMAID_WORDS = re.compile(
    "end|graph|flowchart|subgraph|style|class|classdef|click|default|linkstyle|direction|call|href"
)
"""Words of Mermaid that cannot be the name of a node."""

CHANGED = ("file", "override")
"""Sources of a parameter that a short table names; profiles and defaults would hide them."""

TIED = "\N{NO-BREAK SPACE}"
"""Between what must stand in one line."""


def table(
    graph: NodeGraph,
    run: GraphRun | None = None,
    settings: Mapping[str, Any] | None = None,
    *,
    width: int = 80,
    whole: bool = True,
) -> str:
    """The graph as plain text, node by node, with milliseconds if it ran.

    Behind a value stands where it is from: (sensor) and (lens), their profiles;
    (default), the op; (set), an override; (run), what `settings` say for an `auto`.
    What the file says stands alone.

    Args:
        graph: what is shown.
        run: its last run.
        settings: of that run, by name.
        width: of a line [characters].
        whole: with what each node reads and gives, and all parameters; else a line for each, with those that the file,
            an override or the run says.
    """
    heads = [("node", "op", "ms"), *((n.name, n.op.name, _time(n, run)) for n in graph.nodes.values())]
    columns = [max(map(len, column)) for column in zip(*heads, strict=True)][: 2 if run is None else 3]
    lines = []
    for head, node in zip(heads, [None, *graph.nodes.values()], strict=True):
        name, op, time = (cell.ljust(size) for cell, size in zip(head, (*columns, 0)[:3], strict=True))
        line = f"{name}  {op}" + (f"  {time.strip():>{columns[2]}}" if run is not None else "")
        parameters = _parameters(node, settings or {}, whole=whole) if node is not None else ""
        if whole or node is None:
            lines.append(line.rstrip()[:width])
        else:
            lines += _wrapped(parameters, width, first=f"{line}  ", indent=min(len(line) + 2, width // 2)) or [
                line.rstrip()
            ]
        if whole and node is not None:
            lines += _wrapped(f"{', '.join(node.inputs) or 'nothing'} -> {node.gives}", width)
            lines += _wrapped(parameters, width)
    lines.insert(1, "  ".join("-" * size for size in columns)[:width])
    for kind, profile in graph.profiles.items():
        lines += _wrapped(f"{kind}: {profile.name}", width, first="")
    for file_name, node_name in graph.outputs.items():
        options = ", ".join(f"{word}={value}" for word, value in graph.options_of(file_name).items())
        lines += _wrapped(f"writes {file_name} from {node_name}{f' ({options})' if options else ''}", width, first="")
    return "\n".join(lines)


def _parameters(node: Node, settings: Mapping[str, Any], *, whole: bool) -> str:
    return ", ".join(
        f"{key}={_sourced(bound, settings.get(node.op.parameters[key].auto_key)).replace(' (', f'{TIED}(')}"
        for key, bound in node.params.items()
        if node.op.parameters[key].can_be_set and (whole or bound.source in CHANGED or bound.is_auto)
    )


def _wrapped(text: str, width: int, *, first: str | None = None, indent: int = 4) -> list[str]:
    """Lines of at most `width` characters; all but the first, which begins with `first`, are indented."""
    before = " " * indent
    start = before if first is None else first
    lines = textwrap.wrap(text, width, initial_indent=start, subsequent_indent=before, break_on_hyphens=False)
    return [line.replace(TIED, " ") for line in lines]


def mermaid(graph: NodeGraph) -> str:
    """The graph as a Mermaid flow chart."""
    lines = ["flowchart TD"]
    lines += [f'  {_id(name)}(["{name}: {port}"])' for name, port in graph.inputs.items()]
    for node in graph.nodes.values():
        lines.append(f'  {_id(node.name)}["{node.name}<br/>{node.op.name}"]')
        lines += [
            f"  {_id(source)} -- {_flows(_port_of(graph, source))} --> {_id(node.name)}" for source in node.inputs
        ]
    for index, (file_name, node_name) in enumerate(graph.outputs.items()):
        lines.append(f"  {_id(node_name)} --> file{index}[/{file_name}/]")
    return "\n".join(lines)


def _time(node: Node, run: GraphRun | None) -> str:
    if run is None:
        return ""
    return f"{run.milliseconds[node.name]:.1f}" if node.name in run.milliseconds else ""


def _id(name: str) -> str:
    return f"{name}_" if MERMAID_WORDS.fullmatch(name) else name


def _port_of(graph: NodeGraph, name: str) -> Port:
    return graph.inputs[name] if name in graph.inputs else graph.nodes[name].gives


def _flows(port: Port) -> str:
    return port.quantity.value if port.quantity else "anything"


def _sourced(bound: Bound, looked_up: object) -> str:
    if bound.is_auto:
        return f"{looked_up:.4g} (run)" if isinstance(looked_up, float | int) else _shown(bound)
    word = {"file": "", "default": "default", "override": "set"}.get(bound.source, bound.source.partition(".")[0])
    return f"{_shown(bound)} ({word})" if word else _shown(bound)


def _shown(bound: Bound) -> str:
    value = bound.value
    if bound.is_auto:
        return AUTO
    if isinstance(value, tuple):
        return "[" + ", ".join(f"{item:g}" for item in value) + "]"
    return f"{value:g}" if isinstance(value, float) else str(value)
