"""A fisheye: angles against pixels by closed forms and by OpenCV, its rays, falloff, labels and RAW."""

from __future__ import annotations

import json
import struct
from dataclasses import replace

import cv2
import numpy as np
import pytest
import tifffile
from support import cli
from support.parts import glow

from synfog_usd import camera
from synfog_usd.base import resources
from synfog_usd.base.errors import GraphError, ImageError, ParameterError, StageError
from synfog_usd.base.fisheye import Fisheye
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import optics
from synfog_usd.camera.fisheye import of_graph
from synfog_usd.camera.graph import make_graph
from synfog_usd.camera.profiles import load_lens
from synfog_usd.camera.writers import read_exr
from synfog_usd.camera.writers.opcodes import opcode_list
from synfog_usd.dataset import scenes
from synfog_usd.dataset.exports.frames import Labels
from synfog_usd.dataset.objects import Projection, solids
from synfog_usd.render.film import aovs
from synfog_usd.render.load import to_mitsuba
from synfog_usd.render.shot import render
from synfog_usd.scene.testing import scene, sky, uniform_fog

WOODSCAPE = (339.749, -31.988, 48.275, -7.201)
F_THETA = Fisheye((1.0,), 200.0)
"""Equidistant: a pixel is the same angle everywhere along a radius."""

SIZE = (80, 60)
PX_A_RAD = SIZE[0] / np.radians(200.0)


def seen_by(source, lens=F_THETA, shift=(0.0, 0.0)):
    return replace(source, camera=replace(source.camera, fisheye=lens, fov_x_deg=lens.fov_x_deg, shift=shift))


def towards(angle_deg, turn_deg, distance_m=1.0):
    """A place in the scene by its angle to the axis of `LOOK_NORTH`, and the turn from the right to the top."""
    t, p = np.radians(angle_deg), np.radians(turn_deg)
    return distance_m * np.array([np.sin(t) * np.cos(p), np.cos(t), np.sin(t) * np.sin(p)])


def ball(place, radius_m, **emitter):
    return {"type": "sphere", "center": list(map(float, place)), "radius": radius_m, **emitter}


def test_a_place_and_its_angle_are_woodscapes():
    """u = rho(t) X / chi by the calibration's own formula, 1e-6 pixels; the angle of view is where rho is half the
    width.
    """
    half_fov = min(
        root.real for root in np.roots([*WOODSCAPE[::-1], -640.0]) if abs(root.imag) < 1e-9 and root.real > 0.0
    )
    lens = Fisheye(WOODSCAPE, 2.0 * np.degrees(half_fov))
    assert lens.fov_x_deg == pytest.approx(190.0, abs=0.5)
    rng = np.random.default_rng(3)
    point = rng.normal(size=(200, 3))
    point[:, 2] += 1.0
    chi = np.hypot(point[:, 0], point[:, 1])
    t = np.arctan2(chi, point[:, 2])
    rho = sum(k * t ** (power + 1) for power, k in enumerate(WOODSCAPE))
    wanted = point[:, :2] * (rho / chi)[:, None]
    np.testing.assert_allclose(lens.places(point) * 1280, wanted, atol=1e-6)
    back = lens.directions(wanted / 1280)
    np.testing.assert_allclose(back, point / np.linalg.norm(point, axis=1, keepdims=True), atol=1e-9)
    np.testing.assert_allclose(lens.polynomial(1280), WOODSCAPE, rtol=1e-9)


def test_a_place_is_opencvs():
    """Kannala and Brandt's k1 to k4 as OpenCV's fisheye module takes them, within 1e-6 pixels."""
    k, width, focal = (-0.02, 0.006, -0.003, 0.0004), 1000, 320.0
    lens = Fisheye((1.0, 0.0, k[0], 0.0, k[1], 0.0, k[2], 0.0, k[3]), 150.0)
    scale = lens.polynomial(width)[0] / focal
    points = np.stack(np.meshgrid(np.linspace(-3, 3, 7), np.linspace(-2, 2, 5)), axis=-1).reshape(-1, 2)
    points = np.c_[points, np.full(len(points), 0.7)]
    matrix = np.diag([focal * scale, focal * scale, 1.0])
    wanted, _ = cv2.fisheye.projectPoints(points[:, None], np.zeros(3), np.zeros(3), matrix, np.array(k))
    np.testing.assert_allclose(lens.places(points) * width, wanted[:, 0], atol=1e-6)


