"""Files appear whole or not at all, whichever library writes them."""

from __future__ import annotations

from pathlib import Path

import pytest
from pxr import Sdf

from synfog_usd.base.errors import OutputError
from synfog_usd.base.files import TEMPORARY_PREFIX, remove_leftovers, write_bytes, write_json, write_whole


def test_a_writer_that_fails_leaves_the_old_file_and_nothing_beside_it(tmp_path: Path) -> None:
    """A power cut in mid-write must not cost yesterday's result."""
    path = tmp_path / "kept.txt"
    write_bytes(path, b"old")

    def half(temporary: Path) -> None:
        temporary.write_bytes(b"ne")
        raise RuntimeError("in the middle")

    with pytest.raises(RuntimeError):
        write_whole(path, half)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    "write", [lambda p: p.write_bytes(b"x"), lambda p: Sdf.Layer.CreateNew(str(p))], ids=["bytes", "usd"]
)
def test_a_folder_that_takes_no_file_is_one_clear_error(write: object) -> None:
    """USD's library raises an error of its own kind, which would reach the user as a traceback."""
    with pytest.raises(OutputError, match=r"^/proc/x\.usda: cannot be written"):
        write_whole(Path("/proc/x.usda"), write)  # type: ignore[arg-type]


def test_leftovers_of_killed_runs_go_and_nothing_else(tmp_path: Path) -> None:
    """Below the folder, at any depth."""
    write_json(tmp_path / "a" / "b.json", {"é": 1})
    (tmp_path / "a" / f"{TEMPORARY_PREFIX}1-b.json").touch()
    remove_leftovers(tmp_path)
    assert [p.name for p in (tmp_path / "a").iterdir()] == ["b.json"]
    assert (tmp_path / "a" / "b.json").read_text("utf-8") == '{\n  "é": 1\n}\n'
