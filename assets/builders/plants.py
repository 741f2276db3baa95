"""Street trees, hedges and fallen leaves.

Trees branch by rule from a named random stream; leaves are small folded
diamonds, so that nothing needs transparency.  Lengths in metres.
"""

# ruff: noqa: RUF005 -- offsets are added to arrays, which only look like lists
from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from synfog_usd.base.seeds import stream
from synfog_usd.world.components import Component
from synfog_usd.world.shapes import Array, Part, box, quads, tube


@dataclass(frozen=True)
class Tree:
    """One tree.

    Attributes:
        height: [m]; clear: height of the first branch [m]; girth: radius of the trunk [m].
        leaves: how many; leaf: length of one [m]; tones: materials, first is commonest.
        spread: half width of the crown relative to its height; fork: angle between branches [deg].
        shares: of the leaves in each tone; lean: how far the crown's middle lies aside, relative to the height.
        individual: 'a', or which other one of its kind.
    """

    name: str
    about: str
    height: float
    clear: float
    girth: float
    leaves: int
    leaf: float
    tones: tuple[str, ...]
    spread: float = 0.36
    fork: float = 36.0
    shares: tuple[float, ...] = (0.62, 0.26, 0.12)
    lean: float = 0.0
    individual: str = "a"


TREES = (
    Tree(
        "lime_tree",
        "A lime of the street in early autumn.",
        10.5,
        3.0,
        0.17,
        24000,
        0.12,
        ("leaf_olive", "leaf_green", "leaf_gold"),
        0.34,
    ),
    Tree(
        "maple_tree",
        "A maple of the street, turned golden.",
        8.5,
        2.6,
        0.14,
        20000,
        0.12,
        ("leaf_gold", "leaf_olive", "leaf_rust"),
        0.38,
    ),
    Tree(
        "bare_tree",
        "A plane tree that has lost most of its leaves.",
        11.0,
        3.2,
        0.19,
        900,
        0.13,
        ("leaf_rust", "leaf_gold"),
        0.36,
        32.0,
    ),
    Tree("park_tree", "A large tree of the park.", 15.0, 2.4, 0.32, 30000, 0.185, ("leaf_green", "leaf_olive"), 0.42),
)


def build_trees() -> list[Component]:
    """The trees of `TREES`, three individuals of each: as the table says; tall and slender; low, broad and lopsided,
    further turned.
    """
    trees = []
    for tree in TREES:
        slender = replace(
            tree,
            individual="b",
            height=1.10 * tree.height,
            spread=0.76 * tree.spread,
            fork=tree.fork - 6,
            shares=(0.38, 0.50, 0.12),
        )
        broad = replace(
            tree,
            individual="c",
            height=0.88 * tree.height,
            spread=1.22 * tree.spread,
            fork=tree.fork + 7,
            shares=(0.52, 0.14, 0.34),
            lean=0.07,
        )
        trees.append(replace(_tree(tree), individuals={other.individual: _tree(other) for other in (slender, broad)}))
    return trees


def build_country_trees() -> list[Component]:
    """A birch and a spruce."""
    return [_birch(12.0), _conifer(13.0)]


def build_hedge() -> Component:
    """Eight metres of clipped hedge, 1.3 m high."""
    rng = stream(0, "hedge")
    n = 3600
    u, v, face = rng.uniform(-4, 4, n), rng.uniform(0, 1, n), rng.integers(0, 5, n)
    y = np.where(face < 2, -0.38, np.where(face < 4, 0.38, rng.uniform(-0.38, 0.38, n))) + rng.normal(0, 0.035, n)
    z = np.where(face < 4, v * 1.25, 1.28) + rng.normal(0, 0.035, n)
    places = np.c_[u, y, np.maximum(z, 0.05)]
    own, m = stream(0, "hedge", "ends"), 300
    x = own.choice([-3.9, 3.9], m) + own.normal(0, 0.02, m)
    ends = np.c_[x, own.uniform(-0.36, 0.36, m), own.uniform(0.05, 1.24, m)]
    parts = [
        box((-3.86, -0.34, 0), (3.86, 0.34, 1.24), "hedge", bottom=False),
        _leaves(places, 0.10, "leaf_green", rng),
        _leaves(places[::5] + 0.02, 0.10, "leaf_olive", rng),
        _leaves(ends, 0.10, "leaf_green", own),
    ]
    return Component("hedge", "vegetation", tuple(parts), "Eight metres of clipped hedge.")


def build_leaf() -> Component:
    """One fallen leaf, to be strewn by an instancer."""
    corners = np.array([[(0, -0.07, 0.004), (0.045, 0.0, 0.018), (0, 0.075, 0.004), (-0.045, 0, 0.014)]])
    return Component("fallen_leaf", "vegetation", (quads(corners, "leaf_gold"),), "A fallen leaf.")


