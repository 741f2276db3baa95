"""What would give a drawn street away: names that come twice, boards behind trees, gaps at a portal, bare meadows."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import shapely
from pxr import Usd, UsdGeom, UsdShade

from assets.builders.textures import FASCIA_COLUMNS, FASCIA_ROWS, fascia_words
from synfog_usd.world.compose import draw, load
from synfog_usd.world.library import library, nominal
from synfog_usd.world.roads import horizon, land, road_built, road_props, rules, structures
from synfog_usd.world.roads.lane_section import LaneSection
from synfog_usd.world.roads.network import Land, Road
from synfog_usd.world.roads.reference_line import ReferenceLine, bends
from synfog_usd.world.spec import Placement

RECIPES = Path(__file__).resolve().parents[2] / "stages" / "recipes"
NEAR_M = 100.0
"""Letters 27 cm high are three pixels there, of 1280 and a view of 55 degrees."""
MOTORWAY = [("verge", 4.0, 0), ("lane", 3.75, -1), ("lane", 3.75, 1), ("lane", 3.75, 1), ("verge", 4.0, 0)]


def words(asset: str, variant: str) -> list[str]:
    """Over the shops of a house, as its meshes and materials show them."""
    stage = Usd.Stage.CreateInMemory()
    prim = stage.DefinePrim("/House")
    prim.GetReferences().AddReference(str(library()[asset].path))
    prim.GetVariantSets().GetVariantSet("shops").SetVariantSelection(variant)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/House/Geometry/fascia"))
    st = np.array(UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st").Get()).reshape(-1, 4, 2).mean(axis=1)
    place = UsdShade.Shader(stage.GetPrimAtPath("/House/Materials/fascia/Place"))
    u, v = (st * place.GetInput("scale").Get() + place.GetInput("translation").Get()).T % 1.0
    columns, rows = (u * FASCIA_COLUMNS).astype(int), ((1.0 - v) * FASCIA_ROWS).astype(int)
    return [fascia_words()[j][i] for i, j in zip(rows, columns, strict=True)]


def test_the_picture_of_names_has_none_twice():
    every = [word for column in fascia_words() for word in column]
    assert len(set(every)) == len(every) == FASCIA_ROWS * FASCIA_COLUMNS


@pytest.mark.parametrize(("name", "least"), [("arterial", 25), ("crossroads", 25), ("residential", 1)])
def test_no_name_stands_over_two_shops_of_a_street(name, least):
    """Of four seeds: among houses within 100 m of the camera each name is read once, and rows of `nominal.json` are
    as many as the shops.
    """
    shown: dict[tuple[str, str], list[str]] = {}
    for seed in range(4):
        spec = draw(load(RECIPES / f"{name}.yaml"), seed=seed)
        read = []
        for p in spec.placed:
            if "shops" in p.variants and math.hypot(p.x - spec.view.x, p.y - spec.view.y) < NEAR_M:
                key = (p.asset, p.variants["shops"])
                shown[key] = shown.get(key) or sorted(
                    set(words(*key))
                )  # a shop at a corner bears its name to both streets
                assert len(shown[key]) == len(nominal()[p.asset]["shops"])
                read += shown[key]
        assert len(read) >= least
        assert len(set(read)) == len(read)


def test_no_tree_stands_before_a_board():
    """Spruces every 4 m beside a road with one board: none that is left meets a sight line to the board's middle from
    a lane within 100 m, and those behind it and across the road stay.
    """
    road = Road(ReferenceLine(400.0, bends([(150.0, 300.0, 20.0)], length=400.0)), LaneSection.from_widths(MOTORWAY))
    edge = road.lane_section.high

    def at(asset: str, s: float, t: float) -> Placement:
        x, y, z, heading, _ = road.pose(s, t)
        return Placement("", f"{asset}_{s}_{t}", asset, x, y, heading, z=z)

    board = at("sign_direction", 250.0, edge + 1.4)
    spruces = [at("conifer", s, t) for s in np.arange(60.0, 390.0, 4.0) for t in (edge + 3.0, edge + 9.0, -edge - 3.0)]
    left = road_props.unhidden(road, [board, *spruces], [])
    half = rules.model("conifer").width / 2
    crowns = shapely.union_all([shapely.Point(p.x, p.y).buffer(half) for p in left if p.asset == "conifer"])
    along = [lane.middle for lane in road.driving_lanes if lane.way > 0]
    looks = [
        shapely.LineString([np.array(road.reference_line.place(s, t)), (board.x, board.y)])
        for s in np.arange(150.0, 240.0, 1.0)
        for t in along
    ]
    ahead = shapely.Point(board.x, board.y).buffer(half + 0.5)  # a crown behind the board may reach round it
    assert not any(line.difference(ahead).intersects(crowns) for line in looks)
    gone = {p.name for p in spruces} - {p.name for p in left}
    assert 5 <= len(gone) < 40
    for p in spruces:
        s, t = (float(v) for v in road.reference_line.nearest(p.x, p.y))
        assert p.name not in gone or (100.0 < s < 251.0 and t > 0)


def first_hits(eye: np.ndarray, ways: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Distance along each of (N, 3) unit ways to the nearest of (K, 3, 3) triangles (Moller and Trumbore 1997)."""
    a, u, v = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    found = []
    for way in ways:
        p = np.cross(way, v)
        det = np.einsum("ij,ij->i", u, p)
        inverse = 1 / np.where(np.abs(det) > 1e-12, det, np.inf)
        s = eye - a
        q = np.cross(s, u)
        b, c, t = np.einsum("ij,ij->i", s, p) * inverse, q @ way * inverse, np.einsum("ij,ij->i", v, q) * inverse
        found.append(t[(b >= 0) & (c >= 0) & (b + c <= 1) & (t > 1e-6)].min(initial=np.inf))
    return np.array(found)


