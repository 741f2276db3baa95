"""The contact sheet, from pictures of one colour each."""

import hashlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from synfog_usd.dataset import contact
from synfog_usd.dataset.plan import BakePlan, shots

COLOURS = {
    "sky/clear": (250, 0, 0),
    "sky/mor150": (0, 250, 0),
    "active/clear": (0, 0, 250),
    "active/mor150": (250, 250, 0),
}
PLAN = shots(BakePlan(Path("street.usda"), Path("out")), {"fog": ("clear", "mor150"), "lighting": ("sky", "active")})


def row(shot, *, time_s=1 / 250, files=("radiance.exr", "srgb.png")):
    """What the manifest knows of a shot."""
    return {
        "mor_m": None if shot.fog == "clear" else 150.0,
        "exposure": {"exposure_s": time_s, "iso": 100.0} if time_s else None,
        "files": dict.fromkeys(files, ""),
    }


def put(out, shot, size=(64, 36), colour=None, name="srgb.png"):
    """One picture of one colour."""
    (out / shot.folder).mkdir(parents=True, exist_ok=True)
    Image.new("RGB", size, colour or COLOURS[shot.folder]).save(out / shot.folder / name)


def sheet_of(out, size=(64, 36), **more):
    """The sheet of all four shots as (H, W, 3) numbers."""
    for shot in PLAN:
        put(out, shot, size)
    hashes = contact.write(out, PLAN, {shot.folder: row(shot, **more) for shot in PLAN})
    assert hashes == {"contact.png": hashlib.sha256((out / "contact.png").read_bytes()).hexdigest()}
    with Image.open(out / "contact.png") as picture:
        assert picture.mode == "RGB"
        return np.array(picture)


@pytest.mark.parametrize("size, tile", [((64, 36), (480, 270)), ((100, 100), (480, 480))])
def test_lightings_go_down_and_fogs_across(tmp_path, size, tile):
    """Tiles 480 px wide in the pictures' proportions, 8 px apart, a caption of 26 px below each; between them
    background.
    """
    sheet = sheet_of(tmp_path, size)
    width, height = tile
    assert sheet.shape == (8 + 2 * (height + 26 + 8), 8 + 2 * (width + 8), 3)
    for index, shot in enumerate(PLAN):
        top, left = 8 + (index // 2) * (height + 34), 8 + (index % 2) * (width + 8)
        assert (sheet[top : top + height, left : left + width] == COLOURS[shot.folder]).all(), shot.folder
    assert (sheet[:8] == contact.BACKGROUND).all() and (sheet[:, :8] == contact.BACKGROUND).all()
    assert (sheet[:, 8 + width : 16 + width] == contact.BACKGROUND).all()


def test_a_graph_without_pictures_has_no_sheet(tmp_path):
    """Only radiance is written: no contact sheet and no error."""
    assert contact.write(tmp_path, PLAN, {shot.folder: row(shot, files=("radiance.exr",)) for shot in PLAN}) == {}
    assert not list(tmp_path.iterdir())


def test_the_same_pictures_give_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        sheet_of(tmp_path / name)
    assert (tmp_path / "a" / "contact.png").read_bytes() == (tmp_path / "b" / "contact.png").read_bytes()
