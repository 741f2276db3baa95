"""What a cached run leaves out, and that its pictures are those of a run without."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Annotated

import numpy as np
import pytest

from synfog_usd.base.files import TEMPORARY_PREFIX
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.graph import Cache, Range, Registry, cache, load_graph

GRAPH = """\
synfog: graph/1
inputs: [radiance]
chip: good
nodes:
  - {name: lens, op: lens.pass, scale: 2}
  - {name: side, op: lens.pass, in: radiance, scale: 3}
  - {name: expose, op: chip.expose, in: lens, time_s: auto}
  - {name: noise, op: chip.noise}
  - {name: adc, op: chip.adc}
  - {name: show, op: screen.show}
outputs: {raw.dng: adc, srgb.png: show}
"""
ALL = ["lens", "side", "expose", "noise", "adc", "show"]


@pytest.fixture
def run(tmp_path, registry, radiance):
    """Runs the graph with a cache, checks each picture against a run without one, and gives the names of the nodes that
    ran.
    """
    (tmp_path / "g.yaml").write_text(GRAPH)

    def go(
        text: str | None = None,
        *,
        image: Image = radiance,
        seed=1,
        time_s=3.0,
        keep=None,
        ops=registry,
        store=None,
        **arguments,
    ):
        if text is not None:
            (tmp_path / "g.yaml").write_text(text)
        arguments |= {"seed": seed, "settings": {"time_s": time_s}, "keep": keep}
        graph = load_graph(tmp_path / "g.yaml", ops)
        plain = graph.run({"radiance": image}, **arguments)
        cached = graph.run({"radiance": image}, cache=store or Cache(tmp_path / "cache"), **arguments)
        assert list(cached) == list(plain)
        for name, picture in plain.items():
            assert cached[name].pixels.tobytes() == picture.pixels.tobytes()
            assert (cached[name].channels, cached[name].quantity) == (picture.channels, picture.quantity)
            assert list(cached[name].provenance.items()) == list(picture.provenance.items())
        assert set(cached.cached) == set(plain.milliseconds) - set(cached.milliseconds)
        return [name for name in ALL if name in cached.milliseconds]

    return go


def test_nothing_runs_twice(run):
    assert run() == ALL
    assert run() == []


@pytest.mark.parametrize(
    ("change", "ran"),
    [
        ({"text": GRAPH.replace("scale: 2", "scale: 2.5")}, ["lens", "expose", "noise", "adc", "show"]),
        ({"text": GRAPH.replace("chip: good", "chip: other.yaml")}, ["noise", "adc", "show"]),
        (
            {"text": GRAPH.replace("  - {name: adc", "  - {name: more, op: chip.noise, sigma_e: 0}\n  - {name: adc")},
            ["adc", "show"],
        ),
        ({"text": GRAPH.replace("name: noise", "name: hiss")}, ["adc", "show"]),
        ({"text": GRAPH.replace("raw.dng", "other.dng") + "# a comment\n"}, []),
        ({"overrides": {"noise.sigma_e": 9}}, ["noise", "adc", "show"]),
        ({"seed": 2}, ["noise", "adc", "show"]),
        ({"time_s": 4.0}, ["expose", "noise", "adc", "show"]),
        ({"keep": ["adc"], "overrides": {"side.scale": 1}}, ["side"]),
    ],
)
def test_one_change_runs_what_follows_and_nothing_else(tmp_path, run, change, ran):
    """Nodes of another name than those six are not counted."""
    (tmp_path / "other.yaml").write_text("3.0")
    run()
    assert run(**change) == ran
    assert run(**change) == []


def test_another_picture_runs_all_and_so_does_another_meaning(run, radiance):
    run()
    pixels = radiance.pixels.copy()
    pixels[3, 5, 2] += 1e-3
    assert run(image=radiance.with_pixels(pixels)) == ALL
    assert run(image=radiance.with_metadata(fov_x_deg=3.0)) == ALL
    assert run(image=Image(radiance.pixels, ("B", "G", "R"), Quantity.RADIANCE)) == ALL
    assert run(image=radiance) == []


def registry_of(folder: Path, source: str) -> Registry:
    """A registry with one op, `own.op`, whose source is a file as a user has it."""
    path = folder / "own_ops.py"
    path.write_text(f"from synfog_usd.base.image import Image, Quantity\n\n{source}\n")
    names: dict = {}
    exec(compile(path.read_text(), str(path), "exec"), names)
    cache._source_hash.cache_clear()
    ops = Registry()
    ops.op("own.op", takes=Quantity.RADIANCE, gives=Quantity.RADIANCE)(names["own"])
    return ops


def test_an_op_that_was_rewritten_runs_again(tmp_path, radiance):
    """Its name and parameters stay; its source does not."""
    (tmp_path / "g.yaml").write_text(
        "synfog: graph/1\ninputs: [radiance]\nnodes: [{op: own.op}]\noutputs: {a.exr: op}\n"
    )
    source = "def own(image: Image) -> Image:\n    return image.with_pixels(image.pixels * {})"
    peaks = []
    for factor in (2, 2, 3):
        graph = load_graph(tmp_path / "g.yaml", registry_of(tmp_path, source.format(factor)))
        run = graph.run({"radiance": radiance}, seed=0, cache=Cache(tmp_path / "cache"))
        peaks.append((run["op"].pixels.max() / radiance.pixels.max(), len(run.milliseconds)))
    assert peaks == [(2, 1), (2, 0), (3, 1)]


def test_an_op_that_holds_variables_of_the_function_around_it_is_never_kept(tmp_path, radiance):
    """Two ops of one source that differ in what they hold; the second must not get the first's result."""
    (tmp_path / "g.yaml").write_text(
        "synfog: graph/1\ninputs: [radiance]\nnodes: [{op: own.op}]\noutputs: {a.exr: op}\n"
    )

    def scaled(factor: float) -> Registry:
        ops = Registry()

        @ops.op("own.op", takes=Quantity.RADIANCE, gives=Quantity.RADIANCE)
        def scale(image: Image, *, power: Annotated[float, Range(0.0)] = 1.0) -> Image:
            return image.with_pixels(image.pixels * np.float32(factor))

        return ops

    store = Cache(tmp_path / "cache")
    for factor in (2, 3):
        run = load_graph(tmp_path / "g.yaml", scaled(factor)).run({"radiance": radiance}, seed=0, cache=store)
        assert run["op"].pixels.max() == radiance.pixels.max() * factor
    assert list((tmp_path / "cache").iterdir()) == []


