"""Parts and their materials, written as a USD component that a stage references.

Takes a `Component`; leaves a folder `<name>` behind, divided as the USD working group
advises (github.com/usd-wg/assets, asset-structure-guidelines.md):

- `<name>.usda`, the interface: label, variants, lamps, thumbnail; it refers to the rest;
- `<name>.mtl.usda`: materials, and which mesh wears which;
- `<name>.geo.usdc`, a payload: the meshes; `<name>.low.geo.usdc`, `.far` and `.distant`
  where there are fewer triangles to choose, `<name>.<individual>.geo.usdc` of each further individual.

The payload leads straight to the meshes, so that variants can be chosen while they are
not loaded.  The component stands on the ground at the origin and looks along +Y, in
metres, Z up.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from pxr import Gf, Kind, Sdf, Usd, UsdGeom, UsdLux, UsdMedia, UsdSemantics, UsdShade, Vt

from synfog_usd.base.files import write_whole
from synfog_usd.base.spectra import REFLECTANCE
from synfog_usd.world import lamps as street_and_vehicle
from synfog_usd.world.materials import PALETTE, Colour, Material
from synfog_usd.world.shapes import Part, by_material

MADE_BY = "synfog_usd.world"
LICENCE = "CC0-1.0"


@dataclass(frozen=True)
class MountedLamp:
    """A light that shines along its -Z: one of `world.lamps` by its name, or a shaped disk.

    Attributes:
        name: prim name.
        place: (4, 4) local matrix.
        candela: intensity on the axis [cd].
        radius_m: radius of the disk.
        cone_deg: half angle of the cone; softness: share of it that fades.
        colour: tint of luminance 1 within a few per cent.
        beam: name in `lamps.LAMPS`, which then gives all but the place, or ''.
    """

    name: str
    place: np.ndarray
    candela: float = 0.0
    radius_m: float = 0.05
    cone_deg: float = 180.0
    softness: float = 0.0
    colour: Colour = (1.0, 1.0, 1.0)
    beam: str = ""


@dataclass(frozen=True)
class Look:
    """What one variant changes.

    Attributes:
        materials: material -> (input -> value).
        bindings: mesh (by the material of its parts) -> material that it wears.
        lamps: lights that exist in this variant only.
        without: meshes that this variant leaves out.
        shifts: material with `columns` -> (u, v) by which its texture is moved.
    """

    materials: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    bindings: Mapping[str, str] = field(default_factory=dict)
    lamps: tuple[MountedLamp, ...] = ()
    without: tuple[str, ...] = ()
    shifts: Mapping[str, tuple[float, float]] = field(default_factory=dict)


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
        afar: the same plant in so few triangles that hundreds of it stand in a wood: further variants of `lod`.
        low_bindings: mesh -> material that it wears in fewer triangles; meshes that nothing shows may be missing there.
        individuals: others of its kind, of the same materials, by name; with them comes a variant set `individual`,
            whose 'a' is the thing itself.
        textures: where its pictures lie, seen from its folder.
        origin: what its files say of source and licence.
        thumbnail: whether it gets a picture, which the interface then names before it is there.
    """

    name: str
    label: str
    parts: tuple[Part, ...]
    about: str
    variants: Mapping[str, Mapping[str, Look]] = field(default_factory=dict)
    materials: Mapping[str, Material] = field(default_factory=dict)
    labels: Mapping[str, str] = field(default_factory=dict)
    low: tuple[Part, ...] = ()
    afar: Mapping[str, tuple[Part, ...]] = field(default_factory=dict)
    low_bindings: Mapping[str, str] = field(default_factory=dict)
    individuals: Mapping[str, Component] = field(default_factory=dict)
    textures: str = "../../textures/"
    origin: Mapping[str, str] = field(default_factory=lambda: {"source": f"made by {MADE_BY}", "licence": LICENCE})
    thumbnail: bool = True

    def triangles(self) -> int:
        """Number of triangles."""
        return sum(len(p.faces) for p in self.parts)


