"""What is painted and put up at a roundabout: give-way lines, zebras, lines, arrows, covers, and its blue signs.

Markings are made in the level plane of an arm, offsets to the right and stations
outwards, 3 mm thick.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from synfog_usd.base.seeds import stream
from synfog_usd.world.roads import markings
from synfog_usd.world.roads.lane_section import Lane
from synfog_usd.world.roads.markings import THICK_M, TILE_M
from synfog_usd.world.roads.roundabout import HOLD_M, ISLAND_EDGE_M, TAPER_M, ZEBRA_HALF_M, Roundabout
from synfog_usd.world.roads.structures import Built
from synfog_usd.world.roads.surface import ASPHALT_TILE_M, bend, cover, gully, ribbon
from synfog_usd.world.shapes import Part, fan, shift, strip, textured_from_above, tube, turn, untextured

GIVE_WAY = ("teeth", "dashes")
GIVE_WAY_M = 0.25
"""Between the circle and the give-way line."""
FROM_KERB_M = 0.3
TOOTH_M = 0.6
LINE_M = 0.12
SIGN_M = 0.3
"""Radius of the blue signs' faces."""


def paint(junction: Roundabout, *, give_way: str) -> list[Part]:
    """Every marking of a roundabout, laid on it."""
    parts: list[Part] = []
    for arm, road in enumerate(junction.arms):
        level = [*_give_way(junction, arm, give_way), *_zebra(junction, arm), *_lines(junction, arm)]
        middle = -(float(junction.spread(junction.radius + HOLD_M)) + junction.lane_width / 2)
        lane = Lane("lane", junction.lane_width, -1, middle - junction.lane_width / 2, middle + junction.lane_width / 2)
        parts += [bend(part, road) for part in [*level, *markings.arrow(lane, junction.radius + HOLD_M + 4.0)]]
    return parts


def entry(junction: Roundabout, arm: int, beyond: float) -> tuple[float, float]:
    """Offsets (from, to) [m] of an arm's entry at a distance beyond the circle, from the kerb to the island."""
    r = junction.radius + beyond
    right = np.linspace(-0.97 * r, -junction.half_island, 300)
    u, _ = junction.across(*junction.arms[arm].reference_line.place(np.sqrt(r * r - right**2), right))
    kerbs = np.flatnonzero(u > -FROM_KERB_M)
    return float(right[kerbs[-1] + 1]) if len(kerbs) else float(right[0]), -junction.half_island


def _give_way(junction: Roundabout, arm: int, kind: str) -> list[Part]:
    """Along the circle from the kerb to the splitter island: triangles that point at who must wait, or a broken
    line.
    """
    r, long = junction.radius + GIVE_WAY_M, TOOTH_M if kind == "teeth" else 0.3
    low, high = entry(junction, arm, GIVE_WAY_M + long)  # where the far ends of the marks keep off the kerb
    a, b = np.arcsin(max(low, -0.75 * r) / (r + long)), np.arcsin(high / r)
    n = int(r * (b - a) / 0.9)
    parts = []
    for angle in a + (b - a) * (np.arange(n) + 0.5) / n:
        across, out = np.array([np.cos(angle), -np.sin(angle)]), np.array([np.sin(angle), np.cos(angle)])
        foot = r * out
        if kind == "teeth":
            outline = [foot - 0.25 * across, foot + 0.25 * across, foot + long * out]
        else:
            side, far = 0.3 * across, long * out
            outline = [foot - side, foot + side, foot + side + far, foot - side + far]
        parts.append(fan([(t, s, THICK_M) for t, s in outline], "marking", tile_m=TILE_M))
    return parts


