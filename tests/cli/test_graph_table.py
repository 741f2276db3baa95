"""What `graph show` and `graph run` print fits a terminal."""

import re
from pathlib import Path

import numpy as np
import pytest
from support.cli import run

from synfog_usd import camera
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import writers
from synfog_usd.camera.graph import drawing

PIPELINES = sorted((Path(__file__).parents[2] / "pipeline").glob("*.yaml"))


@pytest.mark.parametrize("width", [40, 80, 200])
@pytest.mark.parametrize("path", PIPELINES, ids=[path.stem for path in PIPELINES])
def test_a_table_has_every_node_and_parameter_within_the_width(path, width):
    """Of every shipped graph: no line is longer, nothing is cut, and a value and where it is from stand in one line."""
    graph = camera.load_graph(path)
    table = drawing.table(graph, width=width)
    assert max(map(len, table.splitlines())) <= width
    for node in graph.nodes.values():
        (block,) = re.findall(rf"^{node.name} .*\n(?:    .*\n)+", table, re.MULTILINE)
        told = " ".join(block.split())
        assert all(f" {key}=" in told for key in node.params if node.op.parameters[key].can_be_set)
        assert str(node.gives) in told and all(name in told for name in node.inputs)
    assert not re.search(r"^ +\((sensor|lens|default)\)", table, re.MULTILINE)


def test_a_run_tells_each_node_in_a_line(tmp_path, monkeypatch):
    """Piped, 80 characters: its milliseconds, and of the parameters what the file, --set and the meter say."""
    monkeypatch.delenv("COLUMNS", raising=False)
    grey = Image(np.full((8, 12, 3), 300.0, np.float32), ("R", "G", "B"), Quantity.RADIANCE)
    writers.write_exr(tmp_path / "grey.exr", grey)
    words = ("--in", "grey.exr", "-o", "out", "--no-cache", "--fov", "50", "--set", "adc.bits=12")
    done = run("graph", "run", PIPELINES[0].parent / "phone.yaml", *words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    lines = done.stderr[done.stderr.index("node ") :].splitlines()
    assert max(map(len, lines)) <= 80
    heads = [line.split() for line in lines[2:] if re.match(r"\w+ +\w+\.\w+ +[\d.]+", line)]
    assert [name for name, *_ in heads] == list(camera.load_graph(PIPELINES[0].parent / "phone.yaml").nodes)
    (adc,) = (head for head in heads if head[0] == "adc")
    assert adc[3:] == ["bits=12", "(set)"]
    assert any("exposure_s=" in word for head in heads for word in head[3:])
