"""What progress says of the time that is left."""

from __future__ import annotations

import pytest

from synfog_usd.cli.progress import _left
from synfog_usd.dataset.bake import SET_UP


@pytest.mark.parametrize(
    ("spent_s", "fraction", "said"),
    [
        (30.0, 0.25, "about 90 s left"),
        (245.0, 1 / 12, "about 2695 s left"),
        (20.0, SET_UP, ""),  # the one shot of a bake is set up, and nothing is sampled
        (10.0, 1.0, ""),
        (5.0, 0.0, ""),
    ],
)
def test_time_left_is_told_once_part_of_the_work_is_done(spent_s: float, fraction: float, said: str) -> None:
    assert _left(spent_s, fraction) == said
