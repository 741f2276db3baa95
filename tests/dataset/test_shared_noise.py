"""What pictures of two cameras, frames, fogs and lightings have in common: each cell of the table in docs/camera.md.

Two cameras stand in one place, so that nothing but noise can differ.  A graph with four branches puts out the picture
without noise, with each pixel's own gain, with its own offset, and with temporal noise; what is correlated is what the
last three have beside the first.
"""

import itertools
import json

import numpy as np
import pytest
import tifffile
from support.stages import street

from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import OPS, writers
from synfog_usd.dataset.bake import bake
from synfog_usd.dataset.plan import BakePlan, Sampling

SIZE = (96, 54)
CHANCE = 5.0 / np.sqrt(SIZE[0] * SIZE[1])  # five standard deviations of the correlation of independent pixels: 0.07
GRAPH = """
synfog: graph/1
inputs: [radiance]
sensor: imx363
lens: pixel4a
nodes:
  - {name: irradiance, op: optics.irradiance, falloff: none}
  - {name: expose, op: sensor.expose, exposure_s: auto}
  - {name: plain, op: sensor.gain, in: expose, iso: auto}
  - {name: prnu, op: sensor.prnu, in: expose, prnu_percent: 5}
  - {name: response, op: sensor.gain, iso: auto}
  - {name: dsnu, op: sensor.dsnu, in: expose, dsnu_e: 20}
  - {name: amplified_dsnu, op: sensor.gain, iso: auto}
  - {name: offset, op: sensor.row_column, row_noise_dn: 1, column_noise_dn: 1}
  - {name: shot_noise, op: sensor.shot_noise, in: expose}
  - {name: read_noise, op: sensor.read_noise, sigma_e: 20}
  - {name: amplified, op: sensor.gain, iso: auto}
  - {name: temporal, op: sensor.adc_noise, sigma_dn: 5}
outputs:
  plain.exr: plain
  response.exr: response
  offset.exr: offset
  temporal.exr: temporal
"""
MOMENT = "float inputs:exposure.timeSamples = { 1: -5, 2: -5, 3: -5 }"
CAMERAS = {"Ego": None, "Right": "/World/Right"}
CELLS = list(itertools.product(CAMERAS, (None, 2.0), ("sky", "active"), ("clear", "mor150")))
"""Cameras, frames (None is the stage's first, 1), lightings and fogs."""


def stage_of(folder):
    text = street(sky=300.0, emission=100.0).replace("float inputs:exposure = -5", MOMENT)
    begin = text.index('    def Camera "Ego"')
    end = text.index("    variantSet", begin)
    right = text[begin:end].replace('"Ego"', '"Right"')
    text = text[:end] + right + text[end:]
    path = folder / "rig.usda"
    path.write_text(text.replace("    upAxis", "    startTimeCode = 1\n    upAxis", 1))
    return path


def shots(folder, *, seed=0, same_noise=False, cells=CELLS):
    """Cell -> {'response', 'offset', 'temporal'}: (H, W) of what differs from the picture without noise; and of
    'radiance' the green itself.
    """
    (folder / "graph.yaml").write_text(GRAPH)
    stage, found = stage_of(folder), {}
    for camera, frame in dict.fromkeys(cell[:2] for cell in cells):
        out = folder / f"{camera}-{frame}-{seed}-{same_noise}"
        sampling = Sampling(quality="reference", samples=4, bands=3, model="path")
        options = dict(sampling=sampling, size=SIZE, seed=seed, same_noise=same_noise)
        plan = dict(pipeline=folder / "graph.yaml", camera=CAMERAS[camera], frame=frame)
        lighting, fog = (tuple(dict.fromkeys(cell[axis] for cell in cells)) for axis in (2, 3))
        bake(BakePlan(stage, out, **plan, **options, lighting=lighting, fog=fog))
        for cell in cells:
            if cell[:2] == (camera, frame):
                at = out / cell[2] / cell[3]
                pictures = {
                    name: writers.read_exr(at / f"{name}.exr", quantity=Quantity.DATA).pixels.astype(float)
                    for name in ("plain", "response", "offset", "temporal", "radiance")
                }
                plain = pictures["plain"][..., 0]
                found[cell] = {name: pictures[name][..., 0] - plain for name in ("response", "offset", "temporal")}
                found[cell]["response"] /= plain
                found[cell]["radiance"] = pictures["radiance"][..., 1]
    return found


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    return shots(tmp_path_factory.mktemp("noise"))


def together(one, other):
    """Correlation of two residuals whose deviation follows the light: each pixel's is that of its filter."""
    parts = [(r[y::2, x::2], s[y::2, x::2]) for r, s in [(one, other)] for y in (0, 1) for x in (0, 1)]
    return np.mean([np.corrcoef(r.ravel(), s.ravel())[0, 1] for r, s in parts])


def pairs(rig):
    return itertools.combinations(rig, 2)


