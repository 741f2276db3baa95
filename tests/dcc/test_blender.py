"""The Blender round trip: fog by the add-on, exported, read, and compared with the same street written by hand.

Needs a Python with bpy, named by SYNFOG_BPY; `make test-dcc` makes one.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from synfog_usd.camera.profiles import load_lens, load_sensor, shipped
from synfog_usd.camera.writers.exr import read_exr
from synfog_usd.stage import check, open_stage, select, variants
from synfog_usd.translate import outdoors, translate

BPY = os.environ.get("SYNFOG_BPY", "")
pytestmark = pytest.mark.skipif(not BPY, reason="SYNFOG_BPY names no Python that has bpy")
ROOT = Path(__file__).resolve().parents[2]


def has_usd():
    """Whether the Python that is asked has Blender's own USD library: bpy 4.2's wheels have none."""
    code = "import bpy; from pathlib import Path; place = Path(bpy.utils.system_resource('SCRIPTS')).parent"
    code += "; print(list(place.glob('python/lib/*/*/pxr')))"
    return bool(BPY) and "pxr" in subprocess.run([BPY, "-c", code], capture_output=True, text=True, timeout=60).stdout


hooked = pytest.mark.skipif(not has_usd(), reason="this bpy has no USD library for Python")

# By hand: the box reaches 20 m beyond what there is and 1 m below it; x -10..10, y -20..100, z -1..5 (the lamp).  The
# sky is 1000 nits.
BY_HAND = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Z"
)
def Xform "World" {
    def Cube "Fog" (prepend apiSchemas = ["SynFogMediumAPI"]) {
        uniform token purpose = "guide"
        double size = 1
        float synfog:fog:mor = 150
        double3 xformOp:translate = (0, 40, 11.5)
        float3 xformOp:scale = (60, 160, 27)
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
    }
    def Cube "Car" (prepend apiSchemas = ["SemanticsLabelsAPI:cityscapes"]) {
        token[] semantics:labels:cityscapes = ["car"]
        double size = 1
        double3 xformOp:translate = (1, 20, 0.75)
        float3 xformOp:scale = (2, 4, 1.5)
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
    }
    def Cube "Road" (prepend apiSchemas = ["SemanticsLabelsAPI:cityscapes"]) {
        token[] semantics:labels:cityscapes = ["road"]
        double size = 1
        double3 xformOp:translate = (0, 40, -0.5)
        float3 xformOp:scale = (20, 120, 1)
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
    }
    def DomeLight "Sky" {
        float inputs:intensity = 1000
    }
    def Camera "Ego" {
        float2 clippingRange = (0.1, 1000)
        float focalLength = 0.35
        float horizontalAperture = 0.36
        float verticalAperture = 0.2025
        double3 xformOp:translate = (0, 0, 1.5)
        float xformOp:rotateX = 90
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateX"]
    }
}
"""


