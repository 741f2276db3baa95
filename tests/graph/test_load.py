"""What `load_graph` refuses, with its exact place, and what it accepts."""

from __future__ import annotations

from pathlib import Path

import pytest

from synfog_usd.base.errors import GraphError
from synfog_usd.camera.graph import drawing, load_graph

GOOD = """\
synfog: graph/1
inputs: [radiance]
chip: good
nodes:
  - {name: lens, op: lens.pass, scale: 2}
  - {name: expose, op: chip.expose, time_s: 1/4}
  - {name: noise, op: chip.noise}
  - {name: adc, op: chip.adc, bits: 8}
  - {name: show, op: screen.show}
outputs:
  raw.dng: adc
  srgb.png: show
"""


def load(tmp_path: Path, text: str, registry):
    path = tmp_path / "g.yaml"
    path.write_text(text)
    return load_graph(path, registry)


def refusal(tmp_path: Path, text: str, registry, kind: type[Exception] = GraphError) -> str:
    with pytest.raises(kind) as caught:
        load(tmp_path, text, registry)
    return str(caught.value).replace(str(tmp_path) + "/", "")


def lines(text: str) -> list[str]:
    """The errors of a message, without the line that counts them."""
    head, *rest = text.splitlines()
    if rest:
        assert head == f"g.yaml: {len(rest)} errors"
    return rest or [head]


def test_a_good_graph_loads_with_its_values_and_their_sources(tmp_path, registry):
    graph = load(tmp_path, GOOD, registry)
    assert list(graph.nodes) == ["lens", "expose", "noise", "adc", "show"]
    assert graph.nodes["expose"].params["time_s"].value == 0.25
    assert (graph.nodes["noise"].params["sigma_e"].value, graph.nodes["noise"].params["sigma_e"].source) == (
        2.0,
        "chip.noise_e",
    )
    assert graph.nodes["lens"].params["shape"].source == "default"
    assert graph.outputs == {"raw.dng": "adc", "srgb.png": "show"}


def test_outputs_may_say_how_they_are_written(tmp_path, registry):
    """Whoever needs only file and node finds them as ever; the rest stands beside, and in the hash."""
    plain = load(tmp_path, GOOD, registry)
    assert plain.output_options == {} and plain.options_of("raw.dng") == {}
    said = GOOD.replace("raw.dng: adc", "raw.dng: {compression: lossless, node: adc}").replace(
        "srgb.png: show", "srgb.png: {node: show, bits: 16}\n  raw.exr: adc"
    )
    graph = load(tmp_path, said, registry)
    assert graph.outputs == {"raw.dng": "adc", "srgb.png": "show", "raw.exr": "adc"}
    assert graph.output_options == {"raw.dng": {"compression": "lossless"}, "srgb.png": {"bits": 16}}
    assert (
        len(
            {
                load(tmp_path, text, registry).hash
                for text in (said, said.replace("bits: 16", "bits: 8"), said.replace("{node: show, bits: 16}", "show"))
            }
        )
        == 3
    )
    assert load(tmp_path, GOOD.replace("raw.dng: adc", "raw.dng: {node: adc}"), registry).hash == plain.hash
    assert (
        "writes raw.dng from adc (compression=lossless)\nwrites srgb.png from show (bits=16)\nwrites raw.exr from adc"
        in drawing.table(graph)
    )


