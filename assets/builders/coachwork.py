"""What vehicles are made of besides their skin: cuts, wheels, lamps, mirrors, plates and pictures.

Openings and painted areas are cut out of a skin of triangles by planes.  Lengths
in metres; the front looks along +Y, the wheels stand on z = 0.
"""

# ruff: noqa: RUF005 -- offsets are added to arrays, which only look like lists
from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from assets.builders.solids import Field, carve, prism, split
from assets.builders.textures import PLATE_COLUMNS as COLUMNS
from synfog_usd.world.components import Component, Look, MountedLamp
from synfog_usd.world.materials import DUST, DUST_COLOUR, FLAKES, PAINTS
from synfog_usd.world.shapes import (
    Array,
    Part,
    ball,
    disc,
    fan,
    join,
    lathe,
    quad,
    scale,
    shift,
    smooth_normals,
    strip,
    tube,
    turn,
)

PLATES = 24
HEADLIGHT_CD = 9000.0  # dipped beam, hot spot
HEADLIGHT_TINT = (1.02, 0.995, 0.95)
HEADLIGHT_LENS_NITS = (
    14200.0,
    14000.0,
    13600.0,
)  # 120 cd of a lens of 5 cm: with its beam's stray light under the 350 cd of UN R112's point B50L
TAIL_NITS = (2600.0, 6.0, 2.0)  # 5 to 10 cd of a lens of 5.5 to 7.5 cm; UN R7 allows 4 to 12
BRAKE_NITS = (39200.0, 112.0, 34.0)  # 15 times as much: 80 to 150 cd; UN R7 allows 60 to 185
CENTRE_NITS = (47000.0, 134.0, 40.0)  # 44 cd of 240 x 18 mm; UN R7 allows 25 to 80


def painted(name: str) -> Look:
    """What a colour of PAINTS changes; flakes of metal are a share of the ground below the clear coat, and dust hides
    a share of both.
    """
    looks: dict[str, dict[str, object]] = {}
    for material, share in (("paint", 0.0), *DUST.items()):
        mixed = (round((1 - share) * a + share * b, 4) for a, b in zip(PAINTS[name], DUST_COLOUR, strict=True))
        flakes = {"metallic": round((1 - share) * FLAKES[name], 3)} if name in FLAKES else {}
        looks[material] = {"diffuseColor": tuple(mixed), **flakes}
    return Look(materials=looks)


def dusted(skin: Part, parts: list[Part], sill: float, axles: Sequence[float]) -> Part:
    """Cut what the road has thrown up at a skin out of it: two bands above the sill, higher behind the wheels and at
    the back; gives what is clean.
    """
    x, y, z = skin.points.T
    thrown = 0.5 * np.clip((skin.points[:, 1].min() + 0.45 - y) / 0.35, 0, 1)
    for axle in axles:
        behind = (axle - 0.36 - y) / 0.42
        thrown = np.maximum(thrown, np.clip(1 - behind * behind, 0, 1))

    def wave(at: Array) -> Array:
        return np.abs(2 * (at - np.floor(at)) - 1) - 0.5

    ragged = 0.030 * wave(1.1 * y + 0.4 * x) + 0.022 * wave(2.7 * y - 0.9 * x + 0.3)
    height = (z - sill) - ragged - 0.17 * thrown
    dusty, clean = split(skin, height - 0.24)
    x, y, z = dusty.points.T
    thrown = np.zeros(len(z))
    for axle in axles:
        behind = (axle - 0.36 - y) / 0.42
        thrown = np.maximum(thrown, np.clip(1 - behind * behind, 0, 1))
    ragged = 0.030 * wave(1.4 * y + 0.2) + 0.018 * wave(3.4 * y - 0.7 * x)
    dirty, dusty = split(dusty, (z - sill) - ragged - 0.13 * thrown - 0.14)
    parts += [part.painted(name) for part, name in ((dusty, "paint_dusty"), (dirty, "paint_dirty")) if len(part.faces)]
    return clean


