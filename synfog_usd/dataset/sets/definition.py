"""What a data set is: its sources, its splits, and what is made of each scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

from synfog_usd.world.language import Distribution

if TYPE_CHECKING:
    from synfog_usd.camera.graph import NodeGraph

RECIPE_LIGHTINGS = ("sky", "active")
"""What every recipe's stage offers."""

Offer = Mapping[str, Sequence[str]]
"""'lighting', 'fog' -> the variants that a stage has in the set of that name."""


@dataclass(frozen=True)
class Source:
    """Where scenes come from.

    Attributes:
        name: of the recipe, or as the file has the glob.
        share: of the scenes, beside those of the others.
        recipe: file of a recipe, or None.
        stages: files of a glob, sorted, none for a recipe.
    """

    name: str
    share: Fraction
    recipe: Path | None
    stages: tuple[Path, ...] = ()


@dataclass(frozen=True)
class Split:
    """A part of a set that others see nothing of.

    Attributes:
        name: as 'train'.
        share: of the scenes, beside those of the others.
        models, recipes, skies: what only this split may show.
    """

    name: str
    share: Fraction
    models: frozenset[str] = frozenset()
    recipes: frozenset[str] = frozenset()
    skies: frozenset[str] = frozenset()


@dataclass(frozen=True)
class SetDefinition:
    """A set that was read and checked.

    Attributes:
        name: of its file; about: one sentence.
        seed: every scene's seed follows from it and the scene's number.
        scenes: how many.
        sources, splits: in the order of the file.
        changes: 'section.key=value' each, over what recipes say.
        lightings: one for each; a scene has those that are drawn.  None is all that its recipe or stage offers.
        fogs: one for each; drawn as a visibility [m], or a name.
        cameras: prim paths, '' for the stage's own.
        meter: see `BakePlan`; the cameras are one rig.
        pipelines: files of node graphs; radiance is rendered for the first.
        asm_estimated: pipelines that also develop the clear frame in a guessed fog, see `unit`.
        same_noise: see `BakePlan`.
        size: (width, height) [px], or None for the stage's own.
        quality: options of `BakePlan`; exposure: likewise, of all its pipelines.
        folder: where relative paths in `words` start from.
        words: what makes the same set again, as `define_set` takes it.
        offers: what each stage that was read offers, by file; others are read when their scene is planned.
    """

    name: str
    about: str
    seed: int
    scenes: int
    sources: tuple[Source, ...]
    splits: tuple[Split, ...]
    changes: tuple[str, ...]
    lightings: tuple[Distribution, ...]
    fogs: tuple[Distribution, ...]
    cameras: tuple[str, ...]
    meter: str
    pipelines: tuple[Path, ...]
    asm_estimated: tuple[str, ...]
    same_noise: bool
    size: tuple[int, int] | None
    quality: Mapping[str, Any]
    exposure: Mapping[str, float]
    folder: Path
    words: Mapping[str, Any] = field(repr=False)
    offers: Mapping[Path, Offer] = field(default_factory=dict, repr=False, compare=False)


def exposed(graph: NodeGraph, exposure: Mapping[str, float]) -> NodeGraph:
    """A graph as the exposure of a set has it.

    Raises:
        ParameterError: outside what its sensor does.
    """
    from synfog_usd import camera

    return camera.exposed(graph, exposure_s=exposure.get("exposure_s"), iso=exposure.get("iso"))
