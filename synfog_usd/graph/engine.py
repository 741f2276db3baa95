"""The node graph: read from YAML, checked before anything runs, run, and shown.

`load_graph` turns a file into a `NodeGraph` or says where the file is wrong;
`NodeGraph.run` turns images into images.  Knows order, not physics: what the ops
do, and which ops there are, stands in the `Registry` that the caller gives.
"""

from __future__ import annotations

import hashlib
import json
import re
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from synfog_usd import __version__, seeds
from synfog_usd.errors import GraphError, ImageError, SynfogError, did_you_mean
from synfog_usd.graph import outputs as output_files
from synfog_usd.graph.op import MISSING, Op, Parameter, Port, Profile, Registry
from synfog_usd.image import Image, Quantity
from synfog_usd.progress import Progress, silent
from synfog_usd.yamlio import Located, Place, load_file

SCHEMA = "graph/1"
AUTO = "auto"

_NAME = re.compile(r"[a-z][a-z0-9_]*")


@dataclass(frozen=True)
class Bound:
    """A parameter's value and where it came from.

    Attributes:
        value: as the op's function wants it, or 'auto'.
        source: 'file', 'default', 'auto', 'override', or a profile's path such as
            'sensor.read_noise_e'.
    """

    value: Any
    source: str

    @property
    def is_auto(self) -> bool:
        """Whether the run decides."""
        return self.source == "auto"


@dataclass(frozen=True)
class Node:
    """One step of a graph.

    Attributes:
        name: unique in the graph.
        op: what it does.
        inputs: names of nodes or graph inputs, one per image.
        params: by name, every parameter of the op.
        place: where it stands in the file.
        gives: what comes out, as far as it is known before the run.
    """

    name: str
    op: Op
    inputs: tuple[str, ...]
    params: Mapping[str, Bound]
    place: Place
    gives: Port = field(default_factory=Port)

    def __str__(self) -> str:
        return f"node {self.name!r} ({self.op.name})"


@dataclass(frozen=True)
class GraphRun(Mapping[str, Image]):
    """What a run leaves: images by node name, and how long each node took.

    Attributes:
        images: one per node that ran and was kept, inputs left out.
        milliseconds: wall time per node that ran.
    """

    images: Mapping[str, Image]
    milliseconds: Mapping[str, float]

    def __getitem__(self, name: str) -> Image:
        return self.images[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.images)

    def __len__(self) -> int:
        return len(self.images)


