"""Workers of a scheduler that runs already."""

import pytest
from support.cli import process
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
