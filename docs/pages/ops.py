"""All ops as one page of Markdown, each as `synfog-usd graph explain` prints it."""

from __future__ import annotations

from synfog_usd.base.image import Quantity
from synfog_usd.camera.graph import Registry, reference

HEAD = """\
# Ops

Every step that a graph can name. This page is made from the functions themselves: `python -m docs.pages`.
What an op takes and gives is checked when a graph is loaded; a range that a value leaves is refused with its line.
"""


def page(registry: Registry) -> str:
    """One page with all ops: families as light meets them, each in the order of its declaration."""
    quantities = [None, *Quantity]
    first: dict[str, int] = {}
    for op in registry:
        first[op.family] = min(first.get(op.family, len(quantities)), quantities.index(op.takes[0].quantity))
    ordered = sorted(registry, key=lambda op: (first[op.family], op.family))
    contents = ["| op | takes | gives | does |", "|---|---|---|---|"]
    for op in ordered:
        what = (
            f"[{op.name}](#{op.name.replace('.', '')}) | {reference.takes(op)} | {reference.gives(op)} | {op.summary}"
        )
        contents.append(f"| {what} |")
    return "\n".join([HEAD, *contents, "", *("\n".join(reference.section(op)) for op in ordered)])