@pytest.mark.slow
def test_temporal_noise_is_its_own_by_camera_frame_lighting_and_fog(rig):
    """Sixteen shots, 120 pairs: none is correlated by more than chance, of 5184 pixels."""
    for one, other in pairs(rig):
        assert abs(together(rig[one]["temporal"], rig[other]["temporal"])) < CHANCE, (one, other)


@pytest.mark.slow
def test_fixed_patterns_are_the_cameras(rig):
    """PRNU as a share of the light, and DSNU with rows and columns less the picture at one exposure: the same in all
    shots of a camera, but for float32; none of it in those of the other.  Rows share one number: 54 + 96 beside 5184
    pixels of DSNU, at a tenth of its deviation.
    """
    for one, other in pairs(rig):
        for what in ("response", "offset"):
            found = together(rig[one][what], rig[other][what])
            assert found > 0.95 if one[0] == other[0] else abs(found) < CHANCE, (one, other, what, found)


@pytest.mark.slow
def test_the_renders_noise_is_its_cameras(rig, tmp_path):
    """Of two seeds the difference is noise alone: that of one camera is not that of the other, which stands in the
    same place.  In the next frame nothing moves, and so it stands still, as in a clip it must not crawl.
    """
    cells = [(camera, frame, "sky", "mor150") for camera in CAMERAS for frame in (None, 2.0)]
    again = shots(tmp_path, seed=1, cells=cells)
    left = {cell: rig[cell]["radiance"] - again[cell]["radiance"] for cell in cells}
    assert all(part.std() > 1e-3 * again[cell]["radiance"].mean() for cell, part in left.items())
    for one, other in itertools.combinations(cells, 2):
        found = together(left[one], left[other])
        assert found > 0.999 if one[0] == other[0] else abs(found) < CHANCE, (one, other, found)


@pytest.mark.slow
def test_fogs_can_have_the_noise_of_their_clear_frame(rig, tmp_path):
    """With `same_noise` two fogs share it, of one camera, frame and lighting; the clear frame is what it was."""
    cells = [cell for cell in CELLS if cell[1] is None]
    same = shots(tmp_path, same_noise=True, cells=cells)
    for one, other in pairs(same):
        found = together(same[one]["temporal"], same[other]["temporal"])
        assert found > 0.9 if one[:3] == other[:3] else abs(found) < CHANCE, (one, other, found)
    for cell in cells:
        if cell[3] == "clear":
            np.testing.assert_array_equal(same[cell]["temporal"], rig[cell]["temporal"])


@pytest.mark.parametrize("name", [op.name for op in OPS if "serial" in op.parameters])
def test_every_op_with_a_serial_knows_the_specimen(name):
    """On an even picture: the same for one specimen in two runs, another for the next one and for none."""
    op, made = OPS.ops[name], {}
    quantity = op.port(0).quantities[0] if hasattr(op.port(0), "quantities") else op.port(0).quantity
    for specimen in (None, "/Rig/Left", "/Rig/Right"):
        more = {} if specimen is None else {"specimen": specimen}
        even = Image(
            np.full((64, 64, 1), 100.0, np.float32),
            ("CFA",),
            quantity,
            provenance={"dark_e": 4.0, "exposure_s": 0.01, **more},
        )
        given = {
            "serial": "7",
            "full_well_e": 1e4,
            "prnu_percent": 1.0,
            "dsnu_e": 1.0,
            "row_noise_dn": 1.0,
            "column_noise_dn": 1.0,
        }
        wanted = {key: value for key, value in given.items() if key in op.parameters}
        runs = []
        for _ in range(2):
            rng = {"rng": np.random.default_rng(0)} if op.draws else {}
            runs.append(op.function(even, **wanted, **rng).pixels)
        np.testing.assert_array_equal(*runs)
        made[specimen] = runs[0]
    for one, other in itertools.combinations(made.values(), 2):
        assert (one != other).any()


@pytest.mark.slow
def test_the_serial_number_of_a_rigs_camera_is_in_its_raw(tmp_path):
    """A camera that is not the stage's own says which it is; the bake of one camera alone is what it was."""
    stage = stage_of(tmp_path)
    for camera, tail in ((None, ""), ("/World/Ego", ""), ("/World/Right", ":/World/Right")):
        out = tmp_path / str(camera)[-5:]
        bake(
            BakePlan(
                stage,
                out,
                camera=camera,
                size=(32, 18),
                sampling=Sampling(samples=2),
                lighting=("sky",),
                fog=("clear",),
            )
        )
        with tifffile.TiffFile(out / "sky/clear/raw.dng") as file:
            assert file.pages[0].tags[50735].value == "imx363-0001" + tail  # CameraSerialNumber
        made = json.loads((out / "bake.json").read_text())["shots"][0]["files"]
        if camera == "/World/Ego":
            first = json.loads((tmp_path / "None" / "bake.json").read_text())["shots"][0]["files"]
            assert made == first
