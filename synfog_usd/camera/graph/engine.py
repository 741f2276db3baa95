"""The node graph, checked, and how it runs.

`NodeGraph.run` turns images into images.  Knows order, not physics: what the ops
do stands in the `Registry` that `load.load_graph` was given.
"""

from __future__ import annotations

import hashlib
import json
import re
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from synfog_usd.base import seeds
from synfog_usd.base.arrays import strips
from synfog_usd.base.errors import GraphError, ImageError, SynfogError, did_you_mean
from synfog_usd.base.image import Image, Quantity
from synfog_usd.base.version import __version__
from synfog_usd.base.yamlio import Place
from synfog_usd.camera.graph.compose import SCHEMA
from synfog_usd.camera.graph.op import MISSING, Op, Parameter, Port, Profile, Setting

AUTO = "auto"

_WITH_UNIT = re.compile(r"[+-]?[\d.]+(?:[eE][+-]?\d+)?\s*([^\d\s./*+-][^\d]*)")


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
        images: one per node that was asked for and kept, inputs left out.
        milliseconds: wall time per node.
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
        output_options: file name -> how it is written ({'compression': 'lossless'}),
            where the YAML says.
    """

    name: str
    inputs: Mapping[str, Port]
    nodes: Mapping[str, Node]
    outputs: Mapping[str, str]
    profiles: Mapping[str, Profile]
    output_options: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    @property
    def hash(self) -> str:
        """SHA-256 of all that decides the pictures: nodes, parameters, profiles, program version.

        Comments, file names and the order of independent nodes do not count.
        """
        hashed = {
            "schema": SCHEMA,
            "version": __version__,
            "inputs": {name: str(port) for name, port in self.inputs.items()},
            "nodes": {
                node.name: [node.op.name, list(node.inputs), {key: _plain(bound) for key, bound in node.params.items()}]
                for node in self.nodes.values()
            },
            "outputs": {name: [node, dict(self.options_of(name))] for name, node in self.outputs.items()},
            "profiles": {kind: profile.content_hash for kind, profile in self.profiles.items()},
        }
        return hashlib.sha256(json.dumps(hashed, sort_keys=True).encode()).hexdigest()

    @property
    def settings_needed(self) -> tuple[str, ...]:
        """Names that `auto` parameters without a default look up when the graph runs."""
        keys = {
            node.op.parameters[key].auto_key
            for node in self.nodes.values()
            for key, bound in node.params.items()
            if bound.is_auto and bound.value is MISSING
        }
        return tuple(sorted(keys))

    def nodes_with(self, op_name: str) -> tuple[Node, ...]:
        """The nodes that run one op, in order."""
        return tuple(node for node in self.nodes.values() if node.op.name == op_name)

    def with_overrides(self, overrides: Mapping[str, Any]) -> NodeGraph:
        """The graph with some parameters changed, checked as if the file had said so.

        Args:
            overrides: what -> value; text is read as the YAML would be.  What is
                'node.parameter' ('gain.iso'); or, for every node that it fits,
                'op.parameter' or 'family.parameter' ('sensor.iso'), or a value of a
                profile ('lens.f_number').

        Raises:
            GraphError: no such node or parameter, or a value that it does not take.
        """
        nodes = dict(self.nodes)
        for key, value in overrides.items():
            for node_name, parameter in self._overridden(key):
                node = nodes[node_name]
                bound = bind(f"override {key!r}: {node}", parameter, value, "override")
                nodes[node_name] = replace(node, params={**node.params, parameter.name: bound})
        for node in nodes.values():
            if fault := fault_of(node.op, node.params):
                raise GraphError(f"overrides {', '.join(overrides)}: {node}: {fault}")
        return replace(self, nodes=nodes)

    def _overridden(self, key: str) -> list[tuple[str, Parameter]]:
        where, _, name = key.rpartition(".")
        if where in self.nodes:
            return [(where, known_parameter(f"override {key!r}: {self.nodes[where]}", self.nodes[where].op, name))]
        settable = [
            (node, parameter)
            for node in self.nodes.values()
            for parameter in node.op.parameters.values()
            if parameter.can_be_set
        ]
        matches = [
            (node.name, parameter)
            for node, parameter in settable
            if (parameter.name == name and where in (node.op.name, node.op.family))
            or (parameter.profile is not None and parameter.profile.path == key)
        ]
        if not matches:
            names = [
                f"{place}.{parameter.name}" for node, parameter in settable for place in (node.name, node.op.family)
            ]
            raise GraphError(
                f"override {key!r}: no node {where or key!r}; write node.parameter.{did_you_mean(key, names)}"
            )
        return matches

    def without(self, names: Iterable[str]) -> NodeGraph:
        """The graph without some nodes: a node that read one of them reads its input instead.

        Raises:
            GraphError: no such node, one that changes what its image is, reads
                several images that are not data, or is an output.
        """
        graph = self
        for name in names:
            graph._check_node(name)
            node = graph.nodes[name]
            source = node.inputs[0]
            before, *rest = (
                graph.inputs[item] if item in graph.inputs else graph.nodes[item].gives for item in node.inputs
            )
            same_port = (before.quantity, before.layout) == (node.gives.quantity, node.gives.layout)
            lit = any(port.quantity is not Quantity.DATA for port in rest)
            if lit or not same_port or name in graph.outputs.values():
                raise GraphError(
                    f"{node.place}: {node} cannot be left out: it makes {node.gives} of {before}, reads several "
                    f"pictures, or is an output"
                )
            nodes = {
                port.name: replace(port, inputs=tuple(source if item == name else item for item in port.inputs))
                for port in graph.nodes.values()
                if port.name != name
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
    ) -> GraphRun:
        """Run the graph.

        Every node that draws has its own random stream, named by the node, so a
        node that is added or taken away moves no other.

        Args:
            images: one for each of `inputs` that is read.
            seed: of all random streams; the same seed gives the same bytes.
            settings: values for parameters that say `auto`, such as the exposure.
            overrides: see `with_overrides`.
            until: run only this node, or the node of this output, and what it reads.
            keep: nodes whose images are returned; all unless given.

        Returns:
            Images by node name, and milliseconds.

        Raises:
            GraphError: an image, node or setting is missing or does not fit.
            ImageError: an image holds what the ops cannot take.
        """
        graph = self.with_overrides(overrides) if overrides else self
        needed = graph._needed(until)
        for name in keep or ():
            graph._check_node(name)
        returned = needed if keep is None else keep
        have = graph._checked_inputs(images, needed)
        readers = {name: sum(name in graph.nodes[node].inputs for node in needed) for name in (*have, *needed)}
        milliseconds: dict[str, float] = {}
        done: dict[str, Image] = {}
        for name in needed:
            began = time.perf_counter()
            have[name] = graph._apply(graph.nodes[name], have, seed, settings or {})
            milliseconds[name] = (time.perf_counter() - began) * 1e3
            if name in returned:
                done[name] = have[name]
            for source in set(graph.nodes[name].inputs):
                readers[source] -= 1
                if readers[source] == 0:
                    del have[source]
        return GraphRun(done, milliseconds)

    def outputs_of(self, name: str) -> dict[str, str]:
        """The outputs that `name` means: a file ('raw.dng'), or all of that stem ('raw'); file name -> node."""
        return {file: node for file, node in self.outputs.items() if name in (file, file.rpartition(".")[0])}

    def options_of(self, file_name: str) -> Mapping[str, Any]:
        """How an output is written, as its writer wants it; empty where the graph does not say."""
        return self.output_options.get(file_name, {})

    def _check_node(self, name: str) -> None:
        if name not in self.nodes:
            raise GraphError(
                f"graph {self.name!r} has no node {name!r}; it has "
                f"{', '.join(self.nodes)}.{did_you_mean(name, self.nodes)}"
            )

    def _needed(self, until: str | None) -> list[str]:
        if until is None:
            return list(self.nodes)
        if until in self.nodes:
            return self._leading_to([until])
        if nodes := self.outputs_of(until).values():
            return self._leading_to(nodes)
        names = [*self.nodes, *self.outputs]
        raise GraphError(
            f"graph {self.name!r} has no node {until!r}; it has {', '.join(names)}.{did_you_mean(until, names)}"
        )

    def _leading_to(self, names: Iterable[str]) -> list[str]:
        """These nodes and all that they read, in order."""
        needed = set(names)
        for name in reversed(list(self.nodes)):
            if name in needed:
                needed.update(self.nodes[name].inputs)
        return [name for name in self.nodes if name in needed]

    def _checked_inputs(self, images: Mapping[str, Image], needed: Sequence[str]) -> dict[str, Image]:
        for name in images:
            if name not in self.inputs:
                raise GraphError(
                    f"graph {self.name!r} has no input {name!r}; it takes "
                    f"{', '.join(self.inputs)}.{did_you_mean(name, self.inputs)}"
                )
        have: dict[str, Image] = {}
        for name in sorted({source for node in needed for source in self.nodes[node].inputs if source in self.inputs}):
            if name not in images:
                raise GraphError(
                    f"graph {self.name!r} needs an image for its input {name!r}; it was given "
                    f"{', '.join(images) or 'none'}"
                )
            image = images[name]
            if not self.inputs[name].accepts(Port(image.quantity)):
                raise GraphError(
                    f"input {name!r} of graph {self.name!r} takes {self.inputs[name]}; the image holds "
                    f"{image.quantity.value}"
                )
            finite = (np.isfinite(image.pixels[rows]).all() for rows in strips(image.height_px))
            if image.quantity is not Quantity.DATA and not all(finite):
                row, column, channel = (int(index[0]) for index in np.nonzero(~np.isfinite(image.pixels)))
                raise ImageError(
                    f"input {name!r}: pixel x={column}, y={row} of channel {image.channels[channel]!r} is not a finite "
                    f"number"
                )
            have[name] = image.with_metadata(graph_name=self.name, graph_hash=self.hash)
        return have

    def _apply(self, node: Node, have: Mapping[str, Image], seed: int, settings: Mapping[str, Any]) -> Image:
        images = [have[source] for source in node.inputs]
        arguments: dict[str, Any] = {}
        for name, bound in node.params.items():
            arguments[name] = self._looked_up(node, name, bound, images[0], settings) if bound.is_auto else bound.value
        if node.op.draws:
            arguments["rng"] = seeds.stream(seed, "node", node.name)
        for index, image in enumerate(images):
            if not node.op.port(index).accepts(Port(image.quantity)):
                raise GraphError(
                    f"{node.place}: {node} takes {node.op.port(index)}; {node.inputs[index]!r} gave "
                    f"{image.quantity.value}"
                )
        try:
            result = node.op.function(*images, **arguments)
        except SynfogError as error:
            raise type(error)(f"{node.place}: {node}: {error}") from error
        expected = node.op.result(Port(images[0].quantity)).quantity
        if result.quantity is not expected:
            raise AssertionError(f"op {node.op.name} gave {result.quantity.value}, but is declared to give {expected}")
        return result

    def _looked_up(self, node: Node, name: str, bound: Bound, image: Image, settings: Mapping[str, Any]) -> Setting:
        parameter = node.op.parameters[name]
        key = parameter.auto_key
        for where, values in (("settings", settings), ("provenance", image.provenance)):
            if key in values:
                try:
                    return parameter.read(values[key])
                except ValueError as problem:
                    raise GraphError(
                        f"{node.place}: {node}: {key!r} in the {where} {problem}; it takes {parameter}"
                    ) from problem
        if bound.value is MISSING:
            hint = f", or {parameter.auto.hint}" if parameter.auto and parameter.auto.hint else ""
            raise GraphError(
                f"{node.place}: {node} has {name}: auto, but nothing says {key}: neither the settings of the run nor "
                f"the image. "
                f"Give {name} a number there, or with --set {node.name}.{name}=...{hint}"
            )
        return bound.value


def known_parameter(where: str, op: Op, name: str) -> Parameter:
    """The parameter of an op, or a GraphError that begins with `where`."""
    settable = [parameter for parameter in op.parameters.values() if parameter.can_be_set]
    for parameter in settable:
        if parameter.name == name:
            return parameter
    names = [parameter.name for parameter in settable]
    takes = f"it takes {', '.join(names)}" if names else "it takes none"
    raise GraphError(f"{where} has no parameter {name!r}; {takes}.{did_you_mean(name, names)}")


def fault_of(op: Op, params: Mapping[str, Bound]) -> str:
    """What is wrong with parameters together, or '' ; also where one of them is missing or left to the run."""
    if op.fault is None:
        return ""
    names = op.fault.__code__.co_varnames[: op.fault.__code__.co_argcount]
    if any(name not in params or params[name].is_auto for name in names):
        return ""
    return op.fault(*(params[name].value for name in names))


def bind(where: str, parameter: Parameter, value: object, source: str) -> Bound:
    """A parameter's value, checked, or a GraphError that begins with `where`."""
    if isinstance(value, str) and value == AUTO and parameter.auto is not None:
        return Bound(parameter.default, "auto")
    try:
        return Bound(parameter.read(value), source)
    except ValueError as problem:
        hint = did_you_mean(value, parameter.choices) if isinstance(value, str) else ""
        if parameter.kind in ("number", "integer") and isinstance(value, str) and _WITH_UNIT.fullmatch(value.strip()):
            hint = f" Write the number alone{f', in {parameter.unit}' if parameter.unit else ', without a unit'}"
        raise GraphError(f"{where}: {parameter.name} {problem}; it takes {parameter}.{hint}") from problem


def _plain(bound: Bound) -> Setting | list[Setting]:
    """A parameter's value as JSON holds it."""
    if bound.is_auto:
        return [AUTO, None if bound.value is MISSING else bound.value]
    return bound.value.content_hash if hasattr(bound.value, "content_hash") else bound.value
