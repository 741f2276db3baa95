"""A road's `WorldSpec` as a USD stage: meshes of the road and its land, references, lights, fog, variants.

A scope for each kind of thing: /World/Road, Buildings, Plants and Furniture, Vehicles and
People, Lights and Sky, Fog, Ego and Rig; `departments.py` makes layers of them.  It opens in
plain OpenUSD.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from pxr import Gf, Kind, Sdf, Usd, UsdGeom, UsdShade, Vt

from synfog_usd.seeds import stream
from synfog_usd.world import authoring, lamps
from synfog_usd.world.components import author_material, author_mesh, label, new_stage
from synfog_usd.world.materials import PALETTE, Material
from synfog_usd.world.roads import asphalt, land, markings, roundabout_built, structures, surface, works
from synfog_usd.world.roads.network import Road
from synfog_usd.world.roads.roundabout import Roundabout
from synfog_usd.world.roads.rules import model
from synfog_usd.world.roads.structures import Built
from synfog_usd.world.shapes import Array, Part, by_material, quads, shift, turn
from synfog_usd.world.spec import Placement, View, WorldSpec

LOOKS: dict[str, Material] = {
    "post_white": Material((0.72, 0.72, 0.70), 0.5),
    "straw": Material((0.30, 0.25, 0.10), 0.8),
    "tunnel_dark": Material((0.004, 0.004, 0.004), 0.9),
    "tunnel_lamp": Material((0.6, 0.6, 0.6), 0.4, emission=(9000.0, 8200.0, 6900.0)),
    "board_blue": Material((0.012, 0.06, 0.27), 0.4),
    "board_white": Material((0.75, 0.75, 0.74), 0.4),
    **roundabout_built.LOOKS,
    **asphalt.LOOKS,
}
"""Materials of what only roads have; tunnel lamps of 9 000 cd m-2, as LED luminaires of tunnels have."""
LIT_SHARE = {"window": 0.34, "shop_glass": 0.85}
LIT_LOOK = {"window": ("Windows", "windows_lit.jpg", 55.0), "shop_glass": ("Shops", "shops_lit.jpg", 160.0)}
LIT_M = 170.0
"""How far windows are lit, from the camera."""
TUFTS_M = 45.0


def author(path: Path, spec: WorldSpec, *, assets: str) -> Sdf.Layer:
    """The stage of a road as one layer, not yet saved.

    Args:
        path: the file; its suffix chooses the format.
        spec: of a road.
        assets: where the shipped assets lie, from the stage's folder or from the root.
    """
    assert spec.road is not None
    stage = new_stage(spec.about, path)
    stage.GetRootLayer().customLayerData = {**stage.GetRootLayer().customLayerData, **spec.origin}
    stage.SetMetadata("renderSettingsPrimPath", "/Render/Settings")
    world = UsdGeom.Xform.Define(stage, "/World").GetPrim()
    stage.SetDefaultPrim(world)
    Usd.ModelAPI(world).SetKind(Kind.Tokens.assembly)
    authoring.author_camera(stage, spec.view)
    authoring.author_rig(stage, spec)
    authoring.author_fog(stage)
    authoring.author_skies(stage, spec, assets)
    for group in dict.fromkeys(p.group for p in spec.placed):
        Usd.ModelAPI(UsdGeom.Xform.Define(stage, f"/World/{group}").GetPrim()).SetKind(Kind.Tokens.group)
    _author_lights(stage, spec, assets)
    authoring.author_variants(stage, spec)  # early, because each choice of a variant composes what stands there by then again
    _author_road(stage, spec, spec.road, assets)
    authoring.author_render(stage)
    authoring.author_products(stage, [authoring.EGO, *(f"{authoring.RIG}/{one.name}" for one in spec.rig)])
    authoring.author_placements(stage, spec.placed, assets)
    return Sdf.Layer.FindOrOpen(stage.GetRootLayer().identifier)


def built(spec: WorldSpec) -> list[Built]:
    """Everything that is made for this road alone, by name."""
    road = spec.road
    assert road is not None
    if isinstance(road, Roundabout):
        return roundabout_built.built(spec, road)
    parts = surface.surface(road, seed=spec.scatter, asphalt=spec.built["asphalt"])
    names = {"road": "Carriageway", "sidewalk": "Pavement", "terrain": "Verges"}
    made = [Built(names[key], key, tuple(found)) for key, found in parts.items()]
    made.append(Built("Markings", "road", tuple(markings.markings(road))))
    made.append(Built("Land", "terrain", tuple(land.land(road))))
    rails = spec.built.get("rails", "none")
    end = road.reference_line.length if road.land.hill is None else road.land.hill[0] - 0.3
    if rails in ("outer", "all"):
        for t, side in ((_soft(road, -1), 1), (_soft(road, 1), -1)):
            made.append(structures.guard_rail(road, t, side, 0.0, end, f"Guard_Rail_{'Left' if side > 0 else 'Right'}"))
    if rails in ("median", "all"):
        for lane in road.lane_section.of("reserve"):
            for t, side, name in ((lane.low + 0.7, -1, "Against"), (lane.high - 0.7, 1, "Along")):
                made.append(structures.guard_rail(road, t, side, 0.0, end, f"Guard_Rail_{name}"))
    if spec.built.get("delineators") == "both":
        made += structures.delineators(road, 0.0, end)
    made += [structures.gantry(road, s, i + 1) for i, s in enumerate(spec.built.get("gantries", ()))]
    if spec.built.get("works"):
        made.append(works.built(road, spec.built["works"]))
    if road.land.valley:
        made += structures.bridge(road)
    if road.land.hill:
        made += structures.tunnel(road)
    return made


def _soft(road: Road, side: int) -> float:
    """Offset of a guard rail beside the carriageway: 0.6 m into the verge."""
    verges = [lane for lane in road.lane_section.of("verge") if lane.middle * side > 0]
    if not verges:
        return road.lane_section.high - 0.3 if side > 0 else road.lane_section.low + 0.3
    return verges[-1].low + 0.6 if side > 0 else verges[0].high - 0.6


def _author_road(stage: Usd.Stage, spec: WorldSpec, road: Road, assets: str) -> None:
    root = UsdGeom.Xform.Define(stage, "/World/Road").GetPrim()
    Usd.ModelAPI(root).SetKind(Kind.Tokens.group)
    materials = Sdf.Path("/World/Road/Materials")
    UsdGeom.Scope.Define(stage, materials)
    known: dict[str, UsdShade.Material] = {}
    made = asphalt.looks(spec.built["asphalt"], LOOKS)

    def bind(prim: Usd.Prim, name: str) -> None:
        if name not in known:
            look = made.get(name) or LOOKS.get(name) or PALETTE[name]
            known[name] = author_material(stage, materials.AppendChild(name), look, textures=f"{assets}/textures/")
        UsdShade.MaterialBindingAPI.Apply(prim).Bind(known[name])

    for thing in built(spec):
        prim = UsdGeom.Xform.Define(stage, f"/World/Road/{thing.name}").GetPrim()
        Usd.ModelAPI(prim).SetKind(Kind.Tokens.component)
        label(prim, thing.label)
        for name, part in by_material(thing.parts).items():
            bind(author_mesh(stage, prim.GetPath().AppendChild(name), _small(part)).GetPrim(), name)
    for scatter in scatters(spec, road):
        if scatter is not None and len(scatter.points):
            _author_scatter(stage, scatter, bind)


def scatters(spec: WorldSpec, road: Road) -> Sequence[land.Scatter | None]:
    """Woods far away, and tall grass where the camera is near."""
    if isinstance(road, Roundabout):
        return roundabout_built.scatters(spec, road)
    found: list[land.Scatter | None] = [land.wood(road, seed=spec.scatter, count=spec.built["trees"], nearest_m=spec.built["trees_from_m"])]
    station = spec.built["station"]
    if spec.built["grass"] == "tufts":
        found.append(land.tufts(road, seed=spec.scatter, low=station, high=station + TUFTS_M))
    return found


def _small(part: Part) -> Part:
    """Coordinates to the millimetre, texture coordinates to a thousandth: less to store."""
    return Part(np.round(part.points, 4), part.faces, part.material, None if part.uv is None else np.round(part.uv, 3), part.normals)


def _author_scatter(stage: Usd.Stage, scatter: land.Scatter, bind: object) -> None:
    path = f"/World/Road/{scatter.name}"
    instancer = UsdGeom.PointInstancer.Define(stage, path)
    UsdGeom.Scope.Define(stage, f"{path}/Prototypes")
    prototype = UsdGeom.Xform.Define(stage, f"{path}/Prototypes/One")
    for part in scatter.parts:
        mesh = author_mesh(stage, prototype.GetPath().AppendChild(part.material), part)
        bind(mesh.GetPrim(), part.material)  # type: ignore[operator]
    instancer.CreatePrototypesRel().SetTargets([prototype.GetPath()])
    n = len(scatter.points)
    instancer.CreateProtoIndicesAttr(Vt.IntArray([0] * n))
    instancer.CreatePositionsAttr(Vt.Vec3fArray.FromNumpy(np.round(scatter.points, 3).astype(np.float32)))
    half = np.deg2rad(scatter.turns) / 2
    instancer.CreateOrientationsAttr(Vt.QuathArray([Gf.Quath(float(c), 0, 0, float(s)) for c, s in zip(np.cos(half), np.sin(half), strict=True)]))
    instancer.CreateScalesAttr(Vt.Vec3fArray.FromNumpy(np.repeat(np.round(scatter.sizes, 3)[:, None], 3, axis=1).astype(np.float32)))
    instancer.CreateExtentAttr(instancer.ComputeExtentAtTime(Usd.TimeCode.Default(), Usd.TimeCode.Default()))
    Usd.ModelAPI(instancer.GetPrim()).SetKind(Kind.Tokens.component)
    label(instancer.GetPrim(), scatter.label)


# -- lights


def headlights(view: View, ground: float) -> Iterable[tuple[str, Array]]:
    """Names and places of the dipped beams of the camera's own car, which goes the way that the camera looks."""
    place = shift(view.x, view.y, ground) @ turn(view.heading - 0.8) @ turn(view.tilt - 90.6, "x")
    for name, x in (("Left", -0.62), ("Right", 0.72)):
        yield name, place @ shift(x, 1.75, 0.66) @ turn(90.0, "x")


