"""What ships is taken by its name, wherever a file of its kind is."""

from pathlib import Path

import pytest
from support.cli import run

from synfog_usd import camera
from synfog_usd.base import resources
from synfog_usd.base.errors import GraphError, RecipeError, SetError
from synfog_usd.dataset.asked import plan_of
from synfog_usd.dataset.sets.load import load_set
from synfog_usd.world.compose import load

KINDS = [("recipe", load, RecipeError), ("data set", load_set, SetError), ("pipeline", camera.load_graph, GraphError)]


@pytest.mark.parametrize("kind, read, error", KINDS)
def test_a_bare_name_is_what_ships_and_a_path_is_a_file(kind, read, error, tmp_path, monkeypatch):
    """From any folder, also one with a folder of that name, as a bake leaves."""
    monkeypatch.chdir(tmp_path)
    for name in resources.shipped(kind):
        assert resources.named(Path(name), kind).stem == name
    name, path = next(iter(resources.shipped(kind).items()))
    (tmp_path / name).mkdir()
    read(Path(name))
    read(path)
    (tmp_path / "own.yaml").write_text("no: such format\n")
    assert resources.named(Path("own.yaml"), kind) == Path("own.yaml")
    for wrong in (f"{name}x", f"{name}x.yaml", f"{name}.yaml"):
        with pytest.raises(error, match=rf"{wrong}: no such file, and no {kind} .* Did you mean '{name}'\?"):
            read(Path(wrong))
    with pytest.raises(error, match="no such file"):
        read(tmp_path / "elsewhere" / name)


def test_compose_takes_the_name_of_a_recipe(tmp_path):
    """As `dataset` does, from another folder; a name that is none is one line and exit code 2."""
    done = run("compose", "tunnel", "--seed", "3", "-o", "drawn.usda", cwd=tmp_path)
    assert done.returncode == 0 and (tmp_path / "drawn.usda").is_file(), done.stderr
    done = run("compose", "tunnell", "--seed", "3", "-o", "a.usda", cwd=tmp_path)
    assert done.returncode == 2 and "Did you mean 'tunnel'?" in done.stderr and done.stderr.count("\n") == 1


def test_a_stage_that_ships_is_taken_by_its_name(tmp_path, monkeypatch):
    """From a folder where a bake of it left one of that name; a file of one's own goes before."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "chamber").mkdir()
    assert run("check", "chamber", cwd=tmp_path).returncode == 0
    assert plan_of("bench/canyon").stage == resources.folder("stages") / "bench/canyon.usda"
    assert plan_of("chamber").out == Path("out/chamber")
    (tmp_path / "crossroads").write_text("mine")
    for name in ("crossroads", "chamber.usda", "no"):
        assert resources.stage(Path(name)) == Path(name)
