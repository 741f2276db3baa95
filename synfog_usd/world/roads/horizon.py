"""What closes the view behind the last house: hills, fields with borders, woods, villages or a town, and a skyline.

Knows a site by two functions of places only: the height of its ground, and how far off its road is.  All of it
stands beyond `NEAR_M` of the road, where nothing of a recipe stands.  Lengths in metres.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import Array
from synfog_usd.base.arrays import Indices as Index
from synfog_usd.base.seeds import stream
from synfog_usd.world.materials import Material
from synfog_usd.world.shapes import Part, box, by_material, join, quad, quads, shift, tube, turn

Tree = tuple[str, Mapping[str, str]]
LAND_M = 2400.0
"""How far the land goes; the camera's far end is at 3 km."""
NEAR_M = 75.0
RELIEF_FROM_M, RELIEF_OVER_M = 160.0, 1300.0
KINDS = ("country", "town")
LOOKS: dict[str, Material] = {
    "field_wheat": Material((0.30, 0.245, 0.115), 0.9),
    "field_stubble": Material((0.215, 0.185, 0.095), 0.9),
    "field_soil": Material((0.105, 0.078, 0.052), 0.95),
    "field_crop": Material((0.072, 0.125, 0.036), 0.9),
    "field_meadow": Material((0.095, 0.140, 0.045), 0.9),
    "field_wood": Material((0.030, 0.046, 0.018), 0.95),
    "far_cream": Material((0.56, 0.49, 0.36), 0.85),
    "far_white": Material((0.64, 0.63, 0.60), 0.85),
    "far_brick": Material((0.27, 0.125, 0.085), 0.9),
    "far_grey": Material((0.36, 0.365, 0.36), 0.85),
    "far_tile": Material((0.235, 0.092, 0.055), 0.8),
    "far_slate": Material((0.105, 0.110, 0.120), 0.6),
    "far_window": Material((0.035, 0.038, 0.042), 0.06, ior=1.9),
    "far_blind": Material((0.36, 0.35, 0.32), 0.6),
    "far_door": Material((0.075, 0.045, 0.03), 0.5),
    "far_frame": Material((0.60, 0.60, 0.58), 0.5),
    "far_steel": Material((0.30, 0.31, 0.32), 0.6),
    "water": Material((0.014, 0.022, 0.018), 0.07, ior=1.33),
    "far_red": Material((0.40, 0.05, 0.04), 0.6),
}
"""Materials without pictures: a brick is a hundredth of a pixel there."""
CROPS = ("field_wheat", "field_stubble", "field_soil", "field_crop", "field_meadow", "field_wood")
SHARES = {"country": (0.14, 0.13, 0.14, 0.17, 0.24, 0.18), "town": (0.02, 0.03, 0.03, 0.10, 0.70, 0.12)}
WOODS = (
    (("lime_tree", "a"), ("lime_tree", "c"), ("park_tree", "a"), ("park_tree", "b"), ("birch_tree", "")),
    (("park_tree", "c"), ("park_tree", "a"), ("maple_tree", "b"), ("lime_tree", "b"), ("conifer", "")),
    (("conifer", ""), ("conifer", ""), ("birch_tree", ""), ("park_tree", "b"), ("lime_tree", "a")),
)
"""Mixtures of a wood: five trees of the library, and which individual of each."""


@dataclass(frozen=True)
class Scatter:
    """Many of the same few: prototypes, and where they stand.

    Attributes:
        name, label: of the prim.
        parts: of the prototype, where it is made for this world.
        points: (N, 3) [m]; turns: (N,) degrees; sizes: (N,) scale.
        models: prototypes from the library, each with its variants; which: (N,) of them stands where.
    """

    name: str
    label: str
    parts: tuple[Part, ...]
    points: Array
    turns: Array
    sizes: Array
    models: tuple[Tree, ...] = ()
    which: Index | None = None


