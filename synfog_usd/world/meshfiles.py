"""A user's mesh file as triangles and materials: glTF, OBJ, PLY by trimesh, USD by itself.

What cannot be read is one error; notes say what is left out.  The command reads in a child with limits, which end a
file that unfolds without end.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pxr import Ar, Sdf, Tf, Usd, UsdGeom, UsdShade, UsdUtils

from synfog_usd.base.arrays import Array
from synfog_usd.base.arrays import Indices as Index
from synfog_usd.base.colour import srgb_decode
from synfog_usd.base.errors import StageError, SynfogError
from synfog_usd.base.fence import Fence
from synfog_usd.world.materials import Colour, Material
from synfog_usd.world.shapes import Part

if TYPE_CHECKING:
    import trimesh
    from PIL import Image

MOST_PICTURE_PX = 80_000_000
MOST_TEXTURE_PX = 4096
"""Longer sides are scaled down to this."""
MESHES = (".glb", ".gltf", ".obj", ".ply")
STAGES = (".usd", ".usda", ".usdc", ".usdz")


@dataclass
class MeshFile:
    """What a file holds, in its own units and axes.

    Attributes:
        parts: triangles, one or more for each material.
        materials: by name; `pictures` holds what their `texture` names.
        metres_per_unit, up, front: what the file or its format says, or None.
        notes: what was left out or made simpler.
    """

    parts: list[Part] = field(default_factory=list)
    materials: dict[str, Material] = field(default_factory=dict)
    pictures: dict[str, Image.Image] = field(default_factory=dict)
    metres_per_unit: float | None = None
    up: str | None = None
    front: str | None = None
    notes: list[str] = field(default_factory=list)


def read(file: Path) -> MeshFile:
    """All triangles of a file.

    Raises:
        StageError: it is missing, of another kind, damaged or empty.
    """
    kind = file.suffix.lower()
    if kind not in MESHES + STAGES:
        raise StageError(f"{file}: not a kind of file that can be imported; allowed are {', '.join(MESHES + STAGES)}")
    if not file.is_file():
        raise StageError(f"{file}: no such file")
    model = _of_stage(file) if kind in STAGES else _of_mesh(file, kind)
    if not sum(len(p.faces) for p in model.parts):
        raise StageError(f"{file}: no triangles in it; export the model as a mesh")
    if not all(np.isfinite(p.points).all() for p in model.parts):
        raise StageError(f"{file}: points that are not finite numbers; export it again")
    for name, picture in model.pictures.items():
        _decode(file, name, picture)
    return model


def _decode(file: Path, name: str, picture: Image.Image) -> None:
    """Read a picture now, since its library does so only when its pixels are wanted."""
    width, height = picture.size
    if width * height > MOST_PICTURE_PX:
        raise StageError(
            f"{file}: picture {name} of {width} x {height} pixels, more than the {MOST_PICTURE_PX:,} that are read; "
            f"scale it down"
        )
    try:
        picture.load()
    except Exception as error:  # a damaged picture can fail anywhere in its decoder
        raise StageError(f"{file}: picture {name} cannot be read ({_short(error)}); save it again as PNG") from error


def _short(error: BaseException) -> str:
    text = " ".join(str(error).split()) or type(error).__name__
    quoted = re.search(r" in file \S+ : '(.*?)'( |$)", text)  # what USD says, without where in its code
    text = quoted[1] if quoted else text
    return text if len(text) < 140 else text[:137] + "..."


def _of_mesh(file: Path, kind: str) -> MeshFile:
    import trimesh

    class Beside(trimesh.resolvers.FilePathResolver):
        """Opens what lies below the folder of the file, and nothing else."""

        def get(self, name: str) -> bytes:
            if not (file.parent / name).resolve().is_relative_to(file.parent.resolve()):
                raise ValueError(f"refers to {name}, outside its own folder")
            return bytes(super().get(name))

    try:
        scene = trimesh.load_scene(str(file), process=False, resolver=Beside(str(file)))
        meshes = [g for g in scene.dump() if isinstance(g, trimesh.Trimesh)]
        model = MeshFile()
        if kind in (".glb", ".gltf"):
            model.metres_per_unit, model.up, model.front = 1.0, "+Y", "+Z"  # glTF 2.0, section 3.4
        for mesh in meshes:
            if len(mesh.faces):
                _take(model, mesh)
    except Exception as error:  # a damaged file can fail anywhere in its reader
        raise StageError(f"{file}: cannot be read ({_short(error)}); export it again, as .glb if you can") from error
    return model


def _take(model: MeshFile, mesh: trimesh.Trimesh) -> None:
    """Add a mesh of trimesh with its material."""
    import trimesh

    visual = mesh.visual
    look = getattr(visual, "material", None)
    picture = None
    if look is None:
        colour = (0.3, 0.3, 0.3)
        if isinstance(visual, trimesh.visual.ColorVisuals) and visual.defined:
            colour = _linear(np.asarray(visual.main_color[:3]) / 255.0)
            if "colours of vertices became one" not in model.notes:
                model.notes.append("colours of vertices became one")
        surface = Material(colour, 0.6)
    else:
        physical = hasattr(look, "baseColorFactor")
        rgb = np.asarray(look.main_color[:3]) / 255.0
        picture = look.baseColorTexture if physical else look.image
        metallic = look.metallicFactor if physical and look.metallicFactor is not None else 0.0
        rough = look.roughnessFactor if physical and look.roughnessFactor is not None else (1.0 if physical else 0.6)
        # factors of glTF are linear, colours of OBJ are meant for the screen; under a picture OBJ's is not a factor
        colour = _colour(rgb) if physical else _linear(rgb)
        if picture is not None and not (physical and look.baseColorFactor is not None):
            colour = (1.0, 1.0, 1.0)
        surface = Material(colour, float(rough), float(metallic))
    uv = getattr(visual, "uv", None) if picture is not None else None
    uv = np.asarray(uv, dtype=np.float64) if uv is not None and len(uv) == len(mesh.vertices) else None
    name = _material(model, str(getattr(look, "name", "") or "surface"), surface, picture if uv is not None else None)
    model.parts.append(
        Part(np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64), name, uv)
    )


def _linear(srgb: Array) -> tuple[float, float, float]:
    """sRGB (IEC 61966-2-1) as linear light."""
    r, g, b = srgb_decode(np.asarray(srgb, dtype=np.float64))
    return float(r), float(g), float(b)


def _material(model: MeshFile, title: str, look: Material, picture: Image.Image | None) -> str:
    """The name under which a material is kept; the same look twice is one."""
    base = Tf.MakeValidIdentifier(title) or "surface"
    for number in range(1, 100_000):
        name = base if number == 1 else f"{base}_{number}"
        if picture is not None:
            look = replace(look, texture=f"{name}.png")
        if name not in model.materials:
            model.materials[name] = look
            if picture is not None:
                model.pictures[look.texture] = picture
            return name
        if model.materials[name] == look and (picture is None or model.pictures[look.texture] is picture):
            return name
    raise ValueError("too many materials")


def _of_stage(file: Path) -> MeshFile:
    """Every visible mesh of a USD stage, in the stage's own units."""
    try:
        _check_fence(file)
        layer = Sdf.Layer.FindOrOpen(str(file))
        stage = Usd.Stage.Open(layer) if layer else None
        if not stage:
            raise StageError(f"{file}: not a USD file, or damaged")
        info = layer.pseudoRoot.GetInfo  # of the stage itself, USD gives no number that an exporter stored as float
        model = MeshFile(metres_per_unit=float(info("metersPerUnit")), up=f"+{info('upAxis')}")
        cache = UsdGeom.XformCache(Usd.TimeCode.EarliestTime())
        for mesh in _visible(stage):
            _take_mesh(model, mesh, np.array(cache.GetLocalToWorldTransform(mesh.GetPrim())), file.parent.resolve())
    except SynfogError:
        raise
    except Exception as error:  # arrays of a damaged stage need not fit each other
        raise StageError(f"{file}: cannot be read ({_short(error)})") from error
    return model


