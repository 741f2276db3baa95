"""`FogPath` and its siblings for a loaded scene, as the models of `render.models` want them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from synfog_usd.base.errors import ParameterError
from synfog_usd.base.numbers import RGB
from synfog_usd.render import backend
from synfog_usd.render.integrators.light_groups import LightGroups
from synfog_usd.render.integrators.path import FogPath, Truncation
from synfog_usd.render.lights.importance import emitter_index
from synfog_usd.render.lights.rows import is_sampled_light
from synfog_usd.render.lights.sampler import LightSampler
from synfog_usd.render.load import MitsubaScene
from synfog_usd.render.media.medium import Medium, unsupported_fog
from synfog_usd.render.spectra.bands import Bands
from synfog_usd.scene import SceneDict

OTHER = "other"
"""Light group of lamps that have none."""


def make_tracer(
    loaded: MitsubaScene,
    *,
    scatterings: int | None = None,
    bounces: int | None = None,
    bands: int = RGB,
    regularize: bool = True,
) -> FogPath:
    """Path tracing with the fog's edge in closed form.

    Args:
        scatterings, bounces: see `Truncation`; None is no limit.
        bands: what a path carries, see `spectra.bands`.
        regularize: see `FogPath`.

    Raises:
        ParameterError: a density grid whose extinction differs between the bands.
    """
    limits = {name: value for name, value in (("scatterings", scatterings), ("bounces", bounces)) if value is not None}
    world = loaded.source.world
    sampled = sum(is_sampled_light(part) for part in world.values())
    sky = loaded.scene.environment() is not None
    other_lights = len(loaded.scene.emitters()) - sky - sampled
    spectra, kind_of = _emissions(loaded, bands)
    carried = Bands(bands, loaded.source.fog, spectra)
    carried.assign_spectral_bsdfs(loaded)
    medium = Medium(loaded.source.fog, carried.clearest)
    if medium.grids and carried.coloured and carried.ratio.max() > 1.0:
        path = next(volume.path for volume in medium.volumes if volume.medium.grid is not None)
        raise ParameterError(
            f"{path}: wavelength bands take no grid or patchy fog with an Angstrom exponent; make it grey, or use R, "
            f"G and B"
        )
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
        other_lights=other_lights,
        light_groups=LightGroups(names, of_emitter, carried),
        truncation=cut,
        regularize=regularize,
    )


def make_single(loaded: MitsubaScene, *, bands: int = RGB, regularize: bool = True) -> FogPath:
    """Light that the fog scattered once at most."""
    return make_tracer(loaded, scatterings=1, bands=bands, regularize=regularize)


def path_refuses(scene: SceneDict) -> str:
    """Why a scene is outside of `FogPath`'s domain, or ''."""
    return "it needs LLVM or CUDA" if backend.is_scalar() else unsupported_fog(scene.fog)


def _emissions(loaded: MitsubaScene, bands: int) -> tuple[list[Any], dict[str, int]]:
    """Spectra of lamps that have their own, each once, and key of a lamp -> its kind of light, from 1 on."""
    number_of: dict[bytes, int] = {}
    spectra, kind_of = [], {}
    for key, curve in loaded.source.emission_of.items() if bands != RGB else ():
        word = curve.tobytes()
        if word not in number_of:
            spectra.append(curve)
            number_of[word] = len(spectra)
        kind_of[key] = number_of[word]
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
    everything = [
        emitter_index(emitter) for emitter in loaded.scene.emitters()
    ]  # a scene made by hand may name its lights otherwise: the sky's
    table = np.full(
        max([*index_of.values(), *everything], default=0) + 1,
        kinds * (names.index("sky") if "sky" in names else 0),
        dtype=np.uint32,
    )
    for key, index in index_of.items():
        table[index] = numbers[key]
    return names, numbers, backend.numbers(table)
