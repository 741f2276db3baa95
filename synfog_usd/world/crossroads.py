"""The crossing of two city streets: its assets, and the stage that puts them in place.

`build(folder)` writes `assets/models`, `assets/textures`, `assets/skies` and
`stages/crossroads.usda` below a folder; the same code gives the same bytes.  From
a shell: `python -m synfog_usd.world.crossroads [folder]`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
from pxr import Kind, Sdf, Usd, UsdGeom, UsdShade

from synfog_usd.files import write_whole
from synfog_usd.seeds import stream
from synfog_usd.world.authoring import (
    author_camera,
    author_fog,
    author_instancer,
    author_placements,
    author_render,
    author_skies,
    author_variants,
)
from synfog_usd.world.buildings import HOUSES, build_church, build_houses, glazing
from synfog_usd.world.components import Component, MountedLamp, author_lamp, author_material, author_mesh, label, new_stage, write_component
from synfog_usd.world.furniture import build_furniture
from synfog_usd.world.lod import with_low
from synfog_usd.world.materials import Material
from synfog_usd.world.people import build_bicycle, build_people, build_rider
from synfog_usd.world.plants import build_hedge, build_leaf, build_trees
from synfog_usd.world.shapes import Array, Part, quads, shift, turn
from synfog_usd.world.sky import DUSK_NITS, OVERCAST_NITS, write_skies
from synfog_usd.world.spec import Placement, SkyDome, View, WorldSpec
from synfog_usd.world.street import CORNER, MAIN_HALF, NORTH, SIDE_HALF, TREE_X, WALL_X, WALL_Y, build_ground, ground_height
from synfog_usd.world.textures import write_textures
from synfog_usd.world.vehicles import build_bus, build_cars, build_lorry

VIEW = View(1.55, -37.0, 1.45)
LOW_M = 50.0  # where 2 cm are half a pixel of the 1280 that the stage asks for
FOG_VARIANTS = {"clear": None, "mor600": 600.0, "mor300": 300.0, "mor150": 150.0}


def build(folder: Path) -> Path:
    """Write all assets and the stage below `folder`; gives the stage."""
    models = folder / "assets" / "models"
    write_textures(folder / "assets" / "textures")
    write_skies(folder / "assets" / "skies")
    for component in components():
        write_component(component, models)
    return write_stage(folder / "stages" / "crossroads.usda")


def components() -> list[Component]:
    """Every component of the crossing; vehicles, people and trees with many triangles in two levels of detail."""
    pits = [(p.x, p.y) for p in trees() if abs(p.x) == TREE_X]
    solid = [with_low(c) for c in (*build_cars(), build_bus(), build_lorry(), *build_people(), build_rider(), build_bicycle(), *build_trees())]
    return [*build_ground(pits), *build_houses(), build_church(), *solid, *build_furniture(), build_hedge(), build_leaf()]


def placements() -> list[Placement]:
    """Everything that stands in the streets; vehicles and people far from the camera in fewer triangles."""
    movable = [_coarser(p) for p in (*vehicles(), *people())]
    return [*ground(), *houses(), *movable, *furniture(), *trees()]


def _coarser(p: Placement) -> Placement:
    far = np.hypot(p.x - VIEW.x, p.y - VIEW.y) > LOW_M and p.asset != "bicycle"
    return replace(p, variants={**p.variants, "lod": "low"}) if far else p


def ground() -> list[Placement]:
    """Road, pavements, land."""
    return [Placement("Ground", name.title(), f"street_{name}", 0, 0, z=0.0) for name in ("road", "pavement", "land")]


def houses() -> list[Placement]:
    """Both sides of both streets, corner houses first, and the church at the end."""
    width = {h.name: h.width for h in HOUSES}
    depth = {h.name: h.depth for h in HOUSES}
    base = 0.115
    placed: list[Placement] = []

    def put(asset: str, x: float, y: float, heading: float) -> None:
        placed.append(Placement("Buildings", f"House_{len(placed) + 1:02d}", asset, round(x, 3), round(y, 3), heading, z=base))

    ne, nw, se, sw = "corner_cream", "corner_brick", "corner_brick", "corner_green"
    put(ne, WALL_X + width[ne] / 2, WALL_Y, 180)
    put(nw, -WALL_X, WALL_Y + width[nw] / 2, -90)
    put(se, WALL_X, -WALL_Y - width[se] / 2, 90)
    put(sw, -WALL_X - width[sw] / 2, -WALL_Y, 0)
    rows = {
        (1, 1): ["house_ochre", "house_brick", "house_rose", "house_stone", "house_buff", "house_grey", "house_cream", "house_ochre", "house_white",
        "house_rose", "house_brick", "house_buff", "house_cream", "house_grey", "house_stone", "house_ochre", "house_rose"],
        (-1, 1): ["house_white", "house_buff", "house_cream", "house_grey", "house_rose", "house_brick", "house_ochre", "house_stone", "house_buff",
        "house_cream", "house_rose", "house_white", "house_brick", "house_grey", "house_ochre", "house_buff", "house_stone"],
        (1, -1): ["house_buff", "house_cream", "house_rose", "house_stone", "house_grey"],
        (-1, -1): ["house_rose", "house_brick", "house_ochre", "house_white", "house_cream"],
    }  # fmt: skip
    first = {(1, 1): depth[ne], (-1, 1): width[nw], (1, -1): width[se], (-1, -1): depth[sw]}
    for (sx, sy), names in rows.items():
        y = WALL_Y + first[sx, sy]
        for name in names:
            if y + width[name] > NORTH - 2:
                break
            put(name, sx * WALL_X, sy * (y + width[name] / 2), 90 * sx)
            y += width[name]
    side = {
        (1, 1): ["house_grey", "house_stone", "house_rose", "house_brick"], (-1, 1): ["house_cream", "house_ochre", "house_brick", "house_white"],
        (1, -1): ["house_white", "house_ochre", "house_cream", "house_buff"], (-1, -1): ["house_buff", "house_stone", "house_grey", "house_rose"],
    }  # fmt: skip
    first = {(1, 1): width[ne], (-1, 1): depth[nw], (1, -1): depth[se], (-1, -1): width[sw]}
    for (sx, sy), names in side.items():
        x = WALL_X + first[sx, sy]
        for name in names:
            put(name, sx * (x + width[name] / 2), sy * WALL_Y, 180 if sy > 0 else 0)
            x += width[name]
    placed.append(Placement("Buildings", "Church", "church", 6.5, NORTH + 58, 180, z=-0.04))
    return placed


def vehicles() -> list[Placement]:
    """Cars that drive (lamps on when it is dark) and cars that are parked."""
    placed: list[Placement] = []

    def put(asset: str, x: float, y: float, heading: float, paint: str, drives: bool = False) -> None:
        lit = {"lamps": "on" if y < 80 else "glow"} if drives else {}
        placed.append(Placement("Vehicles", f"{asset.title()}_{len(placed) + 1:02d}", asset, x, y, heading, {"paint": paint}, lit))

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
            put(asset, round(sx * (4.5 + float(rng.normal(0, 0.05))), 3), round(float(y + rng.normal(0, 0.15)), 3), 180.0 if sx < 0 else 0.0, paint)
    return placed


def people() -> list[Placement]:
    """Who crosses, waits and walks, and the cyclist ahead."""
    rows = [
        ("man_walking", -1.5, -12.5, -88, "a"), ("woman_walking", 1.0, -13.3, 92, "b"), ("old_man", 4.3, -12.4, 94, "a"), ("child", -4.5, -13.0, -90, "a"),
        ("woman_walking", -5.1, -12.4, -92, "a"),
        ("man_waiting", 6.9, -10.2, 40, "a"), ("woman_phone", 7.4, -16.9, 80, "a"), ("student", 7.6, -22.5, 4, "a"), ("man_walking", 8.6, -18.9, 176, "b"),
        ("woman_walking", 8.2, -29.0, 184, "c"),
        ("student", -7.4, -21.8, 178, "b"), ("man_walking", -8.3, -26.0, -3, "c"), ("woman_phone", -7.2, -11.4, -110, "b"), ("man_waiting", -7.5, -10.1, -100,
        "b"), ("child", -8.0, -22.0, 176, "b"),
        ("woman_walking", -7.6, 11.8, 170, "a"), ("man_walking", 7.3, 12.6, 10, "a"), ("student", 2.2, 12.7, 88, "a"), ("woman_phone", 8.8, 19.5, 90, "a"),
        ("man_waiting", -8.9, 18.5, -80, "a"),
        ("old_man", -8.2, 30.0, 182, "b"), ("woman_walking", 8.0, 33.0, 3, "b"), ("man_walking", 8.7, 47.0, 181, "c"), ("student", -7.9, 52.0, 2, "b"),
        ("woman_walking", -8.6, 70.0, 178, "c"),
        ("man_walking", 8.1, 74.0, 0, "b"), ("woman_phone", 8.4, 96.0, 185, "b"), ("man_walking", -8.0, 110.0, 180, "a"), ("woman_walking", -1.5, 13.4, -90,
        "c"), ("man_walking", -11.8, -5.9, -85, "a"),
    ]  # fmt: skip
    placed = [Placement("People", f"Person_{i + 1:02d}", asset, x, y, heading, {"outfit": outfit}) for i, (asset, x, y, heading, outfit) in enumerate(rows)]
    for i, (x, y, heading, outfit, colour) in enumerate([(2.75, -24.2, 1.0, "a", "teal"), (-2.3, 42.0, 180.0, "b", "black")]):
        placed.append(Placement("People", f"Rider_{i + 1}", "rider", x, y, heading, {"outfit": outfit}))
        placed.append(Placement("Vehicles", f"Bicycle_{i + 1}", "bicycle", x, y, heading, {"colour": colour}))
    for i, (x, y, heading, colour) in enumerate(
        [(9.2, -26.0, 85, "red"), (9.15, -25.15, 84, "black"), (-9.1, 14.0, -95, "teal"), (-9.2, 14.9, -91, "red"), (9.1, 39.6, 92, "black")]
    ):
        placed.append(Placement("Vehicles", f"Parked_Bicycle_{i + 1}", "bicycle", x, y, heading, {"colour": colour}))
    return placed


def furniture() -> list[Placement]:
    """Lamps, lights, signs, bins, benches."""
    placed: list[Placement] = []
    lamps = [
        (1, -47.0),
        (-1, -33.0),
        (1, -19.0),
        (-1, -17.6),
        (1, 17.6),
        (-1, 19.0),
        (1, 44.0),
        (-1, 46.5),
        (1, 72.0),
        (-1, 74.0),
        (1, 101.0),
        (-1, 103.0),
        (1, 131.0),
        (-1, 162.0),
    ]
    for i, (s, y) in enumerate(lamps):
        placed.append(Placement("Furniture", f"Lamp_{i + 1:02d}", "street_lamp", s * 6.05, y, 90 * s, {}, {"lamps": "on" if y < 80 else "glow"}))
    signals = [
        ("traffic_light_mast", 6.15, -16.2, 180, "red"),
        ("traffic_light", -6.1, 15.9, 0, "red"),
        ("traffic_light", 16.9, 4.95, -90, "green"),
        ("traffic_light", -16.9, -4.95, 90, "green"),
        ("traffic_light", -6.1, -16.0, 180, "red"),
    ]
    for i, (asset, x, y, heading, state) in enumerate(signals):
        placed.append(Placement("Furniture", f"Signal_{i + 1}", asset, x, y, heading, {"signal": state}, {"lamps": "on"}))
    others = [
        ("sign_crossing", 6.1, -14.9, 180), ("sign_limit", 6.05, -33.2, 180), ("sign_no_stopping", 6.05, -20.4, 180), ("sign_priority", 6.05, -27.3, 180),
        ("sign_street", 7.1, -9.0, 0), ("sign_street", -7.2, 9.1, 0),
        ("sign_crossing", -6.1, 14.9, 0), ("sign_parking", -6.05, -20.8, 0), ("sign_no_entry", 6.1, 16.2, 180), ("sign_parking", 6.05, 20.4, 180),
        ("sign_limit", -6.05, 41.5, 0), ("sign_ahead", 6.05, 59.0, 180), ("sign_no_stopping", 6.05, 86.0, 180),
        ("litter_bin", 6.5, -18.0, 0), ("litter_bin", -6.5, -15.2, 0), ("litter_bin", 6.6, 16.8, 0), ("litter_bin", -6.6, 28.5, 0), ("bench", 6.75, -22.6,
        -90), ("bench", -6.8, 24.5, 90), ("bench", 6.8, 54.0, -90),
        ("cabinet", 9.45, -17.8, 90), ("cabinet", -9.45, 27.4, -90), ("advertising_column", -8.0, -15.5, 30),
    ]  # fmt: skip
    placed += [Placement("Furniture", f"{asset.title()}_{i + 1:02d}", asset, x, y, heading) for i, (asset, x, y, heading) in enumerate(others)]
    return placed


def trees() -> list[Placement]:
    """Street trees in their pits, and the park at the end of the street."""
    rng, individuals = stream(0, "crossroads", "trees"), stream(0, "crossroads", "individuals")
    placed: list[Placement] = []
    kinds = ("lime_tree", "maple_tree", "lime_tree", "bare_tree")

    def put(asset: str, x: float, y: float, z: float | None = None) -> None:
        size = round(float(rng.uniform(0.88, 1.12)), 3)
        which = {"individual": "abc"[int(individuals.integers(3))]}
        placed.append(Placement("Plants", f"Tree_{len(placed) + 1:02d}", asset, x, y, round(float(rng.uniform(0, 360)), 1), which, z=z, size=size))

    for s, ys in ((1, [-53.0, -39.0, -25.2, 25.5, 37.0, 50.5, 64.0, 80.0, 93.0, 110.0, 124.0, 140.0, 156.0, 174.0, 192.0, 212.0, 235.0]), (-1, [-55.0, -41.0,
        -28.5, 31.5, 39.0, 55.0, 66.0, 83.0, 95.0, 111.0, 126.0, 143.0, 158.0, 178.0, 196.0, 215.0, 240.0])):  # fmt: skip
        for y in ys:
            put(kinds[int(rng.integers(0, 4))], s * TREE_X, y)
    for k in range(26):
        x = float(np.linspace(-75, 75, 26)[k] + rng.normal(0, 1.5))
        y = NORTH + 14 + float(rng.uniform(0, 30)) + (8 if abs(x) < 14 else 0)
        if abs(x - 6.5) < 8:
            continue
        put("park_tree", round(x, 2), round(y, 2), -0.04)
    for k, x in enumerate((-118, -128, -140, 118, 127, 141)):
        put("park_tree", float(x), (14.0, -13.0, 18.0)[k % 3], -0.04)
    for k, x in enumerate(np.arange(-28, 29, 8.0)):
        placed.append(Placement("Plants", f"Hedge_{k + 1}", "hedge", float(x), NORTH + 6.2, 0.0, z=-0.04))
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
    )


def write_stage(path: Path, spec: WorldSpec | None = None, *, assets: str = "../assets") -> Path:
    """Write a stage of the crossing.

    Args:
        path: the file; its suffix chooses the format.
        spec: what stands where; None is the one that ships.
        assets: where the shipped assets lie, from the stage's folder or from the root.
    """
    write_whole(path, lambda temporary: author_stage(temporary, spec or shipped(), assets=assets).Save())
    return path


def author_stage(path: Path, spec: WorldSpec, *, assets: str) -> Sdf.Layer:
    """The stage of `write_stage` as one layer, not yet saved."""
    stage = new_stage(spec.about, path)
    if spec.origin:
        stage.GetRootLayer().customLayerData = {**stage.GetRootLayer().customLayerData, **spec.origin}
    stage.SetMetadata("renderSettingsPrimPath", "/Render/Settings")
    world = UsdGeom.Xform.Define(stage, "/World").GetPrim()
    stage.SetDefaultPrim(world)
    Usd.ModelAPI(world).SetKind(Kind.Tokens.assembly)
    placed = spec.placed
    author_camera(stage, spec.view)
    author_fog(stage)
    author_skies(stage, spec, assets)
    for group in dict.fromkeys(p.group for p in placed):
        prim = UsdGeom.Xform.Define(stage, f"/World/{group}").GetPrim()
        Usd.ModelAPI(prim).SetKind(Kind.Tokens.group)
    _author_bollards(stage, assets)
    _author_leaves(stage, [p for p in placed if p.group == "Plants" and abs(p.x) == TREE_X and p.y < 60], spec.scatter, assets)
    _author_lights(stage, spec, assets)
    author_variants(stage, spec)
    author_render(stage)
    author_placements(stage, placed, assets)
    return Sdf.Layer.FindOrOpen(stage.GetRootLayer().identifier)


def _author_bollards(stage: Usd.Stage, assets: str) -> None:
    points = []
    angle = np.deg2rad(np.array([200, 212, 224, 236, 248]))
    for sx in (-1, 1):
        for sy in (-1, 1):
            radius = CORNER - 0.45
            points += [(sx * (MAIN_HALF + CORNER + radius * np.cos(a)), sy * (SIDE_HALF + CORNER + radius * np.sin(a)), 0.12) for a in angle]
        for y in (-31.0, -29.4, -27.8, 32.0, 33.6, 35.2):
            points.append((sx * 6.0, y, 0.12))
    author_instancer(stage, "/World/Furniture/Bollards", "bollard", "pole", np.array(points), np.zeros(len(points)), assets)


def _author_leaves(stage: Usd.Stage, below: Iterable[Placement], scatter: int, assets: str) -> None:
    rng = stream(scatter, "crossroads", "leaves")
    points, turns = [], []
    for tree in below:
        count = 55 if tree.y > -50 else 15
        for _ in range(count):
            x, y = tree.x + rng.normal(0, 1.5), tree.y + rng.normal(0, 2.6)
            if abs(x) > WALL_X - 0.15:
                continue
            if abs(x) < MAIN_HALF and rng.random() < 0.8:  # wind gathers them in the gutter
                x = np.sign(tree.x) * (MAIN_HALF - abs(rng.normal(0, 0.12)) - 0.04)
            if abs(abs(x) - MAIN_HALF) < 0.01:
                continue
            points.append((x, y, ground_height(x, y)))
            turns.append(rng.uniform(0, 360))
    author_instancer(stage, "/World/Plants/Fallen_Leaves", "fallen_leaf", "vegetation", np.array(points), np.array(turns), assets)


def _author_lights(stage: Usd.Stage, spec: WorldSpec, assets: str) -> None:
    """The ego car's headlights, and one mesh each of all lit windows and shops."""
    lights = UsdGeom.Xform.Define(stage, "/World/Lights")
    Usd.ModelAPI(lights.GetPrim()).SetKind(Kind.Tokens.group)
    UsdGeom.Scope.Define(stage, "/World/Lights/Headlights")
    for name, x in (("Left", spec.view.x - 0.62), ("Right", spec.view.x + 0.72)):
        lamp = MountedLamp(name, shift(x, spec.view.y + 1.75, 0.66) @ turn(90, "x"), beam="low_beam_led")
        author_lamp(stage, Sdf.Path(f"/World/Lights/Headlights/{name}"), lamp, lamps=f"{assets}/lamps")
    rng = stream(spec.scatter, "crossroads", "lit")
    panes: dict[str, list[tuple[Array, Array]]] = {"Windows": [], "Shops": []}
    homes = {h.name: glazing(h) for h in HOUSES}
    for p in (p for p in spec.placed if p.group == "Buildings"):
        if p.asset not in homes or p.y > 190 or p.y < -60:
            continue
        glass = homes[p.asset]
        place = shift(p.x, p.y, p.height) @ turn(p.heading)
        for name, corners, uv, share in (("Windows", glass.windows, glass.window_uv, 0.36), ("Shops", glass.shops, glass.shop_uv, 0.85)):
            lit = rng.random(len(corners)) < share
            if not lit.any():
                continue
            front = corners[lit]
            normal = np.cross(front[:, 1] - front[:, 0], front[:, 2] - front[:, 0])
            normal /= np.linalg.norm(normal, axis=1, keepdims=True)
            front = front + 0.008 * normal[:, None]
            panes[name].append((front @ place[:3, :3].T + place[:3, 3], uv[lit]))
    materials = Sdf.Path("/World/Lights/Materials")
    UsdGeom.Scope.Define(stage, materials)
    for name, picture, nits in (("Windows", "windows_lit.jpg", 55.0), ("Shops", "shops_lit.jpg", 160.0)):
        part: Part = quads(np.concatenate([c for c, _ in panes[name]]), name, np.concatenate([u for _, u in panes[name]]))
        mesh = author_mesh(stage, Sdf.Path(f"/World/Lights/{name}"), part)
        look = Material((0.02, 0.02, 0.02), 0.05, emission=(nits, nits, nits), emission_texture=picture)
        material = author_material(stage, materials.AppendChild(name), look, textures=f"{assets}/textures/")
        UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
        label(mesh.GetPrim(), "building")


if __name__ == "__main__":
    print(build(Path(sys.argv[1]) if len(sys.argv) > 1 else Path.cwd()))
