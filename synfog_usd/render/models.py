"""The ways to transport light through fog, by name.

Each model states where it holds, and refuses a scene outside of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from synfog_usd.errors import ParameterError, did_you_mean
from synfog_usd.render import backend
from synfog_usd.render.load import Loaded
from synfog_usd.scene import SceneDict

AUTO = "auto"

RR_DEPTH = 8
"""Events before Russian roulette.  Measured in MOR 150 under a uniform sky, 1 / (variance x time): 5, 8 and 16 alike, 2 and 40 up to a quarter worse."""


@dataclass(frozen=True)
class Model:
    """One way to transport light.

    Attributes:
        make: integrator for a loaded scene, as `film.expose` takes it.
        boundaries: whether the fog must stand in the scene as null-material shapes.
        refuses: why a scene is outside its domain, or ''.
    """

    make: Callable[[Loaded], Any]
    boundaries: bool
    refuses: Callable[[SceneDict], str]


def _volpath(loaded: Loaded) -> Any:
    """Mitsuba's volumetric path tracer: the peer, unbiased and slow.

    Paths are not cut at any depth: with an albedo of 1 a fixed depth darkens dense
    fog.  Russian roulette ends them, after RR_DEPTH events and never with a
    probability above 5 % while nothing was absorbed.

    Valid for any fog, lamp and surface.
    Source: Mitsuba 3, src/integrators/volpath.cpp.
    """
    return backend.mitsuba().load_dict({"type": "volpath", "max_depth": -1, "rr_depth": RR_DEPTH})


def _path(loaded: Loaded) -> Any:
    """Path tracing with the fog's edge in closed form; see `fogpath`."""
    from synfog_usd.render.fogpath import FogPath
    from synfog_usd.render.lamps import Lamps, is_handled

    world = loaded.source.world
    handled = sum(is_handled(part) for part in world.values())
    sky = loaded.scene.environment() is not None
    others = len(loaded.scene.emitters()) - sky - handled
    return FogPath(loaded.source.fog[0] if loaded.source.fog else None, lamps=Lamps(world), others=others, sky=sky)


def _path_refuses(scene: SceneDict) -> str:
    if backend.is_scalar():
        return "it needs LLVM or CUDA"
    if len(scene.fog) > 1:
        return f"it takes one fog volume, and there are {len(scene.fog)}"
    for volume in scene.fog:
        if volume.boundary.kind == "mesh":
            return f"the boundary {volume.path} is a mesh, not a box or a sphere"
        if volume.medium.profile != "uniform":
            return f"the fog {volume.path} is not uniform"
    return ""


MODELS: dict[str, Model] = {
    "path": Model(_path, False, _path_refuses),
    "volpath": Model(_volpath, True, lambda scene: ""),
}
"""By name, cheapest first."""


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
    for candidate, model in MODELS.items():
        problem = model.refuses(scene)
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
        raise ParameterError(f"--model {name}: not known; it takes auto, {', '.join(MODELS)}.{did_you_mean(name, (AUTO, *MODELS))}")
