"""The schema that is made from the ops is of one mind with the loader."""

from __future__ import annotations

import pytest
import yaml

from synfog_usd import camera
from synfog_usd.base import resources
from synfog_usd.base.errors import GraphError
from synfog_usd.camera.graph import Registry, load_graph, schema

GRAPHS = sorted(resources.folder("pipeline").glob("*.yaml"))


@pytest.fixture
def valid():
    """Whether the schema of some ops accepts a text."""
    jsonschema = pytest.importorskip("jsonschema")

    def accepts(text: str, ops: Registry) -> bool:
        made = schema.schema(ops)
        jsonschema.Draft7Validator.check_schema(made)
        return jsonschema.Draft7Validator(made).is_valid(yaml.safe_load(text))

    return accepts


@pytest.mark.parametrize("path", GRAPHS, ids=lambda path: path.stem)
def test_the_schema_accepts_the_shipped_graphs(valid, path):
    assert valid(path.read_text(), camera.OPS)


NODES = (
    "op: lens.pass",
    "op: lens.pass, scale: 0",
    "op: lens.pass, scale: '1/4'",
    "op: lens.pass, scale: auto",
    "op: lens.pass, scale: true",
    "op: lens.pass, shape: rond",
    "op: lens.pass, shap: round",
    "op: lens.pas",
    "op: lens.pass, in: [1]",
    "scale: 1",
)
OUTPUTS = (
    "raw.dng: {node: adc, compression: lossless}",
    "raw.dng: {node: adc, compresion: none}",
    "raw.exr: {node: adc, half: true, compression: none}",
    "raw.raw10: {node: adc, embedded_lines: 2}",
    "raw.raw10: {node: adc, embedded_lines: '2'}",
    "raw.bmp: adc",
)


@pytest.mark.parametrize(
    "nodes, output",
    [
        *((f"{{{node}}}", "a.exr: pass") for node in NODES),
        *(("{op: lens.pass}, {op: chip.expose}, {op: chip.adc}", output) for output in OUTPUTS),
    ],
)
def test_schema_and_loader_agree(tmp_path, registry, valid, nodes, output):
    """Names, types and ranges of nodes and outputs: what the one refuses the other refuses."""
    text = f"synfog: graph/1\ninputs: [radiance]\nnodes: [{nodes}]\noutputs: {{{output}}}\n"
    (tmp_path / "g.yaml").write_text(text)
    try:
        loads = bool(load_graph(tmp_path / "g.yaml", registry))
    except GraphError:
        loads = False
    assert valid(text, registry) is loads