@dataclass(frozen=True)
class NodeGraph:
    """A checked graph: everything that can be known before a run is right.

    Attributes:
        name: the file's stem.
        inputs: image inputs and what they must be.
        nodes: by name, each behind the nodes that it reads.
        outputs: file name -> node name, as the YAML says.
        profiles: kind ('sensor', 'lens') -> the profile that the header names.
    """

    name: str
    inputs: Mapping[str, Port]
    nodes: Mapping[str, Node]
    outputs: Mapping[str, str]
    profiles: Mapping[str, Profile]

    @property
    def hash(self) -> str:
        """SHA-256 of all that decides the pictures: nodes, parameters, profiles, program version.

        Comments, file names and the order of independent nodes do not count.
        """
        facts = {
            "schema": SCHEMA,
            "version": __version__,
            "inputs": {name: str(port) for name, port in self.inputs.items()},
            "nodes": {node.name: [node.op.name, list(node.inputs), {key: _plain(bound) for key, bound in node.params.items()}] for node in self.nodes.values()},
            "outputs": dict(self.outputs),
            "profiles": {kind: profile.content_hash for kind, profile in self.profiles.items()},
        }
        return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()

    @property
    def settings_needed(self) -> tuple[str, ...]:
        """Names that `auto` parameters without a default look up when the graph runs."""
        keys = {
            node.op.parameters[key].auto_key for node in self.nodes.values() for key, bound in node.params.items() if bound.is_auto and bound.value is MISSING
        }
        return tuple(sorted(keys))

    def nodes_with(self, op_name: str) -> tuple[Node, ...]:
        """The nodes that run one op, in order."""
        return tuple(node for node in self.nodes.values() if node.op.name == op_name)

    def with_overrides(self, overrides: Mapping[str, Any]) -> NodeGraph:
        """The graph with some parameters changed, checked as if the file had said so.

        Args:
            overrides: 'node.parameter' -> value; text is read as the YAML would be.

        Raises:
            GraphError: no such node or parameter, or a value that it does not take.
        """
        nodes = dict(self.nodes)
        for key, value in overrides.items():
            node_name, dot, parameter_name = key.partition(".")
            if not dot or node_name not in nodes:
                names = [f"{node.name}.{parameter}" for node in nodes.values() for parameter in node.op.parameters]
                raise GraphError(f"override {key!r}: no node {node_name!r}; write node.parameter.{did_you_mean(key, names)}")
            node = nodes[node_name]
            parameter = _known_parameter(f"override {key!r}: {node}", node.op, parameter_name)
            bound = _bind(f"override {key!r}: {node}", parameter, value, "override")
            nodes[node_name] = replace(node, params={**node.params, parameter_name: bound})
        return replace(self, nodes=nodes)

    def without(self, names: Iterable[str]) -> NodeGraph:
        """The graph with some nodes taken out; their readers read what they read.

        Raises:
            GraphError: no such node, one that changes what its image is, reads
                several images, or is an output.
        """
        graph = self
        for name in names:
            graph._check_node(name)
            node = graph.nodes[name]
            source = node.inputs[0]
            before = graph.inputs[source] if source in graph.inputs else graph.nodes[source].gives
            if len(node.inputs) > 1 or before != node.gives or name in graph.outputs.values():
                raise GraphError(f"{node.place}: {node} cannot be left out: it makes {node.gives} of {before}, reads several images, or is an output")
            nodes = {
                other.name: replace(other, inputs=tuple(source if item == name else item for item in other.inputs))
                for other in graph.nodes.values()
                if other.name != name
            }
            graph = replace(graph, nodes=nodes)
        return graph

    def run(
        self,
        images: Mapping[str, Image],
        *,
        seed: int,
        settings: Mapping[str, Any] | None = None,
        overrides: Mapping[str, Any] | None = None,
        until: str | None = None,
        keep: Sequence[str] | None = None,
        progress: Progress = silent,
    ) -> GraphRun:
        """Run the graph.

        Every node that draws has its own random stream, named by the node, so a
        node that is added or taken away moves no other.

        Args:
            images: one for each of `inputs` that is read.
            seed: of all random streams; the same seed gives the same bytes.
            settings: values for parameters that say `auto`, such as the exposure.
            overrides: see `with_overrides`.
            until: run only this node and what it reads.
            keep: nodes whose images are returned; all unless given.
            progress: told before each node.

        Returns:
            Images by node name, and milliseconds.

        Raises:
            GraphError: an image, node or setting is missing or does not fit.
            ImageError: an image holds what the ops cannot take.
        """
        graph = self.with_overrides(overrides) if overrides else self
        wanted = graph._needed(until)
        for name in keep or ():
            graph._check_node(name)
        have = graph._checked_inputs(images, wanted)
        readers = {name: sum(name in graph.nodes[node].inputs for node in wanted) for name in (*have, *wanted)}
        done: dict[str, Image] = {}
        milliseconds: dict[str, float] = {}
        for index, name in enumerate(wanted):
            node = graph.nodes[name]
            progress(name, index / len(wanted))
            sources = [have[source] for source in node.inputs]
            began = time.perf_counter()
            result = graph._apply(node, sources, seed, settings or {})
            milliseconds[name] = (time.perf_counter() - began) * 1e3
            have[name] = result
            if keep is None or name in keep:
                done[name] = result
            for source in node.inputs:
                readers[source] -= 1
                if readers[source] == 0:
                    del have[source]
        progress("done", 1.0)
        return GraphRun(done, milliseconds)

    def _check_node(self, name: str) -> None:
        if name not in self.nodes:
            raise GraphError(f"graph {self.name!r} has no node {name!r}; it has {', '.join(self.nodes)}.{did_you_mean(name, self.nodes)}")

    def _needed(self, until: str | None) -> list[str]:
        if until is None:
            return list(self.nodes)
        self._check_node(until)
        needed = {until}
        for name in reversed(list(self.nodes)):
            if name in needed:
                needed.update(self.nodes[name].inputs)
        return [name for name in self.nodes if name in needed]

    def _checked_inputs(self, images: Mapping[str, Image], wanted: Sequence[str]) -> dict[str, Image]:
        for name in images:
            if name not in self.inputs:
                raise GraphError(f"graph {self.name!r} has no input {name!r}; it takes {', '.join(self.inputs)}.{did_you_mean(name, self.inputs)}")
        have: dict[str, Image] = {}
        note = {"graph_name": self.name, "graph_hash": self.hash}
        for name in sorted({source for node in wanted for source in self.nodes[node].inputs if source in self.inputs}):
            if name not in images:
                raise GraphError(f"graph {self.name!r} needs an image for its input {name!r}; it was given {', '.join(images) or 'none'}")
            image = images[name]
            if not self.inputs[name].accepts(Port(image.quantity)):
                raise GraphError(f"input {name!r} of graph {self.name!r} takes {self.inputs[name]}; the image holds {image.quantity.value}")
            if not np.isfinite(image.pixels).all():
                row, column, channel = (int(index[0]) for index in np.nonzero(~np.isfinite(image.pixels)))
                raise ImageError(f"input {name!r}: pixel x={column}, y={row} of channel {image.channels[channel]!r} is not a finite number")
            have[name] = image.noted(**note)
        return have

    def _apply(self, node: Node, images: list[Image], seed: int, settings: Mapping[str, Any]) -> Image:
        arguments: dict[str, Any] = {}
        for name, bound in node.params.items():
            arguments[name] = self._looked_up(node, name, bound, images[0], settings) if bound.is_auto else bound.value
        if node.op.draws:
            arguments["rng"] = seeds.stream(seed, "node", node.name)
        for index, image in enumerate(images):
            if not node.op.port(index).accepts(Port(image.quantity)):
                raise GraphError(f"{node.place}: {node} takes {node.op.port(index)}; {node.inputs[index]!r} gave {image.quantity.value}")
        try:
            result = node.op.function(*images, **arguments)
        except SynfogError as error:
            raise type(error)(f"{node.place}: {node}: {error}") from error
        expected = node.op.result(Port(images[0].quantity)).quantity
        if result.quantity is not expected:
            raise AssertionError(f"op {node.op.name} gave {result.quantity.value}, but is declared to give {expected}")
        return result

    def _looked_up(self, node: Node, name: str, bound: Bound, image: Image, settings: Mapping[str, Any]) -> Any:
        parameter = node.op.parameters[name]
        key = parameter.auto_key
        for where, facts in (("settings", settings), ("provenance", image.provenance)):
            if key in facts:
                try:
                    return parameter.read(facts[key])
                except ValueError as problem:
                    raise GraphError(f"{node.place}: {node}: {key!r} in the {where} {problem}; it takes {parameter}") from problem
        if bound.value is MISSING:
            raise GraphError(
                f"{node.place}: {node} has {name}: auto, but neither the run's settings nor the image's provenance has {key!r}. "
                f"Give {name} a number, or run with settings={{{key!r}: ...}}"
            )
        return bound.value

    def rows(self, milliseconds: Mapping[str, float] | None = None) -> list[tuple[str, str, str, str, str, str]]:
        """One row per node: name, op, what it reads, what it gives, parameters, milliseconds."""
        rows = []
        for node in self.nodes.values():
            facts = ", ".join(f"{key}={_shown(bound)}" for key, bound in node.params.items() if node.op.parameters[key].kind != "profile")
            spent = f"{milliseconds[node.name]:.1f}" if milliseconds and node.name in milliseconds else ""
            rows.append((node.name, node.op.name, ", ".join(node.inputs), str(node.gives), facts, spent))
        return rows

    def table(self, milliseconds: Mapping[str, float] | None = None) -> str:
        """The graph as a plain text table."""
        head = ("node", "op", "reads", "gives", "parameters", "ms")
        rows = [head, *self.rows(milliseconds)]
        if not milliseconds:
            rows = [row[:-1] for row in rows]  # type: ignore[misc]
        widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
        lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
        lines.insert(1, "  ".join("-" * width for width in widths))
        lines += [f"{kind}: {profile.name}" for kind, profile in self.profiles.items()]
        lines += [f"writes {file_name} from {node}" for file_name, node in self.outputs.items()]
        return "\n".join(lines)

    def mermaid(self) -> str:
        """The graph as a Mermaid flow chart."""
        lines = ["flowchart LR"]
        lines += [f"  {name}([{name}: {port}])" for name, port in self.inputs.items()]
        for node in self.nodes.values():
            lines.append(f'  {node.name}["{node.name}<br/>{node.op.name}"]')
            lines += [f"  {source} -- {self._port_of(source)} --> {node.name}" for source in node.inputs]
        for index, (file_name, node_name) in enumerate(self.outputs.items()):
            lines.append(f"  {node_name} --> file{index}[/{file_name}/]")
        return "\n".join(lines)

    def _port_of(self, name: str) -> str:
        port = self.inputs[name] if name in self.inputs else self.nodes[name].gives
        return port.quantity.value if port.quantity else "anything"


