"""`synfog-usd bake` leaves out what fog hides, tells of it, and loses neither labels nor layers by it."""

import json

import numpy as np
import OpenImageIO
import pytest
from support.cli import run
from support.stages import street

SIDE = 180
"""Squares along each side of a field of stones behind the fog: 64 800 triangles."""


def stones(path, y):
    """A stage's text for a wall of many triangles, 100 m wide and 60 m high, at a distance [m]."""
    x, z = np.meshgrid(np.linspace(-50, 50, SIDE + 1), np.linspace(-30, 30, SIDE + 1))
    points = ", ".join(f"({a:.4f}, {y}, {b:.4f})" for a, b in zip(x.ravel(), z.ravel(), strict=True))
    corner = (np.arange(SIDE)[:, None] * (SIDE + 1) + np.arange(SIDE)).ravel()
    faces = np.stack([corner, corner + 1, corner + SIDE + 2, corner + SIDE + 1], axis=1).ravel()
    return f"""
    def Mesh "{path}" ( prepend apiSchemas = ["SemanticsLabelsAPI:cityscapes"] )
    {{
        token[] semantics:labels:cityscapes = ["building"]
        int[] faceVertexCounts = [{", ".join(["4"] * SIDE**2)}]
        int[] faceVertexIndices = [{", ".join(map(str, faces))}]
        point3f[] points = [{points}]
        uniform token subdivisionScheme = "none"
    }}
"""


def bake(stage, out, *more):
    arguments = [
        "bake",
        stage,
        "-o",
        out,
        "--resolution",
        "32x18",
        "--samples",
        "4",
        "--lighting",
        "sky",
        "--fog",
        "mor50",
        *more,
    ]
    done = run(*arguments)
    assert done.returncode == 0, done.stderr
    return done.stderr, json.loads((out / "bake.json").read_text())


@pytest.fixture(scope="module")
def baked(tmp_path_factory):
    """The same stage with and without --no-cull: (folder, what was printed, manifest) of each."""
    folder = tmp_path_factory.mktemp("cull")
    stage = folder / "street.usda"
    stage.write_text(street().replace('    def DomeLight "Sky"', stones("Stones", 150) + '    def DomeLight "Sky"'))
    return {
        name: (folder / name, *bake(stage, folder / name, *more))
        for name, more in (("reduced", ()), ("whole", ("--no-cull",)))
    }


def instances(folder, fog):
    return {
        instance["path"]: instance
        for instance in json.loads((folder / "sky" / fog / "instances.json").read_text())["instances"]
    }


def test_a_bake_tells_what_lies_behind_fog(baked):
    """One line on the way and a record in bake.json; with --no-cull there is no line, and no triangle is saved."""
    _, told, manifest = baked["reduced"]
    lines = [line for line in told.splitlines() if "behind fog" in line]
    assert len(lines) == 1 and "sky/mor50: 1 of 2 instances lie behind fog" in lines[0]
    (foggy,) = (row["behind_fog"] for row in manifest["shots"])
    assert foggy["simplified"] + foggy["left_out"] == 1 and foggy["triangles_saved"] > 50_000
    _, told, manifest = baked["whole"]
    assert "behind fog" not in told and all(row["behind_fog"]["triangles_saved"] == 0 for row in manifest["shots"])
    assert not manifest["plan"]["cull"]


def test_things_are_listed_with_the_transmittance_before_them(baked):
    """exp(-3 x 150 / 50) before the stones, by the WMO's threshold of 5 %, and exp(-3) before the wall."""
    for name, drawn in (("reduced", {"simplified", "left out"}), ("whole", {"whole"})):
        found = instances(baked[name][0], "mor50")
        assert found["/World/Stones"]["transmittance"] == pytest.approx(0.05 ** (150 / 50), rel=1e-3)
        assert found["/World/Wall"]["transmittance"] == pytest.approx(0.05, rel=1e-3)
        assert found["/World/Stones"]["drawn"] in drawn and found["/World/Wall"]["drawn"] == "whole"


def test_labels_and_the_layer_of_transmittance_are_of_the_whole_scene(baked):
    """Labels have the same bytes, with pixels of what is hidden, and so has the transmittance; radiance, which has less
    in it, differs.
    """
    reduced, whole = baked["reduced"][0], baked["whole"][0]
    for name in ("labels.exr", "labels.json"):
        assert (reduced / name).read_bytes() == (whole / name).read_bytes()
    seen = {
        instance["path"]: instance["pixels"]
        for instance in json.loads((reduced / "labels.json").read_text())["instances"]
    }
    assert seen["/World/Stones"] > 0
    layers = [OpenImageIO.ImageBuf(str(folder / "sky" / "mor50" / "layers.exr")) for folder in (reduced, whole)]
    channel = list(layers[0].spec().channelnames).index("transmittance.Y")
    one, other = (layer.get_pixels(OpenImageIO.FLOAT)[..., channel] for layer in layers)
    np.testing.assert_array_equal(one, other)
    assert (reduced / "sky/mor50/radiance.exr").read_bytes() != (whole / "sky/mor50/radiance.exr").read_bytes()
