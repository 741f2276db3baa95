"""What stages of a user's own offer a set: which lightings and fogs they have by name.

A stage without a variant set of a kind is lit, or fogged, as it is authored, whatever names the set has for others.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from synfog_usd.base import isolated
from synfog_usd.base.errors import SetError, StageError, did_you_mean
from synfog_usd.base.numbers import fog_fault
from synfog_usd.dataset.plan import AS_AUTHORED, offered_names, visibility_of
from synfog_usd.dataset.sets.definition import RECIPE_LIGHTINGS, Offer, SetDefinition

KINDS = {"lighting": "lightings", "fog": "fogs"}
"""Variant set -> section of a set's file."""


def of_stage(path: Path) -> Offer:
    """Variants by set; none of a stage that cannot be opened: of that its bake will tell."""
    try:
        return _of_file(path, path.stat().st_mtime_ns)
    except (StageError, OSError):
        return {}


@functools.lru_cache(maxsize=4096)
def _of_file(path: Path, changed_ns: int) -> Offer:
    from synfog_usd import stage as usd

    return usd.offered(path)


def of_stages(paths: Sequence[Path]) -> dict[Path, Offer]:
    """Likewise of several."""
    return {path: of_stage(path) for path in paths}


def ask_child(stages: Sequence[Path]) -> dict[Path, Offer]:
    """`of_stages` in a child, since a stage may take its reader down.  That one offers nothing, and its bake tells."""
    offers: dict[Path, Offer] = {}
    while remaining := [path for path in stages if path not in offers]:
        lines = isolated.answer(("dataset", "offers"), "\n".join(map(str, remaining)))
        read = [json.loads(line) for line in lines if line.endswith("}")]
        offers |= dict(zip(remaining, [*read, {}], strict=False))
    return offers


def with_offers(
    definition: SetDefinition, read: Callable[[Sequence[Path]], Mapping[Path, Offer]] = of_stages
) -> SetDefinition:
    """The set with what all its stages offer.

    Args:
        definition: the set.
        read: `of_stages`, or `asked`.

    Raises:
        SetError: the set names what none of its stages has.
    """
    stages = dict.fromkeys(path for source in definition.sources for path in source.stages)
    offers = {**definition.offers, **read([path for path in stages if path not in definition.offers])} if stages else {}
    definition = replace(definition, offers=offers)
    recipes = any(source.recipe for source in definition.sources)
    for kind, section in KINDS.items():
        there = {AS_AUTHORED: None} | {name: None for path in stages for name in offers[path].get(kind, ())}
        there |= dict.fromkeys(RECIPE_LIGHTINGS if kind == "lighting" and recipes else ())
        for distribution in definition.lightings if kind == "lighting" else definition.fogs:
            for name in distribution.values if distribution.kind in ("fixed", "choice") else ():
                usual = name in RECIPE_LIGHTINGS if kind == "lighting" else _needs_no_variant(name)
                if usual or name in there:
                    continue
                if kind == "fog" and (fault := fog_fault(name)):
                    raise SetError(f"{definition.name}: {section} has {name!r}: {fault}")
                if not (recipes and kind == "fog"):
                    free = ", and all take clear and visibilities" if kind == "fog" else ""
                    raise SetError(
                        f"{definition.name}: {section} has {name!r}, which no stage of the set has; they have "
                        f"{', '.join(there)}{free}.{did_you_mean(str(name), there)}"
                    )
    return definition


def chosen(definition: SetDefinition, stage: Path, kind: str, names: Sequence[str]) -> tuple[str, ...]:
    """The lightings or fogs of a stage in a set.

    Args:
        definition: the set.
        stage: a file of its stages.
        kind: 'lighting' or 'fog'.
        names: names that the set has for the scene; none for all that the stage has.

    Raises:
        SetError: the stage has variants, and one that is asked for is not among them.
    """
    there = (definition.offers[stage] if stage in definition.offers else of_stage(stage)).get(kind, ())
    if not names:
        return tuple(offered_names(there))
    result = [name if there or (kind == "fog" and _needs_no_variant(name)) else AS_AUTHORED for name in names]
    for name in result:
        if name not in (*there, AS_AUTHORED) and not (kind == "fog" and _needs_no_variant(name)):
            raise SetError(
                f"{stage}: has the {KINDS[kind]} {', '.join(there)}, and the set {definition.name!r} asks for "
                f"{name!r}; name some of them under {KINDS[kind]}, or {AS_AUTHORED} for the stage as it is."
                f"{did_you_mean(name, there)}"
            )
    return tuple(dict.fromkeys(result))


def _needs_no_variant(fog: str | float) -> bool:
    """Whether any stage can be put into a fog: into one of a visibility or weather, as into clear air."""
    return not isinstance(fog, str) or visibility_of(fog) is not None