def load_graph(path: Path, registry: Registry) -> NodeGraph:
    """Read a graph from a YAML file and check all of it.

    Args:
        path: the file; profile paths in it start from its folder.
        registry: the ops and profiles that it may name.

    Raises:
        GraphError: with file, line and column; what was found, what is allowed,
            and the likely fix.
    """
    return _Loader(load_file(path, error=GraphError), path, registry).load()


def _known_parameter(where: str, op: Op, name: str) -> Parameter:
    settable = [parameter for parameter in op.parameters.values() if parameter.kind != "profile"]
    for parameter in settable:
        if parameter.name == name:
            return parameter
    names = [parameter.name for parameter in settable]
    takes = f"it takes {', '.join(names)}" if names else "it takes none"
    raise GraphError(f"{where} has no parameter {name!r}; {takes}.{did_you_mean(name, names)}")


def _bind(where: str, parameter: Parameter, value: Any, source: str) -> Bound:
    if value == AUTO and parameter.auto is not None:
        return Bound(parameter.default, "auto")
    try:
        return Bound(parameter.read(value), source)
    except ValueError as problem:
        hint = did_you_mean(value, parameter.choices) if isinstance(value, str) else ""
        raise GraphError(f"{where}: {parameter.name} {problem}; it takes {parameter}.{hint}") from problem


