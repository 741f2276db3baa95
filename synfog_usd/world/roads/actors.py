"""Draws of actors that the camera sees: traffic and people are drawn again until the rules of sight are met."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from synfog_usd.base.errors import RecipeError
from synfog_usd.world.language import Recipe
from synfog_usd.world.roads import rules
from synfog_usd.world.roads.network import Road
from synfog_usd.world.roads.props import numbered
from synfog_usd.world.spec import Placement, View

TRIES = 60
MORE = ("traffic.per_hour", "traffic.count", "traffic.ring", "people.count", "parked.share")
"""Parameters that bring road users, in the worlds that have them."""
CHOICES, ENOUGH, HIDDEN_COSTS = 4, 12, 0.5
"""Of so many draws that keep the rules, among the first ENOUGH, the one is taken that shows most road users; one that
is hidden takes half of one away.
"""


def in_sight(
    recipe: Recipe,
    drawn: Callable[[int, rules.CollisionSet], list[Placement]],
    road: Road,
    value: Any,
    view: View,
    fov: float,
    fixed: list[Placement],
    taken: rules.CollisionSet,
) -> list[Placement]:
    """Of the actors that attempt after attempt draws, those that meet the rules of sight best.

    Args:
        recipe: for its name in errors.
        drawn: takes the attempt's number and what stands already.
        road: whose ground may hide something.
        value: parameters by name.
        view: the camera; fov: its horizontal angle of view [degrees].
        fixed: what stands whatever is drawn.
        taken: the room that it takes.

    Raises:
        RecipeError: no attempt meets them; names the rule and the most that was reached.
    """
    users, in_view, within = value("rules.users"), value("rules.in_view"), value("rules.within_m")
    most_users = most_seen = 0
    chosen: tuple[float, list[Placement]] | None = None
    kept = 0
    for attempt in range(TRIES):
        found = drawn(attempt, taken.copy())
        every = numbered([*fixed, *found])
        count = sum(rules.model(p.asset).label in rules.USERS for p in every)
        most_users = max(most_users, count)
        if count < users:
            continue
        shares = rules.visible_shares(view, fov, every, road, within_m=within).values()
        seen = sum(share >= rules.SHARE_SEEN for share in shares)
        most_seen = max(most_seen, seen)
        if seen >= in_view:
            kept += 1
            score = seen - HIDDEN_COSTS * (len(shares) - seen)
            if chosen is None or score > chosen[0]:
                chosen = score, found
            if kept == CHOICES:
                break
        if chosen is not None and attempt + 1 >= ENOUGH:
            break
    if chosen is not None:
        return chosen[1]
    rule, most = (f"users {users}", most_users) if most_users < users else (f"in_view {in_view}", most_seen)
    more = [name for name in MORE if name in recipe.distributions]
    raise RecipeError(
        f"{recipe.name}: rules.{rule} cannot be met: {TRIES} tries gave at most {most}; "
        f"ask for less, or raise {', '.join(more[:-1])} or {more[-1]}"
    )
