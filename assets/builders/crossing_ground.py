"""The ground of the crossing: carriageways, markings, kerbs, pavements and the land around.

Laid out by the figures of `synfog_usd.world.roads.crossing`.  Lengths in metres.
"""

from __future__ import annotations

import itertools

import numpy as np

from synfog_usd.base.seeds import stream
from synfog_usd.world.components import Component
from synfog_usd.world.materials import LANE_TEXTURE_LENGTH_M
from synfog_usd.world.roads.crossing import (
    CORNER,
    KERB_M,
    MAIN_HALF,
    NORTH,
    SIDE,
    SIDE_HALF,
    SOUTH,
    ZEBRA,
    ZEBRA_DEPTH,
    ZEBRA_SIDE,
)
from synfog_usd.world.shapes import Array, Part, disc, fan, quad, strip


def build_ground(trees: list[tuple[float, float]]) -> list[Component]:
    """Road, pavements and land; `trees` are where the pavement has pits."""
    return [_road(), _pavement(trees), _land()]


def _road() -> Component:
    edge_x, edge_y = MAIN_HALF + CORNER, SIDE_HALF + CORNER
    parts: list[Part] = []
    for y0, y1 in ((edge_y, NORTH), (-SOUTH, -edge_y)):
        v0, v1 = y0 / LANE_TEXTURE_LENGTH_M, y1 / LANE_TEXTURE_LENGTH_M
        parts.append(
            quad(
                [(-MAIN_HALF, y0, 0), (MAIN_HALF, y0, 0), (MAIN_HALF, y1, 0), (-MAIN_HALF, y1, 0)],
                "asphalt_lane",
                [(0, v0), (1, v0), (1, v1), (0, v1)],
            )
        )
    for x0, x1 in ((edge_x, SIDE), (-SIDE, -edge_x)):
        v0, v1 = x0 / LANE_TEXTURE_LENGTH_M + 0.37, x1 / LANE_TEXTURE_LENGTH_M + 0.37
        parts.append(
            quad(
                [(x0, -SIDE_HALF, 0), (x1, -SIDE_HALF, 0), (x1, SIDE_HALF, 0), (x0, SIDE_HALF, 0)],
                "asphalt_lane",
                [(0.05, v0), (0.05, v1), (0.95, v1), (0.95, v0)],
            )
        )
    parts.append(
        fan(
            [(-MAIN_HALF, -edge_y, 0), (MAIN_HALF, -edge_y, 0), (MAIN_HALF, edge_y, 0), (-MAIN_HALF, edge_y, 0)],
            "asphalt",
            tile_m=6,
        )
    )
    angle = np.linspace(np.pi, 1.5 * np.pi, 17)
    for sx in (-1, 1):
        x0, x1 = sorted((sx * MAIN_HALF, sx * edge_x))
        parts.append(
            fan([(x0, -SIDE_HALF, 0), (x1, -SIDE_HALF, 0), (x1, SIDE_HALF, 0), (x0, SIDE_HALF, 0)], "asphalt", tile_m=6)
        )
        for sy in (-1, 1):
            arc = np.c_[sx * (edge_x + CORNER * np.cos(angle)), sy * (edge_y + CORNER * np.sin(angle)), np.zeros(17)]
            outline = np.vstack([[(sx * MAIN_HALF, sy * SIDE_HALF, 0)], arc[:: -1 if sx * sy > 0 else 1]])
            parts.append(fan(outline, "asphalt", tile_m=6))
    parts += _repairs() + _markings()
    return Component(
        "street_road", "road", tuple(parts), "Two streets that cross: asphalt, repairs, covers and markings."
    )


