"""Skinned characters: posed at the frame, on a stage of our own.

Takes a stage; gives one whose skinned meshes stand as posed.  The input stage and
all its layers stay as they are: the pose goes to a copy of the session layer.
"""

from __future__ import annotations

from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel

from synfog_usd.base.errors import StageError
from synfog_usd.translate.diagnostics import Diagnostics

MAX_PRIMS = 2_000_000
"""Prims that are searched for characters, those of instances counted."""


def posed(stage: Usd.Stage, time: Usd.TimeCode, notes: Diagnostics) -> Usd.Stage:
    """The stage itself where nothing is skinned, else a copy of it with the pose baked in."""
    if not has_skeletons(stage):
        return stage
    roots = []
    for count, prim in enumerate(Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies())):
        if count > MAX_PRIMS:
            raise StageError(
                f"{prim.GetPath()}: more than {MAX_PRIMS} prims, instances counted, on a stage with skeletons; make it "
                f"smaller"
            )
        if prim.IsA(UsdSkel.Root):
            roots.append(prim)
    copy = _copy(stage)
    with Usd.EditContext(copy, Usd.EditTarget(copy.GetSessionLayer())):
        for root in roots:
            _open_instances(copy, root.GetPath())
        moment = time.GetValue() if not time.IsDefault() else 0.0
        for prim in Usd.PrimRange(copy.GetPseudoRoot()):
            if prim.IsA(UsdSkel.Animation):
                _give_key(prim, moment)
            elif prim.IsA(UsdGeom.Mesh) and prim.HasAPI(UsdSkel.BindingAPI):
                _give_normals(UsdGeom.Mesh(prim), time)
        if not UsdSkel.BakeSkinning(Usd.PrimRange(copy.GetPseudoRoot()), Gf.Interval(moment, moment)):
            for root in roots:
                notes.warn(root.GetPath(), "the pose cannot be computed; the character stands as it was modelled")
            return stage
    return copy


def _give_key(animation: Usd.Prim, moment: float) -> None:
    """Write what an animation is at a moment as a key of its own: BakeSkinning passes over a moment that has none."""
    for name in ("translations", "rotations", "scales", "blendShapeWeights"):
        attribute = animation.GetAttribute(name)
        value = attribute.Get(moment) if attribute.GetNumTimeSamples() else None
        if value is not None:
            attribute.Set(value, moment)


def _give_normals(mesh: UsdGeom.Mesh, time: Usd.TimeCode) -> None:
    """Move `primvars:normals` to `normals`: BakeSkinning turns only these with the bones."""
    primvar = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("normals")
    if primvar and primvar.HasValue():
        normals, interpolation = primvar.ComputeFlattened(time), primvar.GetInterpolation()
        primvar.GetAttr().Block()
        mesh.GetNormalsAttr().Clear()
        if normals is not None and interpolation in (UsdGeom.Tokens.vertex, UsdGeom.Tokens.faceVarying):
            mesh.CreateNormalsAttr(normals)
            mesh.SetNormalsInterpolation(interpolation)


def has_skeletons(stage: Usd.Stage) -> bool:
    """Whether anything on a stage is posed by bones."""
    return any(
        prim.IsA(UsdSkel.Root) for top in [stage.GetPseudoRoot(), *stage.GetPrototypes()] for prim in Usd.PrimRange(top)
    )


def _copy(stage: Usd.Stage) -> Usd.Stage:
    session = Sdf.Layer.CreateAnonymous("pose.usda")
    session.TransferContent(stage.GetSessionLayer())
    copy = Usd.Stage.OpenMasked(
        stage.GetRootLayer(), session, stage.GetPathResolverContext(), stage.GetPopulationMask(), Usd.Stage.LoadNone
    )
    copy.SetLoadRules(stage.GetLoadRules())
    for identifier in stage.GetMutedLayers():
        copy.MuteLayer(identifier)
    return copy


def _open_instances(stage: Usd.Stage, path: Sdf.Path) -> None:
    """Make the instances around a path ordinary prims, outermost first: a pose cannot be written into a prototype."""
    for prefix in path.GetPrefixes():
        prim = stage.GetPrimAtPath(prefix)
        if prim and prim.IsInstance():
            prim.SetInstanceable(False)
