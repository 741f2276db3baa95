"""Several cameras in one run: the same pictures as one by one, one exposure, one translation, and a bake for each."""

import json

import numpy as np
import pytest
from pxr import Usd
from support.stages import rig_stage

from synfog_usd import camera, stage
from synfog_usd.base import resources
from synfog_usd.base.errors import OutputError, StageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import writers
from synfog_usd.camera.exposure import meter
from synfog_usd.dataset import session
from synfog_usd.dataset.bake import bake
from synfog_usd.dataset.plan import BakePlan, Exposing, Sampling
from synfog_usd.dataset.rig import bake_cameras, folders_of
from synfog_usd.dataset.sets.load import define_set
from synfog_usd.dataset.sets.scenes import scene
from synfog_usd.dataset.sets.unit import make
from synfog_usd.translate import Exchange, StageView, exchange

SMALL = dict(size=(48, 28), sampling=Sampling(quality="reference", samples=4, bands=3))
EACH = Exposing(meter="each")


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    """Folder of a run of two cameras, that of two runs of one each, and how often the first translated and loaded."""
    folder = tmp_path_factory.mktemp("rig")
    path, counts = rig_stage(folder, turn_deg=-70.0), {"translated": 0, "loaded": 0}
    with pytest.MonkeyPatch.context() as patch:
        made, load = exchange.with_boundaries, session.Renderer.free

        def translated(*given, **more):
            counts["translated"] += 1
            return made(*given, **more)

        def freed(self):
            counts["loaded"] += 1
            load(self)

        patch.setattr(exchange, "with_boundaries", translated)
        patch.setattr(session.Renderer, "free", freed)
        plan = BakePlan(path, folder / "both", lighting=("sky", "active"), fog=("clear", "mor600"), **SMALL)
        told, _ = bake_cameras(plan, ["Ego", "/World/Rig"])
    rig = ("/World/Ego", "/World/Rig/Right")
    for name, eye in zip(("Ego", "Right"), rig, strict=True):
        bake(BakePlan(path, folder / "apart" / name, camera=eye, rig=rig, fog=("clear", "mor600"), **SMALL))
    return folder, told, counts


@pytest.mark.slow
def test_each_camera_has_the_bake_that_it_has_alone(both):
    """All bytes of the pictures and labels, though the scene was translated and loaded for another camera."""
    folder, told, _ = both
    assert [row["folder"] for row in told["cameras"]] == ["Ego", "Right"]
    for name in ("Ego", "Right"):
        one, other = (json.loads((folder / way / name / "bake.json").read_text()) for way in ("both", "apart"))
        assert len(one["shots"]) == 4
        assert one["labels"] == other["labels"]
        for row, same in zip(one["shots"], other["shots"], strict=True):
            assert row["files"] == same["files"], (name, row["folder"])


@pytest.mark.slow
def test_two_cameras_are_translated_and_loaded_once_a_lighting(both):
    """Two lightings, two cameras, two fogs of which none hides enough to be loaded without it."""
    assert both[2] == {"translated": 2, "loaded": 2}


@pytest.mark.slow
def test_a_rig_is_exposed_once(both):
    """One exposure for both cameras in a lighting; and it is between those that each would have by itself."""
    folder = both[0]
    plan = BakePlan(folder / "rig.usda", folder / "each", lighting=("sky",), fog=("clear",), exposes=EACH, **SMALL)
    bake_cameras(plan, ["/World"])

    def exposed(way, name):
        rows = json.loads((folder / way / name / "bake.json").read_text())["shots"]
        return {row["lighting"]: row["exposure"]["exposure_s"] * row["exposure"]["iso"] for row in rows}

    together = exposed("both", "Ego")
    assert together == exposed("both", "Right")
    alone = sorted(exposed("each", name)["sky"] for name in ("Ego", "Right"))
    assert alone[0] < together["sky"] < alone[1]