def _repairs() -> list[Part]:
    rng = stream(0, "street", "repairs")
    parts = []
    rects = [
        (2.35, 3.05, -66, -18.2), (-1.6, 0.2, -27.2, -22.8), (-4.6, -2.9, -10.4, -6.8), (1.2, 4.0, 1.1, 3.4),
        (-3.2, -2.4, 17.2, 70), (0.5, 2.4, 24, 29), (-5.2, -3.8, -47, -41), (2.0, 3.2, 78, 86),
        (-9, -5.8, -3.9, -2.2),
    ]  # fmt: skip
    for k, (x0, x1, y0, y1) in enumerate(rects):
        wobble = rng.normal(0, 0.03, 8)
        corners = [
            (x0 + wobble[0], y0 + wobble[1]),
            (x1 + wobble[2], y0 + wobble[3]),
            (x1 + wobble[4], y1 + wobble[5]),
            (x0 + wobble[6], y1 + wobble[7]),
        ]
        parts.append(fan([(x, y, 0.0012) for x, y in corners], "asphalt_patch" if k % 3 else "asphalt_old", tile_m=6))
        loop = [*corners, corners[0]]
        for (ax, ay), (bx, by) in itertools.pairwise(loop):
            parts.append(_ribbon(np.array([(ax, ay), (bx, by)]), 0.035, 0.0016, "tar"))
    for _ in range(26):
        x, y = rng.uniform(-4.5, 4.5), rng.uniform(-60, 75)
        heading = rng.choice([0.0, np.pi / 2]) + rng.normal(0, 0.25)
        points = [(x, y)]
        for _ in range(int(rng.integers(6, 26))):
            heading += rng.normal(0, 0.22)
            x, y = x + 0.22 * np.cos(heading), y + 0.22 * np.sin(heading)
            points.append((float(np.clip(x, -5.4, 5.4)), y))
        parts.append(_ribbon(np.array(points), rng.uniform(0.012, 0.035), 0.0018, "tar"))
    for x, y, r in [
        (1.05, -21.0, 0.33),
        (-2.3, -8.2, 0.33),
        (2.9, 0.4, 0.33),
        (0.4, -31.0, 0.33),
        (-1.2, 9.6, 0.33),
        (-0.9, 28, 0.33),
        (1.6, 47, 0.33),
        (3.0, -13.9 - 3.2, 0.16),
        (-3.3, -18.8, 0.16),
        (-1.8, 62, 0.33),
        (1.0, 92, 0.33),
    ]:
        parts += [disc((x, y, 0.0022), r + 0.10, "asphalt_patch", sides=24), disc((x, y, 0.0046), r, "iron", sides=24)]
    for x in (-MAIN_HALF + 0.22, MAIN_HALF - 0.22):
        for y in (-44.0, -18.3, 17.6, 41.0, 70.0, 100.0):
            parts.append(
                quad(
                    [
                        (x - 0.18, y - 0.25, 0.004),
                        (x + 0.18, y - 0.25, 0.004),
                        (x + 0.18, y + 0.25, 0.004),
                        (x - 0.18, y + 0.25, 0.004),
                    ],
                    "iron",
                    [(0.25, 0.25), (0.75, 0.25), (0.75, 0.75), (0.25, 0.75)],
                )
            )
    return parts


def _markings() -> list[Part]:
    parts: list[Part] = []

    def paint(x0: float, x1: float, y0: float, y1: float) -> None:
        parts.append(fan([(x0, y0, 0.003), (x1, y0, 0.003), (x1, y1, 0.003), (x0, y1, 0.003)], "marking", tile_m=3))

    for x in np.arange(-5.25, 5.0, 1.0):  # zebras, 0.5 m on and 0.5 m off
        for s in (-1, 1):
            paint(x, x + 0.5, *sorted((s * ZEBRA, s * (ZEBRA + ZEBRA_DEPTH))))
    for y in np.arange(-4.0, 4.0, 1.0):
        for s in (-1, 1):
            paint(*sorted((s * ZEBRA_SIDE, s * (ZEBRA_SIDE + ZEBRA_DEPTH))), y, y + 0.5)
    stop = ZEBRA + ZEBRA_DEPTH + 1.0
    paint(0.12, 5.3, -stop - 0.5, -stop)
    paint(-5.3, -0.12, stop, stop + 0.5)
    stop_x = ZEBRA_SIDE + ZEBRA_DEPTH + 1.0
    paint(-stop_x - 0.5, -stop_x, -4.1, -0.12)
    paint(stop_x, stop_x + 0.5, 0.12, 4.1)
    for s, end in ((-1, SOUTH), (1, NORTH)):
        paint(-0.06, 0.06, *sorted((s * stop, s * (stop + 21))))
        for y in np.arange(stop + 25, end - 4, 9.0):
            paint(-0.06, 0.06, *sorted((s * y, s * (y + 3))))
        for x in (-3.42, 3.42):
            for y in np.arange(20.0, end - 6, 5.8):
                paint(x - 0.05, x + 0.05, *sorted((s * y, s * (y + 1.0))))
                paint(*sorted((np.sign(x) * 3.42, np.sign(x) * 5.35)), *sorted((s * y, s * (y + 0.1))))
    for s in (-1, 1):
        paint(*sorted((s * stop_x, s * (stop_x + 18))), -0.06, 0.06)
        for x in np.arange(stop_x + 22, SIDE - 4, 9.0):
            paint(*sorted((s * x, s * (x + 3))), -0.06, 0.06)
    for y in (-24.5, -52.0):
        _arrow(parts, 1.75, y, 1)
    for y in (24.5, 52.0):
        _arrow(parts, -1.75, y, -1)
    return parts


def _arrow(parts: list[Part], x: float, y: float, s: int) -> None:
    for outline in ([(-0.08, 0), (0.08, 0), (0.08, 3.2), (-0.08, 3.2)], [(-0.38, 3.2), (0.38, 3.2), (0, 5.0)]):
        parts.append(fan([(x + s * u, y + s * v, 0.003) for u, v in outline], "marking", tile_m=3))


