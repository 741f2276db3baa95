"""Signals of a crossing over time: who may go, what the lenses show, and what traffic does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdShade

from synfog_usd.world import compose
from synfog_usd.world.traffic import signals
from synfog_usd.world.traffic.motion import _signal_street

SECONDS, FPS = 14.0, 2.0
WAITS = ["traffic.main_street=waits", "people.count=0"]


@pytest.mark.parametrize("street", [signals.MAIN, signals.SIDE])
@pytest.mark.parametrize("seed", range(8))
def test_streets_are_never_green_together(street, seed):
    """One street is green at the beginning; amber lasts 3 s, and 5 s go by between it and the other's green."""
    phases = signals.programme(street, seed)
    t = np.arange(0.0, 3 * phases.cycle, 0.05)
    main, side = phases.lit(signals.MAIN, t), phases.lit(signals.SIDE, t)
    assert (main, side)[street]["green"][0]
    for mine, other in ((main, side), (side, main)):
        ends = np.flatnonzero(mine["green"][:-1] & ~mine["green"][1:])
        assert len(ends) >= 2
        for end in ends[:-1]:
            begins = end + np.argmax(other["green"][end:])
            assert t[begins] - t[end] == pytest.approx(8.0, abs=0.11)
            amber = mine["amber"][end + 1 : begins]
            assert amber.sum() * 0.05 == pytest.approx(3.0, abs=0.11)
            assert amber[0]
            red_amber = other["red"] & other["amber"]
            assert red_amber[end:begins].sum() * 0.05 == pytest.approx(1.0, abs=0.11)
        assert ((mine["red"] | mine["amber"]) != mine["green"]).all()


def test_people_set_out_while_the_other_street_is_green():
    """Nobody sets out over a street that is green, or will be within the time that the last seconds leave."""
    phases = signals.programme(signals.SIDE, 3)
    t = np.arange(0.0, 90.0, 0.1)
    walks = np.any([(t >= begin) & (t < end) for begin, end in phases.walks(signals.MAIN, 90.0)], axis=0)
    assert walks.any()
    assert not (walks & ~phases.lit(signals.SIDE, t)["green"]).any()


def changing_seed():
    """The first seed whose main street turns green after 8 to 10 s."""
    for seed in range(200):
        phases = signals.programme(signals.SIDE, seed)
        green = phases.lit(signals.MAIN, np.array([8.0, 10.0]))["green"]
        if not green[0] and green[1]:
            return seed
    raise AssertionError("no seed changes so early")


@pytest.fixture(scope="module")
def street():
    """A drawn crossing whose main street waits at first, and its clip."""
    seed = changing_seed()
    recipe = compose.load(Path("crossroads"), [*WAITS, f"time.seconds={SECONDS}", f"time.fps={FPS}"])
    return seed, *compose.clip_of(recipe, compose.draw(recipe, seed=seed), seed=seed)


def test_the_queue_stands_at_red_and_goes_at_green(street):
    """Who waits at the line of the main street stands while it is red, and has gone on at the end."""
    _, spec, clip = street
    green = next(lit["green"] for i, lit in clip.signals.items() if _signal_street(spec.placed[i]) == signals.MAIN)
    begins = int(np.argmax(green))
    assert begins > 5
    queue = [
        track for i, track in clip.tracks.items()
        if spec.placed[i].group == "Vehicles" and spec.placed[i].speed_m_s == 0.0 and abs(spec.placed[i].x) < 3.0
    ]  # fmt: skip
    assert queue
    for track in queue:
        assert track.speed[1:begins].max() < 0.2
        assert track.travel[-1] > 0.5
    assert max(track.travel[-1] for track in queue) > 5.0


def test_lenses_change_in_the_stage(street, tmp_path):
    """At dusk the lens that is lit emits and no other does; the stage at frame 0 shows what the still does."""
    seed, spec, clip = street
    for name, seconds in (("still", 0.0), ("clip", SECONDS)):
        compose.compose("crossroads", tmp_path / f"{name}.usda", seed=seed, change=WAITS, seconds=seconds, fps=FPS)
    stages = [Usd.Stage.Open(str(tmp_path / f"{name}.usda")) for name in ("still", "clip")]
    for stage in stages:
        stage.GetPrimAtPath("/World").GetVariantSet("lighting").SetVariantSelection("active")
    changed = 0
    for index, lit in clip.signals.items():
        path = f"/World/Furniture/{spec.placed[index].name}"
        for lens, mesh in (("red", "lens_top"), ("amber", "lens_middle"), ("green", "lens_bottom")):
            before, now = (surface(stage, f"{path}/Geometry/{mesh}") for stage in stages)
            for frame in range(len(lit[lens]) - 2):
                emission = now.GetInput("emissiveColor").Get(float(frame))
                assert (max(emission) > 0.0) == lit[lens][frame + 1], (path, lens, frame)
            changed += lit[lens].any() and not lit[lens].all()
            for name in ("diffuseColor", "roughness"):
                assert before.GetInput(name).Get() == now.GetInput(name).Get(0.0) == now.GetInput(name).Get()
            was = before.GetInput("emissiveColor")
            assert (tuple(was.Get()) if was else (0.0, 0.0, 0.0)) == tuple(now.GetInput("emissiveColor").Get(0.0))
    assert changed >= 6


def surface(stage, path):
    """The shader that a mesh wears."""
    material, _ = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath(path)).ComputeBoundMaterial()
    return UsdShade.Shader(material.GetPrim().GetChild("Surface"))