def mixture(seed: int, lod: str = "far") -> tuple[Tree, ...]:
    """The trees of this world's woods, as they are seen from afar."""
    chosen = WOODS[int(stream(seed, "land", "mixture").integers(len(WOODS)))]
    return tuple(
        (name, {"individual": individual, "lod": lod} if individual else {"lod": lod}) for name, individual in chosen
    )


@dataclass(frozen=True)
class Horizon:
    """The land of one world beyond its road.

    Attributes:
        seed: of its streams; kind: one of KINDS.
        height: ground of the site [m] at (N,) x, y, without the relief; away: how far off the road is [m].
        ahead: (x, y, heading) of the camera, heading in degrees counter-clockwise from +Y.
        flooded: where nothing stands.
    """

    seed: int
    kind: str
    height: Callable[[Array, Array], Array]
    away: Callable[[Array, Array], Array]
    ahead: tuple[float, float, float] = (0.0, 0.0, 0.0)
    flooded: Callable[[Array, Array], npt.NDArray[np.bool_]] | None = None

    @cached_property
    def _waves(self) -> tuple[Array, float]:
        rng = stream(self.seed, "horizon", "relief")
        table = np.c_[rng.uniform(420, 1700, 7), rng.uniform(0, 2 * np.pi, (7, 2))]
        return table, float(rng.uniform(30, 95) if self.kind == "country" else rng.uniform(12, 50))

    def relief(self, x: Array, y: Array, away: Array) -> Array:
        """What far hills add to the ground [m]; nothing near the road."""
        table, high = self._waves
        total = sum(
            (length / 1700) * np.sin((x * np.cos(a) + y * np.sin(a)) * 2 * np.pi / length + p) for length, a, p in table
        )
        share = np.clip((away - RELIEF_FROM_M) / RELIEF_OVER_M, 0.0, 1.0)
        return np.asarray(high * share * share * (3 - 2 * share) * np.clip(0.55 + 0.34 * total, 0.0, None))

    def ground(self, x: Array, y: Array) -> Array:
        """Height of the land [m] with its hills."""
        return self.height(x, y) + self.relief(x, y, self.away(x, y))

    # -- fields

    @cached_property
    def borders(self) -> tuple[Array, Array]:
        """Where fields end, along x and along y [m]."""
        rng = stream(self.seed, "horizon", "fields")
        along_x, along_y = (np.cumsum(rng.uniform(60, 230, 50)) - 0.5 * 50 * 145 for _ in range(2))
        return along_x, along_y

    @cached_property
    def _crops(self) -> Index:
        rng = stream(self.seed, "horizon", "crops")
        return np.asarray(rng.choice(len(CROPS), (51, 51), p=SHARES[self.kind]))

    def crop(self, x: Array, y: Array) -> Index:
        """Index in CROPS of what grows at places beyond NEAR_M."""
        across, along = self.borders
        return np.asarray(self._crops[np.searchsorted(across, x), np.searchsorted(along, y)])

    def snapped(self, axis: Array, number: int) -> Array:
        """A net's coordinates with those nearest to borders moved there, so that fields end in straight lines."""
        axis = axis.copy()
        for border in self.borders[number]:
            if axis[0] < border < axis[-1]:
                k = int(np.argmin(np.abs(axis - border)))
                room = np.diff(axis)[max(k - 1, 0) : k + 1].min()
                if abs(axis[k] - border) < 0.6 * room and 0 < k < len(axis) - 1:
                    axis[k] = np.clip(border, axis[k - 1] + 0.2 * room, axis[k + 1] - 0.2 * room)
        return axis

    def sown(self, part: Part, normals: Array | None = None, keep: npt.NDArray[np.bool_] | None = None) -> list[Part]:
        """Grass with its fields in other materials.

        Args:
            part: triangles of a net; where it is a `strip`, both of a cell bear the same.
            normals: (N, 3) of its points, which fields wear.
            keep: of its faces; the others are left out.
        """
        faces, half = part.faces, len(part.faces) // 2
        middle = part.points[faces][..., :2].mean(axis=1)
        if 2 * half == len(faces) and (faces[:half, [0, 2]] == faces[half:, [0, 1]]).all():
            middle = np.tile((middle[:half] + middle[half:]) / 2, (2, 1))
        kind = np.where(self.away(*middle.T) < NEAR_M, -1, self.crop(*middle.T))
        parts = []
        for number in range(-1, len(CROPS)):
            used, corners = np.unique(faces[(kind == number) & (True if keep is None else keep)], return_inverse=True)
            if not len(used):
                continue
            corners = corners.reshape(-1, 3)
            if number < 0:
                parts.append(
                    Part(part.points[used], corners, part.material, None if part.uv is None else part.uv[used])
                )
            else:
                shine = None if normals is None else normals[used]
                parts.append(Part(part.points[used], corners, CROPS[number], None, shine))
        return parts

    # -- what stands there

    def scatters(self) -> list[Scatter]:
        """Woods and hedgerows, houses, and what stands out against the sky."""
        return [scatter for scatter in (*self._plants(), *self._houses(), *self._skyline()) if len(scatter.points)]

    def _there(self, places: Array, least_m: float) -> tuple[Array, Index]:
        """(N, 3) on the ground of those of (M, 2) places that are farther than that from the road, and which these
        are.
        """
        x, y = places.T
        dry = True if self.flooded is None else ~self.flooded(x, y)
        keep = np.flatnonzero((self.away(x, y) > least_m) & dry)
        return np.c_[x[keep], y[keep], self.ground(x[keep], y[keep])], keep

    def _plants(self) -> list[Scatter]:
        rng = stream(self.seed, "horizon", "plants")
        places, sizes = [], []
        across, along = self.borders
        near = [np.flatnonzero(np.abs(line[:-1] + np.diff(line) / 2) < 1000) for line in (across, along)]
        for i in near[0]:
            for j in near[1]:
                (x0, x1), (y0, y1) = across[i : i + 2], along[j : j + 2]
                if CROPS[self._crops[i + 1, j + 1]] == "field_wood":
                    far = float(self.away(np.array([(x0 + x1) / 2]), np.array([(y0 + y1) / 2]))[0])
                    n = int(min((x1 - x0) * (y1 - y0) / (90 if far < 500 else 220), 110))
                    places.append(np.c_[rng.uniform(x0 - 6, x1 + 6, n), rng.uniform(y0 - 6, y1 + 6, n)])
                    sizes.append(rng.uniform(0.75, 1.2, n))
                for vertical in (True, False):  # a row of bushes and trees along a border
                    if rng.random() < (0.30 if self.kind == "country" else 0.18):
                        length = (y1 - y0) if vertical else (x1 - x0)
                        s = np.cumsum(rng.uniform(2.5, 15, int(length / 8)))
                        s = s[s < length]
                        off = rng.normal(0, 0.8, len(s))
                        places.append(np.c_[x0 + off, y0 + s] if vertical else np.c_[x0 + s, y0 + off])
                        sizes.append(np.where(rng.random(len(s)) < 0.7, rng.uniform(0.2, 0.45, len(s)), 0.85))
        if not places:
            return []
        p, size = np.concatenate(places), np.concatenate(sizes)
        points, keep = self._there(p, NEAR_M + 20.0)
        size = size[keep]
        keep = rng.permutation(len(points))[:1400]
        models = mixture(self.seed, "distant")
        points[:, 2] -= 0.3 + 1.2 * (size < 0.5)  # bushes are the tops of trees
        return [
            Scatter(
                "Far_Trees",
                "vegetation",
                (),
                points[keep],
                rng.uniform(0, 360, len(keep)),
                size[keep],
                models,
                rng.integers(len(models), size=len(keep)),
            )
        ]

    def _houses(self) -> list[Scatter]:
        """A town in rows, or two or three villages in the country."""
        rng = stream(self.seed, "horizon", "houses")
        x, y, heading = self.ahead
        if self.kind == "town":
            a, b = np.meshgrid(np.arange(-900, 901, 15.5), np.arange(-700, 1101, 46.0), indexing="ij")
            a, b = a + rng.normal(0, 0.6, a.shape), b + np.where(rng.random(a.shape) < 0.5, -8.0, 8.0)
            turned = np.deg2rad(heading + rng.uniform(-12, 12))
            p = np.c_[a.ravel(), b.ravel()]
            p = p[(rng.random(len(p)) < 0.8) & (np.hypot(*p.T) < 1000)]
            p = p @ np.array([[np.cos(turned), np.sin(turned)], [-np.sin(turned), np.cos(turned)]]) + [x, y]
            facing, most = np.degrees(turned) + 90.0 * rng.integers(0, 4, len(p)), 620
        else:
            groups = []
            for _ in range(int(rng.integers(2, 5))):
                away, aside = rng.uniform(300, 1100), np.deg2rad(heading + rng.uniform(-60, 60))
                middle = np.array([x - away * np.sin(aside), y + away * np.cos(aside)])
                groups.append(middle + rng.normal(0, (70, 45), (int(rng.integers(9, 34)), 2)))
            p = np.concatenate(groups)
            facing, most = rng.uniform(0, 360, len(p)), 120
        points, keep = self._there(p, NEAR_M)
        facing = facing[keep]
        order = np.argsort(np.hypot(points[:, 0] - x, points[:, 1] - y), kind="stable")[:most]
        points, facing = points[order], facing[order]
        which = rng.integers(0, len(HOUSES), len(points))
        return [
            Scatter(
                f"Far_Houses_{number + 1}",
                "building",
                _house(*HOUSES[number], town=self.kind == "town"),
                points[which == number] - [0, 0, 0.5],
                facing[which == number],
                rng.uniform(0.88, 1.15, int((which == number).sum())),
            )
            for number in range(len(HOUSES))
        ]

    def _skyline(self) -> list[Scatter]:
        """One to three of: a church, a line of pylons, turbines, a chimney, blocks of flats."""
        rng = stream(self.seed, "horizon", "skyline")
        x, y, heading = self.ahead
        chance = {"church": 0.6, "pylons": 0.45, "turbines": 0.35, "chimney": 0.25, "blocks": 0.15}
        if self.kind == "town":
            chance = {"church": 0.6, "pylons": 0.15, "turbines": 0.1, "chimney": 0.5, "blocks": 0.7}
        scatters = []
        for name, share in chance.items():
            there, away, aside = rng.random() < share, rng.uniform(420, 1050), rng.uniform(-26, 26)
            along, n = rng.uniform(0, np.pi), int(rng.integers(3, 7))
            if not there:
                continue
            angle = np.deg2rad(heading + aside)
            middle = np.array([x - away * np.sin(angle), y + away * np.cos(angle)])
            n, step = {"church": (1, 0.0), "chimney": (1, 0.0), "pylons": (n + 3, 240.0), "turbines": (n, 330.0)}.get(
                name, (n, 70.0)
            )
            s = (np.arange(n) - (n - 1) / 2) * step
            p = middle + np.c_[s * np.cos(along), s * np.sin(along)] + rng.normal(0, 0.08 * step + 1e-6, (n, 2))
            points, _ = self._there(p, 160.0)
            turns = np.full(len(points), np.degrees(along))
            if name in ("church", "blocks"):
                turns = rng.uniform(0, 360, len(points))
            sizes = np.ones(len(points)) * (rng.uniform(0.9, 1.3) if name != "church" else 1.0)
            if name == "church":
                scatters.append(
                    Scatter(
                        "Far_Church",
                        "building",
                        (),
                        points,
                        turns,
                        sizes,
                        (("church", {}),),
                        np.zeros(len(points), int),
                    )
                )
            else:
                label = "building" if name in ("blocks", "chimney") else "pole"
                points[:, 2] -= 0.5
                scatters.append(Scatter(f"Far_{name.title()}", label, MADE[name](), points, turns, sizes))
        return scatters


