"""The light of one lamp that the fog around it has scattered: its glow.

Takes a phase function and an albedo; gives the radiance that one isotropic point
lamp makes in fog without end, and what it sends onto surfaces.  Knows nothing of
USD, Mitsuba or files.

Two numbers fix it: tau, the optical distance to the lamp, and theta, the angle
between the direction that is looked into and the one to the lamp (Narasimhan and
Nayar 2003).  Everything here is in units of the lamp's intensity times sigma_t^2.

    scattered once     L1 = albedo exp(-tau) / (tau sin theta)
                            * integral from theta to pi of p(cos a) exp(-b (tan(a/2) - tan(theta/2))) da,  b = tau sin
                              theta
    more often         L2+ = integral over s of exp(-s) J(r(s), cos a(s)) ds
                       J = albedo * sum of (2l+1) / (4 pi) chi_l f_l(r) P_l(cos a)

with f_l the Legendre moments of all light that was scattered.  Those of L1 are a
quadrature.  Those of L2+ are the transform (1 / 2 pi^2) integral of k^2 j_l(k r) F_l(k) dk of

    (2l+1) (1 - albedo chi_l) F_l + k (l+1) F_(l+1) - k l F_(l-1) = (2l+1) albedo chi_l F1_l

which is the equation of transfer itself, a chain of any length; nothing is diffused.
Because J is integrated along the ray, the peak of L2+ towards the lamp, which is
only a logarithm, is there as well.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from synfog_usd.arrays import Array
from synfog_usd.errors import ParameterError
from synfog_usd.fog.phase import Phase

TAU = (1e-3, 100.0)
"""Range of the tables; nearer, L1 goes as 1 / tau and L2+ stays; farther, L1 is gone and L2+ goes as 1 / tau."""

TAU_ROWS, THETA_COLUMNS, NORMAL_COLUMNS = 193, 97, 33
"""Nodes: even in log tau (38 a decade), in sqrt(theta / pi), and in the cosine of a surface."""

ORDERS = 1024
"""Most Legendre moments of a phase function that are used; Henyey-Greenstein of 0.99 has 1e-4 left there."""

NEGLIGIBLE = 1e-4

SMOOTH_ORDERS = 128
"""Moments of L2+; its peak is a logarithm, whose moments go as 1 / l^2, and the phase function dims them once more."""

SURFACE_ORDERS = 17
"""Moments that a Lambertian surface sees; the next one of a clamped cosine is 0.3 % of the first."""

REACH = 30.0
"""Optical length of the rays that L2+ is integrated along: the rest is exp(-30)."""

_PEAK_NODES, _RAY_NODES, _TAIL = 96, 48, 400


def glow_table(phase: Phase, albedo: float = 1.0) -> GlowTable:
    """The glow in fog of a phase function and an albedo, made once a process.

    Args:
        phase: of the fog; a record of `fog.phase`.
        albedo: single-scattering albedo [1], 0 to 1.

    Raises:
        ParameterError: an albedo outside its range, or a phase function that has more than 1 % left after 1024 moments.

    Valid for a uniform medium that nothing else than the lamp is in.  Measured for g = 0.87, 0 and -0.5 and droplets of
    10 um at optical distances 0.02 to 30: the net flux through a sphere is the lamp's to 3e-4 (droplets 1.3e-3); scalar
    irradiance at g = 0 is Case's exact one to 1e-3.  L1 between nodes is good to 0.5 %.  Making one takes 0.5 to 1.5 s.
    Source: Narasimhan and Nayar, CVPR 2003 (the two numbers); Case and Zweifel, Linear
    Transport Theory (1967), ch. 6 (point source by Fourier transform).
    """
    if not 0.0 <= albedo <= 1.0:
        raise ParameterError(f"albedo {albedo} is outside 0 to 1")
    return _made(phase, float(albedo))


@functools.lru_cache(maxsize=8)
def _made(phase: Phase, albedo: float) -> GlowTable:
    chi = phase.moments(ORDERS)
    if abs(chi[-1]) > 0.01:
        raise ParameterError(
            f"the phase function is too peaked for a table of its glow: moment {ORDERS - 1} is {chi[-1]:.3g}; it takes "
            f"up to 0.01 there"
        )
    above = np.flatnonzero(np.abs(chi) > NEGLIGIBLE)
    orders = max(int(above[-1]) + 1, SURFACE_ORDERS)
    chi = chi[:orders]

    tau = np.geomspace(TAU[0], TAU[1], TAU_ROWS)
    theta = theta_nodes()
    far = tau[0] * (tau[1] / tau[0]) ** np.arange(
        TAU_ROWS + math.ceil(math.log(1.0 + REACH / TAU[1]) / math.log(tau[1] / tau[0]))
    )
    single = _single(phase, tau, theta) / (2.0 * np.cos(theta / 2.0))
    once = albedo * _moments_of_single(phase, far, orders)
    more = np.zeros_like(once)
    smooth = min(orders, SMOOTH_ORDERS)
    more[:, :smooth] = _moments_of_more(far, chi, albedo, smooth)
    multiple = _along_rays(tau, theta, far, albedo * chi * (once + more))
    once, more = once[:TAU_ROWS, :SURFACE_ORDERS], more[:TAU_ROWS, :SURFACE_ORDERS]
    return GlowTable(
        phase, albedo, tau, theta, single, multiple, _on_surfaces(once), _on_surfaces(more), once[:, 0] + more[:, 0]
    )


@dataclass(frozen=True, eq=False)
class GlowTable:
    """The glow of one lamp; see `glow_table`.

    Attributes:
        phase, albedo: of the fog.
        tau, theta: (T,), (A,) nodes of the tables.
        single: (T, A) L1 * tau * exp(tau) * sin(theta / 2) / albedo.
        multiple: (T, A) L2+; at theta = 0, where it is infinite, its value half way to the next node.
        once, more: (T, N) irradiance on surfaces by light scattered once, and more often, times tau; nodes even in the
            cosine from -1 to 1.
        scalar: (T,) scalar irradiance by all scattered light, times tau.
    """

    phase: Phase
    albedo: float
    tau: Array
    theta: Array
    single: Array
    multiple: Array
    once: Array
    more: Array
    scalar: Array

    def radiance(self, tau: npt.ArrayLike, theta: npt.ArrayLike) -> Array:
        """Radiance of the scattered light; the lamp itself is not in it.

        Args:
            tau: optical distance to the lamp [1], > 0, any shape.
            theta: angle [rad], 0 to pi, any shape; at 0 it is infinite.

        Returns:
            Radiance over intensity * sigma_t^2 [1/sr], float64.
        """
        return self.radiance_single(tau, theta) + self.radiance_multiple(tau, theta)

    def radiance_single(self, tau: npt.ArrayLike, theta: npt.ArrayLike) -> Array:
        """That of the light that was scattered once; as `radiance`."""
        r, angle = np.broadcast_arrays(np.asarray(tau, dtype=np.float64), np.asarray(theta, dtype=np.float64))
        with np.errstate(divide="ignore"):
            return np.asarray(
                self.albedo * self._bilinear(self.single, r, angle) * np.exp(-r) / (r * np.sin(angle / 2.0))
            )

    def radiance_multiple(self, tau: npt.ArrayLike, theta: npt.ArrayLike) -> Array:
        """That of the light that was scattered more often; as `radiance`."""
        r, angle = np.broadcast_arrays(np.asarray(tau, dtype=np.float64), np.asarray(theta, dtype=np.float64))
        if self.albedo == 0.0:
            return np.zeros(r.shape)
        return np.asarray(np.exp(self._bilinear(np.log(self.multiple), r, angle)) * np.minimum(TAU[1] / r, 1.0))

    def irradiance(self, tau: npt.ArrayLike, cosine: npt.ArrayLike | None = None) -> Array:
        """Light that falls on a point at an optical distance, the lamp's own left out.

        Args:
            tau: optical distance to the lamp [1], > 0, any shape.
            cosine: of the angle between a surface's normal and the direction to the
                lamp [1], -1 to 1; None for the scalar irradiance, the integral of radiance over the sphere.

        Returns:
            Irradiance over intensity * sigma_t^2 [1], float64.
        """
        r = np.asarray(tau, dtype=np.float64)
        if cosine is None:
            if self.albedo == 0.0:
                return np.zeros(r.shape)
            return np.asarray(np.exp(np.interp(r, self.tau, np.log(np.maximum(self.scalar, 1e-300)))) / r)
        r, mu = np.broadcast_arrays(r, np.asarray(cosine, dtype=np.float64))
        column = 0.5 * (np.clip(mu, -1.0, 1.0) + 1.0) * (NORMAL_COLUMNS - 1)
        return np.asarray(_read(self.once + self.more, _row(r), column) / r)

    def _bilinear(self, table: Array, tau: Array, theta: Array) -> Array:
        return _read(table, _row(tau), np.sqrt(np.clip(theta / math.pi, 0.0, 1.0)) * (THETA_COLUMNS - 1))


def theta_nodes() -> Array:
    """(A,) angles of the tables [rad]; the first stands for 0."""
    nodes = math.pi * np.linspace(0.0, 1.0, THETA_COLUMNS) ** 2
    nodes[0], nodes[-1] = nodes[1] / 4.0, math.pi * (1.0 - 1e-6)
    return nodes


def _row(tau: Array) -> Array:
    return np.log(np.clip(tau, *TAU) / TAU[0]) * ((TAU_ROWS - 1) / math.log(TAU[1] / TAU[0]))


def _read(table: Array, row: Array, column: Array) -> Array:
    """Linear between the nodes of a table, at fractional rows and columns."""
    i = np.clip(row.astype(np.int64), 0, table.shape[0] - 2)
    j = np.clip(column.astype(np.int64), 0, table.shape[1] - 2)
    y, x = row - i, column - j
    flat, at = table.ravel(), i * table.shape[1] + j
    low = (1.0 - x) * flat[at] + x * flat[at + 1]
    at = at + table.shape[1]
    return np.asarray((1.0 - y) * low + y * ((1.0 - x) * flat[at] + x * flat[at + 1]))


def _single(phase: Phase, tau: Array, theta: Array) -> Array:
    """(T, A) the integral in L1; nodes crowd towards theta, where both the peak and the exponential are."""
    node, weight = np.polynomial.legendre.leggauss(_PEAK_NODES)
    y = (node + 1.0) / 2.0
    a = theta[:, None] + (math.pi - theta)[:, None] * y**3
    peak = phase.value(np.cos(a)) * (math.pi - theta)[:, None] * (1.5 * weight * y**2)
    apart = np.sin((a - theta[:, None]) / 2.0) / (
        np.maximum(np.cos(a / 2.0), 1e-12) * np.cos(theta / 2.0)[:, None]
    )  # tan - tan
    apart *= np.sin(theta)[:, None]
    return np.stack([np.einsum("aq,aq->a", peak, np.exp(-r * apart)) for r in tau])


def _moments_of_single(phase: Phase, tau: Array, orders: int) -> Array:
    """(R, L) tau times the Legendre moments 2 pi * integral of L1 P_l, albedo 1."""
    edges = np.r_[0.0, np.geomspace(1e-4, 0.1, 10), np.linspace(0.1, math.pi, max(10, orders // 14))[1:]]
    node, weight = np.polynomial.legendre.leggauss(24)
    theta = (edges[:-1, None] + np.diff(edges)[:, None] * (node + 1.0) / 2.0).ravel()
    step = (np.diff(edges)[:, None] * weight / 2.0).ravel()
    legendre = np.polynomial.legendre.legvander(np.cos(theta), orders - 1) * (2.0 * math.pi * step)[:, None]
    return np.exp(-tau)[:, None] * _single(phase, tau, theta) @ legendre


def _moments_of_more(tau: Array, chi: Array, albedo: float, orders: int) -> Array:
    """(R, L) tau times the Legendre moments of L2+.

    The transform ends smoothly at x = k tau of 300, which blurs the moments by 1 / 300 of their distance.
    """
    edges = np.r_[0.0, np.geomspace(1e-4, 1.0, 8), np.arange(8.0, 600.1, 7.0)]
    node, weight = np.polynomial.legendre.leggauss(10)
    x = (edges[:-1, None] + np.diff(edges)[:, None] * (node + 1.0) / 2.0).ravel()
    step = (np.diff(edges)[:, None] * weight / 2.0).ravel()
    kernel = _spherical_bessel(x, orders) * (step * x * x * np.exp(-((x / 300.0) ** 4)))
    kernel *= 4.0 * math.pi / (2.0 * math.pi**2)
    moments = np.empty((len(tau), orders))
    for low in range(0, len(tau), 16):
        part = tau[low : low + 16]
        transform = _chain(x / part[:, None], chi, albedo, orders)
        moments[low : low + 16] = np.einsum("lrx,lx->rl", transform, kernel) / part[:, None] ** 2
    return moments


def _chain(k: Array, chi: Array, albedo: float, orders: int) -> Array:
    """(L, *K) transforms F_l of light scattered twice or more, of a source of unit power.

    The chain is closed far out, where its pivots go as (2l+1) (1 + sqrt(1 + k^2)) / 2, to 1 / (8 l^2) for any k.
    """
    scattering = np.zeros(orders)
    scattering[: min(orders, len(chi))] = albedo * chi[:orders]
    degree = 2.0 * np.arange(orders) + 1.0
    pivot = (2.0 * (orders + _TAIL) + 1.0) * (1.0 + np.sqrt(1.0 + k * k)) / 2.0
    for order in range(orders + _TAIL - 1, orders - 1, -1):
        pivot = 2.0 * order + 1.0 + (k * (order + 1)) ** 2 / pivot
    bare, full = np.empty((2, orders, *k.shape))
    above_bare = above_full = pivot
    for order in range(orders - 1, -1, -1):
        square = (k * (order + 1)) ** 2
        above_bare = bare[order] = degree[order] + square / above_bare
        above_full = full[order] = degree[order] * (1.0 - scattering[order]) + square / above_full
    light = np.zeros((orders, *k.shape))
    light[0] = 1.0
    for pivots in (bare, bare, full):
        for order in range(orders - 2, -1, -1):
            light[order] -= k * (order + 1) / pivots[order + 1] * light[order + 1]
        light[0] /= pivots[0]
        for order in range(1, orders):
            light[order] = (light[order] + k * order * light[order - 1]) / pivots[order]
        if pivots is not full:
            light *= (degree * scattering).reshape(-1, *[1] * k.ndim)
    return light


def _spherical_bessel(x: Array, orders: int) -> Array:
    """(L, X) spherical Bessel functions: upwards while l < x, and by their ratios, found downwards, beyond."""
    ratio = np.zeros((orders, len(x)))
    last = np.zeros_like(x)
    for order in range(orders + 60 + int(x.max()), 0, -1):
        gap = (2.0 * order + 1.0) / x - last
        last = 1.0 / np.where(np.abs(gap) < 1e-12, 1e-12, gap)
        if order <= orders:
            ratio[order - 1] = last
    value = np.empty((orders, len(x)))
    value[0] = np.sin(x) / x
    before = np.cos(x) / x  # j_-1
    for order in range(1, orders):
        upward = (2.0 * order - 1.0) / x * value[order - 1] - before
        before = value[order - 1]
        value[order] = np.where(order < x, upward, ratio[order - 1] * value[order - 1])
    return value


def _along_rays(tau: Array, theta: Array, far: Array, strength: Array) -> Array:
    """(T, A) L2+: the source J, from (R, L) tau times its moments, along every ray.

    In t with s = s0 + b sinh t, s0 the nearest point to the lamp and b its distance, r J ds / r has no peak.
    """
    columns = 257
    angle = math.pi * np.linspace(0.0, 1.0, columns) ** 2
    degree = (2.0 * np.arange(strength.shape[1]) + 1.0) / (4.0 * math.pi)
    source = np.asarray(
        (strength * degree) @ np.polynomial.legendre.legvander(np.cos(angle), strength.shape[1] - 1).T, dtype=np.float64
    )
    node, weight = np.polynomial.legendre.leggauss(_RAY_NODES)
    share = (node + 1.0) / 2.0
    log_first, per_row = math.log(far[0]), (len(far) - 1) / math.log(far[-1] / far[0])
    nearest, b = tau[:, None] * np.cos(theta), tau[:, None] * np.sin(theta)
    begin, end = np.arcsinh(-nearest / b), np.arcsinh((REACH - nearest) / b)
    middle = np.clip(0.0, begin, end)
    total = np.zeros(b.shape)
    for low, high in ((begin, middle), (middle, end)):
        t = low[..., None] + (high - low)[..., None] * share
        along = b[..., None] * np.sinh(t)
        r = b[..., None] * np.cosh(t)
        a = math.pi - np.arctan2(b[..., None], along)  # the direction that is looked into against the one to the lamp
        row = np.clip((np.log(r) - log_first) * per_row, 0.0, len(far) - 1.0)
        light = _read(source, row, np.sqrt(np.clip(a / math.pi, 0.0, 1.0)) * (columns - 1))
        total += np.einsum("taq,taq,q->ta", light, np.exp(-(nearest[..., None] + along)), weight / 2.0) * (high - low)
    return np.maximum(total, 1e-300)


def _on_surfaces(moments: Array) -> Array:
    """(T, N) irradiance from (T, L) moments, by those of the clamped cosine (Ramamoorthi and Hanrahan 2001)."""
    node, weight = np.polynomial.legendre.leggauss(64)
    mu = (node + 1.0) / 2.0
    clamped = 2.0 * math.pi * (mu * weight / 2.0) @ np.polynomial.legendre.legvander(mu, SURFACE_ORDERS - 1)
    clamped *= (2.0 * np.arange(SURFACE_ORDERS) + 1.0) / (4.0 * math.pi)
    return (moments * clamped) @ np.polynomial.legendre.legvander(
        np.linspace(-1.0, 1.0, NORMAL_COLUMNS), SURFACE_ORDERS - 1
    ).T
