"""The workshop: it makes every shipped asset again, byte for byte, and the package knows nothing of it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest

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
    """All of them byte for byte, but for meshes, whose decimation turns on how a processor rounds."""
    shipped, written = shipped_of(what), made(what, tmp_path)
    assert set(written) == set(shipped)
    assert [name for name, data in written.items() if data != shipped[name].read_bytes() and "geo" not in name] == []


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
