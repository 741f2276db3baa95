"""`FogPath` and its siblings for a loaded scene, as the models of `render.models` want them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from synfog_usd.errors import ParameterError
from synfog_usd.render import backend
from synfog_usd.render.integrators.path import FogPath, Truncation
from synfog_usd.render.lights.importance import emitter_index
from synfog_usd.render.lights.rows import is_sampled_light
from synfog_usd.render.lights.sampler import LightSampler
from synfog_usd.render.load import MitsubaScene
from synfog_usd.render.media.control_variate import make_control_variate
from synfog_usd.render.media.medium import Medium, unsupported_fog
from synfog_usd.render.models import RGB
from synfog_usd.render.spectra.bands import Bands
from synfog_usd.scene import SceneDict

OTHER = "other"
"""Light group of lamps that have none."""


def make_tracer(
    loaded: MitsubaScene,
    *,
    with_slab: bool = False,
    scatterings: int | None = None,
    bounces: int | None = None,
    bands: int = RGB,
    regularize: bool = True,
) -> FogPath:
    """Path tracing with the fog's edge in closed form.

    Args:
        with_slab: sample only what differs from a plane-parallel slab, see `media.control_variate`.
        scatterings, bounces: see `Truncation`; None is no limit.
        bands: what a path carries, see `spectra.bands`.
        regularize: see `FogPath`.

    Raises:
        ParameterError: a slab for a scene that is none.
    """
    limits = {name: value for name, value in (("scatterings", scatterings), ("bounces", bounces)) if value is not None}
    world = loaded.source.world
    sampled = sum(is_sampled_light(part) for part in world.values())
    sky = loaded.scene.environment() is not None
    others = len(loaded.scene.emitters()) - sky - sampled
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
    lights = loaded.light_samplers.get((g, carried.kinds))
    if lights is None:
        lights = LightSampler(world, numbers, g)
        if not loaded.source.motion_of:  # else it knows where the lamps are at one moment
            loaded.light_samplers[g, carried.kinds] = lights
    cut = Truncation(**limits)
    return FogPath(
        loaded,
        medium,
        lights=lights,
        others=others,
        control=control,
        truncation=cut,
        groups=names,
        group_of_emitter=of_emitter,
        bands=carried,
        regularize=regularize,
    )


def make_slab(loaded: MitsubaScene, *, bands: int = RGB, regularize: bool = True) -> FogPath:
    """The slab's airlight, and surfaces in the slab's light with visibility rays."""
    return make_tracer(loaded, with_slab=True, scatterings=0, bounces=2, bands=bands, regularize=regularize)


def make_single(loaded: MitsubaScene, *, bands: int = RGB, regularize: bool = True) -> FogPath:
    """Light that the fog scattered once at most."""
    return make_tracer(loaded, scatterings=1, bands=bands, regularize=regularize)


def path_refuses(scene: SceneDict) -> str:
    """Why a scene is outside of `FogPath`'s domain, or ''."""
    return "it needs LLVM or CUDA" if backend.is_scalar() else unsupported_fog(scene.fog)


def slab_refuses(scene: SceneDict) -> str:
    """Why a scene is not like a plane-parallel slab, or ''."""
    if problem := path_refuses(scene):
        return problem
    if len(scene.fog) != 1:
        return f"it takes one fog volume, and there are {len(scene.fog)}"
    matrix = scene.fog[0].boundary.to_world
    if (
        scene.fog[0].boundary.kind != "box"
        or max(abs(matrix[2, :2]).max(), abs(matrix[:2, 2]).max()) > 1e-5 * abs(matrix[:3, :3]).max()
    ):
        return f"the fog {scene.fog[0].path} is no box with a level top"
    if not any(
        isinstance(part, dict) and part.get("type") in ("constant", "envmap", "sunsky") for part in scene.world.values()
    ):
        return "there is no sky"
    return ""


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


def _groups(
    loaded: MitsubaScene, kinds: int, kind_of: Mapping[str, int]
) -> tuple[tuple[str, ...], dict[str, int], Any]:
    """Names of the light groups that are there; key of a lamp -> its number, group x kinds of light + kind; and the
    same by the renderer's own index.
    """
    source = loaded.source
    shining = [
        key
        for key, part in source.world.items()
        if isinstance(part, dict) and ("emitter" in part or key.startswith("light_"))
    ]
    names = tuple(sorted({source.group_of.get(key, OTHER) for key in shining})) or (OTHER,)
    numbers = {key: names.index(source.group_of.get(key, OTHER)) * kinds + kind_of.get(key, 0) for key in shining}
    index_of = {
        key: emitter_index(loaded.shapes[(key,)].emitter() if (key,) in loaded.shapes else loaded.parts[key])
        for key in shining
    }
    others = [
        emitter_index(emitter) for emitter in loaded.scene.emitters()
    ]  # a scene made by hand may name its lights otherwise: the sky's
    table = np.full(
        max([*index_of.values(), *others], default=0) + 1,
        kinds * (names.index("sky") if "sky" in names else 0),
        dtype=np.uint32,
    )
    for key, index in index_of.items():
        table[index] = numbers[key]
    return names, numbers, backend.numbers(table)
