"""What every composed stage has: camera, fog, skies, references, variants, render settings.

Takes numbers; writes prims below /World and /Render of an open stage.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from pxr import Gf, Kind, Sdf, Usd, UsdGeom, UsdLux, UsdRender, Vt

from synfog_usd.base.arrays import Array
from synfog_usd.fog import Fog
from synfog_usd.fog.kinds import FOG
from synfog_usd.world import skies
from synfog_usd.world.components import label
from synfog_usd.world.library import model
from synfog_usd.world.shapes import shift, turn
from synfog_usd.world.spec import Placement, RigCamera, SkyDome, View, WorldSpec

APERTURE = 0.36  # tenths of a metre
EGO, RIG = "/World/Ego", "/World/Rig"
VELOCITY = "physics:velocity"
"""In metres per second; UsdPhysics' name, without its rigid body, which would fall."""
VARS: dict[str, tuple[str, dict[str, tuple[str, str]]]] = {
    "Radiance": ("radiance.exr", {"Radiance": ("color3f", "RGB")}),
    "Labels": (
        "labels.exr",
        {
            "Depth": ("float", "depth.Z"),
            "Distance": ("float", "distance.Z"),
            "Normal": ("normal3f", "N"),
            "Instance": ("int", "instance.ID"),
            "Semantic": ("int", "semantic.ID"),
        },
    ),
}
"""Product -> file and its variables, each with its type and its channels in that file; as a bake writes them."""


def focal_length(fov_x_deg: float) -> float:
    """Focal length [tenths of a metre] that shows an angle of APERTURE's width."""
    return round(APERTURE / 2 / math.tan(math.radians(fov_x_deg) / 2), 6)


def author_camera(stage: Usd.Stage, view: View) -> None:
    """/World/Ego behind the windscreen."""
    camera = _camera(stage, EGO, view.focal_length)
    camera.AddTranslateOp().Set(Gf.Vec3d(view.x, view.y, view.z))
    camera.AddRotateXYZOp().Set(Gf.Vec3f(view.tilt, 0, view.heading))


def _camera(stage: Usd.Stage, path: str, focal_length: float) -> UsdGeom.Camera:
    camera = UsdGeom.Camera.Define(stage, path)
    camera.CreateHorizontalApertureAttr(APERTURE)
    camera.CreateVerticalApertureAttr(APERTURE * 9 / 16)
    camera.CreateFocalLengthAttr(focal_length)
    camera.CreateClippingRangeAttr(Gf.Vec2f(0.1, 3000))
    camera.CreateFocusDistanceAttr(30.0)
    camera.CreateFStopAttr(0.0)
    return camera


def author_rig(stage: Usd.Stage, spec: WorldSpec) -> None:
    """The cameras of the rig below /World/Rig, fixed to the ego's car."""
    if not spec.rig:
        return
    UsdGeom.Xform.Define(stage, "/World/Rig")
    for eye in spec.rig:
        camera = _camera(stage, f"{RIG}/{eye.name}", eye.focal_length)
        camera.AddTransformOp().Set(Gf.Matrix4d(np.round(rig_place(spec.view, eye).T, 6).tolist()))


def rig_place(view: View, camera: RigCamera) -> Array:
    """(4, 4) from a camera of the rig to the stage, for the ego's view."""
    car = shift(view.x, view.y, view.z) @ turn(view.heading) @ turn(view.tilt - 90.0, "x")
    return np.asarray(car @ shift(camera.right, camera.ahead) @ turn(camera.yaw) @ turn(90.0, "x"))


def author_fog(stage: Usd.Stage, wind_m_s: tuple[float, float]) -> None:
    """The box of fog round everything, without a visibility: the fog variants set it; a wind (x, y) is its velocity."""
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
    if any(wind_m_s):
        prim.CreateAttribute(VELOCITY, Sdf.ValueTypeNames.Vector3f).Set(Gf.Vec3f(*wind_m_s, 0.0))


def author_skies(stage: Usd.Stage, spec: WorldSpec, assets: str) -> None:
    """The two domes, of which a lighting shows one."""
    UsdGeom.Scope.Define(stage, "/World/Sky")
    for name, sky in ((_day(spec.day), spec.day), ("Dusk", spec.dusk)):
        path = f"/World/Sky/{name}"
        if sky.sky in skies.skies():
            skies.author_dome(stage, path, sky.sky, skies=f"{assets}/skies", heading_deg=sky.heading_deg, gain=sky.gain)
            continue
        dome = UsdLux.DomeLight.Define(stage, path)
        dome.CreateIntensityAttr(sky.gain)
        dome.CreateTextureFileAttr(Sdf.AssetPath(f"{assets}/skies/{sky.sky}.exr"))
        dome.CreateTextureFormatAttr(UsdLux.Tokens.latlong)
        UsdGeom.Xformable(dome).AddRotateXOp().Set(90.0)  # the picture's pole to the zenith