def _zebra(junction: Roundabout, arm: int) -> list[Part]:
    """Stripes of half a metre on both lanes, none in the island's gap."""
    at = junction.arms[arm].zebras[0]
    low, high = at - ZEBRA_HALF_M, at + ZEBRA_HALF_M
    inner = junction.half_island - ISLAND_EDGE_M
    parts = []
    for side in (-1, 1):
        edge = float(min(junction.edge(arm, side, low), junction.edge(arm, side, high)))
        for t in side * np.arange(inner + 0.35, edge - 0.55, 1.0):
            a, b = sorted((t, t + side * 0.5))
            parts.append(markings.bar((a, b), (low, high)))
    return parts


def _lines(junction: Roundabout, arm: int) -> list[Part]:
    """Two lines that lead round the island's tip and go on as one broken line."""
    tip, end = junction.islands(arm)[-1][1], junction.radius + HOLD_M + TAPER_M
    s = np.linspace(tip + 0.8, end + 8.0, 24)
    parts = []
    for side in (-1, 1):
        t = side * np.maximum(junction.spread(s) - 0.5 * LINE_M, 0.11)
        parts.append(textured_from_above(ribbon(np.c_[t, s], LINE_M, THICK_M, "marking"), TILE_M))
    for at in np.arange(tip + 2.2, end - 6.0, 2.4):  # slanting bars between them
        half = float(junction.spread(at)) - 0.22
        if half > 0.12:
            slanting = ribbon(np.array([(-half, at), (half, at + half)]), 0.25, THICK_M, "marking")
            parts.append(textured_from_above(slanting, TILE_M))
    dash = markings.painted_line(0.0, end + 10.0, junction.arms[arm].reference_line.length - 1.0, LINE_M, (3.0, 6.0))
    return parts + dash


def worn(junction: Roundabout, *, seed: int) -> list[Part]:
    """Seams where the ring's asphalt meets the arms', sealed cracks, covers and gullies, 1.5 to 2.6 mm above the
    asphalt.
    """
    rng = stream(seed, "roundabout", "worn")
    parts: list[Part] = []
    far = junction.radius + HOLD_M
    for road in junction.arms:
        edge = junction.half_island + junction.lane_width - 0.05
        for side in (-1, 1):
            t = side * np.linspace(junction.half_island, edge, 7)
            parts.append(bend(ribbon(np.c_[t, np.sqrt(far**2 - t * t)], 0.04, 0.0016, "tar"), road))
            for s in np.arange(far + rng.uniform(2, 10), road.reference_line.length - 1.0, 24.0):
                x = side * (float(junction.spread(s)) + junction.lane_width - 0.22)
                parts.append(bend(gully(x, s), road))
        for s in np.arange(far + rng.uniform(4, 12), road.reference_line.length - 5, 31.0):
            t = rng.choice((-1, 1)) * (float(junction.spread(s)) + junction.lane_width / 2)
            parts += [bend(part, road) for part in cover(t, s)]
    width = junction.radius - junction.inner
    for angle in rng.uniform(0, 2 * np.pi, 3):
        r = junction.inner + width * rng.uniform(0.3, 0.7)
        parts += cover(r * np.cos(angle), r * np.sin(angle))
    for number in range(int(rng.integers(1, 4))):
        parts += _mended(junction, rng, 0.0011 + 0.0001 * number)  # they may cross
    for _ in range(9):
        angle, r = rng.uniform(0, 2 * np.pi), junction.inner + width * rng.uniform(0.15, 0.85)
        steps = int(rng.integers(6, 24))
        a = angle + np.cumsum(np.full(steps, 0.22 / r))
        path = np.clip(r + np.cumsum(rng.normal(0, 0.035, steps)), junction.inner + 0.1, junction.radius - 0.1)
        parts.append(ribbon(np.c_[path * np.cos(a), path * np.sin(a)], float(rng.uniform(0.012, 0.035)), 0.0018, "tar"))
    return parts


