"""The model library: every model opens, stands on the ground, has the size of what it is, and looks as its variants
say.
"""

from __future__ import annotations

import re

import pytest
from pxr import Sdf, Usd, UsdGeom, UsdValidation

from synfog_usd.base import cityscapes
from synfog_usd.base.errors import StageError
from synfog_usd.world.library import SIZES, library, model, read

NAMES = [name for name, m in library().items() if m.group != "ground"]
ROOTED = {"bare_tree", "lime_tree", "maple_tree", "park_tree"}
"""Trees of the crossing whose trunks begin up to 9 cm below the ground."""
NOT_ON_GROUND = {"rider"}
"""Sits on the model `bicycle`, at the same place."""
FIRST = sorted({m.group: m.name for m in reversed(library().values())}.values())
"""One model of each group; one writer wrote all of them."""


@pytest.mark.parametrize("name", NAMES)
def test_model_stands_on_the_ground_and_has_the_size_of_its_class(name):
    """Least z within 2 cm of 0, the origin inside the footprint, extents within the limits of the class."""
    m = library()[name]
    stage = Usd.Stage.Open(str(m.path))
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert m.label in cityscapes.LABELS
    if name not in NOT_ON_GROUND:
        assert abs(m.low[2]) <= (0.09 if name in ROOTED else 0.02)
    assert m.low[0] <= 0 <= m.high[0]
    assert m.low[1] <= 0 <= m.high[1]
    for extent, (least, most) in zip((m.length, m.width, m.height), SIZES[m.label], strict=True):
        assert least <= extent <= most
    stated = re.search(r"([\d.]+) m long", m.about)
    if stated:  # 3 %: rounded corners take a few centimetres, mirrors and plates give some
        assert m.length == pytest.approx(float(stated[1]), rel=0.03)


@pytest.mark.parametrize("name", FIRST)
def test_every_validator_of_usd_is_content_with_a_model(name):
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    stage = Usd.Stage.Open(str(library()[name].path))
    assert [e.GetMessage() for e in UsdValidation.ValidationContext(validators).Validate(stage)] == []


def test_unknown_models_and_files_that_are_none_are_told(tmp_path):
    with pytest.raises(StageError, match=r"no model 'taksi'\. Did you mean 'taxi'"):
        model("taksi")
    for text, said in (
        ("#usda 1.0\n", "default prim"),
        ('#usda 1.0\n(defaultPrim = "A")\ndef Xform "A" {}\n', "0 Cityscapes labels"),
    ):
        path = tmp_path / f"{len(text)}.usda"
        path.write_text(text)
        with pytest.raises(StageError, match=said):
            read(path)
    empty = tmp_path / "empty.usda"
    layer = Sdf.Layer.CreateNew(str(empty))
    stage = Usd.Stage.Open(layer)
    prim = UsdGeom.Xform.Define(stage, "/A").GetPrim()
    stage.SetDefaultPrim(prim)
    prim.CreateAttribute("semantics:labels:cityscapes", Sdf.ValueTypeNames.TokenArray).Set(["car"])
    layer.Save()
    with pytest.raises(StageError, match="no geometry"):
        read(empty)
