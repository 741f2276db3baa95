"""A graph as Mermaid text."""

from __future__ import annotations

from pathlib import Path

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


def branches(tmp_path: Path, registry):
    (tmp_path / "g.yaml").write_text(BRANCHES)
    return load_graph(tmp_path / "g.yaml", registry)


def test_mermaid_gets_no_word_of_its_own_as_a_name(tmp_path, registry):
    """`end` closes a block in Mermaid and would break the chart."""
    graph = branches(tmp_path, registry)
    chart = drawing.mermaid(graph)
    assert 'end_["end<br/>lens.pass"]' in chart and "again -- radiance --> end_" in chart and "end_ --> file5[" in chart