def _tree(tree: Tree) -> Component:
    rng = stream(0, "tree", tree.name, *(() if tree.individual == "a" else (tree.individual,)))
    parts: list[Part] = []
    tips: list[Array] = []
    crown_middle = np.array([tree.lean * tree.height, 0, tree.clear + 0.55 * (tree.height - tree.clear)])
    crown_size = np.array([tree.spread * tree.height, tree.spread * tree.height, 0.56 * (tree.height - tree.clear)])

    def inside(p: Array) -> bool:
        return float((((p - crown_middle) / crown_size) ** 2).sum()) < 1.0

    def grow(start: Array, direction: Array, length: float, radius: float, level: int) -> None:
        count = 6 if level == 0 else (5 if level == 1 else 4)
        points, heading = [start], direction
        for _ in range(count):
            lift = 0.03 if level else 0.0
            heading = heading + rng.normal(0, 0.05 + 0.05 * level, 3) + [0, 0, lift]
            heading /= np.linalg.norm(heading)
            points.append(points[-1] + heading * length / count)
        path = np.array(points)
        taper = np.linspace(1.0, 0.62 if level == 0 else 0.45, len(path))
        radii = radius * taper
        if level == 0:
            radii[0] *= 1.35
        sides = (10, 7, 5, 3, 3)[level]
        parts.append(tube(path, radii, "bark" if level < 2 else "twig", sides=sides, capped=False))
        if level >= 2:
            tips.extend(path[1:])
        if level == 4 or radius < 0.005:
            return
        children = (5, 5, 4, 3)[level]
        for i in range(children):
            at = 1.0 if i == 0 else rng.uniform(0.62 if level == 0 else 0.30, 1.0)
            k = at * count
            j = min(int(k), count - 1)
            p = path[j] + (k - j) * (path[j + 1] - path[j])
            turn_angle = np.deg2rad(rng.normal(tree.fork if i else 10, 7))
            side = np.cross(heading, rng.standard_normal(3))
            side /= np.linalg.norm(side)
            branch = np.cos(turn_angle) * heading + np.sin(turn_angle) * side
            size = length * rng.uniform(0.58, 0.80) * (1.15 if level == 0 else 1.0)
            while not inside(p + branch * size) and size > 0.25 * length:
                size *= 0.8
            grow(p, branch, size, radius * (0.74 if i == 0 else rng.uniform(0.42, 0.58)), level + 1)

    first = 0.80 * tree.clear + 0.16 * tree.height
    grow(np.array([0.0, 0.0, -0.05]), np.array([0.0, 0.0, 1.0]), first, tree.girth, 0)
    twigs = np.array(tips)
    which = rng.integers(0, len(twigs), tree.leaves)
    places = twigs[which] + rng.normal(0, 0.22 if tree.leaves > 1000 else 0.05, (tree.leaves, 3))
    tone = rng.choice(
        len(tree.tones), tree.leaves, p=np.array(tree.shares[: len(tree.tones)]) / sum(tree.shares[: len(tree.tones)])
    )
    parts += [_leaves(places[tone == i], tree.leaf, material, rng) for i, material in enumerate(tree.tones)]
    return Component(tree.name, "vegetation", tuple(parts), tree.about)


def _birch(height: float) -> Component:
    """A birch: one white trunk to the top, boughs that rise, twigs that hang."""
    rng = stream(0, "tree", "birch")
    z = np.linspace(0.0, height, 10)
    bend = np.cumsum(rng.normal(0, 0.05, (10, 2)), axis=0)
    trunk = np.c_[bend - bend[0], z]
    parts = [tube(trunk, np.r_[0.145, np.linspace(0.115, 0.010, 9)], "bark_birch", sides=9, capped=False)]
    twigs: list[Array] = []
    for i, at in enumerate(np.linspace(2.3, height - 0.15, 42)):
        start = np.array([np.interp(at, z, trunk[:, 0]), np.interp(at, z, trunk[:, 1]), at])
        length = (0.62 * (height - at) ** 0.62 + 0.25) * rng.uniform(0.75, 1.15) * min(1.0, 0.6 + 0.16 * (at - 2.0))
        a = 2.4 * i + rng.normal(0, 0.3)  # the golden angle, roughly
        out = np.array([np.cos(a), np.sin(a), 0.0])
        t = np.linspace(0, 1, 5)[:, None]
        path = (
            start
            + length * (out * t + np.array([0, 0, 1.0]) * (0.85 * t - 0.45 * t**2))
            + np.r_[[[0, 0, 0]], rng.normal(0, 0.03 * length, (4, 3))]
        )
        parts.append(tube(path, np.linspace(0.016 + 0.009 * length, 0.006, 5), "twig", sides=4, capped=False))
        for s in np.linspace(0.3, 1.0, 3 + round(3 * length)):
            foot = np.array([np.interp(s, t[:, 0], path[:, k]) for k in range(3)])
            way = out * rng.uniform(0.2, 0.9) + rng.normal(0, 0.55, 3) * [1, 1, 0.4]
            hang = rng.uniform(0.45, 0.85)
            twig = foot + hang * np.array([0 * way, 0.5 * way + [0, 0, -0.10], 0.75 * way + [0, 0, -0.62]])
            parts.append(tube(twig, [0.006, 0.004, 0.003], "twig", sides=3, capped=False))
            twigs.append(twig)
    along = np.array(twigs)
    count = 19000
    which, s = rng.integers(0, len(along), count), rng.uniform(0.15, 1.0, count) * 2
    k = np.minimum(s.astype(int), 1)
    places = (
        along[which, k] + (s - k)[:, None] * (along[which, k + 1] - along[which, k]) + rng.normal(0, 0.09, (count, 3))
    )
    tone = rng.choice(3, count, p=[0.6, 0.28, 0.12])
    parts += [
        _leaves(places[tone == i], 0.12, material, rng)
        for i, material in enumerate(("leaf_green", "leaf_olive", "leaf_gold"))
    ]
    return Component("birch_tree", "vegetation", tuple(parts), f"A birch, {height:.0f} m high.")