@pytest.mark.parametrize(("coefficients", "fov"), [((1.0, 0.0, -0.2), 190.0), ((), 90.0)])
def test_a_lens_that_folds_is_refused(coefficients, fov):
    """t - 0.2 t^3 falls from sqrt(1 / 0.6) = 74 degrees on."""
    with pytest.raises(ValueError, match="angle of view"):
        Fisheye(coefficients, fov)
    with pytest.raises(ValueError, match="17 coefficients; 16 are the most"):
        Fisheye((1.0,) * 17, 90.0)


def test_rays_are_those_of_the_lens():
    """An equidistant lens: the ray through a pixel's centre leaves at the angle of its distance from the axis, within
    1e-6 rad, the axis shifted.
    """
    source = seen_by(scene({}, width_px=SIZE[0], height_px=SIZE[1]), shift=(0.05, -0.02))
    origin, direction = aovs.centre_rays(to_mitsuba(source))
    y, x = np.divmod(np.arange(SIZE[0] * SIZE[1]), SIZE[0])
    right = x + 0.5 - SIZE[0] * (0.5 - 0.05)
    up = SIZE[1] * (0.5 - 0.02) - (y + 0.5)
    angle, turn = np.hypot(right, up) / PX_A_RAD, np.arctan2(up, right)
    wanted = np.stack([np.sin(angle) * np.cos(turn), np.cos(angle), np.sin(angle) * np.sin(turn)], axis=1)
    apart = np.arctan2(np.linalg.norm(np.cross(direction, wanted), axis=1), (direction * wanted).sum(axis=1))
    assert apart.max() < 1e-6
    np.testing.assert_allclose(source.camera.directions((np.c_[x, y] + 0.5) / SIZE), wanted, atol=1e-9)
    np.testing.assert_allclose(origin, wanted * source.camera.near_m, atol=1e-6)


def test_labels_are_of_those_rays():
    """A ball 95 degrees to the right, behind the plane of the lens: its pixels are those whose rays pass its centre by
    less than its radius, its depth is below 0, and its box is that of the two angles at which it ends.
    """
    place, radius = towards(95.0, 0.0, 10.0), 2.0
    source = seen_by(scene({"shape_ball": ball(place, radius)}, width_px=SIZE[0], height_px=SIZE[1]))
    seen = aovs.measure(to_mitsuba(source))
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    right, up = x + 0.5 - SIZE[0] / 2, SIZE[1] / 2 - (y + 0.5)
    angle, turn = np.hypot(right, up) / PX_A_RAD, np.arctan2(up, right)
    way = np.stack([np.sin(angle) * np.cos(turn), np.cos(angle), np.sin(angle) * np.sin(turn)], axis=-1)
    passes = np.linalg.norm(np.cross(way, place), axis=-1)
    inside = (passes < radius) & (way @ place > 0.0)
    assert inside.sum() > 10
    clear = np.abs(passes - radius) > 1e-3
    np.testing.assert_array_equal(seen.instance_id[clear] == 1, inside[clear])
    wanted = way @ place - np.sqrt(np.maximum(radius**2 - passes**2, 0.0))
    here = inside & clear
    np.testing.assert_allclose(seen.distance_m[here], wanted[here], rtol=1e-3)
    np.testing.assert_allclose(seen.depth_m[here], wanted[here] * np.cos(angle[here]), atol=1e-3)
    assert (seen.depth_m[here & (angle > np.pi / 2)] < 0.0).all()
    view = Projection.of(source.camera)
    left, _, end, _ = view.box_px(solids(source)[1])
    reach = np.degrees(np.arcsin(radius / 10.0))
    ends = SIZE[0] / 2 + np.radians([95.0 - reach, 95.0 + reach]) * PX_A_RAD
    np.testing.assert_allclose([left, end], ends, atol=0.05)
    told = view.metadata((0.0, 0.0, 0.0))
    assert told["model"] == "fisheye" and "camera_matrix_px" not in told
    np.testing.assert_allclose(told["radius_px"], [PX_A_RAD], rtol=1e-6)
    np.testing.assert_allclose(told["axis_px"], [SIZE[0] / 2 - 0.5, SIZE[1] / 2 - 0.5])


