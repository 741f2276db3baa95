"""Labels of a tiny picture whose every pixel is known."""

import json
import re
import struct
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import maximum_filter, minimum_filter

from synfog_usd import camera
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import writers
from synfog_usd.dataset import labels, shot_files
from synfog_usd.dataset.plan import BakePlan
from synfog_usd.render.film.aovs import Aovs
from synfog_usd.scene import Camera, Instance, SceneDict

INSTANCES = (
    Instance(1, "/World/Road", "road"),
    Instance(2, "/World/Car", "car"),
    Instance(3, "/World/Behind", "person"),
    Instance(4, "/World/Blob", "unlabeled"),
)

IDS = np.array(
    [
        [0, 0, 0, 0, 0],
        [0, 2, 2, 4, 0],
        [1, 1, 2, 1, 1],
        [1, 1, 1, 1, 1],
    ]
)


@pytest.fixture
def aovs():
    """Four rows of five: sky, a car in an L, a road, one instance that is hidden."""
    depth = np.where(IDS > 0, 10.0 + np.arange(20).reshape(4, 5), np.inf)
    normal = np.zeros((4, 5, 3))
    normal[IDS == 1] = (0.0, 0.0, 1.0)
    normal[IDS == 2] = (0.0, -1.0, 0.0)
    return Aovs(
        distance_m=depth + 0.5,
        depth_m=depth,
        normal=normal,
        instance_id=IDS,
        part_id=np.zeros_like(IDS),
        transmittance=np.exp(-np.where(np.isfinite(depth), depth, 1e3) / 100),
    )


def plane(image, name):
    return image.pixels[:, :, image.channels.index(name)]


def bits(value):
    """The 32 bits of a float as 8 hexadecimal digits."""
    return f"{struct.unpack('<I', struct.pack('<f', value))[0]:08x}"


def test_an_id_is_the_hash_read_as_a_float():
    """The published id of "bunny", to the digits that it is published with."""
    assert labels._crypto_float("bunny") == pytest.approx(3.36000126251e-27, rel=1e-11)
    assert bits(labels._crypto_float("default")) == "42c9679f"


def test_no_id_is_infinite_nan_or_denormal():
    """Where the exponent's 8 bits are all 0 or all 1, the lowest of them is turned over and nothing else; 1 name in
    128.
    """
    odd = 0
    for name in (f"/World/Car_{index}" for index in range(4096)):
        raw, value = labels._murmur(name), labels._crypto_float(name)
        assert np.isfinite(value) and abs(value) >= np.finfo(np.float32).tiny
        strange = (raw >> 23) & 255 in (0, 255)
        odd += strange
        assert int(bits(value), 16) == raw ^ (0x00800000 if strange else 0)
    assert 0 < odd < 100  # 32 are expected, with a standard deviation of 5.6


def test_the_picture_has_every_aov_and_says_what_it_means(aovs):
    """Depth and distance in metres and infinite at the sky, ids as they are, Cityscapes' own class numbers."""
    image = labels.label_image(aovs, INSTANCES)
    assert (
        image.pixels.dtype == np.float32
        and image.pixels.shape == (4, 5, len(labels.CHANNELS))
        and image.channels == labels.CHANNELS
    )
    np.testing.assert_array_equal(plane(image, "depth.Z"), aovs.depth_m.astype(np.float32))
    np.testing.assert_array_equal(plane(image, "distance.Z"), aovs.distance_m.astype(np.float32))
    np.testing.assert_array_equal(np.stack([plane(image, f"N.{axis}") for axis in "XYZ"], axis=2), aovs.normal)
    np.testing.assert_array_equal(plane(image, "instance.ID"), IDS)
    class_of = np.array(
        [23, 7, 26, 24, 0]
    )  # sky, road, car, person and unlabeled in the table of the Cityscapes authors
    np.testing.assert_array_equal(plane(image, "semantic.ID"), class_of[IDS])


