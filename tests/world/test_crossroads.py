"""The demo crossing: what it holds, that it is well-formed, and that nothing floats, overlaps or changes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdLux
from support.outlines import assert_whole

from assets.builders import crossing
from synfog_usd.base.cityscapes import LABELS
from synfog_usd.translate import ies

ROOT = Path(__file__).resolve().parents[2]
STAGE = ROOT / "stages" / "crossroads.usda"


def opened(fog: str = "clear", lighting: str = "sky") -> Usd.Stage:
    stage = Usd.Stage.Open(str(STAGE))
    stage.SetEditTarget(stage.GetSessionLayer())  # layers are shared between the stages of a process
    sets = stage.GetDefaultPrim().GetVariantSets()
    sets.GetVariantSet("fog").SetVariantSelection(fog)
    sets.GetVariantSet("lighting").SetVariantSelection(lighting)
    return stage


@pytest.fixture(scope="module")
def day() -> Usd.Stage:
    return opened()


@pytest.fixture(scope="module")
def dusk() -> Usd.Stage:
    return opened("mor150", "active")


def everything(stage: Usd.Stage) -> list[Usd.Prim]:
    return list(Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()))


def test_the_stage_is_whole_labelled_and_valid(day):
    """And no label anywhere is a word of its own."""
    assert_whole(STAGE, least=200)
    labels = (prim.GetAttribute("semantics:labels:cityscapes") for prim in everything(day))
    assert {word for one in labels if one.IsValid() for word in one.Get()} <= {*LABELS}


@pytest.mark.parametrize("name, mor", [("mor600", 600.0), ("mor300", 300.0), ("mor150", 150.0)])
def test_fog_variant_says_how_far_one_sees(name, mor):
    stage = opened(name)
    fog = stage.GetPrimAtPath("/World/Fog/Global")
    assert fog.GetAttribute("synfog:fog:mor").Get() == mor
    assert fog.GetAttribute("synfog:fog:g").Get() == pytest.approx(0.87)
    assert "SynFogMediumAPI" in fog.GetPrimTypeInfo().GetAppliedAPISchemas()
    assert UsdGeom.Imageable(fog).ComputePurpose() == "guide"


def test_nothing_but_the_sky_shines_by_day(day):
    assert [p.GetName() for p in everything(day) if p.HasAPI(UsdLux.LightAPI)] == ["Overcast"]
    glowing = [p.GetPath() for p in everything(day) if p.GetAttribute("inputs:emissiveColor").HasAuthoredValue()]
    assert glowing == []


def test_lamps_shine_at_dusk_and_are_few(dusk):
    """Each local light costs noise in every pixel; forty are the most that this stage allows itself."""
    lights = [p for p in everything(dusk) if p.HasAPI(UsdLux.LightAPI)]
    assert [p.GetName() for p in lights if p.IsA(UsdLux.DomeLight)] == ["Dusk"]
    local = [p for p in lights if not p.IsA(UsdLux.DomeLight)]
    assert 15 < len(local) < 40
    headlights = [p for p in local if p.GetName() in ("Left", "Right")]
    assert len(headlights) >= 12
    for prim in local:
        candela = UsdLux.LightAPI(prim).GetIntensityAttr().Get() * np.pi * prim.GetAttribute("inputs:radius").Get() ** 2
        if prim in headlights:  # a dipped beam of UN Regulation 112, which keeps below the horizon by itself
            file = UsdLux.ShapingAPI(prim).GetShapingIesFileAttr().Get()
            candela *= ies.parse(Path(file.resolvedPath).read_bytes(), file.path).candela.max()
            place = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
            assert abs(place.TransformDir(Gf.Vec3d(0, 0, -1))[2]) < 1e-3, prim.GetPath()
        assert 1_000 <= candela <= 44_000, prim.GetPath()


def test_stage_is_what_the_code_writes(tmp_path):
    """Remake with `python -m assets.builders stages`."""
    (tmp_path / "assets").symlink_to(ROOT / "assets")
    assert crossing.write_stage(tmp_path / "stages" / "crossroads.usda").read_bytes() == STAGE.read_bytes()
