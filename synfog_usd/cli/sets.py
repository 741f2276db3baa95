"""What the verbs of `synfog-usd dataset` that make and check sets do and print."""

from __future__ import annotations

import dataclasses
import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from synfog_usd.cli import worker
from synfog_usd.cli.progress import shown
from synfog_usd.dataset.sets import journal, offers
from synfog_usd.dataset.sets.layout import Unit
from synfog_usd.dataset.sets.load import load_set
from synfog_usd.dataset.sets.run import Outcome, make_set
from synfog_usd.dataset.sets.work import outcome_of

if TYPE_CHECKING:
    from synfog_usd.dataset.sets.cost import Count
    from synfog_usd.dataset.sets.definition import SetDefinition
    from synfog_usd.dataset.sets.status import Status

WATCH_S = 2.0


def plan(file: Path, *, as_json: bool) -> None:
    """Print what a set holds."""
    from synfog_usd.dataset.sets import cost

    definition = offers.with_offers(load_set(file), offers.ask_child)
    counted = cost.count(definition)
    if as_json:
        print(json.dumps(dataclasses.asdict(counted), indent=2))
    else:
        _print_count(definition, counted)


def _print_count(definition: SetDefinition, counted: Count) -> None:
    units = ", ".join(f"{number} in {lighting}" for lighting, number in counted.units.items())
    print(f"{definition.name}: {definition.about}".removesuffix(": "))
    print(f"  scenes    {counted.scenes} ({', '.join(f'{number} {name}' for name, number in counted.splits.items())})")
    print(f"  drawn of  {', '.join(f'{number} {name}' for name, number in counted.sources.items())}")
    print(f"  units     {sum(counted.units.values())} of a scene and lighting: {units}")
    print(f"  shots     {counted.shots}, as {counted.pictures} pictures in {counted.files} files")
    print("  hours     are known after the first units: run it, and ask `synfog-usd dataset status OUT`", flush=True)


def print_offers() -> None:
    """In that child: a line of JSON for each path that it is given."""
    if worker.is_worker():
        worker.follow_parent()
    for path in sys.stdin.read().splitlines():
        with worker.reading_limits():
            print(json.dumps(offers.of_stage(Path(path))), flush=True)


def run(file: Path | None, out: Path, *, quiet: bool, as_json: bool, **more: Any) -> None:
    """Make a set; the exit code is 1 where units were set aside or a budget stopped it, 130 after Ctrl-C."""
    try:
        with shown(quiet) as (progress, log), worker.stopped_by_sigterm():
            outcome = make_set(file, out, progress=progress, log=log, **more)
    except KeyboardInterrupt:
        again = f"synfog-usd dataset run {file} -o {out}" if file else f"synfog-usd dataset retry {out}"
        print(f"synfog-usd: stopped. Finished units are kept in {out}; {again} goes on from there", file=sys.stderr)
        raise typer.Exit(worker.INTERRUPTED) from None
    _report(outcome, out, quiet=quiet, as_json=as_json)


def _report(outcome: Outcome, out: Path, *, quiet: bool, as_json: bool) -> None:
    if as_json:
        print(json.dumps(dataclasses.asdict(outcome), indent=2))
    elif not quiet:
        print(f"{out}: {outcome.made} units made, {outcome.kept} were there, {len(outcome.aside)} set aside")
    for name, line in outcome.aside.items():
        print(f"synfog-usd: {name} (seed {line['seed']}) is set aside: {line['error']}", file=sys.stderr)
    if outcome.aside:
        print(f"synfog-usd: synfog-usd dataset retry {out} takes them up", file=sys.stderr)
    if outcome.stopped:
        print(f"synfog-usd: {outcome.stopped}", file=sys.stderr)
    if outcome.aside or outcome.stopped:
        raise typer.Exit(1)


def status(out: Path, *, watch: bool, as_json: bool) -> None:
    """Print how far a set is; under `watch` again whenever it is further."""
    from synfog_usd.dataset.sets.status import status as look

    shown_last = None
    while True:
        now = look(out)
        told_now = json.dumps(dataclasses.asdict(now), indent=2) if as_json else _in_words(out, now)
        if told_now != shown_last:
            print(told_now, flush=True)
            shown_last = told_now
        if not watch or not now.running:
            return
        time.sleep(WATCH_S)


def _in_words(out: Path, now: Status) -> str:
    share = f"{now.made} of {now.units} units ({now.made / now.units:.0%})"
    parts = [share, f"{now.bytes / 1e9:.2f} GB"]
    if now.left_s and now.made < now.units:
        parts.append(f"{now.left_s / 3600:.2g} h of processor time left")
    parts.append("a run works on it" if now.running else "complete" if now.made == now.units else "no run works on it")
    lines = [f"{out}: {now.name}, {now.scenes} scenes, {now.shots} shots: {', '.join(parts)}"]
    lines += [f"  {name} (seed {line['seed']}) is set aside: {line['error']}" for name, line in now.aside.items()]
    return "\n".join(lines)


def verify(out: Path, *, quiet: bool, as_json: bool) -> None:
    """Look at every file in a child, because a damaged file may take a library down; exit code 1 with findings."""
    if not worker.is_worker():
        code = worker.run(sys.argv[1:])
        if code < 0:
            print(f"synfog-usd: {out}: the process that read it died of signal {-code}", file=sys.stderr)
        raise typer.Exit(2 if code < 0 else code)
    worker.follow_parent()
    from synfog_usd.dataset.sets.verify import verify as look

    with shown(quiet) as (progress, log):
        faults = []
        for fault in look(out, progress=progress):
            faults.append(fault)
            if not as_json:
                log(f"{out}: {fault.unit}{': ' if fault.unit else ''}{fault.text}")
    wrong = [fault for fault in faults if not fault.missing]
    if as_json:
        print(json.dumps([dataclasses.asdict(fault) for fault in faults], indent=2))
    elif not quiet:
        missing = len(faults) - len(wrong)
        end = f", {missing} units are not made" if missing else ""
        print(f"{out}: {len(wrong) or 'nothing'} wrong{end}" + ("; run --repair mends it" if wrong else ""))
    raise typer.Exit(1 if wrong else 0)


def unit(out: Path, number: int, lighting: str, camera: str, *, repair: bool, variant: str) -> None:
    """Make one unit, in a child process with limits; the child runs the same command, and comes here too."""
    if not worker.is_worker():
        code = worker.run(sys.argv[1:])
        raise typer.Exit(2 if code < 0 else code)
    worker.follow_parent()
    from synfog_usd.dataset.sets import identity
    from synfog_usd.dataset.sets.unit import make as make_unit
    from synfog_usd.render import backend

    def make_one() -> tuple[dict[str, Any], bool]:
        definition = journal.kept_definition(out)
        identity.check(out, identity.identity(definition, backend.choose(variant).variant))  # type: ignore[arg-type]
        which = Unit(number, lighting, camera)
        return make_unit(definition, out, which, variant=variant, repair=repair, reading=worker.reading_limits)

    result, code = outcome_of(make_one)
    print(json.dumps(result))
    raise typer.Exit(code)
