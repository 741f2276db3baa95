"""Graphs that build on others: what comes out, and what is refused, with its place in the right file."""

from __future__ import annotations

from pathlib import Path

import pytest

from synfog_usd import camera
from synfog_usd.base import resources
from synfog_usd.base.errors import GraphError
from synfog_usd.camera.graph import load_graph

BASE = """\
synfog: graph/1
inputs: [radiance]
chip: good
nodes:
  - {name: lens, op: lens.pass, scale: 2}
  - {name: expose, op: chip.expose, time_s: 1/4}
  - {name: noise, op: chip.noise}
  - {name: adc, op: chip.adc, bits: 8}
  - {name: show, op: screen.show}
outputs: {raw.dng: adc, srgb.png: show}
"""

SHIPPED = ", ".join(sorted(path.stem for path in resources.folder("pipeline").glob("*.yaml")))


def load(tmp_path: Path, registry, **texts: str):
    """The graph `g.yaml` among the files of these stems."""
    for stem, text in {"base": BASE, **texts}.items():
        (tmp_path / f"{stem}.yaml").write_text(text)
    return load_graph(tmp_path / "g.yaml", registry)


def refusal(tmp_path: Path, registry, **texts: str) -> str:
    with pytest.raises(GraphError) as caught:
        load(tmp_path, registry, **texts)
    return str(caught.value).replace(str(tmp_path) + "/", "")


def own(nodes: str = "", rest: str = "", extends: str = "base.yaml") -> str:
    return f"synfog: graph/1\nextends: {extends}\n" + (f"nodes:\n{nodes}" if nodes else "") + rest


def test_nodes_are_changed_replaced_taken_away_and_put_in(tmp_path, registry):
    """The same graph written out by hand has the same hash, which holds every node, parameter, edge and output."""
    nodes = """\
  - {name: lens, scale: 3}
  - {name: noise, remove: true}
  - {name: adc, op: chip.adc, invert: true}
  - {name: early, op: chip.noise, sigma_e: 1, after: expose}
  - {name: earlier, op: chip.noise, sigma_e: 2, before: early}
  - {name: again, op: screen.show, in: adc, tint: [1, 0, 0]}
"""
    by_hand = """\
synfog: graph/1
inputs: [radiance]
chip: good
nodes:
  - {name: lens, op: lens.pass, scale: 3}
  - {name: expose, op: chip.expose, time_s: 1/4}
  - {name: earlier, op: chip.noise, sigma_e: 2}
  - {name: early, op: chip.noise, sigma_e: 1}
  - {name: adc, op: chip.adc, invert: true}
  - {name: show, op: screen.show}
  - {name: again, op: screen.show, in: adc, tint: [1, 0, 0]}
outputs: {raw.dng: adc, again.png: again}
"""
    graph = load(tmp_path, registry, g=own(nodes, "outputs: {again.png: again, srgb.png: }\n"), hand=by_hand)
    assert graph.hash == load_graph(tmp_path / "hand.yaml", registry).hash
    assert [graph.nodes[name].inputs for name in ("earlier", "early", "adc")] == [("expose",), ("earlier",), ("early",)]


def test_outputs_of_both_are_written_and_how_they_are_can_be_changed(tmp_path, registry):
    """Without 'node' the base's words stay and the own ones go before them; a name, or a 'node', begins anew."""
    base = BASE.replace(
        "{raw.dng: adc, srgb.png: show}",
        "{raw.dng: adc, all.exr: {node: noise, half: true, compression: piz}, srgb.png: {node: show, bits: 16}, "
        "a.exr: {node: show, half: true}}",
    )
    outputs = (
        "outputs: {raw.dng: {compression: lossless}, all.exr: {compression: rle}, srgb.png: show, a.exr: {node: adc}, "
        "b.png: {node: show, bits: 8}}\n"
    )
    graph = load(tmp_path, registry, g=own(rest=outputs), base=base)
    assert graph.outputs == {"raw.dng": "adc", "all.exr": "noise", "srgb.png": "show", "a.exr": "adc", "b.png": "show"}
    assert graph.output_options == {
        "raw.dng": {"compression": "lossless"},
        "all.exr": {"half": True, "compression": "rle"},
        "b.png": {"bits": 8},
    }
    fault = refusal(
        tmp_path, registry, g=own(rest="outputs: {raw.dng: {compression: lossles}, new.exr: {half: true}}\n"), base=BASE
    )
    assert fault.splitlines()[1:] == [
        "g.yaml:3:34: output 'raw.dng': compression is 'lossles'; it takes one of none, lossless. Did you mean "
        "'lossless'?",
        "g.yaml:3:53: output 'new.exr' has no 'node'; name the node that it is made of, beside what it has",
    ]


def test_a_chain_of_graphs_is_followed_and_profiles_stay_in_their_folders(tmp_path, registry):
    (tmp_path / "more").mkdir()
    (tmp_path / "more" / "chip.yaml").write_text("7.0")
    (tmp_path / "more" / "mid.yaml").write_text(
        own("  - {name: lens, scale: 4}\n", "chip: chip.yaml\n", "../base.yaml")
    )
    graph = load(tmp_path, registry, g=own("  - {name: adc, bits: 12}\n", extends="more/mid.yaml"))
    values = [
        graph.nodes[node].params[name].value
        for node, name in (("lens", "scale"), ("adc", "bits"), ("noise", "sigma_e"))
    ]
    assert values == [4.0, 12, 7.0]


