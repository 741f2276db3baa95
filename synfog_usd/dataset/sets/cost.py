"""What a set holds, by counting, and when a unit of it has taken so long that it is taken to hang.

Takes a definition and what units took; gives numbers of scenes, shots and files, and a limit [s].
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from synfog_usd.dataset.plan import CLEAR
from synfog_usd.dataset.sets import offers
from synfog_usd.dataset.sets.definition import SetDefinition
from synfog_usd.dataset.sets.journal import Tally
from synfog_usd.dataset.sets.scenes import scenes
from synfog_usd.fog import Fog

UNKNOWN_S = 3600.0
"""Limit of a unit of `UNKNOWN_PX` pixels while nothing is known of its cost."""
UNKNOWN_PX = 4 * 1280 * 720
PATIENCE = 10.0
"""A unit may take this many times what was expected of it."""
LEAST_LIMIT_S = 600.0

OF_VIEW, OF_SHOT = ("bake.json", "labels.exr", "labels.json", "unit.json"), 3
PICTURES = (".png", ".jpg", ".jpeg")


@dataclass(frozen=True)
class Cost:
    """What units were seen to take on the machine at hand.

    Attributes:
        seconds: the most of a unit, by lighting, and under '' the mean of an earlier run.
        unknown_s: limit where there is none.
    """

    seconds: Mapping[str, float] = field(default_factory=dict)
    unknown_s: float = UNKNOWN_S

    @classmethod
    def of_tally(cls, definition: SetDefinition, tally: Tally) -> Cost:
        """From what was made already."""
        width, height = definition.size or (1280, 720)
        unknown = UNKNOWN_S * max(1.0, len(definition.fogs) * width * height / UNKNOWN_PX)
        return cls({"": tally.seconds / tally.units} if tally.units else {}, unknown)

    def with_unit(self, lighting: str, seconds: float) -> Cost:
        """With one unit more."""
        return replace(self, seconds={**self.seconds, lighting: max(seconds, self.seconds.get(lighting, 0.0))})

    def limit_s(self, lighting: str) -> float:
        """Seconds after which a unit is taken to hang."""
        expected = max(self.seconds.get(lighting, 0.0), self.seconds.get("", 0.0))
        return max(LEAST_LIMIT_S, PATIENCE * expected) if expected else self.unknown_s


@dataclass(frozen=True)
class Count:
    """How much a set holds.

    Attributes:
        scenes, shots, files: in all; pictures: those that pipelines make of them.
        units: by lighting; splits: scenes by split; sources: scenes by recipe or glob.
    """

    scenes: int
    shots: int
    pictures: int
    files: int
    units: Mapping[str, int]
    splits: Mapping[str, int]
    sources: Mapping[str, int]


def count(definition: SetDefinition) -> Count:
    """Count a set, scene by scene; memory does not grow with it."""
    from synfog_usd import camera

    definition = offers.with_offers(definition)
    outputs = [camera.load_graph(path).outputs for path in definition.pipelines]
    a_view = len(OF_VIEW) + any(name.endswith(PICTURES) for name in outputs[0])
    a_shot = OF_SHOT + sum(map(len, outputs))
    guessed = [
        len(outputs_of)
        for path, outputs_of in zip(definition.pipelines, outputs, strict=True)
        if path.stem in definition.asm_estimated
    ]
    shots = files = pictures = 0
    units: dict[str, int] = {}
    splits = {split.name: 0 for split in definition.splits}
    sources = {source.name: 0 for source in definition.sources}
    for planned in scenes(definition):
        splits[planned.split.name] += 1
        sources[planned.source.name] += 1
        shots += planned.shots
        foggy = len(planned.units) * sum(fog != CLEAR for fog in planned.fogs)
        pictures += planned.shots * len(definition.pipelines) + foggy * len(guessed)
        files += planned.shots * a_shot + foggy * sum(guessed) + len(planned.units) * a_view
        falling = sum(bool(fog and fog.rates) for fog in map(Fog.named, planned.fogs))
        files += len(planned.units) * falling * (len(definition.pipelines) - 1)  # with the streaks of each
        for lighting in planned.lightings:
            units[lighting] = units.get(lighting, 0) + len(planned.cameras)
    return Count(definition.scenes, shots, pictures, files, units, splits, sources)