# (what is replaced; by what, ^ standing before the thing that is wrong; the message or its start)
FAULTS = [
    ("op: screen.show", "op: screen.show, tint: ^[1, 2]", "node 'show' (screen.show): tint is [1, 2]; it takes a"),
    ("op: chip.noise}", "op: chip.noise, in: ^[expose, lens]}", "node 'noise' (chip.noise) reads 1 image; 'in' names"),
    ("op: lens.pass", "op: light.difference", "g.yaml:5:5: node 'lens' (light.difference) reads 2 images (radiance,"),
    ("name: noise", "name: Noise 1", "g.yaml:7:12: node name 'Noise 1' is not a name; use lower-case letters, digits"),
    ("{name: noise, op: chip.noise}", "{name: noise, op: chip.noise, op: chip.adc}", "g.yaml:7:35: key 'op' stands"),
    ("chip: good\n", "", "g.yaml:6:5: node 'noise' (chip.noise) takes sigma_e from the chip profile; name one at the"),
    ("graph/1", "graph/2", "g.yaml:1:9: synfog is 'graph/2'; this program reads 'graph/1'"),
    ("synfog: graph/1\n", "", "g.yaml:1:1: the first line must be 'synfog: graph/1'"),
    ("[radiance]", "[radiance, lamps]", "g.yaml:5:5: node 'lens' (lens.pass) has no 'in', and the graph has several"),
    ("srgb.png: show", "../srgb.png: show", "g.yaml:12:3: output '../srgb.png': it is not a plain file name"),
    ("srgb.png: show", "radiance.exr: show", "g.yaml:12:3: output 'radiance.exr': a bake writes a file of that name"),
    ("srgb.png: show", "srgb.png: adc", "g.yaml:12:13: output 'srgb.png' takes display_rgb; node 'adc' gives dn"),
    ("raw.dng: adc", "raw.dng: {compression: lossless}", "g.yaml:11:12: output 'raw.dng' has no 'node'; name the"),
    ("raw.dng: adc", "raw.dng: {node: adc, compression: ^losless}", "output 'raw.dng': compression is 'losless'; it"),
    ("outputs:\n  raw.dng: adc\n  srgb.png: show\n", "outputs: all\n", "g.yaml:10:10: outputs is 'all'; it takes a"),
    ("bits: 8", "bits: ^!!python/object/apply:os.system ['true']", "tag"),
    ("bits: 8}", "bits: 8", "g.yaml:9:5: not valid YAML: expected ',' or '}', but got '{'"),
]


@pytest.mark.parametrize(("old", "new", "message"), FAULTS, ids=[new[:40] for _, new, _ in FAULTS])
def test_a_fault_is_named_with_its_place(tmp_path, registry, old, new, message):
    """Line and column are where ^ stood, or are written out in the message."""
    assert GOOD.count(old) == 1, "the fault must stand in one place"
    text = GOOD.replace(old, new)
    if "^" in text:
        before, _, after = text.partition("^")
        message = f"g.yaml:{before.count(chr(10)) + 1}:{len(before.rpartition(chr(10))[2]) + 1}: {message}"
        text = before + after
    told = lines(refusal(tmp_path, text, registry))
    assert told[0][: len(message)] == message
    assert len(told) == (2 if "light.difference" in new else 1), (
        "what follows from a fault is no fault of its own"
    )  # it takes no 'scale' either


def test_all_faults_of_a_file_are_told_at_once_in_its_order(tmp_path, registry):
    """One of each kind, none of them on a node that another has spoiled; each with the place where it stands."""
    text = """\
synfog: graph/1
title: [1]
inputs: {radiance: radance}
chip: bad
nodes:
  - {name: lens, op: lens.pass, scale: 11, shap: round}
  - {name: expose, op: chip.expose, time_s: soon}
  - {name: noise, op: chip.nose}
  - {name: adc, op: chip.adc, in: expos}
  - {name: adc, op: chip.adc}
  - {name: late, op: screen.show, in: expose}
  - {name: one, op: chip.noise, in: two, sigma_e: 1}
  - {name: two, op: chip.noise, in: one, sigma_e: 1}
outputs:
  raw.gif: adc
  srgb.png: shw
"""
    starts = [
        "g.yaml:2:8: title is [1]; it takes a text",
        "g.yaml:3:20: input 'radiance' is 'radance'; it takes one of radiance,",
        "g.yaml:4:7: chip 'bad': no such chip; there is good",
        "g.yaml:6:40: node 'lens' (lens.pass): scale is 11; it takes a number above 0, up to 10.",
        "g.yaml:6:44: node 'lens' (lens.pass) has no parameter 'shap'; it takes scale, shape. Did you mean 'shape'?",
        "g.yaml:7:45: node 'expose' (chip.expose): time_s is 'soon'; it takes a number above 0 [s] or auto.",
        "g.yaml:8:23: no op 'chip.nose'; there are chip.adc,",
        "g.yaml:9:35: node 'adc' (chip.adc) reads 'expos', which is no node or input. Did you mean 'expose'?",
        "g.yaml:10:5: node 'adc' stands already at line 9; give one of them another name",
        "g.yaml:11:39: node 'late' (screen.show) takes dn; 'expose' gives electrons (mosaic). What gives dn: chip.adc",
        "g.yaml:12:5: nodes read each other in a circle: one -> two -> one; change one 'in'",
        "g.yaml:15:3: output 'raw.gif': its format '.gif' is not known",
        "g.yaml:16:13: output 'srgb.png' is 'shw', which is no node;",
    ]
    told = lines(refusal(tmp_path, text, registry))
    assert [line[: len(start)] for line, start in zip(told, starts, strict=True)] == starts