def exported(folder, fogs):
    """The street as Blender writes it with the add-on's hook."""
    folder.mkdir()
    path = folder / "street.usda"
    script = Path(__file__).with_name("blender_street.py")
    done = subprocess.run(
        [BPY, str(script), str(ROOT / "integrations" / "blender"), str(path), fogs],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0 and path.is_file(), done.stdout + done.stderr
    return path


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return exported(tmp_path_factory.mktemp("plain") / "out", "")


@pytest.fixture(scope="module")
def varied(tmp_path_factory):
    return exported(tmp_path_factory.mktemp("varied") / "out", "clear,mor300,mor150")


@hooked
def test_what_blender_exports_is_proper_usd(plain, varied):
    """Nothing that `check` finds; a guide prim with the schema, labels as schemas, no custom properties left."""
    for path in (plain, varied):
        assert check(open_stage(path)) == []
    stage = Usd.Stage.Open(str(plain))
    (fog,) = [prim for prim in stage.Traverse() if "SynFogMediumAPI" in prim.GetPrimTypeInfo().GetAppliedAPISchemas()]
    assert fog.GetAttribute("purpose").Get() == "guide" and fog.GetAttribute("synfog:fog:mor").Get() == 150.0
    labels = {
        prim.GetName(): prim.GetAttribute("semantics:labels:cityscapes").Get()
        for prim in stage.Traverse()
        if prim.GetAttribute("semantics:labels:cityscapes")
    }
    assert {name: list(words) for name, words in labels.items()} == {"Car": ["car"], "Road": ["road"]}
    assert not [
        prop.GetName()
        for prim in stage.Traverse()
        for prop in prim.GetAuthoredProperties()
        if "userProperties:synfog" in prop.GetName()
    ]


def test_the_scene_is_that_which_was_written_by_hand(plain, tmp_path):
    """Fog box, extinction, camera and labels; float32 in Blender's transforms."""
    (tmp_path / "hand.usda").write_text(BY_HAND, encoding="utf-8")
    theirs, ours = translate(open_stage(plain)), translate(open_stage(tmp_path / "hand.usda"))
    (fog,), (wanted,) = theirs.fog, ours.fog
    assert fog.boundary.kind == wanted.boundary.kind == "box"
    corners = [
        np.sort(volume.boundary.surface_points(), axis=0)[[0, -1]] + np.array(scene.origin_m)
        for scene, volume in ((theirs, fog), (ours, wanted))
    ]
    np.testing.assert_allclose(corners[0], corners[1], atol=1e-4)
    np.testing.assert_allclose(fog.medium.sigma_t_per_m, wanted.medium.sigma_t_per_m, rtol=1e-6)
    np.testing.assert_allclose(
        [theirs.camera.fov_x_deg, *theirs.origin_m], [ours.camera.fov_x_deg, *ours.origin_m], atol=1e-4
    )
    assert (
        {instance.label for instance in theirs.instances}
        == {instance.label for instance in ours.instances}
        == {"car", "road"}
    )


@hooked
def test_variants_are_shots(varied):
    """Visibilities by name, clear air without the fog, the lamp with 'active' only."""
    stage = open_stage(varied)
    assert variants(stage) == {"fog": ["clear", "mor150", "mor300"], "lighting": ["active", "sky"]}
    for name, wanted in (("clear", []), ("mor300", [300.0]), ("mor150", [150.0])):
        select(stage, fog=name)
        np.testing.assert_allclose([volume.medium.visibility_m for volume in translate(stage).fog], wanted, rtol=1e-6)
    for name, lamps in (("active", 1), ("sky", 0)):
        select(stage, lighting=name)
        parts = [part for part in translate(stage).world.values() if isinstance(part, dict)]
        assert sum("emitter" in part or part["type"] == "point" for part in parts) == lamps


@hooked
def test_the_picture_is_that_of_the_street_written_by_hand(varied, tmp_path):
    """Without the lamp the two bake to the same light: 64 x 36 pixels to 2 % each, so that blocks of 48 differ by some
    0.4 %.  Not denoised: that leaves errors which neighbours share, up to 5 % of a block.
    """
    (tmp_path / "hand.usda").write_text(BY_HAND, encoding="utf-8")
    means = []
    for name, path, more in (
        ("blender", varied, ["--lighting", "sky", "--fog", "mor150"]),
        ("hand", tmp_path / "hand.usda", []),
    ):
        words = [
            "bake", path, "-o", tmp_path / name, "--resolution", "64x36", "--samples", "1024",
            "--quality", "reference", *more,
        ]  # fmt: skip
        done = subprocess.run(
            [sys.executable, "-m", "synfog_usd.cli.main", *map(str, words)], capture_output=True, text=True, timeout=300
        )
        assert done.returncode == 0, done.stderr
        (row,) = json.loads((tmp_path / name / "bake.json").read_text())["shots"]
        means.append(
            read_exr(tmp_path / name / row["lighting"] / row["fog"] / "radiance.exr")
            .pixels.reshape(6, 6, 8, 8, 3)
            .mean(axis=(1, 3))
        )
    np.testing.assert_allclose(means[0], means[1], rtol=0.02)
    np.testing.assert_allclose(means[0].mean(), means[1].mean(), rtol=0.003)


@pytest.fixture(scope="module")
def used(tmp_path_factory):
    """The extension, packed by the command line, installed into a fresh Blender and used."""
    folder = tmp_path_factory.mktemp("used")
    words = [sys.executable, "-m", "synfog_usd.cli.main", "plugin-path", "--blender", str(folder / "synfog_fog.zip")]
    subprocess.run(words, check=True, capture_output=True, timeout=60)
    script = Path(__file__).with_name("blender_use.py")
    fresh = {**os.environ, "BLENDER_USER_RESOURCES": str(folder / "user")}
    done = subprocess.run(
        [BPY, str(script), str(folder / "synfog_fog.zip")], capture_output=True, text=True, env=fresh, timeout=300
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_the_extension_installs_from_its_file(used):
    assert "bl_ext.user_default.synfog_fog" in used["add_ons"]


def test_the_box_shows_its_fog_in_blender_and_follows_its_visibility(used):
    """A cube of 2 m with 20 m around it and 1 m below; density is -ln(0.05) / visibility, 1/m."""
    assert used["size"] == used["again"] == [42.0, 42.0, 23.0]
    np.testing.assert_allclose(
        used["density"], -np.log(0.05) / np.array([120.0, 60.0]), rtol=2e-4
    )  # 2.996 is -ln 0.05 to 1e-4


def test_what_the_extension_does_can_be_undone(used):
    """Two steps back, the box, its mesh and its material are gone."""
    assert used["undone"] == [["Cube"], 0]


def test_the_extension_refuses_what_would_go_wrong_later(used):
    """A fog of no visibility is told at once, and no box is put into a mesh that is being edited."""
    assert "fog9: no fog" in used["wrong"] and used["set"] is False and used["while_editing"] is False


@pytest.fixture(scope="module")
def baked(tmp_path_factory):
    """A scene lit by the presets, seen by their cameras, checked and baked from inside Blender."""
    folder = tmp_path_factory.mktemp("baked")
    words = [sys.executable, "-m", "synfog_usd.cli.main", "plugin-path", "--blender", str(folder / "synfog_fog.zip")]
    subprocess.run(words, check=True, capture_output=True, timeout=60)
    tool = folder / "synfog-usd"
    tool.write_text(f'#!/bin/sh\nexec {sys.executable} -m synfog_usd.cli.main "$@"\n', encoding="utf-8")
    tool.chmod(0o755)
    done = subprocess.run(
        [BPY, str(Path(__file__).with_name("blender_bake.py")), *map(str, (folder / "synfog_fog.zip", folder, tool))],
        capture_output=True,
        text=True,
        env={**os.environ, "BLENDER_USER_RESOURCES": str(folder / "user")},
        timeout=300,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_presets_of_light_arrive_as_their_lux(baked):
    """Sun across its rays and ground under sun and sky, of the exported stage: by the preset's own words, to 1 %."""
    words = {"noon": (85000, 85000 * np.sin(np.radians(50)) + np.pi * 5000), "overcast": (0, np.pi * 4000)}
    words |= {"dusk": (0, np.pi * 3), "night": (0.25, 0.25 * np.sin(np.radians(40)) + np.pi * 0.01)}
    for name, wanted in words.items():
        found = outdoors(translate(open_stage(baked["lights"][name])))
        np.testing.assert_allclose([found.sun_lux, found.ground_lux], wanted, rtol=0.01)


def test_presets_of_cameras_arrive_as_their_sensors(baked):
    """Every shipped sensor: the angle of its width behind its lens, its picture's shape, and the lens's f-number."""
    assert set(baked["cameras"]) == set(shipped("sensors"))
    for name, (file, f_number) in baked["cameras"].items():
        sensor, known = load_sensor(name), {load_lens(one) for one in shipped("lenses")}
        stage = Usd.Stage.Open(file)
        (camera,) = [UsdGeom.Camera(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Camera)]
        width, height = camera.GetHorizontalApertureAttr().Get(), camera.GetVerticalApertureAttr().Get()
        focal = camera.GetFocalLengthAttr().Get()
        assert width / height == pytest.approx(sensor.width_px / sensor.height_px, rel=1e-3)
        wanted = [lens.focal_length_mm for lens in known if abs(lens.f_number - f_number) < 1e-3]
        assert width / focal in [
            pytest.approx(sensor.width_px * sensor.pixel_pitch_um / 1000 / mm, rel=1e-4) for mm in wanted
        ]


def test_a_bake_from_inside_blender_opens_its_pictures(baked):
    """Nothing is found; the bake ends, and the picture of its only shot is in the image editor, 5 % of 752 x 480."""
    assert baked["check"] == [["FINISHED"], [["done", [], "Nothing is wrong"]]]
    assert baked["bake"] == ["FINISHED"] and baked["progress"]
    assert baked["shown"] == ["Synfog srgb"] and baked["images"]["Synfog srgb"] == [38, 24]
    assert "Synfog contact" in baked["images"] and baked["after"][0][0] == "done"


def test_faults_are_shown_on_their_objects(baked):
    """A car of 20 m, by Check; two boxes of fog that cut through each other, by Bake: selected, and told."""
    (car, told), (boxes, refused) = baked["faults"]
    ((severity, names, text),) = told
    assert car == names == ["Red Car.001"] and severity == "warning"
    assert text.startswith("this car is 20 m long") and "Mend: " in text  # as Blender's button, and how to mend it
    assert boxes == ["Bank", "Fog"] and "cut through each other" in refused


def test_a_dusk_by_preset_is_not_doubted(baked):
    """A dim world from Blender is taken for one whose strength is no nits, but not where the preset set it."""
    assert [severity for severity, _, _ in baked["dusk"]] == ["done"]


def test_a_bake_shows_how_far_it_is_and_can_be_stopped(baked):
    """Share, step and seconds in the panel, with a button; no second bake is begun beside it."""
    panel, *may = baked["while baking"]
    assert may == [False, False] and ["progress", "42 %"] in panel and ["operator", "synfog.stop"] in panel
    assert ["label", "Rendering, 7 s"] in panel
    assert not [text for _, text in panel if text.startswith("Bake ")]
    assert baked["stop"] == [["FINISHED"], True] and baked["may bake"]


def test_fog_gets_no_label(baked):
    """With everything selected it stays as it was, and alone it cannot be labelled."""
    labels, alone = baked["label"]
    assert labels["Fog"] is None and labels["Road"] == labels["Red Car.001"] == "bus" and alone is False


WITHOUT_USD = """
import sys, bpy
from types import SimpleNamespace
class Less:
    def __init__(self, whole, **other):
        self.whole, self.__dict__["other"] = whole, other
    def __getattr__(self, name):
        if name == "USDHook":
            raise AttributeError(name)
        return self.other[name] if name in self.other else getattr(self.whole, name)
bpy.types, bpy.app = Less(bpy.types), Less(bpy.app, build_options=SimpleNamespace(usd=False))
sys.path.insert(0, sys.argv[-1])
import synfog_fog
synfog_fog.register()
print(bpy.ops.synfog.bake.poll(), bpy.ops.synfog.check.poll(), bpy.ops.synfog.add_fog.poll())
synfog_fog.unregister()
"""


def test_a_blender_without_usd_has_the_rest():
    """Linux distributions build Blender without it: the add-on starts, Check and Bake are greyed."""
    words = [BPY, "-c", WITHOUT_USD, str(ROOT / "integrations" / "blender")]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and done.stdout.splitlines()[-1] == "False False True", done.stdout + done.stderr
