"""A set from YAML or from Python, checked.

A file says which recipes or stages a set draws from, in which lightings and fogs, through which cameras and pipelines,
how large, how clean, and into which splits.  Every mistake has its file, line and column.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeVar

from synfog_usd.base import numbers, resources, yamlio
from synfog_usd.base.errors import RecipeError, SetError, SynfogError, did_you_mean
from synfog_usd.base.yamlio import Located, from_python, load_file
from synfog_usd.dataset.asked import OPTIONS
from synfog_usd.dataset.plan import AS_AUTHORED, CLEAR, METERS, Exposing, Sampling
from synfog_usd.dataset.sets.definition import RECIPE_LIGHTINGS, SetDefinition, Source, Split, exposed
from synfog_usd.world.language import (
    FOG,
    Categorical,
    Continuous,
    Distribution,
    Parameter,
    mapping,
    read_distribution,
)

Read = TypeVar("Read")

SCHEMA = "set/1"
SECTIONS = (
    *("synfog", "about", "extends", "seed", "scenes", "recipes", "stages", "changes", "lightings", "fogs", "cameras"),
    *("pipelines", "meter", "asm_estimated", "same_noise", "size", "quality", "exposure", "splits"),
)
QUALITY = ("word", "model", "samples", "target_error", "bands")
EXPOSURE = {"time": "exposure_s", "iso": "iso", "ev": "ev"}
"""Key of a set's exposure -> what `BakePlan` calls it."""
HELD_OUT = ("models", "recipes", "skies")
MOST_SCENES = 1_000_000
MOST_EXTENDS = 8
OWN_CAMERA = "own"


def load_set(path: Path) -> SetDefinition:
    """Read a set's file.

    Args:
        path: a file, or the name of a set that ships, as 'mini'.

    Raises:
        SetError, RecipeError: with file, line and column of what is wrong.
    """
    path = resources.named(path, "data set")
    return _SetReader(path.stem, path.parent).read(load_file(path, error=SetError))


def define_set(name: str = "set", *, folder: Path = Path(), **words: Any) -> SetDefinition:
    """A set from Python: the words of the YAML, the same checks.

    Args:
        name: what errors call the set.
        folder: where paths in it start from.
        words: sections of the file.

    Raises:
        SetError, RecipeError: with the place as in 'splits.train'.

    >>> define_set(scenes=0)
    Traceback (most recent call last):
    ...
    synfog_usd.base.errors.RecipeError: scenes: scenes 0 is outside 1 to 1e+06
    """
    return _SetReader(name, folder).read(from_python({"synfog": SCHEMA, **words}, name=name))


def shipped() -> dict[str, Path]:
    """The sets that ship, by name."""
    return resources.shipped("data set")


