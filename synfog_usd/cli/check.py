"""`synfog-usd check`: everything that is wrong with a stage, and what its translation will leave out."""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from synfog_usd import stage as usd
from synfog_usd.errors import StageError
from synfog_usd.stage import rules
from synfog_usd.translate import translate

if TYPE_CHECKING:
    from synfog_usd.scene import Note
    from synfog_usd.stage.rules import Finding

GRAVEST_FIRST = ("error", "warning", "info")
ERRORS, WARNINGS_UNDER_STRICT, CLEAN = 2, 1, 0


def look(stage: Path, *, allow: Sequence[Path] = ()) -> tuple[list[Finding], list[Note]]:
    """Findings on a stage, gravest first, and the notes of its translation over all lightings and fogs.

    Raises:
        StageError: the stage cannot be opened at all.
    """
    opened = usd.open_stage(stage, allow=allow, allow_errors=True)
    found = usd.check(opened)
    broken = {(one.path, one.text) for one in found if one.rule == "composition"}
    notes: dict[Note, None] = {}
    if usd.cameras(opened):
        try:
            notes = _translated(opened)
        except StageError as problem:
            rule = getattr(problem, "rule", "refused")
            found.append(rules.finding(rule, getattr(problem, "path", ""), str(problem)))
    told = {(one.path, one.text) for one in found} | broken
    kept = [note for note in notes if (note.path, note.text) not in told]
    return sorted(found, key=lambda one: GRAVEST_FIRST.index(one.severity)), kept


def _translated(opened: Any) -> dict[Note, None]:
    """Notes of translating every lighting once and every fog once, as a bake would."""
    names = usd.variants(opened)
    notes: dict[Note, None] = {}
    for lighting, fog in list(itertools.zip_longest(names.get("lighting", []), names.get("fog", []))) or [(None, None)]:
        usd.select(opened, lighting=lighting, fog=fog)
        notes |= dict.fromkeys(translate(opened).notes)
    return notes


def exit_code(found: Sequence[Finding], notes: Sequence[Note], *, strict: bool) -> int:
    """2 where a bake would stop, 1 where `strict` and something is not as it was meant, else 0."""
    severities = {one.severity for one in found} | {note.severity for note in notes}
    return ERRORS if "error" in severities else WARNINGS_UNDER_STRICT if strict and "warning" in severities else CLEAN


def as_json(stage: Path, found: Sequence[Finding], notes: Sequence[Note], code: int) -> str:
    """One object: 'stage', 'exit_code', 'counts', 'findings', 'translation'."""
    return json.dumps(
        {
            "stage": str(stage),
            "exit_code": code,
            "counts": {severity: sum(one.severity == severity for one in found) for severity in GRAVEST_FIRST},
            "findings": [{"rule": one.rule, "severity": one.severity, "path": one.path, "text": one.text, "mend": dict(one.mend)} for one in found],
            "translation": [
                {"severity": severity, "text": text, "prims": count, "paths": paths} for (severity, text), (paths, count) in _by_text(notes).items()
            ],
        },
        indent=2,
    )


def as_text(stage: Path, found: Sequence[Finding], notes: Sequence[Note]) -> str:
    """Findings with, once a rule, what to do in which tool; then the table of what is simplified or left out."""
    lines, explained = [], set()
    for one in found:
        lines.append(f"{one.severity}: {one.path or stage}: {one.text.removeprefix(one.path + ': ') if one.path else one.text} [{one.rule}]")
        if one.rule not in explained:
            explained.add(one.rule)
            lines += [f"    {tool}: {advice}" for tool, advice in one.mend.items()]
    rows = sorted(_by_text(notes).items(), key=lambda row: GRAVEST_FIRST.index(row[0][0]))
    if rows:
        lines += ["", "What the translation makes simpler or leaves out:", f"{'':8} {'prims':>5}  what became of it, and the first prim"]
        lines += [f"{severity:8} {count:5}  {text} ({paths[0] or stage.name})" for (severity, text), (paths, count) in rows]
        lines.append("")
    counts = {severity: sum(one.severity == severity for one in found) for severity in GRAVEST_FIRST}
    lines.append(f"{stage}: {counts['error']} errors, {counts['warning']} warnings, {counts['info']} remarks; {len(rows)} simplifications")
    return "\n".join(lines)


_MORE = re.compile(r" \(and (\d+) more prims\)$")


def _by_text(notes: Sequence[Note]) -> dict[tuple[str, str], tuple[list[str], int]]:
    """(severity, text) -> the paths that are told, and how many there are; the translation lists some and counts the rest."""
    grouped: dict[tuple[str, str], tuple[list[str], int]] = {}
    for note in notes:
        rest = _MORE.search(note.text)
        key = (note.severity, _MORE.sub("", note.text))
        paths, count = grouped.get(key, ([], 0))
        grouped[key] = ([*paths, note.path], count + 1 + (int(rest[1]) if rest else 0))
    return grouped
