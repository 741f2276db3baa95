"""A `WorldSpec` as a USD stage, whatever road or junction it stands at: meshes of the road and its land, references,
lights, fog, variants.

A scope for each kind of thing: /World/Road, Buildings, Plants and Furniture, Vehicles and
People, Lights and Sky, Fog, Ego and Rig.  It opens in plain OpenUSD.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Gf, Kind, Sdf, Usd, UsdGeom, UsdShade, Vt

from synfog_usd.base.arrays import Array
from synfog_usd.base.seeds import stream
from synfog_usd.fog import Fog
from synfog_usd.world import authoring, lamps
from synfog_usd.world.components import author_material, author_mesh, label, new_stage
from synfog_usd.world.library import model, nominal
from synfog_usd.world.materials import PALETTE, Material
from synfog_usd.world.roads import asphalt, crossing_built, horizon, road_built, roundabout_built, spray, water
from synfog_usd.world.roads.crossing import Crossing
from synfog_usd.world.roads.network import Road
from synfog_usd.world.roads.roundabout import Roundabout
from synfog_usd.world.roads.structures import Built, LitPanes
from synfog_usd.world.shapes import Part, by_material, quads, shift, turn
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
    **horizon.LOOKS,
}
"""Materials of what only roads have; tunnel lamps of 9 000 cd m-2, as LED luminaires of tunnels have."""
LIT_LOOK = {"window": ("Windows", "windows_lit.jpg", 55.0), "shop_glass": ("Shops", "shops_lit.jpg", 160.0)}
KINDS: Mapping[type, Any] = {Road: road_built, Roundabout: roundabout_built, Crossing: crossing_built}
"""What a road or junction is -> the module that says what is made for it alone."""
LANES, LANE_TYPE = "/World/Lanes", "synfog:lane:type"
DRY = "/World/Road/Dry"
"""Where the materials of a road are that rain changes: a variant is stronger than what a stage refers to."""


def author(path: Path, spec: WorldSpec, *, assets: str) -> Sdf.Layer:
    """The stage of a world as one layer, not yet saved.

    Args:
        path: the file; its suffix chooses the format.
        spec: what stands where.
        assets: where the shipped assets lie, from the stage's folder or from the root.
    """
    layer = _without_placements(path, spec, assets)
    authoring.author_placements(layer, spec.placed, assets)
    return layer


def _without_placements(path: Path, spec: WorldSpec, assets: str) -> Sdf.Layer:
    """All but the components in their places, which no open stage need compose."""
    stage = new_stage(spec.about, path)
    stage.GetRootLayer().customLayerData = {**stage.GetRootLayer().customLayerData, **spec.origin}
    stage.SetMetadata("renderSettingsPrimPath", "/Render/Settings")
    world = UsdGeom.Xform.Define(stage, "/World").GetPrim()
    stage.SetDefaultPrim(world)
    Usd.ModelAPI(world).SetKind(Kind.Tokens.assembly)
    authoring.author_camera(stage, spec.view)
    authoring.author_rig(stage, spec)
    authoring.author_fog(stage, spec.wind_m_s)
    authoring.author_skies(stage, spec, assets)
    for group in dict.fromkeys(p.group for p in spec.placed):
        Usd.ModelAPI(UsdGeom.Xform.Define(stage, f"/World/{group}").GetPrim()).SetKind(Kind.Tokens.group)
    kind = KINDS[type(spec.road)]
    for many in kind.instanced(spec, spec.road):
        authoring.author_instancer(stage, many.path, many.asset, many.label, many.points, many.turns, assets)
    _author_lights(stage, spec, assets)
    authoring.author_variants(stage, spec)  # early: each choice of a variant composes again what stands there
    author_lanes(stage, spec)
    _author_built(stage, spec, assets)
    for variant, fog in spec.falls.items():
        if "rain" in fog.rates:
            _author_wet(stage, spec, variant, fog, assets)
    authoring.author_render(stage)
    if spec.products:
        authoring.author_products(stage, [authoring.EGO, *(f"{authoring.RIG}/{eye.name}" for eye in spec.rig)])
    return Sdf.Layer.FindOrOpen(stage.GetRootLayer().identifier)  # a stage's own hold on it ends with the stage


def built(spec: WorldSpec) -> list[Built]:
    """Everything that is made for this world alone, by name."""
    return list(KINDS[type(spec.road)].built(spec, spec.road))


def _author_built(stage: Usd.Stage, spec: WorldSpec, assets: str) -> None:
    kind = KINDS[type(spec.road)]
    solid, sown = built(spec), [s for s in kind.scatters(spec, spec.road) if s is not None and len(s.points)]
    if not solid and not sown:
        return
    root = UsdGeom.Xform.Define(stage, "/World/Road").GetPrim()
    Usd.ModelAPI(root).SetKind(Kind.Tokens.group)
    materials = Sdf.Path("/World/Road/Materials")
    UsdGeom.Scope.Define(stage, materials)
    authored: dict[str, UsdShade.Material] = {}
    paved = asphalt.looks(spec.built["asphalt"], LOOKS)

    rain = any("rain" in fog.rates for fog in spec.falls.values())

    def bind(prim: Usd.Prim, name: str) -> None:
        if name not in authored:
            look, path = paved.get(name) or LOOKS.get(name) or PALETTE[name], materials.AppendChild(name)
            if rain and name in asphalt.RAINED_ON:
                author_material(stage, Sdf.Path(f"{DRY}/{name}"), look, textures=f"{assets}/textures/")
                authored[name] = UsdShade.Material.Define(stage, path)
                authored[name].GetPrim().GetReferences().AddInternalReference(f"{DRY}/{name}")
            else:
                authored[name] = author_material(stage, path, look, textures=f"{assets}/textures/")
        UsdShade.MaterialBindingAPI.Apply(prim).Bind(authored[name])

    for structure in solid:
        prim = UsdGeom.Xform.Define(stage, f"/World/Road/{structure.name}").GetPrim()
        Usd.ModelAPI(prim).SetKind(Kind.Tokens.component)
        label(prim, structure.label)
        for name, part in by_material(structure.parts).items():
            bind(author_mesh(stage, prim.GetPath().AppendChild(name), _small(part)).GetPrim(), name)
    for scatter in sown:
        _author_scatter(stage, scatter, bind, assets)


def _author_wet(stage: Usd.Stage, spec: WorldSpec, variant: str, fog: Fog, assets: str) -> None:
    """A variant of the fog in which rain wets the road: its materials, which are stronger than the dry ones that the
    stage refers to, standing water, and spray.
    """
    rate_mm_h = fog.rates["rain"]
    kind, textures = KINDS[type(spec.road)], f"{assets}/textures/"
    paved: asphalt.Asphalt = spec.built.get("asphalt", asphalt.Asphalt())
    parts = by_material(kind.water(spec, spec.road, rate_mm_h))
    choices = stage.GetPrimAtPath("/World").GetVariantSets().GetVariantSet("fog")
    before = choices.GetVariantSelection()
    choices.SetVariantSelection(variant)
    with choices.GetVariantEditContext():
        wet = water.rained_on(paved, rate_mm_h, LOOKS, spec.road if isinstance(spec.road, Road) else None)
        for folder, names in kind.WET_MATERIALS.items():
            for name in names:
                if stage.GetPrimAtPath(f"{DRY}/{name}") or not folder.startswith("/World/Road"):
                    author_material(stage, Sdf.Path(f"{folder}/{name}"), wet[name], textures=textures)
        if parts:
            prim = UsdGeom.Xform.Define(stage, "/World/Road/Water").GetPrim()
            Usd.ModelAPI(prim).SetKind(Kind.Tokens.component)
            label(prim, "road")
            look = author_material(stage, Sdf.Path("/World/Road/Water/Look"), wet["puddle"], textures=textures)
            for name, part in parts.items():
                mesh = author_mesh(stage, prim.GetPath().AppendChild(name), _small(part)).GetPrim()
                UsdShade.MaterialBindingAPI.Apply(mesh).Bind(look)
        for number, cloud in enumerate(spray.clouds(spec.placed, spec.view, fog), 1):
            _author_spray(stage, Sdf.Path(spray.PATH.format(number)), spec, cloud, fog)
    choices.SetVariantSelection(before)


def spray_water(spec: WorldSpec, fog: Fog) -> float:
    """Depth of the water that wheels throw up in rain [m]."""
    paved: asphalt.Asphalt = spec.built.get("asphalt", asphalt.Asphalt())
    return water.film_m(paved, fog.rates["rain"], spec.road if isinstance(spec.road, Road) else None)


def _author_spray(stage: Usd.Stage, path: Sdf.Path, spec: WorldSpec, cloud: spray.Cloud, fog: Fog) -> None:
    """A ball of drops that scatter as rain's do, in what else is in the air."""
    ball, types, p = UsdGeom.Sphere.Define(stage, path), Sdf.ValueTypeNames, spec.placed[cloud.vehicle]
    ball.CreateRadiusAttr(1.0)
    ball.CreateExtentAttr(Vt.Vec3fArray([Gf.Vec3f(-1), Gf.Vec3f(1)]))
    ball.CreatePurposeAttr(UsdGeom.Tokens.guide)
    ball.AddTransformOp().Set(Gf.Matrix4d(np.round(cloud.to_world(p.x, p.y, p.z, p.heading, p.pitch).T, 5).tolist()))
    prim = ball.GetPrim()
    prim.AddAppliedSchema("SynFogMediumAPI")
    for name, kind, value in (
        ("medium:kind", types.Token, "rain"),
        ("fog:profile", types.Token, "exponential"),
        ("fog:scaleHeight", types.Float, cloud.half_m[2]),
        ("fog:sigma_t", types.Float, float(cloud.densest(p.speed_m_s or 0.0, spray_water(spec, fog)))),
        ("medium:also", types.String, spray.also(fog)),
    ):
        if value == "":
            continue
        varies = Sdf.VariabilityUniform if kind == types.Token else Sdf.VariabilityVarying
        prim.CreateAttribute(f"synfog:{name}", kind, False, varies).Set(value)


