"""What a graph does with images: order, random streams, settings, overrides, and how it shows itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from synfog_usd.base.errors import GraphError, ImageError, ParameterError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.graph import Registry, load_graph

GRAPH = """\
synfog: graph/1
inputs: [radiance]
chip: good
nodes:
  - {name: lens, op: lens.pass, scale: 2}
  - {name: expose, op: chip.expose, time_s: auto}
  - {name: noise, op: chip.noise}
  - {name: adc, op: chip.adc}
outputs: {raw.dng: adc}
"""


def load(tmp_path: Path, registry, text: str = GRAPH, name: str = "g.yaml"):
    (tmp_path / name).write_text(text)
    return load_graph(tmp_path / name, registry)


def test_the_same_seed_gives_the_same_bytes_and_another_does_not(tmp_path, registry, radiance):
    graph = load(tmp_path, registry)
    one, again, other = (
        graph.run({"radiance": radiance}, seed=seed, settings={"time_s": 3.0})["noise"].pixels for seed in (1, 1, 2)
    )
    assert one.tobytes() == again.tobytes()
    assert (one != other).all()


def test_a_node_that_is_added_moves_no_other_stream(tmp_path, registry, radiance):
    """The node before `noise` draws too, but its noise is 0: what `noise` draws must not change."""
    text = GRAPH.replace("  - {name: noise,", "  - {name: early, op: chip.noise, sigma_e: 0}\n  - {name: noise,")
    arguments = {"seed": 5, "settings": {"time_s": 3.0}}
    plain = load(tmp_path, registry).run({"radiance": radiance}, **arguments)
    longer = load(tmp_path, registry, text).run({"radiance": radiance}, **arguments)
    np.testing.assert_array_equal(longer["noise"].pixels, plain["noise"].pixels)


def test_auto_is_found_in_the_settings_before_the_provenance(tmp_path, registry, radiance):
    graph = load(tmp_path, registry)
    assert graph.settings_needed == ("time_s",)
    noted = radiance.with_metadata(time_s=2.0)
    assert graph.run({"radiance": noted}, seed=0, until="expose")["expose"].pixels[0, 1, 0] == 3 * 2 * 2
    assert (
        graph.run({"radiance": noted}, seed=0, until="expose", settings={"time_s": 5.0})["expose"].pixels[0, 1, 0]
        == 3 * 2 * 5
    )


def test_auto_that_nobody_answers_is_an_error_that_says_what_to_do(tmp_path, registry, radiance):
    with pytest.raises(
        GraphError,
        match=(
            r"g\.yaml:6:5: node 'expose' \(chip.expose\) has time_s: auto, but nothing says time_s: .* Give time_s a "
            r"number"
        ),
    ):
        load(tmp_path, registry).run({"radiance": radiance}, seed=0)


@pytest.mark.parametrize("value", [0.0, "soon"])
def test_a_setting_is_checked_like_a_value_in_the_file(tmp_path, registry, radiance, value):
    with pytest.raises(GraphError, match=r"'time_s' in the settings is .*; it takes a number above 0 \[s\]"):
        load(tmp_path, registry).run({"radiance": radiance}, seed=0, settings={"time_s": value})


def test_overrides_change_a_run_and_its_hash_but_not_the_graph(tmp_path, registry, radiance):
    graph = load(tmp_path, registry)
    before = graph.hash
    run = graph.run({"radiance": radiance}, seed=0, overrides={"lens.scale": "3", "expose.time_s": 1.0}, until="expose")
    assert run["expose"].pixels[0, 1, 0] == 3 * 3
    assert graph.with_overrides({"lens.scale": 3}).hash != before == graph.hash


@pytest.mark.parametrize(
    ("key", "value", "changed"),
    [
        ("noise.sigma_e", 7, {"noise.sigma_e": 7.0}),
        ("chip.sigma_e", 7, {"noise.sigma_e": 7.0, "more.sigma_e": 7.0}),
        ("chip.noise_e", 7, {"noise.sigma_e": 7.0, "more.sigma_e": 7.0}),
        ("chip.time_s", "1/8", {"expose.time_s": 0.125}),
        ("lens.pass.scale", 3, {"lens.scale": 3.0}),
    ],
)
def test_an_override_may_name_a_node_an_op_a_family_or_a_value_of_a_profile(tmp_path, registry, key, value, changed):
    graph = load(
        tmp_path, registry, GRAPH.replace("  - {name: adc", "  - {name: more, op: chip.noise}\n  - {name: adc")
    )
    before = {
        f"{node.name}.{name}": bound.value for node in graph.nodes.values() for name, bound in node.params.items()
    }
    after = {
        f"{node.name}.{name}": bound.value
        for node in graph.with_overrides({key: value}).nodes.values()
        for name, bound in node.params.items()
    }
    assert {name: after[name] for name in after if after[name] != before[name]} == changed


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"chip.nois_e": 1}, r"override 'chip.nois_e': no node 'chip'; write node.parameter. Did you mean"),
        (
            {"lens.scal": 1},
            r"override 'lens.scal': node 'lens' \(lens.pass\) has no parameter 'scal'; it takes scale, shape. Did you "
            r"mean 'scale'\?",
        ),
        ({"lns.scale": 1}, r"override 'lns.scale': no node 'lns'; write node.parameter. Did you mean 'lens.scale'\?"),
        ({"lens.scale": 99}, r"scale is 99; it takes a number above 0, up to 10"),
    ],
)
def test_a_wrong_override_is_refused(tmp_path, registry, overrides, message):
    with pytest.raises(GraphError, match=message):
        load(tmp_path, registry).with_overrides(overrides)


def test_images_that_do_not_fit_are_refused_before_anything_runs(tmp_path, registry, radiance):
    graph = load(tmp_path, registry)
    with pytest.raises(GraphError, match="needs an image for its input 'radiance'"):
        graph.run({}, seed=0)
    with pytest.raises(GraphError, match=r"has no input 'radience'; it takes radiance. Did you mean 'radiance'\?"):
        graph.run({"radience": radiance}, seed=0)
    with pytest.raises(GraphError, match="takes radiance; the image holds dn"):
        graph.run({"radiance": Image(radiance.pixels, radiance.channels, Quantity.DN)}, seed=0)
    pixels = radiance.pixels.copy()
    pixels[2, 5, 1] = np.nan
    with pytest.raises(ImageError, match="pixel x=5, y=2 of channel 'G' is not a finite number"):
        graph.run({"radiance": radiance.with_pixels(pixels)}, seed=0)


def test_several_inputs_meet_in_one_node(tmp_path, registry, radiance):
    text = """\
