"""The ways to transport light through fog, by name: one record each, which all others read.

A new model is an entry here and a module in `integrators`.  Nothing heavy is imported before one is made.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, cast

from synfog_usd.base.errors import ParameterError, did_you_mean
from synfog_usd.base.numbers import RGB, check_bands
from synfog_usd.scene import SceneDict

if TYPE_CHECKING:
    from synfog_usd.render.film.accumulator import Integrator
    from synfog_usd.render.load import MitsubaScene

AUTO = "auto"


@dataclass(frozen=True, kw_only=True)
class Model:
    """One way to transport light.

    Attributes:
        make: `Integrator` of a loaded scene; one with `limits` takes `scatterings` and `bounces`, one with `bands`
            takes their number.
        refuses: why a scene is outside its domain, or ''.
        valid: where it holds, in words.
        unbiased: whether it has no error but noise, where it holds, and without or in the end with regularization.
        peer: whether it is Mitsuba's own: the fog then stands in the scene as null-material shapes, surface and
            airlight are not told apart, and pixels are sampled evenly to the end.
        bands: whether its paths can carry wavelength bands.
        regularizes: whether it widens mirrors before lamps, see `surface.blur`, unless told not to.
        limits: whether its paths can be cut short.
    """

    make: Callable[..., Integrator]
    refuses: Callable[[SceneDict], str] = lambda scene: ""
    valid: str = ""
    unbiased: bool = False
    peer: bool = False
    bands: bool = False
    regularizes: bool = False
    limits: bool = False

    @property
    def boundaries(self) -> bool:
        """Whether the fog must stand in the scene as null-material shapes."""
        return self.peer


def _of(module: str, function: str, **fixed: str) -> Callable[..., Any]:
    """A function of a module of `integrators`, which is imported when it is called."""

    def call(*arguments: Any, **options: Any) -> Integrator | str:
        imported = import_module(f"synfog_usd.render.integrators.{module}")
        return cast("Integrator | str", getattr(imported, function)(*arguments, **fixed, **options))

    return call


MODELS: dict[str, Model] = {
    "single": Model(
        make=_of("tracer", "make_single"),
        refuses=_of("tracer", "path_refuses"),
        valid="up to optical depths of about 0.3; beyond, it loses most of the airlight",
        bands=True,
        regularizes=True,
    ),
    "path": Model(
        make=_of("tracer", "make_tracer"),
        refuses=_of("tracer", "path_refuses"),
        valid="for any lamp and surface, and for fog in boxes and balls, even or on grids, nested or not",
        unbiased=True,
        bands=True,
        regularizes=True,
        limits=True,
    ),
    "volpath": Model(
        make=_of("peers", "make_peer", plugin="volpath"),
        valid="for any fog, lamp and surface",
        unbiased=True,
        peer=True,
    ),
    "volpathmis": Model(
        make=_of("peers", "make_peer", plugin="volpathmis"),
        valid="for any fog and surface; lamps may give NaN (seen with a spot inside the fog)",
        unbiased=True,
        peer=True,
    ),
}
"""By name, in the order in which `choose` looks at them."""


def having(fact: str) -> tuple[str, ...]:
    """Names of the models of which a fact of `Model` is true."""
    return tuple(name for name, model in MODELS.items() if getattr(model, fact))


def ours_unbiased() -> tuple[str, ...]:
    """Names of our own models without bias: those that a reference is made with."""
    return tuple(name for name in having("unbiased") if not MODELS[name].peer)


def make(
    name: str,
    loaded: MitsubaScene,
    *,
    scatterings: int | None = None,
    bounces: int | None = None,
    bands: int = RGB,
    regularize: bool = True,
) -> Integrator:
    """A model's integrator, with paths cut short, in wavelength bands or without regularization where that is asked
    for.

    Raises:
        ParameterError: a limit or bands for a model that takes none, or values that do not exist.
    """
    how: dict[str, Any] = {}
    if scatterings is not None or bounces is not None:
        if not MODELS[name].limits:
            raise ParameterError(
                f"--model {name} takes no limit on scatterings or bounces; {' and '.join(having('limits'))} do"
            )
        if min(scatterings or 0, bounces or 0) < 0:
            raise ParameterError(
                f"a path cannot be scattered {min(scatterings or 0, bounces or 0)} times; give 0 or more"
            )
        how |= {"scatterings": scatterings, "bounces": bounces}
    if bands != RGB:
        check_bands(bands)
        if not MODELS[name].bands:
            raise ParameterError(
                f"--model {name} knows R, G and B alone; --bands {bands} takes {', '.join(having('bands'))}"
            )
        how["bands"] = bands
    if not regularize and MODELS[name].regularizes:
        how["regularize"] = False
    return MODELS[name].make(loaded, **how)


def choose(name: str, scene: SceneDict) -> tuple[str, str]:
    """The model for a scene, and why.

    Args:
        name: a model, or 'auto' for the first without bias that holds.

    Raises:
        ParameterError: an unknown name, or a model that does not hold for this scene.
    """
    check_name(name)
    if name != AUTO:
        if problem := MODELS[name].refuses(scene):
            raise ParameterError(f"--model {name} does not hold here: {problem}; use --model auto")
        return name, "asked for"
    ruled_out = list[str]()
    for candidate in having("unbiased"):
        problem = MODELS[candidate].refuses(scene)
        if not problem:
            return candidate, "; ".join([*ruled_out, "the first unbiased one that holds"])
        ruled_out.append(f"not {candidate}: {problem}")
    raise AssertionError("volpath takes any scene")


def check_name(name: str) -> None:
    """Refuse a model that does not exist.

    Raises:
        ParameterError: with the names that do.
    """
    if name not in (AUTO, *MODELS):
        raise ParameterError(
            f"--model {name}: not known; it takes auto, {', '.join(MODELS)}.{did_you_mean(name, (AUTO, *MODELS))}"
        )
