"""What is built at a road: guard rails, delineators, a bridge's deck and railing, a tunnel's mouth, a gantry.

Parts by name, each with its Cityscapes label, laid on the road.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from synfog_usd.base.arrays import Array
from synfog_usd.world.lettering import letters
from synfog_usd.world.roads.network import AT_PORTAL, Road
from synfog_usd.world.roads.surface import bend, sweep
from synfog_usd.world.shapes import Part, box, fan, quad, soft_box, strip, tube, untextured
from synfog_usd.world.spec import Placement, View

RAIL_TOP_M = 0.75
POST_M = 4.0
DELINEATOR_M = 50.0
TUNNEL_APEX_M, TUNNEL_WALL_M = 6.4, 3.4
PORTAL_OUT_M = 8.5
UPSTAND_M = 0.08
"""Of a bridge's edge over its pavement: low, so that a driver sees the water below."""
LAMP_M = 9.0
"""Between the lamps of a tunnel."""


@dataclass(frozen=True)
class Built:
    """Parts that belong together, under one name and label."""

    name: str
    label: str
    parts: tuple[Part, ...]


@dataclass(frozen=True)
class Instanced:
    """Many of one model, upright.

    Attributes:
        path: of the instancer; asset: of the model; label: Cityscapes class.
        points: (N, 3) [m]; turns: (N,) degrees counter-clockwise.
    """

    path: str
    asset: str
    label: str
    points: Array
    turns: Array


@dataclass(frozen=True)
class LitPanes:
    """Which panes of buildings are lit at dusk.

    Attributes:
        name: of the random stream.
        shares: material of panes -> share that is lit.
        near: whether a building counts, seen from the camera.
        facades: whether windows in roofs stay dark, as `nominal.json` counts them.
    """

    name: str
    shares: Mapping[str, float]
    near: Callable[[Placement, View], bool]
    facades: bool = False


def guard_rail(road: Road, t: float, side: int, low: float, high: float, name: str) -> Built:
    """A W-beam on posts at offset t whose traffic lies to the right if `side` is 1, else to the left."""
    waves = [
        (0.0, 0.44),
        (0.08, 0.48),
        (0.08, 0.535),
        (0.02, 0.575),
        (0.02, 0.615),
        (0.08, 0.655),
        (0.08, 0.71),
        (0.0, RAIL_TOP_M),
    ]
    profile = [(t + side * u, h) for u, h in waves]
    base = float(road.lane_section.height(t))
    profile = [(u, h + base) for u, h in profile]
    parts = [sweep(road, profile if side > 0 else profile[::-1], "galvanised", tile_m=1.0, low=low, high=high)]
    for s in np.arange(low + 1.0, high, POST_M):
        a, b = sorted((t - side * 0.02, t - side * 0.12))
        parts.append(
            bend(box((a, s - 0.05, base - 0.15), (b, s + 0.05, base + 0.70), "galvanised", bottom=False), road)
        )
    return Built(name, "guard rail", tuple(untextured(part) for part in parts))


def delineators(road: Road, low: float, high: float) -> list[Built]:
    """White posts 1 m high every 50 m on both sides, with a black band and reflectors."""
    edges = (road.lane_section.low, road.lane_section.high)
    verges = [lane for lane in road.lane_section.of("verge")]
    if verges:
        edges = (verges[0].high - 0.75, verges[-1].low + 0.75)
    parts: list[Part] = []
    for s in np.arange(low + 12.0, high, DELINEATOR_M):
        for t in edges:
            base = float(road.lane_section.height(t))
            for material, out, z0, z1 in (
                ("post_white", 0.0, -0.2, 0.72),
                ("gloss_black", 0.001, 0.72, 0.90),
                ("post_white", 0.0, 0.90, 1.02),
            ):
                across, along = 0.06 + out, 0.05 + out
                corners = (t - across, s - along, base + z0), (t + across, s + along, base + z1)
                parts.append(soft_box(*corners, material, radius=0.03))
            parts.append(box((t - 0.025, s - 0.056, base + 0.74), (t + 0.025, s - 0.052, base + 0.88), "reflective"))
    return [Built("Delineators", "pole", tuple(untextured(bend(part, road)) for part in parts))]