HOUSES = (
    ("far_cream", "far_tile", 10.0, 9.0, 2),
    ("far_white", "far_tile", 12.0, 9.5, 2),
    ("far_brick", "far_slate", 11.0, 9.0, 2),
    ("far_white", "far_slate", 13.0, 10.0, 3),
    ("far_brick", "far_tile", 15.0, 10.5, 3),
    ("far_grey", "far_tile", 9.0, 8.5, 2),
)
"""Wall, roof, width and depth [m], storeys."""
MADE: dict[str, Callable[[], tuple[Part, ...]]] = {}


def _panes(width: float, depth: float, floors: int, floor_m: float, foot_m: float) -> list[Part]:
    """Windows on all four sides, a hand's breadth before the wall: each on a pale frame, with a bar down its middle,
    two of five with a blind let down behind it; and a door in the front.
    """
    rng = stream(0, "horizon", "panes", round(100 * width), floors)
    panes: dict[str, list[Array]] = {"far_frame": [], "far_window": [], "far_blind": [], "far_door": []}

    def put(material: str, side: int, u: tuple[float, float], v: tuple[float, float], out: float) -> None:
        off = -(depth if side % 2 == 0 else width) / 2 - out
        corners = np.array([(u[0], off, v[0]), (u[1], off, v[0]), (u[1], off, v[1]), (u[0], off, v[1])])
        panes[material].append(corners @ turn(90.0 * side)[:3, :3].T)

    for side in range(4):
        long = width if side % 2 == 0 else depth
        n = max(2, round(long / 2.9))
        for k in range(n):
            u = (k + 0.5) / n * long - long / 2
            for floor in range(floors):
                v = foot_m + floor * floor_m + 0.95
                if (side, k, floor) == (2, n // 2, 0):
                    put("far_door", side, (u - 0.55, u + 0.55), (foot_m - 0.3, foot_m + 2.0), 0.05)
                    continue
                put("far_frame", side, (u - 0.68, u + 0.68), (v - 0.13, v + 1.48), 0.02)
                put("far_window", side, (u - 0.55, u + 0.55), (v, v + 1.35), 0.05)
                if rng.random() < 0.4:
                    put("far_blind", side, (u - 0.55, u + 0.55), (v + rng.uniform(0.2, 1.0), v + 1.35), 0.06)
                put("far_frame", side, (u - 0.05, u + 0.05), (v, v + 1.35), 0.07)
    return [quads(np.array(corners), material) for material, corners in panes.items()]


def _house(wall: str, roof: str, width: float, depth: float, floors: int, *, town: bool) -> tuple[Part, ...]:
    """A gabled house seen from beyond NEAR_M, about 300 triangles."""
    floors = floors + town
    top, eaves, half = 0.6 + 2.9 * floors, 0.5, depth / 2
    ridge = top + 0.42 * depth
    x, e = width / 2, eaves
    parts = [box((-x, -half, -1.5), (x, half, top), wall, bottom=False)]
    drop = 0.84 * e
    for side in (-1, 1):
        parts.append(Part(np.array([(side * x, -half, top), (side * x, half, top), (side * x, 0, ridge)])[:: side],
                          np.array([[0, 1, 2]]), wall))  # fmt: skip
        slope = [(-side * (x + 0.3), side * (half + e), top - drop), (side * (x + 0.3), side * (half + e), top - drop),
                 (side * (x + 0.3), 0, ridge), (-side * (x + 0.3), 0, ridge)]  # fmt: skip
        parts += [quad(slope[::-1], roof), quad(np.array(slope) - [0, 0, 0.12], roof)]
    parts.append(box((0.25 * width - 0.4, 0.6, top), (0.25 * width + 0.4, 1.3, ridge + 0.9), "far_brick", bottom=False))
    return tuple(by_material([*parts, *_panes(width, depth, floors, 2.9, 0.6)]).values())


def _blocks() -> tuple[Part, ...]:
    """A block of flats of nine storeys."""
    body = box((-16, -7, -2), (16, 7, 27.5), "far_grey", bottom=False)
    hut = box((-4, -3, 27.5), (4, 3, 30.5), "far_grey", bottom=False)
    return tuple(by_material([body, hut, *_panes(32.0, 14.0, 9, 2.9, 0.9)]).values())


def _chimney() -> tuple[Part, ...]:
    """A works' chimney 75 m high with three red bands, and its hall."""
    z = np.array([-1.0, 50.0, 55.0, 60.0, 65.0, 70.0, 75.0])
    r = 3.4 - 1.7 * np.clip(z, 0, None) / 75.0
    parts = [
        tube([(0, 0, z[k]), (0, 0, z[k + 1])], [r[k], r[k + 1]], "far_red" if k % 2 else "far_grey", sides=14)
        for k in range(len(z) - 1)
    ]
    parts.append(box((8, -20, -1), (70, 14, 14), "far_grey", bottom=False))
    return tuple(by_material(parts).values())


def _pylons() -> tuple[Part, ...]:
    """A lattice mast 42 m high with two arms, which looks along +X; and the wires to the next."""
    parts: list[Part] = []
    levels = [(0.0, 3.2), (9.0, 2.4), (18.0, 1.7), (27.0, 1.1), (35.0, 0.7), (42.0, 0.25)]
    corners = [(1, 1), (-1, 1), (-1, -1), (1, -1)]
    for (z0, r0), (z1, r1) in itertools.pairwise(levels):
        for k, (a, b) in enumerate(corners):
            c, d = corners[(k + 1) % 4]
            parts.append(tube([(a * r0, b * r0, z0), (a * r1, b * r1, z1)], 0.13, "far_steel", sides=4))
            parts.append(tube([(a * r0, b * r0, z0), (c * r1, d * r1, z1)], 0.07, "far_steel", sides=3))
            parts.append(tube([(c * r0, d * r0, z0), (a * r1, b * r1, z1)], 0.07, "far_steel", sides=3))
    for z, reach in ((27.0, 9.0), (35.0, 6.0)):
        for side in (-1, 1):
            parts.append(tube([(0, side * 0.8, z), (0, side * reach, z + 0.4)], [0.2, 0.1], "far_steel", sides=4))
            parts.append(tube([(0, side * 0.8, z + 2.2), (0, side * reach, z + 0.4)], 0.1, "far_steel", sides=4))
            x = np.linspace(0, 240.0, 11)
            sag = z - 1.8 - 9.0 * (1 - (2 * x / 240.0 - 1) ** 2)
            parts.append(tube(np.c_[x, np.full(11, side * reach), sag], 0.03, "far_steel", sides=3, capped=False))
    return tuple(by_material(parts).values())


def _turbines() -> tuple[Part, ...]:
    """A wind turbine: hub at 95 m, blades of 45 m, turned by chance of the prototype once for all."""
    parts = [tube([(0, 0, -1), (0, 0, 95)], [2.1, 1.2], "far_frame", sides=12)]
    parts.append(box((-1.6, -2.0, 93.6), (1.6, 5.0, 97.2), "far_frame"))
    for k in range(3):
        blade = tube([(0, -3, 1.0), (0.4, -3, 9.0), (0, -3, 45.0)], [0.9, 1.5, 0.12], "far_frame", sides=6)
        parts.append(blade.moved(shift(0, 0, 95.4) @ turn(17.0 + 120.0 * k, "y")))
    return (join(parts),)


MADE.update(blocks=_blocks, chimney=_chimney, pylons=_pylons, turbines=_turbines)