def _mended(junction: Roundabout, rng: np.random.Generator, height: float) -> list[Part]:
    """A mended trench along the ring, and the tar along its seams."""
    width = junction.radius - junction.inner
    low = junction.inner + width * rng.uniform(0.1, 0.55)
    radius = np.array([low, low + rng.uniform(0.6, 1.6)])
    angle = rng.uniform(0, 2 * np.pi) + np.linspace(0.0, rng.uniform(2.0, 12.0) / low, 25)
    rims = [np.c_[r * np.cos(angle), r * np.sin(angle)] for r in radius]
    patch = strip([np.c_[rim, np.full(len(angle), height)] for rim in rims[::-1]], "asphalt_patch")
    seams = [*rims, np.array([rims[0][0], rims[1][0]]), np.array([rims[0][-1], rims[1][-1]])]
    return [textured_from_above(patch, ASPHALT_TILE_M), *(ribbon(seam, 0.035, 0.0016, "tar") for seam in seams)]


# -- signs


def signs(junction: Roundabout) -> list[Built]:
    """On each splitter island the sign of the roundabout before the circle, and low at its tip 'keep right'; both face
    who arrives.
    """
    built = []
    for arm, road in enumerate(junction.arms):
        (low, _), (_, tip) = junction.islands(arm)
        for name, s, high, face in (
            ("Roundabout", low + 1.1, 2.35, _round_arrows()),
            ("Keep_Right", tip - 0.9, 0.95, _keep_right()),
        ):
            place = shift(*junction.stand(*road.reference_line.place(s, 0.0))) @ turn(road.reference_line.origin[2])
            pole = tube([(0, 0, -0.2), (0, 0, high + SIGN_M)], 0.03, "galvanised", sides=10)
            parts = [untextured(pole), *(part.moved(shift(0, 0, high)) for part in face)]
            built.append(Built(f"Sign_{name}_{arm + 1}", "traffic sign", tuple(part.moved(place) for part in parts)))
    return built


def _front(outline: npt.ArrayLike, depth: float, material: str) -> Part:
    """A convex outline of a sign's face, right and up from its middle as one sees it, `depth` [m] before the pole."""
    p = np.asarray(outline, dtype=np.float64)
    return Part(np.c_[-p[:, 0], np.full(len(p), depth), p[:, 1]], fan(np.c_[p, np.zeros(len(p))], "").faces, material)


def _plate() -> list[Part]:
    """A blue disc with a white rim, and its grey back."""
    angle = np.linspace(0, 2 * np.pi, 33)[:-1]
    circle = SIGN_M * np.c_[np.cos(angle), np.sin(angle)]
    back = _front(circle, 0.035, "sign_back")
    return [
        Part(back.points, back.faces[:, ::-1], back.material),
        _front(circle, 0.05, "sign_white"),
        _front(0.93 * circle, 0.053, "sign_blue"),
    ]


def _round_arrows() -> list[Part]:
    """Three arrows that go round counter-clockwise, as traffic does."""
    parts = _plate()
    for k in range(3):
        a = np.radians(120.0 * k) + np.linspace(0.0, np.radians(68.0), 9)
        rim = [np.c_[r * np.cos(a), r * np.sin(a)] for r in (0.14, 0.195)]
        parts.append(strip([np.c_[-p[:, 0], np.full(9, 0.056), p[:, 1]] for p in rim[::-1]], "sign_white"))
        tip, end = a[-1] + np.radians(34.0), a[-1]
        head = [(r * np.cos(b), r * np.sin(b)) for r, b in ((0.245, end), (0.168, tip), (0.09, end))]
        parts.append(_front(head, 0.056, "sign_white"))
    return parts


def _keep_right() -> list[Part]:
    """A white arrow down to the right."""
    along, side = np.array([np.sqrt(0.5), -np.sqrt(0.5)]), np.array([np.sqrt(0.5), np.sqrt(0.5)])
    shaft = [s * along + t * side for s, t in ((-0.2, -0.035), (0.06, -0.035), (0.06, 0.035), (-0.2, 0.035))]
    head = [0.06 * along - 0.12 * side, 0.22 * along, 0.06 * along + 0.12 * side]
    return [*_plate(), _front(shaft, 0.056, "sign_white"), _front(head, 0.056, "sign_white")]
