"""Cameras: angle of view, shift, size, choice."""

import math

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdRender
from support.looks import fill

from synfog_usd.base.errors import StageError
from synfog_usd.stage.open import override
from synfog_usd.translate import translate


def camera(stage):
    found = fill(UsdGeom.Camera.Get(stage, "/Camera"), focalLength=35.0, horizontalAperture=36.0, verticalAperture=24.0)
    return found


@pytest.mark.parametrize("size, policy, width_mm", [
    ((900, 600), "expandAperture", 36.0), ((1200, 600), "expandAperture", 48.0), ((300, 600), "expandAperture", 36.0),
    ((1200, 600), "cropAperture", 36.0), ((1200, 600), "adjustApertureWidth", 48.0),
    ((1200, 600), "adjustApertureHeight", 36.0),
])  # fmt: skip
def test_the_aperture_conforms_to_the_picture(empty, size, policy, width_mm):
    """As UsdRenderSettings say; by the fallback a wider picture keeps the height, a narrower one the width."""
    stage = empty()
    camera(stage)
    if policy != "expandAperture":
        fill(rendered(stage), aspectRatioConformPolicy=policy)
    found = translate(stage, resolution=size).camera
    assert (found.width_px, found.height_px) == size
    np.testing.assert_allclose(found.fov_x_deg, 2 * math.degrees(math.atan(width_mm / 2 / 35.0)), rtol=1e-6)


def test_the_projection_is_usds_own(empty):
    """A point's place in the picture, by fov and shift, is where Gf.Frustum of the same camera puts it."""
    stage = empty()
    authored = camera(stage)
    fill(authored, horizontalApertureOffset=4.0, verticalApertureOffset=-3.0)
    found = translate(stage, resolution=(900, 600)).camera
    matrix = authored.GetCamera(0).frustum.ComputeProjectionMatrix()
    tangent = math.tan(math.radians(found.fov_x_deg / 2))
    for x, y in ((0.0, 0.0), (0.3, 0.1), (-0.2, 0.25)):
        clip = matrix.Transform(Gf.Vec3d(x, y, -1.0))
        wanted = (clip[0] / 2, clip[1] / 2)  # from the centre, in picture widths and heights
        ours = (x / tangent / 2 - found.shift[0], y / (tangent * 600 / 900) / 2 - found.shift[1])
        np.testing.assert_allclose(ours, wanted, atol=1e-6)


def test_lens_numbers_are_in_metres(empty):
    """Focal length and aperture are tenths of a stage unit, focus distance is whole units."""
    stage = empty(metres_per_unit=0.01)
    authored = camera(stage)
    fill(authored, fStop=2.8, focusDistance=1200.0, clippingRange=Gf.Vec2f(10.0, 1e6))
    found = translate(stage).camera
    np.testing.assert_allclose(
        [found.focal_length_m, found.f_number, found.focus_m, found.near_m], [0.035, 2.8, 12.0, 0.1], rtol=1e-6
    )
    assert (found.width_px, found.height_px) == (1280, 853)


def test_an_absurd_focal_length_is_a_pinhole(empty):
    """35 'mm' in a stage of metres is a lens of 3.5 m: harmless for the view, absurd for depth of field."""
    stage = empty()
    authored = camera(stage)
    fill(authored, fStop=2.8, focusDistance=12.0)
    scene = translate(stage)
    assert scene.camera.f_number == 0.0
    assert any(note.path == "/Camera" and "3.50 m" in note.text for note in scene.notes)


