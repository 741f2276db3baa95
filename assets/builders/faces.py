"""Fronts and tail lamps of cars, by model: grilles and intakes with their bars, headlamps, badge and plate.

Openings are set back behind a rim, so that they have depth.  Lengths in metres; across
a car a share of half its width, which is 1 at the flank; the front looks along +Y.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from assets.builders.bodywork import Body
from assets.builders.coachwork import bowl, convex, covered, cut_out, front_at, lens_disc, plate
from assets.builders.solids import Field, filleted
from synfog_usd.world.shapes import Array, Part, quad, smooth_normals, strip, tube

Corner = tuple[float, float]


@dataclass(frozen=True)
class Opening:
    """A hole of the front, or with no depth an area of another material.

    Attributes:
        outline: corners (share of half width, height: 0 at the sill, 1 at the headlamps), convex.
        bars: number of bars, across, or upright where it is negative; of: their material.
        deep: of its ground behind the skin [m]; ground: material of that; rim: of a frame 1 cm wide, or ''.
        both: on either side, mirrored, instead of in the middle.
        corner: setback of its rounded corners [m].
        fog: radius of a fog lamp in its middle [m], or 0.
    """

    outline: Sequence[Corner]
    bars: int = 0
    of: str = "gloss_black"
    deep: float = 0.035
    ground: str = "seam"
    rim: str = ""
    both: bool = False
    corner: float = 0.03
    fog: float = 0.0


@dataclass(frozen=True)
class Lens:
    """A luminous area of a lamp.

    Attributes:
        at: (share of half width, height above the lamps' middle [m]).
        half: half its width and height [m].
        square: 1 for an ellipse; towards 0 it fills its rectangle.
    """

    at: Corner
    half: Corner
    square: float = 1.0


ROUND = (0.052, 0.052)
"""Half sizes of a lens of 80 cm2, for which the luminances of `coachwork` are."""


@dataclass(frozen=True)
class Face:
    """What tells the front and the tail lamps of one car from those of another.

    Attributes:
        openings: cut in this order.
        lamp: right headlamp's corners (share of half width, height above the lamps' middle [m]).
        bowls: reflectors in it: (share, height [m], radius [m]).
        lens: luminous area of it; tail: that of a tail lamp, at (share, share of the lamp's height).
        badge, plate: height as in `Opening`.
        stacked: whether the tail lamp's indicator and reversing lamp are below its light, or else further in.
    """

    openings: Sequence[Opening]
    lamp: Sequence[Corner]
    bowls: Sequence[tuple[float, float, float]]
    lens: Lens
    tail: Lens
    badge: float
    plate: float
    stacked: bool = True


def wide(low: float, high: float, foot: float, head: float, waist: float | None = None) -> list[Corner]:
    """A symmetric outline from `low` to `high`, `foot` and `head` half wide there, `waist` in the middle."""
    middle = [] if waist is None else [(waist, 0.5 * (low + high))]
    right = [(foot, low), *middle, (head, high)]
    return [*right, *((-x, z) for x, z in reversed(right))]


_SALOON = Face(
    openings=(
        Opening(wide(0.54, 1.04, 0.32, 0.33, 0.41), 6, rim="chrome"),
        Opening(wide(0.10, 0.28, 0.44, 0.38), 2),
        Opening([(0.56, 0.12), (0.88, 0.20), (0.86, 0.46), (0.80, 0.48)], both=True, fog=0.030),
    ),
    lamp=[(0.47, 0.005), (0.53, -0.050), (0.985, -0.030), (0.99, 0.080), (0.80, 0.065), (0.50, 0.035)],
    bowls=((0.84, 0.012, 0.040), (0.62, -0.008, 0.030)),
    lens=Lens((0.73, 0.004), (0.085, 0.024), 0.3),
    tail=Lens((0.84, 0.52), (0.105, 0.024), 0.3),
    badge=0.97,
    plate=0.42,
    stacked=False,
)

FACES = {
    "hatchback": Face(
        openings=(
            Opening(wide(0.90, 1.02, 0.46, 0.52), 1, "chrome"),
            Opening(wide(0.12, 0.48, 0.60, 0.47), 3),
            Opening([(0.68, 0.14), (0.86, 0.20), (0.86, 0.40), (0.72, 0.44)], both=True, fog=0.036),
        ),
        lamp=[(0.55, -0.030), (0.63, -0.075), (0.985, -0.050), (0.99, 0.100), (0.84, 0.085), (0.57, 0.020)],
        bowls=((0.755, 0.0, 0.058), (0.655, -0.020, 0.034)),
        lens=Lens((0.755, 0.0), ROUND),
        tail=Lens((0.79, 0.50), (0.050, 0.050), 0.6),
        badge=0.80,
        plate=0.62,
    ),
    "saloon": _SALOON,
    "taxi": replace(
        _SALOON,
        openings=(
            Opening(wide(0.66, 1.03, 0.40, 0.46), 3, "chrome", rim="chrome"),
            Opening(wide(0.12, 0.34, 0.74, 0.68), 1, "black_plastic"),
        ),
        lamp=[(0.50, -0.070), (0.985, -0.060), (0.99, 0.085), (0.80, 0.075), (0.52, 0.040)],
        bowls=((0.78, 0.0, 0.056), (0.62, -0.014, 0.040)),
        lens=Lens((0.78, 0.0), ROUND),
        badge=0.86,
        plate=0.50,
    ),
    "estate": Face(
        openings=(
            Opening(
                [(0.035, 0.70), (0.30, 0.72), (0.36, 0.88), (0.33, 1.01), (0.035, 1.01)],
                -5,
                "chrome",
                rim="chrome",
                both=True,
            ),
            Opening(wide(0.08, 0.36, 0.56, 0.72), 2, "black_plastic"),
            Opening([(0.78, 0.26), (0.92, 0.30), (0.90, 0.40), (0.78, 0.40)], both=True, fog=0.028),
        ),
        lamp=[(0.46, -0.055), (0.70, -0.080), (0.985, -0.060), (0.99, 0.085), (0.80, 0.070), (0.46, 0.030)],
        bowls=((0.80, 0.004, 0.046), (0.60, -0.018, 0.046)),
        lens=Lens((0.705, -0.006), (0.110, 0.019), 0.25),
        tail=Lens((0.80, 0.62), (0.040, 0.060), 0.35),
        badge=0.86,
        plate=0.53,
    ),
    "offroader": Face(
        openings=(
            Opening(wide(0.82, 1.06, 0.48, 0.50), -7, "chrome", rim="galvanised", corner=0.05),
            Opening(wide(0.20, 0.44, 0.66, 0.58), 2),
            Opening(wide(0.0, 0.13, 0.42, 0.50), deep=0.0, ground="galvanised"),
            Opening([(0.74, 0.34), (0.84, 0.34), (0.84, 0.46), (0.74, 0.46)], both=True),
        ),
        lamp=[(0.585, -0.05), (0.64, -0.095), (0.86, -0.095), (0.96, -0.05), (0.96, 0.055), (0.86, 0.09), (0.62, 0.07)],
        bowls=((0.76, -0.004, 0.072), (0.905, -0.004, 0.026)),
        lens=Lens((0.76, -0.004), ROUND),
        tail=Lens((0.80, 0.62), (0.055, 0.045), 0.25),
        badge=0.93,
        plate=0.60,
    ),
    "van": Face(
        openings=(
            Opening(wide(0.74, 1.02, 0.50, 0.54), 3, "black_plastic", ground="gloss_black"),
            Opening(wide(0.14, 0.36, 0.60, 0.60), 2, "black_plastic"),
            Opening(wide(0.0, 0.46, 0.97, 0.97), deep=0.0, ground="black_plastic"),
        ),
        lamp=[(0.60, -0.120), (0.985, -0.100), (0.99, 0.150), (0.90, 0.165), (0.64, 0.050)],
        bowls=((0.80, 0.035, 0.062), (0.77, -0.070, 0.042)),
        lens=Lens((0.80, 0.035), ROUND),
        tail=Lens((0.88, 0.78), (0.040, 0.075), 0.3),
        badge=0.92,
        plate=0.58,
    ),
    "minibus": Face(
        openings=(
            Opening(wide(0.80, 0.98, 0.40, 0.56), 2, "chrome"),
            Opening(wide(0.12, 0.44, 0.70, 0.58), 4, "black_plastic"),
            Opening([(0.76, 0.16), (0.90, 0.18), (0.90, 0.34), (0.76, 0.36)], both=True, fog=0.036),
        ),
        lamp=[(0.56, -0.060), (0.66, -0.095), (0.985, -0.070), (0.99, 0.130), (0.86, 0.120), (0.60, 0.020)],
        bowls=((0.80, 0.020, 0.056), (0.67, -0.030, 0.040)),
        lens=Lens((0.80, 0.020), ROUND),
        tail=Lens((0.88, 0.76), (0.040, 0.075), 0.3),
        badge=0.89,
        plate=0.62,
    ),
    "city_car": Face(
        openings=(
            Opening(wide(0.90, 0.965, 0.28, 0.32), ground="gloss_black", deep=0.015, corner=0.016),
            Opening(wide(0.12, 0.42, 0.42, 0.60), 3, "black_plastic", corner=0.06),
            Opening([(0.72, 0.22), (0.86, 0.26), (0.86, 0.42), (0.72, 0.42)], both=True, fog=0.034, corner=0.045),
        ),
        lamp=[(0.56, -0.03), (0.63, -0.095), (0.80, -0.105), (0.97, -0.06), (0.985, 0.06), (0.90, 0.105), (0.70, 0.09)],
        bowls=((0.775, -0.004, 0.070),),
        lens=Lens((0.775, -0.004), ROUND),
        tail=Lens((0.78, 0.50), (0.054, 0.048), 0.9),
        badge=0.82,
        plate=0.60,
    ),
    "crossover": Face(
        openings=(
            Opening(wide(0.46, 1.05, 0.30, 0.29, 0.44), 7, rim="gloss_black"),
            Opening([(0.58, 0.30), (0.90, 0.36), (0.88, 0.62), (0.80, 0.66)], both=True, fog=0.044),
            Opening(wide(0.12, 0.26, 0.50, 0.46), 1, "black_plastic"),
            Opening(wide(0.0, 0.10, 0.46, 0.54), deep=0.0, ground="galvanised"),
        ),
        lamp=[(0.47, 0.030), (0.53, -0.025), (0.985, 0.0), (0.99, 0.075), (0.62, 0.062)],
        bowls=((0.84, 0.030, 0.028), (0.62, 0.016, 0.026)),
        lens=Lens((0.73, 0.022), (0.100, 0.021), 0.3),
        tail=Lens((0.78, 0.60), (0.105, 0.024), 0.3),
        badge=0.90,
        plate=0.40,
        stacked=False,
    ),
}


def front(skin: Part, parts: list[Part], body: Body, field: Field) -> tuple[Part, list[tuple[float, float, float]]]:
    """Cut a car's front into its skin: gives the rest, and where its headlamps shine from, left and right."""
    face, half, z = FACES[body.name], body.width / 2, body.lamps_z
    sill, y1 = min(z for _, z in body.side), body.length / 2

    def height(share: float) -> float:
        return sill + share * (z - sill)

    shines = []
    for sign in (-1, 1):
        skin = covered(skin, parts, convex([(sign * half * x, z + dz) for x, dz in face.lamp]), y1 - 0.46, 0.045)
        parts += [bowl(field, sign * half * x, z + dz, radius) for x, dz, radius in face.bowls]
        x, dz = sign * half * face.lens.at[0], face.lens.at[1]
        parts.append(lens_patch(field, (x, z + dz), face.lens, "headlamp_lens", 1))
        shines.append((x, front_at(field, x, z + dz, 1) + 0.05, z + dz))
    for opening in face.openings:
        for sign in (-1, 1) if opening.both else (1,):
            outline = convex([(sign * half * x, height(t)) for x, t in opening.outline])
            skin = opened(skin, parts, field, opening, outline)
    at = height(face.plate)
    ahead = max(front_at(field, 0.0, at + dz, 1) for dz in (-0.056, 0.056))
    parts.append(plate((0, ahead + 0.014, at), body.plate, front=True))
    at = height(face.badge)
    parts.append(lens_disc((0, front_at(field, 0.0, at, 1) + 0.010, at), 0.042, "chrome"))
    return skin, shines


def tail_lamps(skin: Part, parts: list[Part], body: Body, field: Field) -> Part:
    """Cut the tail lamps into a skin, each with a light, an amber indicator and a white reversing lamp; gives the
    rest.
    """
    face, half, y0, (low, high) = FACES[body.name], body.width / 2, -body.length / 2, body.tail
    tall = high - low
    ahead, leaning = -y0 - 0.27, []
    if body.pillar is not None:  # a lamp that goes up the pillar does not go on along the shoulder
        leaning = [lambda q: q[:, 1] + 0.5 * (q[:, 2] - low) + ahead]
    for sign in (-1, 1):
        inner = body.tail_inner
        whole = [(inner, low + 0.03), (0.99, low), (0.99, high - 0.03), (0.76, high), (0.62, high - 0.05)]
        if face.stacked:
            bands = [
                ("lamp_lens_white", [(0.4, low + 0.08 * tall), (0.955, low + 0.20 * tall)]),
                ("amber", [(0.4, low + 0.23 * tall), (0.955, low + 0.37 * tall)]),
            ]
        else:
            bands = [
                ("lamp_lens_white", [(inner + 0.02, low + 0.30 * tall), (inner + 0.09, low + 0.80 * tall)]),
                ("amber", [(inner + 0.10, low + 0.62 * tall), (0.955, low + 0.80 * tall)]),
            ]
        for material, ((x0, z0), (x1, z1)) in bands:
            x0 = max(x0, inner + 0.03)
            area = convex([(sign * half * x, z) for x in (x0, x1) for z in (z0, z1)])
            skin = cut_out(skin, parts, material, (0, 2), area, 1, -1, 0.2, ahead, leaning)
        area = convex([(sign * half * x, z) for x, z in whole])
        skin = cut_out(skin, parts, "tail_lamp", (0, 2), area, 1, -1, -9, ahead, leaning)
        x, share = face.tail.at
        parts.append(lens_patch(field, (sign * half * x, low + share * tall), face.tail, "tail_lens", -1))
    return skin


def centre_lamp(field: Field, z: float) -> list[Part]:
    """The third brake lamp, upright at height `z` on the back, under a small roof."""
    low, high = z - 0.004, z + 0.014
    y = front_at(field, 0.0, low, -1) - 0.006
    skin = front_at(field, 0.0, high, -1) + 0.01
    lamp = quad([(-0.12, y, low), (0.12, y, low), (0.12, y, high), (-0.12, y, high)], "brake_lens")
    roof = quad([(-0.13, y, high), (0.13, y, high), (0.13, skin, high), (-0.13, skin, high)], "gloss_black")
    return [lamp, roof]


def opened(skin: Part, parts: list[Part], field: Field, opening: Opening, outline: Sequence[Corner]) -> Part:
    """Cut one opening out of a skin; gives the rest."""
    edge = np.array(convex([(float(x), float(z)) for x, z in filleted(outline, opening.corner, points=3)]))
    found: list[Part] = []
    skin = cut_out(skin, found, opening.ground, (0, 2), edge, 1, 1, 0.25)
    if not found or opening.deep == 0.0:
        parts += found
        return skin
    parts += [replace(part, points=part.points - [0, opening.deep, 0]) for part in found]
    ring = _on_front(field, _along(edge, 0.06))
    parts.append(strip([ring, ring - [0, opening.deep + 0.01, 0]], "gloss_black", closed=True))
    if opening.rim:
        middle = ring.mean(axis=0)
        out = (ring - middle) * [1, 0, 1]
        out /= np.sqrt((out * out).sum(axis=1, keepdims=True))
        frame = [
            ring - 0.006 * out,
            ring - 0.004 * out + [0, 0.008, 0],
            ring + 0.008 * out + [0, 0.006, 0],
            ring + 0.010 * out - [0, 0.006, 0],
        ]
        parts.append(smooth_normals(strip(frame, opening.rim, closed=True), 50))
    parts += _bars(field, opening, edge)
    if opening.fog:
        x, z = np.mean(outline, axis=0)
        parts.append(bowl(field, float(x), float(z), opening.fog))
    return skin


def lamp_units(
    skin: Part,
    parts: list[Part],
    field: Field,
    outline: Sequence[Corner],
    bowls: Sequence[tuple[float, float, float]],
    beyond: float,
) -> tuple[Part, list[tuple[float, float, float]]]:
    """Headlamps of a bus or lorry behind clear covers: gives the rest of the skin, and where they shine from.

    Args:
        outline: corners of the right one's cover (x, z) [m].
        bowls: reflectors of the right one (x, z, radius) [m]; the first has the lens.
        beyond: least y [m] of what is cut.
    """
    shines = []
    for sign in (-1, 1):
        skin = covered(skin, parts, convex([(sign * x, z) for x, z in outline]), beyond, 0.045)
        parts += [bowl(field, sign * x, z, radius) for x, z, radius in bowls]
        x, z, _ = bowls[0]
        parts.append(lens_patch(field, (sign * x, z), Lens((0.0, 0.0), ROUND), "headlamp_lens", 1))
        shines.append((sign * x, front_at(field, sign * x, z, 1) + 0.05, z))
    return skin, shines


def wipers(field: Field, lines: Sequence[tuple[Corner, Corner]]) -> list[Part]:
    """Wipers at rest from one place of the windscreen (x, z) [m] to another."""
    parts = []
    for (x0, z0), (x1, z1) in lines:
        path = [(x0 + u * (x1 - x0), z0 + u * (z1 - z0)) for u in (0.0, 0.5, 1.0)]
        parts.append(tube([(x, front_at(field, x, z, 1) + 0.016, z) for x, z in path], 0.011, "black_plastic", sides=4))
    return parts


def lens_patch(field: Field, at: Corner, lens: Lens, material: str, sign: int) -> Part:
    """A lens that follows the skin of the front (`sign` 1) or back, 14 mm before it."""
    columns = []
    for u in np.array([-0.985, -0.8, -0.5, -0.17, 0.17, 0.5, 0.8, 0.985]) * sign:
        tall = lens.half[1] * (1 - abs(u) ** (2 / lens.square)) ** (lens.square / 2)
        x, zs = at[0] + lens.half[0] * u, at[1] + tall * np.array([-1.0, 0.0, 1.0])
        columns.append(np.array([(x, front_at(field, x, z, sign) + sign * 0.014, z) for z in zs]))
    return strip(columns, material)


def _bars(field: Field, opening: Opening, edge: Array) -> list[Part]:
    """Bars across an opening, or upright, each with a front and a top."""
    across = opening.bars > 0
    axis = 1 if across else 0
    count = abs(opening.bars)
    low, high = edge[:, axis].min(), edge[:, axis].max()
    parts = []
    for k in range(count):
        at = low + (k + 1) / (count + 1) * (high - low)
        cut = []
        for a, b in zip(edge, np.roll(edge, -1, axis=0), strict=True):
            if (a[axis] > at) != (b[axis] > at):
                cut.append(a[1 - axis] + (at - a[axis]) / (b[axis] - a[axis]) * (b[1 - axis] - a[1 - axis]))
        run = np.linspace(min(cut), max(cut), 5 if across else 3)
        line = np.c_[run, np.full(run.shape, at)] if across else np.c_[np.full(run.shape, at), run]
        rail = _on_front(field, line) - [0, 0.008, 0]
        thick = np.array([0, 0, 0.007]) if across else np.array([0.006, 0, 0])
        parts.append(strip([rail - thick, rail + thick, rail + thick - [0, 0.02, 0]], opening.of))
    return parts


def _along(outline: Array, step: float) -> Array:
    """A closed outline with further points, so that none is farther than `step` from the next."""
    points = []
    for a, b in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        count = max(1, int(np.ceil(np.sqrt(((b - a) ** 2).sum()) / step)))
        points += [a + k / count * (b - a) for k in range(count)]
    return np.array(points)


def _on_front(field: Field, line: Array) -> Array:
    """(N, 3) points 2 mm before the front at (N, 2) places across and up."""
    return np.array([(x, front_at(field, x, z, 1) + 0.002, z) for x, z in line])
