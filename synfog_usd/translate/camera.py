"""The camera that looks: its place, lens, picture and exposure.

Takes a stage; gives the scene's `Camera` in stage metres, not yet recentred.
"""

from __future__ import annotations

import math

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdRender
from scipy.spatial.transform import Rotation

from synfog_usd.base.arrays import Array
from synfog_usd.base.errors import StageError, did_you_mean
from synfog_usd.scene import PARALLEL_DEG, Camera
from synfog_usd.stage.open import MISSING, cameras, composition_notes
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.motion import velocity_above
from synfog_usd.translate.pose import Poser
from synfog_usd.translate.space import Space, columns

DEFAULT_WIDTH_PX = 1280
READOUT = "synfog:shutter:readout"
MODE, ROLLING, GLOBAL_RESET = "synfog:shutter:mode", "rolling", "global_reset"
"""Attribute of a camera: seconds between the beginnings of the top and the bottom row's exposure."""

OMNIVERSE = "cameraProjectionType"
"""Omniverse's attribute of cameras that are no pinholes."""

NEAR_M = 0.01
"""Near plane where none is authored; USD's own fallback of one unit would cut off a bonnet."""

MAX_SIZE_PX = 1 << 16
MIN_VIEW_DEG, MAX_VIEW_DEG, MAX_SHIFT = PARALLEL_DEG, 179.0, 10.0
_PROJECTIONS = ("perspective", "orthographic")
_ABSURD_FOCAL_M = 0.5
_STILL_M, _STILL_RAD = 1e-6, 1e-7
_OF_FRAMES = UsdRender.SettingsBase.GetSchemaAttributeNames(includeInherited=False)
"""What render settings and each of their products may say of a frame."""

_EXPOSURE = ("exposure", "exposure:iso", "exposure:time", "exposure:fStop", "exposure:responsivity")


