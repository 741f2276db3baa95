"""SUMO's floating car data: places by hand, a way out and in again, and broken files."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from synfog_usd.base.errors import RecipeError
from synfog_usd.world import compose
from synfog_usd.world.roads import rules
from synfog_usd.world.traffic import fcd

BY_HAND = """<fcd-export>
  <timestep time="10.00">
    <vehicle id="a" x="3.0" y="120.0" z="2.5" angle="90.0" type="saloon" speed="10"/>
    <person id="p" x="1.0" y="100.0" angle="180.0" type="DEFAULT_PEDTYPE" speed="1"/>
    <person id="rider" x="3.0" y="120.0" angle="90.0" vehicle="a"/>
  </timestep>
  <timestep time="10.50">
    <vehicle id="a" x="8.0" y="120.0" z="2.5" angle="90.0" type="saloon" speed="10"/>
    <person id="p" x="1.0" y="99.5" angle="180.0" type="DEFAULT_PEDTYPE" speed="1"/>
  </timestep>
</fcd-export>
"""


def test_one_car_and_one_person_by_hand(tmp_path):
    """90 degrees is east: the car looks along +X, and its origin lies its nose behind the bumper; z is the file's; who
    rides in it is nobody of their own.
    """
    (tmp_path / "t.xml").write_text(BY_HAND)
    out = tmp_path / "street.usda"
    spec = compose.compose("residential", out, seed=3, traffic=tmp_path / "t.xml")
    stage = Usd.Stage.Open(str(out))
    car, person = (next(p for p in spec.placed if p.name.endswith(f"_F00{k}")) for k in (1, 2))
    assert (car.asset, rules.model(person.asset).group) == ("saloon", "person")
    assert sum("_F0" in p.name for p in spec.placed) == 2
    nose = rules.foot("saloon")[3]
    for t, x in ((0.0, 3.0), (2.0, 5.0), (4.0, 7.0)):
        cache = UsdGeom.XformCache(t)
        at = np.array(cache.GetLocalToWorldTransform(stage.GetPrimAtPath(f"/World/Vehicles/{car.name}")))
        np.testing.assert_allclose(at[3, :3], [x - nose, 120.0, 2.5], atol=2e-4)
        np.testing.assert_allclose(at[1, :2], [1.0, 0.0], atol=0.05)
        walker = np.array(cache.GetLocalToWorldTransform(stage.GetPrimAtPath(f"/World/People/{person.name}")))
        np.testing.assert_allclose(walker[3, :2], [1.0, 100.0 - t / 10.0], atol=2e-4)
        np.testing.assert_allclose(walker[1, :2], [0.0, -1.0], atol=1e-5)


def rows(path):
    """Of each time what is where, by kind and type."""
    return {
        float(step.get("time")): sorted(
            (one.tag, one.get("type"), *(float(one.get(key)) for key in ("x", "y", "z"))) for one in step
        )
        for step in ElementTree.parse(path).getroot()
    }


def test_a_clip_goes_out_and_comes_in_again(tmp_path):
    """A clip's own FCD drives it to the same places within a millimetre."""
    paths = [tmp_path / "a.xml", tmp_path / "b.xml"]
    first = compose.compose("residential", tmp_path / "a.usda", seed=3, seconds=1.0, fcd=paths[0])
    compose.compose("residential", tmp_path / "b.usda", seed=3, traffic=paths[0], fcd=paths[1])
    wanted, found = (rows(path) for path in paths)
    assert len(found) >= 9
    assert len(wanted[0.0]) > 8
    for time, told in found.items():
        for one, other in zip(told, wanted[time], strict=True):
            assert one[:2] == other[:2]
            np.testing.assert_allclose(one[2:], other[2:], atol=2e-3)
    hatchback = next(p for p in first.placed if p.lit and p.asset == "hatchback")
    h, nose = math.radians(hatchback.heading), rules.foot("hatchback")[3]
    front = [hatchback.x - nose * math.sin(h), hatchback.y + nose * math.cos(h)]
    assert min(np.hypot(x - front[0], y - front[1]) for _, _, x, y, _ in wanted[0.0]) < 1e-3


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("<fcd-export><timestep", "t.xml:1:"),
        ("<fcd-export/>", "no vehicle"),
        (
            '<fcd-export><timestep time="0"><vehicle id="a" x="1" y="nan" angle="0"/></timestep></fcd-export>',
            "y is 'nan'",
        ),
        ('<fcd-export><vehicle id="a" x="1" y="2" angle="0"/></fcd-export>', "in no timestep"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><fcd-export/>', "document type"),
        (BY_HAND.replace("10.50", "10.00"), "comes twice"),
    ],
)
def test_a_broken_file_is_one_line(tmp_path, text, line):
    """With its place and what is wrong."""
    (tmp_path / "t.xml").write_text(text)
    with pytest.raises(RecipeError, match=line):
        fcd.read(Path(tmp_path / "t.xml"))