class _SetReader:
    def __init__(self, name: str, folder: Path) -> None:
        self.name, self.folder = name, folder.resolve()

    def read(self, root: Located) -> SetDefinition:
        """The whole file."""
        items = self.extended(root, 0)

        def of(section: str, reader: Callable[[Located], Read], otherwise: Read) -> Read:
            return reader(items[section]) if section in items else otherwise

        scenes = of("scenes", lambda item: whole(item, "scenes", 1, MOST_SCENES), None)
        if scenes is None:
            raise SetError(f"{root.place}: the set has no 'scenes'; it takes how many there are, as in scenes: 100")
        none: tuple[Source, ...] = ()
        sources = (*of("recipes", self.recipes, none), *of("stages", self.stages, none))
        if not sources:
            raise SetError(f"{root.place}: the set has neither 'recipes' nor 'stages' to draw from")
        definition = SetDefinition(
            name=self.name,
            about=of("about", lambda item: text(item, "about"), ""),
            seed=of("seed", lambda item: whole(item, "seed", 0, 2**63 - 1), 0),
            scenes=scenes,
            sources=sources,
            splits=of("splits", self.splits, (Split("all", Fraction(1)),)),
            changes=of("changes", self.changes, ()),
            lightings=of(
                "lightings",
                lambda item: self.lightings(item, any(source.stages for source in sources)),
                (),
            ),
            fogs=of("fogs", self.fogs, tuple(fixed(name) for name in (CLEAR, 600, 300, 150))),
            cameras=of("cameras", self.cameras, ("",)),
            pipelines=of("pipelines", self.pipelines, (resources.folder("pipeline") / "synfog.yaml",)),
            asm_estimated=of("asm_estimated", self.asm_estimated, ()),
            meter=of("meter", self.meter, METERS[0]),
            same_noise=of("same_noise", lambda item: switch(item, "same_noise"), False),
            size=of("size", self.size, None),
            quality=of("quality", self.quality, {}),
            exposure=of("exposure", self.exposure, {}),
            folder=self.folder,
            words={},
        )
        self.check(definition, items)
        return replace(definition, words=self.words(definition, items))

    def extended(self, root: Located, depth: int) -> dict[str, Located]:
        """Sections of the file, over those of the one that it extends: a section replaces the whole other."""
        if not isinstance(root.value, dict):
            raise SetError(f"{root.place}: a set is a mapping that begins with 'synfog: {SCHEMA}'")
        mark = root.value.get("synfog")
        if mark is None or mark.value != SCHEMA:
            raise SetError(
                f"{(mark or root).place}: synfog is {mark.plain() if mark else 'missing'}; this program reads "
                f"{SCHEMA!r}"
            )
        items = {key: item for key, item in mapping(root, "a set", SECTIONS).items() if key != "synfog"}
        if "extends" not in items:
            return items
        base = items.pop("extends")
        if depth == MOST_EXTENDS:
            raise SetError(f"{base.place}: more than {MOST_EXTENDS} files extend each other; is one of them its own?")
        path = self.file(base, "extends", shipped(), "datasets")
        return {**self.extended(load_file(path, error=SetError), depth + 1), **items}

    def file(
        self, item: Located, what: str, shipped_files: Mapping[str, Path], folder: str, name: str | None = None
    ) -> Path:
        """A file that is named or lies beside the file that names it."""
        word = name if name is not None else text(item, what)
        if word in shipped_files:
            return shipped_files[word]
        place = (item.key_place if name is not None else None) or item.place
        path = self.folder_of(item) / word
        if path.suffix == ".yaml" and path.is_file():
            return path.resolve()
        raise SetError(
            f"{place}: {what} has no {word!r}; it takes the path of a file (.yaml), or a name of those that ship: "
            f"{', '.join(shipped_files)}.{did_you_mean(word, shipped_files)}"
        )

    def folder_of(self, item: Located) -> Path:
        """Where paths of an item start from: the folder of its file."""
        path = Path(item.place.file)
        return path.parent.resolve() if path.suffix == ".yaml" and path.is_file() else self.folder

    def shares(self, item: Located, what: str) -> list[tuple[str, Fraction, Located]]:
        """Names with shares from a mapping, or equal ones from a list."""
        if isinstance(item.value, list) and item.value:
            return [(text(entry, what), Fraction(1), entry) for entry in item.value]
        if isinstance(item.value, dict) and item.value:
            return [(key, share(entry, f"{what}: the share of {key!r}"), entry) for key, entry in item.value.items()]
        raise SetError(f"{item.place}: {what} is {item.plain()!r}; it takes a list of names, or {{name: share, ...}}")

    def recipes(self, item: Located) -> tuple[Source, ...]:
        shipped_recipes = resources.shipped("recipe")
        sources = []
        for name, part, entry in self.shares(item, "recipes"):
            path = self.file(entry, "recipes", shipped_recipes, "recipes", name)
            sources.append(Source(path.stem, part, path))
        return _different(sources, item)

    def stages(self, item: Located) -> tuple[Source, ...]:
        sources = []
        for name, part, entry in self.shares(item, "stages"):
            pattern, place = Path(name), entry.key_place or entry.place
            base = Path(pattern.anchor) if pattern.is_absolute() else self.folder_of(entry)
            name = name if base in (self.folder, Path(pattern.anchor)) else os.path.relpath(base / name, self.folder)
            try:
                paths = sorted(base.glob(str(pattern.relative_to(pattern.anchor))))
            except (ValueError, NotImplementedError) as error:
                raise SetError(f"{place}: stages: {name!r} is no pattern of files ({error})") from error
            paths = [path.resolve() for path in paths if path.suffix in (".usd", ".usda", ".usdc", ".usdz")]
            if not paths:
                raise SetError(f"{place}: stages: {name!r} matches no USD file below {base.resolve()}")
            sources.append(Source(name, part, None, tuple(paths)))
        return _different(sources, item)

    def changes(self, item: Located) -> tuple[str, ...]:
        import json

        if not isinstance(item.value, dict):
            raise SetError(f"{item.place}: changes is {item.plain()!r}; it takes {{section.key: value, ...}}")
        return tuple(f"{key}={json.dumps(entry.plain())}" for key, entry in item.value.items())

    def lightings(self, item: Located, foreign: bool) -> tuple[Distribution, ...]:
        if item.value == []:
            return ()
        names = dict.fromkeys(RECIPE_LIGHTINGS)
        if foreign:
            names |= dict.fromkeys([AS_AUTHORED, *re.findall(r"[\w.|-]+", str(item.plain()))])
        parameter = Categorical(tuple(names), "sky")
        return tuple(read_distribution(entry, "lightings", parameter) for entry in entries(item, "lightings"))

    def fogs(self, item: Located) -> tuple[Distribution, ...]:
        distributions = []
        for entry in entries(item, "fogs"):
            named = isinstance(entry.value, str)
            if named and re.fullmatch(r"[A-Za-z_][\w.+-]*", entry.value):
                distributions.append(fixed(entry.value))
            elif named:
                raise SetError(f"{entry.place}: fogs: {entry.value!r} is no name; 600 is a visibility of 600 m")
            else:
                distributions.append(read_distribution(entry, "fogs", FOG))
        return tuple(distributions)

    def cameras(self, item: Located) -> tuple[str, ...]:
        paths = []
        for entry in entries(item, "cameras"):
            name = text(entry, "cameras")
            if name != OWN_CAMERA and not re.fullmatch(r"(/\w+)+", name):
                raise SetError(f"{entry.place}: cameras has {name!r}; it takes prim paths, or {OWN_CAMERA}")
            paths.append("" if name == OWN_CAMERA else name)
        names = [name.rsplit("/", 1)[-1] for name in paths]
        if len(set(names)) < len(names):
            raise SetError(f"{item.place}: cameras: two have the same name; their folders would be one")
        return tuple(paths)

    def meter(self, item: Located) -> str:
        if item.value not in METERS:
            raise SetError(f"{item.place}: meter is {item.plain()!r}; it takes {' or '.join(METERS)}")
        return str(item.value)

    def pipelines(self, item: Located) -> tuple[Path, ...]:
        shipped_graphs = resources.shipped("pipeline")
        paths = [self.file(entry, "pipelines", shipped_graphs, "pipeline") for entry in entries(item, "pipelines")]
        if len({path.stem for path in paths}) < len(paths):
            raise SetError(f"{item.place}: pipelines: two have the same name; their folders would be one")
        return tuple(paths)

    def asm_estimated(self, item: Located) -> tuple[str, ...]:
        listed = entries(item, "asm_estimated") if item.value != [] else []
        return tuple(dict.fromkeys(text(entry, "asm_estimated") for entry in listed))

    def size(self, item: Located) -> tuple[int, int]:
        listed = entries(item, "size", "[width, height] in pixels")
        if len(listed) != 2:
            raise SetError(f"{item.place}: size is {item.plain()!r}; it takes [width, height] in pixels")
        width, height = (whole(entry, "size", 1, 16384) for entry in listed)
        return width, height

    def quality(self, item: Located) -> dict[str, Any]:
        from synfog_usd.render.models import check_name

        is_word, options = isinstance(item.value, str), {}
        for key, entry in ({"word": item} if is_word else mapping(item, "quality", QUALITY)).items():
            name = "quality" if key == "word" else key
            with placed(entry, "quality" if is_word else f"quality.{key}"):
                options[name] = OPTIONS[name](entry.plain(), name)
                Sampling(**{name: options[name]})
                if name == "model":
                    check_name(options[name])
        return options

    def exposure(self, item: Located) -> dict[str, float]:
        options: dict[str, float] = {}
        for key, entry in mapping(item, "exposure", tuple(EXPOSURE)).items():
            value = entry.value
            if isinstance(value, bool) or not isinstance(value, int | float | str):
                raise SetError(
                    f"{entry.place}: exposure.{key} is {entry.plain()!r}; it takes a number, as 1/200 or 400"
                )
            with placed(entry, f"exposure.{key}"):
                options[EXPOSURE[key]] = numbers.seconds_of(str(value)) if key == "time" else float(value)
        with placed(item, "exposure"):
            Exposing(**options)  # type: ignore[arg-type]
        return options

    def splits(self, item: Located) -> tuple[Split, ...]:
        if not isinstance(item.value, dict) or not item.value:
            raise SetError(f"{item.place}: splits is {item.plain()!r}; it takes {{train: 9, test: 1}} or the like")
        result = []
        for name, entry in item.value.items():
            if not re.fullmatch(r"[A-Za-z][\w-]*", name):
                raise SetError(f"{entry.key_place}: splits: {name!r} is no name; use letters, digits, _ and -")
            if not isinstance(entry.value, dict):
                result.append(Split(name, share(entry, f"splits: the share of {name!r}")))
                continue
            fields = mapping(entry, f"splits: {name}", ("share", *HELD_OUT))
            if "share" not in fields:
                raise SetError(f"{entry.place}: splits: {name} has no 'share'")
            held = {
                key: frozenset(text(thing_held, f"splits: {name}: {key}") for thing_held in entries(fields[key], key))
                for key in HELD_OUT
                if key in fields
            }
            result.append(Split(name, share(fields["share"], f"splits: the share of {name!r}"), **held))
        return tuple(result)

    def check(self, definition: SetDefinition, items: Mapping[str, Located]) -> None:
        """What no section can tell alone."""
        from synfog_usd.dataset.sets.scenes import assignment, held_out

        place = items["splits"].place if "splits" in items else ""
        source_names = {source.name for source in definition.sources}
        for split in definition.splits:
            for name in sorted(split.recipes - source_names):
                raise SetError(
                    f"{place}: splits: {split.name}: no recipe {name!r} in this set.{did_you_mean(name, source_names)}"
                )
        if any(split.models or split.skies for split in definition.splits):
            if any(source.stages for source in definition.sources):
                raise SetError(
                    f"{place}: models and skies can be held out of recipes alone: what a stage of your own shows is "
                    f"not known beforehand; hold out the pattern under recipes instead"
                )
            from synfog_usd.world.library import library
            from synfog_usd.world.skies import skies

            for split in definition.splits:
                for kind, names, there in (("model", split.models, library()), ("sky", split.skies, skies())):
                    for name in sorted(names - set(there)):
                        raise SetError(
                            f"{place}: splits: {split.name}: no {kind} {name!r} ships.{did_you_mean(name, there)}"
                        )
        assignment(definition)
        for source in definition.sources:
            if source.recipe is not None:
                try:
                    for split in definition.splits:
                        held_out(definition, source, split)
                except (RecipeError, SetError) as error:
                    raise SetError(f"{place or items['recipes'].place}: {error}") from error
        if len(definition.pipelines) > 1 and not any(fog == fixed(CLEAR) for fog in definition.fogs):
            raise SetError(
                f"{items['pipelines'].place}: pipelines after the first are metered on the clear frame; put {CLEAR} "
                f"among the fogs"
            )
        self.check_cameras(definition, items)
        source_names = {path.stem for path in definition.pipelines}
        for index, name in enumerate(definition.asm_estimated):
            entry = items["asm_estimated"].value[index]
            if name not in source_names:
                raise SetError(
                    f"{entry.place}: asm_estimated has {name!r}; it takes those that stand under pipelines: "
                    f"{', '.join(sorted(source_names))}"
                )
            if fixed(CLEAR) not in definition.fogs:
                raise SetError(f"{entry.place}: asm_estimated fogs the clear frame; put {CLEAR} among the fogs")

    def check_cameras(self, definition: SetDefinition, items: Mapping[str, Located]) -> None:
        """Whether every pipeline can develop the radiance that is rendered for the first."""
        from synfog_usd import camera
        from synfog_usd.camera import fisheye
        from synfog_usd.camera.distortion import to_render
        from synfog_usd.camera.exposure import moments_of
        from synfog_usd.camera.pinhole import Pinhole

        view = None
        for index, path in enumerate(definition.pipelines):
            place = items["pipelines"].value[index].place if "pipelines" in items else path
            try:
                graph = camera.load_graph(path)
                exposed(graph, definition.exposure)
            except SynfogError as error:
                raise SetError(f"{place}: pipelines: {error}") from error
            if [str(port) for port in graph.inputs.values()] != ["radiance"] or moments_of(graph):
                raise SetError(
                    f"{place}: pipelines: {path.stem} does not take radiance alone, which is what is rendered"
                )
            lens = to_render(graph, Pinhole(180, 320, 60.0, (0.0, 0.0))), fisheye.of_graph(graph)
            if index and lens != view:
                raise SetError(
                    f"{place}: pipelines: the lens of {path.stem} projects otherwise than that of "
                    f"{definition.pipelines[0].stem}, for which the radiance is rendered; put it into a set of its own"
                )
            view = lens

    def words(self, definition: SetDefinition, items: Mapping[str, Located]) -> dict[str, Any]:
        """The sections as plain data without `extends`; paths start from the folder of the file."""

        def named(path: Path, folder: Path) -> str:
            return path.stem if path.parent == folder.resolve() else os.path.relpath(path, self.folder)

        recipes, pipelines = resources.folder("stages") / "recipes", resources.folder("pipeline")
        shares = [(source, str(source.share)) for source in definition.sources]
        of_recipes = {named(origin.recipe, recipes): part for origin, part in shares if origin.recipe}
        of_stages = {origin.name: part for origin, part in shares if origin.stages}
        return {
            **{key: item.plain() for key, item in items.items()},
            **({"recipes": of_recipes} if of_recipes else {}),
            **({"stages": of_stages} if of_stages else {}),
            "pipelines": [named(path.resolve(), pipelines) for path in definition.pipelines],
        }


