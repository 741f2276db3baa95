"""A composed road in other programs: USD without our plugin, and Blender 5.

The reading of Blender needs a Python with bpy, named by SYNFOG_BPY; `make test-dcc` makes one.
"""

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from synfog_usd.world.compose import compose

BPY = os.environ.get("SYNFOG_BPY", "")
HERE = Path(__file__).resolve().parent
RECIPE = HERE.parents[1] / "stages" / "recipes" / "residential.yaml"
FOLDED = ("PYTHONPATH", "PXR_PLUGINPATH_NAME")
"""Variables by which our package or its schema would come in by the back door."""

BY_NIGHT = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Z"
    subLayers = [@./road.usda@]
)
over "World" (
    variants = {
        string lighting = "active"
    }
) {}
"""


@pytest.fixture(scope="module")
def road(tmp_path_factory):
    """A residential street of recipe and seed, its lamps switched on: (file, what USD alone finds in it)."""
    folder = tmp_path_factory.mktemp("road")
    compose(RECIPE, folder / "road.usda", seed=3)
    path = folder / "night.usda"
    path.write_text(BY_NIGHT, encoding="utf-8")
    plain = {name: value for name, value in os.environ.items() if name not in FOLDED}
    done = subprocess.run(
        [sys.executable, str(HERE / "plain_look.py"), str(path)], capture_output=True, text=True, env=plain, cwd=folder,
        timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return path, json.loads(done.stdout), done.stderr


def test_usd_without_our_plugin_reads_all_of_a_world(road):
    """Nothing of ours is loaded, nothing fails to compose, nothing is said."""
    _, told, words = road
    assert told["ours"] == [] and told["errors"] == [] and words == ""
    (fog,) = told["fog_attributes"].values()
    assert fog["synfog:fog:mor"] > 0.0 and 0.0 < fog["synfog:fog:g"] < 1.0
    assert len(told["instances"]) > 100 and len(told["lights"]) > 10 and "Ego" in told["cameras"]


@pytest.fixture(scope="module")
def opened(road):
    """What Blender makes of it."""
    if not BPY:
        pytest.skip("SYNFOG_BPY names no Python that has bpy")
    path = road[0]
    done = subprocess.run(
        [BPY, str(HERE / "blender_look.py"), str(path), *road[1]["fog"]], capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, f"{done.stdout[-2000:]}{done.stderr[-2000:]}"
    return json.loads(done.stdout.splitlines()[-1]), done.stdout + done.stderr


def ordered(rows):
    """Points or matrices in an order that both programs share: by their numbers, to a centimetre."""
    flat = np.array(rows, dtype=float).reshape(len(rows), -1)
    return flat[np.lexsort(np.round(flat, 2).T[::-1])]


def test_blender_finds_no_mesh_to_repair(opened):
    """It drops faces whose corners coincide and says so; some such meshes it does not survive."""
    _, words = opened
    assert "Invalid face data" not in words


def test_blenders_cameras_stand_and_look_as_authored(road, opened):
    """To 1 mm, 1e-3 of a turn's matrix and 1e-3 degrees."""
    wanted, found = (
        road[1]["cameras"],
        {name.partition(".")[0]: camera for name, camera in opened[0]["cameras"].items()},
    )
    assert len(found) == len(opened[0]["cameras"])
    assert set(found) == set(wanted)
    for name, camera in wanted.items():
        np.testing.assert_allclose(found[name]["matrix"], camera["matrix"], atol=1e-3)
        assert math.degrees(found[name]["fov_x"]) == pytest.approx(camera["fov_x_deg"], abs=1e-3)


def test_blenders_fog_box_is_where_it_was_authored(road, opened):
    wanted, found = road[1]["fog"], opened[0]["fog"]
    assert set(found) == set(wanted)
    for name, box in wanted.items():
        np.testing.assert_allclose(found[name], box, rtol=1e-6, atol=1e-3)  # float32 of some kilometres


def test_blenders_instances_are_all_there(road, opened):
    """Each instance by its whole matrix, and the points of instancers by their number."""
    wanted, found = road[1]["instances"], opened[0]["instances"]
    assert len(found) == len(wanted)
    np.testing.assert_allclose(ordered(found), ordered(wanted), atol=1e-3)
    assert opened[0]["points"] == road[1]["points"]


def test_blenders_lamps_are_all_there(road, opened):
    """Those within instances too, each to 1 mm."""
    wanted, found = road[1]["lights"], opened[0]["lights"]
    assert len(found) == len(wanted)
    np.testing.assert_allclose(ordered(found), ordered(wanted), atol=1e-3)
