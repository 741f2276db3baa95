"""The rules of `check` as a page, made from the rules themselves."""

from __future__ import annotations

from synfog_usd.stage.rulebook import RULES, TOOLS

HEAD = """\
# Rules of check

This page is made from the rules themselves: `python -m docs.pages`.
[Checking a stage](../check.md) says what `check` does. The advice for Houdini and Omniverse follows their manuals; it was not tried there.
"""  # noqa: E501


def page() -> str:
    """Every rule with its severity, its meaning and its way out in each tool, in Markdown."""
    rows = [
        ["rule", "severity", "what is wrong", *(f"in {tool}" for tool in TOOLS)],
        ["---"] * (3 + len(TOOLS)),
        *([f"`{rule.name}`", rule.severity, rule.meaning, *rule.mend.values()] for rule in RULES.values()),
    ]
    return HEAD + "\n" + "".join(f"| {' | '.join(row)} |\n" for row in rows)
