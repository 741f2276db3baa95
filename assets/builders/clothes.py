"""Clothes of people: coats and trousers that crease where limbs bend, and what is sewn on or worn over them.

A crease is a ridge with a valley on each side, as cloth lies that is too long for the limb within: rings round a
bent limb, rays from an armpit, flutes in a skirt.  Garments are signed distances as `solids` takes them; seams,
lapels, belts and straps are bands laid on them.  Lengths in metres.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from assets.builders.person import Person
from assets.builders.solids import Field, blob_distance, carve, gradient, limb_distance, soft_max, soft_min, surface
from synfog_usd.world.shapes import Array, Part, strip, tube

GOLDEN = 2.4
"""Angle [rad] from one crease round a limb to the next, so that none lies above its neighbour."""
LONG = 0.15
"""A coat that reaches farther below the hip [m] has a skirt."""
ASTRIDE = 0.45
"""Cosine between trunk and thigh below which a coat ends above the thigh, as on who sits."""


@dataclass(frozen=True)
class Trunk:
    """Axes of somebody's trunk: across to the right, ahead, and up from the hips to the chest."""

    hips: Array
    axes: Array
    chest: float
    build: float

    @classmethod
    def of(cls, joints: Mapping, person: Person) -> Trunk:
        """From the places of the joints."""
        hips, chest = (np.asarray(joints[k], dtype=np.float64) for k in ("hips", "chest"))
        up = (chest - hips) / np.linalg.norm(chest - hips)
        across = np.array([1.0, 0.0, 0.0])
        across -= (across @ up) * up
        across /= np.linalg.norm(across)
        return cls(
            hips, np.stack([across, np.cross(up, across), up]), float(np.linalg.norm(chest - hips)), person.build
        )

    def local(self, x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
        """Points in the trunk's axes."""
        p = (x - self.hips[0], y - self.hips[1], z - self.hips[2])
        a, b, c = (p[0] * e[0] + p[1] * e[1] + p[2] * e[2] for e in self.axes)
        return a, b, c

    def world(self, points: npt.ArrayLike) -> Array:
        """(N, 3) points of the trunk's axes in those of the body."""
        return np.asarray(self.hips + np.asarray(points, dtype=np.float64) @ self.axes)

    def matrix(self) -> Array:
        """(4, 4) from the trunk's axes to the body's."""
        m = np.eye(4)
        m[:3, :3], m[:3, 3] = self.axes.T, self.hips
        return m


def ridges(u: Array) -> Array:
    """0 in a valley at each multiple of pi, up to 0.85 on the round ridges between."""
    return np.asarray(np.sqrt(np.sin(u) ** 2 + 0.03) - 0.03**0.5)


def bell(x: Array, width: float) -> Array:
    """1 at 0, 1/e at `width`."""
    return np.asarray(np.exp(-((x / width) ** 2)))


@dataclass(frozen=True)
class Limb:
    """A sleeve or a trouser leg, bent at its middle.

    Attributes:
        joints: (3, 3) places of its ends and of the bend between.
        radii: at the joints, of the upper half and of the lower (begin, end, begin, end).
        gathers: where along it [m] cloth is gathered, over how far, how deep and how dense: (at, width, depth, pitch).
        beyond: how far it reaches past the last joint [m], to an edge across.
        seed: where round the limb the creases lie [rad].
    """

    joints: Array
    radii: tuple[float, float, float, float]
    gathers: Sequence[tuple[float, float, float, float]]
    beyond: float
    seed: float

    def __call__(self, x: Array, y: Array, z: Array) -> Array:
        """Signed distance to the cloth."""
        first, middle, last = self.joints
        r = self.radii
        upper, lower = (
            limb_distance(x, y, z, first, middle, r[0], r[1]),
            limb_distance(x, y, z, middle, last, r[2], r[3]),
        )
        s, round_upper = self._around(x, y, z, first, middle)
        t, round_lower = self._around(x, y, z, middle, last)
        length = float(np.linalg.norm(middle - first))
        share = np.clip(0.5 + (upper - lower) / 0.03, 0.0, 1.0)
        d = soft_min(upper, lower, 0.035)
        d = d - (1 - share) * self._creases(np.minimum(s, length), round_upper)
        d = d - share * self._creases(length + np.maximum(t, 0.0), round_lower)
        return soft_max(d, t - float(np.linalg.norm(last - middle)) - self.beyond, 0.006)

    def _around(self, x: Array, y: Array, z: Array, start: Array, end: Array) -> tuple[Array, Array]:
        """How far along one half [m], and where round it [rad], 0 on the inside of the bend."""
        along = (end - start) / np.linalg.norm(end - start)
        inner = self.joints[0] + self.joints[2] - 2 * self.joints[1]
        inner = inner - (inner @ along) * along + 1e-3 * np.cross(along, [1.0, 0.0, 0.0])
        inner /= np.linalg.norm(inner)
        side = np.cross(along, inner)
        w = (x - start[0], y - start[1], z - start[2])
        s, a, b = (w[0] * e[0] + w[1] * e[1] + w[2] * e[2] for e in (along, inner, side))
        return s, np.arctan2(b, a)

    def _creases(self, s: Array, angle: Array) -> Array:
        """Height of the cloth over its mean line: rings that climb round the limb, each strongest on one side."""
        height = np.zeros(np.shape(s))
        for k, (at, width, depth, pitch) in enumerate(self.gathers):
            climb = 1.7 * np.sin(angle + self.seed + 2.1 * k) + 0.8 * np.sin(2 * angle - 2 * self.seed)
            u = np.pi * (s - at) / pitch + climb
            ring = np.floor(u / np.pi)
            strength = 0.35 + 0.65 * np.maximum(np.cos(angle - GOLDEN * ring - self.seed), 0.0) + 0.12 * np.cos(angle)
            height = height + depth * bell(s - at, width) * ridges(u) * strength
        return height


def sleeves(joints: Mapping, seed: float) -> list[Limb]:
    """Both sleeves, gathered at shoulder, elbow and cuff."""
    made = []
    for k, limb in enumerate(zip(joints["shoulders"], joints["elbows"], joints["hands"], strict=True)):
        places = np.array(limb, dtype=np.float64)
        upper, fore = np.linalg.norm(np.diff(places, axis=0), axis=1)
        bend = _bend(places)
        gathers = [
            (0.40 * upper, 0.10, 0.014, 0.070),
            (upper, 0.085, 0.017 + 0.008 * bend, 0.046),
            (upper + 0.80 * fore, 0.085, 0.015, 0.038),
        ]
        made.append(Limb(places, (0.058, 0.050, 0.051, 0.043), gathers, 0.004, seed + 1.3 * k))
    return made


def legs(joints: Mapping, seed: float) -> list[Limb]:
    """Both legs of the trousers, gathered at crotch, knee and where they rest on the shoe."""
    made = []
    for k, limb in enumerate(zip(joints["thighs"], joints["knees"], joints["ankles"], strict=True)):
        places = np.array(limb, dtype=np.float64)
        thigh, shin = np.linalg.norm(np.diff(places, axis=0), axis=1)
        gathers = [
            (0.14, 0.15, 0.022, 0.095),
            (thigh, 0.11, 0.023 + 0.010 * _bend(places), 0.060),
            (thigh + 0.45 * shin, 0.15, 0.015, 0.100),
            (thigh + 0.95 * shin, 0.085, 0.026, 0.046),
        ]
        made.append(Limb(places, (0.083, 0.057, 0.053, 0.056), gathers, 0.050, seed + 0.9 + 1.7 * k))
    return made


def _bend(places: Array) -> float:
    """0 of a straight limb to 1 of one bent by a right angle or more."""
    a, b = (e / np.linalg.norm(e) for e in np.diff(places, axis=0))
    return float(np.clip(1 - a @ b, 0.0, 1.0))


def seed_of(person: Person) -> float:
    """Where somebody's creases lie [rad]: others of a kind differ."""
    said = f"{person.name} {person.height:.3f} {person.thighs[0]:.2f} {person.turn_head:.1f}"
    return zlib.crc32(said.encode()) % 6283 / 1000


def torso(joints: Mapping, person: Person) -> Field:
    """The upper body in cloth, without creases, sleeves and skirt."""
    b, up = person.build, Trunk.of(joints, person).axes[2]
    hips, chest, neck = (np.asarray(joints[k], dtype=np.float64) for k in ("hips", "chest", "neck"))
    shoulders = [np.asarray(s, dtype=np.float64) for s in joints["shoulders"]]

    def cloth(x: Array, y: Array, z: Array) -> Array:
        d = blob_distance(x, y, z, chest - 0.02 * up, (0.172 * b, 0.118, 0.20))
        d = soft_min(d, blob_distance(x, y, z, hips + 0.16 * up, (0.150 * b, 0.112, 0.20)), 0.10)
        for s in shoulders:
            d = soft_min(d, limb_distance(x, y, z, chest + 0.115 * up, s, 0.060, 0.056), 0.05)
        return soft_min(d, limb_distance(x, y, z, chest + 0.10 * up, neck - 0.005 * up, 0.085, 0.064), 0.05)

    return cloth


def coat(joints: Mapping, person: Person) -> Field:
    """A coat or jacket with a collar, to its hem: creases run from the armpits, a jacket is gathered above its hem, and
    a long coat hangs in flutes.
    """
    trunk, b, seed, upper = Trunk.of(joints, person), person.build, seed_of(person), torso(joints, person)
    up, ahead = trunk.axes[2], trunk.axes[1]
    hips, neck = (np.asarray(joints[k], dtype=np.float64) for k in ("hips", "neck"))
    arms = sleeves(joints, seed)
    armpits = [trunk.local(*(np.asarray(s) - 0.075 * up))[::2] for s in joints["shoulders"]]
    thighs = [np.array(limb, dtype=np.float64) for limb in zip(joints["thighs"], joints["knees"], strict=True)]
    knee, long = 0.5 * (thighs[0][1] + thighs[1][1]), person.coat > LONG
    covered = [(a, b) for a, b in thighs if (a - b) @ up > ASTRIDE * np.linalg.norm(a - b)]
    hem = hips + (knee - hips) * person.coat / 0.43 if long else hips - person.coat * up
    spread = 0.165 + 0.10 * max(abs(np.sin(np.deg2rad(a))) for a in person.thighs)
    squeezed = np.array([0.75 / b, 1, 1])  # wider than deep
    waist = 0.13 if long else 0.095 - person.coat

    def creases(p: Array, q: Array, r: Array) -> Array:
        """Height of the cloth at points of the trunk's axes."""
        height = np.zeros(np.shape(p))
        for k, (at, high) in enumerate(armpits):
            away = np.hypot(p - at, r - high)
            ray = 3.4 * np.arctan2(high - r, (at - p) * np.sign(at)) + 0.6 * np.sin(seed + k + 18 * away)
            height += 0.020 * bell(away - 0.12, 0.10) * ridges(ray + seed) * np.clip(np.abs(q) / 0.08, 0, 1)
        angle = np.arctan2(p, q)
        ring = np.pi * (r - waist) / 0.066 + 1.8 * np.sin(angle + seed) + 1.0 * np.sin(2 * angle + 2 * seed)
        strength = 0.3 + 0.7 * np.maximum(np.cos(angle - GOLDEN * np.floor(ring / np.pi)), 0)
        height += (0.014 if long else 0.024) * bell(r - waist, 0.11) * ridges(ring) * strength
        if long:
            hang = np.clip((0.08 - r) / (0.08 + person.coat), 0, 1)
            flutes = ridges(4.5 * angle + 0.9 * np.sin(2 * angle + seed) + 1.2 * np.sin(5 * r + seed))
            return height + 0.048 * hang * flutes * (0.6 + 0.4 * np.cos(3 * angle + seed))
        return height + 0.012 * bell(r + person.coat - 0.075, 0.045)

    def cloth(x: Array, y: Array, z: Array) -> Array:
        d = upper(x, y, z)
        if long:  # a skirt that follows the legs half-way
            skirt = limb_distance(x / b, y, z, hips * [1 / b, 1, 1] + [0, 0, 0.1], hem * [1 / b, 1, 1], 0.130, spread)
            below = hem[2] - z
        else:
            skirt = limb_distance(x * squeezed[0], y, z, (hips + 0.14 * up) * squeezed, hem * squeezed, 0.108, 0.112)
            below = (hem[0] - x) * up[0] + (hem[1] - y) * up[1] + (hem[2] - z) * up[2]
        d = soft_min(d, skirt, 0.06)
        for thigh in covered:  # no leg comes through it
            d = soft_min(d, limb_distance(x, y, z, *thigh, 0.096, 0.074), 0.04)
        p, q, r = trunk.local(x, y, z)
        d = soft_max(d - creases(p, q, r), below, 0.006)
        for arm in arms:
            d = soft_min(d, arm(x, y, z), 0.025)
        stand = limb_distance(x, y, z, neck - 0.06 * up, neck + 0.02 * up, 0.078, 0.069)
        over = (x - neck[0]) * up[0] + (y - neck[1]) * up[1] + (z - neck[2]) * up[2] - 0.008
        tilt = (x - neck[0]) * ahead[0] + (y - neck[1]) * ahead[1] + (z - neck[2]) * ahead[2]
        d = soft_min(d, soft_max(stand, over + 0.25 * tilt, 0.004), 0.008)
        if person.open:
            inside = np.abs(p) - OPEN * (r - trunk.chest - OPENS)
            d = d + 0.012 * np.clip(-inside / 0.01, 0, 1) * (q > 0)
        return np.asarray(d)

    return cloth


OPENS, OPEN = -0.06, 0.28
"""Where a coat that is worn open at the neck closes above the chest [m], and half its opening's width for each metre
above.
"""


def trousers(joints: Mapping, person: Person) -> Field:
    """Trousers that end on the shoes."""
    hips, b = np.asarray(joints["hips"], dtype=np.float64), person.build
    both = legs(joints, seed_of(person))

    def cloth(x: Array, y: Array, z: Array) -> Array:
        d = blob_distance(x, y, z, hips - [0, 0, 0.02], (0.142 * b, 0.098, 0.11))
        for leg in both:
            d = soft_min(d, leg(x, y, z), 0.03)
        return np.asarray(d)

    return cloth


def laid(
    field: Field, path: npt.ArrayLike, width: float, material: str, *, lift: float = 0.003, thick: float = 0.0
) -> Part:
    """A band along (K, 3) points, drawn onto the surface of a field and `lift` [m] above it; `thick` gives it edges."""
    points = np.asarray(path, dtype=np.float64)
    for _ in range(6):
        g = gradient(field, points)
        points = points - np.clip(field(*points.T), -0.03, 0.03)[:, None] * g / np.maximum(
            (g * g).sum(axis=1, keepdims=True), 0.3
        )
    out = gradient(field, points)
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    along = np.gradient(points, axis=0)
    side = np.cross(along, out)
    side *= 0.5 * width / np.linalg.norm(side, axis=1, keepdims=True)
    low, high = points + lift * out, points + (lift + thick) * out
    if thick:
        loops = np.stack([low - 1.1 * side, high - 0.9 * side, high + 0.9 * side, low + 1.1 * side], axis=1)
        return strip([*loops], material)
    return Part(
        np.concatenate([low - side, low + side]),
        strip([low - side, low + side], material).faces[:, ::-1],
        material,
        None,
        np.concatenate([out, out]),
    )


def between(points: npt.ArrayLike, count: int) -> Array:
    """`count` points evenly along a polygon of (K, 3) points."""
    p = np.asarray(points, dtype=np.float64)
    at = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))]
    return np.stack([np.interp(np.linspace(0, at[-1], count), at, axis) for axis in p.T], axis=1)


