"""What each scene of a set is: its split, source, seed, lightings and fogs, from the set and a number alone.

Any scene can be planned, and made, without the others, and a growing set keeps those that it has.  Splits and sources
are dealt out evenly: of the first N scenes each has its share, to one scene.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

from synfog_usd.base.errors import SetError
from synfog_usd.base.seeds import seed32, stream
from synfog_usd.dataset.sets import offers
from synfog_usd.dataset.sets.definition import RECIPE_LIGHTINGS, SetDefinition, Source, Split
from synfog_usd.dataset.sets.layout import Unit
from synfog_usd.fog import Fog
from synfog_usd.world.language import Distribution, Recipe


@dataclass(frozen=True)
class PlannedScene:
    """One scene before it is made.

    Attributes:
        number, seed: the seed follows from the set's and the number.
        split, source: where it belongs, and what draws it.
        stage: a file of the user's own, or None where a recipe draws it.
        lightings: names; fogs: names as `bake` takes them.
        cameras: prim paths.
    """

    number: int
    seed: int
    split: Split
    source: Source
    stage: Path | None
    lightings: tuple[str, ...]
    fogs: tuple[str, ...]
    cameras: tuple[str, ...]

    @property
    def units(self) -> tuple[Unit, ...]:
        """What is made of it, lightings outside."""
        return tuple(Unit(self.number, lighting, camera) for lighting in self.lightings for camera in self.cameras)

    @property
    def shots(self) -> int:
        """How many there are."""
        return len(self.lightings) * len(self.cameras) * len(self.fogs)


def scenes(definition: SetDefinition, only: Iterable[int] | None = None) -> Iterator[PlannedScene]:
    """The scenes of a set, one at a time.

    Args:
        definition: the set.
        only: numbers; all of them if left out.
    """
    deal = assignment(definition)
    for number in range(definition.scenes) if only is None else only:
        yield _scene(definition, number, deal)


def scene(definition: SetDefinition, number: int) -> PlannedScene:
    """One scene.

    Raises:
        SetError: the set has no such scene.
    """
    if not 0 <= number < definition.scenes:
        raise SetError(f"{definition.name}: no scene {number}; it has 0 to {definition.scenes - 1}")
    return _scene(definition, number, assignment(definition))


def _scene(definition: SetDefinition, number: int, deal: Assignment) -> PlannedScene:
    seed = seed32(definition.seed, "scene", number)
    split, source, rank = deal(number)
    drawn_fogs = [_drawn(distribution, seed, "fog", index) for index, distribution in enumerate(definition.fogs)]
    fogs = tuple(dict.fromkeys(fog if isinstance(fog, str) else f"mor{fog:g}" for fog in drawn_fogs))
    lights = (
        str(_drawn(distribution, seed, "lighting", index)) for index, distribution in enumerate(definition.lightings)
    )
    lightings, stage = tuple(dict.fromkeys(lights)), None
    if source.stages:
        stage = deal.stage(split, source, rank)
        lightings, fogs = (
            offers.chosen(definition, stage, "lighting", lightings),
            offers.chosen(definition, stage, "fog", fogs),
        )
    return PlannedScene(number, seed, split, source, stage, lightings or RECIPE_LIGHTINGS, fogs, definition.cameras)


def _drawn(distribution: Distribution, seed: int, *names: str | int) -> object:
    return distribution.values[0] if distribution.kind == "fixed" else distribution(stream(seed, "set", *names))


def even(number: int, shares: Sequence[Fraction]) -> tuple[int, int]:
    """Whose turn it is, where each of several has a share, and how often it was before.

    Of every first N numbers, the k-th of the shares has its part of what those before it leave, rounded.

    >>> [even(n, (Fraction(2), Fraction(1)))[0] for n in range(6)]
    [0, 1, 0, 0, 1, 0]
    """
    rank, rest = number, sum(shares)
    for index, share in enumerate(shares):
        part = share / rest if rest else Fraction(1)
        before, after = _dealt(rank, part), _dealt(rank + 1, part)
        if after > before or index == len(shares) - 1:
            return index, before if index < len(shares) - 1 else rank
        rank, rest = rank - before, rest - share
    raise AssertionError("no shares")


def _dealt(count: int, part: Fraction) -> int:
    """How many of the first `count` have a part of them: rounded, halves up."""
    return (2 * count * part.numerator + part.denominator) // (2 * part.denominator)


class Assignment:
    """Scene -> split, source, and which of its source's scenes within the split it is.

    Raises:
        SetError: a split is left without a source, or a glob has fewer stages than scenes.
    """

    def __init__(self, definition: SetDefinition) -> None:
        self.splits = definition.splits
        self.shares = [split.share for split in definition.splits]
        self.sources: dict[str, list[Source]] = {}
        for split in definition.splits:
            held_elsewhere = frozenset[str]().union(
                *(rival.recipes for rival in definition.splits if rival is not split)
            )
            self.sources[split.name] = [source for source in definition.sources if source.name not in held_elsewhere]
            if not self.sources[split.name]:
                raise SetError(f"{definition.name}: every recipe and stage is held out of the split {split.name!r}")
        self.stages = {
            (split.name, source.name): files
            for source in definition.sources
            for split, files in self._parted(source)
            if source.stages
        }
        self._enough(definition)

    def __call__(self, number: int) -> tuple[Split, Source, int]:
        """Split and source of a scene, and which of its source's scenes within the split it is."""
        which, rank = even(number, self.shares)
        split = self.splits[which]
        sources = self.sources[split.name]
        chosen, place = even(rank, [source.share for source in sources])
        return split, sources[chosen], place

    def stage(self, split: Split, source: Source, rank: int) -> Path:
        """The stage of a glob for its scene `rank` within a split; no two splits share one."""
        return self.stages[split.name, source.name][rank]

    def _parted(self, source: Source) -> Iterator[tuple[Split, list[Path]]]:
        """The stages of a glob for each split."""
        takers = [split for split in self.splits if source in self.sources[split.name]]
        dealt: dict[str, list[Path]] = {split.name: [] for split in takers}
        for index, path in enumerate(source.stages):
            which, _ = even(index, [split.share for split in takers])
            dealt[takers[which].name].append(path)
        yield from ((split, dealt[split.name]) for split in takers)

    def _enough(self, definition: SetDefinition) -> None:
        if not self.stages:
            return
        needed: dict[tuple[str, str], int] = {}
        for number in range(definition.scenes):
            split, source, rank = self(number)
            if source.stages:
                needed[split.name, source.name] = rank + 1
        for (split_name, name), count in needed.items():
            there = len(self.stages[split_name, name])
            if count > there:
                raise SetError(
                    f"{definition.name}: {count} scenes of the split {split_name!r} are to come from {name!r}, which "
                    f"has {there} stages for it; ask for fewer scenes, or add recipes"
                )