def _day(dome: SkyDome) -> str:
    """Name of the prim of the sky by day."""
    return "Day" if dome.sky in skies.skies() else "Overcast"


def author_placements(layer: Sdf.Layer, placed: Iterable[Placement], assets: str) -> None:
    """Components in their places, instanceable.

    They are written to the layer at one go.  A stage that has it open composes all of them then: call it when none has.
    """
    with Sdf.ChangeBlock():
        for p in placed:
            _author_placement(layer, p, assets)


def _author_placement(layer: Sdf.Layer, p: Placement, assets: str) -> None:
    prim = Sdf.CreatePrimInLayer(layer, f"/World/{p.group}/{p.name}")
    prim.specifier, prim.typeName = Sdf.SpecifierDef, "Xform"
    prim.referenceList.Prepend(Sdf.Reference(f"{assets}/models/{p.asset}/{p.asset}.usda"))
    for name, choice in p.variants.items():
        prim.variantSelections[name] = choice
    if "lamps" in p.lit and "driver" in model(p.asset).variants:  # it is in traffic
        prim.variantSelections["driver"] = "on"
    if p.group != "Ground":
        prim.instanceable = True
    kinds = Sdf.ValueTypeNames
    ops = [("xformOp:translate", kinds.Double3, Gf.Vec3d(p.x, p.y, p.z))]
    if p.heading:
        ops.append(("xformOp:rotateZ", kinds.Float, float(p.heading)))
    if p.pitch:
        ops.append(("xformOp:rotateX", kinds.Float, float(p.pitch)))
    if p.roll:
        ops.append(("xformOp:rotateY", kinds.Float, float(p.roll)))
    if p.size != 1.0:
        ops.append(("xformOp:scale", kinds.Float3, Gf.Vec3f(p.size)))
    for name, kind, value in ops:
        Sdf.AttributeSpec(prim, name, kind).default = value
    if p.speed_m_s is not None:
        h, up = math.radians(p.heading), math.radians(p.pitch)
        ahead = (-math.sin(h) * math.cos(up), math.cos(h) * math.cos(up), math.sin(up))
        velocity = Gf.Vec3f(*(round(p.speed_m_s * part, 3) + 0.0 for part in ahead))
        Sdf.AttributeSpec(prim, VELOCITY, kinds.Vector3f, declaresCustom=True).default = velocity
    order = Sdf.AttributeSpec(prim, "xformOpOrder", kinds.TokenArray, Sdf.VariabilityUniform)
    order.default = Vt.TokenArray([name for name, _, _ in ops])


def author_instancer(
    stage: Usd.Stage, path: str, asset: str, name: str, points: Array, turns: Array, assets: str
) -> None:
    """Many of one component, upright: (N, 3) places [m] and (N,) headings [degrees]."""
    instancer = UsdGeom.PointInstancer.Define(stage, path)
    prototype = stage.DefinePrim(f"{path}/Prototypes/{asset.title()}", "Xform")
    prototype.GetParent().SetTypeName("Scope")
    prototype.GetReferences().AddReference(f"{assets}/models/{asset}/{asset}.usda")
    instancer.CreatePrototypesRel().SetTargets([prototype.GetPath()])
    instancer.CreateProtoIndicesAttr(Vt.IntArray([0] * len(points)))
    instancer.CreatePositionsAttr(Vt.Vec3fArray([Gf.Vec3f(*(round(float(v), 3) for v in p)) for p in points]))
    instancer.CreateOrientationsAttr(upright(turns))
    instancer.CreateExtentAttr(instancer.ComputeExtentAtTime(Usd.TimeCode.Default(), Usd.TimeCode.Default()))
    Usd.ModelAPI(instancer.GetPrim()).SetKind(Kind.Tokens.group)
    label(instancer.GetPrim(), name)


def upright(turns: Array) -> Vt.QuathArray:
    """Rotations about Z from (N,) headings [degrees]."""
    half = np.deg2rad(turns) / 2
    return Vt.QuathArray([Gf.Quath(float(c), 0, 0, float(s)) for c, s in zip(np.cos(half), np.sin(half), strict=True)])