@functools.cache
def panes(asset: str) -> Mapping[str, tuple[Array, Array]]:
    """Panes of a building by material: (K, 4, 3) corners [m] and (K, 4, 2) texture coordinates."""
    found: dict[str, tuple[Array, Array]] = {}
    layer = Sdf.Layer.FindOrOpen(str(model(asset).path.with_suffix(".geo.usdc")))
    if layer is None:
        return found
    for name in LIT_SHARE:
        mesh = layer.GetPrimAtPath(f"/Geometry/{name}")
        if not mesh or "points" not in mesh.attributes or "primvars:st" not in mesh.attributes:
            continue
        points, st = np.array(mesh.attributes["points"].default, dtype=np.float64), np.array(mesh.attributes["primvars:st"].default, dtype=np.float64)
        if len(points) % 4 == 0:
            found[name] = (points.reshape(-1, 4, 3), st.reshape(-1, 4, 2))
    return found


def _author_lights(stage: Usd.Stage, spec: WorldSpec, assets: str) -> None:
    """The camera's own headlights, and one mesh each of all lit windows and shops."""
    Usd.ModelAPI(UsdGeom.Xform.Define(stage, "/World/Lights").GetPrim()).SetKind(Kind.Tokens.group)
    UsdGeom.Scope.Define(stage, "/World/Lights/Headlights")
    assert spec.road is not None
    ground = float(spec.road.height(spec.view.x, spec.view.y))
    for name, place in headlights(spec.view, ground):
        lamps.author_lamp(stage, f"/World/Lights/Headlights/{name}", spec.built["headlights"], place, lamps=f"{assets}/lamps")
    rng = stream(spec.scatter, "roads", "lit")
    fronts: dict[str, list[tuple[Array, Array]]] = {name: [] for name in LIT_SHARE}
    for p in spec.placed:
        if p.group == "Buildings" and np.hypot(p.x - spec.view.x, p.y - spec.view.y) < LIT_M:
            for name, front in _lit(p, rng):
                fronts[name].append(front)
    materials = Sdf.Path("/World/Lights/Materials")
    for name, found in fronts.items():
        if not found:
            continue
        title, picture, nits = LIT_LOOK[name]
        UsdGeom.Scope.Define(stage, materials)
        part = quads(np.concatenate([corners for corners, _ in found]), title, np.concatenate([uv for _, uv in found]))
        mesh = author_mesh(stage, Sdf.Path(f"/World/Lights/{title}"), part)
        look = Material((0.02, 0.02, 0.02), 0.05, emission=(nits, nits, nits), emission_texture=picture)
        material = author_material(stage, materials.AppendChild(title), look, textures=f"{assets}/textures/")
        UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
        label(mesh.GetPrim(), "building")


def _lit(p: Placement, rng: np.random.Generator) -> Sequence[tuple[str, tuple[Array, Array]]]:
    """Lit panes of one building, a hand's breadth of light before the glass."""
    result = []
    place = shift(p.x, p.y, p.z) @ turn(p.heading)
    for name, (corners, uv) in panes(p.asset).items():
        lit = rng.random(len(corners)) < LIT_SHARE[name]
        if not lit.any():
            continue
        front = corners[lit]
        normal = np.cross(front[:, 1] - front[:, 0], front[:, 2] - front[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        front = front + 0.008 * normal[:, None]
        result.append((name, (front @ place[:3, :3].T + place[:3, 3], uv[lit])))
    return result
