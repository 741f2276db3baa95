"""The workshop: it makes every shipped asset again, byte for byte, and the package knows nothing of it."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest
from pxr import Sdf

from assets.builders import homesteads, roadside, skies
from synfog_usd.world.components import write_component
from synfog_usd.world.lod import bare, with_low

ROOT = Path(__file__).resolve().parents[2]


def made(what, folder):
    """Relative name -> bytes of what the workshop writes, in a process of its own, as one calls it.

    After renders in the same process decimation has been seen to round otherwise.
    """
    (folder / "docs" / "images").mkdir(parents=True)
    command = [sys.executable, "-m", "assets.builders", what, "--out", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    files = [path for path in sorted((folder / "assets").rglob("*")) if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


ROUNDED = 25
"""Layers of models, of 212, whose decimation may turn on how a processor rounds: 22 of people do between two
processors.
"""


def assert_decimated_alike(one, other):
    """The same prims with the same attributes; meshes of as many triangles to 5 % and as large to 2 mm, or a factor of
    2 and 20 mm at a low level of detail, where the step of decimation that still looks right may be another one.
    """
    within_m, share = (0.02, 0.5) if ".low." in one.name else (0.002, 0.05)
    ours, theirs = meshes(one), meshes(other)
    assert ours.keys() == theirs.keys(), one
    for path, mesh in ours.items():
        assert mesh.keys() == theirs[path].keys(), path
        if "points" in mesh:
            counts = [len(found["faceVertexCounts"]) for found in (mesh, theirs[path])]
            assert abs(counts[0] - counts[1]) <= 4 + share * max(counts), path
            low, high = (
                [edge(np.array(found["points"]), axis=0) for found in (mesh, theirs[path])] for edge in (np.min, np.max)
            )
            np.testing.assert_allclose(*low, atol=within_m)
            np.testing.assert_allclose(*high, atol=within_m)


def meshes(path):
    """Prim's path -> its attributes' names and values."""
    layer, found = Sdf.Layer.FindOrOpen(str(path)), {}

    def visit(place):
        if place.IsPrimPath():
            found[str(place)] = {one.name: one.default for one in layer.GetPrimAtPath(place).attributes}

    layer.Traverse(Sdf.Path.absoluteRootPath, visit)
    return found


def numbers(path):
    """What a layer says, with every number as it stands but for the sign of zeros.

    Processors round products of matrices differently in the last bit (fused multiply-add), so that a sum which is
    0 on one is -1e-17 on another and is stored as -0.
    """
    return re.sub(r"(?<![\w.])-0(?![\w.])", "0", Sdf.Layer.FindOrOpen(str(path)).ExportToString())


def shipped_of(what):
    """Name -> file of what ships of a kind, without thumbnails; textures with their pictures."""
    return {
        path.relative_to(ROOT).as_posix(): path
        for path in (ROOT / "assets" / what).rglob("*")
        if path.is_file() and (what == "textures" or path.suffix != ".png")
    }


def pixels(data, folder):
    """What a picture holds and says of itself, of an EXR's bytes."""
    path = folder / "one.exr"
    path.write_bytes(data)
    picture = OpenImageIO.ImageBuf(str(path))
    said = {one.name: one.value for one in picture.spec().extra_attribs}
    return np.array(picture.get_pixels(OpenImageIO.FLOAT)), said


def assert_same_sky(made, shipped, folder):
    """The same picture but for a pixel in 10 000 at most, and those by one step of what is stored.

    A processor with AVX-512 rounds exponentials in single precision otherwise than one without; of a sky of 2.5
    million values 1 to 15 then fall on the other side of a step of 1/128.
    """
    (ours, said), (theirs, told) = pixels(made, folder), pixels(shipped, folder)
    assert said == told and ours.shape == theirs.shape
    apart = np.abs(ours - theirs)
    assert np.mean(apart > 0.0) < 1e-4 and (apart <= 1.01 / 128 * np.abs(theirs)).all()


def test_some_models_and_skies_are_what_the_code_writes(tmp_path):
    """Those that are made in a second; all of them are among the long tests."""
    models = [one for one in roadside.build_roadside() if one.name in ("guard_rail", "lamp_post_top", "sign_direction")]
    models += [one for one in homesteads.build_homesteads() if one.name == "warehouse"]
    for one in models:
        for file in write_component(bare(with_low(one)), tmp_path).parent.iterdir():
            shipped = ROOT / "assets" / "models" / one.name / file.name
            assert file.read_bytes() == shipped.read_bytes(), file
    assert len(models) == 4
    for path in skies.write_skies(tmp_path):
        assert_same_sky(path.read_bytes(), (ROOT / "assets" / "skies" / path.name).read_bytes(), tmp_path)


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("what", ["textures", "lamps", pytest.param("models", marks=pytest.mark.physics)])
def test_every_asset_is_what_the_code_writes(what, tmp_path):
    """All of them byte for byte, meshes but for the sign of zeros and what `ROUNDED` bears."""
    shipped = shipped_of(what)
    found = made(what, tmp_path)
    assert set(found) == set(shipped)
    other = [name for name, data in found.items() if data != shipped[name].read_bytes()]
    assert [name for name in other if not name.endswith(".geo.usdc")] == []
    off = [name for name in other if numbers(tmp_path / name) != numbers(shipped[name])]
    assert len(off) <= ROUNDED, off
    for name in off:
        assert_decimated_alike(tmp_path / name, shipped[name])


@pytest.mark.physics
@pytest.mark.timeout(2400)  # each of sixteen takes 40 to 60 processor seconds
def test_every_sky_is_what_the_code_writes(tmp_path):
    """To a step in a few pixels; nothing else lies there."""
    shipped = shipped_of("skies")
    assert {Path(name).stem for name in shipped} == {*skies.SKIES, "overcast", "dusk"}
    found = made("skies", tmp_path)
    assert found.keys() == shipped.keys()
    for name, data in found.items():
        assert_same_sky(data, shipped[name].read_bytes(), tmp_path)


def test_a_sky_that_differs_would_be_seen(tmp_path):
    """Neither a picture with a block of other pixels nor one that is a little brighter passes."""
    data = (ROOT / "assets" / "skies" / "overcast.exr").read_bytes()
    assert_same_sky(data, data, tmp_path)
    picture, _ = pixels(data, tmp_path)
    brighter, other = 1.02 * picture, picture.copy()
    other[:20, :100] *= 1.005
    for wrong in (brighter, other):
        path = tmp_path / "wrong.exr"
        spec = OpenImageIO.ImageBuf(str(tmp_path / "one.exr")).spec()
        buffer = OpenImageIO.ImageBuf(spec)
        buffer.set_pixels(OpenImageIO.ROI(), np.ascontiguousarray(wrong))
        assert buffer.write(str(path))
        with pytest.raises(AssertionError):
            assert_same_sky(path.read_bytes(), data, tmp_path)