def test_a_picture_is_drawn_by_those_rays():
    """A shining ball behind the plane of the lens, under a sky of 1 nit in fog: its light has its centre where the
    closed form puts it, within a tenth of a pixel, and the sky is as bright in the corner as on the axis.
    """
    light = glow(50.0)
    place = towards(93.0, 180.0, 20.0)
    world = {**sky(1.0), "shape_ball": ball(place, 1.5, emitter=light)}
    source = seen_by(scene(world, width_px=SIZE[0], height_px=SIZE[1]))
    clear = render(source, model="path", samples=32, seed=1, denoise=False)
    pixels = clear.radiance.pixels[..., 1] - 1.0
    x = (np.arange(SIZE[0]) + 0.5)[None, :]
    y = (np.arange(SIZE[1]) + 0.5)[:, None]
    near = x < 8
    centre = [float((pixels * part * near).sum() / (pixels * near).sum()) for part in (x, y)]
    np.testing.assert_allclose(centre, [SIZE[0] / 2 - np.radians(93.0) * PX_A_RAD, SIZE[1] / 2], atol=0.1)
    np.testing.assert_allclose(clear.radiance.pixels[:5, -5:], 1.0, rtol=1e-5)
    assert "fov_x_deg" not in clear.radiance.provenance
    assert clear.radiance.provenance["fisheye_fov_x_deg"] == 200.0


@pytest.mark.parametrize("model", ["path", pytest.param("volpath", marks=pytest.mark.slow)])
def test_fog_is_the_same_behind_it_by_another_model(model):
    """The furnace: in fog that takes no light a sky of 1 is 1 everywhere; volpath's mean of 3072 paths is known to
    0.006.
    """
    source = seen_by(scene(sky(1.0), [uniform_fog(60.0)], width_px=8, height_px=6))
    found = render(source, model=model, samples=64, seed=2, denoise=False).radiance.pixels
    assert found.mean() == pytest.approx(1.0, abs=0.02)
    np.testing.assert_allclose(found, 1.0, atol=0.2)


def picture(falloff, lens=F_THETA, glass=None):
    image = Image(
        np.ones((SIZE[1], SIZE[0], 3), np.float32),
        ("R", "G", "B"),
        Quantity.RADIANCE,
        provenance={"fisheye_coefficients": list(lens.coefficients), "fisheye_fov_x_deg": lens.fov_x_deg},
    )
    return optics.irradiance(image, f_number=2.0, transmission=1.0, falloff=falloff, lens=glass)


def test_the_falloff_is_the_lens_s_own():
    """sin t / t of an equidistant lens; a lens's table by the angle, beyond 90 degrees too."""
    y, x = np.mgrid[: SIZE[1], : SIZE[0]] + 0.5
    angle = np.hypot(x - SIZE[0] / 2, y - SIZE[1] / 2) / PX_A_RAD
    axis = np.pi / 17.0
    np.testing.assert_allclose(picture("projection").pixels[..., 0], axis * np.sin(angle) / angle, rtol=1e-5)
    found = picture(
        "table", glass=replace(load_lens("pixel4a"), field_deg=(0.0, 150.0), relative_illumination=(1.0, 0.0))
    ).pixels[..., 0]
    np.testing.assert_allclose(found, axis * (1.0 - np.degrees(angle) / 150.0), rtol=1e-5)
    with pytest.raises(ImageError, match="falloff cos4 is a pinhole's"):
        picture("cos4")


def test_what_is_no_fisheye_s_is_refused(tmp_path):
    graph = camera.load_graph(resources.folder("pipeline") / "surround.yaml")
    flat = Image(np.ones((4, 4, 3), np.float32), ("R", "G", "B"), Quantity.RADIANCE, provenance={"fov_x_deg": 60.0})
    with pytest.raises(ImageError, match="a pinhole's of 60 degrees"):
        camera.develop(graph, {"radiance": flat}, seed=0)
    with pytest.raises(ImageError, match="a field of view is a pinhole's"):
        camera.field_of_view(flat, graph, fov_x_deg=60.0)
    both = make_graph(
        camera.OPS,
        extends="surround",
        nodes=[
            {"name": "bend", "op": "optics.distortion", "coefficients": [0.1, 0.0, 0.0, 0.0], "after": "irradiance"}
        ],
    )
    with pytest.raises(GraphError, match="a fisheye already"):
        of_graph(both)
    lens = of_graph(graph)
    wide = scene({}, width_px=8, height_px=6)
    assert scenes._through(wide, lens).camera.fisheye == lens
    blurred = scenes._through(replace(wide, camera=replace(wide.camera, f_number=2.8)), lens)
    assert [note.text for note in blurred.notes] == ["its fStop blurs nothing: behind a fisheye all is drawn sharp"]
    with pytest.raises(StageError, match="orthographic"):
        scenes._through(replace(wide, camera=replace(wide.camera, width_m=3.0)), lens)
    with pytest.raises(StageError, match="lie beyond the picture"):
        scenes._through(wide, Fisheye((1.0, 0.0, -0.1), 200.0))
    labels = Labels(*4 * [np.zeros((1, 1))], {"model": "fisheye", "path": "/Eye"}, [], {})
    with pytest.raises(ParameterError, match="KITTI knows pinholes alone"):
        labels.refuse_fisheye("KITTI")


