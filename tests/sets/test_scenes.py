"""Which scene is what: by its number and the set's seed alone."""

from collections import Counter
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from synfog_usd.dataset.sets.load import define_set, load_set
from synfog_usd.dataset.sets.scenes import even, held_out, scene, scenes
from synfog_usd.world.compose import draw


def test_a_scene_is_told_without_the_others():
    """The same from its number as in the row of all, and in a set that has grown."""
    words = {"recipes": {"tunnel": 2, "rural": 1}, "fogs": ["clear", {"integer": [50, 900]}], "seed": 7}
    words["lightings"] = [{"choice": {"sky": 1, "active": 1}}]
    small, grown = (define_set(scenes=count, splits={"train": 9, "test": 1}, **words) for count in (40, 400))
    every = list(scenes(small))
    assert [scene(small, number) for number in range(40)] == every == list(scenes(grown, range(40)))
    assert len({one.seed for one in every}) == 40
    assert len({one.fogs for one in every}) > 30 and len({one.lightings for one in every}) == 2
    other = define_set(scenes=40, splits={"train": 9, "test": 1}, **{**words, "seed": 8})
    assert not {one.seed for one in scenes(other)} & {one.seed for one in every}


@pytest.mark.parametrize("shares", [(9, 1), (3, 3, 2, 1), ("0.85", "0.05", "0.1")])
def test_shares_are_dealt_out_to_one(shares):
    """Of every first N, each has its part of N to one and a half at most; of the whole sum its share exactly; ranks
    count up without a gap.
    """
    exact = [Fraction(share) for share in shares]
    dealt, ranks = Counter(), Counter()
    for number in range(2000):
        which, rank = even(number, exact)
        assert rank == ranks[which]
        dealt[which] += 1
        ranks[which] += 1
        for index, share in enumerate(exact):
            assert abs(dealt[index] - (number + 1) * share / sum(exact)) <= Fraction(3, 2)
    round_number = 1000 - 1000 % int(sum(exact)) if sum(exact) <= 1000 else 0
    if round_number and all(share.denominator == 1 for share in exact):
        counted = Counter(even(number, exact)[0] for number in range(round_number))
        assert [counted[index] for index in range(len(exact))] == [round_number * s / sum(exact) for s in exact]


def test_a_drawn_fog_has_its_distribution():
    """A uniform visibility: mean of 2000 scenes within 4 standard errors of (50 + 150) / 2, and both ends seen."""
    found = define_set(scenes=2000, recipes=["tunnel"], fogs=[{"integer": [50, 150]}])
    drawn = np.array([float(one.fogs[0][3:]) for one in scenes(found)])
    assert abs(drawn.mean() - 100.0) < 4 * (101**2 / 12) ** 0.5 / 2000**0.5
    assert drawn.min() == 50 and drawn.max() == 150


def test_what_is_held_out_is_drawn_in_its_split_alone():
    """Of 12 drawn worlds: the models, skies and recipe of the test split are in it, and in no other."""
    found = define_set(
        scenes=12,
        recipes=["motorway", "bridge"],
        splits={
            "train": 2,
            "test": {"share": 1, "models": ["saloon", "lorry"], "skies": ["overcast_noon"], "recipes": ["bridge"]},
        },
    )
    seen = {"train": Counter(), "test": Counter()}
    for one in scenes(found):
        spec = draw(held_out(found, one.source, one.split), seed=one.seed)
        shown = {placed.asset for placed in spec.placed} | {spec.day.sky, spec.dusk.sky, one.source.name}
        seen[one.split.name].update(shown)
    held = {"saloon", "lorry", "overcast_noon", "bridge"}
    assert not held & set(seen["train"]) and held <= set(seen["test"])
    assert {"motorway", "hatchback"} <= set(seen["train"]) & set(seen["test"])


def test_the_shipped_set_for_detectors_keeps_its_promise_by_recipe():
    """No scene but the test's comes from what it holds out."""
    found = load_set(Path("detection"))
    by_split = {split.name: {one.source.name for one in scenes(found) if one.split is split} for split in found.splits}
    assert "roundabout" in by_split["test"]
    assert "roundabout" not in by_split["train"] | by_split["val"]
