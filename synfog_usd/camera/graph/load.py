"""From YAML, or the same words in Python, to a checked `NodeGraph`.

Everything that is wrong is reported together, each fault with its place; what follows
from a fault that is reported already is not.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from synfog_usd.base.errors import GraphError, SynfogError, did_you_mean
from synfog_usd.base.image import Quantity
from synfog_usd.base.yamlio import Located, Place, from_python, load_file
from synfog_usd.camera.graph import outputs as output_files
from synfog_usd.camera.graph.compose import composed, node_name
from synfog_usd.camera.graph.engine import Bound, Node, NodeGraph, bind, fault_of, known_parameter
from synfog_usd.camera.graph.faults import Faults
from synfog_usd.camera.graph.op import MISSING, Op, Parameter, Port, Profile, Registry

UNSURE = ""
"""Stands for a node with a fault that is reported already."""

_NAME = re.compile(r"[a-z][a-z0-9_]*")


def load_graph(path: Path, registry: Registry) -> NodeGraph:
    """Read a graph from a YAML file and check all of it.

    Args:
        path: the file; the paths in it start from its folder.
        registry: the ops and profiles that it may name.

    Raises:
        GraphError: with file, line and column of everything that is wrong; what was
            found, what is allowed, and the likely fix.
    """
    return _Loader(load_file(path, error=GraphError), path.stem, path.parent, registry).load()


def make_graph(
    registry: Registry,
    *,
    nodes: Sequence[Mapping[str, Any]] = (),
    outputs: Mapping[str, str | Mapping[str, Any] | None] | None = None,
    inputs: Sequence[str] | Mapping[str, str] | None = None,
    name: str = "graph",
    folder: Path = Path(),
    **header: str,
) -> NodeGraph:
    """A graph from Python: the words of the YAML, the same checks, the same bytes.

    Args:
        registry: the ops and profiles that it may name.
        nodes: one mapping per node, such as {'op': 'isp.tone', 'shoulder': 0.3}.
        outputs: file name -> node name, or a mapping with 'node' and how it is written:
            {'raw.dng': {'node': 'adc', 'compression': 'lossless'}}.  A graph that extends
            another may leave nodes, outputs and inputs to it.
        inputs: names of radiance images, or names with quantities; ('radiance',) unless
            given here or by the graph that is extended.
        name: what errors call the graph.
        folder: where paths in it start from.
        header: what else stands at the top: extends='phone', sensor='imx363' ...

    Raises:
        GraphError: as `load_graph`, with the place as in 'nodes[3].shoulder'.

    >>> ops = Registry()
    >>> make_graph(ops, nodes=[{"op": "lens.blur"}], outputs={})
    Traceback (most recent call last):
    ...
    synfog_usd.base.errors.GraphError: graph: 2 errors
    nodes[0].op: no op 'lens.blur'; there are none
    outputs: outputs is {}; it takes a mapping of file names to nodes, such as srgb.png: gamma
    """
    alone = "extends" not in header
    sections = {"inputs": inputs or (("radiance",) if alone else None), "nodes": nodes, "outputs": outputs}
    plain = {
        "synfog": "graph/1",
        **header,
        **{key: value for key, value in sections.items() if value or (alone and value is not None)},
    }
    return _Loader(from_python(plain, name=name), name, folder, registry).load()


@dataclass
class _Draft:
    """A node of which not everything need be right."""

    name: str
    op: Op | None
    place: Place
    sources: list[tuple[str, Place]] = field(default_factory=list)
    params: dict[str, Bound] = field(default_factory=dict)
    wrong: bool = False

    def __str__(self) -> str:
        return f"node {self.name!r} ({self.op.name})" if self.op else f"node {self.name!r}"

    def result(self, arriving: Sequence[Port]) -> Port:
        return self.op.result(arriving[0] if arriving else Port()) if self.op and not self.wrong else Port()


class _Loader:
    def __init__(self, root: Located, name: str, folder: Path, registry: Registry) -> None:
        self.root, self.name, self.folder, self.registry = root, name, folder, registry
        self.faults = Faults(root.place.file)
        self.top = composed(root, folder, self.faults)
        self.unsure: set[str] = set()
        """Sections and kinds of profile that are wrong themselves: what is missing for lack of them is no fault of its
        own.
        """

    def load(self) -> NodeGraph:
        self.check_header()
        inputs = self.read_inputs()
        profiles = self.read_profiles()
        drafts = self.read_nodes(inputs, profiles)
        gives = self.connected(drafts, inputs)
        outputs, options = self.read_outputs(gives)
        self.faults.check()
        by_name = {draft.name: draft for draft in drafts}
        nodes = {}
        for name, port in gives.items():
            draft = by_name[name]
            assert draft.op is not None
            nodes[name] = Node(
                name, draft.op, tuple(source for source, _ in draft.sources), draft.params, draft.place, port
            )
        return NodeGraph(self.name, inputs, nodes, outputs, profiles, options)

    def check_header(self) -> None:
        allowed = ["synfog", "title", "extends", "inputs", *self.registry.profiles, "nodes", "outputs"]
        for key, item in self.top.items():
            if key not in allowed:
                hint = did_you_mean(key, allowed)
                self.unsure |= {word for word in allowed if repr(word) in hint}
                self.faults.add(
                    item.key_place or item.place, f"a graph has no {key!r}; it takes {', '.join(allowed)}.{hint}"
                )
        title = self.top.get("title")
        if title is not None and not isinstance(title.value, str):
            self.faults.add(title.place, f"title is {title.plain()!r}; it takes a text")

    def section(self, key: str, kinds: type | tuple[type, ...], takes: str) -> Located | None:
        """A part of the file that must be there and hold something; None, with a fault added, where it does not."""
        item = self.top.get(key)
        if item is None:
            if key not in self.unsure:
                self.faults.add(self.root.place, f"the graph has no {key!r}")
        elif not isinstance(item.value, kinds) or not item.value:
            self.faults.add(item.place, f"{key} is {item.plain()!r}; it takes {takes}")
        else:
            return item
        self.unsure.add(key)
        return None

    def read_inputs(self) -> dict[str, Port]:
        item = self.section(
            "inputs", (list, dict), "a list of names, such as [radiance], or a mapping of names to quantities"
        )
        if item is None:
            return {}
        words = {quantity.value: quantity for quantity in Quantity}
        ports: dict[str, Port] = {}
        entries: Iterable[tuple[Located, Any, Any]]
        if isinstance(item.value, list):
            entries = [(entry, entry.value, None) for entry in item.value]
        else:
            entries = [(entry, key, entry.value) for key, entry in item.value.items()]
        for entry, name, word in entries:
            place = (entry.key_place if isinstance(item.value, dict) else None) or entry.place
            if not isinstance(name, str) or not _NAME.fullmatch(name):
                self.faults.add(
                    place,
                    f"input {entry.plain() if name is entry.value else name!r} is not a name; use lower-case letters, "
                    f"digits and _",
                )
                self.unsure.add("inputs")
                continue
            if name in ports:
                self.faults.add(place, f"input {name!r} stands here twice")
            if word is not None and (not isinstance(word, str) or word not in words):
                self.faults.add(
                    entry.place,
                    f"input {name!r} is {entry.plain()!r}; it takes one of "
                    f"{', '.join(words)}.{did_you_mean(str(word), words)}",
                )
                ports[name] = Port()
            else:
                ports[name] = Port(words[word] if word is not None else Quantity.RADIANCE)
        return ports

    def read_profiles(self) -> dict[str, Profile]:
        profiles: dict[str, Profile] = {}
        for kind, loader in self.registry.profiles.items():
            item = self.top.get(kind)
            if item is None:
                continue
            self.unsure.add(kind)
            if not isinstance(item.value, str):
                self.faults.add(
                    item.place,
                    f"{kind} is {item.plain()!r}; it takes the name of a profile, or a path that ends in .yaml",
                )
                continue
            try:
                folder = self.folder if item.place.file == self.root.place.file else Path(item.place.file).parent
                profiles[kind] = loader(item.value, folder)
            except SynfogError as error:
                self.faults.take(item.place, type(error)(f"{item.place}: {kind} {item.value!r}: {error}"))
            else:
                self.unsure.discard(kind)
        return profiles

    def read_nodes(self, inputs: Mapping[str, Port], profiles: Mapping[str, Profile]) -> list[_Draft]:
        item = self.section("nodes", list, "a list, each entry with an 'op'")
        drafts: dict[str, _Draft] = {}
        pictures = [name for name, port in inputs.items() if port.quantity is not Quantity.DATA] or list(inputs)
        previous = pictures[0] if len(pictures) == 1 else None
        for number, entry in enumerate(item.value if item else (), start=1):
            draft = self.read_node(number, entry, previous, profiles)
            previous = draft.name
            if draft.name in drafts or draft.name in inputs:
                previous = UNSURE
            if draft.name in drafts:
                first = drafts[draft.name].place
                where = f"line {first.line}" if type(first) is Place and first.file == draft.place.file else str(first)
                self.faults.add(
                    draft.place, f"node {draft.name!r} stands already at {where}; give one of them another name"
                )
            elif draft.name in inputs:
                self.faults.add(draft.place, f"node {draft.name!r} has the name of an input; give it another name")
            else:
                drafts[draft.name] = draft
        return list(drafts.values())

    def read_node(self, number: int, entry: Located, previous: str | None, profiles: Mapping[str, Profile]) -> _Draft:
        nameless = _Draft(f"node {number}", None, entry.place)
        if not isinstance(entry.value, dict):
            self.faults.add(entry.place, f"node {number} is {entry.plain()!r}; it takes a mapping with an 'op'")
            return nameless
        fields: dict[str, Located] = entry.value
        name = node_name(fields) or nameless.name
        op_item = fields.get("op")
        op = self.registry.ops.get(op_item.value) if op_item is not None and isinstance(op_item.value, str) else None
        if op_item is None:
            self.faults.add(entry.place, f"node {number} has no 'op'")
        elif op is None:
            known_ops = sorted(self.registry.ops)
            there = f"there are {', '.join(known_ops) or 'none'}"
            self.faults.add(
                op_item.place,
                f"no op {op_item.plain()!r}; {there}{'.' if known_ops else ''}"
                f"{did_you_mean(str(op_item.plain()), known_ops)}",
            )
        name_item = fields.get("name")
        if (name_item is not None or op is not None) and not (isinstance(name, str) and _NAME.fullmatch(name)):
            place = name_item.place if name_item is not None else entry.place
            op_name = name_item.plain() if name_item is not None else name
            self.faults.add(place, f"node name {op_name!r} is not a name; use lower-case letters, digits and _")
        elif name_item is not None and not isinstance(name_item.value, str):
            self.faults.add(
                name_item.place, f"node name {name_item.plain()!r} is not a name; use lower-case letters, digits and _"
            )
        draft = _Draft(name, op, entry.place)
        draft.sources = self.read_sources(draft, fields.get("in"), previous)
        if op is not None:
            values = {key: value for key, value in fields.items() if key not in ("name", "op", "in")}
            draft.params = self.read_params(str(draft), op, entry.place, values, profiles)
            if fault := fault_of(op, draft.params):
                place = next((item.place for item in values.values()), entry.place)
                self.faults.add(place, f"{draft}: {fault}")
        return draft

    def read_sources(self, draft: _Draft, item: Located | None, previous: str | None) -> list[tuple[str, Place]]:
        if item is None:
            if previous is None and "inputs" not in self.unsure:
                self.faults.add(draft.place, f"{draft} has no 'in', and the graph has several inputs to choose from")
            sources = [(previous, draft.place)] if previous else []
            count = 1
        else:
            entries = item.value if isinstance(item.value, list) else [item]
            for entry in entries:
                if not isinstance(entry.value, str):
                    self.faults.add(
                        entry.place, f"{draft} has in: {entry.plain()!r}; it takes the name of a node or input"
                    )
            sources = [(entry.value, entry.place) for entry in entries if isinstance(entry.value, str)]
            count = len(entries)
        op = draft.op
        if op is not None and (not count or (not op.variadic and count != len(op.takes))):
            kinds = f"{len(op.takes)} images ({', '.join(map(str, op.takes))})" if len(op.takes) > 1 else "1 image"
            wants = "at least 1 image" if op.variadic else kinds
            self.faults.add(item.place if item else draft.place, f"{draft} reads {wants}; 'in' names {count}")
            draft.wrong = True
            return []
        return sources

    def read_params(
        self, where: str, op: Op, place: Place, values: Mapping[str, Located], profiles: Mapping[str, Profile]
    ) -> dict[str, Bound]:
        for key, item in values.items():
            try:
                known_parameter(f"{item.key_place}: {where}", op, key)
            except GraphError as error:
                self.faults.take(item.key_place or item.place, error)
        misspelt = any(key not in op.parameters for key in values)
        params: dict[str, Bound] = {}
        for parameter in op.parameters.values():
            item = values.get(parameter.name) if parameter.can_be_set else None  # type: ignore[assignment]
            try:
                if item is not None:
                    params[parameter.name] = bind(f"{item.place}: {where}", parameter, item.plain(), "file")
                elif parameter.profile is not None:
                    params[parameter.name] = self.from_profile(f"{place}: {where}", parameter, profiles)
                elif parameter.auto is not None:
                    params[parameter.name] = Bound(parameter.default, "auto")
                elif parameter.default is not MISSING:
                    params[parameter.name] = Bound(parameter.default, "default")
                elif not misspelt:
                    self.faults.add(place, f"{where} needs {parameter.name}: {parameter}")
            except _UnsureError:
                continue
            except GraphError as error:
                self.faults.take(place if item is None else item.place, error)
        return params

    def from_profile(self, where: str, parameter: Parameter, profiles: Mapping[str, Profile]) -> Bound:
        source = parameter.profile
        assert source is not None
        if source.kind not in profiles:
            if parameter.default is not MISSING:
                return Bound(parameter.default, "default")
            if source.kind in self.unsure:
                raise _UnsureError
            advice = f", or give {parameter.name} here" if parameter.can_be_set else ""
            raise GraphError(
                f"{where} takes {parameter.name} from the {source.kind} profile; name one at the top with "
                f"'{source.kind}: ...'{advice}"
            )
        value: Any = profiles[source.kind]
        for part in source.path.split(".")[1:]:
            value = getattr(value, part)
        return Bound(value, source.path)

    def connected(self, drafts: Sequence[_Draft], inputs: Mapping[str, Port]) -> dict[str, Port]:
        """What every node gives, each behind the nodes that it reads."""
        names = {draft.name for draft in drafts}
        for draft in drafts:
            for source, place in draft.sources:
                if source not in names and source not in inputs and "inputs" not in self.unsure:
                    self.faults.add(
                        place,
                        f"{draft} reads {source!r}, which is no node or "
                        f"input.{did_you_mean(source, [*inputs, *(item.name for item in drafts)])}",
                    )
        gives: dict[str, Port] = {}
        waiting = list(drafts)
        while waiting:
            ready = [
                draft for draft in waiting if all(source in gives or source not in names for source, _ in draft.sources)
            ]
            if not ready:
                loop = self.circle(waiting)
                gives |= {draft.name: draft.result([]) for draft in loop}
            for draft in ready:
                gives[draft.name] = self.typed(
                    draft, [gives.get(source) or inputs.get(source) or Port() for source, _ in draft.sources]
                )
            waiting = [draft for draft in waiting if draft.name not in gives]
        return gives

    def circle(self, waiting: Sequence[_Draft]) -> list[_Draft]:
        """Tells of one circle among nodes that all wait for each other, and gives its nodes."""
        stuck = {draft.name: draft for draft in waiting}
        path = [waiting[0].name]
        while True:
            following = next(source for source, _ in stuck[path[-1]].sources if source in stuck)
            if following in path:
                loop = path[path.index(following) :]
                names = [following, *reversed(loop)]
                self.faults.add(
                    stuck[following].place, f"nodes read each other in a circle: {' -> '.join(names)}; change one 'in'"
                )
                return [stuck[name] for name in loop]
            path.append(following)

    def typed(self, draft: _Draft, arriving: Sequence[Port]) -> Port:
        for index, (port, (source, place)) in enumerate(zip(arriving, draft.sources, strict=True)):
            needed = draft.op.port(index) if draft.op else Port()
            if not needed.accepts(port):
                self.faults.add(place, f"{draft} takes {needed}; {source!r} gives {port}. {self.advice(needed)}")
                draft.wrong = True  # what follows from one node in the wrong place is not reported
        return draft.result(arriving)

    def advice(self, port: Port) -> str:
        makers = sorted(
            op.name
            for op in self.registry
            if op.gives.quantity is port.quantity and op.gives.quantity is not None and port.accepts(op.gives)
        )
        if port.quantity is Quantity.DATA:
            return "The graph's header declares an input of data: 'inputs: {radiance: radiance, depth: data}'"
        return f"What gives {port}: {', '.join(makers)}" if makers else f"Name a node that gives {port} in 'in'"

    def read_outputs(
        self, gives: Mapping[str, Port]
    ) -> tuple[dict[str, str], dict[str, dict[str, output_files.Value]]]:
        """File name -> node; and file name -> how it is written, where the graph says."""
        item = self.section("outputs", dict, "a mapping of file names to nodes, such as srgb.png: gamma")
        outputs: dict[str, str] = {}
        options: dict[str, dict[str, output_files.Value]] = {}
        for file_name, entry in item.value.items() if item else ():
            fault = output_files.fault(file_name)
            if not fault and file_name.lower() in (name.lower() for name in outputs):
                fault = "some systems cannot tell it from another output's name"
            if fault:
                self.faults.add(entry.key_place or entry.place, f"output {file_name!r}: {fault}")
                continue
            settings, node = self.read_options(file_name, entry) if isinstance(entry.value, dict) else ({}, entry)
            if node is None:
                continue
            if not isinstance(node.value, str) or node.value not in gives:
                if "nodes" not in self.unsure:
                    there = f"there are {', '.join(gives)}.{did_you_mean(str(node.value), gives)}"
                    self.faults.add(node.place, f"output {file_name!r} is {node.plain()!r}, which is no node; {there}")
                continue
            needed, port = output_files.FORMATS[output_files.suffix_of(file_name)], gives[node.value]
            if not needed.accepts(port):
                fitting = [name for name, flow in gives.items() if flow.quantity and needed.accepts(flow)]
                hint = f"; what fits: {', '.join(fitting)}" if fitting else ""
                self.faults.add(
                    node.place, f"output {file_name!r} takes {needed}; node {node.value!r} gives {port}{hint}"
                )
            outputs[file_name] = node.value
            if settings:
                options[file_name] = settings
        return outputs, options

    def read_options(self, file_name: str, entry: Located) -> tuple[dict[str, output_files.Value], Located | None]:
        """How an output is written, as far as it is right, and its node."""
        options: dict[str, output_files.Value] = {}
        for word, item in entry.value.items():
            if word == output_files.NODE:
                continue
            misspelt, fault = output_files.option_fault(file_name, word, item.plain())
            if fault:
                self.faults.add(
                    (item.key_place if misspelt else None) or item.place,
                    f"output {file_name!r}{' ' if misspelt else ': '}{fault}",
                )
            else:
                options[word] = output_files.OPTIONS[output_files.suffix_of(file_name)][word].read(item.value)
        node = entry.value.get(output_files.NODE)
        if node is None:
            self.faults.add(
                entry.place, f"output {file_name!r} has no 'node'; name the node that it is made of, beside what it has"
            )
        return options, node


class _UnsureError(Exception):
    """A value cannot be had for a reason that is reported already."""