@pytest.mark.slow
def test_a_rig_goes_on_where_it_stopped(both):
    """With one shot of the second camera lost, the same run makes that one, and its bytes are the same."""
    folder = both[0]
    lost, kept = (folder / "both" / name / "sky/mor600/raw.dng" for name in ("Right", "Ego"))
    before, stamp = lost.read_bytes(), kept.stat().st_mtime_ns
    lost.unlink()
    plan = BakePlan(folder / "rig.usda", folder / "both", lighting=("sky", "active"), fog=("clear", "mor600"), **SMALL)
    bake_cameras(plan, ["Ego", "Right"])
    assert lost.read_bytes() == before
    assert kept.stat().st_mtime_ns == stamp


def test_frames_that_are_metered_together_count_pixel_by_pixel():
    """Two even frames of luminance L and 4 L: the key is set by the geometric mean of all, 2 L, as that of one even
    frame of 2 L is; the same frame twice is metered as once.  Highlights lie below their limit in all of them.
    """
    graph = camera.load_graph(resources.folder("pipeline") / "phone.yaml").with_overrides(
        {"irradiance.falloff": "none"}
    )

    def even(level):
        return Image(np.full((18, 32, 3), level, np.float32), ("R", "G", "B"), Quantity.RADIANCE)

    dim, bright, middle = even(300.0), even(1200.0), even(600.0)
    once, twice = meter(dim, graph), meter(dim, graph, side_frames=[dim])
    assert once.exposure_s * once.iso == pytest.approx(twice.exposure_s * twice.iso, rel=1e-6)
    both, wanted = meter(dim, graph, side_frames=[bright]), meter(middle, graph)
    assert both.mean_cd_m2 == pytest.approx(600.0, rel=1e-3)
    assert both.exposure_s * both.iso == pytest.approx(wanted.exposure_s * wanted.iso, rel=2e-3)


def test_a_second_camera_is_exchanged_at_the_same_origin(tmp_path):
    """From the translation of the first: its place is its own, in the first one's axes; notes on the first are not of
    the second.
    """
    opened = stage.open_stage(rig_stage(tmp_path, right=(123.4, 5.0, 0.0)))
    made = Exchange(opened, StageView(camera="/World/Ego"), rig=["/World/Rig/Right"])
    other = made.within(opened, camera="/World/Rig/Right")
    assert other.world is made.scene.world
    assert other.origin_m == made.scene.origin_m
    place = other.camera.to_world[:3, 3] + other.origin_m
    np.testing.assert_allclose(place, (123.4, 5.0, 0.0), atol=1e-9)
    assert [eye.path for eye in made.scene.further_cameras] == ["/World/Rig/Right"]
    assert [eye.path for eye in other.further_cameras] == ["/World/Ego"]


def test_cameras_of_other_moments_are_translated_apart(tmp_path):
    """A second camera whose shutter is open for another time sees what moves elsewhere: no exchange."""
    path = rig_stage(tmp_path)
    text = path.read_text()
    at = text.index('def Camera "Right"')
    path.write_text(text[:at] + text[at:].replace("{", "{\n double shutter:open = 0\n double shutter:close = 0.5\n", 1))
    opened = stage.open_stage(path)
    made = Exchange(opened, StageView(camera="/World/Ego", frame=1.0), rig=["/World/Rig/Right"])
    assert made.within(opened, camera="/World/Rig/Right") is None
    assert made.scene.further_cameras == ()


def test_cameras_are_named_by_path_name_or_what_is_above():
    """Each once, in the order of the words; what is missing or meant twice is told."""
    opened = Usd.Stage.CreateInMemory()
    for path in ("/Rig/Left", "/Rig/Right", "/Ego", "/Other/Left"):
        opened.DefinePrim(path, "Camera")
    assert stage.named_cameras(opened, ["Right", "/Rig"]) == ("/Rig/Right", "/Rig/Left")
    assert stage.named_cameras(opened, ["/"]) == tuple(stage.cameras(opened))
    with pytest.raises(StageError, match="/Rig/Left and /Other/Left have this name"):
        stage.named_cameras(opened, ["Left"])
    with pytest.raises(StageError, match=r"--camera Rigth.*Did you mean"):
        stage.named_cameras(opened, ["Rigth"])
    assert folders_of(stage.cameras(opened))["/Rig/Left"] == "Rig_Left"