def author_lanes(stage: Usd.Stage, spec: WorldSpec) -> None:
    """Every lane as two guide curves, its left edge and its right one, along the way that is driven."""
    UsdGeom.Scope.Define(stage, LANES)
    for number, lane in enumerate(KINDS[type(spec.road)].edged_lanes(spec.road), 1):
        curves = UsdGeom.BasisCurves.Define(stage, f"{LANES}/Lane_{number:02d}")
        points = np.round(np.concatenate([lane.left, lane.right]), 3).astype(np.float32)
        curves.CreateTypeAttr(UsdGeom.Tokens.linear)
        curves.CreateCurveVertexCountsAttr([len(lane.left), len(lane.right)])
        curves.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
        curves.CreateWidthsAttr([0.1])
        curves.SetWidthsInterpolation(UsdGeom.Tokens.constant)
        curves.CreateExtentAttr(
            Vt.Vec3fArray.FromNumpy(np.stack([points.min(axis=0) - 0.05, points.max(axis=0) + 0.05]))
        )
        curves.CreatePurposeAttr(UsdGeom.Tokens.guide)
        kind = curves.GetPrim().CreateAttribute(LANE_TYPE, Sdf.ValueTypeNames.Token, True, Sdf.VariabilityUniform)
        kind.Set(lane.type)


