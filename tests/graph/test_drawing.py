"""The drawing of a graph is well-formed whatever names and parameters say."""

from __future__ import annotations

import xml.etree.ElementTree as ET

from synfog_usd.camera.graph import drawing, load_graph

SVG = "{http://www.w3.org/2000/svg}"


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
    assert 'text.note says=<script>&"]' in [(item.text or "").replace("  ", " ") for item in root.iter(f"{SVG}text")]
    assert "script" not in {item.tag for item in root.iter()}