def write_component(component: Component, models: Path) -> Path:
    """Write the component below the folder `models`; gives its interface layer."""
    folder = models / component.name
    meshes = by_material(component.parts)
    for suffix, individual in (("", component), *component.individuals.items()):
        for level, file in _geometry_files(component.name, individual, suffix).items():
            parts = by_material({"full": individual.parts, "low": individual.low, **individual.afar}[level])
            if not set(parts) <= set(meshes):
                raise ValueError(f"{component.name}: {file} has other materials than the rest")
            write_whole(folder / file, functools.partial(_write_geometry, component, parts))
    write_whole(folder / _material_file(component.name), functools.partial(_write_materials, component, meshes))
    target = folder / f"{component.name}.usda"
    write_whole(target, functools.partial(_write_interface, component))
    return target


def _geometry_files(name: str, component: Component, individual: str = "") -> dict[str, str]:
    """Level of detail -> file of meshes."""
    stem = f"{name}.{individual}" if individual else name
    levels = (*(("low",) if component.low else ()), *component.afar)
    return {"full": f"{stem}.geo.usdc"} | {level: f"{stem}.{level}.geo.usdc" for level in levels}


def thumbnail_file(name: str) -> str:
    """Where the picture of a model lies, seen from its folder."""
    return f"thumbnails/{name}.png"


def _material_file(name: str) -> str:
    return f"{name}.mtl.usda"


def author_material(stage: Usd.Stage, path: Sdf.Path, material: Material, *, textures: str) -> UsdShade.Material:
    """A UsdPreviewSurface at `path`."""
    result = UsdShade.Material.Define(stage, path)
    shader = UsdShade.Shader.Define(stage, path.AppendChild("Surface"))
    shader.CreateIdAttr("UsdPreviewSurface")
    result.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")

    def put(name: str, kind: Sdf.ValueTypeName, value: object) -> None:
        shader.CreateInput(name, kind).Set(value)

    if material.texture:
        image = _author_image(
            stage, path, "Colour", textures + material.texture, "sRGB", material.colour, material.columns
        )
        shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(image, "rgb")
    else:
        put("diffuseColor", Sdf.ValueTypeNames.Color3f, Gf.Vec3f(*material.colour))
    if material.gloss:
        image = _author_image(stage, path, "Roughness", textures + material.gloss, "raw", (material.gloss_factor,) * 3)
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
        put("clearcoatRoughness", Sdf.ValueTypeNames.Float, material.clearcoat_roughness)
    put("ior", Sdf.ValueTypeNames.Float, material.ior)
    if material.opacity < 1.0:
        put("opacity", Sdf.ValueTypeNames.Float, material.opacity)
        put("opacityMode", Sdf.ValueTypeNames.Token, "presence")
    if material.spectrum:
        result.GetPrim().CreateAttribute(REFLECTANCE, Sdf.ValueTypeNames.Token).Set(material.spectrum)
    return result


def author_mesh(stage: Usd.Stage, path: Sdf.Path, part: Part, *, double_sided: bool = True) -> UsdGeom.Mesh:
    """The part as a polygon mesh with extent, and normals and st where it has them; points of no face are left out."""
    mesh = UsdGeom.Mesh.Define(stage, path)
    faces = part.faces[
        (part.faces != np.roll(part.faces, 1, axis=1)).all(axis=1)
    ]  # a corner that stands twice makes Blender 5 repair the mesh, or crash
    used, faces = np.unique(faces, return_inverse=True)  # what only such faces had has no direction to face
    faces = faces.reshape(-1, 3)
    points = np.round(part.points[used], 5).astype(np.float32)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, dtype=np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.astype(np.int32).ravel()))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateDoubleSidedAttr(double_sided)
    if len(points):
        mesh.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.stack([points.min(axis=0), points.max(axis=0)])))
    if part.normals is not None:
        normals = np.round(part.normals[used], 3).astype(np.float32)
        mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(normals))
        mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    if part.uv is not None:
        st = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex)
        st.Set(Vt.Vec2fArray.FromNumpy(np.round(part.uv[used], 4).astype(np.float32)))
    return mesh


