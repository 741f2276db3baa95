"""Fog as a kernel sees it: optical depth in closed form, flights by its inverse.

Takes fog volumes; gives, for rays of the wavefront, how much fog lies on a stretch
and where the fog would scatter a path.  No geometry is traced for it.  Boxes and
balls, uniform or exponential, nested as deep as one likes: each adds what it has
over the fog around it, on the stretch that it covers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import drjit as dr

from synfog_usd.fog import FogVolume
from synfog_usd.render import backend
from synfog_usd.render.media.phases import kernel_phase

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float, UInt32
    from mitsuba import Point3f, Vector3f

BISECTIONS = 30
"""Halvings of a stretch until its optical depth fits: 1 km to a micrometre, below what float32 holds."""

WRITTEN_OUT = 4
"""Volumes up to which a kernel holds every halving apart, which is faster; of more it would be too long to compile."""


def unsupported_fog(volumes: Sequence[FogVolume]) -> str:
    """Why `Medium` cannot hold these volumes, or ''."""
    for volume in volumes:
        if volume.boundary.kind == "mesh":
            return f"the boundary {volume.path} is a mesh, not a box or a sphere"
        if volume.medium.profile == "grid":
            return f"the fog {volume.path} is a grid"
    if len({volume.medium.phase_function for volume in volumes}) > 1:
        return f"the fogs {', '.join(volume.path for volume in volumes)} scatter by different phase functions"
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
        self.media = [_Volume(volume, scale) for volume in self.volumes]
        self.parents = [None if parent is None else self.media[parent] for parent in around]
        self.order = sorted(range(len(self.volumes)), key=lambda place: _nesting(around, place))
        self.single = len(self.volumes) == 1 and self.volumes[0].medium.profile == "uniform"
        if self.foggy:
            self.phase = kernel_phase(self.volumes[0].medium.phase_function)
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

    def optical_depth(self, origin: Point3f, direction: Vector3f, begin: Float | float, end: Float | float) -> Float:
        """Optical depth between two distances [m] on a ray of unit direction."""
        total = backend.mitsuba().Float(0.0)
        for medium, parent in zip(self.media, self.parents, strict=True):
            near, far = medium.intersect(origin, direction)
            near, far = dr.maximum(near, begin), dr.minimum(far, end)
            far = dr.maximum(far, near)
            total += medium.optical_depth(origin, direction, near, far)
            if parent is not None:
                total -= parent.optical_depth(origin, direction, near, far)
        return dr.maximum(total, 0.0)

    def optical_depth_inside(self, origin: Point3f, direction: Vector3f, begin: Float, end: Float) -> Float:
        """The same for a stretch that is known to be in fog all along: one uniform fog needs no look for its edge."""
        return (
            self.media[0].sigma_t * (end - begin) if self.single else self.optical_depth(origin, direction, begin, end)
        )

    def sample_distance(
        self, origin: Point3f, direction: Vector3f, optical_depth: Float, near: Float, far: Float
    ) -> Float:
        """Distance [m] at which the optical depth from `near` on is `optical_depth`; at most `far`."""
        if self.single:
            return dr.minimum(near + optical_depth / self.media[0].sigma_t, far)

        def halved(step: UInt32 | int, low: Float, high: Float) -> tuple[UInt32 | int, Float, Float]:
            middle = 0.5 * (low + high)
            short = self.optical_depth(origin, direction, near, middle) < optical_depth
            return step + 1, dr.select(short, middle, low), dr.select(short, high, middle)

        state: tuple[Any, Any, Any] = (0, near, far)
        if len(self.media) <= WRITTEN_OUT:
            for _ in range(BISECTIONS):
                state = halved(*state)
        else:
            state = dr.while_loop((backend.mitsuba().UInt32(0), near, far), lambda step, *_: step < BISECTIONS, halved)
        _, low, high = state
        return dr.select(self.optical_depth(origin, direction, near, far) > optical_depth, 0.5 * (low + high), far)

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

    def _innermost(self, place: Point3f, value: Callable[[_Volume], Float], outside: Float) -> Float:
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

    def __init__(self, volume: FogVolume, scale: float) -> None:
        mi = backend.mitsuba()
        to_world, self.ball = mi.ScalarTransform4f(volume.boundary.to_world), volume.boundary.kind == "sphere"
        self.to_local = mi.Transform4f(to_world.inverse())
        dr.make_opaque(self.to_local)
        medium = volume.medium
        self.sigma_t, self.albedo = (
            dr.opaque(mi.Float, scale * medium.sigma_t_per_m),
            dr.opaque(mi.Float, medium.albedo),
        )
        self.exponential = medium.profile == "exponential"
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

    def extinction(self, place: Point3f) -> Float:
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


def transmittance(optical_depth: Float) -> tuple[Float, Float]:
    """exp(-tau), and 1 - exp(-tau) without cancellation for thin fog."""
    tau = optical_depth
    return dr.exp(-tau), dr.select(tau < 1e-2, tau * (1.0 - tau * (0.5 - tau / 6.0)), 1.0 - dr.exp(-tau))