def bridge(road: Road) -> list[Built]:
    """The deck over the valley: fascias, underside, piers, and a railing on both sides."""
    assert road.land.valley is not None
    low, high, depth = road.land.valley
    west, east = road.lane_section.low, road.lane_section.high
    a, b = float(road.lane_section.height(west)), float(road.lane_section.height(east))
    profile = [
        (west, a),
        (west, a + UPSTAND_M),
        (west - 0.35, a + UPSTAND_M),
        (west - 0.35, a - 0.75),
        (west + 1.2, -1.9),
        (east - 1.2, -1.9),
        (east + 0.35, b - 0.75),
        (east + 0.35, b + UPSTAND_M),
        (east, b + UPSTAND_M),
        (east, b),
    ]
    deck: list[Part] = [sweep(road, profile[::-1], "concrete", tile_m=3.0, low=low - 4.0, high=high + 4.0)]
    for s in np.linspace(low, high, max(3, round((high - low) / 28.0)) + 1)[1:-1]:
        deck.append(
            bend(
                soft_box((west + 2.0, s - 0.7, -depth - 7.0), (east - 2.0, s + 0.7, -1.85), "concrete", radius=0.4),
                road,
            )
        )
    rails: list[Part] = []
    for t, base in ((west - 0.17, a + UPSTAND_M), (east + 0.17, b + UPSTAND_M)):
        for h, r in ((1.02, 0.035), (0.78, 0.014), (0.56, 0.014), (0.34, 0.014), (0.14, 0.014)):
            rails.append(_bar(road, t, base + h, r, low - 4.0, high + 4.0))
        for s in np.arange(low - 4.0, high + 4.0, 2.0):
            rails.append(
                bend(box((t - 0.03, s - 0.03, base), (t + 0.03, s + 0.03, base + 1.0), "railing", bottom=False), road)
            )
    return [Built("Deck", "bridge", tuple(deck)), Built("Railing", "fence", tuple(untextured(part) for part in rails))]


def _bar(road: Road, t: float, h: float, radius: float, low: float, high: float) -> Part:
    ring = np.linspace(0, 2 * np.pi, 7)
    return sweep(
        road, np.c_[t + radius * np.cos(ring), h + radius * np.sin(ring)], "railing", tile_m=1.0, low=low, high=high
    )


def arch(half: float, *, grown: float = 0.0, sides: int = 24) -> Array:
    """(K, 2) offsets and heights of the tunnel's lining from the left foot over the apex to the right foot."""
    angle = np.linspace(np.pi, 0.0, sides + 1)
    crown = np.c_[
        (half + grown) * np.cos(angle), TUNNEL_WALL_M + (TUNNEL_APEX_M - TUNNEL_WALL_M + grown) * np.sin(angle)
    ]
    return np.vstack([[(-(half + grown), -0.3)], crown, [(half + grown, -0.3)]])


def tunnel(road: Road) -> list[Built]:
    """Lining, portal and lamps of a tunnel that begins where the hill does."""
    assert road.land.hill is not None
    begin, end = road.land.hill[0], road.reference_line.length
    top_m = AT_PORTAL * road.land.hill[1] + 0.5
    half = (road.lane_section.high - road.lane_section.low) / 2
    middle = (road.lane_section.high + road.lane_section.low) / 2
    line = arch(half)
    inside = sweep(road, line + np.array([middle, 0.0]), "concrete", tile_m=3.0, low=begin - 0.6, high=end)
    outer = arch(half, grown=0.5)
    collar = sweep(road, outer + np.array([middle, 0.0]), "concrete", tile_m=3.0, low=begin - 0.6, high=begin)
    face = [_ring(road, line, outer, middle, begin - 0.6, "concrete")]
    wide = half + PORTAL_OUT_M
    crown = outer[1:-1]
    top = np.c_[np.clip(crown[:, 0] * 2.0, -wide, wide), np.full(len(crown), top_m)]
    top[0], top[-1] = (-wide, top_m), (wide, top_m)
    frame = np.vstack([[(-wide, -0.6)], top, [(wide, -0.6)]])
    face.append(_ring(road, outer, frame, middle, begin, "stone_dark"))
    coping = box(
        (middle - wide - 0.2, begin - 0.25, top_m),
        (middle + wide + 0.2, begin + 0.7, top_m + 0.35),
        "concrete",
        tile_m=3.0,
    )
    face.append(bend(coping, road))
    for side in (-1, 1):
        x = middle + side * wide
        parts = quad([(x, begin, -0.6), (x, begin + 6, -0.6), (x, begin + 6, top_m), (x, begin, top_m)], "stone_dark",
                     [(0, 0), (2, 0), (2, 3), (0, 3)])  # fmt: skip
        face.append(bend(parts, road))
    closed = fan([(middle + t, end, h) for t, h in line], "tunnel_dark")
    lamps: list[Part] = []
    for s in np.arange(begin + 3.0, end - 2.0, LAMP_M):
        for t in (-0.32 * half, 0.32 * half):
            lamps.append(
                bend(box((middle + t - 0.12, s - 0.75, 5.55), (middle + t + 0.12, s + 0.75, 5.62), "tunnel_lamp"), road)
            )
    marks = [
        Built(
            "Lining",
            "tunnel",
            tuple(untextured(p) if p.material == "tunnel_dark" else p for p in (inside, collar, bend(closed, road))),
        ),
        Built("Portal", "wall", tuple(face)),
        Built("Tunnel_Lamps", "static", tuple(untextured(part) for part in lamps)),
    ]
    return marks


