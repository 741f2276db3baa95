"""Vehicles in motion as time samples: wheels that roll and steer, brake lights and indicators."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom

from synfog_usd.base.arrays import Array
from synfog_usd.world import library
from synfog_usd.world.components import author_mesh
from synfog_usd.world.lamps import LAMPS
from synfog_usd.world.shapes import shift
from synfog_usd.world.spec import Placement
from synfog_usd.world.traffic.cutting import read_part
from synfog_usd.world.traffic.gait import SIDES
from synfog_usd.world.traffic.motion import Track
from synfog_usd.world.traffic.pedals import BICYCLES, CENTRE, Cranks, crank_turn, cranks_of
from synfog_usd.world.traffic.samples import (
    DARK,
    KINDS,
    amber,
    attribute,
    author_emission,
    begin,
    bound,
    emissions,
    geometry,
    keep,
    refer,
    sample,
)  # fmt: skip
from synfog_usd.world.traffic.wheels import Wheels, sides_of, wheels_of

LABELS = "SemanticsLabelsAPI:cityscapes"
LABEL = "semantics:labels:cityscapes"
INDICATORS = "amber"
"""Material of indicators."""


def author_vehicle(layer: Sdf.Layer, prim: Sdf.PrimSpec, p: Placement, track: Track, codes: Array) -> None:
    """Wheels and lamps of a vehicle that moves."""
    _author_wheels(layer, prim, p, track, codes)
    _author_lamps(layer, prim, p, track, codes)


# -- wheels


def _author_wheels(layer: Sdf.Layer, prim: Sdf.PrimSpec, p: Placement, track: Track, codes: Array) -> None:
    """Wheels that turn by the way that was gone, and steer in bends, in the place of those of the model's meshes."""
    meshes, parts = geometry(p)
    wheels = wheels_of(meshes)
    if wheels is None:
        return
    if not layer.GetPrimAtPath(parts):
        _author_parts(layer, parts, p.asset, wheels, meshes)
    refer(prim, parts)
    if p.asset in BICYCLES:
        turn = np.round(crank_turn(track.travel / p.size), 1)
        for place, angle in (("", turn), *((f"/{side}", -turn) for side in SIDES)):
            over = Sdf.CreatePrimInLayer(layer, prim.path.AppendPath(f"Cranks{place}"))
            sample(layer, attribute(over, "xformOp:rotateX", KINDS.Float), codes, (angle + 0.0).tolist())
    for wheel in wheels.wheels:
        over = Sdf.CreatePrimInLayer(layer, prim.path.AppendPath(f"Wheels/{wheel.name}"))
        spin = np.round(np.degrees(-track.travel / (wheel.radius * p.size)), 1)
        sample(layer, attribute(over, "xformOp:rotateX", KINDS.Float), codes, spin.tolist())
        if wheel.name.startswith("Front"):
            steer = np.round(np.degrees(np.arctan(wheels.wheelbase * p.size * track.bend)), 2) + 0.0
            sample(layer, attribute(over, "xformOp:rotateZ", KINDS.Float), codes, steer.tolist())


def _author_parts(layer: Sdf.Layer, path: str, asset: str, wheels: Wheels, meshes: Path) -> None:
    """What a reference brings to a model whose wheels turn: the wheels and cranks, and meshes without them."""
    scratch = begin(path)
    rest, chrome, plastic = (
        dict(wheels.rest),
        wheels.rest.get("chrome"),
        read_part(Sdf.Layer.FindOrOpen(str(meshes)), "black_plastic"),
    )
    if asset in BICYCLES and chrome and plastic:
        cranks = cranks_of(chrome, plastic)
        rest |= cranks.rest
        _author_cranks(scratch, path, cranks)
    for name, part in rest.items():
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
            bound(
                scratch,
                f"{root.GetPath()}/{name}",
                part.moved(shift(*(-v for v in wheel.axle))),
                f"{path}/Materials/{name}",
            )
    model = Sdf.Layer.FindOrOpen(str(library.model(asset).path))
    label = model.GetAttributeAtPath(f"/{asset}/Geometry/tyre.{LABEL}")
    for prim in (scratch.GetPrimAtPath(f"{path}/{name}") for name in ("Wheels", "Cranks")):
        if label and prim:  # a model with its rider has labels by material
            prim.AddAppliedSchema(LABELS)
            prim.CreateAttribute(LABEL, KINDS.TokenArray).Set(label.default)
    keep(layer, scratch, path)


