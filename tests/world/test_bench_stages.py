"""The stages on which renderers are compared: they are as written, whole, and say what shines and what stands where."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenImageIO
import pytest
from pxr import Usd, UsdGeom, UsdLux

from assets.builders import bench_stages
from synfog_usd.stage import cameras, check, open_stage, select, variants
from synfog_usd.stage.labels import direct_label
from synfog_usd.stage.schema import read_fog

FOLDER = Path(__file__).resolve().parents[2] / "stages" / "bench"
STAGES = sorted(path.stem for path in FOLDER.glob("*.usda"))
MAX_BYTES = 100_000
GROUPS = {"headlights", "street_lamps", "sky"}


def opened(name: str) -> Usd.Stage:
    return open_stage(FOLDER / f"{name}.usda")


def everything(stage: Usd.Stage) -> list[Usd.Prim]:
    return list(Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()))


def group_of(prim: Usd.Prim) -> str | None:
    while prim and not prim.IsPseudoRoot():
        attribute = prim.GetAttribute(bench_stages.GROUP)
        if attribute and attribute.HasAuthoredValue():
            return str(attribute.Get())
        prim = prim.GetParent()
    return None


def test_the_committed_files_are_what_write_makes_and_small(tmp_path: Path):
    """Same bytes every time, and nothing else lies there."""
    made = {path.name: path.read_bytes() for path in bench_stages.write(tmp_path)}
    assert made == {path.name: path.read_bytes() for path in FOLDER.iterdir()}
    assert max(map(len, made.values())) < MAX_BYTES


@pytest.mark.parametrize("name", STAGES)
def test_a_stage_is_sound_and_has_a_camera_fog_and_labels(name: str):
    stage = opened(name)
    assert [note for note in check(stage) if note.severity == "warning" or "label" in note.text] == []
    assert cameras(stage) == ["/World/Ego"]
    assert "clear" in variants(stage)["fog"]


@pytest.mark.parametrize("name", STAGES)
def test_every_light_has_a_group(name: str):
    """A lamp is of the headlights or the street lamps, a dome is sky."""
    stage = opened(name)
    lights = [prim for prim in everything(stage) if prim.HasAPI(UsdLux.LightAPI)]
    groups = {str(prim.GetPath()): group_of(prim) for prim in lights}
    assert set(groups.values()) <= GROUPS and groups
    assert all((group == "sky") == stage.GetPrimAtPath(path).IsA(UsdLux.DomeLight) for path, group in groups.items())


@pytest.mark.parametrize(
    "name, fog, mor_m",
    [
        ("overcast_street", None, {150.0}),
        ("canyon", "mor600", {600.0}),
        ("dense_mor50", None, {50.0}),
        ("dense_mor50", "mor300", {300.0}),
        ("haze_mor2000", None, {2000.0}),
        ("fog_bank", None, {400.0, 40.0}),
        ("fog_bank", "clear", set()),
    ],
)
def test_a_variant_sets_the_visibility(name: str, fog: str | None, mor_m: set[float]):
    stage = opened(name)
    select(stage, fog=fog)
    found = [read_fog(prim, Usd.TimeCode.Default()) for prim in stage.Traverse()]
    assert {one.values["mor"] for one in found if one is not None} == mor_m


@pytest.mark.parametrize("name", STAGES)
def test_nothing_hangs_in_the_air_or_stands_in_the_camera(name: str):
    """Whatever has a label starts within 0.12 m of the ground or above an open street, and keeps 0.4 m from the
    lens.
    """
    stage = opened(name)
    cache = UsdGeom.BBoxCache(Usd.TimeCode.Default(), ["default", "render"])
    eye = np.array(bench_stages.EYE_M)
    for group in ("Vehicles", "People", "Furniture", "Plants", "Buildings"):
        for prim in (
            stage.GetPrimAtPath(f"/World/{group}").GetChildren() if stage.GetPrimAtPath(f"/World/{group}") else ()
        ):
            box = cache.ComputeWorldBound(prim).ComputeAlignedRange()
            low, high = np.array(box.GetMin()), np.array(box.GetMax())
            assert -0.12 <= low[2] <= 0.12, prim.GetPath()
            assert np.linalg.norm(np.maximum(np.maximum(low - eye, eye - high), 0.0)) > 0.4, prim.GetPath()
            assert direct_label(prim, Usd.TimeCode.Default())


def test_the_sky_depends_on_elevation_only():
    """CIE overcast: a third of the zenith at the horizon, and below."""
    pixels = OpenImageIO.ImageInput.open(str(FOLDER / bench_stages.SKY_FILE)).read_image("float")
    np.testing.assert_array_equal(pixels, np.broadcast_to(pixels[:, :1, :1], pixels.shape))
    half = pixels.shape[0] // 2
    np.testing.assert_allclose(
        pixels[0, 0], 1.0, atol=2e-5
    )  # half a row from the zenith: 1 - 2/3 (1 - cos(pi / 512)) = 1 - 1.3e-5
    np.testing.assert_allclose(pixels[half:], 1 / 3, rtol=1e-6)
