"""The camera: which one, how large the picture, what it sees.

Takes a stage; gives the scene's `Camera` in stage metres, not yet recentred.
"""

from __future__ import annotations

import math

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdRender

from synfog_usd.errors import StageError, did_you_mean
from synfog_usd.scene import Camera
from synfog_usd.stage.open import cameras
from synfog_usd.translate.notes import Notebook
from synfog_usd.translate.space import Space, columns

DEFAULT_WIDTH_PX = 1280
NEAR_M = 0.01
"""Near plane where none is authored; USD's own fallback of one unit would cut off a bonnet."""

MAX_SIZE_PX = 1 << 16
_ABSURD_FOCAL_M = 0.5
_EXPOSURE = ("exposure", "exposure:iso", "exposure:time", "exposure:fStop", "exposure:responsivity")


def read_camera(stage: Usd.Stage, space: Space, time: Usd.TimeCode, notes: Notebook, *, path: str | None, resolution: tuple[int, int] | None) -> Camera:
    """The camera that looks.

    Args:
        path: prim path, or None for the render settings' camera, else the first one.
        resolution: (width, height) [px], or None for the render settings', else
            1280 pixels wide with the aspect of the aperture.

    Raises:
        StageError: no such camera, none at all, or one that cannot be drawn.
    """
    settings = UsdRender.Settings.GetStageRenderSettings(stage)
    prim = _chosen(stage, settings, path, notes)
    camera = UsdGeom.Camera(prim)
    lens = camera.GetCamera(time)
    if lens.projection == Gf.Camera.Orthographic:
        raise StageError(f"{prim.GetPath()}: an orthographic camera is not drawn; set projection = 'perspective'")
    width_mm, height_mm, focal = lens.horizontalAperture, lens.verticalAperture, lens.focalLength
    if not (width_mm > 0.0 and height_mm > 0.0 and focal > 0.0 and math.isfinite(width_mm * height_mm * focal)):
        raise StageError(f"{prim.GetPath()}: aperture {width_mm} x {height_mm} and focal length {focal} must be above 0")
    width_px, height_px = _resolution(settings, resolution, width_mm / height_mm, prim)
    policy = settings.GetAspectRatioConformPolicyAttr().Get() if settings else "expandAperture"
    conformed_width, conformed_height = _conformed(width_mm, height_mm, width_px / height_px, str(policy), prim, notes)
    focal_m = focal * 0.1 * space.metres_per_unit
    f_number, focus_m = float(lens.fStop), float(lens.focusDistance) * space.metres_per_unit
    if f_number > 0.0 and focal_m > _ABSURD_FOCAL_M:
        notes.warn(prim.GetPath(), f"a focal length of {focal_m:.2f} m makes no sense for depth of field (wrong units); the lens is drawn as a pinhole")
        f_number = 0.0
    if f_number > 0.0 and not focus_m > 0.0:
        notes.warn(prim.GetPath(), "fStop without focusDistance; the lens is drawn as a pinhole")
        f_number = 0.0
    scale = camera.ComputeLinearExposureScale(time)
    if scale != 1.0 and any(prim.GetAttribute(name).HasAuthoredValue() for name in _EXPOSURE):
        notes.info(prim.GetPath(), f"the camera's own exposure (a factor of {scale:.4g}) is not used; a bake meters its own")
    return Camera(
        path=str(prim.GetPath()),
        to_world=_upright(space.matrix @ columns(UsdGeom.XformCache(time).GetLocalToWorldTransform(prim)), prim),
        width_px=width_px,
        height_px=height_px,
        fov_x_deg=math.degrees(2.0 * math.atan(conformed_width / (2.0 * focal))),
        shift=(lens.horizontalApertureOffset / conformed_width, lens.verticalApertureOffset / conformed_height),
        near_m=max(float(lens.clippingRange.min) * space.metres_per_unit, 1e-4) if camera.GetClippingRangeAttr().HasAuthoredValue() else NEAR_M,
        focal_length_m=focal_m,
        f_number=f_number,
        focus_m=focus_m,
    )


def _chosen(stage: Usd.Stage, settings: UsdRender.Settings, path: str | None, notes: Notebook) -> Usd.Prim:
    known = cameras(stage)
    if path is not None:
        if path not in known:
            listed = ", ".join(known) or "none"
            raise StageError(f"{path}: no such camera; the stage has {listed}.{did_you_mean(path, known)}")
        return stage.GetPrimAtPath(path)
    if settings:
        for target in settings.GetCameraRel().GetForwardedTargets():
            if str(target) in known:
                return stage.GetPrimAtPath(target)
            notes.warn(settings.GetPath(), f"names the camera {target}, which does not exist")
    if not known:
        raise StageError(f"{stage.GetRootLayer().identifier}: the stage has no camera; add a Camera prim, or sublayer the stage under one that has one")
    if len(known) > 1:
        notes.info(known[0], f"the first of {len(known)} cameras is used; name another with --camera")
    return stage.GetPrimAtPath(known[0])


def _resolution(settings: UsdRender.Settings, asked: tuple[int, int] | None, aspect: float, prim: Usd.Prim) -> tuple[int, int]:
    if asked is None and settings and settings.GetResolutionAttr().HasAuthoredValue():
        asked = tuple(int(n) for n in settings.GetResolutionAttr().Get())  # type: ignore[assignment]
    if asked is None:
        asked = (DEFAULT_WIDTH_PX, max(round(DEFAULT_WIDTH_PX / aspect), 1))
    if not all(1 <= n <= MAX_SIZE_PX for n in asked):
        raise StageError(f"{prim.GetPath()}: a picture of {asked[0]} x {asked[1]} pixels; each side is 1 to {MAX_SIZE_PX}")
    return asked


def _conformed(width: float, height: float, aspect: float, policy: str, prim: Usd.Prim, notes: Notebook) -> tuple[float, float]:
    """Aperture that fits the picture's aspect, by UsdRender's aspectRatioConformPolicy."""
    wide = aspect > width / height
    if policy == "adjustPixelAspectRatio":
        notes.warn(prim.GetPath(), "pixels are square here; the aperture is expanded instead of stretching them")
        policy = "expandAperture"
    keep_height = {"expandAperture": wide, "cropAperture": not wide, "adjustApertureWidth": True, "adjustApertureHeight": False}.get(policy, wide)
    return (height * aspect, height) if keep_height else (width, width / aspect)


def _upright(matrix: np.ndarray, prim: Usd.Prim) -> np.ndarray:
    """A rigid right-handed frame with the same place and view direction."""
    back, up = matrix[:3, 2], matrix[:3, 1]
    if not np.isfinite(matrix).all() or not np.linalg.norm(np.cross(up, back)) > 0.0:
        raise StageError(f"{prim.GetPath()}: the camera's transform has no direction of view; remove its scale")
    z = back / np.linalg.norm(back)
    x = np.cross(up, z)
    x /= np.linalg.norm(x)
    result = np.eye(4)
    result[:3, 0], result[:3, 1], result[:3, 2], result[:3, 3] = x, np.cross(z, x), z, matrix[:3, 3]
    return result