def lamp_states(lamps: tuple[MountedLamp, ...], *, centre: bool = False) -> dict[str, Look]:
    """What `lamps` can be: off; glow (lenses only, for afar); on, with the given lights; brake, which is on with bright
    tail lamps.

    centre: whether there is a third brake lamp, of the material `brake_lens`.
    """
    glow = {"headlamp_lens": {"emissiveColor": HEADLIGHT_LENS_NITS}, "tail_lens": {"emissiveColor": TAIL_NITS}}
    brake = {**glow, "tail_lens": {"emissiveColor": BRAKE_NITS}} | (
        {"brake_lens": {"emissiveColor": CENTRE_NITS}} if centre else {}
    )
    return {
        "off": Look(),
        "glow": Look(materials=glow),
        "on": Look(materials=glow, lamps=lamps),
        "brake": Look(materials=brake, lamps=lamps),
    }


def headlights(places: Sequence[tuple[float, float, float]], beam: str = "low_beam_led") -> tuple[MountedLamp, ...]:
    """Dipped beams, left and right, aimed level: the beam itself keeps below the horizon."""
    return tuple(
        MountedLamp(n, shift(*p) @ turn(90, "x"), beam=beam)
        for n, p in zip(("Left", "Right"), sorted(places), strict=True)
    )


def rect(u0: float, u1: float, v0: float, v1: float) -> list[tuple[float, float]]:
    """Corners of an upright rectangle."""
    return [(u0, v0), (u1, v0), (u1, v1), (u0, v1)]


def grown(outline: Sequence[tuple[float, float]], by: float) -> list[tuple[float, float]]:
    """A convex outline moved outward by a distance [m], inward where it is negative."""
    p = np.asarray(outline, dtype=np.float64)
    a = np.roll(p, 1, axis=0)
    b = np.roll(p, -1, axis=0)
    e0, e1 = (
        (p - a) / np.linalg.norm(p - a, axis=1, keepdims=True),
        (b - p) / np.linalg.norm(b - p, axis=1, keepdims=True),
    )
    n0, n1 = np.c_[e0[:, 1], -e0[:, 0]], np.c_[e1[:, 1], -e1[:, 0]]
    offset = (n0 + n1) / np.maximum(1 + (n0 * n1).sum(axis=1, keepdims=True), 0.3)
    return [tuple(q) for q in p + by * offset]