def _small(part: Part) -> Part:
    """Coordinates to the millimetre, texture coordinates to a thousandth: less to store."""
    return replace(part, points=np.round(part.points, 4), uv=None if part.uv is None else np.round(part.uv, 3))


def _author_scatter(
    stage: Usd.Stage, scatter: horizon.Scatter, bind: Callable[[Usd.Prim, str], None], assets: str
) -> None:
    path = f"/World/Road/{scatter.name}"
    instancer = UsdGeom.PointInstancer.Define(stage, path)
    UsdGeom.Scope.Define(stage, f"{path}/Prototypes")
    n = len(scatter.points)
    which = np.zeros(n, dtype=np.int64) if scatter.which is None else scatter.which
    targets = []
    if scatter.parts:
        prototype = UsdGeom.Xform.Define(stage, f"{path}/Prototypes/One")
        for part in scatter.parts:
            mesh = author_mesh(stage, prototype.GetPath().AppendChild(part.material), part)
            bind(mesh.GetPrim(), part.material)
        targets.append(prototype.GetPath())
    for number, (asset, variants) in enumerate(scatter.models, 1):
        prim = stage.DefinePrim(f"{path}/Prototypes/{asset.title()}_{number}", "Xform")
        for name, choice in variants.items():
            prim.GetVariantSets().GetVariantSet(name).SetVariantSelection(choice)
        prim.GetReferences().AddReference(f"{assets}/models/{asset}/{asset}.usda")
        targets.append(prim.GetPath())
    instancer.CreatePrototypesRel().SetTargets(targets)
    instancer.CreateProtoIndicesAttr(Vt.IntArray.FromNumpy(which.astype(np.int32)))
    instancer.CreatePositionsAttr(Vt.Vec3fArray.FromNumpy(np.round(scatter.points, 3).astype(np.float32)))
    instancer.CreateOrientationsAttr(authoring.upright(scatter.turns))
    instancer.CreateScalesAttr(
        Vt.Vec3fArray.FromNumpy(np.repeat(np.round(scatter.sizes, 3)[:, None], 3, axis=1).astype(np.float32))
    )
    instancer.CreateExtentAttr(instancer.ComputeExtentAtTime(Usd.TimeCode.Default(), Usd.TimeCode.Default()))
    Usd.ModelAPI(instancer.GetPrim()).SetKind(Kind.Tokens.component)
    label(instancer.GetPrim(), scatter.label)