def assignment(definition: SetDefinition) -> Assignment:
    """What deals the scenes of a set out.

    Raises:
        SetError: it cannot be done.
    """
    return Assignment(definition)


def held_out(definition: SetDefinition, source: Source, split: Split) -> Recipe:
    """A recipe as one split may draw from it: without the models and skies that others hold for themselves.

    Raises:
        RecipeError: the recipe does not load.
        SetError: nothing is left of one of its choices.
    """
    from synfog_usd.world.compose import load

    assert source.recipe is not None
    recipe = load(source.recipe, definition.changes)
    gone = frozenset[str]().union(
        *(rival.models | rival.skies for rival in definition.splits if rival is not split)
    ) - (split.models | split.skies)
    if not gone:
        return recipe

    def without_held(distributions: Mapping[str, Distribution]) -> dict[str, Distribution]:
        return {
            name: _without(distribution, gone, f"{source.name}: {name}", split)
            for name, distribution in distributions.items()
        }

    return replace(
        recipe,
        distributions=without_held(recipe.distributions),
        rows=tuple(replace(row, distributions=without_held(row.distributions)) for row in recipe.rows),
    )


def with_weather(recipe: Recipe, fogs: Sequence[str]) -> Recipe:
    """A recipe that draws a variant for the rain and the snow of a scene, in which its road is wet."""
    named = {name: Fog.named(name) for name in fogs}
    falling = tuple(Distribution("fixed", (name,)) for name, fog in named.items() if fog is not None and fog.rates)
    return replace(recipe, fog=(*recipe.fog, *falling)) if falling else recipe


def _without(distribution: Distribution, gone: frozenset[str], what: str, split: Split) -> Distribution:
    if distribution.kind != "choice" or not gone & set(distribution.values):
        return distribution
    pairs = [
        (value, weight)
        for value, weight in zip(distribution.values, distribution.weights, strict=True)
        if value not in gone
    ]
    if not pairs:
        raise SetError(
            f"{what} has nothing left for the split {split.name!r}: {', '.join(distribution.values)} are held out"
        )
    return replace(
        distribution, values=tuple(value for value, _ in pairs), weights=tuple(weight for _, weight in pairs)
    )
