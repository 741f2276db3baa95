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


@pytest.mark.parametrize(
    "size, tile", [((64, 36), (480, 270)), ((1280, 720), (480, 270)), ((100, 100), (480, 480)), ((33, 16), (480, 233))]
)
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


def test_every_tile_has_a_caption_that_fits_under_it(tmp_path):
    """Something is written in each caption's band and ends before the next tile."""
    sheet = sheet_of(tmp_path)
    for index in range(4):
        top, left = 8 + (index // 2) * 304 + 270, 8 + (index % 2) * 488
        inked = (sheet[top : top + 26, left : left + 480] != contact.BACKGROUND).any(axis=2)
        assert inked.sum() > 200 and not inked[:, -4:].any() and not inked[-1].any()


@pytest.mark.parametrize(
    "time_s, text", [(1 / 250, "1/250 s   ISO 100"), (0.25, "1/4 s"), (2.0, "2.0 s"), (None, "mor150   MOR 150 m")]
)
def test_a_caption_says_shot_visibility_and_exposure(time_s, text):
    """Short times as fractions, long ones in seconds, none where the graph has no exposure."""
    clear, foggy = PLAN[0], PLAN[1]
    caption = contact._caption(foggy, row(foggy, time_s=time_s))
    assert caption.startswith("sky / mor150   MOR 150 m") and text in caption
    assert "clear air" in contact._caption(clear, row(clear))
    assert ("ISO" in caption) == (time_s is not None)


def test_a_shot_that_was_not_asked_for_is_left_out(tmp_path):
    """The sheet shows this bake's shots; what an earlier one left in the folder stays out."""
    for shot in PLAN:
        put(tmp_path, shot)
    contact.write(tmp_path, PLAN[1:2], {shot.folder: row(shot) for shot in PLAN})
    with Image.open(tmp_path / "contact.png") as picture:
        assert picture.size == (8 + 488, 8 + 304)
        assert picture.getpixel((100, 100)) == COLOURS["sky/mor150"]


def test_shots_that_do_not_fill_a_grid_leave_a_gap(tmp_path):
    """Three of four: the place of the missing one is background."""
    for shot in PLAN[:3]:
        put(tmp_path, shot)
    contact.write(tmp_path, PLAN[:3], {shot.folder: row(shot) for shot in PLAN[:3]})
    with Image.open(tmp_path / "contact.png") as picture:
        assert picture.size == (8 + 2 * 488, 8 + 2 * 304)
        assert picture.getpixel((8 + 488 + 100, 8 + 304 + 100)) == contact.BACKGROUND


def test_a_graph_without_pictures_has_no_sheet(tmp_path):
    """Only radiance is written: no contact sheet and no error."""
    assert contact.write(tmp_path, PLAN, {shot.folder: row(shot, files=("radiance.exr",)) for shot in PLAN}) == {}
    assert not list(tmp_path.iterdir())


def test_the_same_pictures_give_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        sheet_of(tmp_path / name)
    assert (tmp_path / "a" / "contact.png").read_bytes() == (tmp_path / "b" / "contact.png").read_bytes()


def test_what_is_missing_stands_over_the_pictures(tmp_path):
    """One line each for six, the number of the rest, no line wider than the sheet; the pictures follow below as they
    were.
    """
    plain = sheet_of(tmp_path)
    told = [f"/World/Prop{n}: its reference ./{'far/' * (40 * n)}gone{n}.usda is missing" for n in range(9)]
    rows = {shot.folder: row(shot) for shot in PLAN}
    contact.write(tmp_path, PLAN, rows, told=told)
    with Image.open(tmp_path / "contact.png") as picture:
        sheet = np.array(picture)
    band = 26 * 7
    assert (sheet[band:] == plain).all()
    inked = (sheet[:band] != contact.BACKGROUND).any(axis=2)
    assert not inked[:, -4:].any() and all(inked[26 * line : 26 * (line + 1)].sum() > 200 for line in range(7))
