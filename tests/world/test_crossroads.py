"""The demo crossing: what it holds, that it is well-formed, and that nothing floats, overlaps or changes."""

from __future__ import annotations

from pathlib import Path

import pytest
from pxr import Usd
from support.outlines import assert_whole

from assets.builders import crossing
from synfog_usd.base.cityscapes import LABELS

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


def everything(stage: Usd.Stage) -> list[Usd.Prim]:
    return list(Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()))


@pytest.mark.slow
def test_the_stage_is_whole_labelled_and_valid(day):
    """And no label anywhere is a word of its own."""
    assert_whole(STAGE, least=200)
    labels = (prim.GetAttribute("semantics:labels:cityscapes") for prim in everything(day))
    assert {word for one in labels if one.IsValid() for word in one.Get()} <= {*LABELS}


def test_stage_is_what_the_code_writes(tmp_path):
    """Remake with `python -m assets.builders stages`."""
    (tmp_path / "assets").symlink_to(ROOT / "assets")
    assert crossing.write_stage(tmp_path / "stages" / "crossroads.usda").read_bytes() == STAGE.read_bytes()
