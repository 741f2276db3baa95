"""A box of fog around everything: paste this into Houdini's Python Script LOP, Omniverse's Script Editor or usdview's
interpreter, and change the visibility.

Untried in Houdini and Omniverse: it asks them for their stage as their manuals say, and its USD is tested.
"""

from pxr import Gf, Sdf, Usd, UsdGeom

MOR_M = 150.0
"""Visibility (meteorological optical range) [m]."""

MARGIN_M, BELOW_M = 20.0, 1.0


def stage_here():
    """The stage that is open."""
    if "usdviewApi" in globals():
        return usdviewApi.stage  # noqa: F821 - usdview's interpreter has it
    try:
        import hou

        return hou.pwd().editableStage()  # sidefx.com/docs/houdini/nodes/lop/pythonscript.html
    except ImportError:
        import omni.usd

        return omni.usd.get_context().get_stage()  # docs.omniverse.nvidia.com/kit/docs/omni.usd


def add_fog(stage, mor_m=MOR_M):
    """A Cube named Fog below the default prim, as a guide with the fog schema; the prim."""
    unit = UsdGeom.GetStageMetersPerUnit(stage)
    root = stage.GetDefaultPrim() or stage.GetPseudoRoot()
    path = root.GetPath().AppendChild("Fog")
    stage.RemovePrim(path)
    shown = [UsdGeom.Tokens.default_, UsdGeom.Tokens.render]
    boxes = UsdGeom.BBoxCache(Usd.TimeCode.EarliestTime(), shown, useExtentsHint=True)
    around = boxes.ComputeWorldBound(stage.GetPseudoRoot()).ComputeAlignedRange()
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.Camera):
            place = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.EarliestTime())
            around.UnionWith(place.ExtractTranslation())
    if around.IsEmpty():
        raise RuntimeError("the stage is empty: there is nothing for the fog to be around")
    up = "XYZ".index(UsdGeom.GetStageUpAxis(stage))
    low = Gf.Vec3d(*(around.GetMin()[k] - (BELOW_M if k == up else MARGIN_M) / unit for k in range(3)))
    high = around.GetMax() + Gf.Vec3d(MARGIN_M / unit)

    cube = UsdGeom.Cube.Define(stage, path)
    cube.CreateSizeAttr(1.0)
    cube.CreateExtentAttr([(-0.5, -0.5, -0.5), (0.5, 0.5, 0.5)])
    cube.CreatePurposeAttr(UsdGeom.Tokens.guide)
    place = Gf.Matrix4d().SetScale(high - low) * Gf.Matrix4d().SetTranslate((low + high) / 2.0)
    parent = (
        UsdGeom.Xformable(root).ComputeLocalToWorldTransform(Usd.TimeCode.EarliestTime())
        if root.GetParent()
        else Gf.Matrix4d(1.0)
    )
    cube.MakeMatrixXform().Set(place * parent.GetInverse())
    prim = cube.GetPrim()
    prim.AddAppliedSchema("SynFogMediumAPI")
    prim.CreateAttribute("synfog:fog:mor", Sdf.ValueTypeNames.Float).Set(mor_m)
    return prim


if __name__ != "fog_box":  # pasted, or run; not imported
    add_fog(stage_here())