# -- lights


def headlights(view: View, ground: float) -> Iterable[tuple[str, Array]]:
    """Names and places of the dipped beams of the camera's own car, which goes the way that the camera looks."""
    place = shift(view.x, view.y, ground) @ turn(view.heading - view.yaw) @ turn(view.tilt - (90.0 + view.dip), "x")
    for name, x in (("Left", -0.62), ("Right", 0.72)):
        yield name, place @ shift(x, 1.75, 0.66) @ turn(90.0, "x")


@functools.cache
def panes(asset: str) -> Mapping[str, tuple[Array, Array]]:
    """Panes of a building by material: corners [m] (K, 4, 3) with texture coordinates."""
    by_name: dict[str, tuple[Array, Array]] = {}
    layer = Sdf.Layer.FindOrOpen(str(model(asset).path.with_suffix(".geo.usdc")))
    if layer is None:
        return by_name
    for name in LIT_LOOK:
        mesh = layer.GetPrimAtPath(f"/Geometry/{name}")
        if not mesh or "points" not in mesh.attributes or "primvars:st" not in mesh.attributes:
            continue
        points, st = (np.array(mesh.attributes[key].default, dtype=np.float64) for key in ("points", "primvars:st"))
        if len(points) % 4 == 0:
            by_name[name] = (points.reshape(-1, 4, 3), st.reshape(-1, 4, 2))
    return by_name


def _author_lights(stage: Usd.Stage, spec: WorldSpec, assets: str) -> None:
    """The camera's own headlights, and one mesh each of all lit windows and shops."""
    Usd.ModelAPI(UsdGeom.Xform.Define(stage, "/World/Lights").GetPrim()).SetKind(Kind.Tokens.group)
    UsdGeom.Scope.Define(stage, "/World/Lights/Headlights")
    ground, beams = float(spec.road.height(spec.view.x, spec.view.y)), spec.built["headlights"]
    for name, place in headlights(spec.view, ground) if beams != "off" else ():
        lamps.author_lamp(stage, f"/World/Lights/Headlights/{name}", beams, place, lamps=f"{assets}/lamps")
    lit = KINDS[type(spec.road)].PANES
    rng = stream(spec.scatter, lit.name, "lit")
    fronts: dict[str, list[tuple[Array, Array]]] = {name: [] for name in LIT_LOOK}
    for p in spec.placed:
        if p.group == "Buildings" and lit.near(p, spec.view):
            for name, front in _lit(p, lit, rng):
                fronts[name].append(front)
    materials = Sdf.Path("/World/Lights/Materials")
    for name, lit_panes in fronts.items():
        if not lit_panes:
            continue
        title, picture, nits = LIT_LOOK[name]
        UsdGeom.Scope.Define(stage, materials)
        corners, uv = (np.concatenate(arrays) for arrays in zip(*lit_panes, strict=True))
        part = quads(corners, title, uv)
        mesh = author_mesh(stage, Sdf.Path(f"/World/Lights/{title}"), part)
        look = Material((0.02, 0.02, 0.02), 0.05, emission=(nits, nits, nits), emission_texture=picture)
        material = author_material(stage, materials.AppendChild(title), look, textures=f"{assets}/textures/")
        UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
        label(mesh.GetPrim(), "building")


def _lit(p: Placement, panes_lit: LitPanes, rng: np.random.Generator) -> Sequence[tuple[str, tuple[Array, Array]]]:
    """Lit panes of one building, a hand's breadth of light before the glass."""
    result = []
    place = shift(p.x, p.y, p.z) @ turn(p.heading)
    for name, (corners, uv) in panes(p.asset).items():
        if panes_lit.facades and name == "window":  # those of the roof stand before them
            count = int(nominal()[p.asset]["facade_windows"])
            corners, uv = corners[-count:], uv[-count:]
        lit = rng.random(len(corners)) < panes_lit.shares[name]
        if not lit.any():
            continue
        front = corners[lit]
        normal = np.cross(front[:, 1] - front[:, 0], front[:, 2] - front[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        front = front + 0.008 * normal[:, None]
        result.append((name, (front @ place[:3, :3].T + place[:3, 3], uv[lit])))
    return result