def author_lamp(
    stage: Usd.Stage, path: Sdf.Path, lamp: MountedLamp, *, lamps: str = "../../lamps"
) -> UsdLux.BoundableLightBase:
    """The lamp as a light; intensity [cd] over its area gives the nits that UsdLux wants.

    lamps: folder of the IES files as the stage's layer refers to it.
    """
    if lamp.beam:
        return street_and_vehicle.author_lamp(stage, path, lamp.beam, lamp.place, lamps=lamps)
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
    lit = _lit_meshes(component, meshes)
    for name, part in meshes.items():
        author_mesh(stage, Sdf.Path(f"/Geometry/{name}"), part, double_sided=name not in lit)
    stage.GetRootLayer().Save()


def _lit_meshes(component: Component, meshes: Iterable[str]) -> set[str]:
    """Meshes that shine in some look.  Such a sheet has one side: its back would light the housing behind it, which
    few paths meet and which is as bright as the lamp.
    """
    looks = [look for choices in component.variants.values() for look in choices.values()]
    worn = [*((name, name) for name in meshes), *(pair for look in looks for pair in look.bindings.items())]
    lit = {name for look in looks for name, inputs in look.materials.items() if "emissiveColor" in inputs}
    materials = {**PALETTE, **component.materials}
    lit |= {name for _, name in worn if name in materials and any(materials[name].emission)}
    return {mesh for mesh, material in worn if material in lit}


def _write_materials(component: Component, meshes: Mapping[str, Part], path: Path) -> None:
    """All materials, and the bindings that no variant changes; those of variants are stronger than what a reference
    brings.
    """
    stage = new_stage(f"Materials of {component.name}.", path, component.origin)
    prim = UsdGeom.Xform.Define(stage, f"/{component.name}").GetPrim()
    stage.SetDefaultPrim(prim)
    looks = [look for choices in component.variants.values() for look in choices.values()]
    rebound = {mesh for look in looks for mesh in look.bindings}
    worn = [*(m for look in looks for m in look.bindings.values()), *component.low_bindings.values()]
    materials = prim.GetPath().AppendChild("Materials")
    stage.OverridePrim(prim.GetPath().AppendChild("Geometry"))  # before the materials, as in the interface
    UsdGeom.Scope.Define(stage, materials)
    for name in dict.fromkeys([*(n for n in meshes if n not in rebound), *worn]):
        author_material(
            stage,
            materials.AppendChild(name),
            component.materials.get(name) or PALETTE[name],
            textures=component.textures,
        )
    for name in meshes:
        if name not in rebound:
            _bind(stage, prim, name, name)
    stage.GetRootLayer().Save()


def _write_interface(component: Component, path: Path) -> None:
    stage = new_stage(component.about, path, component.origin)
    root = UsdGeom.Xform.Define(stage, f"/{component.name}")
    prim = root.GetPrim()
    stage.SetDefaultPrim(prim)
    model = Usd.ModelAPI(prim)
    model.SetKind(Kind.Tokens.component)
    model.SetAssetName(component.name)
    model.SetAssetIdentifier(Sdf.AssetPath(f"./{component.name}.usda"))
    if component.thumbnail:
        picture = UsdMedia.AssetPreviewsAPI.Thumbnails(
            defaultImage=Sdf.AssetPath(f"./{thumbnail_file(component.name)}")
        )
        UsdMedia.AssetPreviewsAPI.Apply(prim).SetDefaultThumbnails(picture)
    prim.SetDocumentation(component.about)
    label(prim, component.label)
    prim.GetReferences().AddReference(f"./{_material_file(component.name)}")
    scope = UsdGeom.Scope.Define(stage, prim.GetPath().AppendChild("Geometry"))
    files = _geometry_files(component.name, component)
    if not component.low and not component.individuals:
        scope.GetPrim().GetPayloads().AddPayload(f"./{files['full']}")
    for name, mesh_label in component.labels.items():
        label(stage.OverridePrim(scope.GetPath().AppendChild(name)), mesh_label)
    for set_name, choices in component.variants.items():
        variants = prim.GetVariantSets().AddVariantSet(set_name)
        for variant, look in choices.items():
            variants.AddVariant(variant)
            variants.SetVariantSelection(variant)
            with variants.GetVariantEditContext():
                _author_look(stage, prim, look)
        variants.SetVariantSelection(next(iter(choices)))
    if component.individuals:
        _author_individuals(stage, prim, component)
    elif component.low:
        _author_lod(stage, prim, component, files)
    stage.GetRootLayer().Save()


