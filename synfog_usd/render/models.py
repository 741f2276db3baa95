"""The ways to transport light through fog, by name.

Each model states where it holds, and refuses a scene outside of it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from synfog_usd.errors import ParameterError, did_you_mean
from synfog_usd.render import backend
from synfog_usd.render.load import MitsubaScene
from synfog_usd.render.spectra.bands import RGB
from synfog_usd.render.spectra.bands import check as check_bands
from synfog_usd.scene import SceneDict

AUTO = "auto"

OTHER = "other"
"""Light group of lamps that have none."""

RR_DEPTH = 8
"""Events before Russian roulette.  Measured in MOR 150 under a uniform sky, 1 / (variance x time): 5, 8 and 16 alike, 2 and 40 up to a quarter worse."""


@dataclass(frozen=True)
class Model:
    """One way to transport light.

    Attributes:
        make: integrator for a loaded scene, as `film.accumulator.accumulate` takes it; see `make` for what some may be told.
        boundaries: whether the fog must stand in the scene as null-material shapes.
        refuses: why a scene is outside its domain, or ''.
    """

    make: Callable[..., Any]
    boundaries: bool
    refuses: Callable[[SceneDict], str]


def _volpath(loaded: MitsubaScene) -> Any:
    """Mitsuba's volumetric path tracer: the peer, unbiased and slow.

    Paths are not cut at any depth: with an albedo of 1 a fixed depth darkens dense
    fog.  Russian roulette ends them, after RR_DEPTH events and never with a
    probability above 5 % while nothing was absorbed.

    Valid for any fog, lamp and surface.
    Source: Mitsuba 3, src/integrators/volpath.cpp.
    """
    return backend.mitsuba().load_dict({"type": "volpath", "max_depth": -1, "rr_depth": RR_DEPTH})


def _volpathmis(loaded: MitsubaScene) -> Any:
    """Mitsuba's other volumetric path tracer: the peer for spectral extinction.

    Valid for any fog and surface; lamps may give NaN (seen with a spot inside the fog).
    Source: Mitsuba 3, src/integrators/volpathmis.cpp.
    """
    return backend.mitsuba().load_dict({"type": "volpathmis", "max_depth": -1, "rr_depth": RR_DEPTH})


def _tracer(loaded: MitsubaScene, *, with_slab: bool = False, in_froxels: bool = False, method: Any = None, bands: int = RGB) -> Any:
    from synfog_usd.render.integrators.froxels import FroxelPath
    from synfog_usd.render.integrators.path import FogPath
    from synfog_usd.render.lights.sampler import LightSampler, is_sampled_light
    from synfog_usd.render.media.control_variate import make_control_variate
    from synfog_usd.render.media.medium import Medium
    from synfog_usd.render.spectra.bands import Bands

    world = loaded.source.world
    handled = sum(is_sampled_light(part) for part in world.values())
    sky = loaded.scene.environment() is not None
    others = len(loaded.scene.emitters()) - sky - handled
    spectra, kind_of = _emissions(loaded, bands)
    carried = Bands(bands, loaded.source.fog, spectra)
    carried.assign_spectral_bsdfs(loaded)
    medium = Medium(loaded.source.fog, carried.clearest)
    control = None
    if with_slab:
        control, problem = make_control_variate(loaded, medium, carried, kind_of.get("light_sky", 0))
        if control is None:
            raise ParameterError(f"the slab cannot be used here: {problem}")
    names, numbers, of_emitter = _groups(loaded, carried.kinds, kind_of)
    g = loaded.source.fog[0].medium.phase_function.mean_cosine if loaded.source.fog else 0.0
    lights = LightSampler(world, numbers, g)
    kind = FroxelPath if in_froxels else FogPath
    return kind(loaded, medium, lights=lights, others=others, control=control, method=method, groups=names, group_of_emitter=of_emitter, bands=carried)


def _index(emitter: Any) -> int:
    """The number by which kernels know an emitter."""
    import drjit as dr

    mi = backend.mitsuba()
    return int(dr.reinterpret_array(mi.UInt32, mi.EmitterPtr(emitter))[0])


def _emissions(loaded: MitsubaScene, bands: int) -> tuple[list[Any], dict[str, int]]:
    """Spectra of lamps that have their own, each once, and key of a lamp -> its kind of light, from 1 on."""
    known: dict[bytes, int] = {}
    spectra, kind_of = [], {}
    for key, curve in loaded.source.emission_of.items() if bands != RGB else ():
        word = curve.tobytes()
        if word not in known:
            spectra.append(curve)
            known[word] = len(spectra)
        kind_of[key] = known[word]
    return spectra, kind_of


def _groups(loaded: MitsubaScene, kinds: int, kind_of: Mapping[str, int]) -> tuple[tuple[str, ...], dict[str, int], Any]:
    """Names of the light groups that are there; key of a lamp -> its number, group x kinds of light + kind; and the same by the renderer's own index."""
    import numpy as np

    mi, source = backend.mitsuba(), loaded.source
    shining = [key for key, part in source.world.items() if isinstance(part, dict) and ("emitter" in part or key.startswith("light_"))]
    names = tuple(sorted({source.group_of.get(key, OTHER) for key in shining})) or (OTHER,)
    numbers = {key: names.index(source.group_of.get(key, OTHER)) * kinds + kind_of.get(key, 0) for key in shining}
    index_of = {key: _index(loaded.shapes[(key,)].emitter() if (key,) in loaded.shapes else loaded.parts[key]) for key in shining}
    others = [_index(emitter) for emitter in loaded.scene.emitters()]  # a scene made by hand may name its lights otherwise: the sky's
    table = np.full(max([*index_of.values(), *others], default=0) + 1, kinds * (names.index("sky") if "sky" in names else 0), dtype=np.uint32)
    for key, index in index_of.items():
        table[index] = numbers[key]
    return names, numbers, mi.UInt32(table)


