"""Stages and models that were made elsewhere, from the file to radiance and labels."""

import json
from pathlib import Path

import numpy as np
import pytest
from support import cli

from synfog_usd.camera.writers.exr import read_exr

REAL = Path(__file__).resolve().parents[3] / "shared" / "usd"
SKY, ROAD, PERSON, CAR, TRUCK = 23, 7, 24, 26, 27
"""Class numbers of the Cityscapes authors' table."""

VEHICLES = REAL / "vehicles/USD_Mini_Car_Kit/assets/vehicles"
PEOPLE = REAL / "people"

HEAD = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Z"
)
def Xform "World" {
    def Cube "Fog" (prepend apiSchemas = ["SynFogMediumAPI"]) {
        uniform token purpose = "guide"
        float synfog:fog:mor = 150
        double3 xformOp:translate = (0, 60, 20)
        float3 xformOp:scale = (60, 100, 30)
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
        float xformOp:rotateX = 88
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateX"]
    }
    def Mesh "Ground" (prepend apiSchemas = ["SemanticsLabelsAPI:cityscapes", "MaterialBindingAPI"]) {
        token[] semantics:labels:cityscapes = ["road"]
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(-50, -30, 0), (50, -30, 0), (50, 150, 0), (-50, 150, 0)]
        uniform token subdivisionScheme = "none"
        rel material:binding = </World/Asphalt>
    }
    def Material "Asphalt" {
        token outputs:surface.connect = </World/Asphalt/Shader.outputs:surface>
        def Shader "Shader" {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor = (0.12, 0.12, 0.12)
            float inputs:roughness = 0.9
            token outputs:surface
        }
    }
"""

PLACED = """    def Xform "{name}" (
        prepend apiSchemas = ["SemanticsLabelsAPI:cityscapes"]
        prepend references = @{asset}@
        {variants}
    )
    {{
        token[] semantics:labels:cityscapes = ["{label}"]
        double3 xformOp:translate:place = ({x}, {y}, {z})
        float3 xformOp:rotateXYZ:place = (90, 0, {turn})
        float3 xformOp:scale:place = ({scale}, {scale}, {scale})
        uniform token[] xformOpOrder = ["xformOp:translate:place", "xformOp:rotateXYZ:place", "xformOp:scale:place"]
    }}
"""

# name, file, label, x, y [m], turn [deg], metres by which its lowest point lies below its origin, variants
PLACES = (
    ("Sedan", "sedan/asset/sedanFullAsset.usda", "car", -3.0, 14.0, 20, 0.551, ""),
    ("Offroader", "4wd/asset/4wdFullAsset.usda", "car", 3.5, 16.0, -30, 0.551, ""),
    ("Van", "van/asset/vanFullAsset.usda", "car", 0.2, 22.0, 0, 0.551, ""),
    ("Ambulance", "ambulance/asset/ambulanceFullAsset.usda", "car", -6.0, 26.0, 45, 0.551, ""),
    ("Formula", "formula/asset/formulaFullAsset.usda", "car", 7.0, 24.0, 90, 0.231, ""),
    ("Flatbed", "truckFlat/asset/truckFlatFullAsset.usda", "truck", 16.0, 35.0, 0, 0.551, ""),
    ("Tractor", "vehicleVariants.usda", "truck", -11.0, 38.0, 60, 0.784, ""),
    ("Chosen", "vehicleVariants.usda", "car", 4.0, 45.0, 180, 0.551,
     'variants = {\n            string wheels = "sedan"\n        }'),
)  # fmt: skip
WALKERS = (
    ("Cesium", "CesiumMan/CesiumMan.usdz", -1.2, 7.0, 0.012),
    ("Rigged", "RiggedFigure/RiggedFigure.usdz", 1.2, 8.0, 0.022),
)


def bake(stage, out, *more, size="160x90", samples=8):
    """Bake through the command line; gives its manifest."""
    words = ["bake", stage, "-o", out, "--resolution", size, "--samples", samples, "--allow", REAL, *more]
    done = cli.run(*words)
    assert done.returncode == 0, done.stderr
    return json.loads((Path(out) / "bake.json").read_text())


def layers_of(out, shot):
    """All label layers and the shot's own, by channel name, (H, W) float64."""
    found = {}
    for path in (out / "labels.exr", out / shot / "layers.exr"):
        image = read_exr(path)
        found |= {name: image.pixels[:, :, index].astype(np.float64) for index, name in enumerate(image.channels)}
    return found


def luminance(out, shot):
    """Luminance [cd m-2] of the radiance: weights of ITU-R BT.709."""
    return read_exr(out / shot / "radiance.exr").pixels.astype(np.float64) @ [0.2126, 0.7152, 0.0722]


def warnings_of(printed):
    return {(note["path"], note["text"]) for note in printed["notes"] if note["severity"] == "warning"}


