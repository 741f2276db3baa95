"""What is wrong with a stage, before a picture is made of it.

Takes a stage; gives findings.  What does not compose comes first, then USD's own
validators, then the rules of `synfog_usd.stage.rules`.
"""

from __future__ import annotations

from pxr import Usd, UsdUtils, UsdValidation

from synfog_usd.stage import rules
from synfog_usd.stage.open import MATERIALX, check_size, composition_notes, plain_errors
from synfog_usd.stage.rules import Finding

_PREFIX = "usd: "


@plain_errors
def check(stage: Usd.Stage) -> list[Finding]:
    """All findings on a stage, USD's own and ours.

    Raises:
        StageError: beyond a budget of `synfog_usd.stage.budget`, or damaged.
    """
    check_size(stage)
    return [*_composition(stage), *_usd_findings(stage), *rules.findings(stage)]


def _composition(stage: Usd.Stage) -> list[Finding]:
    """References that do not compose; MaterialX files, which the library cannot read, stop nothing."""
    found = []
    for note in composition_notes(stage):
        one = rules.finding("composition", note.path, note.text)
        found.append(Finding("warning", note.path, note.text, one.rule, one.mend) if note.text.endswith(MATERIALX) else one)
    return found


def _usd_findings(stage: Usd.Stage) -> list[Finding]:
    context = UsdValidation.ValidationContext(UsdValidation.ValidationRegistry().GetOrLoadAllValidators())
    quiet = UsdUtils.CoalescingDiagnosticDelegate()  # validators print what they also return
    errors = context.Validate(stage)
    del quiet
    findings = []
    for error in errors:
        warning = error.GetType() != UsdValidation.ValidationErrorType.Info
        paths = [str(site.GetPrim().GetPath()) for site in error.GetSites() if site.IsPrim()]
        text = f"{_PREFIX}{' '.join(error.GetMessage().split())} ({error.GetName()})"
        findings.append(Finding("warning" if warning else "info", paths[0] if paths else "", text, f"usd:{error.GetName()}"))
    return findings