def opened(parts: Sequence[Part], joints: Mapping, person: Person) -> list[Part]:
    """The parts, with the shirt that shows where the coat is open."""
    if not person.open:
        return list(parts)
    trunk = Trunk.of(joints, person)
    planes: list[Callable[[Array], Array]] = [
        lambda p: trunk.local(*p.T)[0] - OPEN * (trunk.local(*p.T)[2] - trunk.chest - OPENS),
        lambda p: -trunk.local(*p.T)[0] - OPEN * (trunk.local(*p.T)[2] - trunk.chest - OPENS),
        lambda p: 0.02 - trunk.local(*p.T)[1],
    ]
    made = []
    for part in parts:
        if part.material != "coat":
            made.append(part)
            continue
        inside, rest = carve(part, planes)
        made += [inside.painted("shirt"), rest]
    return made


def sewn(joints: Mapping, person: Person) -> list[Part]:
    """What is sewn on a coat: where it closes, pockets, lapels; a belt round a long one that is belted."""
    trunk, cloth = Trunk.of(joints, person), coat(joints, person)
    hem = -person.coat if person.coat <= LONG else -0.9 * person.coat
    close = trunk.chest + (OPENS if person.open else 0.12)
    front = 0.16

    def drawn(points: Sequence[tuple[float, float, float]], count: int) -> Array:
        """Points of the trunk's axes, moved inward onto the cloth along ahead or behind."""
        p = between(points, count)
        for i, (a, b, c) in enumerate(p):
            reach = np.linspace(b, 0.02 * np.sign(b), 60)
            line = trunk.world(np.c_[np.full(60, a), reach, np.full(60, c)])
            hit = np.nonzero(cloth(*line.T) < 0)[0]
            p[i, 1] = reach[hit[0]] if len(hit) else 0.12 * np.sign(b)
        return trunk.world(p)

    parts = [laid(cloth, drawn([(0.0, front, hem + 0.01), (0.0, front, close)], 24), 0.006, "line")]
    low = -0.02 if person.coat <= LONG else -0.10
    for s in (-1, 1):
        pocket = drawn([(s * 0.115, front, low), (s * 0.085, front, low + 0.125)], 6)
        parts.append(laid(cloth, pocket, 0.007, "line"))
        if person.open:
            edge = [(0.0, close), (0.085 * 1.15, close + 0.20), (0.075, close + 0.235)]
            lapel = drawn([(s * (x + 0.016), front, z) for x, z in edge], 9)
            parts.append(laid(cloth, lapel, 0.04, "coat", lift=0.006))
            parts.append(laid(cloth, lapel + trunk.world([(s * 0.022, 0, -0.004)]) - trunk.hips, 0.005, "line"))
    return parts