def _conifer(height: float) -> Component:
    """A spruce: whorls of drooping branches, each a spray of twigs to both sides."""
    rng = stream(0, "tree", "conifer")
    parts: list[Part] = [
        tube([(0, 0, 0), (0, 0, 0.3), (0, 0, height)], [0.26, 0.20, 0.015], "bark", sides=9, capped=False)
    ]
    sprays: list[tuple[Array, Array, float]] = []  # middle, direction and length of each spray of needles
    z = 0.9
    while z < height - 0.25:
        reach = 0.21 * (height - z) ** 0.92 + 0.16
        count = 9 if reach > 0.8 else 6
        for k in range(count):
            a = 2 * np.pi * (k + rng.uniform(-0.3, 0.3)) / count + z
            length = reach * rng.uniform(0.78, 1.10)
            out = np.array([np.cos(a), np.sin(a), 0.0])
            side = np.array([-np.sin(a), np.cos(a), 0.0])
            t = np.linspace(0.0, 1.0, 4)[:, None]
            start = np.array([0, 0, z + rng.uniform(-0.1, 0.1)])
            path = start + out * length * t + np.array([0, 0, length]) * (-0.34 * t + 0.16 * t**2)
            parts.append(tube(path, np.linspace(0.030, 0.008, 4) * min(1.0, reach), "twig", sides=3, capped=False))
            steps = np.arange(0.12, 1.0, 0.11 / max(length, 0.2))
            for s in steps:
                at = start + out * length * s + np.array([0, 0, length * (-0.34 * s + 0.16 * s**2)])
                for turn_side in (-1, 1):
                    heading = out + turn_side * side * rng.uniform(0.7, 1.2) + [0, 0, rng.uniform(-0.75, -0.1)]
                    heading /= np.linalg.norm(heading)
                    twig = (0.30 + 0.30 * (1 - s)) * min(1.0, 0.45 + 0.4 * reach) * rng.uniform(0.8, 1.2)
                    sprays.append((at + heading * twig / 2, heading, twig))
            sprays.append(
                (path[-1], (path[-1] - path[-2]) / np.linalg.norm(path[-1] - path[-2]), 0.4 * min(1.0, 0.4 + reach))
            )
        z += 0.16 + 0.13 * min(1.0, (height - z) / 4)
    places, along, size = (np.array(column) for column in zip(*sprays, strict=True))
    young = rng.random(len(places)) < 0.25
    for material, chosen in (("needle", ~young), ("needle_young", young)):
        parts.append(_diamonds(places[chosen], along[chosen], size[chosen, None], 0.13, material, rng))
    return Component("conifer", "vegetation", tuple(parts), f"A spruce, {height:.0f} m high.")


def _leaves(places: Array, size: float, material: str, rng: np.random.Generator) -> Part:
    n = len(places)
    along = rng.standard_normal((n, 3)) + [0, 0, -0.5]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return _diamonds(places, along, size, 0.36, material, rng, spread=(0.7, 1.2))


def _diamonds(
    places: Array,
    along: Array,
    size: Array | float,
    slim: float,
    material: str,
    rng: np.random.Generator,
    *,
    spread: tuple[float, float] | None = None,
) -> Part:
    """Folded diamonds `size` [m] long, `slim` times as wide to either side, turned at random about `along` (N, 3)."""
    n = len(places)
    across = np.cross(along, rng.standard_normal((n, 3)))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    lift = np.cross(across, along)
    length = size * rng.uniform(*spread, (n, 1)) if spread else size
    width = slim * length
    corners = np.stack(
        [
            places - along * length / 2,
            places + across * width + lift * 0.12 * length,
            places + along * length / 2,
            places - across * width + lift * 0.12 * length,
        ],
        axis=1,
    )
    return quads(corners, material)