def read_camera(
    stage: Usd.Stage,
    space: Space,
    time: Usd.TimeCode,
    notes: Diagnostics,
    *,
    path: str | None,
    resolution: tuple[int, int] | None,
) -> Camera:
    """The camera that looks, in the middle of its exposure where it moves.

    Args:
        time: of the frame; `at_mid_exposure` where a shutter is authored.
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
    if not settings and (named := stage.GetMetadata("renderSettingsPrimPath")):
        notes.warn("/", f"renderSettingsPrimPath is {named!r}, where no RenderSettings are; none are followed")
    _tell_what_is_left_out(settings, notes)
    _tell_of_products(settings, prim, notes, named=path is not None)
    parallel = _is_parallel(camera, lens, notes)
    width_mm, height_mm, focal = _size_of_lens(prim, lens, parallel=parallel)
    width_px, height_px = _resolution(settings, resolution, width_mm / height_mm, prim)
    policy = settings.GetAspectRatioConformPolicyAttr().Get() if settings else "expandAperture"
    aperture = _conformed(width_mm, height_mm, width_px / height_px, str(policy), prim, notes)
    focal_m = focal * 0.1 * space.metres_per_unit
    focus_m = float(lens.focusDistance) * space.metres_per_unit
    _tell_of_camera(camera, time, notes)
    drift, turn = _motion(prim, space, time, notes)
    fov, shift = _field_of_view(prim, lens, aperture, None if parallel else focal)
    return Camera(
        path=str(prim.GetPath()),
        to_world=_place(prim, space, time),
        width_px=width_px,
        height_px=height_px,
        fov_x_deg=fov,
        shift=shift,
        near_m=_near(camera, lens, space, notes),
        focal_length_m=focal_m,
        f_number=0.0 if parallel else _f_number(prim, settings, lens, focal_m, focus_m, notes),
        focus_m=focus_m,
        width_m=aperture[0] * 0.1 * space.metres_per_unit if parallel else 0.0,
        drift_m=drift,
        turn_rad=turn,
        shutter_s=_shutter_s(prim, time),
        rolling=_rolling(prim, time, notes),
        global_reset=_global_reset(prim, time, notes),
        velocity_m_s=_velocity(prim, space, time, notes),
    )


def _size_of_lens(prim: Usd.Prim, lens: Gf.Camera, *, parallel: bool) -> tuple[float, float, float]:
    """Width and height of the aperture, and the focal length: 1 of a parallel view, where it has no meaning.

    Raises:
        StageError: one of them is not above 0.
    """
    width_mm, height_mm = lens.horizontalAperture, lens.verticalAperture
    focal = 1.0 if parallel else lens.focalLength
    if not (width_mm > 0.0 and height_mm > 0.0 and focal > 0.0 and math.isfinite(width_mm * height_mm * focal)):
        where = prim.GetPath()
        raise StageError(f"{where}: aperture {width_mm} x {height_mm} and focal length {focal} must be above 0")
    return width_mm, height_mm, focal


def _is_parallel(camera: UsdGeom.Camera, lens: Gf.Camera, notes: Diagnostics) -> bool:
    """Whether a camera is orthographic."""
    notes.token(camera.GetPath(), "projection", camera.GetProjectionAttr().Get(), _PROJECTIONS, "perspective")
    return bool(lens.projection == Gf.Camera.Orthographic)


def _f_number(
    prim: Usd.Prim,
    settings: UsdRender.Settings,
    lens: Gf.Camera,
    focal_m: float,
    focus_m: float,
    notes: Diagnostics,
) -> float:
    """The lens's f-number; 0 for a pinhole, as which a lens without sensible values is drawn."""
    f_number = float(lens.fStop)
    if f_number == 0.0:
        return 0.0
    if not 0.0 < f_number < math.inf:
        problem = f"fStop is {f_number:g}, which is no f-number"
    elif settings and settings.GetDisableDepthOfFieldAttr().Get():
        notes.info(settings.GetPath(), "disableDepthOfField: the lens is drawn as a pinhole")
        return 0.0
    elif focal_m > _ABSURD_FOCAL_M:
        problem = f"a focal length of {focal_m:.2f} m makes no sense for depth of field (wrong units)"
    elif focus_m == 0.0:
        problem = "fStop without focusDistance"
    elif not 0.0 < focus_m < math.inf:
        problem = f"focusDistance is {lens.focusDistance:g}, which is no distance"
    else:
        return f_number
    notes.warn(prim.GetPath(), f"{problem}; the lens is drawn as a pinhole")
    return 0.0


def _tell_of_camera(camera: UsdGeom.Camera, time: Usd.TimeCode, notes: Diagnostics) -> None:
    """Note attributes of a camera that are not followed."""
    prim, path = camera.GetPrim(), camera.GetPath()
    if planes := len(camera.GetClippingPlanesAttr().Get(time) or ()):
        notes.warn(path, f"its {planes} clippingPlanes cut nothing off here; hide what they should take away")
    if (projection := prim.GetAttribute(OMNIVERSE)) and str(projection.Get(time) or "pinhole") != "pinhole":
        notes.warn(
            path,
            f"{OMNIVERSE} {projection.Get(time)!r} is not read, and a pinhole drawn; a pipeline with a fisheye, as "
            f"'surround', draws one",
        )
    scale = camera.ComputeLinearExposureScale(time)
    if scale != 1.0 and any(prim.GetAttribute(name).HasAuthoredValue() for name in _EXPOSURE):
        notes.info(path, f"the camera's own exposure (a factor of {scale:.4g}) is not used; a bake meters its own")
    for attribute in (camera.GetShutterOpenAttr(), camera.GetShutterCloseAttr()):
        if not math.isfinite(float(attribute.Get(time) or 0.0)):
            notes.warn(path, f"{attribute.GetName()} is {attribute.Get(time):g}, no time; nothing is blurred")


