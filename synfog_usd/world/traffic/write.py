"""A clip as time samples of a stage: transforms, wheels, brake lights and indicators.

Takes a layer with the drawn street and the tracks of what moves in it.  What stands has no samples.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, Vt

from synfog_usd.base.arrays import Array, Flags
from synfog_usd.world import authoring
from synfog_usd.world.components import author_mesh
from synfog_usd.world.lamps import LAMPS, tint
from synfog_usd.world.roads import rules, stage
from synfog_usd.world.shapes import Part, shift
from synfog_usd.world.spec import Placement, View, WorldSpec
from synfog_usd.world.traffic.motion import Clip, Track
from synfog_usd.world.traffic.wheels import Wheels, sides_of, wheels_of

PARTS = "/World/Vehicles/Parts"
"""Wheels of each model that drives, for reference; abstract, so that nobody sees them."""
DARK = Gf.Vec3f(0.0)
INDICATORS = "amber"
"""Material of indicators."""
KINDS = Sdf.ValueTypeNames


def author(layer: Sdf.Layer, spec: WorldSpec, clip: Clip) -> None:
    """Put a street into motion.

    Args:
        layer: `roads.stage.author` made it of `spec`.
        spec: what stands where at frame 0.
        clip: of the same street.
    """
    layer.startTimeCode, layer.endTimeCode = 0.0, float(clip.codes[-2])
    layer.timeCodesPerSecond = layer.framesPerSecond = clip.fps
    for index, track in sorted(clip.tracks.items()):
        p = spec.placed[index]
        prim = layer.GetPrimAtPath(f"/World/{p.group}/{p.name}")
        _author_track(layer, prim, p, track, clip.codes)
        if p.group == "Vehicles":
            _author_wheels(layer, prim, p, track, clip.codes)
            _author_lamps(layer, prim, p, track, clip.codes)
    _author_cameras(layer, spec, clip)


# -- samples


def _sample(layer: Sdf.Layer, path: Sdf.Path, codes: Array, values: Sequence[Any]) -> None:
    """Values of an attribute at time codes; only those between which something changes, none where nothing does."""
    if all(value == values[0] for value in values):
        return
    last = len(values) - 1
    for k, (code, value) in enumerate(zip(codes, values, strict=True)):
        if value != values[max(k - 1, 0)] or value != values[min(k + 1, last)]:
            layer.SetTimeSample(path, float(code), value)


def _attribute(prim: Sdf.PrimSpec, name: str, kind: Sdf.ValueTypeName, default: Any = None) -> Sdf.Path:
    """An attribute of a prim in a layer, made where there is none."""
    spec = prim.attributes.get(name)
    if spec is None:
        spec = Sdf.AttributeSpec(prim, name, kind, declaresCustom=name == authoring.VELOCITY)
        if default is not None:
            spec.default = default
    return spec.path


def _order(prim: Sdf.PrimSpec, names: Sequence[str]) -> None:
    order = prim.attributes.get("xformOpOrder")
    order = order or Sdf.AttributeSpec(prim, "xformOpOrder", KINDS.TokenArray, Sdf.VariabilityUniform)
    order.default = Vt.TokenArray(names)


def _author_track(layer: Sdf.Layer, prim: Sdf.PrimSpec, p: Placement, track: Track, codes: Array) -> None:
    names = ["xformOp:translate"]
    places = np.round(np.stack([track.x, track.y, track.z], axis=1), 4)
    _sample(layer, prim.attributes[names[0]].path, codes, [Gf.Vec3d(*row) for row in places.tolist()])
    for axis, angle in (("Z", track.heading), ("X", track.pitch), ("Y", track.roll)):
        name, angles = f"xformOp:rotate{axis}", np.round(angle, 3)
        if name in prim.attributes or np.ptp(angles) > 0.0:
            names.append(name)
            _sample(layer, _attribute(prim, name, KINDS.Float, 0.0), codes, angles.tolist())
    if p.size != 1.0:
        names.append("xformOp:scale")
    _order(prim, names)
    if not track.shown.all():
        shown = ["inherited" if item else "invisible" for item in track.shown]
        _sample(layer, _attribute(prim, "visibility", KINDS.Token, "inherited"), codes, shown)
    if p.group == "Vehicles":
        h, up = np.radians(track.heading), np.radians(track.pitch)
        ahead = np.stack([-np.sin(h) * np.cos(up), np.cos(h) * np.cos(up), np.sin(up)], axis=1)
        velocity = np.round(track.speed[:, None] * ahead, 3) + 0.0
        still = Gf.Vec3f(*velocity[1].tolist())
        path = _attribute(prim, authoring.VELOCITY, KINDS.Vector3f, still)
        _sample(layer, path, codes, [Gf.Vec3f(*row) for row in velocity.tolist()])


# -- wheels


def _author_wheels(layer: Sdf.Layer, prim: Sdf.PrimSpec, p: Placement, track: Track, codes: Array) -> None:
    """Wheels that turn by the way that was gone, and steer in bends, in the place of those of the model's meshes."""
    geometry, parts = _geometry(p)
    wheels = wheels_of(geometry)
    if wheels is None:
        return
    if not layer.GetPrimAtPath(parts):
        _author_parts(layer, parts, wheels)
    _refer(prim, parts)
    for wheel in wheels.wheels:
        over = Sdf.CreatePrimInLayer(layer, prim.path.AppendPath(f"Wheels/{wheel.name}"))
        spin = np.round(np.degrees(-track.travel / (wheel.radius * p.size)), 1)
        _sample(layer, _attribute(over, "xformOp:rotateX", KINDS.Float), codes, spin.tolist())
        if wheel.name.startswith("Front"):
            steer = np.round(np.degrees(np.arctan(wheels.wheelbase * p.size * track.bend)), 2) + 0.0
            _sample(layer, _attribute(over, "xformOp:rotateZ", KINDS.Float), codes, steer.tolist())