def _path(loaded: MitsubaScene, **how: Any) -> Any:
    """Path tracing with the fog's edge in closed form; see `integrators.path`.

    Valid for any lamp and surface, and for fog in boxes and balls, uniform or exponential, nested or not.  Unbiased.
    """
    return _tracer(loaded, **how)


def _path_slab(loaded: MitsubaScene, **how: Any) -> Any:
    """`path` that samples only what differs from a plane-parallel slab; see `control_variate`.

    Valid where `path` is, for one box of fog with a level top under a sky.  Unbiased
    to 0.05 %.  Fast where most of what is seen is fog, ground and sky; slower than `path`
    in a street canyon, under a bridge or where lamps are all the light.
    """
    return _tracer(loaded, with_slab=True, **how)


def _slab(loaded: MitsubaScene, **how: Any) -> Any:
    """The slab's airlight, and surfaces in the slab's light with visibility rays.

    What objects take from or add to the light scattered in the fog is left out.
    Valid under a sky alone, with objects small against 1 / extinction; not for lamps,
    street canyons or under bridges.
    """
    from synfog_usd.render.integrators.path import Method

    return _tracer(loaded, with_slab=True, method=Method(scatterings=0, bounces=2), **how)


def _single(loaded: MitsubaScene, **how: Any) -> Any:
    """Light that the fog scattered once at most.

    Valid up to optical depths of about 0.3; beyond, it loses most of the airlight.
    """
    from synfog_usd.render.integrators.path import Method

    return _tracer(loaded, method=Method(scatterings=1), **how)


def _field(loaded: MitsubaScene, **how: Any) -> Any:
    """Airlight from a grid in the camera's view, all else as `path`; see `integrators.froxels`.

    Valid where `path` is, and as far as light that the fog scattered more than once (a sky's: once) changes little over 1.5 degrees.
    """
    return _tracer(loaded, in_froxels=True, **how)


def _field_slab(loaded: MitsubaScene, **how: Any) -> Any:
    """`field`, with the difference to a plane-parallel slab in the cache; all else as `path+slab`.

    Valid where both are.
    """
    return _tracer(loaded, with_slab=True, in_froxels=True, **how)


def _path_refuses(scene: SceneDict) -> str:
    if backend.is_scalar():
        return "it needs LLVM or CUDA"
    from synfog_usd.render.media.medium import unsupported_fog

    return unsupported_fog(scene.fog)