def _plain(bound: Bound) -> Any:
    if bound.is_auto:
        return [AUTO, None if bound.value is MISSING else bound.value]
    return bound.value.content_hash if hasattr(bound.value, "content_hash") else bound.value


def _shown(bound: Bound) -> str:
    value = bound.value
    if bound.is_auto:
        return AUTO
    if isinstance(value, tuple):
        return "[" + ", ".join(f"{item:g}" for item in value) + "]"
    return f"{value:g}" if isinstance(value, float) else str(value)


class _Loader:
    def __init__(self, root: Located, path: Path, registry: Registry) -> None:
        self.root, self.path, self.registry = root, path, registry
        self.place: Place = root.place
        if not isinstance(root.value, dict):
            raise GraphError(f"{root.place}: a graph is a mapping that begins with 'synfog: {SCHEMA}'")
        self.top: dict[str, Located] = root.value

    def load(self) -> NodeGraph:
        self.check_header()
        inputs = self.read_inputs()
        profiles = self.read_profiles()
        nodes = self.connected(self.read_nodes(inputs, profiles), inputs)
        return NodeGraph(self.path.stem, inputs, nodes, self.read_outputs(nodes), profiles)

    def check_header(self) -> None:
        schema = self.top.get("synfog")
        if schema is None:
            raise GraphError(f"{self.root.place}: the first line must be 'synfog: {SCHEMA}'")
        if schema.value != SCHEMA:
            raise GraphError(f"{schema.place}: synfog is {schema.value!r}; this program reads {SCHEMA!r}")
        allowed = ["synfog", "title", "inputs", *self.registry.profiles, "nodes", "outputs"]
        for key, item in self.top.items():
            if key not in allowed:
                raise GraphError(f"{item.key_place}: a graph has no {key!r}; it takes {', '.join(allowed)}.{did_you_mean(key, allowed)}")
        title = self.top.get("title")
        if title is not None and not isinstance(title.value, str):
            raise GraphError(f"{title.place}: title is {title.plain()!r}; it takes a text")

    def section(self, key: str) -> Located:
        item = self.top.get(key)
        if item is None:
            raise GraphError(f"{self.root.place}: the graph has no {key!r}")
        return item

    def read_inputs(self) -> dict[str, Port]:
        item = self.section("inputs")
        words = {quantity.value: quantity for quantity in Quantity}
        found: dict[str, Port] = {}
        if isinstance(item.value, list) and item.value:
            entries = [(entry, entry.value, None) for entry in item.value]
        elif isinstance(item.value, dict) and item.value:
            entries = [(entry, key, entry.value) for key, entry in item.value.items()]
        else:
            raise GraphError(f"{item.place}: inputs is {item.plain()!r}; it takes a list of names, such as [radiance], or a mapping of names to quantities")
        for entry, name, word in entries:
            place = entry.key_place or entry.place
            if not isinstance(name, str) or not _NAME.fullmatch(name):
                raise GraphError(f"{place}: input {name!r} is not a name; use lower-case letters, digits and _")
            if name in found:
                raise GraphError(f"{place}: input {name!r} stands here twice")
            if word is not None and (not isinstance(word, str) or word not in words):
                raise GraphError(f"{entry.place}: input {name!r} is {entry.plain()!r}; it takes one of {', '.join(words)}.{did_you_mean(str(word), words)}")
            found[name] = Port(words[word] if word is not None else Quantity.RADIANCE)
        return found

    def read_profiles(self) -> dict[str, Profile]:
        found: dict[str, Profile] = {}
        for kind, loader in self.registry.profiles.items():
            item = self.top.get(kind)
            if item is None:
                continue
            if not isinstance(item.value, str):
                raise GraphError(f"{item.place}: {kind} is {item.plain()!r}; it takes the name of a profile, or a path that ends in .yaml")
            try:
                found[kind] = loader(item.value, self.path.parent)
            except SynfogError as error:
                raise type(error)(f"{item.place}: {kind} {item.value!r}: {error}") from error
        return found

    def read_nodes(self, inputs: Mapping[str, Port], profiles: Mapping[str, Profile]) -> list[Node]:
        item = self.section("nodes")
        if not isinstance(item.value, list) or not item.value:
            raise GraphError(f"{item.place}: nodes is {item.plain()!r}; it takes a list, each entry with an 'op'")
        nodes: list[Node] = []
        places: dict[str, Place] = {}
        previous = next(iter(inputs)) if len(inputs) == 1 else None
        self.in_places: dict[tuple[str, int], Place] = {}
        for number, entry in enumerate(item.value, start=1):
            node = self.read_node(number, entry, previous, profiles)
            if node.name in places:
                raise GraphError(f"{node.place}: node {node.name!r} stands already at line {places[node.name].line}; give one of them another name")
            if node.name in inputs:
                raise GraphError(f"{node.place}: node {node.name!r} has the name of an input; give it another name")
            places[node.name] = node.place
            nodes.append(node)
            previous = node.name
        return nodes

    def read_node(self, number: int, entry: Located, previous: str | None, profiles: Mapping[str, Profile]) -> Node:
        if not isinstance(entry.value, dict):
            raise GraphError(f"{entry.place}: node {number} is {entry.plain()!r}; it takes a mapping with an 'op'")
        fields: dict[str, Located] = entry.value
        op_item = fields.get("op")
        if op_item is None:
            raise GraphError(f"{entry.place}: node {number} has no 'op'")
        op = self.registry.ops.get(op_item.value) if isinstance(op_item.value, str) else None
        if op is None:
            known = sorted(self.registry.ops)
            raise GraphError(f"{op_item.place}: no op {op_item.plain()!r}; there are {', '.join(known)}.{did_you_mean(str(op_item.value), known)}")
        name_item = fields.get("name")
        name = op.name.rpartition(".")[2] if name_item is None else name_item.value
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            raise GraphError(f"{(name_item or entry).place}: node name {name!r} is not a name; use lower-case letters, digits and _")
        sources = self.read_sources(name, op, entry, previous)
        given = {key: value for key, value in fields.items() if key not in ("name", "op", "in")}
        params = self.read_params(f"node {name!r} ({op.name})", op, entry, given, profiles)
        return Node(name, op, sources, params, entry.place)

    def read_sources(self, name: str, op: Op, entry: Located, previous: str | None) -> tuple[str, ...]:
        item = entry.value.get("in")
        where = f"node {name!r} ({op.name})"
        if item is None:
            if previous is None:
                raise GraphError(f"{entry.place}: {where} has no 'in', and the graph has several inputs to choose from")
            sources: list[str] = [previous]
            self.in_places[name, 0] = entry.place
        else:
            entries = item.value if isinstance(item.value, list) else [item]
            for index, source in enumerate(entries):
                if not isinstance(source.value, str):
                    raise GraphError(f"{source.place}: {where} has in: {source.plain()!r}; it takes the name of a node or input")
                self.in_places[name, index] = source.place
            sources = [source.value for source in entries]
        if not sources or (not op.variadic and len(sources) != len(op.takes)):
            wants = "at least 1 image" if op.variadic else f"{len(op.takes)} image{'s' if len(op.takes) > 1 else ''}"
            raise GraphError(f"{(item or entry).place}: {where} reads {wants}; 'in' names {len(sources)}")
        return tuple(sources)

    def read_params(self, where: str, op: Op, entry: Located, given: Mapping[str, Located], profiles: Mapping[str, Profile]) -> dict[str, Bound]:
        for key, item in given.items():
            _known_parameter(f"{item.key_place}: {where}", op, key)
        params: dict[str, Bound] = {}
        for parameter in op.parameters.values():
            item = given.get(parameter.name)  # type: ignore[assignment]
            if item is not None:
                params[parameter.name] = _bind(f"{item.place}: {where}", parameter, item.plain(), "file")
            elif parameter.profile is not None:
                params[parameter.name] = self.from_profile(f"{entry.place}: {where}", parameter, profiles)
            elif parameter.auto is not None:
                params[parameter.name] = Bound(parameter.default, "auto")
            elif parameter.default is not MISSING:
                params[parameter.name] = Bound(parameter.default, "default")
            else:
                raise GraphError(f"{entry.place}: {where} needs {parameter.name}: {parameter}")
        return params

    def from_profile(self, where: str, parameter: Parameter, profiles: Mapping[str, Profile]) -> Bound:
        source = parameter.profile
        assert source is not None
        if source.kind not in profiles:
            if parameter.default is not MISSING:
                return Bound(parameter.default, "default")
            own = "" if parameter.kind == "profile" else f", or give {parameter.name} here"
            raise GraphError(f"{where} takes {parameter.name} from the {source.kind} profile; name one at the top with '{source.kind}: ...'{own}")
        value: Any = profiles[source.kind]
        for part in source.path.split(".")[1:]:
            value = getattr(value, part)
        return Bound(value, source.path)

    def connected(self, nodes: list[Node], inputs: Mapping[str, Port]) -> dict[str, Node]:
        by_name = {node.name: node for node in nodes}
        for node in nodes:
            for index, source in enumerate(node.inputs):
                if source not in by_name and source not in inputs:
                    known = [*inputs, *by_name]
                    raise GraphError(f"{self.in_places[node.name, index]}: {node} reads {source!r}, which is no node or input.{did_you_mean(source, known)}")
        ordered: dict[str, Node] = {}
        waiting = list(nodes)
        while waiting:
            ready = [node for node in waiting if all(source in inputs or source in ordered for source in node.inputs)]
            if not ready:
                raise GraphError(self.cycle(waiting))
            for node in ready:
                ordered[node.name] = self.typed(node, ordered, inputs)
            waiting = [node for node in waiting if node.name not in ordered]
        return ordered

    def cycle(self, waiting: list[Node]) -> str:
        stuck = {node.name: node for node in waiting}
        path = [waiting[0].name]
        while True:
            following = next(source for source in stuck[path[-1]].inputs if source in stuck)
            if following in path:
                loop = path[path.index(following) :]
                loop = [following, *reversed(loop)]
                return f"{stuck[following].place}: nodes read each other in a circle: {' -> '.join(loop)}; change one 'in'"
            path.append(following)

    def typed(self, node: Node, ordered: Mapping[str, Node], inputs: Mapping[str, Port]) -> Node:
        arriving = [inputs[source] if source in inputs else ordered[source].gives for source in node.inputs]
        for index, port in enumerate(arriving):
            wanted = node.op.port(index)
            if not wanted.accepts(port):
                raise GraphError(f"{self.in_places[node.name, index]}: {node} takes {wanted}; {node.inputs[index]!r} gives {port}. {self.advice(wanted)}")
        return replace(node, gives=node.op.result(arriving[0]))

    def advice(self, wanted: Port) -> str:
        makers = sorted(op.name for op in self.registry if op.gives.quantity is wanted.quantity and op.gives.quantity is not None and wanted.accepts(op.gives))
        return f"What gives {wanted}: {', '.join(makers)}" if makers else f"Name a node that gives {wanted} in 'in'"

    def read_outputs(self, nodes: Mapping[str, Node]) -> dict[str, str]:
        item = self.section("outputs")
        if not isinstance(item.value, dict) or not item.value:
            raise GraphError(f"{item.place}: outputs is {item.plain()!r}; it takes a mapping of file names to nodes, such as srgb.png: gamma")
        found: dict[str, str] = {}
        for file_name, entry in item.value.items():
            fault = output_files.fault(file_name)
            if not fault and file_name.lower() in (name.lower() for name in found):
                fault = "some systems cannot tell it from another output's name"
            if fault:
                raise GraphError(f"{entry.key_place}: output {file_name!r}: {fault}")
            if entry.value not in nodes if isinstance(entry.value, str) else True:
                raise GraphError(
                    f"{entry.place}: output {file_name!r} is {entry.plain()!r}, which is no node; "
                    f"there are {', '.join(nodes)}.{did_you_mean(str(entry.value), nodes)}"
                )
            wanted = output_files.FORMATS[output_files.suffix_of(file_name)]
            gives = nodes[entry.value].gives
            if not wanted.accepts(gives):
                fitting = [name for name, node in nodes.items() if node.gives.quantity and wanted.accepts(node.gives)]
                hint = f"; what fits: {', '.join(fitting)}" if fitting else ""
                raise GraphError(f"{entry.place}: output {file_name!r} takes {wanted}; node {entry.value!r} gives {gives}{hint}")
            found[file_name] = entry.value
        return found
