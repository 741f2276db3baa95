"""Fog as a kernel sees it: optical depth in closed form, flights by its inverse; density grids by tracking.

Takes fog volumes; gives, for rays of the wavefront, how much fog lies on a stretch
and where the fog would scatter a path.  No geometry is traced for it.  Boxes and
balls, nested as deep as one likes.  Even fog, uniform or exponential, adds what it has
over the even fog around it, on the stretch that it covers.  A grid (`media.grid`) stands apart: flights
through all of them end where the nearest ends, and their transmittances multiply.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import drjit as dr
import numpy as np

from synfog_usd.base.arrays import Array
from synfog_usd.fog import FogVolume
from synfog_usd.fog.volume import OPAQUE, optical_depth
from synfog_usd.render import backend
from synfog_usd.render.media.grid import GridTracker
from synfog_usd.render.media.phases import kernel_phase
from synfog_usd.render.sampling.sobol import unit

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float, UInt32
    from mitsuba import Point2f, Point3f, Vector3f

    from synfog_usd.render.sampling.sobol import Sobol

Lanes = TypeVar("Lanes")
"""Numbers, directions or colours of the wavefront."""

BISECTIONS = 30
"""Halvings of a stretch until its optical depth fits: 1 km to a micrometre, below what float32 holds."""

WRITTEN_OUT = 4
"""Volumes up to which a kernel holds every halving apart, which is faster; of more it would be too long to compile."""


def unsupported_fog(volumes: Sequence[FogVolume]) -> str:
    """Why `Medium` cannot hold these volumes, or ''."""
    for volume in volumes:
        if volume.boundary.kind == "mesh":
            return f"the boundary {volume.path} is a mesh, not a box or a sphere"
    return ""


class Medium:
    """The fog of one scene.

    Args:
        volumes: fog that `unsupported_fog` does not object to.
        scale: factor on every extinction, see `Bands.clearest`.
    """

    def __init__(self, volumes: Sequence[FogVolume], scale: float = 1.0) -> None:
        self.volumes = [volume for volume in volumes if volume.medium.sigma_t_per_m > 0.0 or volume.parent is not None]
        self.foggy = any(volume.medium.sigma_t_per_m > 0.0 for volume in self.volumes)
        index = {id(volume): place for place, volume in enumerate(self.volumes)}
        around = [None if volume.parent is None else index.get(id(volumes[volume.parent])) for volume in self.volumes]
        self.media = [_Volume(volume, scale, number) for number, volume in enumerate(self.volumes)]
        self.parents = [None if parent is None else self.media[parent] for parent in around]
        self.order = sorted(range(len(self.volumes)), key=lambda place: _nesting(around, place))
        self.single = len(self.volumes) == 1 and self.volumes[0].medium.profile == "uniform"
        self.grids = [medium for medium in self.media if medium.grid is not None]
        self.even = len(self.grids) < len(self.media)
        for medium, parent in zip(self.media, self.parents, strict=True):
            if parent is not None and parent.grid is not None:
                parent.grid.holes.append(medium)
        if self.foggy:
            records = [volume.medium.phase_function for volume in self.volumes]
            distinct = list(dict.fromkeys(records))
            self.phases, self._phase_of = (
                [kernel_phase(record) for record in distinct],
                list(map(distinct.index, records)),
            )
            self.one_albedo = len({volume.medium.albedo for volume in self.volumes}) == 1

    def intersect(self, origin: Point3f, direction: Vector3f) -> tuple[Float, Float]:
        """Where a ray is in fog at all, from the first entry to the last exit [m]; equal where it misses."""
        near, far = self.media[0].intersect(origin, direction)
        for medium in self.media[1:]:
            enters, leaves = medium.intersect(origin, direction)
            crosses = leaves > enters
            none = far <= near
            near = dr.select(crosses, dr.select(none, enters, dr.minimum(near, enters)), near)
            far = dr.select(crosses, dr.maximum(far, leaves), far)
        return near, dr.maximum(far, near)

    def optical_depth(
        self, origin: Point3f, direction: Vector3f, begin: Float | float, end: Float | float, *, grids: bool = True
    ) -> Float:
        """Optical depth between two distances [m] on a ray of unit direction, without noise.

        Args:
            grids: whether density grids count, of which each voxel on the way is looked at.
        """
        total = backend.mitsuba().Float(0.0)
        for medium, parent in zip(self.media, self.parents, strict=True):
            near, far = medium.interval(origin, direction, begin, end)
            if medium.grid is None:
                total += medium.optical_depth(origin, direction, near, far)
            elif grids:
                most = OPAQUE if not medium.grid.holes else math.inf
                total += medium.grid.optical_depth(origin, direction, near, far, most)
            if parent is not None and parent.grid is None:
                total -= parent.optical_depth(origin, direction, near, far)
            elif parent is not None and parent.grid is not None and grids:
                total -= parent.grid.optical_depth(origin, direction, near, far, math.inf)
        return dr.maximum(total, 0.0)

    def optical_depth_inside(self, origin: Point3f, direction: Vector3f, begin: Float, end: Float) -> Float:
        """The same for a stretch that is known to be in fog all along: one uniform fog needs no look for its edge.

        A grid counts as its mean: for a choice between lights, which `gap` makes good.
        """
        if self.single:
            return self.media[0].sigma_t * (end - begin)
        tau = self.optical_depth(origin, direction, begin, end, grids=False)
        return tau + self._mean_depth(origin, direction, begin, end) if self.grids else tau

    def transmittance(
        self,
        origin: Point3f,
        direction: Vector3f,
        begin: Float | float,
        end: Float | float,
        sampler: Sobol,
        active: Bool,
    ) -> tuple[Float, Float]:
        """Transmittance between two distances [m], in closed form; through grids unbiased.

        Returns:
            it, and the optical depth of what is no grid.
        """
        tau = self.optical_depth(origin, direction, begin, end, grids=False)
        through = dr.exp(-tau)
        if self.grids:
            through *= self._through_grids(origin, direction, begin, end, sampler, active)
        return through, tau

    def gap(
        self, origin: Point3f, direction: Vector3f, begin: Float, end: Float, sampler: Sobol, active: Bool
    ) -> Float:
        """Transmittance of a stretch, unbiased, over what `optical_depth_inside` says of it."""
        through = self._through_grids(origin, direction, begin, end, sampler, active)
        return through * dr.exp(self._mean_depth(origin, direction, begin, end))

    def sample_distance(
        self, origin: Point3f, direction: Vector3f, optical_depth: Float, near: Float, far: Float
    ) -> Float:
        """Distance [m] at which the optical depth from `near` on is `optical_depth`; at most `far`.  Of even fog."""
        if self.single:
            return dr.minimum(near + optical_depth / self.media[0].sigma_t, far)

        def depth(end: Float) -> Float:
            return self.optical_depth(origin, direction, near, end, grids=False)

        def halved(step: UInt32 | int, low: Float, high: Float) -> tuple[UInt32 | int, Float, Float]:
            middle = 0.5 * (low + high)
            short = depth(middle) < optical_depth
            return step + 1, dr.select(short, middle, low), dr.select(short, high, middle)

        state: tuple[Any, Any, Any] = (0, near, far)
        if len(self.media) <= WRITTEN_OUT:
            for _ in range(BISECTIONS):
                state = halved(*state)
        else:
            state = dr.while_loop((backend.mitsuba().UInt32(0), near, far), lambda step, *_: step < BISECTIONS, halved)
        _, low, high = state
        return dr.select(depth(far) > optical_depth, 0.5 * (low + high), far)

    def sample_flight(
        self, origin: Point3f, direction: Vector3f, near: Float, far: Float, u: Float, sampler: Sobol, active: Bool
    ) -> Float:
        """Distance [m] at which fog between `near` and `far` scatters a ray, infinite where it does not: density in
        proportion to transmittance x extinction.

        Args:
            u: number in [0, 1) that draws it; a grid draws more of them from `sampler`.
        """
        flight = backend.mitsuba().Float(dr.inf)
        if self.even:
            distance = self.sample_distance(origin, direction, -dr.log(1.0 - u), near, far)
            flight = dr.select(active & (distance < far), distance, flight)
        for number, medium in enumerate(self.grids):
            begin, end = medium.interval(origin, direction, near, dr.minimum(far, flight))
            key = sampler.stream()
            first = u if number == 0 and not self.even else unit(key)
            assert medium.grid is not None
            place = medium.grid.track(origin, direction, begin, end, first, key, active, True)[1]
            flight = dr.minimum(flight, place)
        return flight

    def transmittance_inside(
        self, origin: Point3f, direction: Vector3f, near: Float, end: Float, sampler: Sobol, active: Bool
    ) -> Float:
        """Transmittance of a stretch that is known to be in fog all along."""
        if self.grids:
            return self.transmittance(origin, direction, near, end, sampler, active)[0]
        return transmittance(self.optical_depth_inside(origin, direction, near, end))[0]

    def sample_inside(
        self, origin: Point3f, direction: Vector3f, near: Float, end: Float, u: Float, sampler: Sobol, active: Bool
    ) -> tuple[Float, Float]:
        """What a stretch in fog scatters, 1 - its transmittance without cancellation, and where [m]: drawn by `u` in
        proportion to transmittance x extinction.  Of grids both are unbiased as a pair.
        """
        if not self.grids:
            opaque = transmittance(self.optical_depth_inside(origin, direction, near, end))[1]
            return opaque, self.sample_distance(origin, direction, -dr.log(1.0 - u * opaque), near, end)
        if len(self.media) > 1:
            place = self.sample_flight(origin, direction, near, end, u, sampler, active)
            return dr.select(dr.isfinite(place), backend.mitsuba().Float(1.0), 0.0), place
        grid = self.media[0].grid
        assert grid is not None
        key = sampler.stream()
        through, place = grid.track(origin, direction, near, end, u, key, active, False)
        return 1.0 - through, place

    def _through_grids(
        self,
        origin: Point3f,
        direction: Vector3f,
        begin: Float | float,
        end: Float | float,
        sampler: Sobol,
        active: Bool,
    ) -> Float:
        through = backend.mitsuba().Float(1.0)
        for medium in self.grids:
            near, far = medium.interval(origin, direction, begin, end)
            key = sampler.stream()
            assert medium.grid is not None
            lit = active & (through > 0.0)
            through *= medium.grid.track(origin, direction, near, far, unit(key), key, lit, False)[0]
        return through

    def _mean_depth(self, origin: Point3f, direction: Vector3f, begin: Float | float, end: Float | float) -> Float:
        """Optical depth of a stretch if all grids were even."""
        total = backend.mitsuba().Float(0.0)
        for medium in self.grids:
            near, far = medium.interval(origin, direction, begin, end)
            assert medium.grid is not None
            total += medium.grid.mean_sigma_t * (far - near)
        return total

    def scattering(self, place: Point3f) -> Float:
        """Scattering coefficient [1/m] at points in fog."""
        if self.single:
            return self.media[0].sigma_t * self.media[0].albedo
        return self._innermost(
            place, lambda medium: medium.extinction(place) * medium.albedo, backend.mitsuba().Float(0.0)
        )

    def extinction(self, place: Point3f) -> Float:
        """Extinction [1/m] at points in fog."""
        if self.single:
            return self.media[0].sigma_t
        return self._innermost(place, lambda medium: medium.extinction(place), backend.mitsuba().Float(0.0))

    def albedo(self, place: Point3f) -> Float:
        """Single-scattering albedo at points in fog."""
        if self.one_albedo:
            return self.media[0].albedo
        return self._innermost(place, lambda medium: medium.albedo, self.media[0].albedo)

    def phase_value(self, place: Point3f, cosine: Float) -> Float:
        """Density [1/sr] at points in fog at the cosine between the directions of travel."""
        return self._by_phase(place, [phase.value(cosine) for phase in self.phases])

    def phase_sample(self, place: Point3f, forward: Vector3f, u: Point2f) -> tuple[Vector3f, Float]:
        """A direction of travel after scattering at points in fog, and its density [1/sr]."""
        directions, densities = zip(*(phase.sample(forward, u) for phase in self.phases), strict=True)
        return self._by_phase(place, directions), self._by_phase(place, densities)

    def _by_phase(self, place: Point3f, options: Sequence[Lanes]) -> Lanes:
        return options[0] if len(options) == 1 else self.by_volume(place, [options[at] for at in self._phase_of])

    def by_volume(self, place: Point3f, options: Sequence[Lanes]) -> Lanes:
        """Of values by volume those of the innermost one around points in fog."""
        return self._innermost(place, lambda medium: options[medium.number], options[0])

    def _innermost(self, place: Point3f, value: Callable[[_Volume], Lanes], outside: Lanes) -> Lanes:
        result = outside
        for at in self.order:
            medium = self.media[at]
            result = dr.select(medium.contains(place), value(medium), result)
        return result


def _nesting(around: Sequence[int | None], place: int) -> int:
    parent = around[place]
    return 0 if parent is None else 1 + _nesting(around, parent)


class _Volume:
    """One volume's numbers, out of the compiler's sight so that others need no new kernel."""

    def __init__(self, volume: FogVolume, scale: float, number: int) -> None:
        mi, self.number = backend.mitsuba(), number
        to_world, self.ball = mi.ScalarTransform4f(volume.boundary.to_world), volume.boundary.kind == "sphere"
        self.to_local = mi.Transform4f(to_world.inverse())
        dr.make_opaque(self.to_local)
        medium = volume.medium
        self.sigma_t, self.albedo = (
            dr.opaque(mi.Float, scale * medium.sigma_t_per_m),
            dr.opaque(mi.Float, medium.albedo),
        )
        self.exponential = medium.profile == "exponential"
        self.grid = None if medium.grid is None else GridTracker(volume, self.sigma_t)
        self.mean_sigma_t = self.sigma_t if self.grid is None else self.grid.mean_sigma_t
        if self.exponential:
            self.base, self.scale = (
                dr.opaque(mi.Float, medium.base_height_m),
                dr.opaque(mi.Float, medium.scale_height_m),
            )

    def contains(self, place: Point3f) -> Bool:
        """Whether points are inside."""
        mi = backend.mitsuba()
        local = mi.Vector3f(self.to_local @ mi.Point3f(place))
        return dr.squared_norm(local) <= 1.0 if self.ball else dr.max(dr.abs(local)) <= 1.0

    def intersect(self, origin: Point3f, direction: Vector3f) -> tuple[Float, Float]:
        """Where a ray enters and leaves, as distances >= 0; equal where it misses."""
        mi = backend.mitsuba()
        o, d = self.to_local @ mi.Point3f(origin), self.to_local @ mi.Vector3f(direction)
        if self.ball:
            a, b, c = dr.dot(d, d), dr.dot(o, d), dr.dot(o, o) - 1.0
            root = dr.sqrt(dr.maximum(b * b - a * c, 0.0))
            near, far = (-b - root) / a, (-b + root) / a
        else:
            safe = mi.Vector3f([dr.select(dr.abs(x) < 1e-12, dr.copysign(mi.Float(1e-12), x), x) for x in d])
            low, high = (-1.0 - mi.Vector3f(o)) / safe, (1.0 - mi.Vector3f(o)) / safe
            near, far = dr.max(dr.minimum(low, high)), dr.min(dr.maximum(low, high))
        near = dr.maximum(near, 0.0)
        return near, dr.maximum(far, near)

    def interval(
        self, origin: Point3f, direction: Vector3f, begin: Float | float, end: Float | float
    ) -> tuple[Float, Float]:
        """The part of a stretch that is in the volume; without length where none is."""
        near, far = self.intersect(origin, direction)
        near, far = dr.maximum(near, begin), dr.minimum(far, end)
        return near, dr.maximum(far, near)

    def extinction(self, place: Point3f) -> Float:
        if self.grid is not None:
            return self.grid.extinction(place)
        if not self.exponential:
            return self.sigma_t
        return self.sigma_t * dr.exp(-dr.maximum(place.z - self.base, 0.0) / self.scale)

    def optical_depth(self, origin: Point3f, direction: Vector3f, near: Float, far: Float) -> Float:
        """Optical depth of this medium between two distances, wherever its boundary is."""
        length = far - near
        if not self.exponential:
            return self.sigma_t * length
        low = (origin.z + near * direction.z - self.base) / self.scale
        climb = length * direction.z / self.scale
        return self.sigma_t * length * _mean_density(low, climb)


def _mean_density(low: Float, climb: Float) -> Float:
    """Mean of exp(-max(h, 0)) between h = low and low + climb."""
    below = dr.minimum(low, 0.0), dr.minimum(low + climb, 0.0)
    above = dr.maximum(low, 0.0)
    rise = dr.maximum(low + climb, 0.0) - above
    x = -rise
    share = dr.select(
        dr.abs(x) < 1e-3, 1.0 + x * (0.5 + x / 6.0), _expm1(x) / dr.select(x == 0.0, 1.0, x)
    )  # mean of exp over the rise
    high_part = dr.exp(-above) * share
    covered = dr.select(dr.abs(climb) < 1e-7, 0.0, (below[1] - below[0]) / dr.select(climb == 0.0, 1.0, climb))
    flat = dr.select(low < 0.0, 1.0, dr.exp(-above))
    return dr.select(dr.abs(climb) < 1e-7, flat, covered + (1.0 - covered) * high_part)


def _expm1(x: Float) -> Float:
    """exp(x) - 1 where cancellation matters little (|x| >= 1e-3, 1e-4 relative in float32)."""
    return dr.exp(x) - 1.0


def measured_depth(fog: Sequence[FogVolume], origin_m: Array, direction: Array, length_m: Array) -> Array:
    """`fog.volume.optical_depth`, of grids by a kernel, in single precision: a picture's rays meet many voxels.

    Args and returns: as there.
    """
    if backend.is_scalar() or not any(volume.medium.grid is not None for volume in fog):
        return optical_depth(fog, origin_m, direction, length_m)
    mi = backend.mitsuba()
    origin, end = backend.points(origin_m), backend.floats(np.minimum(length_m, np.finfo(np.float32).max))
    tau = Medium(fog).optical_depth(origin, mi.Vector3f(backend.points(direction)), 0.0, end)
    return np.array(tau, dtype=np.float64)


def transmittance(optical_depth: Float) -> tuple[Float, Float]:
    """exp(-tau), and 1 - exp(-tau) without cancellation for thin fog."""
    tau = optical_depth
    return dr.exp(-tau), dr.select(tau < 1e-2, tau * (1.0 - tau * (0.5 - tau / 6.0)), 1.0 - dr.exp(-tau))