def _check_fence(file: Path) -> None:
    """Refuse a stage that refers to a file outside of its folder, before it is composed.

    Raises:
        StageError: with the file.
    """
    fence = Fence.around(file)
    layers, assets, _ = UsdUtils.ComputeAllDependencies(Sdf.AssetPath(str(file)))
    for path in dict.fromkeys([*(layer.realPath for layer in layers), *assets]):
        outer = Ar.SplitPackageRelativePathOuter(path)[0] if Ar.IsPackageRelativePath(path) else path
        if outer and (fault := fence.fault(outer)):
            raise StageError(f"{file}: {fault.partition('; ')[0]}; copy it there")


def _visible(stage: Usd.Stage) -> Iterator[UsdGeom.Mesh]:
    for prim in stage.Traverse(Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)):
        if prim.IsA(UsdGeom.Mesh):
            image = UsdGeom.Imageable(prim)
            hidden = image.ComputeVisibility(Usd.TimeCode.EarliestTime()) == UsdGeom.Tokens.invisible
            if not hidden and image.ComputePurpose() in (UsdGeom.Tokens.default_, UsdGeom.Tokens.render):
                yield UsdGeom.Mesh(prim)


def _take_mesh(model: MeshFile, mesh: UsdGeom.Mesh, matrix: Array, folder: Path) -> None:
    time = Usd.TimeCode.EarliestTime()
    points = np.array(mesh.GetPointsAttr().Get(time) or [], dtype=np.float64).reshape(-1, 3)
    counts = np.array(mesh.GetFaceVertexCountsAttr().Get(time) or [], dtype=np.int64)
    corners = np.array(mesh.GetFaceVertexIndicesAttr().Get(time) or [], dtype=np.int64)
    if not len(points) or not len(counts):
        return
    if counts.min() < 0 or counts.sum() != len(corners) or corners.min() < 0 or corners.max() >= len(points):
        raise ValueError(f"{mesh.GetPath()}: its indices do not fit its points")
    if (
        mesh.GetSubdivisionSchemeAttr().Get() != UsdGeom.Tokens.none
        and counts.max() > 3
        and "subdivision was not applied" not in model.notes
    ):
        model.notes.append("subdivision was not applied")
    first = np.cumsum(counts) - counts
    fans = np.repeat(first, np.maximum(counts - 2, 0))
    step = np.concatenate([np.arange(1, c - 1) for c in counts]) if len(counts) else np.zeros(0, dtype=np.int64)
    triangle = np.stack([fans, fans + step, fans + step + 1], axis=1).astype(np.int64)  # into corners
    if mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded:
        triangle = triangle[:, ::-1]
    moved = points @ matrix[:3, :3] + matrix[3, :3]
    if np.linalg.det(matrix[:3, :3]) < 0:
        triangle = triangle[:, ::-1]
    subsets = UsdGeom.Subset.GetGeomSubsets(mesh, UsdGeom.Tokens.face, "materialBind")
    owner = np.repeat(np.arange(len(counts)), np.maximum(counts - 2, 0))
    unbound = np.ones(len(counts), dtype=bool)
    for prim, chosen in [
        *((s.GetPrim(), np.array(s.GetIndicesAttr().Get() or [], dtype=np.int64)) for s in subsets),
        (mesh.GetPrim(), None),
    ]:
        mask = np.zeros(len(counts), dtype=bool)
        mask[chosen if chosen is not None else unbound] = True
        unbound &= ~mask
        if mask.any():
            _take_faces(model, mesh, prim, moved, corners, triangle[mask[owner]], folder)


