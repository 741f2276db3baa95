"""What is wrong with a stage, before a picture is made of it.

Takes a stage; gives notes.  USD's own validators come first, then the few rules
that only matter here: a camera, fog, the camera within its fog, labels.
"""

from __future__ import annotations

from pxr import Usd, UsdGeom, UsdValidation

from synfog_usd.scene import Note
from synfog_usd.stage.labels import direct_label, official_name
from synfog_usd.stage.open import cameras, check_depth, composition_notes
from synfog_usd.stage.schema import API_NAME, has_fog_attributes

_PREFIX = "usd: "


def check(stage: Usd.Stage) -> list[Note]:
    """All findings on a stage, USD's own and ours.

    Raises:
        StageError: nested too deeply for USD to look at.
    """
    check_depth(stage)
    return [*composition_notes(stage), *_usd_findings(stage), *_camera_and_fog(stage), *_labels(stage)]


def _usd_findings(stage: Usd.Stage) -> list[Note]:
    context = UsdValidation.ValidationContext(UsdValidation.ValidationRegistry().GetOrLoadAllValidators())
    notes = []
    for error in context.Validate(stage):
        warning = error.GetType() != UsdValidation.ValidationErrorType.Info
        paths = [str(site.GetPrim().GetPath()) for site in error.GetSites() if site.IsPrim()]
        text = f"{_PREFIX}{' '.join(error.GetMessage().split())} ({error.GetName()})"
        notes.append(Note("warning" if warning else "info", paths[0] if paths else "", text))
    return notes


def _camera_and_fog(stage: Usd.Stage) -> list[Note]:
    time = Usd.TimeCode.EarliestTime()
    eyes = cameras(stage)
    fog = [prim for prim in stage.Traverse() if has_fog_attributes(prim)]
    notes = []
    if not eyes:
        notes.append(Note("warning", "", "the stage has no camera; add one, or nothing can be rendered"))
    if not fog:
        notes.append(Note("info", "", f"the stage has no fog; apply {API_NAME} to a Cube, Sphere or closed Mesh"))
        return notes
    bounds = UsdGeom.BBoxCache(time, [UsdGeom.Tokens.default_, UsdGeom.Tokens.render, UsdGeom.Tokens.guide, UsdGeom.Tokens.proxy], False, True)
    boxes = [bounds.ComputeWorldBound(prim) for prim in fog]
    for path in eyes:
        eye = UsdGeom.Xformable(stage.GetPrimAtPath(path)).ComputeLocalToWorldTransform(time).ExtractTranslation()
        if not any(box.GetRange().Contains(box.GetMatrix().GetInverse().Transform(eye)) for box in boxes):
            notes.append(Note("warning", path, "stands outside of every fog boundary; enlarge the fog or move the camera"))
    return notes


def _labels(stage: Usd.Stage) -> list[Note]:
    time = Usd.TimeCode.EarliestTime()
    notes: list[Note] = []
    unlabelled: list[str] = []
    iterator = iter(Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()))
    for prim in iterator:
        if prim.IsPseudoRoot():
            continue
        label = direct_label(prim, time)
        if label is not None:
            if official_name(label) is None:
                notes.append(Note("warning", str(prim.GetPath()), f"label {label!r} is not a Cityscapes name; it counts as unlabeled"))
            iterator.PruneChildren()
        elif prim.IsA(UsdGeom.Gprim) and not has_fog_attributes(prim) and not has_fog_attributes(prim.GetParent()):
            unlabelled.append(str(prim.GetPath()))
    if unlabelled:
        notes.append(Note("info", unlabelled[0], f"{len(unlabelled)} prims have no label (semantics:labels:cityscapes), this is the first"))
    return notes
