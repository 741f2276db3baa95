"""The names of `import synfog_usd as sf` as one page of Markdown, made from their signatures and docstrings."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from typing import Any

import synfog_usd
from synfog_usd.dataset.bake import Baked
from synfog_usd.dataset.check import Checked
from synfog_usd.dataset.frames import Frame, Scene
from synfog_usd.dataset.photo import Photo
from synfog_usd.dataset.sets.run import Outcome

GIVEN = {
    "load": (Scene,),
    "render": (Frame,),
    "develop": (Photo,),
    "bake": (Baked,),
    "check": (Checked,),
    "make_set": (Outcome,),
}
"""Name -> the classes of what it gives."""

HEAD = """\
# Python

`import synfog_usd as sf` offers these names. Libraries are imported when a name is used. This page is made from
docstrings: `python -m docs.pages`.

These functions do what the command does, and the same seed gives the same bytes. The options of the
[command line](cli.md) are keywords, with `_` for `-`. Arrays are numpy's, row 0 at the top. What you can mend raises
`sf.SynfogError`, whose text is the command's sentence. `logging.getLogger("synfog_usd")` has what the command prints.

Your own process reads the stages. The fence around a stage's folder and the limits on its size hold there. Limits on
time and memory do not: the command has them, in a child process. Use the command, or `sf.make_set`, whose units are
such children, for files that you do not trust.
"""

SECTIONS = ("Args", "Attributes", "Returns", "Raises")


def page() -> str:
    """All names, in the order of `dir(sf)` before it is sorted, each with what it gives."""
    names = [name for name in synfog_usd.__dir__() if not name.startswith("_")]
    contents = ["| name | does |", "|---|---|"]
    contents += [f"| [`sf.{name}`](#sf{name.lower()}) | {_summary(getattr(synfog_usd, name))} |" for name in names]
    sections = [line for name in names for line in _section(name)]
    return "\n".join([HEAD, *contents, "", *sections]).rstrip("\n") + "\n"


def _summary(item: Any) -> str:
    return " ".join((inspect.getdoc(item) or "").split("\n\n")[0].split())


def _section(name: str) -> Iterator[str]:
    item = getattr(synfog_usd, name)
    yield from (f"## sf.{name}", "", "```text", f"sf.{name}{_signature(item)}", "```", "")
    yield from _described(item)
    for kind in GIVEN.get(name, ()):
        yield from (f"### {kind.__name__}", "")
        yield from _described(kind)
        for inner, member in _members(kind):
            words = "" if isinstance(member, property) else _signature(member)
            yield from (f"`{inner}{words}`: {_summary(member)}", "")


def _members(kind: type) -> Iterator[tuple[str, Any]]:
    for inner, member in vars(kind).items():
        if not inner.startswith("_") and (inspect.isfunction(member) or isinstance(member, property)):
            yield inner, member


def _signature(function: Any) -> str:
    """Parameters and their defaults, without types, which the docstring tells."""
    if inspect.isclass(function) and issubclass(function, Exception):
        return ""
    shown = []
    before: Any = None
    for parameter in inspect.signature(function).parameters.values():
        if parameter.name == "self":
            continue
        if parameter.kind is parameter.KEYWORD_ONLY and before is not parameter.KEYWORD_ONLY:
            shown.append("*")
        before = parameter.kind
        default = (
            "" if parameter.default is parameter.empty or callable(parameter.default) else f"={parameter.default!r}"
        )
        shown.append(f"{'**' if parameter.kind is parameter.VAR_KEYWORD else ''}{parameter.name}{default}")
    return f"({', '.join(shown)})"


def _described(item: Any) -> Iterator[str]:
    """A docstring as paragraphs, and its sections as lists."""
    title, lines = "", list[str]()
    for line in [*(inspect.getdoc(item) or "").split("\n>>>")[0].splitlines(), "End:"]:
        heading = line.removesuffix(":")
        if line.endswith(":") and heading in (*SECTIONS, "End"):
            yield from _text(title, lines)
            title, lines = heading, []
        else:
            lines.append(line)


def _text(title: str, lines: list[str]) -> Iterator[str]:
    text = inspect.cleandoc("\n".join(lines))
    if not text:
        return
    if title in ("", "Returns"):
        for paragraph in text.split("\n\n"):
            yield from (f"{title}: {_plain(paragraph)}" if title else _plain(paragraph), "")
        return
    items = re.split(r"\n(?=\S)", text)
    if title == "Raises":
        yield from (
            "; ".join(f"Raises `{name}`: {_plain(what)}" for name, _, what in (part.partition(": ") for part in items)),
            "",
        )
        return
    yield from ("| | |", "|---|---|")
    for name, _, what in (part.partition(": ") for part in items):
        quoted = ", ".join(f"`{part.strip()}`" for part in name.split(","))
        yield f"| {quoted} | {_cell(what)} |"
    yield ""


def _cell(text: str) -> str:
    return _plain(text).replace("|", "\\|")


def _plain(text: str) -> str:
    return " ".join(text.split())
