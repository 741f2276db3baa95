"""What a second camera costs beside the first: `pytest -m bench tests/bench/test_rig_cost.py`."""

import resource
import subprocess
import sys

import pytest

from synfog_usd.base.resources import folder

SECOND = """#usda 1.0
(
    subLayers = [@{street}@]
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Z"
)
over "World"
{{
    def Camera "Right"
    {{
        float2 clippingRange = (0.1, 3000)
        float focalLength = 0.345
        float horizontalAperture = 0.36
        float verticalAperture = 0.2025
        float3 xformOp:rotateXYZ = (91.2, 0, 1.2)
        double3 xformOp:translate = (1.8499342, -36.9937174, 1.45)
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]
    }}
}}
"""


@pytest.mark.bench
def test_two_cameras_cost_less_than_twice_one(tmp_path):
    """Processor seconds of a stereo pair on the crossing, in clear air and in fog, under 1.8 of those of one eye; a
    first run compiles the kernels.
    """
    (tmp_path / "rig.usda").write_text(SECOND.format(street=(folder("stages") / "crossroads.usda").as_posix()))

    def seconds(cameras, out):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        words = ["bake", tmp_path / "rig.usda", "-o", tmp_path / out, "--camera", cameras, "--quiet"]
        words += [
            "--allow",
            folder("stages"),
            "--allow",
            folder("assets"),
            "--lighting",
            "sky",
            "--fog",
            "clear,mor150",
        ]
        words += ["--resolution", "320x180", "--samples", "16"]
        subprocess.run([sys.executable, "-m", "synfog_usd.cli.main", *map(str, words)], check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    seconds("Ego", "first")
    one, two = seconds("Ego", "one"), seconds("Ego,Right", "two")
    print(f"one {one:.1f} s, two {two:.1f} s: {two / one:.2f}")
    assert two < 1.8 * one