def author_fog_variants(stage: Usd.Stage, fogs: Mapping[str, float | str | None], selected: str) -> None:
    """A variant of /World for each visibility [m], or weather, of /World/Fog/Global; None is clear air."""
    variants = stage.GetPrimAtPath("/World").GetVariantSets().AddVariantSet("fog")
    for name, mor_m in fogs.items():
        variants.AddVariant(name)
        variants.SetVariantSelection(name)
        with variants.GetVariantEditContext():
            if mor_m is None:
                stage.OverridePrim("/World/Fog").SetActive(False)
            elif isinstance(mor_m, str):
                _author_weather(stage.OverridePrim("/World/Fog/Global"), mor_m)
            else:
                stage.OverridePrim("/World/Fog/Global").CreateAttribute(
                    "synfog:fog:mor", Sdf.ValueTypeNames.Float, custom=False
                ).Set(mor_m)
    variants.SetVariantSelection(selected)


def _author_weather(prim: Usd.Prim, name: str) -> None:
    """The attributes of a medium by the name of its weather."""
    first, _, also = name.partition("+")
    fog = Fog.named(first)
    assert fog is not None
    kinds, number = Sdf.ValueTypeNames, "synfog:fog:mor" if fog.rate_mm_h is None else "synfog:medium:rate"
    prim.CreateAttribute("synfog:medium:kind", kinds.Token, False, Sdf.VariabilityUniform).Set(fog.kind or FOG)
    prim.CreateAttribute(number, kinds.Float, custom=False).Set(fog.mor_m if fog.rate_mm_h is None else fog.rate_mm_h)
    if also:
        prim.CreateAttribute("synfog:medium:also", kinds.String, custom=False).Set(also)


def author_variants(stage: Usd.Stage, spec: WorldSpec) -> None:
    """The fog variants, and the lightings: day without lamps, or with those of traffic where rain or snow falls, and
    dusk with all.
    """
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
                for p in spec.placed if spec.falls else ():
                    if p.lit and p.group == "Vehicles" and "glow" in model(p.asset).variants.get("lamps", ()):
                        prim = stage.OverridePrim(f"/World/{p.group}/{p.name}")
                        prim.GetVariantSets().GetVariantSet("lamps").SetVariantSelection("glow")
                continue
            stage.OverridePrim(f"/World/Sky/{_day(spec.day)}").SetActive(False)
            for p in spec.placed:
                for set_name, choice in p.lit.items():
                    prim = stage.OverridePrim(f"/World/{p.group}/{p.name}")
                    prim.GetVariantSets().GetVariantSet(set_name).SetVariantSelection(choice)


def author_products(stage: Usd.Stage, cameras: Sequence[str]) -> None:
    """What each camera makes: products by camera and file, and the variables in them; add to `author_render`."""
    UsdGeom.Scope.Define(stage, "/Render/Vars")
    UsdGeom.Scope.Define(stage, "/Render/Products")
    for _, variables in VARS.values():
        for name, (kind, source) in variables.items():
            var = UsdRender.Var.Define(stage, f"/Render/Vars/{name}")
            var.CreateDataTypeAttr(kind)
            var.CreateSourceNameAttr(source)
            var.CreateSourceTypeAttr(UsdRender.Tokens.raw)
    products = []
    for camera in cameras:
        title = camera.rpartition("/")[2]
        for name, (file, variables) in VARS.items():
            product = UsdRender.Product.Define(stage, f"/Render/Products/{title}_{name}")
            product.CreateProductNameAttr(f"{title.lower()}/{file}")
            product.CreateProductTypeAttr(UsdRender.Tokens.raster)
            product.CreateCameraRel().SetTargets([camera])
            product.CreateOrderedVarsRel().SetTargets([Sdf.Path(f"/Render/Vars/{var}") for var in variables])
            products.append(product.GetPath())
    UsdRender.Settings(stage.GetPrimAtPath("/Render/Settings")).CreateProductsRel().SetTargets(products)


def author_render(stage: Usd.Stage) -> None:
    """Settings that a renderer finds: camera, size, purposes."""
    UsdGeom.Scope.Define(stage, "/Render")
    settings = UsdRender.Settings.Define(stage, "/Render/Settings")
    settings.CreateCameraRel().SetTargets(["/World/Ego"])
    settings.CreateResolutionAttr(Gf.Vec2i(1280, 720))
    settings.CreateIncludedPurposesAttr(["default", "render"])
