"""How far a set is: which of its units are there, and what the journal says of those."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from synfog_usd.dataset.sets import identity, journal, layout
from synfog_usd.dataset.sets.scenes import scenes


@dataclass(frozen=True)
class Status:
    """What `dataset status` tells.

    Attributes:
        name: of the set; scenes: how many it has.
        units, shots: that it is to have; made: units that are finished.
        bytes: that they take; left_s: processor seconds of what is left, None while nothing is known.
        running: whether a run holds the folder.
        aside: unit that failed too often -> its error and seed.
    """

    name: str
    scenes: int
    units: int
    shots: int
    made: int
    bytes: int
    left_s: float | None
    running: bool
    aside: dict[str, dict[str, Any]]


def status(out: Path) -> Status:
    """How far a set is.

    Raises:
        SetError: no set lies there.
    """
    made_of = identity.read(out)
    definition, done = journal.kept_definition(out), journal.tally(out)
    units = shots = count = 0
    for planned in scenes(definition):
        units += len(planned.units)
        shots += planned.shots
        count += sum((out / unit.folder / layout.UNIT).exists() for unit in planned.units)
    each = 1 / done.units if done.units else None
    left_s = (units - count) * done.cpu_s * each if each else None
    aside = {name: {"error": line["error"], "seed": line["seed"]} for name, line in done.aside.items()}
    return Status(
        name=made_of["name"],
        scenes=definition.scenes,
        units=units,
        shots=shots,
        made=count,
        bytes=round(count * done.bytes * each) if each else 0,
        left_s=left_s,
        running=journal.under_way(out),
        aside=aside,
    )
