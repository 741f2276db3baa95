"""The ways to transport light through fog, by name: one record each, which all others read.

A new model is an entry here and a module in `integrators`.  Nothing heavy is imported before one is made.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

from synfog_usd.errors import ParameterError, did_you_mean
from synfog_usd.numbers import RGB, check_bands
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
        cost: seconds of a sample, relative to `path`: rough, from the bench stages, and fixed so that choices repeat.
        unbiased: whether it has no error but noise, where it holds, and without or in the end with regularization.
        peer: whether it is Mitsuba's own: the fog then stands in the scene as null-material shapes, surface and
            airlight are not told apart, and pixels are sampled evenly to the end.
        needs_slab: whether it rests on the plane-parallel solution: one box of fog with a level top, under a sky.
        bands: whether its paths can carry wavelength bands.
        regularizes: whether it widens mirrors before lamps, see `surface.blur`, unless told not to.
        limits: whether its paths can be cut short.
        worth_a_pilot: whether the planner tries it although its error is one that samples do not cure.
    """

    make: Callable[..., Integrator]
    refuses: Callable[[SceneDict], str] = lambda scene: ""
    valid: str = ""
    cost: float = 1.0
    unbiased: bool = False
    peer: bool = False
    needs_slab: bool = False
    bands: bool = False
    regularizes: bool = False
    limits: bool = False
    worth_a_pilot: bool = False

    @property
    def boundaries(self) -> bool:
        """Whether the fog must stand in the scene as null-material shapes."""
        return self.peer


def _of(module: str, function: str, **options: Any) -> Callable[..., Any]:
    """A function of a module of `integrators`, which is imported when it is called."""

    def call(*given: Any, **more: Any) -> Any:
        return getattr(import_module(f"synfog_usd.render.integrators.{module}"), function)(*given, **options, **more)

    return call


MODELS: dict[str, Model] = {
    "asm": Model(
        make=_of("asm", "make_asm", airlight="physical"),
        refuses=_of("asm", "asm_refuses"),
        valid="far from lamps, under an even sky, with transmittances near 0 or 1; see `integrators.asm`",
        cost=0.5,
        worth_a_pilot=True,
    ),
    "asm_estimated": Model(
        make=_of("asm", "make_asm", airlight="estimated"),
        refuses=_of("asm", "asm_refuses"),
        valid="nowhere; it is there to show what guessing the airlight from a picture makes of it",
        cost=0.5,
    ),
    "slab": Model(
        make=_of("tracer", "make_slab"),
        refuses=_of("tracer", "slab_refuses"),
        valid="under a sky alone, with objects small against 1 / extinction; not for lamps, street canyons or under bridges. What objects take from "  # noqa: E501
        "or add to the light scattered in the fog is left out",
        cost=0.4,
        needs_slab=True,
        bands=True,
        regularizes=True,
        worth_a_pilot=True,
    ),
    "single": Model(
        make=_of("tracer", "make_single"),
        refuses=_of("tracer", "path_refuses"),
        valid="up to optical depths of about 0.3; beyond, it loses most of the airlight",
        cost=0.7,
        bands=True,
        regularizes=True,
        worth_a_pilot=True,
    ),
    "path": Model(
        make=_of("tracer", "make_tracer"),
        refuses=_of("tracer", "path_refuses"),
        valid="for any lamp and surface, and for fog in boxes and balls, uniform or exponential, nested or not",
        unbiased=True,
        bands=True,
        regularizes=True,
        limits=True,
    ),
    "path+slab": Model(
        make=_of("tracer", "make_tracer", with_slab=True),
        refuses=_of("tracer", "slab_refuses"),
        valid="where `path` is, for one box of fog with a level top under a sky; unbiased to 0.05 %. Fast where most of what is seen is fog, ground "  # noqa: E501
        "and sky; slower than `path` in a street canyon, under a bridge or where lamps are all the light",
        cost=1.3,
        unbiased=True,
        needs_slab=True,
        bands=True,
        regularizes=True,
        limits=True,
    ),
    "volpath": Model(
        make=_of("peers", "make_peer", plugin="volpath"),
        valid="for any fog, lamp and surface",
        cost=10.0,
        unbiased=True,
        peer=True,
    ),
    "volpathmis": Model(
        make=_of("peers", "make_peer", plugin="volpathmis"),
        valid="for any fog and surface; lamps may give NaN (seen with a spot inside the fog)",
        cost=10.0,
        unbiased=True,
        peer=True,
    ),
}
"""By name, cheapest first."""


def having(fact: str) -> tuple[str, ...]:
    """Names of the models of which a fact of `Model` is true."""
    return tuple(name for name, model in MODELS.items() if getattr(model, fact))


def ours_unbiased() -> tuple[str, ...]:
    """Names of our own models without bias: those that a planner chooses from and that a reference is made with."""
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
        name: a model, or 'auto' for the cheapest that holds.

    Raises:
        ParameterError: an unknown name, or a model that does not hold for this scene.
    """
    check_name(name)
    if name != AUTO:
        if problem := MODELS[name].refuses(scene):
            raise ParameterError(f"--model {name} does not hold here: {problem}; use --model auto")
        return name, "asked for"
    ruled_out = []
    for candidate in having("unbiased"):
        if MODELS[candidate].needs_slab:
            continue
        problem = MODELS[candidate].refuses(scene)
        if not problem:
            return candidate, "; ".join([*ruled_out, "the cheapest unbiased one that holds"])
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