def _field_of_view(
    prim: Usd.Prim, lens: Gf.Camera, aperture: tuple[float, float], focal: float | None
) -> tuple[float, tuple[float, float]]:
    """Horizontal angle of view [deg], and the shift of the aperture in its sizes; `focal` is None for a parallel view.

    Raises:
        StageError: one that cannot be drawn.
    """
    fov = PARALLEL_DEG if focal is None else math.degrees(2.0 * math.atan(aperture[0] / (2.0 * focal)))
    if not MIN_VIEW_DEG <= fov <= MAX_VIEW_DEG:
        raise StageError(
            f"{prim.GetPath()}: an aperture of {lens.horizontalAperture:g} and a focal length of {focal:g} give an "
            f"angle of view of {fov:.3g} degrees; {MIN_VIEW_DEG:g} to {MAX_VIEW_DEG:g} can be drawn"
        )
    shift = (lens.horizontalApertureOffset / aperture[0], lens.verticalApertureOffset / aperture[1])
    if not all(abs(part) <= MAX_SHIFT for part in shift):
        raise StageError(
            f"{prim.GetPath()}: its aperture offset is {shift[0]:.3g} x {shift[1]:.3g} times the aperture; at most "
            f"{MAX_SHIFT:g} can be drawn"
        )
    return fov, shift


def _tell_what_is_left_out(settings: UsdRender.Settings, notes: Diagnostics) -> None:
    """Note render settings that are not followed."""
    if not settings:
        return
    path = settings.GetPath()
    window = settings.GetDataWindowNDCAttr().Get()
    if window is not None and tuple(window) != (0.0, 0.0, 1.0, 1.0):
        part = ", ".join(f"{edge:g}" for edge in window)
        notes.warn(path, f"dataWindowNDC ({part}) is not followed: the whole frame is drawn")
    if (aspect := settings.GetPixelAspectRatioAttr().Get()) not in (None, 1.0):
        notes.warn(path, f"pixelAspectRatio {aspect:g} is not followed: pixels are square here")
    bindings = settings.GetMaterialBindingPurposesAttr()
    if bindings.HasAuthoredValue() and next(iter(bindings.Get() or ["full"])) != "full":
        notes.warn(path, "materialBindingPurposes is not followed: materials for 'full' come before all others here")


def _tell_of_products(settings: UsdRender.Settings, camera: Usd.Prim, notes: Diagnostics, *, named: bool) -> None:
    """Note render products that differ from the frame that is drawn; `named`: the caller names the camera."""
    if not settings:
        return
    stage = settings.GetPrim().GetStage()
    paths = settings.GetProductsRel().GetForwardedTargets()
    products = [product for product in map(UsdRender.Product, map(stage.GetPrimAtPath, paths)) if product]
    for target in paths:
        if not UsdRender.Product(stage.GetPrimAtPath(target)):
            notes.warn(settings.GetPath(), f"names the product {target}, which does not exist")
    cameras_of = {product.GetPath(): product.GetCameraRel().GetForwardedTargets() for product in products}
    is_drawn = named or camera.GetPath() in [target for targets in cameras_of.values() for target in targets]
    for product in products:
        path = product.GetPath()
        differing = [name for name in _OF_FRAMES if _differs(product.GetPrim(), settings.GetPrim(), name)]
        if differing:
            notes.warn(path, f"{', '.join(differing)} of a product is not read; the RenderSettings' own counts")
        for target in cameras_of[path]:
            if not UsdGeom.Camera(stage.GetPrimAtPath(target)):
                notes.warn(path, f"names the camera {target}, which does not exist")
            elif not is_drawn:
                notes.warn(path, f"is of {target}, and {camera.GetPath()} is drawn; --camera {target} draws the other")


def _differs(product: Usd.Prim, settings: Usd.Prim, name: str) -> bool:
    """Whether a product has another value than the render settings."""
    special, common = product.GetAttribute(name), settings.GetAttribute(name)
    if name == "resolution" and not common.HasAuthoredValue():  # then it is not USD's fallback that counts
        return bool(special.HasAuthoredValue())
    return bool(special.HasAuthoredValue() and special.Get() != common.Get())