@pytest.mark.parametrize("turn_deg", [0.0, 14.0])
def test_beside_a_portal_one_sees_its_wall_or_the_slope_and_nothing_between(turn_deg):
    """Up to the top of the slopes and 6 m beyond the wall's ends no look passes the wall's plane by more than 30 cm:
    neither into the sky nor to an upright face of earth behind.
    """
    line = ReferenceLine(300.0, bends([(60.0, 400.0, turn_deg)], length=300.0))
    widths = [("pavement", 1.2, 0), ("lane", 3.6, -1), ("lane", 3.6, 1), ("pavement", 1.2, 0)]
    road = Road(line, LaneSection.from_widths(widths), Land(hill=(120.0, 16.0)))
    parts = [*land._beside(road), *(part for built in structures.tunnel(road) for part in built.parts)]
    triangles = np.concatenate([part.points[part.faces] for part in parts])
    eye = np.array([*np.ravel(line.place(80.0, 1.8)), 1.4])
    half, wide = road.lane_section.high, road.lane_section.high + structures.PORTAL_OUT_M
    t, h = np.meshgrid(
        np.linspace(-wide - 6.0, wide + 6.0, 61), np.linspace(0.3, structures.AT_PORTAL * 16.0 - 0.1, 30)
    )
    t, h = (grid[np.abs(t) > half + 0.6] for grid in (t, h))
    x, y = line.place(np.full(len(t), 120.0), t)
    ways = np.c_[x, y, h] - eye
    far = np.linalg.norm(ways, axis=1)
    assert (first_hits(eye, ways / far[:, None], triangles) < far + 0.3).all()


def test_a_shrub_is_leaves_round_its_core():
    """No leaf is larger than a hand, most stand outside the core, and some of the sky is seen between those at its
    edge.
    """
    core, *leaves = land.shrub()
    corners = np.concatenate([part.points[part.faces] for part in leaves])
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    assert area.max() < 0.005
    assert len(corners) > 800
    middle = corners.mean(axis=1)
    assert (np.hypot(*middle[:, :2].T) > np.hypot(*core.points[:, :2].T).max() * 0.8).mean() > 0.4
    drawn = shapely.union_all([shapely.Polygon(face[:, [0, 2]]) for face in corners if np.ptp(face[:, 0]) > 1e-6])
    assert drawn.area < 0.93 * drawn.convex_hull.area


def test_far_windows_differ():
    """Of the windows of each far house some have a blind, at several heights, and most have none; one door is
    in the front.
    """
    for wall, roof, width, depth, floors in horizon.HOUSES:
        parts = {part.material: part for part in horizon._house(wall, roof, width, depth, floors, town=True)}
        panes, blinds = (len(parts[name].faces) // 2 for name in ("far_window", "far_blind"))
        assert panes >= 10
        assert 0.15 * panes < blinds < 0.65 * panes
        lowest = parts["far_blind"].points[:, 2].reshape(-1, 4).min(axis=1) % 2.9
        assert np.ptp(lowest) > 0.4
        assert len(parts["far_door"].faces) == 2


def test_tall_grass_grows_on_the_land_and_not_in_houses():
    """On two country roads: on the ground, beyond what is mown, outside every building, in thousands."""
    for name in ("rural", "tunnel"):
        spec = draw(load(RECIPES / f"{name}.yaml"), seed=2)
        meadow = next(s for s in road_built.scatters(spec, spec.road) if s is not None and s.name == "Meadow")
        x, y, z = meadow.points.T
        assert len(x) > 1000
        np.testing.assert_allclose(
            spec.road.height(x, y) - 0.02, z, atol=0.05
        )  # the nearest station is found within 1 cm
        assert land.away(spec.road, x, y).min() > land.MOWN_M - 0.01
        for p in spec.placed:
            if p.group == "Buildings":
                outline = shapely.Polygon(rules.footprint(p))
                assert not shapely.contains_xy(outline, x, y).any()