def test_a_surface_without_an_instance_is_unlabeled_and_not_sky(aovs):
    """What is drawn but has no label id has class 0 and no matte; sky is where the ray meets nothing."""
    depth = aovs.depth_m.copy()
    depth[0, 0] = 5.0
    image = labels.label_image(replace(aovs, depth_m=depth, distance_m=depth), INSTANCES)
    assert plane(image, "semantic.ID")[0, :2].tolist() == [0, 23]
    assert plane(image, "crypto_object00.G")[0, 0] == 0


def test_another_program_finds_the_mattes_in_the_file(aovs, tmp_path):
    """As Cryptomatte's readers do: header attributes cryptomatte/<key>/name, the channels <name>00.R and .G, names from
    the manifest.
    """
    import OpenImageIO

    shot_files.write_labels(
        aovs, SceneDict({}, None, instances=INSTANCES), BakePlan(tmp_path / "street.usda", tmp_path)
    )
    source = OpenImageIO.ImageInput.open(str(tmp_path / "labels.exr"))
    header = {item.name: item.value for item in source.spec().extra_attribs}
    channels = list(source.spec().channelnames)
    pixels = source.read_image(0, 0, 0, len(channels), OpenImageIO.FLOAT)
    source.close()
    (key,) = {match[1] for match in (re.fullmatch(r"(cryptomatte/[0-9a-f]{7})/name", name) for name in header) if match}
    name = header[f"{key}/name"]
    ids, coverage = (pixels[:, :, channels.index(f"{name}00.{part}")] for part in "RG")
    manifest = json.loads(header[f"{key}/manifest"])
    for instance in INSTANCES:
        matte = np.where(ids.view(np.uint32) == int(manifest[instance.path], 16), coverage, 0.0)
        np.testing.assert_array_equal(matte, instance.id == IDS)


def test_the_list_has_a_box_around_what_is_seen(aovs):
    """x, y, width and height of the visible pixels, the nearest distance, and both numbers of the class."""
    listed = labels.label_list(aovs, INSTANCES)
    assert (listed["schema"], listed["taxonomy"]) == ("synfog-usd/labels", "cityscapes")
    road, car, behind, blob = listed["instances"]
    assert road == {
        "id": 1,
        "path": "/World/Road",
        "label": "road",
        "semantic_id": 7,
        "train_id": 0,
        "pixels": 9,
        "box_px": [0, 2, 5, 2],
        "distance_m": 20.5,
    }
    assert car == {
        "id": 2,
        "path": "/World/Car",
        "label": "car",
        "semantic_id": 26,
        "train_id": 13,
        "pixels": 3,
        "box_px": [1, 1, 2, 2],
        "distance_m": 16.5,
    }
    assert (blob["label"], blob["semantic_id"], blob["train_id"], blob["box_px"]) == ("unlabeled", 0, 255, [3, 1, 1, 1])
    assert behind["pixels"] == 0 and "box_px" not in behind and "distance_m" not in behind
    assert json.loads(json.dumps(listed, allow_nan=False)) == listed


def test_an_empty_stage_has_labels_too():
    """Nothing but sky: class 23 everywhere, no instance."""
    nothing = np.full((2, 3), np.inf)
    none = np.zeros((2, 3), dtype=np.int64)
    sky = Aovs(nothing, nothing, np.zeros((2, 3, 3)), none, none, np.ones((2, 3)))
    image = labels.label_image(sky, ())
    assert (plane(image, "semantic.ID") == 23).all() and json.loads(
        image.provenance["cryptomatte/f834d0a/manifest"]
    ) == {}
    assert labels.label_list(sky, ())["instances"] == []


DISTORTED = """synfog: graph/1
inputs: [radiance]
sensor: imx363
lens: pixel4a
nodes:
  - {op: optics.irradiance, falloff: none, f_number: 0.5, transmission: 0.6366198}
  - {op: optics.distortion, name: bend, coefficients: [-0.35, 0.1, 0.001, -0.002]}
outputs: {a.exr: bend}
"""
"""0.6366198 = 2 / pi: with f/0.5, E = L."""


