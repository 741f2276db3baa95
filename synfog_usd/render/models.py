"""The ways to transport light through fog, by name.

Each model states where it holds.  A model is a function from a loaded scene to a
Mitsuba integrator.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from synfog_usd.errors import ParameterError, did_you_mean
from synfog_usd.render import backend

DEFAULT_MODEL = "volpath"


def volpath() -> Any:
    """Mitsuba's volumetric path tracer: the reference, unbiased and slow.

    Paths are not cut at any depth: with an albedo of 1 a fixed depth darkens dense
    fog.  Russian roulette ends them, after RR_DEPTH events and never with a
    probability above 5 % while nothing was absorbed.

    Valid for any fog, lamp and surface.  Noisy beside lamps, where the inverse
    square of the distance is not sampled.
    Source: Mitsuba 3, src/integrators/volpath.cpp.
    """
    return backend.mitsuba().load_dict({"type": "volpath", "max_depth": -1, "rr_depth": RR_DEPTH})


RR_DEPTH = 8
"""Events before Russian roulette.  Measured in MOR 150 under a uniform sky, 1 / (variance x time): 5, 8 and 16 alike, 2 and 40 a fifth to a quarter worse."""

MODELS: dict[str, Callable[[], Any]] = {"volpath": volpath}


def check_name(name: str) -> None:
    """Refuse a model that does not exist.

    Raises:
        ParameterError: with the names that do.
    """
    if name not in MODELS:
        raise ParameterError(f"--model {name}: not known; it takes {', '.join(MODELS)}.{did_you_mean(name, MODELS)}")