def _author_individuals(stage: Usd.Stage, prim: Usd.Prim, component: Component) -> None:
    variants = prim.GetVariantSets().AddVariantSet("individual")
    for name, individual in (("a", component), *component.individuals.items()):
        variants.AddVariant(name)
        variants.SetVariantSelection(name)
        with variants.GetVariantEditContext():
            files = _geometry_files(component.name, individual, "" if individual is component else name)
            if individual.low:
                _author_lod(stage, prim, individual, files)
            else:
                prim.GetChild("Geometry").GetPayloads().AddPayload(f"./{files['full']}")
    variants.SetVariantSelection("a")


def _author_lod(stage: Usd.Stage, prim: Usd.Prim, component: Component, files: Mapping[str, str]) -> None:
    variants = prim.GetVariantSets().AddVariantSet("lod")
    for variant, file in files.items():
        variants.AddVariant(variant)
        variants.SetVariantSelection(variant)
        with variants.GetVariantEditContext():
            prim.GetChild("Geometry").GetPayloads().AddPayload(f"./{file}")
            for mesh, material in component.low_bindings.items() if variant == "low" else ():
                _bind(stage, prim, mesh, material)
    variants.SetVariantSelection("full")


def _author_look(stage: Usd.Stage, prim: Usd.Prim, look: Look) -> None:
    materials = prim.GetPath().AppendChild("Materials")
    for name, inputs in look.materials.items():
        shader = UsdShade.Shader(stage.OverridePrim(materials.AppendChild(name).AppendChild("Surface")))
        for key, value in inputs.items():
            kind = Sdf.ValueTypeNames.Color3f if isinstance(value, tuple) else Sdf.ValueTypeNames.Float
            shader.CreateInput(key, kind).Set(Gf.Vec3f(*value) if isinstance(value, tuple) else value)
    for name, (u, v) in look.shifts.items():
        place = UsdShade.Shader(stage.OverridePrim(materials.AppendChild(name).AppendChild("Place")))
        place.CreateInput("translation", Sdf.ValueTypeNames.Float2).Set(Gf.Vec2f(u, v))
    for mesh, material in look.bindings.items():
        _bind(stage, prim, mesh, material)
    for mesh in look.without:
        stage.OverridePrim(prim.GetPath().AppendPath(f"Geometry/{mesh}")).SetActive(False)
    if look.lamps:
        lamps = UsdGeom.Scope.Define(stage, prim.GetPath().AppendChild("Lamps"))
        for lamp in look.lamps:
            author_lamp(stage, lamps.GetPath().AppendChild(lamp.name), lamp)


def _bind(stage: Usd.Stage, prim: Usd.Prim, mesh: str, material: str) -> None:
    bound = UsdShade.Material(stage.GetPrimAtPath(prim.GetPath().AppendPath(f"Materials/{material}")))
    UsdShade.MaterialBindingAPI.Apply(stage.OverridePrim(prim.GetPath().AppendPath(f"Geometry/{mesh}"))).Bind(bound)


def _author_image(
    stage: Usd.Stage, material: Sdf.Path, name: str, file: str, space: str, factor: Colour, columns: int = 1
) -> UsdShade.ConnectableAPI:
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
    source = reader.ConnectableAPI()
    if columns > 1:
        place = UsdShade.Shader.Define(stage, material.AppendChild("Place"))
        place.CreateIdAttr("UsdTransform2d")
        place.CreateInput("in", Sdf.ValueTypeNames.Float2).ConnectToSource(source, "result")
        place.CreateInput("scale", Sdf.ValueTypeNames.Float2).Set(Gf.Vec2f(1.0 / columns, 1.0))
        place.CreateInput("translation", Sdf.ValueTypeNames.Float2).Set(Gf.Vec2f(0.0, 0.0))
        place.CreateOutput("result", Sdf.ValueTypeNames.Float2)
        source = place.ConnectableAPI()
    image.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(source, "result")
    if factor != (1.0, 1.0, 1.0):
        image.CreateInput("scale", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(*factor, 1.0))
    image.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
    image.CreateOutput("r", Sdf.ValueTypeNames.Float)
    return image.ConnectableAPI()
