"""A graph for people: as a text table, as Mermaid text, and as an SVG drawing.

Takes a graph and, where it has run, how long each node took.  The SVG is made for
a page: one row for each step, branches side by side, no script and no font of its
own.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from typing import Any

from synfog_usd.camera.graph.engine import AUTO, Bound, GraphRun, Node, NodeGraph
from synfog_usd.camera.graph.op import Port

MERMAID_WORDS = frozenset(
    {
        "end",
        "graph",
        "flowchart",
        "subgraph",
        "style",
        "class",
        "classdef",
        "click",
        "default",
        "linkstyle",
        "direction",
        "call",
        "href",
    }
)
"""Words of Mermaid that cannot be the name of a node."""

CHANGED = ("file", "override")
"""Sources of a parameter that the drawing names; profiles and defaults would hide them."""

BOX_W, BOX_H, GAP_X, GAP_Y, MARGIN = 250, 50, 150, 34, 24
LANE_W = 20
"""Width of an edge that passes a row [px]."""

CHAR_W = 0.62
"""Width of a character over its size; sans-serif letters are narrower on average, so that no label runs out of its
box.
"""

TIED = "\N{NO-BREAK SPACE}"
"""Between what must stand in one line."""

COLOURS = ("#3b6ea5", "#b5651d", "#4f8a5b", "#7a5195", "#8a8a3a", "#a8434b")


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


def mermaid(graph: NodeGraph, run: GraphRun | None = None) -> str:
    """The graph as a Mermaid flow chart, with milliseconds if it ran."""
    lines = ["flowchart TD"]
    lines += [f'  {_id(name)}(["{name}: {port}"])' for name, port in graph.inputs.items()]
    for node in graph.nodes.values():
        spent = _time(node, run)
        lines.append(
            f'  {_id(node.name)}["{node.name}<br/>{node.op.name}{f"<br/>{_with_unit(spent)}" if spent else ""}"]'
        )
        lines += [
            f"  {_id(source)} -- {_flows(_port_of(graph, source))} --> {_id(node.name)}" for source in node.inputs
        ]
    for index, (file_name, node_name) in enumerate(graph.outputs.items()):
        lines.append(f"  {_id(node_name)} --> file{index}[/{file_name}/]")
    return "\n".join(lines)


def svg(graph: NodeGraph, run: GraphRun | None = None) -> str:
    """The graph as an SVG drawing, with a bar and milliseconds for each node if it ran."""
    layout = _Layout(graph)
    spent = run.milliseconds if run is not None else {}
    longest, total = max(spent.values(), default=0.0), sum(spent.values())
    palette = {
        family: COLOURS[index % len(COLOURS)]
        for index, family in enumerate(dict.fromkeys(node.op.family for node in graph.nodes.values()))
    }
    title = graph.name + (f": {total:.0f} ms" if run is not None else "")
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{layout.width}" height="{layout.height}" viewBox="0 0 '
        f'{layout.width} {layout.height}" '
        'font-family="Helvetica, Arial, sans-serif" font-size="13">',
        f"<title>{escape(title)}</title>",
        f'<rect width="{layout.width}" height="{layout.height}" fill="#ffffff"/>',
        _text(MARGIN, MARGIN + 6, _cut(title, layout.width - 2 * MARGIN, 16), size=16, weight="bold"),
    ]
    labels: list[str] = []
    for path, label, x, y in layout.edges():
        parts.append(f'<path d="{path}" fill="none" stroke="#888888" stroke-width="1.5"/>')
        if label:
            labels.append(_text(x, y, label, size=11, fill="#666666", halo=True))
    parts += labels  # over all edges
    for name, port in graph.inputs.items():
        x, y = layout.corner(name)
        parts.append(
            f'<rect x="{x}" y="{y}" width="{BOX_W}" height="{BOX_H}" rx="{BOX_H // 2}" fill="#eeeeee" '
            f'stroke="#888888"/>'
        )
        parts.append(_text(x + 24, y + 21, _cut(name, BOX_W - 48), weight="bold"))
        parts.append(_text(x + 24, y + 39, str(port), size=11, fill="#666666"))
    for node in graph.nodes.values():
        share = spent[node.name] / longest if longest and node.name in spent else None
        parts += _box(layout, node, _with_unit(_time(node, run)), share, palette[node.op.family])
    for name, files in layout.files.items():
        x, y = layout.corner(name)
        for index, file_name in enumerate(files):
            across, down = x + BOX_W + 12, y + 18 + 17 * index
            parts.append(f'<path d="M {x + BOX_W} {down - 4} h 8" stroke="#888888" stroke-width="1.5"/>')
            parts.append(
                _text(
                    across, down, _cut(file_name, layout.file_width(name) - 16), size=12, fill="#000000", weight="bold"
                )
            )
    return "\n".join([*parts, "</svg>\n"])


def _box(layout: _Layout, node: Node, time: str, share: float | None, colour: str) -> list[str]:
    """A node, with a bar as long as its share of the longest time."""
    x, y = layout.corner(node.name)
    high = layout.height_of(node.name)
    parameters = ", ".join(f"{key}={_shown(bound)}" for key, bound in node.params.items() if bound.source in CHANGED)
    room = BOX_W - 26 - (len(time) + 1) * 12 * CHAR_W
    op = _cut(f"{node.op.name}  {parameters}".rstrip(), BOX_W - 22, 11)
    parts = [
        f"<g><title>{escape(f'{node.name}: {node.op.name} {parameters}')}</title>",
        f'<rect x="{x}" y="{y}" width="{BOX_W}" height="{high}" fill="#fafafa" stroke="#888888"/>',
        f'<rect x="{x}" y="{y}" width="6" height="{high}" fill="{colour}"/>',
    ]
    if share is not None:
        bar = f'width="{(BOX_W - 6) * share:.1f}" height="4" fill="{colour}"'
        parts.append(f'<rect x="{x + 6}" y="{y + high - 4}" {bar}/>')
    parts.append(_text(x + 14, y + 18, _cut(node.name, room), weight="bold"))
    parts.append(_text(x + 14, y + 36, op, size=11, fill="#444444"))
    if time:
        parts.append(_text(x + BOX_W - 8, y + 18, time, size=12, anchor="end"))
    return [*parts, "</g>"]


@dataclass(frozen=True)
class _Slot:
    """Where something stands: the middle of its top, and the height of its row [px]."""

    x: float
    y: float
    height: float


class _Layout:
    """Rows by the longest way from an input; what an edge passes on its way leaves a lane for it."""

    def __init__(self, graph: NodeGraph) -> None:
        self.graph = graph
        self.files: dict[str, list[str]] = {}
        for file_name, node_name in graph.outputs.items():
            self.files.setdefault(node_name, []).append(file_name)
        rank = dict.fromkeys(graph.inputs, 0)
        for node in graph.nodes.values():
            rank[node.name] = 1 + max((rank[source] for source in node.inputs), default=0)
        rows: list[list[str | tuple[str, str, int]]] = [[] for _ in range(max(rank.values()) + 1)]
        for name, row in rank.items():
            rows[row].append(name)
        for node in graph.nodes.values():
            for source in dict.fromkeys(node.inputs):
                for row in range(rank[source] + 1, rank[node.name]):
                    rows[row].append((source, node.name, row))
        self.rank = rank
        self.slots: dict[str | tuple[str, str, int], _Slot] = {}
        self.width, top = 2 * MARGIN + BOX_W, MARGIN + 30
        for row_of in rows:
            x, height = float(MARGIN), self.row_height(row_of)
            for item in row_of:
                wide = BOX_W if isinstance(item, str) else LANE_W
                self.slots[item] = _Slot(x + wide / 2, top, height)
                x += wide + (self.file_width(item) if isinstance(item, str) else 0)
                self.width = max(self.width, round(x + MARGIN))
                x += GAP_X if isinstance(item, str) else LANE_W
            top += round(height + GAP_Y)
        self.width += 110  # room for the label of the last column's edges
        self.height = top - GAP_Y + MARGIN

    def file_width(self, name: str) -> int:
        """Room right of a node for the names of its files [px]."""
        return max((16 + round(min(len(file), 40) * 12 * CHAR_W * 1.1) for file in self.files.get(name, ())), default=0)

    def row_height(self, row: list[str | tuple[str, str, int]]) -> float:
        return max(self.height_of(item) if isinstance(item, str) else 0 for item in row)

    def height_of(self, name: str) -> int:
        """Height of a box, beside which the names of its files stand [px]."""
        return max(BOX_H, 17 * len(self.files.get(name, ())) + 12)

    def corner(self, name: str) -> tuple[float, float]:
        """Left and top of a box [px]."""
        slot = self.slots[name]
        return slot.x - BOX_W / 2, slot.y

    def edges(self) -> list[tuple[str, str, float, float]]:
        """Path of every edge, with a label and where that stands [px]; a node that reads several images has one label
        for all.
        """
        paths = []
        for node in self.graph.nodes.values():
            sources = list(dict.fromkeys(node.inputs))
            step = min(40.0, (BOX_W - 40) / max(len(sources) - 1, 1))
            for place, source in enumerate(sources):
                x, y = self.slots[source].x, self.slots[source].y + self.slots[source].height
                path = f"M {x:g} {self.slots[source].y + self.height_of(source):g} V {y:g}"
                for row in range(self.rank[source] + 1, self.rank[node.name]):
                    lane = self.slots[source, node.name, row]
                    path += _curve(x, y, lane.x, lane.y) + f" V {lane.y + lane.height:g}"
                    x, y = lane.x, lane.y + lane.height
                end = self.slots[node.name]
                landing = end.x + (place - (len(sources) - 1) / 2) * step
                label = (
                    ", ".join(dict.fromkeys(_flows(_port_of(self.graph, item)) for item in sources))
                    if place == len(sources) - 1
                    else ""
                )
                paths.append((path + _curve(x, y, landing, end.y), label, landing + 6, end.y - 6))
        return paths


def _curve(x: float, y: float, to_x: float, to_y: float) -> str:
    middle = (y + to_y) / 2
    return f" L {to_x:g} {to_y:g}" if x == to_x else f" C {x:g} {middle:g} {to_x:g} {middle:g} {to_x:g} {to_y:g}"


def _text(
    x: float,
    y: float,
    text: str,
    *,
    size: int = 13,
    fill: str = "#222222",
    weight: str = "normal",
    anchor: str = "start",
    halo: bool = False,
) -> str:
    words = f'<text x="{x:g}" y="{y:g}" font-size="{size}" fill="{fill}" font-weight="{weight}" text-anchor="{anchor}"'
    around = f'{words} stroke="#ffffff" stroke-width="4" stroke-linejoin="round">{escape(text)}</text>' if halo else ""
    return f"{around}{words}>{escape(text)}</text>"


def _cut(text: str, room: float, size: int = 13) -> str:
    """The text, shortened to `room` pixels."""
    most = max(1, int(room / (size * CHAR_W)))
    return text if len(text) <= most else text[: most - 1] + "…"


def _time(node: Node, run: GraphRun | None) -> str:
    if run is None:
        return ""
    return (
        f"{run.milliseconds[node.name]:.1f}"
        if node.name in run.milliseconds
        else "cached"
        if node.name in run.cached
        else ""
    )


def _with_unit(time: str) -> str:
    return f"{time} ms" if time and time != "cached" else time


def _id(name: str) -> str:
    return f"{name}_" if name in MERMAID_WORDS else name


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