def backpack(joints: Mapping, person: Person) -> list[Part]:
    """A backpack of 24 litres with a pocket in front, two at the sides, a handle and two straps."""
    trunk, cloth = Trunk.of(joints, person), torso(joints, person)
    behind, high = -0.192, trunk.chest - 0.075

    def cushion(x: Array, y: Array, z: Array, half: tuple[float, float, float], edge: float) -> Array:
        q = [np.abs(v) - h + edge for v, h in zip((x, y, z), half, strict=True)]
        outside = np.sqrt(sum(np.maximum(v, 0) ** 2 for v in q))
        return np.asarray(outside + np.minimum(np.maximum.reduce(q), 0) - edge)

    def bag(x: Array, y: Array, z: Array) -> Array:
        y, z = y - behind, z - high
        wide = x * (1 + 0.35 * z)  # narrower at the top
        d = cushion(wide, y, z, (0.142, 0.078, 0.225), 0.055)
        d = d + 0.006 * bell(y + 0.005, 0.006) * np.clip((z + 0.03) / 0.02, 0, 1)  # the zip
        pocket = cushion(wide, y + 0.078, z + 0.085, (0.115, 0.036, 0.115), 0.026)
        pocket = pocket + 0.006 * bell(z - 0.0, 0.006) - 0.004 * ridges(30 * x + 2 * np.sin(40 * z))
        d = soft_min(d, pocket, 0.008)
        for s in (-1, 1):
            d = soft_min(d, cushion(wide - s * 0.142, y, z + 0.13, (0.024, 0.052, 0.075), 0.018), 0.008)
        return np.asarray(d - 0.004 * ridges(26 * z + 9 * x + np.sin(30 * x)))

    low, top = (-0.19, behind - 0.14, high - 0.25), (0.19, behind + 0.10, high + 0.25)
    body = surface(bag, low, top, step=0.007, triangles=1500, material="bag")
    base, body = carve(body, [lambda p: p[:, 2] - high + 0.175])
    parts = [body.moved(trunk.matrix()), base.painted("strap").moved(trunk.matrix())]
    zip_z = high - 0.012
    for z, y, half in ((zip_z, behind - 0.115, 0.095), (high + 0.085, behind - 0.078, 0.10)):
        line = between([(-half, y, z), (half, y, z)], 12)
        parts.append(laid(bag, line, 0.008, "strap").moved(trunk.matrix()))
    hoop = [(x, behind + 0.055, high + 0.215 + dz) for x, dz in ((-0.035, 0), (-0.03, 0.03), (0.03, 0.03), (0.035, 0))]
    parts.append(tube(trunk.world(hoop), 0.007, "strap", sides=5, capped=False))
    for s in (-1, 1):
        c = trunk.chest
        way = [
            (s * 0.070, -0.125, c + 0.10),
            (s * 0.085, -0.03, c + 0.17),
            (s * 0.090, 0.07, c + 0.13),
            (s * 0.100, 0.12, c + 0.02),
            (s * 0.120, 0.11, c - 0.09),
            (s * 0.145, 0.03, c - 0.17),
            (s * 0.125, -0.12, c - 0.24),
        ]
        path = trunk.world(between(way, 27))
        parts.append(laid(cloth, path[:19], 0.058, "strap", lift=0.004, thick=0.014))
        parts.append(laid(cloth, path[18:], 0.024, "strap", lift=0.006, thick=0.004))
    return parts
