"""What every composed stage has: camera, fog, skies, references, variants, render settings.

Takes numbers; writes prims below /World and /Render of an open stage.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from pxr import Gf, Kind, Sdf, Usd, UsdGeom, UsdLux, UsdRender, Vt

from synfog_usd.world.components import label
from synfog_usd.world.shapes import Array
from synfog_usd.world.spec import Placement, View, WorldSpec

APERTURE = 0.36  # tenths of a metre


def author_camera(stage: Usd.Stage, view: View) -> None:
    """/World/Ego behind the windscreen."""
    camera = UsdGeom.Camera.Define(stage, "/World/Ego")
    camera.CreateHorizontalApertureAttr(APERTURE)
    camera.CreateVerticalApertureAttr(APERTURE * 9 / 16)
    camera.CreateFocalLengthAttr(view.focal_length)
    camera.CreateClippingRangeAttr(Gf.Vec2f(0.1, 3000))
    camera.CreateFocusDistanceAttr(30.0)
    camera.CreateFStopAttr(0.0)
    camera.AddTranslateOp().Set(Gf.Vec3d(view.x, view.y, view.z))
    camera.AddRotateXYZOp().Set(Gf.Vec3f(view.tilt, 0, view.heading))


def author_fog(stage: Usd.Stage) -> None:
    """The box of fog round everything, without a visibility: the fog variants set it."""
    UsdGeom.Scope.Define(stage, "/World/Fog")
    cube = UsdGeom.Cube.Define(stage, "/World/Fog/Global")
    prim = cube.GetPrim()
    prim.SetDocumentation("Boundary of the fog: 1.8 km wide, from below the ground to 100 m above it.")
    cube.CreateSizeAttr(2.0)
    cube.CreateExtentAttr(Vt.Vec3fArray([Gf.Vec3f(-1), Gf.Vec3f(1)]))
    cube.CreatePurposeAttr(UsdGeom.Tokens.guide)
    cube.CreateDisplayColorAttr([Gf.Vec3f(0.75, 0.8, 0.85)])
    cube.CreateDisplayOpacityAttr([0.15])
    cube.AddTranslateOp().Set(Gf.Vec3d(0, 100, 40))
    cube.AddScaleOp().Set(Gf.Vec3f(900, 900, 60))
    prim.AddAppliedSchema("SynFogMediumAPI")
    prim.CreateAttribute("synfog:fog:g", Sdf.ValueTypeNames.Float, custom=False).Set(0.87)
    prim.CreateAttribute("synfog:fog:phase", Sdf.ValueTypeNames.Token, False, Sdf.VariabilityUniform).Set("hg")
    prim.CreateAttribute("synfog:fog:profile", Sdf.ValueTypeNames.Token, False, Sdf.VariabilityUniform).Set("uniform")


def author_skies(stage: Usd.Stage, spec: WorldSpec, assets: str) -> None:
    """The two domes, of which a lighting shows one."""
    UsdGeom.Scope.Define(stage, "/World/Sky")
    for name, file, nits in (("Overcast", "overcast.exr", spec.overcast_nits), ("Dusk", "dusk.exr", spec.dusk_nits)):
        dome = UsdLux.DomeLight.Define(stage, f"/World/Sky/{name}")
        dome.CreateIntensityAttr(nits)
        dome.CreateTextureFileAttr(Sdf.AssetPath(f"{assets}/skies/{file}"))
        dome.CreateTextureFormatAttr(UsdLux.Tokens.latlong)
        UsdGeom.Xformable(dome).AddRotateXOp().Set(90.0)  # the picture's pole to the zenith


def author_placement(stage: Usd.Stage, p: Placement, assets: str) -> None:
    """One component in its place, instanceable."""
    xform = UsdGeom.Xform.Define(stage, f"/World/{p.group}/{p.name}")
    prim = xform.GetPrim()
    prim.GetReferences().AddReference(f"{assets}/models/{p.asset}/{p.asset}.usda")
    for name, choice in p.variants.items():
        prim.GetVariantSets().GetVariantSet(name).SetVariantSelection(choice)
    if p.group != "Ground":
        prim.SetInstanceable(True)
    xform.AddTranslateOp().Set(Gf.Vec3d(p.x, p.y, p.height))
    if p.heading:
        xform.AddRotateZOp().Set(float(p.heading))
    if p.pitch:
        xform.AddRotateXOp().Set(float(p.pitch))
    if p.size != 1.0:
        xform.AddScaleOp().Set(Gf.Vec3f(p.size))


def author_instancer(stage: Usd.Stage, path: str, asset: str, name: str, points: Array, turns: Array, assets: str) -> None:
    """Many of one component, upright: (N, 3) places [m] and (N,) headings [degrees]."""
    instancer = UsdGeom.PointInstancer.Define(stage, path)
    prototype = stage.DefinePrim(f"{path}/Prototypes/{asset.title()}", "Xform")
    prototype.GetParent().SetTypeName("Scope")
    prototype.GetReferences().AddReference(f"{assets}/models/{asset}/{asset}.usda")
    instancer.CreatePrototypesRel().SetTargets([prototype.GetPath()])
    instancer.CreateProtoIndicesAttr(Vt.IntArray([0] * len(points)))
    instancer.CreatePositionsAttr(Vt.Vec3fArray([Gf.Vec3f(*(round(float(v), 3) for v in p)) for p in points]))
    half = np.deg2rad(turns) / 2
    instancer.CreateOrientationsAttr(Vt.QuathArray([Gf.Quath(float(c), 0, 0, float(s)) for c, s in zip(np.cos(half), np.sin(half), strict=True)]))
    instancer.CreateExtentAttr(instancer.ComputeExtentAtTime(Usd.TimeCode.Default(), Usd.TimeCode.Default()))
    Usd.ModelAPI(instancer.GetPrim()).SetKind(Kind.Tokens.group)
    label(instancer.GetPrim(), name)


def author_fog_variants(stage: Usd.Stage, fogs: Mapping[str, float | None], selected: str) -> None:
    """A variant of /World for each visibility [m] of /World/Fog/Global; None is clear air."""
    variants = stage.GetPrimAtPath("/World").GetVariantSets().AddVariantSet("fog")
    for name, mor_m in fogs.items():
        variants.AddVariant(name)
        variants.SetVariantSelection(name)
        with variants.GetVariantEditContext():
            if mor_m is None:
                stage.OverridePrim("/World/Fog").SetActive(False)
            else:
                stage.OverridePrim("/World/Fog/Global").CreateAttribute("synfog:fog:mor", Sdf.ValueTypeNames.Float, custom=False).Set(mor_m)
    variants.SetVariantSelection(selected)


def author_variants(stage: Usd.Stage, spec: WorldSpec) -> None:
    """The fog variants, and the lightings: day without lamps, dusk with them."""
    author_fog_variants(stage, spec.fog, spec.fog_selected)
    world = stage.GetPrimAtPath("/World")
    lighting = world.GetVariantSets().AddVariantSet("lighting")
    for name in ("active", "sky"):
        lighting.AddVariant(name)
        lighting.SetVariantSelection(name)
        with lighting.GetVariantEditContext():
            if name == "sky":
                stage.OverridePrim("/World/Sky/Dusk").SetActive(False)
                stage.OverridePrim("/World/Lights").SetActive(False)
                continue
            stage.OverridePrim("/World/Sky/Overcast").SetActive(False)
            for p in spec.placed:
                for set_name, choice in p.lit.items():
                    prim = stage.OverridePrim(f"/World/{p.group}/{p.name}")
                    prim.GetVariantSets().GetVariantSet(set_name).SetVariantSelection(choice)


def author_render(stage: Usd.Stage) -> None:
    """Settings that a renderer finds: camera, size, purposes."""
    UsdGeom.Scope.Define(stage, "/Render")
    settings = UsdRender.Settings.Define(stage, "/Render/Settings")
    settings.CreateCameraRel().SetTargets(["/World/Ego"])
    settings.CreateResolutionAttr(Gf.Vec2i(1280, 720))
    settings.CreateIncludedPurposesAttr(["default", "render"])