def test_included_nodes_stand_where_the_line_stood(tmp_path, registry):
    part = "synfog: graph/1\nnodes:\n  - {name: expose, op: chip.expose, time_s: 1/4}\n  - include: parts/noise.yaml\n"
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "noise.yaml").write_text(
        "synfog: graph/1\ntitle: noise\nnodes:\n  - {name: noise, op: chip.noise}\n"
    )
    lines = BASE.splitlines(keepends=True)
    graph = load(tmp_path, registry, g="".join([*lines[:5], "  - include: part.yaml\n", *lines[7:]]), part=part)
    assert graph.hash == load_graph(tmp_path / "base.yaml", registry).hash


def test_a_shipped_graph_is_extended_by_its_name(tmp_path):
    """One number is changed, from another folder; the rest is the phone's, sensor and all."""
    (tmp_path / "mine.yaml").write_text(own("  - {name: gain, iso: 400}\n", extends="phone"))
    graph, phone = (
        camera.load_graph(tmp_path / "mine.yaml"),
        camera.load_graph(resources.folder("pipeline") / "phone.yaml"),
    )
    assert graph.hash == phone.with_overrides({"gain.iso": 400}).hash != phone.hash


@pytest.mark.parametrize(
    ("nodes", "message"),
    [
        ("  - {name: lens, scale: 11}\n", "g.yaml:4:25: node 'lens' (lens.pass): scale is 11;"),
        (
            "  - {name: lns, scale: 1}\n",
            "g.yaml:4:5: node 'lns' has no 'op', and there is none of that name to change. Did you mean 'lens'?",
        ),
        (
            "  - {name: nois, remove: true}\n",
            "g.yaml:4:5: no node 'nois' to take away; there are lens, expose, noise, adc, show. Did you mean 'noise'?",
        ),
        (
            "  - {name: n, op: chip.noise, after: expos}\n",
            "g.yaml:4:38: node 'n': no node 'expos' to stand after. Did you mean 'expose'?",
        ),
        (
            "  - {name: expose, remove: true}\n",
            "base.yaml:7:5: node 'noise' (chip.noise) takes electrons; 'lens' gives irradiance. What gives electrons: "
            "chip.expose",
        ),
    ],
)
def test_a_fault_is_placed_in_the_file_in_which_it_stands(tmp_path, registry, nodes, message):
    assert refusal(tmp_path, registry, g=own(nodes)).splitlines()[-1].startswith(message)


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        ("../outside.yaml", "'../outside.yaml' is outside the graph's own folder;"),
        ("link.yaml", "'link.yaml' is outside the graph's own folder;"),
        ("none.yaml", "'none.yaml' cannot be used: none.yaml: cannot be read (No such file or directory)"),
        ("folder.yaml", "'folder.yaml' cannot be used: folder.yaml: cannot be read (it is no regular file)"),
        (
            "phon",
            f"no shipped graph 'phon'; there are {SHIPPED}, or give a path that ends in .yaml. Did you mean 'phone'?",
        ),
        ("[base.yaml]", "no shipped graph ['base.yaml']; there are"),
        ("broken.yaml", "'broken.yaml' cannot be used: broken.yaml:1:4: not valid YAML:"),
    ],
)
@pytest.mark.parametrize("way", ["extends", "include"])
def test_files_come_from_the_graph_s_folder_or_the_shipped_ones_only(tmp_path, registry, way, reference, message):
    home = tmp_path / "home"
    (home / "folder.yaml").mkdir(parents=True)
    (tmp_path / "outside.yaml").write_text(BASE)
    (home / "link.yaml").symlink_to(tmp_path / "outside.yaml")
    (home / "broken.yaml").write_text("a: }\n")
    text = (
        own(extends=reference)
        if way == "extends"
        else BASE.replace("  - {name: noise, op: chip.noise}", f"  - include: {reference}")
    )
    place = "g.yaml:2:10" if way == "extends" else "g.yaml:7:14"
    assert refusal(home, registry, g=text).startswith(f"{place}: {message}")


def test_circles_of_files_are_refused(tmp_path, registry):
    assert (
        refusal(tmp_path, registry, g=own(extends="g.yaml"))
        == "g.yaml:2:10: files build on each other in a circle: g.yaml -> g.yaml"
    )
    told = refusal(tmp_path, registry, g=own(extends="a.yaml"), a=own(extends="b.yaml"), b=own(extends="a.yaml"))
    assert told == "b.yaml:2:10: files build on each other in a circle: a.yaml -> b.yaml -> a.yaml"
    part = "synfog: graph/1\nnodes:\n  - include: part.yaml\n"
    told = refusal(tmp_path, registry, g=BASE.replace("{name: noise, op: chip.noise}", "include: part.yaml"), part=part)
    assert told == "part.yaml:3:14: files build on each other in a circle: part.yaml -> part.yaml"


def test_files_that_multiply_into_a_bomb_are_refused(tmp_path, registry):
    """Ten includes of ten includes of ten: 1110 files, of which 32 are read."""
    texts = {f"p{level}": "synfog: graph/1\nnodes:\n" + f"  - include: p{level + 1}.yaml\n" * 10 for level in range(3)}
    texts["p3"] = "synfog: graph/1\nnodes:\n  - {name: x, op: chip.noise}\n"
    told = refusal(tmp_path, registry, g=BASE.replace("{name: noise, op: chip.noise}", "include: p0.yaml"), **texts)
    assert told.splitlines()[-1].endswith("the graph is made of more than 32 files")
