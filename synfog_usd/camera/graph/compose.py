"""Graphs that build on others: `extends:` at the top, `include:` among the nodes.

Takes the tree of one file; gives a tree without either, in which every value still
knows the file, line and column that it came from.  Knows no op: whether the nodes
are right is for `load` to say.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from synfog_usd.base import resources
from synfog_usd.base.errors import GraphError, SynfogError, did_you_mean
from synfog_usd.base.yamlio import Located, Place, load_file
from synfog_usd.camera.graph.faults import Faults
from synfog_usd.camera.graph.outputs import NODE

SCHEMA = "graph/1"

MAX_FILES = 32
"""Files that one graph may be made of, each counted as often as it is included."""

EDITS = ("before", "after", "remove")
"""Words of a node that say where it goes in the graph that is extended."""


def node_name(fields: dict[str, Located]) -> str:
    """What a node is called: its 'name', else the verb of its 'op', else ''."""
    item = fields.get("name")
    if item is not None:
        return str(item.plain())
    op = fields.get("op")
    return op.value.rpartition(".")[2] if op is not None and isinstance(op.value, str) else ""


def composed(root: Located, folder: Path, faults: Faults) -> dict[str, Located]:
    """The sections of a graph with everything that it extends and includes put in.

    Args:
        root: tree of the graph's file.
        folder: of that file; files are read from here, from folders in it, and from
            the shipped pipelines, from nowhere else.
        faults: collects what is wrong.

    Raises:
        SynfogError: a part is missing, so that nothing can be said about the rest.
    """
    try:
        return _Composer(folder, faults).graph(_File(root, folder, (Path(root.place.file).resolve(),)))
    except _UnreadableError:
        faults.check()
        raise


@dataclass(frozen=True)
class _File:
    """A tree, the folder that its paths start from, and the files that led to it, itself the last."""

    root: Located
    folder: Path
    chain: tuple[Path, ...]


class _Composer:
    def __init__(self, folder: Path, faults: Faults) -> None:
        self.faults, self.count = faults, 0
        self.shipped = resources.folder("pipeline")
        self.allowed = (folder.resolve(), self.shipped.resolve())

    def graph(self, file: _File) -> dict[str, Located]:
        sections = self.sections(file)
        extends = sections.pop("extends", None)
        if isinstance(nodes := sections.get("nodes"), Located) and isinstance(nodes.value, list):
            sections["nodes"] = replace(nodes, value=self.included(nodes.value, file))
        if extends is None:
            self.refuse_edits(sections)
            return sections
        base_sections = self.read(extends, file)
        if base_sections is None:  # reported already; what is missing without it is no fault of its own
            raise _UnreadableError
        base = self.graph(base_sections)
        if "nodes" not in base:
            self.refuse_edits(sections)
        merged = {**base, **sections}
        for key, join in (("nodes", self.edited), ("outputs", self.joined_outputs)):
            if key in base and key in sections:
                merged[key] = join(base[key], sections[key])
        return merged

    def sections(self, file: _File) -> dict[str, Located]:
        root = file.root
        if not isinstance(root.value, dict):
            self.faults.add(root.place, f"a graph is a mapping that begins with 'synfog: {SCHEMA}'")
            raise _UnreadableError
        label = root.value.get("synfog")
        if label is None:
            self.faults.add(root.place, f"the first line must be 'synfog: {SCHEMA}'")
        elif label.value != SCHEMA:
            self.faults.add(label.place, f"synfog is {label.plain()!r}; this program reads {SCHEMA!r}")
        return dict(root.value)

    def read(self, item: Located, by: _File) -> _File | None:
        """The file that `item` names in the file `by`; None, with a fault added, where it cannot be read."""
        path = self.path_of(item, by)
        if path is None:
            return None
        real = path.resolve()
        if real in by.chain:
            loop = [*by.chain[by.chain.index(real) :], real]
            self.faults.add(
                item.place, f"files build on each other in a circle: {' -> '.join(link.name for link in loop)}"
            )
            return None
        self.count += 1
        if self.count >= MAX_FILES:
            self.faults.add(item.place, f"the graph is made of more than {MAX_FILES} files")
            return None
        try:
            root = load_file(path, error=GraphError)
        except SynfogError as error:
            self.faults.take(item.place, GraphError(f"{item.place}: {item.value!r} cannot be used: {error}"))
            return None
        return _File(root, path.parent, (*by.chain, real))

    def path_of(self, item: Located, by: _File) -> Path | None:
        text = item.value
        if not isinstance(text, str) or not text.endswith((".yaml", ".yml")) or "\0" in text:
            names = sorted(path.stem for path in self.shipped.glob("*.yaml"))
            if text in names:
                return self.shipped / f"{text}.yaml"
            hint = did_you_mean(text, names) if isinstance(text, str) else ""
            self.faults.add(
                item.place,
                f"no shipped graph {item.plain()!r}; there are {', '.join(names)}, or give a path that ends in "
                f".yaml.{hint}",
            )
            return None
        path = Path(os.path.normpath(by.folder / text))
        try:
            real = path.resolve()
        except (OSError, RuntimeError) as problem:  # links that point at each other
            self.faults.add(item.place, f"{text!r} cannot be read ({problem})")
            return None
        if Path(text).is_absolute() or not any(real.is_relative_to(folder) for folder in self.allowed):
            self.faults.add(
                item.place,
                f"{text!r} is outside the graph's own folder; give a path below it, or the name of a shipped graph",
            )
            return None
        return path

    def included(self, entries: list[Located], file: _File) -> list[Located]:
        """The entries, those that are `include: FILE` replaced by the nodes of that file."""
        nodes: list[Located] = []
        for entry in entries:
            if not isinstance(entry.value, dict) or "include" not in entry.value:
                nodes.append(entry)
                continue
            for key, item in entry.value.items():
                if key != "include":
                    self.faults.add(
                        item.key_place or item.place,
                        f"{key!r} cannot stand beside 'include'; give it an entry of its own",
                    )
            sections_of_file = self.read(entry.value["include"], file)
            if sections_of_file is None:
                raise _UnreadableError
            fields = self.sections(sections_of_file)
            for key, item in fields.items():
                if key not in ("synfog", "title", "nodes"):
                    self.faults.add(
                        item.key_place or item.place,
                        f"{key!r} cannot stand in a file that is included; it holds nodes only (use 'extends' for a "
                        f"whole graph)",
                    )
            inner = fields.get("nodes")
            if inner is None or not isinstance(inner.value, list):
                self.faults.add((inner or sections_of_file.root).place, "an included file has 'nodes', a list")
                raise _UnreadableError
            nodes += self.included(inner.value, sections_of_file)
        return nodes

    def refuse_edits(self, sections: dict[str, Located]) -> None:
        nodes = sections.get("nodes")
        for entry in nodes.value if nodes is not None and isinstance(nodes.value, list) else ():
            if isinstance(entry.value, dict):
                for word in set(EDITS) & set(entry.value):
                    place = entry.value[word].key_place or entry.place
                    self.faults.add(
                        place,
                        f"{word!r} is for a graph that builds on another; put 'extends: ...' at the top, or take "
                        f"{word!r} away",
                    )
                    del entry.value[word]

    def edited(self, base: Located, change: Located) -> Located:
        """The base's nodes, changed, taken away and added to as the own entries say."""
        if not isinstance(base.value, list) or not isinstance(change.value, list):
            return change
        nodes: list[Located] = list(base.value)
        touched: dict[str, Place] = {}
        for entry in change.value:
            if not isinstance(entry.value, dict):
                nodes.append(entry)
                continue
            names = [node_name(node.value) if isinstance(node.value, dict) else "" for node in nodes]
            name = node_name(entry.value)
            fields = {key: item for key, item in entry.value.items() if key not in EDITS}
            words = [word for word in EDITS if word in entry.value]
            if name in touched:
                self.faults.add(
                    entry.place, f"node {name!r} stands already at {touched[name]}; give one of them another name"
                )
            elif "remove" in words or (name in names and name):
                self.change(entry, name, fields, words, nodes, names)
            elif "op" not in fields and name:
                self.faults.add(
                    entry.place,
                    f"node {name!r} has no 'op', and there is none of that name to change.{did_you_mean(name, names)}",
                )
            else:
                self.add(replace(entry, value=fields), entry.value, name, words, nodes, names)
            if name:
                touched.setdefault(name, entry.place)
        return replace(base, value=nodes)

    def change(
        self,
        entry: Located,
        name: str,
        fields: dict[str, Located],
        words: list[str],
        nodes: list[Located],
        names: list[str],
    ) -> None:
        if name not in names:
            self.faults.add(
                entry.place,
                f"no node {name!r} to take away; there are "
                f"{', '.join(filter(None, names))}.{did_you_mean(name, names)}",
            )
            return
        index = names.index(name)
        if "remove" in words:
            if entry.value["remove"].value is not True or set(entry.value) != {"name", "remove"}:
                self.faults.add(
                    entry.place, f"node {name!r}: 'remove: true' takes the node away; only its 'name' stands beside it"
                )
            gone = nodes.pop(index)
            if (
                "in" in gone.value
                and index < len(nodes)
                and isinstance(nodes[index].value, dict)
                and "in" not in nodes[index].value
            ):
                nodes[index] = replace(
                    nodes[index], value={**nodes[index].value, "in": gone.value["in"]}
                )  # it read the one that is gone
        elif words:
            item = entry.value[words[0]]
            self.faults.add(
                item.key_place or item.place,
                f"node {name!r} is one of the graph that is extended and keeps its place; {words[0]!r} is for new "
                f"nodes",
            )
        elif "op" in fields:
            inputs_of_node = {"in": nodes[index].value["in"]} if "in" in nodes[index].value else {}
            nodes[index] = replace(entry, value={**inputs_of_node, **fields})
        else:
            nodes[index] = replace(nodes[index], value={**nodes[index].value, **fields})

    def add(
        self,
        node: Located,
        taken_names: dict[str, Located],
        name: str,
        words: list[str],
        nodes: list[Located],
        names: list[str],
    ) -> None:
        if not words:
            nodes.append(node)
            return
        item: Any = taken_names[words[0]]
        if len(words) > 1 or item.value not in names:
            wrong = (
                "'before' and 'after' exclude each other"
                if len(words) > 1
                else f"no node {item.plain()!r} to stand {words[0]}"
            )
            self.faults.add(
                item.place, f"node {name!r}: {wrong}.{did_you_mean(str(item.value), names) if len(words) == 1 else ''}"
            )
            nodes.append(node)
            return
        nodes.insert(names.index(item.value) + (words[0] == "after"), node)

    def joined_outputs(self, base: Located, change: Located) -> Located:
        """Files of both; an own file that is empty ('srgb.png:') takes the base's away, and one without 'node' changes
        how the base's is written.
        """
        if not isinstance(base.value, dict) or not isinstance(change.value, dict):
            return change
        merged = dict(base.value)
        for name, item in change.value.items():
            if item.value is None and name in merged:
                del merged[name]
            elif isinstance(item.value, dict) and NODE not in item.value and name in merged:
                before = merged[name]
                fields = before.value if isinstance(before.value, dict) else {NODE: before}
                merged[name] = replace(item, value={**fields, **item.value})
            else:
                merged[name] = item
        return replace(change, value=merged)


class _UnreadableError(Exception):
    """A part of the graph is missing, so nothing can be said about the whole; why is among the faults."""
