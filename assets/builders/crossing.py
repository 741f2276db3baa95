"""The crossing of two city streets that ships: its models, and who drives and walks on `stages/crossroads.usda`.

Streets, houses, furniture and trees stand in `synfog_usd.world.roads.crossing_props`, which recipes share.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from assets.builders.buildings import HOUSES, build_church, build_houses, glazing
from assets.builders.crossing_ground import build_ground
from assets.builders.furniture import build_furniture
from assets.builders.people import build_bicycle, build_people, build_rider
from assets.builders.plants import build_hedge, build_leaf, build_trees
from assets.builders.vehicles import CARS, build_bus, build_cars, build_lorry
from synfog_usd.base.files import write_whole
from synfog_usd.base.seeds import stream
from synfog_usd.world.components import Component
from synfog_usd.world.lod import with_low
from synfog_usd.world.roads.crossing import TREE_X, Crossing
from synfog_usd.world.roads.crossing_props import (
    BUILT,
    VIEW,
    furniture,
    ground,
    houses,
    parked_bicycles,
    standing,
    trees,
)
from synfog_usd.world.roads.recipe import posed
from synfog_usd.world.roads.stage import author
from synfog_usd.world.spec import Placement, SkyDome, WorldSpec

OVERCAST_NITS, DUSK_NITS = 5000.0, 5.0
"""Luminance of its two skies at the zenith [cd m-2]."""
LOW_M = 50.0  # where 2 cm are half a pixel of the 1280 that the stage asks for


FOG_VARIANTS = {"clear": None, "mor600": 600.0, "mor300": 300.0, "mor150": 150.0}


def components() -> list[Component]:
    """Every component of the crossing; vehicles, people and trees with many triangles in two levels of detail."""
    pits = [(p.x, p.y) for p in trees() if abs(p.x) == TREE_X]
    solid = [
        with_low(c)
        for c in (
            *build_cars(),
            build_bus(),
            build_lorry(),
            *build_people(),
            build_rider(),
            build_bicycle(),
            *build_trees(),
        )
    ]
    return [
        *build_ground(pits),
        *build_houses(),
        build_church(),
        *solid,
        *build_furniture(),
        build_hedge(),
        build_leaf(),
    ]


def placements() -> list[Placement]:
    """Everything that stands in the streets; vehicles and people far from the camera in fewer triangles, people of a
    kind in different poses.
    """
    movable = [_coarser(p) for p in (*vehicles(), *posed(people(), stream(0, "recipe", "individuals")))]
    return [*ground(), *houses(), *movable, *furniture(), *trees()]


def _coarser(p: Placement) -> Placement:
    far = np.hypot(p.x - VIEW.x, p.y - VIEW.y) > LOW_M and p.asset != "bicycle"
    return replace(p, variants={**p.variants, "lod": "low"}) if far else p


def vehicles() -> list[Placement]:
    """Cars that drive (lamps on when it is dark) and cars that are parked."""
    placed: list[Placement] = []

    def put(asset: str, x: float, y: float, heading: float, paint: str, drives: bool = False) -> None:
        lit = {"lamps": "on" if y < 80 else "glow"} if drives else {}
        placed.append(
            standing(
                "Vehicles", f"{asset.title()}_{len(placed) + 1:02d}", asset, (x, y, heading), {"paint": paint}, lit
            )
        )

    put("hatchback", -1.80, 18.4, 180, "red", True)
    put("estate", -1.95, -22.6, 180, "silver", True)
    put("offroader", -1.72, 25.2, 180, "white", True)
    put("saloon", -1.85, 58.0, 180, "silver", True)
    put("van", -1.75, 104.0, 180, "white", True)
    put("estate", 1.80, 21.5, 0, "blue", True)
    put("saloon", 1.70, 46.0, 0, "black", True)
    put("hatchback", 1.78, 120.0, 0, "white", True)
    put("bus", -7.6, 2.15, 90, "red", True)
    put("saloon", 8.6, -2.05, -90, "grey", True)
    rng = stream(0, "crossroads", "parked")
    cars = ("hatchback", "saloon", "estate", "offroader", "hatchback", "estate")
    paints = ("white", "silver", "grey", "black", "blue", "red", "green", "sand", "grey", "silver", "black")
    parked = [
        ("hatchback", 4.52, -29.2, 0, "grey"),
        ("estate", 4.50, -23.3, 0, "green"),
        ("offroader", -4.50, -32.5, 180, "black"),
        ("van", -4.48, -25.6, 180, "blue"),
        ("saloon", 4.5, -41.0, 0, "silver"),
    ]
    parked += [
        ("lorry", -4.42, 35.5, 180, "white"),
        ("hatchback", -4.52, 22.6, 180, "sand"),
        ("saloon", 4.52, 23.0, 0, "white"),
        ("hatchback", 4.5, 28.9, 0, "red"),
        ("van", 4.48, 41.2, 0, "white"),
    ]
    taken = [(x, y) for _, x, y, _, _ in parked]
    for asset, x, y, heading, paint in parked:
        put(asset, x, y, heading, paint)
    for sx in (-1, 1):
        for y in np.arange(46.6 if sx > 0 else 29.0, 240.0, 5.8):
            if rng.random() < 0.26 or any(x * sx > 0 and abs(y - b) < 7.2 for x, b in taken):
                continue
            asset, paint = cars[int(rng.integers(0, len(cars)))], paints[int(rng.integers(0, len(paints)))]
            put(
                asset,
                round(sx * (4.5 + float(rng.normal(0, 0.05))), 3),
                round(float(y + rng.normal(0, 0.15)), 3),
                180.0 if sx < 0 else 0.0,
                paint,
            )
    return placed


def people() -> list[Placement]:
    """Who crosses, waits and walks, and the cyclist ahead."""
    rows = [
        ("man_walking", -1.5, -12.5, -88, "a"),
        ("woman_walking", 1.0, -13.3, 92, "b"),
        ("old_man", 4.3, -12.4, 94, "a"),
        ("child", -4.5, -13.0, -90, "a"),
        ("woman_walking", -5.1, -12.4, -92, "a"),
        ("man_waiting", 6.9, -10.2, 40, "a"),
        ("woman_phone", 7.4, -16.9, 80, "a"),
        ("student", 7.6, -22.5, 4, "a"),
        ("man_walking", 8.6, -18.9, 176, "b"),
        ("woman_walking", 8.2, -29.0, 184, "c"),
        ("student", -7.4, -21.8, 178, "b"),
        ("man_walking", -8.3, -26.0, -3, "c"),
        ("woman_phone", -7.2, -11.4, -110, "b"),
        ("man_waiting", -7.5, -10.1, -100, "b"),
        ("child", -8.0, -22.0, 176, "b"),
        ("woman_walking", -7.6, 11.8, 170, "a"),
        ("man_walking", 7.3, 12.6, 10, "a"),
        ("student", 2.2, 12.7, 88, "a"),
        ("woman_phone", 8.8, 19.5, 90, "a"),
        ("man_waiting", -8.9, 18.5, -80, "a"),
        ("old_man", -8.2, 30.0, 182, "b"),
        ("woman_walking", 8.0, 33.0, 3, "b"),
        ("man_walking", 8.7, 47.0, 181, "c"),
        ("student", -7.9, 52.0, 2, "b"),
        ("woman_walking", -8.6, 70.0, 178, "c"),
        ("man_walking", 8.1, 74.0, 0, "b"),
        ("woman_phone", 8.4, 96.0, 185, "b"),
        ("man_walking", -8.0, 110.0, 180, "a"),
        ("woman_walking", -1.5, 13.4, -90, "c"),
        ("man_walking", -11.8, -5.9, -85, "a"),
    ]
    placed = [
        standing("People", f"Person_{i + 1:02d}", asset, (x, y, heading), {"outfit": outfit})
        for i, (asset, x, y, heading, outfit) in enumerate(rows)
    ]
    for i, (x, y, heading, outfit, colour) in enumerate(
        [(2.75, -24.2, 1.0, "a", "teal"), (-2.3, 42.0, 180.0, "b", "black")]
    ):
        placed.append(standing("People", f"Rider_{i + 1}", "rider", (x, y, heading), {"outfit": outfit}))
        placed.append(standing("Vehicles", f"Bicycle_{i + 1}", "bicycle", (x, y, heading), {"colour": colour}))
    placed += parked_bicycles()
    return placed


def shipped() -> WorldSpec:
    """The one that ships."""
    return WorldSpec(
        about="A crossing of two city streets, by overcast noon or at dusk with lamps, in clear air or in fog.",
        placed=tuple(placements()),
        view=VIEW,
        fog=FOG_VARIANTS,
        fog_selected="mor300",
        day=SkyDome("overcast", OVERCAST_NITS),
        dusk=SkyDome("dusk", DUSK_NITS),
        road=Crossing(),
        built=BUILT,
        products=False,
    )


def write_stage(path: Path, spec: WorldSpec | None = None, *, assets: str = "../assets") -> Path:
    """Write a stage of the crossing.

    Args:
        path: the file; its suffix chooses the format.
        spec: what stands where; None is the one that ships.
        assets: where the shipped assets lie, from the stage's folder or from the root.
    """
    write_whole(path, lambda temporary: author(temporary, spec or shipped(), assets=assets).Save())
    return path


def nominal() -> dict[str, dict[str, Any]]:
    """What `assets/models/nominal.json` says: sizes that meshes do not show, as their makers mean them [m], panes
    of the facades, and rows of the picture of shops' names.
    """
    sizes: dict[str, dict[str, Any]] = {body.name: {"length_m": body.length} for body in CARS}
    sizes |= {"bus": {"length_m": 12.0}, "lorry": {"length_m": 7.2}}
    return sizes | {
        h.name: {"width_m": h.width, "depth_m": h.depth, "facade_windows": len(glazing(h).windows)}
        | ({"shops": h.shops} if h.shops else {})
        for h in HOUSES
    }