def _rolling(prim: Usd.Prim, time: Usd.TimeCode, notes: Diagnostics) -> float:
    """Part of the whole exposure that lies between the beginnings of the top and the bottom row."""
    readout = _readout(prim, time)
    if prim.HasAttribute(READOUT) and not readout and prim.GetAttribute(READOUT).Get(time) != 0.0:
        notes.warn(
            prim.GetPath(),
            f"{READOUT} is {prim.GetAttribute(READOUT).Get(time)!r}, which is no time in seconds; all rows expose "
            f"together",
        )
    opens, closes = _shutter(prim, time)
    return readout / (closes - opens) if closes > opens else 0.0


def _global_reset(prim: Usd.Prim, time: Usd.TimeCode, notes: Diagnostics) -> bool:
    """Whether all rows begin together, and end one after the other as they are read."""
    mode = prim.GetAttribute(MODE).Get(time) if prim.HasAttribute(MODE) else ROLLING
    if mode not in (ROLLING, GLOBAL_RESET):
        notes.warn(prim.GetPath(), f"{MODE} is {mode!r}; it takes {ROLLING} or {GLOBAL_RESET}, and {ROLLING} is taken")
    return bool(mode == GLOBAL_RESET)


def _near(camera: UsdGeom.Camera, lens: Gf.Camera, space: Space, notes: Diagnostics) -> float:
    """Near plane [m]: as authored, where that is a distance."""
    if not camera.GetClippingRangeAttr().HasAuthoredValue():
        return NEAR_M
    near = float(lens.clippingRange.min)
    if not 0.0 <= near < math.inf:
        notes.warn(camera.GetPath(), f"clippingRange begins at {near:g}, which is no distance; {NEAR_M:g} m is taken")
        return NEAR_M
    return max(near * space.metres_per_unit, 1e-4)


def at_mid_exposure(stage: Usd.Stage, time: Usd.TimeCode, notes: Diagnostics, *, path: str | None) -> Usd.TimeCode:
    """The moment at which a frame's middle row is half exposed, and of which a scene is but for its motion.

    USD's shutter times count in frames from the frame's own time; under a rolling shutter and global reset they are
    those of the top row.  Without an authored shutter, or one that is open for no time, it is the frame's time itself.

    Args:
        path: of the camera, as in `read_camera`.
    """
    if time.IsDefault():
        return time
    prim = _chosen(stage, UsdRender.Settings.GetStageRenderSettings(stage), path, Diagnostics())
    opens, closes = _shutter(prim, time)
    if not closes > opens or opens + closes == 0.0:
        return time
    middle = Usd.TimeCode(time.GetValue() + 0.5 * (opens + closes))
    notes.info(
        prim.GetPath(),
        f"the shutter is open from {opens:g} to {closes:g} frames: the scene is drawn as it is at "
        f"{middle.GetValue():g}",
    )
    return middle


def half_exposure(stage: Usd.Stage, time: Usd.TimeCode, path: str) -> float:
    """Frames from mid-exposure to the end of the bottom row's exposure; 0 where no shutter is open for any time.

    Args:
        path: of the camera that looks.
    """
    opens, closes = _shutter(stage.GetPrimAtPath(path), time)
    return 0.0 if time.IsDefault() or not closes > opens else 0.5 * (closes - opens)


def _shutter(prim: Usd.Prim, time: Usd.TimeCode) -> tuple[float, float]:
    """When the top row begins to expose and the bottom row ends, in frames from the frame's time; (0, 0) where nothing
    sensible is authored, or the render settings want no motion blur.
    """
    camera, settings = UsdGeom.Camera(prim), UsdRender.Settings.GetStageRenderSettings(prim.GetStage())
    if settings and (settings.GetDisableMotionBlurAttr().Get() or settings.GetInstantaneousShutterAttr().Get()):
        return 0.0, 0.0
    opens, closes = (
        float(attribute.Get(time) or 0.0) for attribute in (camera.GetShutterOpenAttr(), camera.GetShutterCloseAttr())
    )
    closes += _readout(prim, time)
    return (opens, closes) if math.isfinite(opens) and math.isfinite(closes) else (0.0, 0.0)


