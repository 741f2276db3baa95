"""Everything that is wrong with a stage, and what its translation will leave out."""

from __future__ import annotations

import itertools
import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeVar

from synfog_usd import stage as usd
from synfog_usd.base.errors import StageError
from synfog_usd.base.values import check_words
from synfog_usd.dataset.asked import plan_of
from synfog_usd.dataset.job import reading_here
from synfog_usd.dataset.plan import AS_AUTHORED
from synfog_usd.stage import rulebook, rules
from synfog_usd.translate import Exchange, outdoors, why_black

if TYPE_CHECKING:
    from synfog_usd.base.notes import Note
    from synfog_usd.stage.rulebook import Finding

NOTHING: Mapping[str, str] = MappingProxyType({})
Told = TypeVar("Told", "Finding", "Note")
Line = TypeVar("Line")

GRAVEST_FIRST = ("error", "warning", "info")
MOST_LETTERS = 500
"""Of a path or a text that is printed; JSON has all of it."""

ERRORS, WARNINGS_UNDER_STRICT, CLEAN = 2, 1, 0


@dataclass(frozen=True)
class Checked:
    """What is wrong with a stage or unusual; as text it reads as `synfog-usd check` prints it.

    Attributes:
        stage: file.
        findings: gravest first, with `severity` ('error', 'warning' or 'info'), `path`, `text`, `rule` and `mend`.
        notes: what the translation simplifies or leaves out, with `severity`, `path` and `text`.
        light: lighting -> how light it is outdoors.
    """

    stage: Path
    findings: tuple[Finding, ...]
    notes: tuple[Note, ...]
    light: Mapping[str, str]

    def __str__(self) -> str:
        return as_text(self.stage, self.findings, self.notes, self.light)

    @property
    def errors(self) -> tuple[Finding, ...]:
        """Findings at which a bake would stop."""
        return tuple(finding for finding in self.findings if finding.severity == "error")


def check(stage: str | os.PathLike[str], **options: Any) -> Checked:
    """Tell what in a stage is wrong or unusual, how to mend it, and what a bake makes simpler.

    Args:
        stage: USD file, or the name of a stage that ships.
        options: of `synfog-usd check`, with _ for -: choose, meters_per_unit, up, allow.

    Raises:
        SynfogError: the stage cannot be opened at all.
    """
    check_words(options, dict.fromkeys(("choose", "meters_per_unit", "up", "allow")))
    plan = plan_of(stage, **options)
    usd.reread()
    with reading_here():
        findings, notes, light = look(
            plan.stage,
            allow=plan.reads.allow,
            choices=plan.reads.choices,
            metres_per_unit=plan.reads.metres_per_unit,
            up=plan.reads.up,
        )
    return Checked(plan.stage, tuple(findings), tuple(notes), light)


def look(
    stage: Path,
    *,
    allow: Sequence[Path] = (),
    choices: Sequence[str] = (),
    metres_per_unit: float | None = None,
    up: str | None = None,
) -> tuple[list[Finding], list[Note], dict[str, str]]:
    """Findings on a stage, gravest first, the notes of its translation over all lightings and fogs, and how light it is
    by lighting.

    Args:
        stage: file.
        allow: folders outside its own in which its files may lie.
        choices, metres_per_unit, up: how it is read otherwise than it says of itself, see `stage.override`.

    Raises:
        StageError: the stage cannot be opened at all, or has no such choice.
    """
    opened = usd.open_stage(stage, allow=allow)
    usd.override(opened, choices=choices, metres_per_unit=metres_per_unit, up=up)
    notes: dict[Note, None] = {}
    first = _placed(opened, usd.check(opened))
    findings = dict.fromkeys([*first, *usd.over_time(opened)])
    light: dict[str, str] = {}
    in_fog: list[set[Finding]] = []  # what is found where there is fog, by variant
    exchange: Exchange | None = None
    try:
        for lighting, chosen in _variants(opened):
            more = _placed(opened, rules.findings(opened)) if chosen else first
            findings |= dict.fromkeys(more)
            if not any(finding.rule == "no-fog" for finding in more):
                in_fog.append(set(more))
            if usd.cameras(opened):
                scene = exchange.within(opened) if exchange is not None and not lighting else None
                if scene is None:
                    exchange = Exchange(opened, before=exchange)
                    scene = exchange.scene
                    light.setdefault(lighting or AS_AUTHORED, str(outdoors(scene)))
                    why = None if any(finding.rule == "no-light" for finding in findings) else why_black(scene)
                    if why is not None:  # and so in any fog
                        findings[rulebook.finding("black", scene.camera.path, why)] = None
                notes |= dict.fromkeys(scene.notes)
    except StageError as problem:
        findings[rulebook.finding(getattr(problem, "rule", "refused"), getattr(problem, "path", ""), str(problem))] = (
            None
        )
    if in_fog:  # one variant with fog, and one in which the camera is in it, are enough
        always = set.intersection(*in_fog)
        findings = {finding: None for finding in findings if finding.rule not in _OF_ALL_FOGS or finding in always}
    texts = {(finding.path, finding.text) for finding in findings}
    remaining = [note for note in notes if (note.path, note.text) not in texts]
    return sorted(findings, key=lambda finding: GRAVEST_FIRST.index(finding.severity)), remaining, light


_OF_ALL_FOGS = frozenset({"no-fog", "camera-outside-fog"})
"""Rules that a stage breaks only if it does so in every variant of its fog: 'clear' has none, or leaves a bank
ahead.
"""


