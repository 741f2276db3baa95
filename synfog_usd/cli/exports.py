"""What the verbs of `synfog-usd dataset` that show and export sets do and print."""

from __future__ import annotations

import json
from pathlib import Path

from synfog_usd.base.errors import ParameterError
from synfog_usd.cli.progress import shown
from synfog_usd.dataset.exports import run, taxonomy
from synfog_usd.dataset.exports.record import Boxed, exporter

DROPS = {"none": (), "invisible": ("invisible",), "faint": ("invisible", "faint")}


def export(
    out: Path, form: str, to: str | None, *, drop: str, classes: str, licence: str, quiet: bool, as_json: bool
) -> None:
    """Write a set in another format."""
    fmt = exporter(form)
    if drop not in DROPS:
        raise ParameterError(f"--drop {drop}: one of {', '.join(DROPS)}")
    words = [word.strip() for word in classes.split(",") if word.strip()]
    chosen = Boxed(DROPS[drop], taxonomy.class_names(words))
    url = to if to is not None and run.is_url(to) else None
    target = Path(to) if to is not None and url is None else out.resolve().with_name(f"{out.resolve().name}-{form}")
    with shown(quiet) as (progress, _):
        census = run.export(out, fmt, target, chosen=chosen, licence=licence, url=url, progress=progress)
    if as_json:
        summary = {
            "folder": str(target),
            "pictures": census.pictures,
            "boxes": census.boxes,
            "dropped": census.dropped,
        }
        print(json.dumps(summary, indent=2))
    elif not quiet:
        print(
            f"{target}: {census.pictures} pictures, {census.boxes} boxes, {census.dropped} things without one; see "
            f"README.md there"
        )


def gallery(out: Path, to: Path | None, *, quiet: bool) -> None:
    """Write pages that show a set."""
    from synfog_usd.dataset.exports.gallery import build

    target = to or out.resolve().with_name(f"{out.resolve().name}-gallery")
    with shown(quiet) as (progress, _):
        count = build(out, target, progress=progress)
    if not quiet:
        print(f"{count} pictures: open {(target / 'index.html').resolve().as_uri()} in a browser")


def stats(out: Path, *, quiet: bool, as_json: bool) -> None:
    """Print figures."""
    from synfog_usd.dataset.exports import stats as figures

    with shown(quiet) as (progress, _):
        counted = figures.gather(out, progress=progress)
    print(json.dumps(counted.metadata(), indent=2) if as_json else figures.text(counted))