def _author_cranks(scratch: Usd.Stage, path: str, cranks: Cranks) -> None:
    """Arms that turn about their middle, and on them pedals that stay level."""
    root = UsdGeom.Xform.Define(scratch, f"{path}/Cranks")
    root.AddTranslateOp().Set(Gf.Vec3d(*CENTRE))
    root.AddRotateXOp().Set(0.0)
    centred = cranks.arms.moved(shift(*(-v for v in CENTRE)))
    bound(scratch, f"{path}/Cranks/chrome", centred, f"{path}/Materials/chrome")
    for side, (part, middle) in cranks.pedals.items():
        pedal = UsdGeom.Xform.Define(scratch, f"{path}/Cranks/{side}")
        pedal.AddTranslateOp().Set(Gf.Vec3d(*np.round(middle - CENTRE, 5).tolist()))
        pedal.AddRotateXOp().Set(0.0)
        centred = part.moved(shift(*(-v for v in middle)))
        bound(scratch, f"{pedal.GetPath()}/black_plastic", centred, f"{path}/Materials/black_plastic")


# -- lamps


def _author_lamps(layer: Sdf.Layer, prim: Sdf.PrimSpec, p: Placement, track: Track, codes: Array) -> None:
    """Brake lights in both lightings, by day off at frame 0 as the still has them, and indicators."""
    bright, dim = (emissions(p.asset, choice) for choice in ("brake", "glow"))
    by_day = track.brakes & (codes > 0.0)
    for name, on in bright.items():
        off = dim.get(name, DARK)
        if on != off:
            for lighting, lit, colours in (("active", track.brakes, (on, off)), ("sky", by_day, (on, DARK))):
                path = Sdf.Path("/World").AppendVariantSelection("lighting", lighting)
                path = path.AppendPath(prim.path.MakeRelativePath("/World")).AppendPath(f"Materials/{name}/Surface")
                if lit.any():
                    author_emission(layer, path, lit, colours, codes)
    if track.blinks.any():
        _author_indicators(layer, prim, p, track, codes)


def _author_indicators(layer: Sdf.Layer, prim: Sdf.PrimSpec, p: Placement, track: Track, codes: Array) -> None:
    """Indicators of the two sides in the place of the one mesh of both, each with a material that blinks."""
    meshes, parts = geometry(p)
    sides = sides_of(meshes, INDICATORS)
    if not sides:
        return
    parts += "_indicators"
    if not layer.GetPrimAtPath(parts):
        scratch = begin(parts)
        scratch.OverridePrim(f"{parts}/Geometry/{INDICATORS}").SetActive(False)
        looks = Sdf.Layer.FindOrOpen(str(library.model(p.asset).path.with_suffix(".mtl.usda")))
        for side, half in sides.items():
            material = scratch.OverridePrim(f"{parts}/Materials/{INDICATORS}_{side}").GetPath()
            Sdf.CopySpec(looks, f"/{looks.defaultPrim}/Materials/{INDICATORS}", scratch.GetRootLayer(), material)
            bound(scratch, f"{parts}/Geometry/{INDICATORS}_{side}", half, str(material))
        keep(layer, scratch, parts)
    lit = amber(LAMPS["indicator_rear"].nits)
    for side, way in (("left", 1), ("right", -1)):
        path = prim.path.AppendPath(f"Materials/{INDICATORS}_{side}/Surface")
        if (track.blinks == way).any():
            author_emission(layer, path, track.blinks == way, (lit, DARK), codes)
    refer(prim, parts)
