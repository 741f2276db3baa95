"""Workers of a scheduler that runs already."""

import sys

import pytest
from support.cli import process, run
from support.stages import street

pytest.importorskip("distributed")


@pytest.mark.slow
def test_a_scheduler_that_does_not_answer_is_one_line(tmp_path):
    (tmp_path / "one.usda").write_text(street())
    (tmp_path / "tiny.yaml").write_text("synfog: set/1\nscenes: 1\nstages: ['*.usda']\n")
    done = process("dataset", "run", tmp_path / "tiny.yaml", "-o", tmp_path / "out", "--scheduler", "tcp://127.0.0.1:9")
    assert done.returncode == 2 and done.stderr.startswith(
        "synfog-usd: --scheduler tcp://127.0.0.1:9: no Dask scheduler"
    )
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("library", ["distributed", "pyarrow"])
def test_a_missing_library_is_told_before_anything_is_written(tmp_path, monkeypatch, library):
    """Both are named at once."""
    monkeypatch.setitem(sys.modules, library, None)
    done = run("dataset", "run", "mini", "-o", tmp_path / "out")
    assert done.returncode == 2 and "pip install distributed pyarrow" in done.stderr
    assert not (tmp_path / "out").exists()
