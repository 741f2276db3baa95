"""People on pavements and zebras: one code for every road and junction.

A road or junction says where somebody may be; who is there, alone or in company, is drawn here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from synfog_usd.base.errors import RecipeError
from synfog_usd.world import library
from synfog_usd.world.language import Recipe
from synfog_usd.world.parameters import WALKERS
from synfog_usd.world.roads import rules
from synfog_usd.world.roads.props import look
from synfog_usd.world.spec import Placement

COMPANY = ("man_walking", "woman_walking", "student", "child", "schoolgirl", "old_man", "woman_pram")
"""Who walks in company at times."""
A_THIRD = 0.25
"""Chance that two become three."""
APART_M, ABREAST_M = 0.12, 0.03
"""Room between strangers, and between those who walk together."""

Places = Iterator[tuple[float, float, float, float] | None]
"""x, y, z [m] and heading [degrees] of one after the other of a group; None where one of them may not be."""


@dataclass(frozen=True)
class Footways:
    """Where people may be at a road or junction.

    Attributes:
        places: (numbers, whether they cross, whether they walk) -> places for a group, drawn as they are asked for.
        zebras: whether anybody can cross.
        most: people in a group.
        tries: places for each group; in the second half of them one walks alone.
        redressed: whether clothes are drawn at every place that is tried, not once.
    """

    places: Callable[[np.random.Generator, bool, bool], Places]
    zebras: bool = True
    most: int = 3
    tries: int = 120
    redressed: bool = False


def walking(
    recipe: Recipe,
    footways: Footways,
    numbers: Callable[[int], np.random.Generator],
    room: rules.Room,
    *,
    count: int,
    crossing_share: float,
    company: float,
) -> list[Placement]:
    """So many people, on pavements and on zebra crossings; some walk in company, side by side.

    Args:
        recipe: says who there is.
        footways: where they may be.
        numbers: random numbers of the group with a number.
        room: what stands already.
        count: of people.
        crossing_share: of the groups, who are on a zebra.
        company: share of those who can that do not walk alone.

    Raises:
        RecipeError: there is no room for so many.
    """
    kinds = recipe.distributions["people.kinds"]
    walkers = [name for name in WALKERS if name in kinds.values]
    friends = [name for name in walkers if name in COMPANY]
    placed: list[Placement] = []
    number = 0
    while len(placed) < count:
        rng = numbers(number)
        number += 1
        crosses = bool(walkers) and footways.zebras and rng.random() < crossing_share
        names = [kinds.word(rng, walkers if crosses else None)]
        if footways.most > 1 and names[0] in COMPANY and rng.random() < company:
            company_of = 2 if footways.most > 2 and rng.random() < A_THIRD else 1
            names += [kinds.word(rng, friends) for _ in range(min(company_of, count - len(placed) - 1))]
        looks = None if footways.redressed else [look(rng, library.model(name)) for name in names]
        for attempt in range(footways.tries):
            group = names if attempt < footways.tries // 2 else names[:1]
            places = footways.places(rng, crosses, names[0] in WALKERS)
            if together := _together(rng, group, looks, places, room):
                placed += together
                break
        else:
            raise RecipeError(
                f"{recipe.name}: people.count {count}: no room for more than {len(placed)} after {footways.tries} tries"
            )
    return placed


def _together(
    rng: np.random.Generator,
    names: Sequence[str],
    looks: Sequence[dict[str, str]] | None,
    places: Places,
    room: rules.Room,
) -> list[Placement]:
    """A group at its places; nobody where one of them has no room."""
    group: list[Placement] = []
    trial = room.copy() if len(names) > 1 else room
    for index, (name, place) in enumerate(zip(names, places, strict=False)):
        worn = look(rng, library.model(name)) if looks is None else dict(looks[index])
        if place is None:
            return []
        x, y, z, heading = place
        p = Placement("People", "", name, x, y, heading, worn, z=z)
        if not trial.take(p, ABREAST_M if group else APART_M):
            return []
        group.append(p)
    if trial is not room:
        for p in group:
            room.add(p)
    return group
