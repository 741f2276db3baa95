"""Constants of nature and of photometry (SI, exact by definition)."""

from __future__ import annotations

PLANCK_J_S = 6.62607015e-34
"""h, SI Brochure 9 (2019)."""

LIGHT_SPEED_M_S = 299_792_458.0
"""c in vacuum, SI Brochure 9 (2019)."""

LUMINOUS_EFFICACY_LM_W = 683.002
"""K_m of the CIE 1931 observer [lm/W], CIE S 010."""