def convex(outline: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """The convex hull of an outline, counter-clockwise."""
    from scipy.spatial import ConvexHull

    p = np.asarray(outline)
    return [tuple(p[i]) for i in ConvexHull(p).vertices]


def cut_out(
    skin: Part,
    parts: list[Part],
    material: str,
    axes: tuple[int, int],
    outline: Sequence[tuple[float, float]],
    along: int,
    sign: int,
    facing: float,
    beyond: float | None = None,
    also: Sequence[Callable[[Array], Array]] = (),
) -> Part:
    """Repaint a convex outline of the skin, seen along an axis, where it faces that way; gives the rest.

    facing: least cosine between the normals and the axis; beyond: least distance along the axis [m]; also: further
    planes, as those of `prism`.
    """
    planes = [*prism(outline, axes), *also]
    if beyond is not None:
        planes.append(lambda q: beyond - sign * q[:, along])
    if sign:
        planes.append(lambda q: -sign * q[:, along])
    inside, rest = carve(skin, planes)
    if len(inside.faces) == 0:
        return skin
    if facing > -1 and inside.normals is not None:
        n = inside.normals[inside.faces].mean(axis=1)[:, along] * sign
        keep = n > facing
        back = Part(inside.points, inside.faces[~keep], skin.material, inside.uv, inside.normals)
        rest = join([rest, back]) if (~keep).any() else rest
        inside = Part(inside.points, inside.faces[keep], material, inside.uv, inside.normals)
    parts.append(inside.painted(material))
    return rest.painted(skin.material)


def gap(
    skin: Part,
    parts: list[Part],
    axes: tuple[int, int],
    path: Sequence[tuple[float, float]],
    along: int,
    sign: int,
    facing: float,
    *,
    width: float = 0.007,
    beyond: float | None = None,
) -> Part:
    """A dark line along a path of corners, as between two panels; gives the rest.  The rest is as for `cut_out`."""
    for a, b in itertools.pairwise(path):
        (ax, ay), (bx, by) = a, b
        half = 0.5 * width / np.sqrt((bx - ax) ** 2 + (by - ay) ** 2)
        nx, ny = half * (ay - by), half * (bx - ax)
        line = [(ax - nx, ay - ny), (bx - nx, by - ny), (bx + nx, by + ny), (ax + nx, ay + ny)]
        skin = cut_out(skin, parts, "seam", axes, line, along, sign, facing, beyond)
    return skin


def screen(
    skin: Part,
    parts: list[Part],
    z0: float,
    z1: float,
    low_half: float,
    high_half: float,
    sign: int,
    upright: bool,
    glass: str = "glass_clear",
    round_to: tuple[float, float] | None = None,
) -> Part:
    """Cut windscreen (`sign` 1) or rear window (-1) with its dark border out of the skin; gives the rest.

    round_to: y [m] at the foot and head of a rear window up to which its border goes round the corners of the car.
    """
    outline = [(-low_half, z0), (low_half, z0), (high_half, z1), (-high_half, z1)]
    planes = prism(grown(outline, -0.01), (0, 2))
    border = prism(grown(outline, 0.02), (0, 2))
    for material, cuts in ((glass, planes), ("gloss_black", border)):
        inside, rest = carve(skin, [*cuts, lambda q: -sign * q[:, 1] - 0.5 if not upright else 0.9 - q[:, 1]])
        n = (
            inside.normals[inside.faces].mean(axis=1)
            if inside.normals is not None and len(inside.faces)
            else np.zeros((0, 3))
        )
        keep = sign * n[:, 1] > (0.18 if sign > 0 else 0.22)
        if len(inside.faces):
            parts.append(Part(inside.points, inside.faces[keep], material, inside.uv, inside.normals))
            back = Part(inside.points, inside.faces[~keep], skin.material, inside.uv, inside.normals)
            skin = (join([rest, back]) if (~keep).any() else rest).painted(skin.material)
    if round_to is not None:
        (y0, y1), low, high = round_to, z0 - 0.02, z1 + 0.02
        behind = min(y0, y1) - 2.0
        corner = convex([(behind, low), (y0, low), (y1, high), (behind, high)])
        for side in (-1, 1):
            skin = cut_out(skin, parts, "gloss_black", (1, 2), corner, 0, side, -0.1, 0.25)
    return skin


def arches(skin: Part, parts: list[Part], axles: Sequence[float], radius: float, inner: float, lip: str = "") -> Part:
    """Cut the wheel arches out, round above the axle and straight below, and line them with dark plastic."""
    arc = np.linspace(0, np.pi, 17)

    def arch(y: float, r: float, foot: float) -> Array:
        return np.vstack([(y + r, foot), np.c_[y + r * np.cos(arc), radius - 0.045 + r * np.sin(arc)], (y - r, foot)])

    def planes(y: float, r: float, sign: int) -> list[Callable[[Array], Array]]:
        first, *bends, last, _ = prism(arch(y, r, -1.0), (1, 2))
        return [lambda q: inner - sign * q[:, 0], first, last, *bends]  # in this order few triangles are cut in vain

    for sign in (-1, 1):
        for y in axles:
            hole, skin = carve(skin, planes(y, radius, sign))
            outer = float(np.abs(hole.points[:, 0]).max()) if len(hole.points) else inner + 0.3
            edge = arch(y, radius + 0.004, 0.72 * radius)
            ring = np.c_[np.zeros(len(edge)), edge]
            parts.append(strip([ring + [sign * inner, 0, 0], ring + [sign * (outer - 0.035), 0, 0]], "seam"))
            wall = np.vstack([ring, [(0, y, radius - 0.3)]]) + [sign * inner, 0, 0]
            last = len(ring)
            parts.append(Part(wall, np.array([(i, i + 1, last) for i in range(last - 1)]), "seam"))
            if lip:
                band, skin = carve(skin, planes(y, radius + 0.055, sign))
                parts.append(band.painted(lip))
    return skin.painted("paint")


def wheels(axles: Sequence[float], radius: float, half_track: float, width: float, spokes: int) -> list[Part]:
    """Four wheels that stand on the ground, rims outward."""
    tyre, rim, brake = wheel(radius, width, spokes)
    placed = []
    for sign in (-1, 1):
        for y in axles:
            m = shift(sign * (half_track - width / 2 + 0.02), y, radius) @ turn(90 * sign, "y")
            placed += [p.moved(m) for p in (tyre, rim, brake)]
    return placed


def wheel(radius: float, width: float, spokes: int) -> tuple[Part, Part, Part]:
    """Tyre with shoulders and a bead, rim with spokes in pairs and brake disc about Z, outside up."""
    r, w, bead = radius, width / 2, radius * 0.68
    tyre = lathe(
        [
            (bead, -w * 0.9),
            (r * 0.90, -w),
            (r, -w * 0.66),
            (r, w * 0.66),
            (r * 0.93, w * 0.97),
            (r * 0.82, w),
            (bead * 1.02, w * 0.86),
        ],
        "tyre",
        sides=26,
        crease_deg=32,
    )
    dish = lathe(
        [(bead * 0.92, -w * 0.5), (bead * 0.94, w * 0.76), (bead * 1.01, w * 0.92), (bead * 1.045, w * 0.88)],
        "rim",
        sides=26,
        crease_deg=35,
    )
    hub = lathe([(bead * 0.24, w * 0.45), (bead * 0.21, w * 0.66), (0.001, w * 0.70)], "rim", sides=10)
    bars = []
    pairs = spokes if spokes > 6 else 2 * spokes
    for i in range(pairs):
        lean = 0.0 if spokes > 6 else (0.5 - i % 2) * 0.62 * np.pi / spokes  # the feet of a pair stand together
        a, b = 2 * np.pi * i / pairs, 2 * np.pi * i / pairs + lean
        foot, tip = np.array([np.cos(a), np.sin(a)]), np.array([np.cos(b), np.sin(b)])
        loops = []
        for at, share, half, z in ((foot, 0.18, 0.085, 0.62), (foot, 0.40, 0.060, 0.72), (tip, 0.96, 0.068, 0.84)):
            side = np.array([-tip[1], tip[0]]) * bead * half * (1.15 if spokes > 6 else 1.0)
            middle = at * bead * share
            ring = [middle - 1.25 * side, middle - side, middle + side, middle + 1.25 * side]
            loops.append(np.c_[np.array(ring), [w * (z - 0.40), w * z, w * z, w * (z - 0.40)]])
        bars.append(smooth_normals(strip(loops, "rim"), 35))
    brake = disc((0, 0, w * 0.15), bead * 0.80, "brake", sides=18)
    return tyre, join([dish, hub, *bars]), brake


def lens_disc(
    centre: tuple[float, float, float], radius: float, material: str, *, back: bool = False, yaw_deg: float = 0.0
) -> Part:
    """A round lens of ten triangles that faces forward or back, turned by `yaw_deg` to the left."""
    return disc((0, 0, 0), radius, material, sides=10).moved(
        shift(*centre) @ turn(yaw_deg) @ turn(90 if back else -90, "x")
    )


def covered(
    skin: Part, parts: list[Part], outline: Sequence[tuple[float, float]], beyond: float, deep_m: float
) -> Part:
    """Cut a headlamp seen from the front out of the skin: a clear cover, and its dark housing `deep_m` behind it."""
    found: list[Part] = []
    skin = cut_out(skin, found, "lamp_glass", (0, 2), outline, 1, 1, -9, beyond)
    for cover in found:
        if cover.normals is None:
            continue
        parts += [cover, replace(cover, points=cover.points - deep_m * cover.normals, material="headlamp")]
    return skin


def bowl(field_: Field, x: float, z: float, radius: float) -> Part:
    """A reflector of a headlamp behind its cover, turned as the skin is there."""
    e = 0.5 * radius
    across = (front_at(field_, x + e, z, 1) - front_at(field_, x - e, z, 1)) / (2 * e)
    upwards = (front_at(field_, x, z + e, 1) - front_at(field_, x, z - e, 1)) / (2 * e)
    ahead = np.array([-across, 1.0, -upwards]) / np.sqrt(1 + across * across + upwards * upwards)
    side = np.array([ahead[1], -ahead[0], 0.0]) / np.sqrt(ahead[0] ** 2 + ahead[1] ** 2)
    place = np.eye(4)
    place[:3, :3] = np.c_[side, np.cross(ahead, side), ahead]
    place[:3, 3] = np.array([x, front_at(field_, x, z, 1), z]) - 0.014 * ahead
    profile = [(radius * 0.3, -0.023), (radius * 0.75, -0.014), (radius, 0.0), (radius * 1.08, 0.0)]
    return lathe(profile, "chrome", sides=10, crease_deg=50).moved(place)


def mirror(sign: int) -> list[Part]:
    """A wing mirror: a shell in the paint of the car over a dark foot, glass towards the back; `sign` is its side."""
    shell = ball((0, 0, 0), (1, 1, 1), "paint", sides=12)
    squared = shell.points * (1.35 - 0.35 * (shell.points * shell.points).max(axis=1, keepdims=True))
    points = squared * [0.105, 0.085, 0.078] + [0.135, 0.0, 0.09]
    points[:, 1] = np.maximum(points[:, 1] - 0.12 * np.abs(points[:, 0] - 0.135), -0.045)
    shell = smooth_normals(Part(points, shell.faces, "paint"), 50)
    at = shell.points - [0.135, 0.0, 0.09]
    low, high = split(shell, at[:, 2] + 0.030)
    rim = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    c, s = np.cos(rim), np.sin(rim)
    bent = 1.25 - 0.25 * np.maximum(c * c, s * s)
    glass = np.c_[0.137 + 0.082 * c * bent, np.full(12, -0.0465), 0.09 + 0.056 * s * bent]
    parts = [
        high,
        low.painted("black_plastic"),
        fan(glass, "chrome"),
        tube(
            [(-0.02, 0.0, -0.005), (0.05, 0.0, 0.01), (0.10, 0.0, 0.045)],
            [0.032, 0.024, 0.026],
            "black_plastic",
            sides=7,
        ),
    ]
    return parts if sign > 0 else [p.moved(scale(-1, 1, 1)) for p in parts]


def plated(component: Component) -> Component:
    """A vehicle with a variant set `plate`: PLATES of the numbers in the picture; any other thing as it is."""
    if not any(part.material == "plate" for part in component.parts):
        return component
    looks = {
        f"p{k:02d}": Look(shifts={"plate": (round(k * 5 % COLUMNS / COLUMNS, 4), round(k // COLUMNS * 3 % 8 / 8, 4))})
        for k in range(PLATES)
    }
    return replace(component, variants={**component.variants, "plate": looks})


def plate(centre: tuple[float, float, float], row: int, *, front: bool) -> Part:
    """A number plate; `row` of their picture."""
    x, y, z = centre
    w, h = 0.26, 0.056
    s = 1 if front else -1
    corners = [(x + s * w, y, z - h), (x - s * w, y, z - h), (x - s * w, y, z + h), (x + s * w, y, z + h)]
    low, high = 1 - (row + 1) / 8, 1 - row / 8
    return quad(corners, "plate", [(0, low), (1, low), (1, high), (0, high)])


def picture(
    corners: Sequence[tuple[float, float, float]],
    material: str,
    row: int,
    rows: int,
    *,
    turned: bool = False,
    lift: tuple[float, float, float] = (0, 0, 0),
) -> Part:
    """One of several pictures that lie one above the other in a texture, on four corners."""
    low, high = 1 - (row + 1) / rows, 1 - row / rows
    uv = [(0, low), (1, low), (1, high), (0, high)]
    p = np.asarray(corners) + np.asarray(lift)
    if turned:  # seen from the front, +X is on the left
        p = p[[1, 0, 3, 2]]
    return quad(p, material, uv)


def side_picture(sign: int, x: float, y0: float, y1: float, z0: float, z1: float, row: int) -> Part:
    """A picture on a flank, read from outside."""
    a, b = (y0, y1) if sign > 0 else (y1, y0)
    return picture([(sign * x, a, z0), (sign * x, b, z0), (sign * x, b, z1), (sign * x, a, z1)], "banner", row, 4)


def on_side(field_, sign: int, y: float, z: float) -> Array:
    """(4, 4) frame on the flank at (y, z) whose X runs along the car."""
    x = np.linspace(0, 1.3, 400)
    f = field_(sign * x, np.full(400, y), np.full(400, z))
    at = x[np.argmax(f > 0)] if (f > 0).any() else 1.0
    return shift(sign * at, y - 0.1, z) @ turn(90)


def side_at(field_, sign: int, y: float, z: float) -> float:
    """The outermost x [m] of a flank at y and z, negative on the left."""
    x = np.linspace(0, 1.4, 300)
    f = field_(sign * x, np.full(300, y), np.full(300, z))
    last = np.nonzero(f < 0)[0][-1]
    return float(sign * (x[last] + (x[last + 1] - x[last]) * f[last] / (f[last] - f[last + 1])))


def seam_line(
    field_: Field, path: Sequence[tuple[float, float]], *, flank: int = 0, end: int = 1, width: float = 0.011
) -> list[Part]:
    """A dark line 4 mm before the skin of a bus or lorry, where a `gap` would cut it into many triangles.

    Args:
        path: corners (x, z) [m] on the front (`end` 1) or back (-1), or (y, z) on the right (`flank` 1) or left one.
    """
    parts = []
    for (a0, b0), (a1, b1) in itertools.pairwise(path):
        long = float(np.hypot(a1 - a0, b1 - b0))
        na, nb = 0.5 * width * (b0 - b1) / long, 0.5 * width * (a1 - a0) / long
        edges = []
        for side in (1, -1):
            edge = []
            for t in np.linspace(0, 1, max(2, int(long / 0.15) + 2)):
                a, b = a0 + t * (a1 - a0) + side * na, b0 + t * (b1 - b0) + side * nb
                if flank:
                    edge.append((side_at(field_, flank, a, b) + 0.004 * flank, a, b))
                else:
                    edge.append((a, front_at(field_, a, b, end) + 0.004 * end, b))
            edges.append(np.array(edge))
        parts.append(strip(edges, "seam"))
    return parts


def front_at(field_, x: float, z: float, sign: int) -> float:
    """The foremost (`sign` 1) or rearmost y [m] of a body at x and z."""
    y = np.linspace(0, 6.4, 800)
    f = field_(np.full(800, x), sign * y, np.full(800, z))
    last = np.nonzero(f < 0)[0][-1]
    return float(sign * (y[last] + (y[last + 1] - y[last]) * f[last] / (f[last] - f[last + 1])))


def top_at(field_, x: float, y: float) -> float:
    """The highest z [m] of a body at x and y."""
    z = np.linspace(0.5, 3, 600)
    f = field_(np.full(600, x), np.full(600, y), z)
    return float(z[np.nonzero(f < 0)[0][-1]])
