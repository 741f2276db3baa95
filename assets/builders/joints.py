"""Joints of the people who walk or pedal, as their models are: what the composer needs to make them move.

Takes the people of `people` and `wayfarers`; gives rows of `nominal.json`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from assets.builders.people import PEOPLE, RIDER, fields_of
from assets.builders.person import Person, kind_of, pose
from assets.builders.wayfarers import CYCLIST, WALKERS
from synfog_usd.world.parameters import WALKERS as WALK

NAMES = {"hips": "thighs", "knees": "knees", "ankles": "ankles", "toes": "toes",
         "shoulders": "shoulders", "elbows": "elbows", "hands": "hands"}  # fmt: skip
"""Joint in `nominal.json` -> in a pose."""
STILL = {"handbag": (True, False), "umbrella": (True, False), "phone": (False, True)}
"""What is carried -> whether the left and the right arm swing."""


def joints() -> dict[str, dict[str, dict[str, Sequence[Sequence[float]] | Sequence[bool]]]]:
    """Model -> individual -> joint -> its places on the left and on the right [m], and which arm swings."""
    walkers = [person for person in (*PEOPLE, *WALKERS) if person.name in WALK]
    riders = {
        name: {"a": {name: places[key] for name, key in NAMES.items()} | {"swings": (False, False)}}
        for name, places in (("rider", RIDER), ("cyclist", CYCLIST))
    }
    return riders | {
        person.name: dict(zip("abcdefg", (_joints(one) for one in kind_of(person)), strict=False)) for person in walkers
    }


def _joints(person: Person) -> dict[str, Sequence[Sequence[float]] | Sequence[bool]]:
    """Of one person, scaled and moved as `people.person_parts` does with the triangles."""
    places = pose(person)
    low, high = _ends(person)
    size = person.height / (high - low)
    rows = {name: np.round(size * (np.array(places[key]) - (0.0, 0.0, low)), 4).tolist() for name, key in NAMES.items()}
    return {**rows, "swings": (False, False) if person.holds else STILL.get(person.carries, (True, True))}


def _ends(person: Person) -> tuple[float, float]:
    """Heights of the lowest point of the shoes and of the highest of the head, before scaling [m]."""
    places = pose(person)
    fields = fields_of(places, person)
    ends = []
    for middle, names, half in (
        (np.mean([places["ankles"], places["toes"]], axis=(0, 1)), ("shoes",), (0.15, 0.75, 0.3)),
        (np.add(places["head"], (0.0, 0.0, 0.1)), ("skin", "hair"), (0.14, 0.16, 0.12)),
    ):
        axes = [np.linspace(m - h, m + h, int(2 * h / 0.006) + 1) for m, h in zip(middle, half, strict=True)]
        grid = np.meshgrid(*axes, indexing="ij")
        inside = np.minimum.reduce([fields[name](*grid) for name in names]) < 0.0
        heights = grid[2][inside]
        ends.append((float(heights.min()), float(heights.max())))
    return ends[0][0], ends[1][1]