def _different(sources: Sequence[Source], item: Located) -> tuple[Source, ...]:
    names = [source.name for source in sources]
    twice = {name for name in names if names.count(name) > 1}
    if twice:
        raise SetError(f"{item.place}: {', '.join(sorted(twice))} stands here twice; splits tell them apart by name")
    return tuple(sources)


def fixed(value: str | float) -> Distribution:
    """Always the same value."""
    return Distribution("fixed", (value,))


@contextlib.contextmanager
def placed(item: Located, what: str) -> Iterator[None]:
    """Within it, an error of what an item says gets the place of the item."""
    try:
        yield
    except (SynfogError, ValueError) as error:
        raise SetError(f"{item.place}: {what}: {error}") from error


def entries(item: Located, what: str, form: str = "a list") -> list[Located]:
    """Of a list that holds something."""
    if not isinstance(item.value, list) or not item.value:
        raise SetError(f"{item.place}: {what} is {item.plain()!r}; it takes {form}")
    return item.value


def text(item: Located, what: str) -> str:
    """A text that is not empty."""
    if not isinstance(item.value, str) or not item.value.strip():
        raise SetError(f"{item.place}: {what} is {item.plain()!r}; it takes a text")
    return item.value


def whole(item: Located, what: str, low: int, high: int) -> int:
    """A whole number within limits."""
    distribution = read_distribution(item, what, _limits(low, high))
    if distribution.kind != "fixed":
        raise SetError(f"{item.place}: {what} is {item.plain()!r}; it takes one whole number")
    return int(distribution.values[0])


def switch(item: Located, what: str) -> bool:
    """True or false."""
    if not isinstance(value := yamlio.switch(item.value), bool):
        raise SetError(f"{item.place}: {what} is {item.plain()!r}; it takes true or false")
    return value


def share(item: Located, what: str) -> Fraction:
    """A number above 0, exact as written."""
    try:
        fraction = Fraction(str(item.value)) if not isinstance(item.value, bool) else Fraction(0)
    except (ValueError, ZeroDivisionError):
        fraction = Fraction(0)
    if not 0 < fraction <= 10**9:
        raise SetError(f"{item.place}: {what} is {item.plain()!r}; it takes a number above 0")
    return fraction


def _limits(low: int, high: int) -> Parameter:
    return Continuous(low, high, None, whole=True)