def _slab_refuses(scene: SceneDict) -> str:
    if problem := _path_refuses(scene):
        return problem
    if len(scene.fog) != 1:
        return f"it takes one fog volume, and there are {len(scene.fog)}"
    matrix = scene.fog[0].boundary.to_world
    if scene.fog[0].boundary.kind != "box" or max(abs(matrix[2, :2]).max(), abs(matrix[:2, 2]).max()) > 1e-5 * abs(matrix[:3, :3]).max():
        return f"the fog {scene.fog[0].path} is no box with a level top"
    if not any(isinstance(part, dict) and part.get("type") in ("constant", "envmap", "sunsky") for part in scene.world.values()):
        return "there is no sky"
    return ""


def _asm(airlight: str) -> Callable[[MitsubaScene], Any]:
    def make(loaded: MitsubaScene) -> Any:
        from synfog_usd.render.integrators.asm import make_asm

        return make_asm(loaded, airlight)

    return make


def _asm_refuses(scene: SceneDict) -> str:
    from synfog_usd.render.integrators.asm import asm_refuses

    return asm_refuses(scene)


def _glow(loaded: MitsubaScene) -> Any:
    from synfog_usd.render.integrators.glow import make_glow

    return make_glow(loaded)


def _glow_refuses(scene: SceneDict) -> str:
    from synfog_usd.render.integrators.glow import glow_refuses

    return glow_refuses(scene)


MODELS: dict[str, Model] = {
    "asm": Model(_asm("physical"), False, _asm_refuses),
    "asm_estimated": Model(_asm("estimated"), False, _asm_refuses),
    "slab": Model(_slab, False, _slab_refuses),
    "glow": Model(_glow, False, _glow_refuses),
    "single": Model(_single, False, _path_refuses),
    "field": Model(_field, False, _path_refuses),
    "field+slab": Model(_field_slab, False, _slab_refuses),
    "path": Model(_path, False, _path_refuses),
    "path+slab": Model(_path_slab, False, _slab_refuses),
    "volpath": Model(_volpath, True, lambda scene: ""),
    "volpathmis": Model(_volpathmis, True, lambda scene: ""),
}
"""By name, cheapest first."""

LIMITED = ("path", "path+slab")
"""Models whose paths can be cut short."""

BANDED = ("slab", "single", "field", "field+slab", "path", "path+slab")
"""Models that carry wavelength bands."""

PEERS = ("volpath", "volpathmis")
"""Mitsuba's own; they know no estimators, and are sampled evenly to the end."""

UNBIASED = ("path", "path+slab", "volpath", "volpathmis")
"""Models without an error but noise, where they hold."""


def make(name: str, loaded: MitsubaScene, *, scatterings: int | None = None, bounces: int | None = None, bands: int = RGB) -> Any:
    """A model's integrator, with paths cut short or in wavelength bands where that is asked for.

    Raises:
        ParameterError: a limit or bands for a model that takes none, or values that do not exist.
    """
    how: dict[str, Any] = {}
    if scatterings is not None or bounces is not None:
        from synfog_usd.render.integrators.path import Method

        if name not in LIMITED:
            raise ParameterError(f"--model {name} takes no limit on scatterings or bounces; {' and '.join(LIMITED)} do")
        if min(scatterings or 0, bounces or 0) < 0:
            raise ParameterError(f"a path cannot be scattered {min(scatterings or 0, bounces or 0)} times; give 0 or more")
        how["method"] = Method(**{key: value for key, value in (("scatterings", scatterings), ("bounces", bounces)) if value is not None})
    if bands != RGB:
        check_bands(bands)
        if name not in BANDED:
            raise ParameterError(f"--model {name} knows R, G and B alone; --bands {bands} takes {', '.join(BANDED)}")
        how["bands"] = bands
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
    for candidate in ("path", "volpath"):
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
        raise ParameterError(f"--model {name}: not known; it takes auto, {', '.join(MODELS)}.{did_you_mean(name, (AUTO, *MODELS))}")
