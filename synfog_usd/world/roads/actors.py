"""Draws of actors that the camera sees: traffic and people are drawn again until the rules of sight are met."""

from __future__ import annotations

from collections.abc import Callable

from synfog_usd.base.errors import RecipeError
from synfog_usd.world import library
from synfog_usd.world.language import Draws
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
    draws: Draws,
    attempts: Callable[[int, rules.CollisionSet], list[Placement]],
    road: Road,
    view: View,
    fov_x_deg: float,
    fixed: list[Placement],
    occupied: rules.CollisionSet,
) -> list[Placement]:
    """Of the actors that attempt after attempt draws, those that meet the rules of sight best.

    Args:
        draws: for the rules, and the recipe's name in errors.
        attempts: takes the attempt's number and what stands already.
        road: whose ground may hide something.
        view: the camera; fov_x_deg: its horizontal angle of view.
        fixed: what stands in every attempt.
        occupied: the room that it takes.

    Raises:
        RecipeError: no attempt meets them; names the rule and the most that was reached.
    """
    least_users, least_visible = draws.whole("rules.users"), draws.whole("rules.in_view")
    within_m = draws.number("rules.within_m")
    most_users = most_visible = 0
    candidates: list[tuple[float, list[Placement]]] = []
    for attempt in range(TRIES):
        actors = attempts(attempt, occupied.copy())
        every = numbered([*fixed, *actors])
        count = sum(library.model(p.asset).label in rules.USERS for p in every)
        most_users = max(most_users, count)
        if count >= least_users:
            shares = rules.visible_shares(view, fov_x_deg, every, road, within_m=within_m).values()
            visible = sum(share >= rules.SHARE_SEEN for share in shares)
            most_visible = max(most_visible, visible)
            if visible >= least_visible:
                candidates.append((visible - HIDDEN_COSTS * (len(shares) - visible), actors))
            if len(candidates) == CHOICES or (candidates and attempt + 1 >= ENOUGH):
                break
    if candidates:
        return max(candidates, key=lambda candidate: candidate[0])[1]
    users_lack = most_users < least_users
    rule, most = (f"users {least_users}", most_users) if users_lack else (f"in_view {least_visible}", most_visible)
    more = [name for name in MORE if name in draws.recipe.distributions]
    raise RecipeError(
        f"{draws.recipe.name}: rules.{rule} cannot be met: {TRIES} tries gave at most {most}; "
        f"ask for less, or raise {', '.join(more[:-1])} or {more[-1]}"
    )
