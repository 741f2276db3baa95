"""What stands along a road and does not move: rows of things, one code for every road and junction.

A road or junction says along which line a row stands, and where on it there is a place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from synfog_usd.world import library
from synfog_usd.world.language import Distribution
from synfog_usd.world.library import LibraryModel
from synfog_usd.world.roads import rules
from synfog_usd.world.spec import Placement

NUDGES, NUDGE_M = 16, 0.3
"""Things that stand end to end need more room inside a bend: so often, and by so much, they are moved on."""
WALL_M, APART_M = 0.02, 0.1
"""Room round a building, and round anything else."""
UNDRAWN = ("lamps", "signal", "lod", "driver", "plate", "shops")


def look(rng: np.random.Generator, model: LibraryModel) -> dict[str, str]:
    """A choice of each variant set but those of lamps, signals, detail and drivers, whom traffic has; and not which of
    a kind of people it is, which is drawn last of all.
    """
    return {
        name: choices[int(rng.integers(len(choices)))]
        for name, choices in sorted(model.variants.items())
        if name not in UNDRAWN and not (name == "individual" and model.group == "person")
    }


@dataclass(frozen=True)
class Prop:
    """A thing of a row, before it has a place.

    Attributes:
        asset: its model; size: scale.
        turned: how it stands to the road: 'road', 'back', 'traffic', 'along' or 'any'.
        any_way: heading where it is turned any way [degrees].
        out: distance from the line that the row counts from [m].
        looks: variants.
    """

    asset: str
    size: float
    turned: str
    any_way: float
    out: float
    looks: dict[str, str]


Places = Callable[[Prop, Sequence[float]], Iterator[tuple[float, Placement]]]
"""(thing, stations to try [m]) -> each station that has a place for it, with the thing there."""


@dataclass(frozen=True)
class Front:
    """The line along which a row stands.

    Attributes:
        places: where on it a thing may be.
        end: where the row ends [m].
        start: where it begins [m], or None: somewhere within its first step.
        joint: room between things that stand end to end [m].
        order: in which the numbers of a thing are drawn, so that a seed draws the same for ever.
    """

    places: Places
    end: float
    start: float | None = None
    joint: float = APART_M
    order: tuple[str, ...] = ("any_way", "looks", "out")


def row(
    distributions: Mapping[str, Distribution], front: Front, rng: np.random.Generator, room: rules.Room
) -> list[Placement]:
    """Things one after the other, each a step or its own length and a gap on; what has no room is left out."""
    draw: Mapping[str, Callable[[LibraryModel], Any]] = {
        "out": lambda model: float(distributions["out_m"].number(rng)),
        "any_way": lambda model: float(rng.uniform(0, 360)),
        "looks": lambda model: look(rng, model),
    }
    placed: list[Placement] = []
    s = front.start
    while s is None or s < front.end:
        asset, turned = distributions["models"].word(rng), distributions["turn"].word(rng)
        model, size = library.model(asset), round(float(distributions["size"].number(rng)), 3)
        extent = (model.width if turned in ("road", "back") else model.length) * size
        step, gap = optional(distributions["step_m"], rng), float(distributions["gap_m"].number(rng))
        if s is None:
            s = float(rng.random()) * (step or extent)
        middle = s if step is not None else s + extent / 2
        s += step if step is not None else extent + gap
        there = rng.random() < distributions["share"].number(rng)
        numbers = {name: draw[name](model) for name in front.order}
        if not there:
            continue
        margin = WALL_M if model.group == "building" else APART_M if step is not None else front.joint
        tried = [middle + NUDGE_M * nudge for nudge in range(NUDGES if step is None else 1)]
        for at, p in front.places(Prop(asset, size, turned, **numbers), tried):
            if room.take(p, margin):
                placed.append(p)
                s += at - middle if step is None else 0.0
                break
    return placed


def optional(distribution: Distribution, rng: np.random.Generator) -> float | None:
    """A number, or None where the row does without."""
    return None if distribution.values[0] is None else float(distribution.number(rng))


def standing(
    asset: str, place: tuple[float, float, float], heading: float, looks: Mapping[str, str], size: float = 1.0
) -> Placement:
    """A thing at x, y, z [m] that looks along a heading [degrees], in the group of its kind."""
    x, y, z = place
    group = rules.prim_group(library.model(asset))
    return Placement(group, "", asset, x, y, heading, looks, z=z, size=size)


def numbered(placed: Sequence[Placement]) -> list[Placement]:
    """With prim names of model and number."""
    counts: dict[str, int] = {}
    result = []
    for p in placed:
        counts[p.asset] = counts.get(p.asset, 0) + 1
        result.append(replace(p, name=f"{p.asset.title()}_{counts[p.asset]:02d}"))
    return result
