"""Denoising that does not paint back what the fog hides.

A denoiser that is guided by clear-air albedo and normals draws a wall at full
contrast where a hundredth of its light arrives: for a defogging data set, poison.
So the components are cleaned apart, each without what the fog does to it in closed form:

    L = T * clean(surface / T | albedo, normal) + (1 - T) * clean(airlight / (1 - T))

The surface's light gets guides, fainter the less of it is seen, and its transmittance
afterwards, so an edge can keep no more than T of its contrast; the airlight, scattered
once or more often, gets none.  A component that is known without noise is not cleaned.
Takes arrays and Intel Open Image Denoise; knows nothing of models or files.  The same
input gives the same bytes, with any number of threads; not from one kind of processor
to another.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal

import drjit as dr
import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import FloatArray, Pixels, total
from synfog_usd.base.errors import ParameterError
from synfog_usd.base.progress import Progress, silent
from synfog_usd.render import backend, dualbuffer
from synfog_usd.render.film.accumulator import DIRECT, HALVES, LIT, SHARE_PX
from synfog_usd.render.film.raster import Raster
from synfog_usd.render.load import MitsubaScene
from synfog_usd.render.media.medium import Medium, unsupported_fog
from synfog_usd.render.motion import moved

if TYPE_CHECKING:
    from drjit.auto.ad import Float, UInt32
    from mitsuba import Color3f, Normal3f, Ray3f, Scene

    from synfog_usd.render.placed import PlacedScene

INSTALL = "pip install pyoidn"

Network = Literal["high", "balanced", "fast"]
"""Of Open Image Denoise, the slowest first."""

SURFACE = "surface"
"""The component with guides; every other is taken for airlight."""

AIRLIGHT = "airlight"
"""All that fog scatters, where light is divided by group."""

NOISELESS = (DIRECT,)
"""Components that are added as they are."""

FAINT_SURFACE = 0.02
"""Transmittance below which the surface AOV is divided by this instead.

It is the threshold of contrast by which visibility is defined (Koschmieder 1924).
"""

FAINT_AIR = 1e-3
"""Opacity below which the airlight is divided by this instead."""

HALF_GUIDED = 0.01
"""Transmittance at which a guide counts half."""

BRIGHT = 1e4
"""Times the typical pixel's luminance beyond which light of surfaces is not denoised.

Open Image Denoise returns a flat patch as bright as this with an error of 6 %, and a brighter one with more.  Of
indirect light only what both halves have is so bright; the rest is fireflies.
"""

BORDER_PX = 16
"""Pixels that are mirrored on every side.  Without them the border of a constant image comes back 4 % wrong."""

GUIDE_RAYS = (8, 64)
"""Rays of a pixel that the guides are means of: the least, of a large picture, and the most."""

PICTURE_RAYS = 1 << 22
"""Rays of a picture for its guides, as far as `GUIDE_RAYS` allows."""

FEW = 16
"""Samples under which a picture gets Open Image Denoise's smaller networks, in half of the time.