@pytest.mark.parametrize("harm", ["short", "flipped", "other", "folder"])
def test_a_broken_file_is_as_good_as_none(tmp_path, run, harm):
    """Every file is harmed in turn; the pictures are those of a run without a cache, and the file is whole again."""
    run()
    whole = {path: path.read_bytes() for path in sorted((tmp_path / "cache").iterdir())}
    assert len(whole) == len(ALL)
    for path, data in whole.items():
        other = next(text for name, text in whole.items() if name != path)
        path.unlink()
        if harm == "folder":
            path.mkdir()
        else:
            flipped = bytes([*data[:-9], data[-9] ^ 1, *data[-8:]])
            path.write_bytes(
                {
                    "short": data[:-1],
                    "flipped": flipped,
                    "other": other,
                }[harm]
            )
        run()
        if harm == "folder":
            path.rmdir()
            path.write_bytes(data)
        else:
            assert path.read_bytes() == data


def test_a_folder_over_the_limit_is_tidied_when_it_is_opened_and_only_of_its_own(tmp_path):
    image = Image(np.zeros((16, 16, 1), np.float32), ("Y",), Quantity.DATA)
    store = Cache(tmp_path)
    for number in range(20):
        store.put(f"{number:064x}", image)
    store.flush()
    (tmp_path / "notes.txt").write_text("x" * 100_000)
    for name, age_s in (("killed", 7200), ("running", 0)):
        (tmp_path / f"{TEMPORARY_PREFIX}{name}.node").write_text("")
        os.utime(tmp_path / f"{TEMPORARY_PREFIX}{name}.node", (time.time() - age_s,) * 2)
    Cache(tmp_path, limit_bytes=8_000)
    names = {path.name for path in tmp_path.iterdir()}
    assert (
        "notes.txt" in names
        and f"{TEMPORARY_PREFIX}running.node" in names
        and f"{TEMPORARY_PREFIX}killed.node" not in names
    )
    assert sum(path.stat().st_size for path in tmp_path.glob("*.node")) <= 8_000


def test_a_folder_that_cannot_be_written_changes_no_picture(tmp_path, run):
    """The folder is taken away from under the cache."""
    store = Cache(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert run(store=store) == ALL
    assert not (tmp_path / "gone").exists()
