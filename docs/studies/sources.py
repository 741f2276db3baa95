"""What fog a network is trained on, and what it is worth on other fog: each kind of fog in turn, tested on all.

The scenes of a set are parted into folds.  For each fold, kind and seed a network is trained on the kind's pictures of
the other folds' scenes (`training`) and asked about this fold's, by every kind.  So each scene is tested by networks
that never saw it.  All are to see one and the same clear picture, that of `target`.

What differs between two kinds is one thing: noise; light scattered more than once, and a true airlight; light mixed
instead of codes.  Its effect is the difference in PSNR, pair by pair.  A network that takes RAW is tested on RAW alone,
and compared, on the same views, with one that takes the developed pictures.  Intervals are by bootstrap over scenes and
seeds together.

Another set shows how far that holds: its pictures are told apart by pipeline, which is another sensor's, by fog, and by
whether training saw their recipe.  All networks are asked about all of them; each is to see its own clear picture.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from docs.studies import command, networks, training
from docs.studies.training import TrainingPair
from synfog_usd.base import files, seeds
from synfog_usd.base.arrays import Array, Indices
from synfog_usd.base.errors import ParameterError
from synfog_usd.base.progress import Progress, silent
from synfog_usd.cli.progress import shown
from synfog_usd.dataset.exports import frames
from synfog_usd.lab.benchmark import page, statistics
from synfog_usd.lab.benchmark.bench import RESULTS, digest, read_results

RAW = "raw."
"""Before a pipeline: its RAW."""

KINDS = ("synfog", "noise_free", "asm_estimated.noise_free", "asm_srgb.synfog", "raw.synfog")
TARGET = "noise_free"
EFFECTS = (
    ("the sensor's noise", "synfog", "noise_free"),
    ("transport instead of the scattering model", "noise_free", "asm_estimated.noise_free"),
    ("the scattering model in light instead of codes", "asm_estimated.noise_free", "asm_srgb.synfog"),
    ("RAW instead of developed pictures", "raw.synfog", "synfog"),
)
"""What training has more, by kinds whose difference it is."""

NONE = "none"


@dataclass(frozen=True)
class SourceStudy:
    """What came of it.

    Attributes:
        kinds: of fog.
        pairs: names of the views that were tested, in order; `scenes`: theirs.
        psnr: (train kind, test kind) -> (seeds, pairs) [dB], where one can be asked about the other; of 'none', the fog
            left on, one row.
        steps, folds: how they were trained.
        others: (train kind, group of the other set) -> (networks, pairs) [dB].
        other_scenes: group -> scenes of its pairs.
    """

    kinds: tuple[str, ...]
    pairs: tuple[str, ...]
    scenes: tuple[str, ...]
    psnr: dict[tuple[str, str], Array]
    steps: int
    folds: int
    others: dict[tuple[str, str], Array] = field(default_factory=dict)
    other_scenes: dict[str, tuple[str, ...]] = field(default_factory=dict)


def study(
    source: Path,
    out: Path,
    *,
    kinds: Sequence[str] = KINDS,
    target: str = TARGET,
    seeds_count: int = 3,
    folds: int = 3,
    steps: int = 400,
    also: Path | None = None,
    progress: Progress = silent,
) -> SourceStudy:
    """Train and test; what `out` has already of the same pictures and options is kept.

    Args:
        source: a set with the pipelines that the kinds name.
        out: folder; weights and results are kept there as they come.
        kinds: see `training`.
        target: pipeline whose clear picture all are to see.
        seeds_count: networks for each kind and fold.
        folds: parts of the scenes.
        steps: of each training.
        also: another set, on which all networks are tested too.
        progress: whom to tell.

    Raises:
        ParameterError: pictures are missing, or scenes are fewer than folds.
        OutputError: the folder cannot be written.
    """
    networks.torch_library()
    by_kind = {
        kind: _in_order(training.pairs(source, kind.removeprefix(RAW), target=target, raw=kind.startswith(RAW)))
        for kind in kinds
    }
    views = [_view(pair) for pair in by_kind[kinds[0]]]
    if any([_view(pair) for pair in found] != views for found in by_kind.values()):
        raise ParameterError(f"{source}: its kinds of fog are not of the same views: {', '.join(kinds)}")
    scenes = [pair.scene for pair in by_kind[kinds[0]]]
    names = sorted(set(scenes))
    if not 2 <= folds <= len(names):
        raise ParameterError(f"--folds {folds}: {source} has {len(names)} scenes; it takes 2 to as many")
    fold = np.array([names.index(scene) % folds for scene in scenes])
    recipes = {pair.foggy.source for pair in by_kind[kinds[0]]}
    groups = {raw: _groups(also, recipes, raw) for raw in {kind.startswith(RAW) for kind in kinds}} if also else {}
    told: dict[tuple[str, str], list[list[float]]] = {}
    known = read_results(out / RESULTS)
    psnr = {(kind, test): np.full((seeds_count, len(views)), np.nan) for kind in kinds for test in _asked(kind, kinds)}
    done, total = 0, len(kinds) * folds * seeds_count
    for number in range(folds):
        inside = np.flatnonzero(fold == number)
        for kind in kinds:
            learned = [pair for pair, its in zip(by_kind[kind], fold, strict=True) if its != number]
            for seed in range(seeds_count):
                progress(f"{kind}, fold {number}, seed {seed}", done / total)
                done += 1
                tests = _asked(kind, kinds)
                key = _key(learned, [by_kind[test][n] for test in tests for n in inside], seed, steps)
                if key not in known:
                    trained = training.train(learned, seed=seed, steps=steps)
                    files.write_bytes(out / "weights" / f"{key}.pt", training.as_bytes(trained))
                    known[key] = {test: [_psnr(by_kind[test][n], trained) for n in inside] for test in tests}
                    files.write_json(out / RESULTS, known)
                for test in tests:
                    psnr[kind, test][seed, inside] = known[key][test]
                for name, pairs in groups.get(kind.startswith(RAW), {}).items():
                    place = hashlib.sha256(json.dumps([key, [_row(pair) for pair in pairs]]).encode()).hexdigest()[:16]
                    if place not in known:
                        trained = training.load(out / "weights" / f"{key}.pt")
                        known[place] = {name: [_psnr(pair, trained) for pair in pairs]}
                        files.write_json(out / RESULTS, known)
                    told.setdefault((kind, name), []).append(known[place][name])
    for test in _asked(kinds[0], kinds):
        psnr[NONE, test] = np.array([[_psnr(pair, None) for pair in by_kind[test]]])
    for name, pairs in groups.get(False, {}).items():
        told[NONE, name] = [[_psnr(pair, None) for pair in pairs]]
    found = SourceStudy(
        tuple(kinds),
        tuple(views),
        tuple(scenes),
        psnr,
        steps,
        folds,
        {key: np.array(rows) for key, rows in told.items()},
        {name: tuple(pair.scene for pair in pairs) for part in groups.values() for name, pairs in part.items()},
    )
    _write(found, out)
    _pictures(found, by_kind, fold, out)
    return found


def _asked(kind: str, kinds: Sequence[str]) -> list[str]:
    """The kinds that a network which was trained on one can be asked about."""
    return [test for test in kinds if test.startswith(RAW) == kind.startswith(RAW)]


def _groups(source: Path, recipes: set[str], raw: bool) -> dict[str, list[TrainingPair]]:
    """Pairs of another set, by pipeline, fog and whether their recipe was seen in training."""
    found: dict[str, list[TrainingPair]] = {}
    for pipeline in sorted({one.pipeline for one in frames.pictures(source)}):
        for pair in _in_order(training.pairs(source, pipeline, raw=raw)):
            seen = "" if pair.foggy.source in recipes else ", other recipes"
            found.setdefault(f"{RAW * raw}{pipeline}, {pair.foggy.fog}{seen}", []).append(pair)
    return dict(sorted(found.items()))


def _in_order(found: Sequence[TrainingPair]) -> list[TrainingPair]:
    return sorted(found, key=_view)


def _view(pair: TrainingPair) -> str:
    """Name of a view in a fog, the same for all kinds."""
    one = pair.foggy
    return "_".join(part for part in (pair.scene, one.lighting, one.camera, one.fog) if part)


def _key(learned: Sequence[TrainingPair], asked: Sequence[TrainingPair], seed: int, steps: int) -> str:
    """Hash of all that decides a training and its test."""
    rows = [_row(pair) for pair in (*learned, *asked)]
    text = json.dumps(
        [rows, len(learned), seed, steps, training.WIDTH, training.SIDE_PX, training.BATCH, training.RATE]
    )
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _row(pair: TrainingPair) -> list[str]:
    """What decides a pair."""
    pictures = [pair.foggy.files["raw.dng"] if pair.raw else pair.foggy.screen, pair.clear, pair.target]
    pictures += [pair.foggy.files["layers.exr"]] * pair.kind.startswith(training.ASM_SRGB)
    return [pair.kind, *(digest(path) for path in pictures)]


def _psnr(pair: TrainingPair, trained: training.TrainedDefogger | None) -> float:
    foggy = training.foggy_of(pair)
    restored = foggy if trained is None else trained.restore(foggy)
    return training.psnr(restored, training.shown(pair.target))


def interval(values: Array, scenes: Sequence[str]) -> tuple[float, float | None, float | None]:
    """Mean and its interval at 95 % over scenes and seeds, drawn together; none of fewer than three scenes.

    Args:
        values: (seeds, pairs).
        scenes: of the pairs.
    """
    names, place = np.unique(list(scenes), return_inverse=True)
    mean = float(values.mean())
    if names.size < statistics.FEWEST_SCENES:
        return mean, None, None
    drawn = statistics.draws(names.size)
    count = len(values)
    rng = seeds.stream(0, "seeds of training", count)
    often = rng.multinomial(count, np.full(count, 1.0 / count), size=len(drawn)) / count
    sums = np.stack([np.bincount(place, row) for row in values])
    pairs = np.bincount(place)
    return mean, *statistics.interval((often @ sums * drawn).sum(axis=1) / (drawn @ pairs))


def effects(found: SourceStudy) -> list[tuple[str, str, float, float | None, float | None]]:
    """What is in training, tested on which kind, and how much PSNR it brings [dB] with its interval."""
    return [
        (what, test, *interval(found.psnr[more, test] - found.psnr[less, _like(test, less)], found.scenes))
        for what, more, less in EFFECTS
        if more in found.kinds and less in found.kinds
        for test in _asked(more, found.kinds)
        if (less, _like(test, less)) in found.psnr
    ]


def _like(test: str, kind: str) -> str:
    """The test of the same pictures that a network of a kind can be asked about."""
    return test if kind.startswith(RAW) else test.removeprefix(RAW)


def other_effects(found: SourceStudy) -> list[tuple[str, str, float, float | None, float | None]]:
    """The same as `effects` on the groups of the other set."""
    return [
        (what, name, *interval(found.others[more, name] - found.others[less, _like(name, less)], scenes))
        for what, more, less in EFFECTS
        for name, scenes in found.other_scenes.items()
        if (more, name) in found.others and (less, _like(name, less)) in found.others
    ]


# -- page


def markdown(found: SourceStudy) -> str:
    """Findings and tables."""
    count = len(found.psnr[found.kinds[0], found.kinds[0]])
    lines = [
        "# What a network is trained on",
        "",
        f"{len(found.pairs)} pairs of {len(set(found.scenes))} scenes in {found.folds} folds, {count} seeds, "
        f"{found.steps} steps. PSNR [dB]; in brackets the interval at 95 % over scenes and seeds.",
        "",
        f"| trained on | {' | '.join(f'tested on {test}' for test in found.kinds)} |",
        f"|---|{'---|' * len(found.kinds)}",
    ]
    for kind in (NONE, *found.kinds):
        cells = [
            _cell(*interval(found.psnr[kind, test], found.scenes)) if (kind, test) in found.psnr else ""
            for test in found.kinds
        ]
        lines.append(f"| {kind} | {' | '.join(cells)} |")
    rows = effects(found)
    lines += [
        "",
        f"What it brings to train with a thing rather than without it [dB]. Of {len(rows)} intervals one in twenty "
        "leaves 0 out by chance.",
        "",
        f"| in training | {' | '.join(f'tested on {test}' for test in found.kinds)} |",
        f"|---|{'---|' * len(found.kinds)}",
    ]
    for what in dict.fromkeys(row[0] for row in rows):
        told = {row[1]: _effect(*row[2:]) for row in rows if row[0] == what}
        cells = [told.get(test, "") for test in found.kinds]
        lines.append(f"| {what} | {' | '.join(cells)} |")
    if found.others:
        lines += _other_tables(found)
    return "\n".join([*lines, ""])


def _other_tables(found: SourceStudy) -> list[str]:
    """The same two tables of the other set, a row a group."""
    columns = [kind for kind in (NONE, *found.kinds) if any(key[0] == kind for key in found.others)]
    lines = ["", "On the other set, by what was tested; each is to see its own clear picture. PSNR [dB]."]
    lines += ["", f"| tested on | scenes | {' | '.join(columns)} |", f"|---|---|{'---|' * len(columns)}"]
    for name, scenes in found.other_scenes.items():
        cells = [
            _cell(*interval(found.others[kind, name], scenes)) if (kind, name) in found.others else ""
            for kind in columns
        ]
        lines.append(f"| {name} | {len(set(scenes))} | {' | '.join(cells)} |")
    rows = other_effects(found)
    effects_there = list(dict.fromkeys(row[0] for row in rows))
    lines += ["", "What it brings there [dB].", "", f"| tested on | {' | '.join(effects_there)} |"]
    lines.append(f"|---|{'---|' * len(effects_there)}")
    for name in found.other_scenes:
        told = {row[0]: _effect(*row[2:]) for row in rows if row[1] == name}
        lines.append(f"| {name} | {' | '.join(told.get(what, '') for what in effects_there)} |")
    return lines


def _cell(mean: float, low: float | None, high: float | None) -> str:
    return f"{mean:.2f}" if low is None else f"{mean:.2f} ({low:.2f} to {high:.2f})"


def _effect(mean: float, low: float | None, high: float | None) -> str:
    if low is None or high is None:
        return f"{mean:+.2f}"
    text = f"{mean:+.2f} ({low:+.2f} to {high:+.2f})"
    return f"**{text}**" if low > 0.0 or high < 0.0 else text


def _write(found: SourceStudy, out: Path) -> None:
    files.write_bytes(out / "findings.md", markdown(found).encode())
    rows = ["trained_on,tested_on,seed,view,psnr_db"]
    for (kind, test), values in found.psnr.items():
        for seed, row in enumerate(values):
            rows += [f"{kind},{test},{seed},{view},{value:.4f}" for view, value in zip(found.pairs, row, strict=True)]
    files.write_bytes(out / "psnr.csv", "\n".join([*rows, ""]).encode())
    files.write_bytes(out / "effects.png", _drawn(found))


def _drawn(found: SourceStudy) -> bytes:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 4.2), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    rows = effects(found)
    colours = ("#0b5fa5", "#c1440e", "#12805c", "#6b3fa0")
    for number, (what, colour) in enumerate(zip(dict.fromkeys(row[0] for row in rows), colours, strict=False)):
        own = [row for row in rows if row[0] == what]
        places = np.array([found.kinds.index(row[1]) for row in own]) + 0.16 * (number - 1)
        axes.plot(places, [row[2] for row in own], "o", ms=5, color=colour, label=what)
        for place, (_, _, _, low, high) in zip(places, own, strict=True):
            if low is not None:
                axes.plot([place, place], [low, high], lw=1.6, color=colour)
    axes.axhline(0.0, lw=0.8, color="#22262a")
    axes.set_xticks(np.arange(len(found.kinds)), [f"tested on\n{kind}" for kind in found.kinds], fontsize=8)
    axes.set(ylabel="PSNR with it less without it [dB]")
    axes.legend(title="in training", fontsize=8)
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png", metadata={"Software": None})
    return drawn.getvalue()


def _pictures(found: SourceStudy, by_kind: dict[str, list[TrainingPair]], fold: Indices, out: Path) -> None:
    """A row a view: in fog, what each training makes of it, clear."""
    first = by_kind[found.kinds[0]]
    strips = []
    for place in page.spread(list(range(len(first)))):
        number, pair = fold[place], first[place]
        foggy = training.foggy_of(pair)
        strip = [_tile(foggy, found.pairs[place])]
        for kind in found.kinds:
            learned = [one for one, its in zip(by_kind[kind], fold, strict=True) if its != number]
            tests = _asked(kind, found.kinds)
            asked = [by_kind[test][n] for test in tests for n in np.flatnonzero(fold == number)]
            trained = training.load(out / "weights" / f"{_key(learned, asked, 0, found.steps)}.pt")
            value = found.psnr[kind, tests[0]][0, place]
            restored = trained.restore(training.foggy_of(by_kind[tests[0]][place]))
            strip.append(_tile(restored, f"{kind}  {value:.1f} dB"))
        strips.append([*strip, _tile(training.shown(pair.target), "clear")])
    page.sheet(strips, out / "pictures.png")


def _tile(picture: Any, caption: str) -> page.Tile:
    from PIL import Image

    pixels = np.rint(255.0 * np.clip(picture, 0.0, 1.0)).astype(np.uint8).transpose(1, 2, 0)
    return page.fitted(Image.fromarray(pixels)), caption


def main(
    source: Annotated[
        Path, typer.Argument(help="Folder of a set with pipelines synfog and noise_free, and asm_estimated.")
    ],
    out: command.Out,
    seeds: Annotated[int, typer.Option(min=1, help="Networks for each kind of fog and fold.")] = 3,
    folds: Annotated[
        int, typer.Option(min=2, help="Parts of the scenes; each is tested by networks of the others.")
    ] = 3,
    steps: Annotated[int, typer.Option(min=1, help="Of each training.")] = 400,
    also: Annotated[Path | None, typer.Option(help="Another set, on which all are tested.")] = None,
) -> None:
    """Train on four kinds of fog and on RAW, and test each: what noise, multiple scattering and RAW are worth."""
    command.writable(out)
    with shown(quiet=False) as (progress, _):
        found = study(source, out, seeds_count=seeds, folds=folds, steps=steps, also=also, progress=progress)
    print(markdown(found))


if __name__ == "__main__":
    command.run(main)
