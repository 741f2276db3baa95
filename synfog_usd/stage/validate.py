"""Findings on a stage before a picture is made of it.

Takes a stage; gives findings: on layers that do not compose, of USD's own
validators, and of the rules of `synfog_usd.stage.rules`.
"""

from __future__ import annotations

import re
from pathlib import Path

from pxr import Usd, UsdUtils, UsdValidation

from synfog_usd.stage import materialx, rules
from synfog_usd.stage.open import composition_notes, plain_errors, who_names
from synfog_usd.stage.rulebook import Finding, finding

_PREFIX = "usd: "

_OF_PACKAGES = "usdUtilsValidators:UsdzPackageValidator"

_MISSING = "put the file in its place, or clear the attribute"

_REPEATED = frozenset({"CompositionError"})
"""Errors that `composition_notes` has too."""

_HARMLESS = frozenset(
    {"MissingDefaultPrim", "MissingMaterialBindingAPI", "InvalidFamilyType", "MismatchedPropertyType"}
)
"""Errors of USD's validators on stages that a bake reads all the same: no default prim, a binding without its schema, a
family of subsets of another kind, and inputs that older exporters wrote as tokens.
"""


@plain_errors
def check(stage: Usd.Stage) -> list[Finding]:
    """All findings on a stage, USD's own and ours.

    Args:
        stage: as `open_stage`, `select` and `override` leave it: within the budgets of `synfog_usd.stage.budget`.

    Raises:
        StageError: it is damaged.
    """
    return [*_composition(stage), *_usd_findings(stage), *rules.findings(stage)]


def _is_known_shader(message: str) -> bool:
    """Whether the shader that USD has not in its registry is one of MaterialX."""
    named = re.search(r"shaderId '([^']*)'", message)
    return named is not None and materialx.is_node(named[1])


def _composition(stage: Usd.Stage) -> list[Finding]:
    """References, payloads and sublayers that do not compose."""
    return [finding("composition", note.path, note.text) for note in composition_notes(stage)]


def _usd_findings(stage: Usd.Stage) -> list[Finding]:
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    if not stage.GetRootLayer().GetFileFormat().IsPackage():  # it lists all files of the stage before it looks
        validators = [each for each in validators if each.GetMetadata().name != _OF_PACKAGES]
    context = UsdValidation.ValidationContext(validators)
    quiet = UsdUtils.CoalescingDiagnosticDelegate()  # validators print what they also return
    errors = context.Validate(stage)
    del quiet
    findings = []
    broken = " ".join(note.text for note in composition_notes(stage))
    for error in errors:
        if error.GetName() == "UnresolvableDependency" and (missing := re.search(r"'(.*)'", error.GetMessage())):
            if Path(missing[1]).name not in broken and not Path(materialx.file_of(missing[1])).is_file():
                findings.append(
                    Finding(
                        "warning",
                        who_names(stage, missing[1]),
                        f"{_PREFIX}{missing[1]} is not there; {_MISSING}",
                        f"usd:{error.GetName()}",
                    )
                )
            continue
        if error.GetName() in _REPEATED or (
            error.GetName() == "MissingShaderIdInRegistry" and _is_known_shader(error.GetMessage())
        ):
            continue
        warning = error.GetType() != UsdValidation.ValidationErrorType.Info and error.GetName() not in _HARMLESS
        paths = [
            str((site.GetPrim() if site.IsPrim() else site.GetProperty()).GetPath())
            for site in error.GetSites()
            if site.IsPrim() or site.IsProperty()
        ]
        text = f"{_PREFIX}{' '.join(error.GetMessage().split())} ({error.GetName()})"
        findings.append(
            Finding("warning" if warning else "info", paths[0] if paths else "", text, f"usd:{error.GetName()}")
        )
    return findings