def _geometry(p: Placement) -> tuple[FilePath, str]:
    """The layer of meshes that a placement shows, and where parts of them stand in the stage."""
    low = p.variants.get("lod") == "low"
    geometry = rules.model(p.asset).path.with_name(f"{p.asset}.{'low.' if low else ''}geo.usdc")
    return geometry, f"{PARTS}/{p.asset}{'_low' if low else ''}"


def _refer(prim: Sdf.PrimSpec, parts: str) -> None:
    """Add parts to a placement; its prims can have opinions then, so that it is no instance."""
    prim.referenceList.prependedItems = [Sdf.Reference("", parts), *prim.referenceList.prependedItems]
    prim.instanceable = False


def _author_parts(layer: Sdf.Layer, path: str, wheels: Wheels) -> None:
    """What a reference brings to a model whose wheels turn: the wheels, and meshes without them."""
    scratch = _begin(path)
    for name, part in wheels.left.items():
        if part is None:
            scratch.OverridePrim(f"{path}/Geometry/{name}").SetActive(False)
        else:
            author_mesh(scratch, Sdf.Path(f"{path}/Geometry/{name}"), part)
    UsdGeom.Scope.Define(scratch, f"{path}/Wheels")
    for wheel in wheels.wheels:
        root = UsdGeom.Xform.Define(scratch, f"{path}/Wheels/{wheel.name}")
        root.AddTranslateOp().Set(Gf.Vec3d(*wheel.axle))
        root.AddRotateZOp().Set(0.0)
        root.AddRotateXOp().Set(0.0)
        for name, part in wheel.parts.items():
            _bound(
                scratch,
                f"{root.GetPath()}/{name}",
                part.moved(shift(*(-v for v in wheel.axle))),
                f"{path}/Materials/{name}",
            )
    _keep(layer, scratch, path)


def _begin(path: str) -> Usd.Stage:
    """A stage of its own with an abstract prim."""
    scratch = Usd.Stage.CreateInMemory()
    scratch.CreateClassPrim(path)
    return scratch


def _bound(scratch: Usd.Stage, path: str, part: Part, material: str) -> None:
    """A part as a mesh, with a material that is elsewhere."""
    prim = author_mesh(scratch, Sdf.Path(path), part).GetPrim()
    UsdShade.MaterialBindingAPI.Apply(prim).GetDirectBindingRel().SetTargets([material])


def _keep(layer: Sdf.Layer, scratch: Usd.Stage, path: str) -> None:
    """Take an abstract prim over into a layer."""
    Sdf.CreatePrimInLayer(layer, PARTS).specifier = Sdf.SpecifierClass
    Sdf.CopySpec(scratch.GetRootLayer(), path, layer, path)


# -- lamps


def _author_lamps(layer: Sdf.Layer, prim: Sdf.PrimSpec, p: Placement, track: Track, codes: Array) -> None:
    """Brake lights in both lightings, by day off at frame 0 as the still has them, and indicators."""
    bright, dim = (_emissions(p.asset, choice) for choice in ("brake", "glow"))
    by_day = track.brakes & (codes > 0.0)
    for name, on in bright.items():
        off = dim.get(name, DARK)
        if on != off:
            for lighting, lit, colours in (("active", track.brakes, (on, off)), ("sky", by_day, (on, DARK))):
                path = Sdf.Path("/World").AppendVariantSelection("lighting", lighting)
                path = path.AppendPath(prim.path.MakeRelativePath("/World")).AppendPath(f"Materials/{name}/Surface")
                _author_emission(layer, path, lit, colours, codes)
    if track.blinks.any():
        _author_indicators(layer, prim, p, track, codes)


