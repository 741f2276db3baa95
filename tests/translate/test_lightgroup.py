"""Light groups: authored, inherited, guessed from labels, or refused."""

import pytest
from pxr import Sdf, Usd

from synfog_usd.base.errors import StageError
from synfog_usd.translate.lightgroup import authored_group


def prim_with(value, kind=Sdf.ValueTypeNames.String):
    stage = Usd.Stage.CreateInMemory()
    stage.DefinePrim("/Car").CreateAttribute("synfog:lightGroup", kind).Set(value)
    return stage, stage.DefinePrim("/Car/Lamps/Left")


def test_a_lamp_belongs_to_the_group_above_it():
    """The nearest ancestor that names one; none where nobody does."""
    _stage, lamp = prim_with("headlights")
    assert authored_group(lamp) == "headlights"
    assert authored_group(Usd.Stage.CreateInMemory().DefinePrim("/Lamp")) is None


@pytest.mark.parametrize("value", ["", "a.R", "../x", "x" * 33, "später"])
def test_a_name_that_cannot_be_a_channel_is_refused_with_its_prim(value):
    """It would become part of a channel's name."""
    _stage, lamp = prim_with(value)
    with pytest.raises(StageError, match=r"/Car: synfog:lightGroup"):
        authored_group(lamp)