Surfaces get the balanced network (4 % more error at 4 samples), airlight and `LIT` the fast one.
"""

MEMORY_MB = 700
"""Memory of Open Image Denoise.  It then works in tiles and gives the same bytes."""

LANES = 1 << 19
"""Pixels that are looked at together."""

KEPT_RAYS = 1 << 23
"""Rays of a picture up to which what they meet is kept for the next fog, in 28 B each."""

CROSSINGS = 64
"""Leaves and fog boundaries that a guide ray goes through at most."""


@dataclass(frozen=True)
class Guides:
    """What a denoiser may know of the surfaces: means over a few rays in each pixel.

    Attributes:
        albedo: (H, W, 3) diffuse reflectance, 0 to 1; 1 for lamps, mirrors, glass and the sky.
        normal: (H, W, 3) world frame, turned to the camera, of length 0 (the sky) to 1.
        transmittance: (H, W) of the fog before the surfaces.
        in_squares: whether airlight is cleaned in squares of `SHARE_PX`, as its paths were.
    """

    albedo: FloatArray
    normal: FloatArray
    transmittance: FloatArray
    in_squares: bool = False


def available() -> str:
    """'' where images can be denoised here, else why not and what helps."""
    try:
        _oidn()
    except ParameterError as error:
        return str(error)
    return ""


@dataclass(frozen=True)
class Denoised:
    """A picture without noise.

    Attributes:
        components: name -> (H, W, C), not negative, which add up to the picture.
        error: of the picture's luminance; None where it was not estimated.
        quick: whether it was made with smaller networks, see `FEW`.
    """

    components: dict[str, FloatArray]
    error: dualbuffer.Error | None
    quick: bool

    def luminance(self, weights: npt.ArrayLike) -> FloatArray:
        """(H, W) of the picture, for (C,) weights of the channels in it."""
        return total(self.components.values()) @ np.asarray(weights, dtype=np.float32)


Halves = Callable[[], tuple[FloatArray, FloatArray]]
"""Makes two halves of a component, (2, H, W, C): as they were sampled, and with fireflies spread out."""


def denoise_halves(
    halves: Mapping[str, Halves],
    guides: Guides,
    weights: npt.ArrayLike,
    *,
    quick: bool = False,
    progress: Progress = silent,
) -> Denoised:
    """Clean a picture from two independent halves of its samples, and tell what is left.

    Open Image Denoise knows fireflies by their brightness, and takes what is left of one that was cut for texture.  So
    it gets the samples as they are.  What it errs in is judged by the light with fireflies spread out.

    Args:
        halves: component -> what makes its halves, see `denoise`; they are made one after the other.  `LIT` is part of
            `SURFACE` in the result.
        weights: (C,) of the channels in luminance.
        quick: with Open Image Denoise's smaller networks, see `FEW`.
        progress: told after each component.

    Raises:
        DenoiserError: Open Image Denoise fails.
    """
    weights = np.asarray(weights, dtype=np.float32)
    components, coarse = dict[str, FloatArray](), _binned(guides)
    noisy = done = np.zeros((HALVES, *guides.transmittance.shape), dtype=np.float32)
    for index, (name, make) in enumerate(halves.items()):
        progress("denoising", index / len(halves))
        sampled, spread = make()
        finished = pair = spread
        if name not in NOISELESS:
            seen = coarse if guides.in_squares and name not in (SURFACE, LIT) else guides
            if seen is coarse:
                sampled, spread = (
                    np.stack([dualbuffer.binned(half, SHARE_PX) for half in two]) for two in (sampled, spread)
                )
            least = {SURFACE: sampled.min(axis=0)}  # of LIT each half is right
            cleaned = np.stack([denoise({name: half}, seen, quick=quick, least=least)[name] for half in sampled])
            finished = dualbuffer.towards_truth(spread, cleaned, weights, nearby=name == LIT)
            if seen is coarse:
                finished = np.stack([_fine_air(half, coarse, guides) for half in finished])
        noisy, done = noisy + pair @ weights, done + finished @ weights
        part = SURFACE if name == LIT else name
        components[part] = components.get(part, np.float32(0.0)) + finished.mean(axis=0)
    return Denoised(components, dualbuffer.error_of(noisy, done), quick)


def denoise_draft(
    halves: Mapping[str, Halves],
    guides: Guides,
    weights: npt.ArrayLike,
    *,
    progress: Progress = silent,
) -> Denoised:
    """Clean a draft: surfaces once and airlight once, by Open Image Denoise's smaller networks.

    It takes the arguments of `denoise_halves` and a third of its time.  Its error is up to a sixth larger, and is not
    estimated.

    Returns:
        components `SURFACE`, those of `NOISELESS`, and `AIRLIGHT` for all that fog scatters.

    Raises:
        DenoiserError: Open Image Denoise fails.
    """
    means = dict[str, FloatArray]()
    for name, make in halves.items():
        of_surfaces = name in (SURFACE, LIT)
        part = SURFACE if of_surfaces else name if name in NOISELESS else AIRLIGHT
        means[part] = means.get(part, np.float32(0.0)) + make()[0].mean(axis=0)
    components, coarse = dict[str, FloatArray](), _binned(guides)
    for index, (name, mean) in enumerate(means.items()):
        progress("denoising", index / len(means))
        if name == AIRLIGHT and guides.in_squares:
            air = denoise({name: dualbuffer.binned(mean, SHARE_PX)}, coarse, quick=True)[name]
            components[name] = _fine_air(air, coarse, guides)
        else:
            components[name] = denoise({name: mean}, guides, quick=True)[name]
        if name not in NOISELESS:
            components[name] = dualbuffer.given_back(mean[None], components[name][None], weights)[0]
    return Denoised(components, None, quick=True)


def denoise(
    components: Mapping[str, npt.ArrayLike],
    guides: Guides,
    *,
    quick: bool = False,
    least: Mapping[str, FloatArray] | None = None,
) -> dict[str, FloatArray]:
    """Clean the components of a foggy image.

    Args:
        components: name -> (H, W, C) linear light as it arrives, any unit.  `SURFACE` and `LIT` are the surfaces', T *
            L_surface, those of `NOISELESS` stay as they are, and each other is light scattered in the fog.  What is
            below 0 (noise of a control variate) counts as 0.
        guides: see `guides`.  The transmittance of the pixel's centre is no substitute for theirs: at an edge
            the light is a mean, and dividing it by one side's T tripled the error of the image.
        quick: with Open Image Denoise's smaller networks, see `FEW`.
        least: name -> what all halves of its samples have, (H, W, C), see `BRIGHT`; where left out, the component.

    Returns:
        the same names, float32, not negative; their sum is the image.

    Raises:
        ParameterError: shapes that do not fit, values that are not finite, or no pyoidn.
        DenoiserError: Open Image Denoise fails.

    Measured at 64 samples a pixel, RMS error before and after: 10.3 and 1.7 % (street, MOR 100), 42 and 2.6 % (the
    same, MOR 30), 15 and 3.1 % (canyon).
    Light of rare bright samples is lost in part: see `dualbuffer.towards_truth`.
    """
    images = {name: _image(name, pixels) for name, pixels in components.items()}
    through = _image("transmittance", np.asarray(guides.transmittance)[..., None])
    albedo, normal = _image("albedo", guides.albedo), _image("normal", guides.normal)
    first, shape = next((name, image.shape) for name, image in images.items())
    shapes = [(name, image, shape) for name, image in images.items()]
    shapes += [("transmittance", through, (*shape[:2], 1))]
    shapes += [("albedo", albedo, (*shape[:2], 3)), ("normal", normal, (*shape[:2], 3))]
    for name, image, fits in shapes:
        if image.shape != fits:
            raise ParameterError(f"denoise: {name} is {image.shape}, and {first} is {shape}; it must be {fits}")
    if through.min() < 0.0 or through.max() > 1.0:
        raise ParameterError(
            f"denoise: transmittance reaches from {through.min():g} to {through.max():g}; it must be within 0 and 1"
        )
    cleaned: dict[str, FloatArray] = {}
    for name, image in images.items():
        if name in NOISELESS:
            cleaned[name] = np.maximum(image, 0.0)
        elif name in (SURFACE, LIT):
            network: Network = "high" if not quick else "fast" if name == LIT else "balanced"
            steady = np.minimum(image, (least or {}).get(name, image))
            cleaned[name] = _clean_surface(image, steady, through, albedo, normal, network)
        else:
            cleaned[name] = _clean_air(image, through, "fast" if quick else "high")
    return cleaned


def _clean_air(image: FloatArray, through: FloatArray, network: Network) -> FloatArray:
    """Light of the fog, (H, W, C), before what the fog lets `through`, (H, W, 1).

    Guides say that there is no edge: that errs 2 to 15 % less than no guides at all.  A large frame fills memory: what
    the denoiser does not need is made anew after it.
    """
    hiding = np.maximum(1.0 - through, FAINT_AIR)
    flat = np.ones((*image.shape[:2], 3), dtype=np.float32)
    return hiding * _clean(image / hiding, _as_guides(flat, np.zeros_like(flat)), network=network)


def _binned(guides: Guides) -> Guides:
    """Means over squares of `SHARE_PX`."""
    albedo, normal = dualbuffer.binned(guides.albedo, SHARE_PX), dualbuffer.binned(guides.normal, SHARE_PX)
    return Guides(albedo, normal, dualbuffer.binned(guides.transmittance[..., None], SHARE_PX)[..., 0])


def _fine_air(light: FloatArray, coarse: Guides, guides: Guides) -> FloatArray:
    """(H, W, C) airlight of squares, (h, w, C): over what hides the surfaces it is smooth."""
    hiding, finely = (np.maximum(1.0 - seen.transmittance, FAINT_AIR)[..., None] for seen in (coarse, guides))
    over = np.asarray(light / hiding, dtype=np.float32)
    return np.asarray(finely * dualbuffer.spread(over, SHARE_PX, finely.shape), dtype=np.float32)


def _clean_surface(
    image: FloatArray,
    steady: FloatArray,
    through: FloatArray,
    albedo: FloatArray,
    normal: FloatArray,
    network: Network,
) -> FloatArray:
    """Light of surfaces, (H, W, C), that the fog dims to `through`, (H, W, 1); `steady` is it without fireflies."""
    dimming, trusted = np.maximum(through, FAINT_SURFACE), through / (through + HALF_GUIDED)
    undimmed = image / dimming
    visible = undimmed[
        through[..., 0] >= FAINT_SURFACE
    ]  # a horizon behind fog is black, and says nothing of the street
    most = np.float32(BRIGHT * _typical(visible if visible.size else undimmed))
    guiding = _as_guides(1.0 - trusted * (1.0 - albedo), trusted * normal)
    light = _clean(np.minimum(undimmed, most), guiding, network=network)
    light += np.maximum(steady / dimming - most, 0.0)
    return dimming * light


def fine(lights: Mapping[str, FloatArray], shape: tuple[int, ...]) -> FloatArray:
    """(H, W, C) all light of a group, whose squares show; arguments as `divide` takes them."""

    def whole(light: FloatArray) -> FloatArray:
        return np.repeat(np.repeat(light, SHARE_PX, axis=0), SHARE_PX, axis=1)[: shape[0], : shape[1]]

    return np.asarray(sum(light if name in NOISELESS else whole(light) for name, light in lights.items()))


def divide(
    denoised: Denoised,
    groups: Iterable[tuple[str, Mapping[str, npt.NDArray[Any]]]],
    guides: Guides,
    *,
    draft: bool = False,
) -> dict[str, FloatArray]:
    """Share a denoised picture out to light groups.

    Each group gets the part of the surfaces, of the airlight and of the lamps' faces that it has of the light of all
    groups.  Each group is cleaned by itself, in pixels of `SHARE_PX`.

    Args:
        denoised: the picture.
        groups: name of each and what the samples found of it, (h, w, C) by component or estimator in squares of
            `SHARE_PX`, but (H, W, C) for `NOISELESS`: at full size the groups of a large frame fill memory.
        guides: see `guides`.
        draft: by shares as they are, not cleaned.

    Returns:
        name -> (H, W, C), not negative; they add up to the picture.

    Raises:
        DenoiserError: Open Image Denoise fails.
    """

    def by_part(lights: Mapping[str, npt.NDArray[Any]]) -> dict[str, FloatArray]:
        sums: dict[str, FloatArray] = {}
        for name, light in lights.items():
            part = SURFACE if name == LIT else name if name == SURFACE or name in NOISELESS else AIRLIGHT
            sums[part] = np.asarray(sums[part] + light if part in sums else light, dtype=np.float32)
        return sums

    coarse = _binned(guides)

    def clean(part: str, light: FloatArray) -> FloatArray:
        if part not in NOISELESS:
            light = np.maximum(light, 0.0) if draft else denoise({part: light}, coarse, quick=denoised.quick)[part]
        trace = np.float32(1e-6) * light.mean(axis=(0, 1), dtype=np.float64).astype(np.float32)
        return light + trace  # where no sample of any group was lit, groups share as in the whole picture

    parts: dict[str, dict[str, FloatArray]] = {}
    pictures = {}
    for group, lights in groups:
        pictures[group] = np.zeros_like(next(iter(denoised.components.values())))
        for part, light in by_part(lights).items():
            parts.setdefault(part, {})[group] = clean(part, light)
    for part, light in by_part(denoised.components).items():
        of_groups = parts.pop(part, {})
        whole = np.maximum(sum(of_groups.values()), np.finfo(np.float32).tiny)
        for group, lit in of_groups.items():
            share = lit / whole
            pictures[group] += light * (share if part in NOISELESS else dualbuffer.spread(share, SHARE_PX, light.shape))
    return pictures


def guides(loaded: MitsubaScene, *, rays: int = GUIDE_RAYS[1]) -> Guides:
    """Look at what each pixel shows, with rays at fixed places in it.

    In a pixel with an edge each side counts as much as its light that arrives:
    the mean is weighted by transmittance.

    Args:
        loaded: scene and sensor.
        rays: a pixel.

    Raises:
        ParameterError: the scalar variant, or fog that `Medium` cannot hold.
    """
    return GuideRays(loaded, rays=rays).guides()


class GuideRays:
    """Rays for `guides` that are under way: the first `LANES` pixels' from the beginning, others when they are asked
    for.  Arguments as there.
    """

    def __init__(self, loaded: MitsubaScene, *, rays: int = GUIDE_RAYS[1]) -> None:
        if backend.is_scalar():
            raise ParameterError(
                f"denoising needs LLVM or CUDA, and this is the scalar variant; {backend.INSTALL_LLVM}"
            )
        camera, fog = loaded.source.camera, loaded.source.fog
        if problem := unsupported_fog(fog):
            raise ParameterError(f"denoising through this fog is not possible: {problem}")
        self._height, self._width, self._rays = camera.height_px, camera.width_px, rays
        self._eye, pixels = _Eye(loaded, Medium(fog)), camera.height_px * camera.width_px
        if pixels * rays <= KEPT_RAYS and not (camera.moves or loaded.source.motion_of):
            self._eye.keep(pixels, rays)
        self._first = self._begin(0)

    def _begin(self, low: int) -> list[Float]:
        mi = backend.mitsuba()
        pixel = dr.arange(mi.UInt32, min(LANES, self._height * self._width - low)) + dr.opaque(mi.UInt32, low)
        albedo, normal, weight, through = _look(self._eye, pixel, dr.opaque(mi.UInt32, self._rays))
        sums = [*albedo, *normal, weight, through]
        dr.eval(*sums)
        return sums

    def guides(self) -> Guides:
        """Wait for them."""
        sums = np.zeros((self._height * self._width, 8), dtype=np.float32)
        for low in range(0, len(sums), LANES):
            sums[low : low + LANES] = backend.rows(self._begin(low) if low else self._first, np.float32)
        albedo, normal, weight, through = np.split(sums.reshape(self._height, self._width, 8), (3, 6, 7), axis=2)
        albedo /= weight
        normal /= weight
        return Guides(albedo, normal, np.minimum(through[..., 0] / self._rays, 1.0))


def _place(number: UInt32, axis: int) -> Float:
    """Where on an axis of pixel, lens or time ray `number` goes, 0 to 1, evenly spread (Roberts 2018, the R sequence in
    five dimensions).
    """
    mi = backend.mitsuba()
    root = 1.1347241384015194  # of x^6 = x + 1
    return dr.minimum(mi.Float((number + 1) * int(root ** -(axis + 1) * 2**32) + (1 << 31)) * 2.0**-32, 1.0 - 2.0**-24)


class _Eye:
    """What a kernel's loop needs to know of a scene and must not carry."""

    def __init__(self, loaded: MitsubaScene, medium: Medium) -> None:
        self.loaded, self.medium, self.raster = loaded, medium, Raster(loaded.source.camera)
        self._surfaces: tuple[Color3f, Normal3f, Float] | None = None
        self.pixels = dr.opaque(backend.mitsuba().UInt32, 1)

    def keep(self, pixels: int, rays: int) -> None:
        """Look at what all rays meet, or take it from when the same scene was looked at in another fog."""
        mi, camera = backend.mitsuba(), self.loaded.source.camera
        surfaces, key = self.loaded.guide_surfaces, (camera.width_px, camera.height_px, rays)
        self.pixels = dr.opaque(mi.UInt32, pixels)
        if key not in surfaces:
            lane = dr.arange(mi.UInt32, pixels * rays)
            dr.make_opaque(lane)
            surfaces.clear()
            surfaces[key] = _meet(self.loaded.tree, self.ray(lane % self.pixels, lane // self.pixels))
            dr.eval(surfaces[key])
        self._surfaces = surfaces[key]

    def look(self, pixel: UInt32, number: UInt32) -> tuple[Color3f, Normal3f, Float]:
        """Albedo, normal and transmittance of what ray `number` of each pixel meets."""
        mi, ray = backend.mitsuba(), self.ray(pixel, number)
        if self._surfaces is None:
            albedo, normal, distance = _meet(self.loaded.tree, ray)
        else:
            at, kinds = number * self.pixels + pixel, (mi.Color3f, mi.Normal3f, mi.Float)
            albedo, normal, distance = (
                dr.gather(kind, values, at) for kind, values in zip(kinds, self._surfaces, strict=True)
            )
        tau = self.medium.optical_depth(ray.o, ray.d, 0.0, distance) if self.medium.foggy else mi.Float(0.0)
        return albedo, normal, dr.exp(-tau)

    def ray(self, pixel: UInt32, number: UInt32) -> Ray3f:
        """Ray `number` of each pixel."""
        mi, camera = backend.mitsuba(), self.loaded.source.camera
        film = (self.raster.corner(pixel) + mi.Point2f(_place(number, 0), _place(number, 1))) / self.raster.size
        ray, _ = self.loaded.sensor.sample_ray(
            0.0, 0.5, film + mi.Point2f(*self.loaded.offset), mi.Point2f(_place(number, 2), _place(number, 3))
        )
        return moved(ray, camera, film.y, _place(number, 4)) if camera.moves else ray


@dr.syntax
def _look(eye: _Eye, pixel: UInt32, rays: UInt32) -> tuple[Color3f, Normal3f, Float, Float]:
    """Sums over the rays of pixels: albedo and normal by weight, weight, transmittance."""
    mi = backend.mitsuba()
    albedo, normal, weights, through = mi.Color3f(0.0), mi.Normal3f(0.0), mi.Float(0.0), mi.Float(0.0)
    number = mi.UInt32(0)
    while number < rays:
        colour, facing, share = eye.look(pixel, number)
        weight = share + 1e-9  # where nothing is seen at all, a plain mean
        albedo += weight * colour
        normal += weight * facing
        weights += weight
        through += share
        number += 1
    return albedo, normal, weights, through


@dr.syntax
def _meet(scene: Scene | PlacedScene, first: Ray3f) -> tuple[Color3f, Normal3f, Float]:
    """Albedo, normal and distance of what rays meet; what is half transparent counts by its share, and as far as half
    of the ray gets.
    """
    mi = backend.mitsuba()
    ray = mi.Ray3f(first)
    albedo, normal = mi.Color3f(0.0), mi.Normal3f(0.0)
    through, distance, crossed, active = mi.Float(1.0), mi.Float(dr.inf), mi.UInt32(0), mi.Bool(True)
    while active:
        si = scene.ray_intersect(ray, active=active)
        surface_hit = active & si.is_valid()
        bsdf = si.bsdf()
        passing = dr.select(
            surface_hit, backend.channel_mean(mi.Color3f(bsdf.eval_null_transmission(si, surface_hit))), 1.0
        )
        matte = surface_hit & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth) & ~si.shape.is_emitter()
        colour = dr.select(matte, dr.clip(mi.Color3f(bsdf.eval_diffuse_reflectance(si, matte)), 0.0, 1.0), 1.0)
        share = dr.select(surface_hit, through * (1.0 - passing), 0.0)
        albedo += share * colour
        normal += dr.select(surface_hit, share, 0.0) * dr.select(
            dr.dot(si.sh_frame.n, ray.d) > 0.0, -si.sh_frame.n, si.sh_frame.n
        )
        through *= passing
        distance = dr.select(surface_hit & (through < 0.5) & (distance == dr.inf), dr.norm(si.p - first.o), distance)
        onward = si.spawn_ray(ray.d)
        ray = dr.select(surface_hit, onward, ray)
        crossed += 1
        active = surface_hit & (through > 1e-3) & (crossed < CROSSINGS)
    return albedo + through, normal, distance


class DenoiserError(ParameterError):
    """Open Image Denoise gave up, for lack of memory or otherwise."""


def _oidn() -> ModuleType:
    try:
        import pyoidn
    except (ImportError, OSError) as error:
        raise ParameterError(f"denoising needs pyoidn, and it does not load: {error}; {INSTALL}") from error
    return pyoidn


def _image(name: str, values: npt.ArrayLike) -> FloatArray:
    image = np.asarray(values, dtype=np.float32)
    if image.ndim != 3 or 0 in image.shape:
        raise ParameterError(f"denoise: {name} is {image.shape}; it must be height, width and channels")
    if not np.isfinite(image).all():
        lost = int((~np.isfinite(image)).any(axis=2).sum())
        raise ParameterError(f"denoise: {lost} pixels of {name} are not finite")
    return image


def _typical(light: Pixels) -> float:
    """Geometric mean of what is lit."""
    lit = light[light > 0.0]
    return float(np.exp(np.log(lit.astype(np.float64)).mean())) if lit.size else 0.0


def _as_guides(albedo: FloatArray, normal: FloatArray) -> dict[str, FloatArray]:
    """Guides as `_clean` takes them."""
    return {"albedo": _framed(np.clip(albedo, 0.0, 1.0)), "normal": _framed(normal)}


def _clean(
    image: FloatArray,
    guides: Mapping[str, FloatArray] | None = None,
    *,
    network: Network = "high",
) -> FloatArray:
    """One pass of Open Image Denoise for each three channels, with a network of it; `guides`, see `_as_guides`, are
    taken as free of noise.
    """
    oidn = _oidn()
    mean = float(np.maximum(image, 0.0).mean(dtype=np.float64))
    if mean == 0.0:
        return np.zeros_like(image)
    scale = np.float32(
        2.0 ** -round(np.log2(mean))
    )  # it takes what is far from 1 for noise or for nothing; a power of two rounds nothing
    image = _framed(image)
    np.maximum(image, 0.0, out=image)
    image *= scale
    channels, parts = image.shape[2], []
    for low in range(0, channels, 3):
        colour = image if channels == 3 else image[:, :, np.minimum(np.arange(low, low + 3), channels - 1)]
        cleaned = _filtered(oidn, {"color": np.ascontiguousarray(colour), **(guides or {})}, network)
        parts.append(cleaned[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX, : channels - low])
    result = np.concatenate(parts, axis=2)
    np.maximum(result, 0.0, out=result)
    result /= scale
    return result


def _filtered(oidn: ModuleType, images: Mapping[str, FloatArray], network: str = "high") -> FloatArray:
    """Open Image Denoise's own result for images (H, W, 3); guides are taken as free of noise.

    On the graphics processor where that renders, else on the processor, which reads and writes the images where they
    lie.
    """
    result = np.empty_like(images["color"])
    pictures, on_cuda = {**images, "output": result}, backend.is_cuda() and oidn.Device.is_cuda_available()
    with (
        oidn.Device(oidn.OIDN_DEVICE_TYPE_CUDA if on_cuda else oidn.OIDN_DEVICE_TYPE_CPU) as device,
        contextlib.ExitStack() as released,
    ):
        device.commit()
        work = oidn.Filter(device, oidn.OIDN_FILTER_TYPE_RT)  # in a `with` it would swallow whatever is raised
        released.callback(work.release)
        if on_cuda:
            there = {
                name: released.enter_context(oidn.Buffer(device, image.nbytes)) for name, image in pictures.items()
            }
            for name, image in images.items():
                there[name].write(0, image.nbytes, image)
        height, width = result.shape[:2]
        for name, image in pictures.items():
            work.set_image(name, there[name] if on_cuda else image, oidn.OIDN_FORMAT_FLOAT3, width, height)
        work.set_bool("hdr", True)
        work.set_bool("cleanAux", len(images) > 1)
        work.set_quality(getattr(oidn, f"OIDN_QUALITY_{network.upper()}"))
        work.set_int("maxMemoryMB", MEMORY_MB)
        work.commit()
        work.execute()
        if on_cuda:
            there["output"].read(0, result.nbytes, result)
        if problem := device.get_error():
            raise DenoiserError(f"Open Image Denoise failed: {problem}")
    if not np.isfinite(result).all():
        raise DenoiserError("Open Image Denoise failed: its result is not finite")
    return result


def _framed(image: FloatArray) -> FloatArray:
    return np.ascontiguousarray(
        np.pad(image, ((BORDER_PX, BORDER_PX), (BORDER_PX, BORDER_PX), (0, 0)), mode="symmetric"), dtype=np.float32
    )
