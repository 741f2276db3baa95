"""A layer over a stage with what of its findings can be mended without a choice.

Takes an opened stage and findings; writes one file whose sublayer is the stage's own, which stays as it is.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path

from pxr import Gf, Sdf, Usd, UsdGeom

from synfog_usd.base.errors import OutputError
from synfog_usd.base.fence import LAYERS, Fence
from synfog_usd.base.files import write_whole
from synfog_usd.stage import rules
from synfog_usd.stage.labels import TAXONOMY
from synfog_usd.stage.open import MENDED_UNITS, dependencies, unscaled_references, up_axis
from synfog_usd.stage.rulebook import Finding

_OF_SUBLAYERS = frozenset({"subLayers", "subLayerOffsets", "primChildren", "primOrder", "relocates", "layerRelocates"})
"""What a root layer says that holds from below, too."""

SCALE_OP = "xformOp:scale:unitsResolve"
"""As Omniverse names the scale that makes up for a reference's units."""


def write(
    stage: Usd.Stage,
    found: Iterable[Finding],
    out: Path,
    *,
    users: Sequence[rules.RoadUser],
    allow: Iterable[Path] = (),
) -> list[str]:
    """Write the layer.

    Mended are labels that names and sizes tell, the purpose of fog boundaries, lamps of which a number is none (they
    are dark in a bake and become so in the file), units where only one fits all road users or the layer that is
    referred to says its own, and a default prim where there is only one root.

    Args:
        stage: as its variants stand.
        found: of all its variants.
        out: to write, beside the stage or above it.
        users: road users of the stage, as `rules.fixable` measures them.
        allow: folders of other files of the stage.

    Returns:
        one line for each fix, with the prim's path; a layer without any is written, too.

    Raises:
        OutputError: a file of the stage itself, not USD by its name, or where the stage's files would lie outside.
    """
    _check(stage, out, allow)
    root = stage.GetRootLayer()
    layer = Sdf.Layer.CreateAnonymous(".usda")
    for key in root.pseudoRoot.ListInfoKeys():
        if key not in _OF_SUBLAYERS:
            layer.pseudoRoot.SetInfo(key, root.pseudoRoot.GetInfo(key))
    layer.subLayerPaths.append("./" + Path(os.path.relpath(root.realPath, out.resolve().parent)).as_posix())
    done = [*_metadata(stage, layer), *_units(stage, layer, list(users))]
    for one in found:
        prim = stage.GetPrimAtPath(one.path) if one.fix and one.path else None
        if one.fix and (prim is None or not prim.IsInstanceProxy()):  # an instance's inside is not to be reached
            done.append(_mended(layer, one.path, *one.fix))
    write_whole(out, lambda temporary: _export(layer, temporary))
    return list(dict.fromkeys(done))


def _check(stage: Usd.Stage, out: Path, allow: Iterable[Path]) -> None:
    if out.suffix.lower() not in LAYERS or out.suffix.lower() == ".usdz":
        raise OutputError(f"--fix {out}: not a layer by its name; it ends in .usda, .usdc or .usd")
    files = dependencies(stage)
    if any(out.resolve() == file.resolve() or (out.exists() and out.samefile(file)) for file in files):
        raise OutputError(f"--fix {out}: is a file of the stage itself, which stays as it is; choose another name")
    fence = Fence.around(out, allow)
    if any(fence.fault(str(file)) for file in files):
        above = os.path.commonpath([str(file.resolve().parent) for file in files])
        raise OutputError(f"--fix {out}: the stage's files lie outside of its folder; write it to {above}")


def _metadata(stage: Usd.Stage, layer: Sdf.Layer) -> list[str]:
    """What a stage ought to say of itself, where it does not: as it is read."""
    done = []
    roots = [prim for prim in stage.GetPseudoRoot().GetChildren() if prim.IsDefined()]
    if not stage.GetDefaultPrim() and len(roots) == 1:
        layer.defaultPrim = roots[0].GetName()
        done.append(f"/: defaultPrim = {roots[0].GetName()}, the only root prim")
    axis = up_axis(stage)
    if not stage.HasAuthoredMetadata("upAxis") or UsdGeom.GetStageUpAxis(stage) != axis:
        layer.pseudoRoot.SetInfo("upAxis", axis)
        done.append(f"/: upAxis = {axis}, as it was read")
    return done