def test_the_raw_file_unfolds_it():
    """WarpFisheye by the DNG specification, 1.7.1 chapter 7: of a straight picture whose farthest corner is at 45
    degrees, the place in the fisheye's is at kr0 t + kr1 t^3 + kr2 t^5 + kr3 t^7, to 1e-6 of that corner's distance.
    """
    height, width = 60, 80
    lens = Fisheye((1.0, 0.0, 0.05, 0.0, -0.002), 190.0)
    told = {"fisheye_coefficients": list(lens.coefficients), "fisheye_fov_x_deg": 190.0, "falloff": "projection"}
    data = opcode_list(height, width, told)
    count, number, _since, flags, size = struct.unpack_from(">5I", data)
    planes, *kr, cx, cy = struct.unpack_from(">I6d", data, 20)
    assert (count, number, flags, planes) == (2, 2, 1, 1) and size == 4 + 6 * 8
    np.testing.assert_allclose([cx, cy], 0.5)
    corner = np.hypot(width - 1, height - 1) / 2
    straight = np.linspace(0.0, 1.0, 11)
    t = np.arctan(straight)
    found = corner * sum(part * t ** (2 * power + 1) for power, part in enumerate(kr))
    half = np.radians(95.0)
    focal = width / 2 / (half + 0.05 * half**3 - 0.002 * half**5)
    np.testing.assert_allclose(found, focal * (t + 0.05 * t**3 - 0.002 * t**5), atol=1e-6 * corner)
    k = struct.unpack_from(">5d", data, 20 + size + 16)
    light = 1.0 / (1.0 + sum(part * straight ** (2 * power + 2) for power, part in enumerate(k)))
    slope = 1.0 + 0.15 * t**2 - 0.01 * t**4
    radius = t + 0.05 * t**3 - 0.002 * t**5
    wanted = np.r_[1.0, np.sin(t[1:]) / (radius * slope)[1:]]
    np.testing.assert_allclose(light, wanted, rtol=1e-3)


@pytest.mark.slow
def test_a_bake_is_of_the_fisheye_throughout(tmp_path):
    """A cube 90 degrees to the right, on a stage whose camera is a pinhole of 55 degrees: it is in the picture and the
    labels where WoodScape's formula has it; radiance.exr tells the lens, and the RAW file unfolds it.
    """
    (tmp_path / "stage.usda").write_text(
        """#usda 1.0
        (
            metersPerUnit = 1
            upAxis = "Y"
        )
        def Camera "Eye" {
        }
        def Cube "Car" (
            prepend apiSchemas = ["SemanticsLabelsAPI:cityscapes"]
        ) {
            double size = 2
            token[] semantics:labels:cityscapes = ["car"]
            double3 xformOp:translate = (10, 0, 0)
            uniform token[] xformOpOrder = ["xformOp:translate"]
        }
        def DomeLight "Sky" {
            float inputs:intensity = 100
        }
        """
    )
    small = ("--resolution", "128x96", "--samples", "4", "--pipeline", "surround")
    done = cli.run("bake", tmp_path / "stage.usda", "-o", tmp_path / "out", *small)
    assert done.returncode == 0, done.stderr
    told = json.loads((tmp_path / "out" / "labels.json").read_text())
    (car,) = (row for row in told["instances"] if row["label"] == "car")
    half = np.radians(95.0)
    rho = [sum(k * t ** (power + 1) for power, k in enumerate(WOODSCAPE)) for t in (np.radians(90.0), half)]
    wanted = 64.0 + 64.0 * rho[0] / rho[1]
    x, y, width, height = car["box_px"]
    assert told["camera"]["model"] == "fisheye" and car["pixels"] > 20
    assert x < wanted < x + width and abs(y + height / 2 - 48.0) < 1.0
    left, top, right, bottom = car["projected_box_px"]
    np.testing.assert_allclose([left, top, min(right, 128.0), bottom], [x, y, x + width, y + height], atol=1.0)
    (radiance,) = (tmp_path / "out").rglob("radiance.exr")
    known = read_exr(radiance).provenance
    assert known["fisheye_fov_x_deg"] == 190.0 and "fov_x_deg" not in known
    with tifffile.TiffFile(radiance.parent / "raw.dng") as raw:
        opcodes = raw.pages[0].tags[51022].value
    assert struct.unpack_from(">2I", opcodes)[1] == 2, "WarpFisheye"