@pytest.mark.parametrize("scale", [(1, 3, 0.5), (-1, 1, 1)])
def test_scale_does_not_reach_the_lens(empty, scale):
    """The view direction and the place stay; the frame is rigid and right-handed."""
    stage = empty()
    authored = camera(stage)
    authored.AddScaleOp().Set(scale)
    found = translate(stage).camera.to_world[:3, :3]
    np.testing.assert_allclose(found @ found.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(found), 1.0)
    np.testing.assert_allclose(found[:, 2], [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(found[:, 1], [0, 0, 1], atol=1e-12)


def test_which_camera_looks(empty):
    """The one asked for, else the render settings', else the first, with a note."""
    stage = empty()
    for name in "AB":
        UsdGeom.Camera.Define(stage, f"/{name}")
    scene = translate(stage)
    assert scene.camera.path == "/Camera"
    assert any("first of 3 cameras" in note.text for note in scene.notes)
    settings = UsdRender.Settings.Define(stage, "/Render")
    settings.CreateCameraRel().AddTarget("/B")
    settings.CreateResolutionAttr(Gf.Vec2i(640, 480))
    stage.SetMetadata("renderSettingsPrimPath", "/Render")
    found = translate(stage).camera
    assert (found.path, found.width_px, found.height_px) == ("/B", 640, 480)
    assert translate(stage, camera="/A", resolution=(64, 32)).camera.path == "/A"
    with pytest.raises(StageError, match=r"/Camra: no such camera.*Did you mean '/Camera'"):
        translate(stage, camera="/Camra")


def rendered(stage):
    stage.SetMetadata("renderSettingsPrimPath", "/Render")
    return UsdRender.Settings.Define(stage, "/Render")


def test_what_a_camera_or_render_settings_ask_for_in_vain_is_told(empty):
    """Planes that would cut, and a window of the picture."""
    stage = empty()
    settings = rendered(stage).GetPrim()
    assert not translate(stage).notes
    camera(stage).CreateClippingPlanesAttr([Gf.Vec4f(1, 0, 0, 0), Gf.Vec4f(0, 1, 0, 0)])
    settings.GetAttribute("dataWindowNDC").Set(Gf.Vec4f(0.5, 0, 1, 1))
    told = {note.path: note.text for note in translate(stage).notes}
    assert "2 clippingPlanes" in told["/Camera"] and "dataWindowNDC (0.5, 0, 1, 1) is not followed" in told["/Render"]


@pytest.mark.parametrize("own, targets, asked, told", [
    ("/Camera", ["/Camera", "/Rear"], None, []),
    (None, ["/Rear"], None, ["is of /Rear, and /Camera is drawn"]),
    ("/Camera", ["/Rear"], "/Camera", []),
    ("/Camera", ["/Camera", "/Gone"], None, ["names the camera /Gone, which does not exist"]),
])  # fmt: skip
def test_a_product_s_camera_is_told_where_another_is_drawn(empty, own, targets, asked, told):
    """One product of each camera is how a rig is written, and no finding."""
    stage = empty()
    camera(stage)
    UsdGeom.Camera.Define(stage, "/Rear")
    settings = rendered(stage)
    if own:
        settings.CreateCameraRel().SetTargets([own])
    for k, target in enumerate(targets):
        UsdRender.Product.Define(stage, f"/Render/P{k}").CreateCameraRel().SetTargets([target])
        settings.GetProductsRel().AddTarget(f"/Render/P{k}")
    texts = [note.text for note in translate(stage, camera=asked).notes if note.path.startswith("/Render/")]
    assert [text.startswith(start) for text, start in zip(texts, told, strict=True)] == [True] * len(told)


def test_render_settings_without_blur_have_none(empty):
    """disableDepthOfField is a pinhole; disableMotionBlur a shutter that is open for no time, but for one that is asked
    for.
    """
    stage = empty(metres_per_unit=0.01)
    authored = camera(stage)
    fill(authored, fStop=2.8, focusDistance=1200.0, shutterClose=0.5)
    cube = UsdGeom.Cube.Define(stage, "/Cube").AddTranslateOp()
    for frame in (0, 2):
        cube.Set((float(frame), 500.0, 0.0), frame)
    settings = rendered(stage)
    scene = translate(stage, frame=1)
    assert scene.camera.f_number == pytest.approx(2.8) and scene.motion_of
    fill(settings, disableDepthOfField=True, disableMotionBlur=True)
    scene = translate(stage, frame=1)
    assert scene.camera.f_number == 0.0 and not scene.motion_of
    override(stage, shutter_s=0.02)
    assert translate(stage, frame=1).motion_of


def test_a_stage_without_a_camera_is_refused(empty):
    stage = empty()
    stage.RemovePrim("/Camera")
    with pytest.raises(StageError, match=r"no camera; add a Camera"):
        translate(stage)


@pytest.mark.parametrize("name, value", [("focalLength", 0.0), ("horizontalAperture", -1.0)])
def test_lenses_that_cannot_be_drawn_are_refused(empty, name, value):
    stage = empty()
    camera(stage).GetPrim().GetAttribute(name).Set(value)
    with pytest.raises(StageError, match="/Camera"):
        translate(stage)


def test_the_frame_is_the_one_asked_for_or_the_first(empty):
    stage = empty()
    move = UsdGeom.Cube.Define(stage, "/Cube").AddTranslateOp()
    for frame in (10, 20):
        move.Set((float(frame), 0.0, 0.0), frame)
    stage.SetStartTimeCode(10)
    stage.SetEndTimeCode(20)
    scene = translate(stage)
    np.testing.assert_allclose(scene.world["shape_0"]["positions"].mean(axis=0), [10, 0, 0])
    assert any("frame 10" in note.text for note in scene.notes)
    np.testing.assert_allclose(translate(stage, frame=17).world["shape_0"]["positions"].mean(axis=0), [17, 0, 0])


@pytest.mark.parametrize("metres_per_unit", [1.0, 0.01])
def test_an_orthographic_camera_sees_its_aperture(empty, metres_per_unit):
    """Gf's frustum of the same camera: a window of tenths of a unit, moved by the offsets, that does not grow with
    distance.
    """
    stage = empty(metres_per_unit=metres_per_unit)
    authored = UsdGeom.Camera.Get(stage, "/Camera")
    fill(authored, projection="orthographic", horizontalAperture=400.0, verticalAperture=200.0)
    fill(authored, horizontalApertureOffset=30.0, verticalApertureOffset=-20.0, fStop=2.8)
    found = translate(stage, resolution=(800, 400)).camera
    window = authored.GetCamera(0).frustum.GetWindow()
    size, middle = window.GetSize() * metres_per_unit, (window.GetMin() + window.GetMax()) * 0.5 * metres_per_unit
    np.testing.assert_allclose(found.width_m, size[0], rtol=1e-6)
    np.testing.assert_allclose([found.shift[0] * found.width_m, found.shift[1] * found.width_m / 2], middle, rtol=1e-6)
    assert found.f_number == 0.0


def test_a_camera_that_drives_is_where_it_is_half_way_through_its_exposure(empty):
    """10 m in 24 frames, the shutter open for half a frame from the frame on; it turns by 24 degrees meanwhile."""
    stage = empty()
    authored = UsdGeom.Camera.Get(stage, "/Camera")
    authored.ClearXformOpOrder()
    move, turn = authored.AddTranslateOp(), authored.AddRotateXYZOp()
    for frame in (0, 24):
        move.Set((0.0, frame / 2.4, 1.5), frame)
        turn.Set((90.0, 0.0, float(frame)), frame)
    fill(authored, shutterOpen=0.0, shutterClose=0.5)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(24)
    scene = translate(stage, frame=6)
    np.testing.assert_allclose(scene.camera.to_world[:3, 3] + scene.origin_m, [0.0, 6.25 / 2.4, 1.5], atol=1e-9)
    np.testing.assert_allclose(scene.camera.drift_m, [0.0, 0.5 / 2.4, 0.0], atol=1e-9)
    np.testing.assert_allclose(scene.camera.turn_rad, [0.0, 0.0, math.radians(0.5)], atol=1e-9)
    assert any("open from 0 to 0.5 frames" in note.text for note in scene.notes)
    authored.CreateShutterOpenAttr(0.5)
    assert not translate(stage, frame=6).camera.moves


def test_what_else_moves_while_the_shutter_is_open_moves_in_the_scene(empty):
    """A cube that goes 1 m a frame, open for half a frame: from 0.25 m before its place in mid-exposure to 0.25 m
    behind it.
    """
    stage = empty()
    authored = fill(UsdGeom.Camera.Get(stage, "/Camera"), shutterOpen=-0.25, shutterClose=0.25)
    stage.SetStartTimeCode(0)
    move = UsdGeom.Cube.Define(stage, "/Cube").AddTranslateOp()
    for frame in (0, 2):
        move.Set((float(frame), 5.0, 0.0), frame)
    scene = translate(stage, frame=1)
    assert any(note.path == "/Cube" and "1 prims move" in note.text for note in scene.notes)
    np.testing.assert_allclose(scene.world["shape_0"]["positions"].mean(axis=0) + scene.origin_m, [1.0, 5.0, 0.0])
    assert not scene.camera.moves
    ways = scene.motion_of["shape_0"]
    wanted = np.tile(np.eye(4), (1, ways.shape[1], 1, 1))
    wanted[0, :, 0, 3] = np.linspace(-0.25, 0.25, ways.shape[1])
    np.testing.assert_allclose(ways, wanted, atol=1e-12)
    authored.CreateShutterCloseAttr(-0.25)
    assert not translate(stage, frame=1).motion_of, "a shutter that is open for no time"


def test_what_is_told_a_velocity_goes_at_it_while_the_shutter_is_open(empty):
    """8 m/s along an axis of a parent that is turned by 90 degrees, for 25 ms: 0.1 m to each side of the middle along
    Y; so does a child.  The shutter is asked for, and the stage has no frames.  A car with time samples goes by these.
    """
    stage = empty()
    turned = UsdGeom.Xform.Define(stage, "/Turned")
    turned.AddRotateZOp().Set(90.0)
    for name in ("Car", "Animated"):
        car = UsdGeom.Xform.Define(stage, f"/Turned/{name}")
        car.GetPrim().CreateAttribute("physics:velocity", Sdf.ValueTypeNames.Vector3f).Set((8.0, 0.0, 0.0))
        UsdGeom.Cube.Define(stage, f"/Turned/{name}/Body")
    UsdGeom.Cube.Define(stage, "/Turned/Still")
    override(stage, shutter_s=0.025)
    scene = translate(stage)
    assert len(scene.motion_of) == 2 and not scene.camera.moves
    ways = next(iter(scene.motion_of.values()))
    wanted = np.tile(np.eye(4), (1, ways.shape[1], 1, 1))
    wanted[0, :, 1, 3] = np.linspace(-0.1, 0.1, ways.shape[1])
    np.testing.assert_allclose(ways, wanted, atol=1e-7)
    assert not stage.GetRootLayer().HasStartTimeCode(), "the stage's own file stays"
    move = UsdGeom.Xform.Get(stage, "/Turned/Animated").AddTranslateOp()
    for frame in (-1, 1):
        move.Set((0.0, float(frame), 0.0), frame)
    both = translate(stage, frame=0).motion_of.values()
    reach = sorted(float(np.abs(ways[0, :, :3, 3]).max()) for ways in both)
    np.testing.assert_allclose(reach, [0.1, 0.5 * 0.025 * stage.GetTimeCodesPerSecond()], rtol=1e-6)


TURNTABLE = """#usda 1.0
(
    startTimeCode = 0
    endTimeCode = 2
    metersPerUnit = 0.01
    upAxis = "Y"
)
class "Part" {
    def Cube "Body" {
        double size = 10
    }
    def SphereLight "Lamp" {
        float inputs:radius = 1
    }
}
def Xform "Table" {
    float xformOp:rotateY.timeSamples = { 0: 0, 2: 90 }
    uniform token[] xformOpOrder = ["xformOp:rotateY"]
    def "One" (
        instanceable = true
        prepend references = </Part>
    ) {
        double3 xformOp:translate = (100, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def "Two" (
        instanceable = true
        prepend references = </Part>
    ) {
        double3 xformOp:translate = (0, 0, 100)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
}
def PointInstancer "Rain" {
    point3f[] positions.timeSamples = { 1: [(0, 0, 0), (50, 0, 0)] }
    vector3f[] velocities.timeSamples = { 1: [(0, -240, 0), (0, 0, 0)] }
    int[] protoIndices = [0, 0]
    rel prototypes = </Rain/Drop>
    def Sphere "Drop" {
        double radius = 1
    }
}
def Cube "House" {
    double size = 10
}
def Camera "Eye" {
    double3 xformOp:translate = (0, 0, 500)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    double shutter:open = -0.5
    double shutter:close = 0.5
}
"""


def test_instances_their_lamps_and_points_with_velocities_move(tmp_path):
    """A table that turns by 45 degrees in the frame carries instances and the lamps within them; rain falls at 240
    cm/s, a tenth of a metre in 1/24 s; the house and the point without a velocity stand.  All in metres, Z up.
    """
    (tmp_path / "turntable.usda").write_text(TURNTABLE)
    scene = translate(Usd.Stage.Open(str(tmp_path / "turntable.usda")), frame=1)
    cosine, sine = np.cos(np.radians(22.5)), np.sin(np.radians(22.5))
    rotation = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    middle = -np.array(scene.origin_m)  # of the stage
    names = {instance.id: instance.path for instance in scene.instances}
    of = {}
    for key, ways in scene.motion_of.items():
        ids = {names[number] for part, number in scene.instance_of.items() if part[0] == key}
        of |= dict.fromkeys(ids or {key}, ways)
    assert {path for path in of if path.startswith("/")} == {"/Table/One", "/Table/Two", "/Rain[0]"}
    assert len(scene.motion_of) == 5, "two instances, their two lamps and a drop"
    for path in ("/Table/One", "/Table/Two"):
        np.testing.assert_allclose(of[path][0, -1, :3, :3], rotation, atol=1e-9)
        np.testing.assert_allclose((of[path][0, 0] @ [*middle, 1.0])[:3], middle, atol=1e-9)
    np.testing.assert_allclose(of["/Rain[0]"][0, -1, :3, 3], [0.0, 0.0, -0.05], atol=1e-9)


def test_exposure_attributes_multiply_as_usd_says(empty):
    """time x ISO / 100 x 2^exposure x responsivity / N^2: 1/60 s at ISO 400, f/2, one stop, 1.5."""
    stage = empty()
    authored = camera(stage)
    authored.CreateExposureAttr(1.0)
    for name, value in (("iso", 400.0), ("time", 1 / 60), ("fStop", 2.0), ("responsivity", 1.5)):
        authored.GetPrim().GetAttribute(f"exposure:{name}").Set(value)
    wanted = 1 / 60 * 4.0 / 2.0**2 * 2.0 * 1.5
    assert any(f"a factor of {wanted:.4g})" in note.text for note in translate(stage).notes)


def test_a_rolling_shutter_is_open_until_the_last_row_ends(empty):
    """10 m in 24 frames at 24 frames a second; each row exposes for a quarter of a frame, the last begins 1/32 s (3/4
    of a frame) after the first: from the first row's beginning to the last one's end one frame, 3/4 of it to begin.
    """
    stage = empty()
    authored = UsdGeom.Camera.Get(stage, "/Camera")
    authored.ClearXformOpOrder()
    move = authored.AddTranslateOp()
    for frame in (0, 24):
        move.Set((0.0, frame / 2.4, 1.5), frame)
    authored.CreateShutterCloseAttr(0.25)
    readout = authored.GetPrim().CreateAttribute("synfog:shutter:readout", Sdf.ValueTypeNames.Float)
    readout.Set(1 / 32)
    stage.SetTimeCodesPerSecond(24)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(24)
    scene = translate(stage, frame=6)
    assert scene.camera.rolling == pytest.approx(0.75)
    assert scene.camera.shutter_s == pytest.approx(1 / 24)
    np.testing.assert_allclose(scene.camera.drift_m, [0.0, 1 / 2.4, 0.0], atol=1e-6)
    np.testing.assert_allclose(scene.camera.to_world[:3, 3] + scene.origin_m, [0.0, 6.5 / 2.4, 1.5], atol=1e-6)
    readout.Set(0.0)
    assert translate(stage, frame=6).camera.rolling == 0.0
    readout.Set(float("nan"))
    broken = translate(stage, frame=6)
    assert broken.camera.rolling == 0.0
    assert any("synfog:shutter:readout is nan, which is no time" in note.text for note in broken.notes)


def test_the_mode_of_the_shutter_is_read_and_one_that_is_none_is_told(empty):
    """Rows end 3/4 of the time apart instead of beginning so; the window is that of a shutter that rolls."""
    stage = empty()
    authored = fill(UsdGeom.Camera.Get(stage, "/Camera"), shutterClose=0.25)
    authored.GetPrim().CreateAttribute("synfog:shutter:readout", Sdf.ValueTypeNames.Float).Set(1 / 32)
    stage.SetTimeCodesPerSecond(24)
    assert not translate(stage, frame=6).camera.global_reset
    mode = authored.GetPrim().CreateAttribute("synfog:shutter:mode", Sdf.ValueTypeNames.Token)
    mode.Set("global_reset")
    seen = translate(stage, frame=6).camera
    assert seen.global_reset and seen.rolling == pytest.approx(0.75)
    mode.Set("strobe")
    broken = translate(stage, frame=6)
    assert not broken.camera.global_reset
    assert any("'strobe'; it takes rolling or global_reset" in note.text for note in broken.notes)
