"""Parts and their materials, written as a USD component that a stage references.

Takes a `Component`; leaves `<folder>/<name>/<name>.usda` (the interface: label,
materials, variants, lamps) and `<name>.geometry.usdc` (the meshes; `<name>.low.usdc`
where there are fewer triangles to choose) behind.  The component stands on the
ground at the origin and looks along +Y, in metres, Z up.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from pxr import Gf, Kind, Sdf, Usd, UsdGeom, UsdLux, UsdSemantics, UsdShade, Vt

from synfog_usd.files import write_whole
from synfog_usd.world.materials import PALETTE, Colour, Material
from synfog_usd.world.shapes import Part, by_material

MADE_BY = "synfog_usd.world"
LICENCE = "CC0-1.0"


@dataclass(frozen=True)
class Lamp:
    """A shaped disk light that shines along its -Z.

    Attributes:
        name: prim name.
        place: (4, 4) local matrix.
        candela: intensity on the axis [cd].
        radius_m: radius of the disk.
        cone_deg: half angle of the cone; softness: share of it that fades.
        colour: tint of luminance 1 within a few per cent.
    """

    name: str
    place: np.ndarray
    candela: float
    radius_m: float
    cone_deg: float
    softness: float
    colour: Colour = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class Look:
    """What one variant changes.

    Attributes:
        materials: material -> (input -> value).
        bindings: mesh (by the material of its parts) -> material that it wears.
        lamps: lights that exist in this variant only.
    """

    materials: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    bindings: Mapping[str, str] = field(default_factory=dict)
    lamps: tuple[Lamp, ...] = ()


@dataclass(frozen=True)
class Component:
    """A thing of the street.

    Attributes:
        name: file and prim name.
        label: official Cityscapes name.
        parts: its triangles.
        about: one sentence.
        variants: variant set -> variant -> what it changes; the first is the default.
        materials: what differs from the palette, or is not in it.
        labels: Cityscapes names of meshes (by material) that differ from `label`.
        low: the same thing in fewer triangles, of the same materials; with it comes a variant set `lod` (full, low).
        textures: where its pictures lie, seen from its folder.
        origin: what its files say of source and licence.
    """

    name: str
    label: str
    parts: tuple[Part, ...]
    about: str
    variants: Mapping[str, Mapping[str, Look]] = field(default_factory=dict)
    materials: Mapping[str, Material] = field(default_factory=dict)
    labels: Mapping[str, str] = field(default_factory=dict)
    low: tuple[Part, ...] = ()
    textures: str = "../../textures/"
    origin: Mapping[str, str] = field(default_factory=lambda: {"source": f"made by {MADE_BY}", "licence": LICENCE})

    def triangles(self) -> int:
        """Number of triangles."""
        return sum(len(p.faces) for p in self.parts)


def write_component(component: Component, models: Path) -> Path:
    """Write the component below the folder `models`; gives its interface layer."""
    folder = models / component.name
    meshes = by_material(component.parts)
    geometry = f"{component.name}.geometry.usdc"
    write_whole(folder / geometry, lambda path: _write_geometry(component, meshes, path))
    if component.low:
        write_whole(folder / f"{component.name}.low.usdc", lambda path: _write_geometry(component, by_material(component.low), path))
    target = folder / f"{component.name}.usda"
    write_whole(target, lambda path: _write_interface(component, meshes, geometry, path))
    return target


def author_material(stage: Usd.Stage, path: Sdf.Path, material: Material, *, textures: str, skip: frozenset[str] = frozenset()) -> UsdShade.Material:
    """A UsdPreviewSurface at `path`; inputs named in `skip` are left to variants."""
    result = UsdShade.Material.Define(stage, path)
    shader = UsdShade.Shader.Define(stage, path.AppendChild("Surface"))
    shader.CreateIdAttr("UsdPreviewSurface")
    result.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")

    def put(name: str, kind: Sdf.ValueTypeName, value: object) -> None:
        shader.CreateInput(name, kind)
        if name not in skip:
            shader.GetInput(name).Set(value)

    if material.texture:
        image = _author_image(stage, path, "Colour", textures + material.texture, "sRGB", material.colour)
        shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(image, "rgb")
    else:
        put("diffuseColor", Sdf.ValueTypeNames.Color3f, Gf.Vec3f(*material.colour))
    if material.gloss:
        image = _author_image(stage, path, "Roughness", textures + material.gloss, "raw", (1.0, 1.0, 1.0))
        shader.CreateInput("roughness", Sdf.ValueTypeNames.Float).ConnectToSource(image, "r")
    else:
        put("roughness", Sdf.ValueTypeNames.Float, material.roughness)
    if material.emission_texture:
        image = _author_image(stage, path, "Emission", textures + material.emission_texture, "sRGB", material.emission)
        shader.CreateInput("emissiveColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(image, "rgb")
    elif any(material.emission):
        put("emissiveColor", Sdf.ValueTypeNames.Color3f, Gf.Vec3f(*material.emission))
    if material.metallic:
        put("metallic", Sdf.ValueTypeNames.Float, material.metallic)
    if material.clearcoat:
        put("clearcoat", Sdf.ValueTypeNames.Float, material.clearcoat)
        put("clearcoatRoughness", Sdf.ValueTypeNames.Float, 0.03)
    put("ior", Sdf.ValueTypeNames.Float, material.ior)
    return result


def author_mesh(stage: Usd.Stage, path: Sdf.Path, part: Part) -> UsdGeom.Mesh:
    """The part as a polygon mesh with extent, and normals and st where it has them."""
    mesh = UsdGeom.Mesh.Define(stage, path)
    points = np.round(part.points, 5).astype(np.float32)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(part.faces), 3, dtype=np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(part.faces.astype(np.int32).ravel()))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateDoubleSidedAttr(True)
    mesh.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.stack([points.min(axis=0), points.max(axis=0)])))
    if part.normals is not None:
        normals = np.round(part.normals, 3).astype(np.float32)
        mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(normals))
        mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    if part.uv is not None:
        st = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex)
        st.Set(Vt.Vec2fArray.FromNumpy(np.round(part.uv, 4).astype(np.float32)))
    return mesh


def author_lamp(stage: Usd.Stage, path: Sdf.Path, lamp: Lamp) -> UsdLux.DiskLight:
    """The lamp as a disk light; intensity [cd] over its area gives the nits that UsdLux wants."""
    light = UsdLux.DiskLight.Define(stage, path)
    light.CreateRadiusAttr(lamp.radius_m)
    light.CreateIntensityAttr(round(lamp.candela / (np.pi * lamp.radius_m**2), 1))
    light.CreateColorAttr(Gf.Vec3f(*lamp.colour))
    shaping = UsdLux.ShapingAPI.Apply(light.GetPrim())
    shaping.CreateShapingConeAngleAttr(lamp.cone_deg)
    shaping.CreateShapingConeSoftnessAttr(lamp.softness)
    UsdGeom.Xformable(light).AddTransformOp().Set(Gf.Matrix4d(np.round(lamp.place.T, 6).tolist()))
    light.CreateExtentAttr(UsdGeom.Boundable.ComputeExtentFromPlugins(light, Usd.TimeCode.Default()))
    return light


def label(prim: Usd.Prim, name: str) -> None:
    """Give a prim its Cityscapes name."""
    UsdSemantics.LabelsAPI.Apply(prim, "cityscapes").CreateLabelsAttr().Set([name])


def new_stage(about: str, path: Path, origin: Mapping[str, str] | None = None) -> Usd.Stage:
    """An empty stage at `path`, in metres and Z up, that says where it is from; `Save` its root layer."""
    layer = Sdf.Layer.CreateNew(str(path))
    stage = Usd.Stage.Open(layer)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    layer.documentation = about
    layer.customLayerData = dict(origin) if origin else {"source": f"made by {MADE_BY}", "licence": LICENCE}
    return stage


def _write_geometry(component: Component, meshes: Mapping[str, Part], path: Path) -> None:
    stage = new_stage(f"Meshes of {component.name}.", path, component.origin)
    root = UsdGeom.Scope.Define(stage, "/Geometry")
    stage.SetDefaultPrim(root.GetPrim())
    for name, part in meshes.items():
        author_mesh(stage, Sdf.Path(f"/Geometry/{name}"), part)
    stage.GetRootLayer().Save()


def _write_interface(component: Component, meshes: Mapping[str, Part], geometry: str, path: Path) -> None:
    stage = new_stage(component.about, path, component.origin)
    root = UsdGeom.Xform.Define(stage, f"/{component.name}")
    prim = root.GetPrim()
    stage.SetDefaultPrim(prim)
    model = Usd.ModelAPI(prim)
    model.SetKind(Kind.Tokens.component)
    model.SetAssetName(component.name)
    model.SetAssetIdentifier(Sdf.AssetPath(f"./{component.name}.usda"))
    prim.SetDocumentation(component.about)
    label(prim, component.label)
    scope = UsdGeom.Scope.Define(stage, prim.GetPath().AppendChild("Geometry"))
    if not component.low:
        scope.GetPrim().GetReferences().AddReference(f"./{geometry}")

    looks = [look for choices in component.variants.values() for look in choices.values()]
    rebound = {mesh for look in looks for mesh in look.bindings}
    needed = list(dict.fromkeys([*(n for n in meshes if n not in rebound), *(m for look in looks for m in look.bindings.values())]))
    materials = prim.GetPath().AppendChild("Materials")
    UsdGeom.Scope.Define(stage, materials)
    for name in needed:
        skip = frozenset(key for look in looks for key in look.materials.get(name, {}))
        material = component.materials.get(name) or PALETTE[name]
        author_material(stage, materials.AppendChild(name), material, textures=component.textures, skip=skip)
    for name in meshes:
        if name not in rebound:
            _bind(stage, scope.GetPath().AppendChild(name), materials.AppendChild(name))
    for name, other in component.labels.items():
        label(stage.OverridePrim(scope.GetPath().AppendChild(name)), other)
    for set_name, choices in component.variants.items():
        variants = prim.GetVariantSets().AddVariantSet(set_name)
        for variant, look in choices.items():
            variants.AddVariant(variant)
            variants.SetVariantSelection(variant)
            with variants.GetVariantEditContext():
                _author_look(stage, prim, look)
        variants.SetVariantSelection(next(iter(choices)))
    if component.low:
        _author_lod(prim, scope.GetPrim(), {"full": geometry, "low": f"{component.name}.low.usdc"})
    stage.GetRootLayer().Save()


def _author_lod(prim: Usd.Prim, scope: Usd.Prim, files: Mapping[str, str]) -> None:
    variants = prim.GetVariantSets().AddVariantSet("lod")
    for variant, file in files.items():
        variants.AddVariant(variant)
        variants.SetVariantSelection(variant)
        with variants.GetVariantEditContext():
            scope.GetReferences().AddReference(f"./{file}")
    variants.SetVariantSelection("full")


def _author_look(stage: Usd.Stage, prim: Usd.Prim, look: Look) -> None:
    materials = prim.GetPath().AppendChild("Materials")
    for name, inputs in look.materials.items():
        shader = UsdShade.Shader(stage.OverridePrim(materials.AppendChild(name).AppendChild("Surface")))
        for key, value in inputs.items():
            kind = Sdf.ValueTypeNames.Color3f if isinstance(value, tuple) else Sdf.ValueTypeNames.Float
            shader.CreateInput(key, kind).Set(Gf.Vec3f(*value) if isinstance(value, tuple) else value)
    for mesh, material in look.bindings.items():
        _bind(stage, prim.GetPath().AppendPath(f"Geometry/{mesh}"), materials.AppendChild(material))
    if look.lamps:
        lamps = UsdGeom.Scope.Define(stage, prim.GetPath().AppendChild("Lamps"))
        for lamp in look.lamps:
            author_lamp(stage, lamps.GetPath().AppendChild(lamp.name), lamp)


def _bind(stage: Usd.Stage, mesh: Sdf.Path, material: Sdf.Path) -> None:
    prim = stage.OverridePrim(mesh)
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(UsdShade.Material(stage.GetPrimAtPath(material)))


def _author_image(stage: Usd.Stage, material: Sdf.Path, name: str, file: str, space: str, factor: Colour) -> UsdShade.ConnectableAPI:
    reader = UsdShade.Shader.Define(stage, material.AppendChild("Coordinates"))
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
    reader.CreateOutput("result", Sdf.ValueTypeNames.Float2)
    image = UsdShade.Shader.Define(stage, material.AppendChild(name))
    image.CreateIdAttr("UsdUVTexture")
    image.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(Sdf.AssetPath(file))
    image.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set(space)
    image.CreateInput("wrapS", Sdf.ValueTypeNames.Token).Set("repeat")
    image.CreateInput("wrapT", Sdf.ValueTypeNames.Token).Set("repeat")
    image.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(reader.ConnectableAPI(), "result")
    if factor != (1.0, 1.0, 1.0):
        image.CreateInput("scale", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(*factor, 1.0))
    image.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
    image.CreateOutput("r", Sdf.ValueTypeNames.Float)
    return image.ConnectableAPI()
