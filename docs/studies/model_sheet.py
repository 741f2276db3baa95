"""A stage on which models of the library stand in rows, each seen from three sides, or from one.

All stand on one plain, far from the camera, each scaled to the same room in the
picture; one render shows them all.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdShade

from synfog_usd.base import resources
from synfog_usd.world.components import author_material
from synfog_usd.world.library import LibraryModel
from synfog_usd.world.materials import Material

VIEWS_DEG = (150.0, 90.0, -35.0)
"""Headings, counter-clockwise, of a model that looks along +Y when the camera does too: front quarter, side, back
quarter.
"""
ELEVATION_DEG = 20.0
DISTANCE = 2500.0
CELL_PX = (118, 108)
ROOM = (1.46, 1.10)
"""Width and height that a model may take in its cell, of a cell 1.5 wide."""
CELL = 1.5
LIFT = 0.01
"""Between the plain and a model of ground, which would vanish in it."""
SKY_NITS = 3000.0
GROUPS = ("vehicle", "person", "rider", "lamp", "sign", "furniture", "plant", "building")


def ordered(models: Sequence[LibraryModel]) -> list[LibraryModel]:
    """By group and size, without the ground of the crossing and its fallen leaf."""
    return sorted(
        (m for m in models if m.group in GROUPS and m.height > 0.1),
        key=lambda m: (GROUPS.index(m.group), m.label, m.length * m.height, m.name),
    )


def write_stage(
    path: Path,
    models: Sequence[LibraryModel],
    columns: int,
    *,
    views_deg: Sequence[float] = VIEWS_DEG,
    cell_px: tuple[int, int] = CELL_PX,
    varied: bool = True,
) -> tuple[int, int]:
    """Write the plain with every model on it; gives the size of its picture [px].

    Args:
        path: of the stage.
        models: in rows of `columns`.
        views_deg: headings, one cell each.
        cell_px: width and height of a cell.
        varied: each in another of its paints or outfits, else in its first.
    """
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    rows = math.ceil(len(models) / columns)
    wide, high = columns * len(views_deg) * CELL, rows * CELL * cell_px[1] / cell_px[0]
    elevation = math.radians(ELEVATION_DEG)
    row_depth = high / rows / math.sin(elevation)
    for k, model in enumerate(models):
        row, column = divmod(k, columns)
        radius = math.hypot(model.length, model.width)
        across = max(_across(model, heading) for heading in views_deg)
        tall = model.height * math.cos(elevation) + radius * math.sin(elevation)
        factor = min(ROOM[0] / across, ROOM[1] / tall)
        # the foot of a cell is its front edge; a deep model is pushed back by half its depth
        y = -(row + 0.5) * row_depth + rows * row_depth / 2 - 0.27 * row_depth + 0.5 * factor * radius
        for view, heading in enumerate(views_deg):
            x = (column * len(views_deg) + view + 0.5) * CELL - wide / 2
            prim = _put(stage, f"/World/{model.name}_{view}", model, (x, y), factor, heading)
            for name in ("paint", "outfit"):  # so that not all cars are white
                if varied and name in model.variants:
                    choices = model.variants[name]
                    prim.GetVariantSets().GetVariantSet(name).SetVariantSelection(choices[k % len(choices)])
    _light(stage, 4 * max(wide, high / math.sin(elevation)))
    _watch(stage, wide, high)
    stage.GetRootLayer().Save()
    return columns * len(views_deg) * cell_px[0], rows * cell_px[1]


def _put(
    stage: Usd.Stage, path: str, model: LibraryModel, place: tuple[float, float], factor: float, heading_deg: float
) -> Usd.Prim:
    """A model with its middle over a place of the plain."""
    middle = [(low + high) / 2 for low, high in zip(model.low, model.high, strict=True)]
    up = LIFT - factor * model.low[2] if model.group == "ground" else 0.0
    matrix = Gf.Matrix4d(1.0).SetTranslate(Gf.Vec3d(-middle[0], -middle[1], 0.0))
    matrix *= Gf.Matrix4d(1.0).SetScale(factor)
    matrix *= Gf.Matrix4d(1.0).SetRotate(Gf.Rotation(Gf.Vec3d(0, 0, 1), heading_deg))
    matrix *= Gf.Matrix4d(1.0).SetTranslate(Gf.Vec3d(*place, up))
    xform = UsdGeom.Xform.Define(stage, path)
    xform.AddTransformOp().Set(matrix)
    xform.GetPrim().GetReferences().AddReference(str(model.path.resolve()))
    xform.GetPrim().SetInstanceable(True)
    return xform.GetPrim()


def _light(stage: Usd.Stage, reach: float) -> None:
    """The plain, so far to each side, and an overcast sky."""
    ground = UsdGeom.Mesh.Define(stage, "/World/Ground")
    ground.CreatePointsAttr([(-reach, -reach, 0), (reach, -reach, 0), (reach, reach, 0), (-reach, reach, 0)])
    ground.CreateFaceVertexCountsAttr([4])
    ground.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
    grey = author_material(stage, Sdf.Path("/World/Ground/Grey"), Material((0.17, 0.17, 0.17), 1.0), textures="")
    UsdShade.MaterialBindingAPI.Apply(ground.GetPrim()).Bind(grey)
    dome = UsdLux.DomeLight.Define(stage, "/World/Sky")
    dome.CreateIntensityAttr(SKY_NITS)
    dome.CreateTextureFileAttr(str((resources.folder("assets") / "skies" / "overcast.exr").resolve()))
    dome.CreateTextureFormatAttr(UsdLux.Tokens.latlong)
    UsdGeom.Xformable(dome).AddRotateXOp().Set(90.0)


def _watch(stage: Usd.Stage, wide: float, high: float) -> None:
    """A camera far off, whose picture is so wide and high."""
    camera = UsdGeom.Camera.Define(stage, "/World/Camera")
    camera.CreateFocalLengthAttr(DISTANCE)
    camera.CreateHorizontalApertureAttr(wide)
    camera.CreateVerticalApertureAttr(high)
    camera.CreateClippingRangeAttr(Gf.Vec2f(1.0, 10000.0))
    elevation = math.radians(ELEVATION_DEG)
    eye = Gf.Vec3d(0, -DISTANCE * math.cos(elevation), DISTANCE * math.sin(elevation))
    look = Gf.Matrix4d(1.0).SetLookAt(eye, Gf.Vec3d(0, 0, 0), Gf.Vec3d(0, 0, 1))
    UsdGeom.Xformable(camera).AddTransformOp().Set(look.GetInverse())


def _across(model: LibraryModel, heading_deg: float) -> float:
    a = math.radians(heading_deg)
    return model.width * abs(math.cos(a)) + model.length * abs(math.sin(a))