def _placed(opened: usd.Stage, items: Iterable[Told]) -> list[Told]:
    """The same with the paths of prototypes, which nobody authored and whose numbers change with the variants, as those
    of their first instances.
    """
    return [replace(item, path=usd.authored_path(opened, item.path)) for item in items]


def _variants(opened: usd.Stage) -> Iterator[tuple[str, bool]]:
    """The stage with every lighting once and every fog once, as a bake would choose them; gives the lighting's name, ''
    for none, and whether anything was chosen.
    """
    names = usd.variants(opened)
    for lighting, fog in list(itertools.zip_longest(names.get("lighting", []), names.get("fog", []))) or [(None, None)]:
        usd.select(opened, lighting=lighting, fog=fog)
        yield lighting or "", bool(names)


def exit_code(findings: Sequence[Finding], notes: Sequence[Note], *, strict: bool) -> int:
    """2 where a bake would stop, 1 where `strict` and something is not as it was meant, else 0."""
    severities = {finding.severity for finding in findings} | {note.severity for note in notes}
    return ERRORS if "error" in severities else WARNINGS_UNDER_STRICT if strict and "warning" in severities else CLEAN


def as_json(
    stage: Path,
    findings: Sequence[Finding],
    notes: Sequence[Note],
    code: int,
    light: Mapping[str, str] = NOTHING,
) -> str:
    """One object: 'stage', 'exit_code', 'counts', 'light', 'findings', 'translation'."""
    return json.dumps(
        {
            "stage": str(stage),
            "exit_code": code,
            "counts": {
                severity: sum(finding.severity == severity for finding in findings) for severity in GRAVEST_FIRST
            },
            "light": dict(light),
            "findings": [
                {
                    "rule": finding.rule,
                    "severity": finding.severity,
                    "path": finding.path,
                    "text": finding.text,
                    "mend": dict(finding.mend),
                }
                for finding in findings
            ],
            "translation": [
                {"severity": severity, "text": text, "prims": count, "paths": paths}
                for (severity, text), (paths, count) in _by_text(notes).items()
            ],
        },
        indent=2,
    )


def as_text(stage: Path, findings: Sequence[Finding], notes: Sequence[Note], light: Mapping[str, str] = NOTHING) -> str:
    """Findings with, once a rule, what to do in which tool; then the table of what is simplified or left out."""
    lines, explained = [], set()
    for finding, more in _by_folder([(finding, finding.severity, finding.rule, finding.text) for finding in findings]):
        text = finding.text.removeprefix(finding.path + ": ") if finding.path else finding.text
        lines.append(f"{finding.severity}: {_short(finding.path) or stage}: {_short(text)}{more} [{finding.rule}]")
        if finding.rule not in explained:
            explained.add(finding.rule)
            lines += [f"    {tool}: {advice}" for tool, advice in finding.mend.items()]
    rows = sorted(_by_text(notes).items(), key=lambda row: GRAVEST_FIRST.index(row[0][0]))
    if rows:
        lines += [
            "",
            "What the translation makes simpler or leaves out:",
            f"{'':8} {'prims':>5}  what became of it, and the first prim",
        ]
        lines += [
            f"{severity:8} {count:5}  {_short(text)}{more} ({_short(paths[0]) or stage.name})"
            for ((severity, text), (paths, count)), more in _by_folder(
                [(row, row[0][0], "", row[0][1]) for row in rows]
            )
        ]
        lines.append("")
    lines += [f"light ({lighting}): {text}" for lighting, text in light.items()]
    counts = {severity: sum(finding.severity == severity for finding in findings) for severity in GRAVEST_FIRST}
    lines.append(
        f"{stage}: {counts['error']} errors, {counts['warning']} warnings, {counts['info']} remarks; {len(rows)} "
        f"simplifications"
    )
    return "\n".join(lines)


_LOST = re.compile(r"(?:^|.* )(?P<file>\S*/[^/]*|[^/ ]+) is (?:not there|missing|not found)\b")
"""A line that tells of a file that is not there."""


def _by_folder(lines: Sequence[tuple[Line, str, str, str]]) -> list[tuple[Line, str]]:
    """Notes on missing files, one for each folder, and how many more there are of it; all else as it is.

    Args:
        lines: each with its severity, its rule or whatever else distinguishes it, and its text.
    """
    groups: dict[object, list[Line]] = {}
    for number, (line, severity, rule, text) in enumerate(lines):
        lost = _LOST.match(text)
        groups.setdefault((severity, rule, PurePosixPath(lost["file"]).parent) if lost else number, []).append(line)
    return [
        (some[0], f" (and {len(some) - 1} more files of this folder)" if len(some) > 1 else "")
        for some in groups.values()
    ]


def _short(text: str) -> str:
    """What fits on a screen: names in a hostile file may have a million letters."""
    return text if len(text) <= MOST_LETTERS else f"{text[: MOST_LETTERS - 1]}…"


_MORE = re.compile(r" \(and (\d+) more prims\)$")


def _by_text(notes: Sequence[Note]) -> dict[tuple[str, str], tuple[list[str], int]]:
    """(severity, text) -> the paths that are listed, and how many there are; the translation lists some and counts the
    rest.
    """
    grouped: dict[tuple[str, str], tuple[list[str], int]] = {}
    for note in notes:
        rest = _MORE.search(note.text)
        key = (note.severity, _MORE.sub("", note.text))
        paths, count = grouped.get(key, ([], 0))
        grouped[key] = ([*paths, note.path], count + 1 + (int(rest[1]) if rest else 0))
    return grouped