def _author_indicators(layer: Sdf.Layer, prim: Sdf.PrimSpec, p: Placement, track: Track, codes: Array) -> None:
    """Indicators of the two sides in the place of the one mesh of both, each with a material that blinks."""
    geometry, parts = _geometry(p)
    sides = sides_of(geometry, INDICATORS)
    if not sides:
        return
    parts += "_indicators"
    if not layer.GetPrimAtPath(parts):
        scratch = _begin(parts)
        scratch.OverridePrim(f"{parts}/Geometry/{INDICATORS}").SetActive(False)
        looks = Sdf.Layer.FindOrOpen(str(rules.model(p.asset).path.with_suffix(".mtl.usda")))
        for side, half in sides.items():
            material = scratch.OverridePrim(f"{parts}/Materials/{INDICATORS}_{side}").GetPath()
            Sdf.CopySpec(looks, f"/{looks.defaultPrim}/Materials/{INDICATORS}", scratch.GetRootLayer(), material)
            _bound(scratch, f"{parts}/Geometry/{INDICATORS}_{side}", half, str(material))
        _keep(layer, scratch, parts)
    nits = LAMPS["indicator_rear"].nits
    lit = Gf.Vec3f(*(round(nits * part, 1) for part in tint("indicator_rear")))
    for side, way in (("left", 1), ("right", -1)):
        path = prim.path.AppendPath(f"Materials/{INDICATORS}_{side}/Surface")
        _author_emission(layer, path, track.blinks == way, (lit, DARK), codes)
    _refer(prim, parts)


def _author_emission(layer: Sdf.Layer, path: Sdf.Path, lit: Flags, colours: tuple[Any, Any], codes: Array) -> None:
    """Emission of a shader, one colour where it is lit and another where it is not; none where it never is."""
    if not lit.any():
        return
    over = Sdf.CreatePrimInLayer(layer, path)
    name = _attribute(over, "inputs:emissiveColor", KINDS.Color3f, colours[0 if lit[1] else 1])
    _sample(layer, name, codes, [colours[0 if item else 1] for item in lit])


def _emissions(asset: str, choice: str) -> Mapping[str, Any]:
    """Emission of a model's materials by a choice of its lamps; empty where it has no such choice."""
    layer = Sdf.Layer.FindOrOpen(str(rules.model(asset).path))
    materials = layer.GetPrimAtPath(
        Sdf.Path(f"/{layer.defaultPrim}").AppendVariantSelection("lamps", choice).AppendPath("Materials")
    )
    result = {}
    for material in materials.nameChildren if materials else ():
        surface = material.nameChildren.get("Surface")
        if surface and "inputs:emissiveColor" in surface.attributes:
            result[material.name] = surface.attributes["inputs:emissiveColor"].default
    return result


# -- the camera's car


def _author_cameras(layer: Sdf.Layer, spec: WorldSpec, clip: Clip) -> None:
    """The ego's camera, those of its rig, and its headlights."""
    views = _views(spec.view, clip.ego)
    ego = layer.GetPrimAtPath(authoring.EGO)
    for name, values in (
        ("xformOp:translate", [Gf.Vec3d(item.x, item.y, item.z) for item in views]),
        ("xformOp:rotateXYZ", [Gf.Vec3f(item.tilt, 0, item.heading) for item in views]),
    ):
        _sample(layer, ego.attributes[name].path, clip.codes, values)
    above = spec.view.z - float(spec.road.height(spec.view.x, spec.view.y))
    places = {f"{authoring.RIG}/{item.name}": [authoring.rig_place(view, item) for view in views] for item in spec.rig}
    lamps = [dict(stage.headlights(view, view.z - above)) for view in views]
    for name in lamps[0]:
        places[f"/World/Lights/Headlights/{name}"] = [item[name] for item in lamps]
    for path, matrices in places.items():
        prim = layer.GetPrimAtPath(path)
        if prim:
            values = [Gf.Matrix4d(np.round(item.T, 6).tolist()) for item in matrices]
            _sample(layer, prim.attributes["xformOp:transform"].path, clip.codes, values)


def _views(view: View, track: Track) -> list[View]:
    """The view at each frame; at frame 0 as it was drawn."""
    rows = np.stack([track.x, track.y, track.z, track.heading + view.yaw, view.tilt + track.pitch], axis=1)
    result = [replace(view, x=x, y=y, z=z, heading=h, tilt=t) for x, y, z, h, t in np.round(rows, 4).tolist()]
    result[1] = view
    return result