def _ring(road: Road, inner: Array, outer: Array, middle: float, s: float, material: str) -> Part:
    """An upright face between two outlines of equally many (t, h), towards the beginning of the road."""
    loops = [np.c_[line[:, 0] + middle, np.full(len(line), s), line[:, 1]] for line in (inner, outer)]
    uv = [line / 3.0 for line in (inner, outer)]
    return bend(strip(loops, material, uv=uv), road)


def gantry(road: Road, s: float, number: int) -> Built:
    """A sign bridge over the lanes that go along: two posts, a lattice beam, a board a lane."""
    lanes = [lane for lane in road.driving_lanes if lane.way > 0]
    low, high = lanes[0].middle - lanes[0].width / 2 - 1.3, lanes[-1].middle + lanes[-1].width / 2 + 3.4
    parts: list[Part] = []
    for t in (low, high):
        base = float(road.lane_section.height(t))
        parts.append(tube([(t, s, base - 0.2), (t, s, 7.6)], [0.2, 0.16], "galvanised", sides=10))
    for h in (6.3, 7.5):
        for y in (s - 0.35, s + 0.35):
            parts.append(tube([(low, y, h), (high, y, h)], 0.07, "galvanised", sides=6))
    for k, t in enumerate(np.arange(low, high - 1.0, 1.2)):
        for y in (s - 0.35, s + 0.35):
            ends = [(t, y, 6.3), (min(t + 1.2, high), y, 7.5)]
            parts.append(
                tube(ends if k % 2 else [(ends[0][0], y, 7.5), (ends[1][0], y, 6.3)], 0.035, "galvanised", sides=5)
            )
    for k, lane in enumerate(lanes):
        t = lane.middle
        back = soft_box((t - 1.55, s - 0.52, 5.75), (t + 1.55, s - 0.42, 7.95), "sign_back", radius=0.06)
        parts += [back, _face(t, s - 0.525, 1.5, 5.8, 7.9, "board_blue"), *_board(t, s - 0.53, number + k)]
    return Built(f"Gantry_{number}", "traffic sign", tuple(untextured(bend(part, road)) for part in parts))


def _face(t: float, s: float, half: float, low: float, high: float, material: str) -> Part:
    return quad([(t - half, s, low), (t + half, s, low), (t + half, s, high), (t - half, s, high)], material)


PLACES = (("NORDTAL", "MESSE"), ("LUMENAU", "ZENTRUM"), ("HAFEN", "STADION"))
"""Names on the boards of a gantry, board by board."""


def _board(t: float, s: float, number: int) -> list[Part]:
    """White frame, an arrow down to the lane and two names."""
    parts = [
        _face(t, s, 0.09, 6.25, 6.75, "board_white"),
        Part(np.array([(t - 0.26, s, 6.28), (t, s, 5.92), (t + 0.26, s, 6.28)]), np.array([[0, 1, 2]]), "board_white"),
    ]
    for word, h in zip(PLACES[number % len(PLACES)], (7.38, 6.93), strict=True):
        for part in letters(word, 0.30, "board_white"):  # which are read from +s, and here from -s
            x, _, z = part.points.T
            parts.append(replace(part, points=np.c_[t - x, np.full(len(x), s), h + z], normals=None))
    for low, high in ((5.84, 5.88), (7.82, 7.86)):
        parts.append(_face(t, s, 1.46, low, high, "board_white"))
    for side in (-1, 1):
        parts.append(_face(t + side * 1.44, s, 0.02, 5.84, 7.86, "board_white"))
    return parts