def _units(stage: Usd.Stage, layer: Sdf.Layer, users: list[rules.RoadUser]) -> list[str]:
    """The unit that alone fits all road users, and references to layers that say another one than the stage's."""
    own, done = UsdGeom.GetStageMetersPerUnit(stage), []
    for prim, asset in unscaled_references(stage):
        ratio = asset.pseudoRoot.GetInfo("metersPerUnit") / own
        below = [user for user in users if user.prim.GetPath().HasPrefix(prim.GetPath())]
        if prim.IsInstanceProxy() or not all(user.fits(ratio) for user in below):
            continue
        users = [user for user in users if user not in below]
        _scale(stage, layer, prim, ratio)
        done.append(f"{prim.GetPath()}: scaled by {ratio:g}, because {Path(asset.realPath).name} is in other units")
    factors = [factor for factor in (1.0, *rules.UNIT_FACTORS) if users and all(user.fits(factor) for user in users)]
    if len(factors) == 1 and factors[0] != 1.0 and not done:
        metres = float(f"{own * factors[0]:.6g}")
        layer.pseudoRoot.SetInfo("metersPerUnit", metres)
        layer.customLayerData = {**layer.customLayerData, MENDED_UNITS: own}
        return [
            f"/: metersPerUnit = {metres:g} instead of {own:g}, the only unit in which all road users have their size"
        ]
    if not stage.HasAuthoredMetadata("metersPerUnit"):
        layer.pseudoRoot.SetInfo("metersPerUnit", own)
        done.append(f"/: metersPerUnit = {own:g}, as it was read")
    return done


def _scale(stage: Usd.Stage, layer: Sdf.Layer, prim: Usd.Prim, ratio: float) -> None:
    """A scale within what the stage says of a reference's place, and around what the file that is referred to says."""
    order = UsdGeom.Xformable(prim).GetXformOpOrderAttr()
    names = list(order.Get() or [])
    said = order.GetPropertyStack(Usd.TimeCode.Default())
    if said and said[0].layer not in stage.GetLayerStack():
        first = 1 if names[:1] == [UsdGeom.XformOpTypes.resetXformStack] else 0
        names.insert(first, SCALE_OP)
    else:
        names.append(SCALE_OP)
    spec = Sdf.CreatePrimInLayer(layer, prim.GetPath())
    Sdf.AttributeSpec(spec, SCALE_OP, Sdf.ValueTypeNames.Double3).default = Gf.Vec3d(ratio)
    _uniform(spec, "xformOpOrder", Sdf.ValueTypeNames.TokenArray, names)


def _mended(layer: Sdf.Layer, path: str, what: str, value: str) -> str:
    """Author one fix; the line that tells it."""
    spec = Sdf.CreatePrimInLayer(layer, path)
    if what == "label":
        schemas = spec.GetInfo("apiSchemas") if spec.HasInfo("apiSchemas") else Sdf.TokenListOp()
        schemas.prependedItems = [*schemas.prependedItems, f"SemanticsLabelsAPI:{TAXONOMY}"]
        spec.SetInfo("apiSchemas", schemas)
        Sdf.AttributeSpec(spec, f"semantics:labels:{TAXONOMY}", Sdf.ValueTypeNames.TokenArray).default = [value]
        return f"{path}: label {value}"
    if what == "purpose":
        _uniform(spec, "purpose", Sdf.ValueTypeNames.Token, value)
        return f"{path}: purpose = {value}"
    for name, number in (("inputs:intensity", 0.0), ("inputs:exposure", 0.0)):
        Sdf.AttributeSpec(spec, name, Sdf.ValueTypeNames.Float).default = number
    Sdf.AttributeSpec(spec, "inputs:color", Sdf.ValueTypeNames.Color3f).default = Gf.Vec3f(1.0)
    return f"{path}: intensity = 0 instead of no number, as it is drawn"


def _uniform(spec: Sdf.PrimSpec, name: str, kind: Sdf.ValueTypeName, value: object) -> None:
    Sdf.AttributeSpec(spec, name, kind, Sdf.VariabilityUniform).default = value


def _export(layer: Sdf.Layer, temporary: Path) -> None:
    if not layer.Export(str(temporary)):
        raise OSError("USD gives no reason")