def _take_faces(
    model: MeshFile, mesh: UsdGeom.Mesh, prim: Usd.Prim, points: Array, corners: Index, triangle: Index, folder: Path
) -> None:
    """Add triangles, (M, 3) places among the corners, (N,) points of a mesh's faces, in the material of a prim."""
    look, picture, title = _surface(model, prim, folder)
    st = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st")
    uv = np.zeros((0, 2))
    if picture is not None and st:
        uv = np.array(st.ComputeFlattened() or [], dtype=np.float64).reshape(-1, 2)
    if len(uv) == len(corners):
        flat = triangle.ravel()
        part = Part(points[corners[flat]], np.arange(flat.size).reshape(-1, 3), "", uv[flat])
    elif len(uv) == len(points):
        part = Part(points, corners[triangle], "", uv)
    else:
        part, picture = Part(points, corners[triangle], ""), None
    model.parts.append(part.painted(_material(model, title, look, picture)))


def _surface(model: MeshFile, prim: Usd.Prim, folder: Path) -> tuple[Material, Image.Image | None, str]:
    """The UsdPreviewSurface that a prim wears: its numbers, its colour picture and its name."""
    bound = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
    source = bound.ComputeSurfaceSource() if bound else None
    shader = source[0] if source else None
    if not shader or shader.GetIdAttr().Get() != "UsdPreviewSurface":
        colours = UsdGeom.Gprim(prim).GetDisplayColorAttr().Get() if prim.IsA(UsdGeom.Gprim) else None
        return Material(_colour(colours[0]) if colours else (0.3, 0.3, 0.3), 0.6), None, "surface"

    def value(name: str) -> object:
        constant = shader.GetInput(name)
        return constant.Get() if constant and not constant.HasConnectedSource() else None

    def number(name: str, default: float) -> float:
        constant = value(name)
        return default if constant is None else float(constant)  # type: ignore[arg-type]

    colour = value("diffuseColor")
    look = Material(
        (0.18, 0.18, 0.18) if colour is None else _colour(colour),  # type: ignore[arg-type]
        number("roughness", 0.5),
        number("metallic", 0.0),
        clearcoat=number("clearcoat", 0.0),
    )
    name = bound.GetPrim().GetName()
    textured = shader.GetInput("diffuseColor")
    if not textured or not textured.HasConnectedSource():
        return look, None, name
    image = UsdShade.Shader(textured.GetConnectedSource()[0].GetPrim())
    asset = image.GetInput("file").Get() if image and image.GetInput("file") else None
    path = Path(asset.resolvedPath) if asset and asset.resolvedPath else None
    if path is None or not path.resolve().is_relative_to(folder) or not path.is_file():
        model.notes.append(
            f"{bound.GetPath()}: its picture {asset.path if asset else ''!r} is not beside the file and was left out"
        )
        return look, None, name
    from PIL import Image

    scale = image.GetInput("scale").Get() if image.GetInput("scale") else None
    factor = (1.0, 1.0, 1.0) if scale is None else _colour(scale)
    return replace(look, colour=factor), Image.open(path), name


def _colour(values: Iterable[float]) -> Colour:
    r, g, b, *_ = (float(value) for value in values)
    return r, g, b