def test_several_cameras_do_not_go_beside_the_bake_of_one(tmp_path):
    """Whose shots and manifest would be taken for theirs."""
    (tmp_path / "bake.json").write_text("{}")
    with pytest.raises(OutputError, match="a bake of one camera lies here, and 2 cameras need"):
        bake_cameras(BakePlan(rig_stage(tmp_path), tmp_path, **SMALL), ["/World"])


@pytest.mark.slow
def test_cameras_of_a_set_are_one_rig(tmp_path):
    """One exposure in both units, by each pipeline, or each its own where that is asked for; and in the further
    pipeline, too, noise of their own: of 1728 pixels of two cameras in one place.
    """
    exposures = {}
    for way, turned in (("together", 0.0), ("together", -70.0), ("each", -70.0)):
        name = f"{way}{turned:g}"
        rig_stage(tmp_path, right=(0.0, 0.0, 0.0), turn_deg=turned, name=name)
        found = define_set(
            folder=tmp_path,
            scenes=1,
            stages={f"{name}.usda": 1},
            lightings=["sky"],
            fogs=["clear"],
            cameras=["own", "/World/Rig/Right"],
            meter=way,
            pipelines=["noise_free", "synfog"],
            size=[48, 36],
            quality={"word": "reference", "samples": 2},
        )
        for one in scene(found, 0).units:
            told, _ = make(found, tmp_path / name, one)
            pictures = told["shots"][0]["pictures"]
            exposures[name, one.camera] = [pictures[by]["exposure"] for by in ("noise_free", "synfog")]
    assert exposures["together-70", ""] == exposures["together-70", "/World/Rig/Right"]
    for one, other in zip(exposures["each-70", ""], exposures["each-70", "/World/Rig/Right"], strict=True):
        assert one != other
    noise = []
    for unit in scene(found, 0).units:
        folder = tmp_path / "together0" / unit.folder / "clear"
        noisy, plain = (writers.read_raw(folder / name / "raw.dng").pixels[..., 0] for name in ("synfog", "."))
        noise.append((noisy - plain).ravel().astype(float))
    assert min(part.std() for part in noise) > 0.5
    assert abs(np.corrcoef(*noise)[0, 1]) < 5.0 / np.sqrt(noise[0].size)


@pytest.mark.slow
def test_each_pipeline_of_a_set_has_the_streaks_of_its_own_exposure(tmp_path):
    """A pipeline that exposes twenty times as long as the first has streaks of the same drops that are longer, and each
    pixel of them changes less.
    """
    for name, exposure in (("short", 0.0005), ("long", 0.01)):
        (tmp_path / f"{name}.yaml").write_text(
            f"synfog: graph/1\ntitle: t\nextends: noise_free\nnodes: [{{name: expose, exposure_s: {exposure}}}]\n"
        )
    rig_stage(tmp_path)
    found = define_set(
        folder=tmp_path,
        scenes=1,
        stages={"rig.usda": 1},
        lightings=["sky"],
        fogs=["clear", "rain100"],
        pipelines=["short.yaml", "long.yaml"],
        size=[320, 180],
        quality={"word": "draft"},
    )
    (unit,) = scene(found, 0).units
    make(found, tmp_path / "out", unit)
    shot = tmp_path / "out" / unit.folder / "rain100"
    drops = writers.read_exr(shot / "layers.exr", channels=[f"drops.{name}" for name in "RGB"]).pixels.astype(float)
    before, longer = (writers.read_exr(path / "radiance.exr").pixels for path in (shot, shot / "long"))
    of_long = longer.astype(float) - before + drops
    assert drops.std() > 1.5 * of_long.std() > 0.0
    assert (shot / "long" / "srgb.png").read_bytes() != (shot / "srgb.png").read_bytes()


def test_a_prim_above_a_rig_is_refused_where_one_camera_is_wanted(tmp_path):
    """A set's unit is of one camera: the line says what a set names instead."""
    path = rig_stage(tmp_path)
    named = r"cameras: \[/World/Ego, /World/Rig/Right\]"
    with pytest.raises(StageError, match=f"/World means 2 cameras, and one is wanted here; .*{named}"):
        bake(BakePlan(path, tmp_path / "out", camera="/World", **SMALL))
