"""What is near the camera: models farther away are left unloaded, on the session layer.

Takes a stage and a distance.  A model that is switched off is not composed, and its payload not read.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdLux, UsdRender

from synfog_usd.base.errors import StageError
from synfog_usd.stage.open import plain_errors


@plain_errors
def keep_near(
    stage: Usd.Stage, metres: float, *, cameras: Sequence[str | None] = (None,), frame: float | None = None
) -> int:
    """Switch off every component, instance and payload whose box is farther from all cameras than `metres`, and hide
    points of instancers that are; what holds a camera, a sun or a sky stays.

    Args:
        stage: to change, on its session layer only.
        metres: > 0.
        cameras: prim paths; None for the render settings' camera, else the first.
        frame: time code; None for the stage's first.

    Returns:
        how many prims and points are left out.

    Raises:
        StageError: there is no camera.
    """
    time = Usd.TimeCode(stage.GetStartTimeCode() if frame is None else frame)
    eye_prims = [_camera(stage, camera) for camera in cameras]
    transforms = UsdGeom.XformCache(time)
    eyes = np.array([transforms.GetLocalToWorldTransform(prim).ExtractTranslation() for prim in eye_prims])
    reach = metres / UsdGeom.GetStageMetersPerUnit(stage)
    boxes = UsdGeom.BBoxCache(time, [UsdGeom.Tokens.default_, UsdGeom.Tokens.render], True)
    needed = {path for prim in eye_prims for path in prim.GetPath().GetPrefixes()}
    for prim in stage.Traverse():
        if prim.IsA(UsdLux.DomeLight) or prim.IsA(UsdLux.DistantLight) or prim.GetTypeName() == "DomeLight_1":
            needed |= set(prim.GetPath().GetPrefixes())
    far: list[Sdf.Path] = []
    hidden: list[tuple[Usd.Attribute, list[int]]] = []
    points = iter(Usd.PrimRange.Stage(stage))
    for prim in points:
        if prim.IsA(UsdGeom.PointInstancer):
            if ids := _far_points(UsdGeom.PointInstancer(prim), transforms, time, eyes, reach):
                hidden.append((UsdGeom.PointInstancer(prim).GetInvisibleIdsAttr(), ids))
            points.PruneChildren()
        elif (prim.HasAuthoredPayloads() or prim.IsInstance() or prim.IsComponent()) and prim.GetPath() not in needed:
            if _distance(prim, boxes, transforms, eyes) > reach:
                far.append(prim.GetPath())
            if prim.IsInstance() or prim.GetPath() in far[-1:]:
                points.PruneChildren()
    session = stage.GetSessionLayer()
    with Sdf.ChangeBlock():
        for path in far:
            Sdf.CreatePrimInLayer(session, path).active = False
    with Usd.EditContext(stage, Usd.EditTarget(session)):
        for attribute, ids in hidden:
            attribute.Set(sorted({*(attribute.Get(time) or ()), *ids}))
    return len(far) + sum(len(ids) for _, ids in hidden)


def _camera(stage: Usd.Stage, path: str | None) -> Usd.Prim:
    if path is None:
        settings = UsdRender.Settings.GetStageRenderSettings(stage)
        targets = settings.GetCameraRel().GetForwardedTargets() if settings else []
        path = str(targets[0]) if targets else None
    found = (
        stage.GetPrimAtPath(path)
        if path is not None
        else next((prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Camera)), None)
    )
    if not found or not found.IsA(UsdGeom.Camera):
        raise StageError(f"--max-distance: no camera {path or 'on the stage'} from which to measure")
    return found


def _distance(prim: Usd.Prim, boxes: UsdGeom.BBoxCache, transforms: UsdGeom.XformCache, eyes: np.ndarray) -> float:
    """From the nearest camera to the nearest point of a prim's box, or to its origin where it has none."""
    box = boxes.ComputeWorldBound(prim).ComputeAlignedRange()
    if box.IsEmpty():
        low = high = np.array(transforms.GetLocalToWorldTransform(prim).ExtractTranslation())
    else:
        low, high = np.array(box.GetMin()), np.array(box.GetMax())
    return float(np.linalg.norm(np.clip(eyes, low, high) - eyes, axis=1).min())


def _far_points(
    instancer: UsdGeom.PointInstancer,
    transforms: UsdGeom.XformCache,
    time: Usd.TimeCode,
    eyes: np.ndarray,
    reach: float,
) -> list[int]:
    """Ids of the points that are farther away than `reach`."""
    positions = instancer.GetPositionsAttr().Get(time)
    if positions is None or not len(positions):
        return []
    matrix = np.array(transforms.GetLocalToWorldTransform(instancer.GetPrim()))
    places = np.asarray(positions, dtype=np.float64) @ matrix[:3, :3] + matrix[3, :3]
    far = np.flatnonzero(np.linalg.norm(places[:, None] - eyes, axis=2).min(axis=1) > reach)
    ids = instancer.GetIdsAttr().Get(time)
    return [int(ids[number]) for number in far] if ids is not None and len(ids) == len(places) else far.tolist()