def assert_whole(out, shot):
    """The files of a shot are there and its radiance is light."""
    radiance = read_exr(out / shot / "radiance.exr").pixels
    assert {path.name for path in (out / shot).iterdir()} == {
        "radiance.exr", "layers.exr", "instances.json", "raw.dng", "srgb.png",
    }  # fmt: skip
    assert np.isfinite(radiance).all() and (radiance >= 0).all() and radiance.mean() > 0


def rays(shape, half, *, shift=(0.0, 0.0), pitch_deg=0.0):
    """Directions (H, W, 3), y = 1 along the axis, of a camera that looks north: from the tangents of half the angles of
    view and of the shift.
    """
    height, width = shape
    x = ((np.arange(width) + 0.5) / width * 2 - 1) * half[0] + shift[0]
    z = (1 - (np.arange(height) + 0.5) / height * 2) * half[1] + shift[1]
    x, z = np.broadcast_arrays(x[None, :], z[:, None])
    turn = np.radians(pitch_deg)
    return np.stack([x, np.cos(turn) - z * np.sin(turn), np.sin(turn) + z * np.cos(turn)], axis=2)


def length_in(low, high, eye, direction, distance):
    """Metres of the way from the eye to `distance` (H, W) that lie in an upright box."""
    direction = direction / np.linalg.norm(direction, axis=2, keepdims=True)
    with np.errstate(divide="ignore"):
        a, b = (np.array(low) - eye) / direction, (np.array(high) - eye) / direction
    enter, leave = np.minimum(a, b).max(axis=2), np.maximum(a, b).min(axis=2)
    return np.maximum(np.minimum(leave, distance) - np.maximum(enter, 0.0), 0.0)


# The centres' rays and Mitsuba's distances are float32, and so are EXR's numbers: 1e-6 of a way of up to 200 m, times
# its extinction.
TRANSMITTANCE = {"rtol": 1e-4, "atol": 1e-7}


@pytest.fixture(scope="module")
def parked(tmp_path_factory):
    """Eight vehicles and two people on a road under a grey sky in MOR 150: (folder, what was printed)."""
    if not (VEHICLES.is_dir() and PEOPLE.is_dir()):
        pytest.skip(f"no vehicles and people in {REAL}")
    folder = tmp_path_factory.mktemp("parked")
    stage = folder / "parked.usda"
    stage.write_text(parked_stage())
    return folder / "out", bake(stage, folder / "out", "--frames", 1)


def parked_stage():
    """The stage's text: models by reference, in metres, turned from Y up to Z up."""
    parts = [HEAD]
    for name, asset, label, x, y, turn, z, variants in PLACES:
        parts.append(
            PLACED.format(
                name=name, asset=VEHICLES / asset, label=label, x=x, y=y, z=z, turn=turn, scale=0.01, variants=variants
            )
        )
    for name, asset, x, y, z in WALKERS:
        parts.append(
            PLACED.format(name=name, asset=PEOPLE / asset, label="person", x=x, y=y, z=z, turn=0, scale=1, variants="")
        )
    return "".join(parts) + "}\n"


def test_models_from_elsewhere_bake_without_a_warning(parked):
    """References, variant sets, textures in a .usdz, skeletons: all is understood."""
    out, printed = parked
    assert_whole(out, "authored/authored")
    assert warnings_of(printed) == set()


def test_every_model_is_one_thing_of_its_class(parked):
    """Wheels, glass and lamps of a car carry the id of the prim that was labelled, and all ten are seen."""
    out, _ = parked
    instances = {row["path"]: row for row in json.loads((out / "labels.json").read_text())["instances"]}
    wanted = (
        {f"/World/{place[0]}": place[2] for place in PLACES}
        | {f"/World/{walker[0]}": "person" for walker in WALKERS}
        | {"/World/Ground": "road"}
    )
    assert {path: row["label"] for path, row in instances.items()} == wanted
    assert not [path for path, row in instances.items() if row["pixels"] < 20]
    layers = layers_of(out, "authored/authored")
    assert set(np.unique(layers["semantic.ID"])) == {SKY, ROAD, PERSON, CAR, TRUCK}
    for row in instances.values():
        seen = layers["instance.ID"] == row["id"]
        assert seen.sum() == row["pixels"] and (layers["semantic.ID"][seen] == row["semantic_id"]).all()


def test_the_picture_of_them_is_right_way_up_and_not_brighter_than_the_sky(parked):
    """Sky in the top rows and road in the bottom rows; nothing shines but a sky of 1000 nits, so nothing is brighter,
    and fog veils the distance.
    """
    out, _ = parked
    layers, light = layers_of(out, "authored/authored"), luminance(out, "authored/authored")
    assert (layers["semantic.ID"][:20] == SKY).all() and (layers["semantic.ID"][-15:] == ROAD).all()
    blocks = light.reshape(9, 10, 16, 10).mean(axis=(1, 3))
    assert blocks.max() < 1200.0  # 8 samples of 100 pixels resolve some 5 %
    road = layers["semantic.ID"] == ROAD
    near, far = (
        light[road & (layers["distance.Z"] > low) & (layers["distance.Z"] < high)].mean()
        for low, high in ((0.0, 8.0), (60.0, 140.0))
    )
    assert (
        near < 250.0 and 1.5 * near < far < light[:20].mean()
    )  # albedo 0.12: less than a quarter of the sky even with its gloss