@pytest.fixture
def baked(tmp_path, monkeypatch):
    """A wall with a post, wide enough that the lens bends both; labels as a bake writes them, and what the picture
    shows of the same ids.
    """
    ids = np.ones((60, 90), dtype=np.int64)
    ids[:12], ids[5:50, 8:14], ids[50:, 70:] = 0, 2, 4
    depth = np.where(ids > 0, 10.0 * ids + np.arange(90) / 100.0, np.inf)
    normal = np.broadcast_to((0.0, -1.0, 0.0), (60, 90, 3)) * (ids > 0)[..., None]
    seen = Aovs(depth + 0.5, depth, normal, ids, np.zeros_like(ids), np.ones(ids.shape))
    (tmp_path / "g.yaml").write_text(DISTORTED)
    graph = camera.load_graph(tmp_path / "g.yaml")
    view = Camera("/Camera", np.eye(4), 90, 60, 70.0)
    shot_files.write_labels(
        seen, SceneDict({}, view, instances=INSTANCES), BakePlan(tmp_path / "street.usda", tmp_path), graph
    )
    radiance = Image(
        np.repeat(ids[..., None], 3, axis=2).astype(np.float32) + 10.0,
        ("R", "G", "B"),
        Quantity.RADIANCE,
        provenance={"fov_x_deg": 70.0},
    )
    picture = graph.run({"radiance": radiance}, seed=0)["bend"].pixels[..., 1] - 10.0
    return (
        writers.read_exr(tmp_path / "labels.exr", quantity=Quantity.DATA),
        json.loads((tmp_path / "labels.json").read_bytes()),
        picture,
        seen,
    )


def test_labels_are_bent_as_the_picture_is(baked):
    """The picture of the ids is nearer to a pixel's id than to its neighbours', but for a spline's ripple of a tenth; 2
    in 1,000, at corners, may differ.
    """
    image, _, picture, seen = baked
    ids = plane(image, "instance.ID")
    step, wide = (maximum_filter(ids, size) - minimum_filter(ids, size) for size in (3, 9))
    assert 0.05 < (step > 0).mean() < 0.3
    assert (np.abs(picture - ids) > 0.5 * step + 0.1 * wide + 0.01).mean() < 0.002
    assert (ids != seen.instance_id).mean() > 0.02


def test_bent_aovs_still_agree_with_each_other(baked):
    """Id, depth, distance, normal and matte of a pixel are those of one ray: no depth between a post and the wall."""
    image, _, _, seen = baked
    ids, depth = plane(image, "instance.ID"), plane(image, "depth.Z")
    known = {(int(i), np.float32(d)) for i, d in zip(seen.instance_id.ravel(), seen.depth_m.ravel(), strict=True)}
    assert {(int(i), d) for i, d in zip(ids.ravel(), depth.ravel(), strict=True)} <= known
    np.testing.assert_array_equal(plane(image, "distance.Z"), depth + 0.5)
    np.testing.assert_array_equal(plane(image, "crypto_object00.G"), ids > 0)
    np.testing.assert_array_equal(plane(image, "N.Y"), np.where(ids > 0, -1.0, 0.0))


def test_boxes_are_those_of_the_bent_ids_and_the_list_says_why(baked):
    image, listed, _, _ = baked
    ids = plane(image, "instance.ID")
    for row in listed["instances"]:
        y, x = np.nonzero(ids == row["id"])
        assert row["pixels"] == y.size
        if y.size:
            assert row["box_px"] == [x.min(), y.min(), x.max() - x.min() + 1, y.max() - y.min() + 1]
    assert listed["warped"] == "distortion of node 'bend'; radiance.exr and layers.exr are not"
    assert listed["distortion_coefficients"] == [-0.35, 0.1, 0.001, -0.002] and len(listed["camera_matrix_px"]) == 3
