"""The tests' own tests: that a failing one leaves what it saw, and that memory is seen at its peak."""

import numpy as np
import pytest
from support import stats
from support.memory import at_peak


@pytest.fixture
def failed(tmp_path, monkeypatch):
    monkeypatch.setattr(stats, "FAILED", tmp_path)
    return tmp_path


def test_a_wrong_mean_leaves_image_reference_and_error(failed):
    """Pictures of 1 with noise of 1 % against a truth of 1.1: fails, and the three lie there as EXR and as numbers."""
    runs = 1.0 + 0.01 * np.random.default_rng(0).normal(size=(8, 4, 6, 3))
    stats.assert_mean(runs, np.ones((4, 6, 3)), resolves=0.05)
    with pytest.raises(AssertionError, match=r"standard errors .* lie in"):
        stats.assert_mean(runs, 1.1, resolves=0.05)
    (folder,) = failed.iterdir()
    assert {file.name for file in folder.iterdir()} == {"evidence.npz", "image.exr", "reference.exr", "error.exr"}
    kept = np.load(folder / "evidence.npz")
    assert kept["runs"].shape == (8, 4, 6, 3) and (kept["error"] < -5.0).mean() > 0.9


def test_draws_that_are_two_percent_off_are_seen(failed):
    """A thousand draws in each of 400 cells, half of them 2 % too often: seen in 9 runs of 10; draws as they should be
    in none of 20.
    """
    draw = np.random.default_rng(1)
    skewed = np.repeat([1.02, 0.98], 200) / 400.0

    def fails(chances):
        try:
            stats.assert_draws(draw.multinomial(400_000, chances), np.ones(400))
        except AssertionError:
            return True
        return False

    assert sum(fails(skewed) for _ in range(20)) >= 18
    assert not any(fails(np.full(400, 1.0 / 400.0)) for _ in range(20))
    assert (next(failed.iterdir()) / "evidence.npz").exists()


def test_cells_that_hardly_anything_falls_into_count_as_one():
    """Chi-squared knows no cells of less than ten draws: a hundred of them together are judged once."""
    expected = np.r_[np.full(10, 1000.0), np.full(100, 0.5)]
    stats.assert_draws(np.r_[np.full(10, 1000), np.ones(50, dtype=int), np.zeros(50, dtype=int)], expected)
    with pytest.raises(AssertionError, match="chi-squared"):
        stats.assert_draws(np.r_[np.full(10, 1000), np.full(100, 3)], expected)


def test_memory_that_was_let_go_again_is_seen_at_its_peak():
    """256 MiB, then 64, and less than 16 where none are taken, although the process had more before."""
    held = [bytes(range(1, 9)) * (20 << 17) for _ in range(6)]
    del held
    for taken_mib, least, most in ((256, 200, 400), (64, 60, 80), (0, -1, 16)):
        _, kib = at_peak(lambda taken_mib=taken_mib: len(bytes(range(1, 9)) * (taken_mib << 17)))
        assert least < kib / 1024 < most