@pytest.mark.parametrize("name, frame", [
    ("CesiumMan", 1.0),
    ("CesiumMan", 12.0),
    ("RiggedFigure", 0.0),
    ("CesiumMan", 0.0),
    ("CesiumMan", 7.3),
    ("RiggedFigure", 1.0),
    ("RiggedFigure", 12.0),
])  # fmt: skip
def test_people_are_posed_at_any_frame(name, frame):
    """The corners of the drawn body are those that USD's own skinning gives, also between two keys of the animation and
    before its first.
    """
    from pxr import Gf, Usd, UsdGeom, UsdSkel

    from synfog_usd.translate import translate

    path = PEOPLE / name / f"{name}.usdz"
    if not path.is_file():
        pytest.skip(f"no {path}")
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, "Y")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.Camera.Define(stage, "/Camera")
    stage.DefinePrim("/Person").GetReferences().AddReference(str(path))
    cache, wanted = UsdSkel.Cache(), []
    for root in (UsdSkel.Root(found) for found in stage.Traverse() if found.IsA(UsdSkel.Root)):
        cache.Populate(root, Usd.PrimDefaultPredicate)
        for binding in cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate):
            skeleton = cache.GetSkelQuery(binding.GetSkeleton())
            to_world = UsdGeom.Xformable(binding.GetSkeleton()).ComputeLocalToWorldTransform(frame)
            for target in binding.GetSkinningTargets():
                points = UsdGeom.Mesh(target.GetPrim()).GetPointsAttr().Get()
                assert target.ComputeSkinnedPoints(skeleton.ComputeSkinningTransforms(frame), points, frame)
                wanted += [tuple(to_world.Transform(Gf.Vec3d(*map(float, point)))) for point in points]
    scene = translate(stage, frame=frame)
    drawn = (
        np.concatenate([part["positions"] for key, part in scene.world.items() if key.startswith("shape_")])
        + scene.origin_m
    )
    x, y, z = np.array(wanted).T
    turned = np.stack([x, -z, y], axis=1)  # Y up to Z up
    np.testing.assert_allclose(
        [drawn.min(axis=0), drawn.max(axis=0)], [turned.min(axis=0), turned.max(axis=0)], atol=1e-4
    )  # float32 matrices


@pytest.fixture(scope="module")
def example(tmp_path_factory):
    """The example street in its own MOR 300 with a bank of MOR 60, headlights on: (folder, what was printed)."""
    stage = REAL / "example_street.usda"
    if not stage.is_file():
        pytest.skip(f"no {stage}")
    out = tmp_path_factory.mktemp("example") / "out"
    return out, bake(stage, out, "--fog", "mor300", "--lighting", "active", size="160x80")


def test_the_example_street_bakes_without_a_warning(example):
    out, printed = example
    assert_whole(out, "active/mor300")
    assert warnings_of(printed) == set()
    (row,) = printed["shots"]
    assert row["mor_m"] == 300 and row["camera"] == "/World/Ego"


def test_the_example_streets_car_is_where_its_numbers_say(example):
    """A car of 1.8 x 1.5 m whose back is at 37.9 m, seen from 1.4 m above the road with 35.15 degrees to each side:
    rows 39.7 to 44.2, columns 77.3 to 82.7.
    """
    out, _ = example
    (car,) = json.loads((out / "labels.json").read_text())["instances"]
    assert (car["path"], car["label"], car["box_px"], car["pixels"]) == ("/World/Car", "car", [77, 40, 6, 4], 24)
    assert car["distance_m"] == pytest.approx(37.9, abs=0.01)


def test_a_bank_in_the_example_streets_fog_adds_its_part(example):
    """MOR 300 outside of the bank and MOR 60 within, along every ray to the car or the end of the fog."""
    out, _ = example
    layers = layers_of(out, "active/mor300")
    eye, direction = (0.0, 0.0, 1.4), rays((80, 160), (0.704, 0.352))
    whole = length_in((-100, -50, -1), (100, 350, 99), eye, direction, layers["distance.Z"])
    bank = length_in((-10, 52, -0.5), (10, 68, 4.5), eye, direction, layers["distance.Z"])
    closed = 0.05 ** ((whole - bank) / 300.0 + bank / 60.0)
    beside = bank == 0.0
    assert bank.max() > 15.0
    np.testing.assert_allclose(layers["transmittance.Y"][beside], closed[beside], **TRANSMITTANCE)
    # Behind a boundary the ray goes on some 5 mm beside itself (Mitsuba's offset against meeting it again, 9e-5 of the
    # coordinates), which shifts where it leaves by 5 mm over the slope to that face: 4 cm where the bank's floor is
    # grazed.  Measured 1.6e-3.
    np.testing.assert_allclose(layers["transmittance.Y"], closed, rtol=2e-3)