def test_very_many_faults_are_counted_not_all_told(tmp_path, registry):
    nodes = "".join(f"  - {{name: n{index}, op: lens.pass, in: radiance, scale: -1}}\n" for index in range(200))
    told = refusal(
        tmp_path, f"synfog: graph/1\ninputs: [radiance]\nnodes:\n{nodes}outputs: {{a.exr: n0}}\n", registry
    ).splitlines()
    assert told[0] == "g.yaml: 200 errors" and told[-1] == "... and 150 more" and len(told) == 52


def test_a_value_in_the_node_goes_before_the_profile(tmp_path, registry):
    graph = load(
        tmp_path, GOOD.replace("op: chip.noise}", "op: chip.noise, sigma_e: 7}").replace("chip: good\n", ""), registry
    )
    assert (graph.nodes["noise"].params["sigma_e"].value, graph.nodes["noise"].params["sigma_e"].source) == (
        7.0,
        "file",
    )


@pytest.mark.parametrize(("written", "value"), [("1/60", 1 / 60), ("1e-3", 0.001), ("3", 3.0)])
def test_times_may_be_written_as_photographers_and_programs_do(tmp_path, registry, written, value):
    """YAML 1.1 takes 1e-3 for text, and 1/60 is one."""
    graph = load(tmp_path, GOOD.replace("time_s: 1/4", f"time_s: {written}"), registry)
    assert graph.nodes["expose"].params["time_s"].value == value


def test_nodes_may_stand_in_any_order_when_they_say_what_they_read(tmp_path, registry):
    text = """\
synfog: graph/1
inputs: [radiance]
chip: good
nodes:
  - {op: chip.adc, in: noise}
  - {op: chip.noise, in: expose}
  - {op: lens.pass, in: radiance, name: lens}
  - {op: chip.expose}
outputs: {a.exr: adc}
"""
    assert list(load(tmp_path, text, registry).nodes) == ["lens", "expose", "noise", "adc"]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[" * 300_000,
        "a: &a [x, x]\nb: &b [*a, *a, *a, *a]\n"
        + "\n".join(f"c{i}: &c{i} [{', '.join(['*b' if i == 0 else f'*c{i - 1}'] * 9)}]" for i in range(9)),
        "synfog: &x [*x]\n",
        "\x00",
        "synfog: graph/1\ninputs: {radiance: {a: b}}\nnodes: [1]\noutputs: {}\n",
        "synfog: graph/1\ninputs: [radiance]\nnodes: [{op: lens.pass, name: [a]}]\noutputs: {}\n",
        "synfog: graph/1\ninputs: [radiance]\nnodes: [{op: lens.pass, in: {a: b}}]\noutputs: {}\n",
        "synfog: graph/1\ninputs: [radiance]\nnodes: [{op: lens.pass, scale: 1"
        + "0" * 400
        + "}]\noutputs: {a.exr: pass}\n",
        "synfog: graph/1\ninputs: [radiance]\nnodes: [{op: lens.pass}]\noutputs: {a.exr: {}, b.exr: {node: {a: b}}, "
        "c.exr: {node: pass, half: {a: b}}}\n",
    ],
)
def test_hostile_text_is_an_error_of_ours_and_never_another(tmp_path, registry, text):
    refusal(tmp_path, text, registry)


def test_a_file_that_is_not_text_or_not_there_is_refused(tmp_path, registry):
    path = tmp_path / "g.yaml"
    with pytest.raises(GraphError, match="cannot be read"):
        load_graph(path, registry)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(GraphError, match="not UTF-8"):
        load_graph(path, registry)