synfog: graph/1
inputs: [sky, lamps]
nodes:
  - {name: both, op: light.sum, in: [sky, lamps, lamps]}
  - {name: rest, op: light.difference, in: [both, sky]}
outputs: {rest.exr: rest}
"""
    run = load(tmp_path, registry, text).run(
        {"sky": radiance, "lamps": radiance.with_pixels(radiance.pixels + 1)}, seed=0
    )
    np.testing.assert_array_equal(run["rest"].pixels, 2 * radiance.pixels + 2)


def test_a_node_that_changes_no_quantity_can_be_left_out(tmp_path, registry, radiance):
    graph = load(tmp_path, registry)
    run = graph.without(["noise"]).run({"radiance": radiance}, seed=0, settings={"time_s": 1.0})
    np.testing.assert_array_equal(run["adc"].pixels, radiance.pixels[..., :1] * 2)
    for name in ("expose", "adc"):
        with pytest.raises(GraphError, match="cannot be left out"):
            graph.without([name])


def test_an_error_inside_an_op_gets_the_place_of_its_node(tmp_path, radiance):
    ops = Registry()

    @ops.op("a.fails", takes=None, gives=None)
    def fails(image: Image) -> Image:
        raise ParameterError("it is too dark")

    graph = load(
        tmp_path, ops, "synfog: graph/1\ninputs: [radiance]\nnodes:\n  - op: a.fails\noutputs: {a.exr: fails}\n"
    )
    with pytest.raises(ParameterError, match=r"g\.yaml:4:5: node 'fails' \(a.fails\): it is too dark"):
        graph.run({"radiance": radiance}, seed=0)


def test_the_hash_follows_meaning_not_spelling(tmp_path, registry):
    same = (
        GRAPH.replace("scale: 2", "scale: 2.0  ")
        .replace("nodes:", "# a comment\nnodes:")
        .replace("outputs: {raw.dng: adc}", "outputs:\n  raw.dng: adc")
    )
    changed = [
        GRAPH.replace("scale: 2", "scale: 2.5"),
        GRAPH.replace("raw.dng", "x.dng"),
        GRAPH.replace("chip: good", "chip: own.yaml"),
        GRAPH.replace("time_s: auto", "time_s: 1"),
        GRAPH.replace("name: lens", "name: glass"),
    ]
    (tmp_path / "own.yaml").write_text("2.0")
    first = load(tmp_path, registry).hash
    assert load(tmp_path, registry, same, "other.yaml").hash == first
    hashes = {load(tmp_path, registry, text).hash for text in changed}
    assert len(hashes) == len(changed) and first not in hashes
