"""A composed stage in layers: it holds what it held as one, and each layer what it is named after."""

from __future__ import annotations

import functools
import resource
from pathlib import Path

import pytest
from pxr import Sdf, Usd
from support import cli

from synfog_usd.world import departments
from synfog_usd.world.compose import compose, draw, load
from synfog_usd.world.roads import stage as of_roads

ROOT = Path(__file__).resolve().parents[2]
RECIPE = ROOT / "stages" / "recipes" / "rural.yaml"


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    """The same world (as one layer, as layers)."""
    folder = tmp_path_factory.mktemp("layers")
    spec = draw(load(RECIPE), seed=3)
    of_roads.author(folder / "one.usda", spec, assets=str(ROOT / "assets")).Save()
    compose(RECIPE, folder / "many.usda", seed=3)
    return folder / "one.usda", folder / "many.usda"


def test_each_department_has_its_own(both):
    """Muting a layer takes away what it is named after and nothing else."""
    stage = Usd.Stage.Open(str(both[1]))
    assert [Path(layer).name for layer in stage.GetRootLayer().subLayerPaths] == [
        "many.cameras.usda", "many.fog.usda", "many.lights.usda", "many.traffic.usda", "many.layout.usda",
    ]  # fmt: skip
    whole = {child.GetName() for child in stage.GetPrimAtPath("/World").GetAllChildren()}
    for name, gone in (("traffic", {"Vehicles", "People"}), ("fog", {"Fog"}), ("lights", {"Lights", "Sky"})):
        layer = str(both[1].with_name(f"many.{name}.usda"))
        stage.MuteLayer(layer)
        assert (
            whole - {child.GetName() for child in stage.GetPrimAtPath("/World").GetAllChildren() if child.IsDefined()}
            == gone
        )
        stage.UnmuteLayer(layer)


def test_the_root_layer_comes_last(tmp_path, monkeypatch):
    """A run that is killed between layers leaves no stage that names a missing one."""
    order = []
    write = departments.write_whole
    monkeypatch.setattr(departments, "write_whole", lambda path, how: (write(path, how), order.append(path.name)))
    compose(RECIPE, tmp_path / "s.usda", seed=1)
    assert order[-1] == "s.usda"
    assert sorted(order) == sorted(path.name for path in tmp_path.iterdir())
    assert len(Sdf.Layer.FindOrOpen(str(tmp_path / "s.usda")).GetPrimAtPath("/World").nameChildren) == 0


@pytest.mark.slow
@pytest.mark.parametrize("place", ["/proc/s.usda", "full"])
def test_a_place_that_takes_no_stage_is_one_line(tmp_path, place):
    """An unwritable folder, and a disk that is full: of the stage that was there before, every layer stays as it
    was.
    """
    compose(RECIPE, tmp_path / "s.usda", seed=2)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    out = tmp_path / "s.usda" if place == "full" else Path(place)
    limits = (lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))) if place == "full" else None
    run = functools.partial(cli.process, preexec_fn=limits) if limits else cli.run
    done = run("compose", RECIPE, "--seed", "1", "-o", out)
    assert done.returncode == 2, done.stderr
    assert done.stderr.count("\n") == 1
    assert "cannot be written" in done.stderr
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