def _shutter_s(prim: Usd.Prim, time: Usd.TimeCode) -> float:
    """Time [s] from the beginning of the top row to the end of the bottom row; 0 where no shutter is open."""
    rate = prim.GetStage().GetTimeCodesPerSecond()
    return 2.0 * half_exposure(prim.GetStage(), time, str(prim.GetPath())) / rate if 0.0 < rate < math.inf else 0.0


def _readout(prim: Usd.Prim, time: Usd.TimeCode) -> float:
    """Time between the top and the bottom row, in frames: of their beginnings, or under global reset of their ends; 0
    for a global shutter.
    """
    value = prim.GetAttribute(READOUT).Get(time) if prim.HasAttribute(READOUT) else None
    seconds = float(value) if isinstance(value, (int, float)) else 0.0
    rate = prim.GetStage().GetTimeCodesPerSecond()
    return seconds * rate if 0.0 < seconds < math.inf and 0.0 < rate < math.inf else 0.0


def _place(prim: Usd.Prim, space: Space, time: Usd.TimeCode) -> Array:
    with np.errstate(invalid="ignore"):  # which `_upright` refuses
        place = space.matrix @ columns(UsdGeom.XformCache(time).GetLocalToWorldTransform(prim))
    return _upright(place, prim)


def _motion(
    prim: Usd.Prim, space: Space, time: Usd.TimeCode, notes: Diagnostics
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """(way [m], rotation vector [rad]) of a camera while it exposes, about the middle of which `time` is; zeros where
    it stands.
    """
    still = (0.0, 0.0, 0.0)
    half = half_exposure(prim.GetStage(), time, str(prim.GetPath()))
    if not half:
        return still, still
    first, last = (_place(prim, space, Usd.TimeCode(time.GetValue() + side * half)) for side in (-1.0, 1.0))
    way = last[:3, 3] - first[:3, 3]
    velocity = velocity_above(prim, UsdGeom.XformCache(time), notes)
    if velocity is not None and not way.any():
        way = space.matrix[:3, :3] @ velocity * (2.0 * half / prim.GetStage().GetTimeCodesPerSecond())
    vector = Rotation.from_matrix(last[:3, :3] @ first[:3, :3].T).as_rotvec()
    if np.linalg.norm(way) < _STILL_M and np.linalg.norm(vector) < _STILL_RAD:
        return still, still
    notes.info(
        prim.GetPath(),
        f"the camera moves {np.linalg.norm(way):.3g} m and turns {math.degrees(float(np.linalg.norm(vector))):.3g} "
        f"degrees while it exposes",
    )
    return (float(way[0]), float(way[1]), float(way[2])), (float(vector[0]), float(vector[1]), float(vector[2]))


def _velocity(prim: Usd.Prim, space: Space, time: Usd.TimeCode, notes: Diagnostics) -> tuple[float, float, float]:
    """Of a camera in the scene's axes [m/s], by that of the nearest prim above it that has one, else by its frames."""
    above = velocity_above(prim, UsdGeom.XformCache(time), notes)
    if above is not None:
        x, y, z = (float(part) for part in space.matrix[:3, :3] @ above)
        return x, y, z
    return Poser(prim.GetStage(), space, time, notes).pose(str(prim.GetPath()), space.matrix)[1] or (0.0, 0.0, 0.0)


def own_camera(stage: Usd.Stage) -> str | None:
    """Prim path of the camera that looks where none is named: the render settings', else the first; None where the
    stage has none.
    """
    if not cameras(stage):
        return None
    settings = UsdRender.Settings.GetStageRenderSettings(stage)
    return str(_chosen(stage, settings, None, Diagnostics()).GetPath())


def _chosen(stage: Usd.Stage, settings: UsdRender.Settings, path: str | None, notes: Diagnostics) -> Usd.Prim:
    paths = cameras(stage)
    if path is not None:
        if path not in paths:
            listed = ", ".join(paths) or "none"
            raise StageError(f"{path}: no such camera; the stage has {listed}.{did_you_mean(path, paths)}")
        return stage.GetPrimAtPath(path)
    if settings:
        for target in settings.GetCameraRel().GetForwardedTargets():
            if str(target) in paths:
                return stage.GetPrimAtPath(target)
            notes.warn(settings.GetPath(), f"names the camera {target}, which does not exist")
    if not paths:
        missing = "".join(
            f"; {note.path}: {note.text.removesuffix('; drawn without it')}"
            for note in composition_notes(stage)[:1]
            if MISSING in note.text
        )
        advice = (
            "put that file in its place"
            if missing
            else "add a Camera prim, or sublayer the stage under one that has one"
        )
        raise StageError(f"{stage.GetRootLayer().identifier}: the stage has no camera{missing}; {advice}")
    if len(paths) > 1:
        notes.info(paths[0], f"the first of {len(paths)} cameras is used; name another with --camera")
    return stage.GetPrimAtPath(paths[0])


def _resolution(
    settings: UsdRender.Settings, size: tuple[int, int] | None, aspect: float, prim: Usd.Prim
) -> tuple[int, int]:
    """(width, height) [px]: `size`, else the render settings', else the default width."""
    if size is None and settings and settings.GetResolutionAttr().HasAuthoredValue():
        width, height = settings.GetResolutionAttr().Get()
        size = int(width), int(height)
    if size is None:
        size = (DEFAULT_WIDTH_PX, max(round(DEFAULT_WIDTH_PX / aspect), 1))
    if not all(1 <= n <= MAX_SIZE_PX for n in size):
        raise StageError(
            f"{prim.GetPath()}: a picture of {size[0]} x {size[1]} pixels; each side is 1 to {MAX_SIZE_PX}"
        )
    return size


def _conformed(
    width: float, height: float, aspect: float, policy: str, prim: Usd.Prim, notes: Diagnostics
) -> tuple[float, float]:
    """Aperture that fits the picture's aspect, by UsdRender's aspectRatioConformPolicy."""
    wide = aspect > width / height
    if policy == "adjustPixelAspectRatio":
        notes.warn(prim.GetPath(), "pixels are square here; the aperture is expanded instead of stretching them")
        policy = "expandAperture"
    keep_height = {
        "expandAperture": wide,
        "cropAperture": not wide,
        "adjustApertureWidth": True,
        "adjustApertureHeight": False,
    }
    policy = notes.token(prim.GetPath(), "aspectRatioConformPolicy", policy, keep_height, "expandAperture")
    return (height * aspect, height) if keep_height[policy] else (width, width / aspect)


def _upright(matrix: Array, prim: Usd.Prim) -> Array:
    """A rigid right-handed frame with the same place and view direction."""
    back, up = matrix[:3, 2], matrix[:3, 1]
    if not np.isfinite(matrix).all():
        raise StageError(f"{prim.GetPath()}: the camera's transform holds numbers that are not finite; correct it")
    if not np.linalg.norm(np.cross(up, back)) > 0.0:
        raise StageError(f"{prim.GetPath()}: the camera's transform has no direction of view; remove its scale")
    z = back / np.linalg.norm(back)
    x = np.cross(up, z)
    x /= np.linalg.norm(x)
    result = np.eye(4)
    result[:3, 0], result[:3, 1], result[:3, 2], result[:3, 3] = x, np.cross(z, x), z, matrix[:3, 3]
    return result
