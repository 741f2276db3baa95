"""Whether a stage changes over its frames: by its values at those times, whatever time samples it has."""

from __future__ import annotations

from collections.abc import Sequence

from pxr import Usd

from synfog_usd.stage.open import plain_errors


@plain_errors
def stands_still(stage: Usd.Stage, codes: Sequence[float]) -> bool:
    """Whether no attribute of any prim has another value at one of the time codes than at the first."""
    first, *later = (Usd.TimeCode(code) for code in codes)
    for root in [stage.GetPseudoRoot(), *stage.GetPrototypes()]:
        for prim in Usd.PrimRange(root):
            for attribute in prim.GetAuthoredAttributes():
                if attribute.ValueMightBeTimeVarying():
                    value = attribute.Get(first)
                    if any(attribute.Get(code) != value for code in later):
                        return False
    return True