def _pavement(trees: list[tuple[float, float]]) -> Component:
    edge_x, edge_y = MAIN_HALF + CORNER, SIDE_HALF + CORNER
    angle = np.linspace(np.pi, 1.5 * np.pi, 17)
    parts: list[Part] = []
    for sx in (-1, 1):
        for sy in (-1, 1):
            end = NORTH if sy > 0 else SOUTH
            turned = -1 if sx * sy < 0 else 1
            inner = CORNER - 0.15
            arc = np.c_[
                sx * (edge_x + inner * np.cos(angle)), sy * (edge_y + inner * np.sin(angle)), np.full(17, KERB_M)
            ]
            parts.append(fan(np.vstack([[(sx * edge_x, sy * edge_y, KERB_M)], arc[::turned]]), "paving", tile_m=4))
            for x0, x1, y0, y1 in ((MAIN_HALF + 0.15, edge_x, edge_y, end), (edge_x, SIDE, SIDE_HALF + 0.15, edge_y)):
                corners = np.array(
                    [
                        (sx * x0, sy * y0, KERB_M),
                        (sx * x1, sy * y0, KERB_M),
                        (sx * x1, sy * y1, KERB_M),
                        (sx * x0, sy * y1, KERB_M),
                    ]
                )
                flat = fan(corners[::turned], "paving", tile_m=4)
                parts.append(flat)
            path = np.vstack(
                [
                    [(MAIN_HALF, end)],
                    np.c_[edge_x + CORNER * np.cos(angle), edge_y + CORNER * np.sin(angle)],
                    [(SIDE, SIDE_HALF)],
                ]
            )
            parts.append(_kerb(path * [sx, sy], -turned))
            band = [
                (MAIN_HALF + 0.25, ZEBRA),
                (MAIN_HALF + 1.05, ZEBRA),
                (MAIN_HALF + 1.05, ZEBRA + ZEBRA_DEPTH),
                (MAIN_HALF + 0.25, ZEBRA + ZEBRA_DEPTH),
            ]
            parts.append(
                fan(np.array([(sx * x, sy * y, KERB_M + 0.003) for x, y in band])[::turned], "tactile", tile_m=0.8)
            )
    for x, y in trees:
        parts.append(
            fan(
                [
                    (x - 0.6, y - 0.6, KERB_M + 0.002),
                    (x + 0.6, y - 0.6, KERB_M + 0.002),
                    (x + 0.6, y + 0.6, KERB_M + 0.002),
                    (x - 0.6, y + 0.6, KERB_M + 0.002),
                ],
                "soil",
            )
        )
        for dx, dy, w, h in (
            (-0.62, 0, 0.04, 0.64),
            (0.62, 0, 0.04, 0.64),
            (0, -0.62, 0.64, 0.04),
            (0, 0.62, 0.64, 0.04),
        ):
            parts.append(
                fan(
                    [
                        (x + dx - w, y + dy - h, KERB_M + 0.008),
                        (x + dx + w, y + dy - h, KERB_M + 0.008),
                        (x + dx + w, y + dy + h, KERB_M + 0.008),
                        (x + dx - w, y + dy + h, KERB_M + 0.008),
                    ],
                    "kerb",
                )
            )
    return Component(
        "street_pavement",
        "sidewalk",
        tuple(parts),
        "Pavements of concrete slabs with granite kerbs and pits for trees.",
    )


def _kerb(path: Array, inward: int) -> Part:
    """A granite kerb along a path; the pavement lies to its left if `inward` is 1, else right."""
    d = np.gradient(path, axis=0)
    d[0], d[-1] = path[1] - path[0], path[-1] - path[-2]
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    d[1], d[-2] = d[0], d[-1]  # the arc begins along the straight
    left = np.c_[-d[:, 1], d[:, 0]] * inward
    at = np.r_[0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))]
    profile = [(0.0, -0.02), (0.0, KERB_M - 0.02), (0.006, KERB_M - 0.006), (0.02, KERB_M), (0.152, KERB_M)]
    loops = [np.c_[path + w * left, np.full(len(path), z)] for w, z in profile]
    across = np.linspace(0, 1, len(profile))
    part = strip(loops, "kerb", uv=[np.c_[at, np.full(len(path), v)] for v in across])
    return part if inward < 0 else Part(part.points, part.faces[:, ::-1], part.material, part.uv)


def _ribbon(points: Array, width: float, z: float, material: str) -> Part:
    d = np.gradient(points, axis=0)
    d /= np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-9)
    side = np.c_[-d[:, 1], d[:, 0]] * width / 2
    flat = np.full(len(points), z)
    return strip([np.c_[points + side, flat], np.c_[points - side, flat]][::-1], material)


def _land() -> Component:
    far, z = 1600.0, -0.04
    parts = [fan([(-far, -far, z), (far, -far, z), (far, far, z), (-far, far, z)], "grass", tile_m=4)]
    parts.append(
        fan([(-30, NORTH, 0.0), (30, NORTH, 0.0), (30, NORTH + 5, 0.0), (-30, NORTH + 5, 0.0)], "asphalt", tile_m=6)
    )
    return Component("street_land", "terrain", tuple(parts), "Open land to the horizon.")
