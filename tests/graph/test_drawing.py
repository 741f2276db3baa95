"""The drawing of a graph: well-formed, complete, and nothing on top of anything else."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from itertools import combinations
from pathlib import Path

import pytest

from synfog_usd import camera
from synfog_usd.base import resources
from synfog_usd.camera.graph import drawing, load_graph

BRANCHES = """\
synfog: graph/1
inputs: [sky, lamps, headlights]
nodes:
  - {name: both, op: light.sum, in: [sky, lamps, headlights, sky]}
  - {name: again, op: light.difference, in: [both, sky]}
  - {name: a_node_with_a_name_that_is_much_too_long_for_its_box, op: lens.pass, in: sky}
  - {name: end, op: lens.pass, in: again, scale: 2}
  - {name: late, op: chip.expose, in: a_node_with_a_name_that_is_much_too_long_for_its_box, time_s: 1}
outputs: {a.exr: both, b.exr: both, c.exr: both, d.exr: both, e.exr: both, long_name_of_a_file_with_many_letters_in_it_indeed.exr: end}
"""  # noqa: E501
SVG = "{http://www.w3.org/2000/svg}"


def branches(tmp_path: Path, registry):
    (tmp_path / "g.yaml").write_text(BRANCHES)
    return load_graph(tmp_path / "g.yaml", registry)


def texts(root):
    """(left, top, right, bottom, text) of every text, from the widths of DejaVu Sans Bold, a wide font: 0.69 em on
    average.
    """
    for item in root.iter(f"{SVG}text"):
        if item.get("stroke"):
            continue  # the halo of the text that follows
        x, y, size, text = float(item.get("x")), float(item.get("y")), float(item.get("font-size")), item.text
        wide = (0.69 if item.get("font-weight") == "bold" else 0.6) * size * len(text)
        yield (
            x - wide if item.get("text-anchor") == "end" else x,
            y - 0.76 * size,
            x if item.get("text-anchor") == "end" else x + wide,
            y + 0.24 * size,
            text,
        )


def boxes(root):
    for item in root.iter(f"{SVG}rect"):
        if item.get("stroke"):
            x, y = float(item.get("x")), float(item.get("y"))
            yield (x, y, x + float(item.get("width")), y + float(item.get("height")))


def overlap(one, two):
    return one[0] < two[2] and two[0] < one[2] and one[1] < two[3] and two[1] < one[3]


@pytest.fixture(params=["branches", *sorted(path.stem for path in resources.folder("pipeline").glob("*.yaml"))])
def graph(request, tmp_path, registry):
    return (
        branches(tmp_path, registry)
        if request.param == "branches"
        else camera.load_graph(resources.folder("pipeline") / f"{request.param}.yaml")
    )


def test_no_text_or_box_lies_on_another_or_outside_the_drawing(graph):
    spent = dict.fromkeys(graph.nodes, 1234.5)
    root = ET.fromstring(drawing.svg(graph, drawing.GraphRun({}, spent)))
    width, height = float(root.get("width")), float(root.get("height"))
    words, frames = list(texts(root)), list(boxes(root))
    assert len(frames) == len(graph.nodes) + len(graph.inputs)
    for one, two in [*combinations(words, 2), *combinations(frames, 2)]:
        assert not overlap(one, two), (one, two)
    for item in [*words, *frames]:
        assert item[0] >= 0 and item[1] >= 0 and item[2] <= width and item[3] <= height, item
    for word in words:  # within one box, or outside all of them
        for frame in frames:
            inside = frame[0] <= word[0] and word[2] <= frame[2] and frame[1] <= word[1] and word[3] <= frame[3]
            assert inside or not overlap(word, frame), (word, frame)


def test_edges_pass_no_box(graph):
    """Straight pieces pass beside boxes; curves, which stay between the heights of their ends, have those between two
    rows.
    """
    root = ET.fromstring(drawing.svg(graph))
    frames = list(boxes(root))
    for path in root.iter(f"{SVG}path"):
        if not path.get("fill"):
            continue  # the tick before a file's name
        points = [
            tuple(map(float, pair))
            for pair in re.findall(
                r"(-?[\d.]+) (-?[\d.]+)(?= |$)", re.sub(r"C \S+ \S+ \S+ \S+", "L", path.get("d")).replace("V", "V 0")
            )
        ]
        x, y = points[0]
        for to_x, to_y in points[1:]:
            to_x = to_x or x  # V keeps it
            left, right = (x, x) if to_x == x else (0.0, 1e9)
            for frame in frames:
                assert not overlap((left, y + 0.5, right, to_y - 0.5), frame), (path.get("d"), frame)
            x, y = to_x, to_y


def test_every_node_input_and_file_is_named_with_its_milliseconds(tmp_path, registry, radiance):
    graph = branches(tmp_path, registry)
    run = graph.run(dict.fromkeys(graph.inputs, radiance), seed=0, keep=[])
    root = ET.fromstring(drawing.svg(graph, run))
    found = [text for *_, text in texts(root)]
    for name in ("both", "again", "end", "sky", "lamps", "headlights", "a.exr", "e.exr"):
        assert name in found
    assert [text for text in found if text.endswith(" ms") and ":" not in text] == [
        f"{run.milliseconds[name]:.1f} ms" for name in graph.nodes
    ]
    assert f"g: {sum(run.milliseconds.values()):.0f} ms" in found
    assert "a_node_with_a_name_that_is_much_too_long_for_its_box: lens.pass" in [
        (item.text or "").strip() for item in root.iter(f"{SVG}title")
    ]
    bars = sorted(float(item.get("width")) for item in root.iter(f"{SVG}rect") if item.get("height") == "4")
    assert bars[-1] == drawing.BOX_W - 6 and len(bars) == 5


def test_hostile_text_stays_text(tmp_path, registry):
    (tmp_path / "<g>&'.yaml").write_text(
        'synfog: graph/1\ninputs: [radiance]\nnodes: [{op: text.note, says: "<script>&\\"]"}]\noutputs: {a.exr: note}\n'
    )
    ops = type(registry)(registry)

    @ops.op("text.note", takes=None, gives=None)
    def note(image, *, says: str):
        return image

    graph = load_graph(tmp_path / "<g>&'.yaml", ops)
    root = ET.fromstring(drawing.svg(graph))
    assert 'text.note says=<script>&"]' in [text.replace("  ", " ") for *_, text in texts(root)]
    assert "script" not in {item.tag for item in root.iter()}


def test_mermaid_gets_no_word_of_its_own_as_a_name(tmp_path, registry, radiance):
    """`end` closes a block in Mermaid and would break the chart."""
    graph = branches(tmp_path, registry)
    chart = drawing.mermaid(graph, graph.run(dict.fromkeys(graph.inputs, radiance), seed=0))
    assert (
        'end_["end<br/>lens.pass<br/>' in chart and "again -- radiance --> end_" in chart and "end_ --> file5[" in chart
    )
    assert len(re.findall(r"<br/>[\d.]+ ms\"\]", chart)) == 5
