"""SUMO's floating car data: places by hand, a way out and in again, and broken files."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from synfog_usd.base.errors import RecipeError
from synfog_usd.world import compose, library
from synfog_usd.world.roads import rules
from synfog_usd.world.traffic import fcd

ALONE = {"people.count": 0}
"""Nobody walks whom no file names."""

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
    """90 degrees is east: the car looks along +X with its nose at the file's place; who rides in it is not drawn.

    On a crossfall below 5 % the nose is shorter from above than along the car, by 3 mm at most.
    """
    (tmp_path / "t.xml").write_text(BY_HAND)
    out = tmp_path / "street.usda"
    spec = compose.compose("residential", out, seed=3, traffic=tmp_path / "t.xml", change=ALONE)
    stage = Usd.Stage.Open(str(out))
    car, person = (next(p for p in spec.placed if p.name.endswith(f"_F00{k}")) for k in (1, 2))
    assert (car.asset, library.model(person.asset).group) == ("saloon", "person")
    assert sum("_F0" in p.name for p in spec.placed) == 2
    nose = rules.foot("saloon")[3]
    for t, x in ((0.0, 3.0), (2.0, 5.0), (4.0, 7.0)):
        cache = UsdGeom.XformCache(t)
        at = np.array(cache.GetLocalToWorldTransform(stage.GetPrimAtPath(f"/World/Vehicles/{car.name}")))
        np.testing.assert_allclose(at[3, :3] + nose * at[1, :3], [x, 120.0, 2.5], atol=3e-3)
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
    how = {"seed": 3, "change": {"people.count": 6}}
    first = compose.compose("residential", tmp_path / "a.usda", seconds=1.0, fcd=paths[0], **how)
    compose.compose("residential", tmp_path / "b.usda", traffic=paths[0], fcd=paths[1], **how)
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


FROM_SUMO = """<fcd-export>
  <timestep time="0">
    <vehicle id="b" x="2" y="50" angle="0" type="speedy"/>
    <person id="p" x="9" y="60" angle="0"/>
  </timestep>
  <timestep time="1">
    <vehicle id="b" x="2" y="60" angle="0" type="speedy"/>
    <person id="p" x="2" y="60" angle="0"/>
  </timestep>
  <timestep time="2">
    <vehicle id="b" x="2" y="70" angle="0" type="speedy"/>
    <person id="p" x="2" y="70" angle="0"/>
  </timestep>
  <timestep time="3">
    <vehicle id="b" x="2" y="80" angle="0" type="speedy"/>
    <person id="p" x="9" y="75" angle="0"/>
  </timestep>
</fcd-export>
"""


def test_who_rides_is_hidden(tmp_path):
    """SUMO 1.28 names no vehicle for who rides: it puts them where the vehicle is.  They are hidden until they leave.

    The car goes at 10 m/s from the first frame to the last.
    """
    (tmp_path / "t.xml").write_text(FROM_SUMO)
    told = {"traffic": tmp_path / "t.xml", "fcd": tmp_path / "o.xml"}
    spec = compose.compose("residential", tmp_path / "s.usda", seed=3, change=ALONE, **told)
    found = rows(tmp_path / "o.xml")
    assert {time: sum(one[0] == "person" for one in found[time]) for time in (0.0, 0.5, 1.0, 2.0, 2.5, 2.9)} == {
        0.0: 1, 0.5: 0, 1.0: 0, 2.0: 0, 2.5: 0, 2.9: 0,
    }  # fmt: skip
    cars = [one for one in ElementTree.parse(tmp_path / "o.xml").iter("vehicle") if one.get("id") != "ego"]
    assert len(cars) == len(found) == 30
    np.testing.assert_allclose([float(one.get("speed")) for one in cars], 10.0, atol=1e-3)
    car = next(p for p in spec.placed if p.name.endswith("_F001"))
    assert library.model(car.asset).label == "car"


@pytest.mark.parametrize(
    ("kind", "label"),
    [("bicycle", "rider"), ("DEFAULT_BIKETYPE", "rider"), ("church", "car"), ("stopped", "car"), ("bus_3", "bus")],
)
def test_a_type_gives_what_drives(kind, label):
    """A type is no model that stands or walks, and a bicycle has its rider."""
    model = fcd._model(fcd.Recorded("a", kind, person=False), np.random.default_rng(1))
    assert library.model(model.asset).label == label


def test_ego_stays_for_the_whole_clip(tmp_path):
    """A camera whose car is gone has no place; the line names both times."""
    text = FROM_SUMO.replace('"b"', '"ego"').replace('<vehicle id="ego" x="2" y="80" angle="0" type="speedy"/>', "")
    (tmp_path / "t.xml").write_text(text)
    with pytest.raises(RecipeError, match=r"'ego' is there from 0 to 2 s, and the clip goes from 0 to 2\.9 s"):
        compose.compose("residential", tmp_path / "s.usda", seed=3, traffic=tmp_path / "t.xml", change=ALONE)


def test_rows_are_as_sumo_writes_them(tmp_path):
    """In SUMO's schema (fcd_file.xsd) persons follow vehicles; its fast reader needs attributes in SUMO's order."""
    compose.compose("residential", tmp_path / "a.usda", seed=3, seconds=0.2, fcd=tmp_path / "a.xml")
    for step in ElementTree.parse(tmp_path / "a.xml").getroot():
        tags = [one.tag for one in step]
        assert tags == sorted(tags, reverse=True)
        assert {"vehicle", "person"} <= set(tags)
        assert all(list(one.keys()) == ["id", "x", "y", "z", "angle", "type", "speed", "slope"] for one in step)


def test_other_names_than_xml_are_refused(tmp_path):
    """Nothing is written over a file of another kind."""
    with pytest.raises(RecipeError, match=r"ends in \.xml"):
        compose.compose("residential", tmp_path / "a.usda", seed=3, seconds=0.2, fcd=tmp_path / "a.usda")


def test_frames_without_a_length_are_refused(tmp_path):
    """A still would be a surprise."""
    with pytest.raises(RecipeError, match=r"^--fps: for a clip, and this is a still; add --seconds$"):
        compose.compose("residential", tmp_path / "a.usda", seed=3, fps=10.0)


def timestep(row, before=""):
    """A file with a row at time 0."""
    return f'{before}<fcd-export><timestep time="0">{row}</timestep></fcd-export>'


ROW = '<vehicle id="a" x="1" y="2" angle="0"/>'
BOMB = '<!DOCTYPE a [<!ENTITY b "cccccccc"><!ENTITY d "&b;&b;&b;&b;&b;&b;&b;&b;&b;">]>'


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("<fcd-export><timestep", "t.xml:1:"),
        ("", "t.xml:1:1: no XML"),
        ('<?xml version="1.0" encoding="klingon"?><fcd-export/>', "klingon"),
        ("<fcd-export/>", "no vehicle"),
        (timestep(ROW.replace('"2"', '"nan"')), "vehicle 'a': y is 'nan'"),
        (timestep(ROW.replace('"2"', '"1e300"')), "y is '1e300'"),
        (timestep(ROW.replace('angle="0"', "")), "t.xml:1:32: vehicle 'a' has no angle"),
        (timestep(ROW.replace('id="a"', "")), "has no id"),
        (timestep(ROW + ROW), "'a' comes twice at time 0"),
        (timestep(ROW).replace('time="0"', 'time="00:00:01"'), "time is '00:00:01'"),
        (f"<fcd-export>{ROW}</fcd-export>", "in no timestep"),
        (timestep(ROW, BOMB), "document type"),
        (timestep(ROW, f"<!--{'x' * 9000}-->{BOMB}"), "document type"),
        (timestep(ROW, f"<!--{'x' * (1 << 21)}-->"), "too long"),
        (BY_HAND.replace("10.50", "10.00"), "t.xml:7:3: timestep 10 comes after 10"),
        (BY_HAND.replace("10.50", "9.00"), "timestep 9 comes after 10"),
    ],
)
def test_a_broken_file_is_one_line(tmp_path, text, line):
    """With its place and what is wrong."""
    (tmp_path / "t.xml").write_text(text)
    with pytest.raises(RecipeError, match=line) as error:
        fcd.read(Path(tmp_path / "t.xml"))
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize("told", [False, True])
def test_on_a_slope_a_car_and_a_person_stand_on_the_road(tmp_path, told):
    """Where a road rises by 4.7 %: without z both are on the ground, and with the ground's z where they are without.

    The car's axis rises as the road does between its bumper and 4 m behind it.
    """
    road = compose.draw(compose.load(Path("rural")), seed=2).road
    line, text = road.reference_line, "<fcd-export>"
    for time, s in ((0, 350.0), (1, 351.0)):
        rows = []
        for tag, t in (("vehicle", 1.7), ("person", 0.9)):
            x, y = (float(v) for v in line.place(s, t))
            z = f' z="{float(road.ground(s, t))}"' if told else ""
            rows.append(f'<{tag} id="{tag}" x="{x}" y="{y}"{z} angle="{-math.degrees(float(line.heading(s)))}"/>')
        text += f'<timestep time="{time}">{"".join(rows)}</timestep>'
    (tmp_path / "t.xml").write_text(text + "</fcd-export>")
    compose.compose("rural", tmp_path / "a.usda", seed=2, traffic=tmp_path / "t.xml", fcd=tmp_path / "o.xml")
    (car,), (person,) = (
        [one for one in ElementTree.parse(tmp_path / "o.xml").getroot()[0].iter(tag) if one.get("id") != "ego"]
        for tag in ("vehicle", "person")
    )
    slope = (float(road.ground(350.0, 1.7)) - float(road.ground(346.0, 1.7))) / 4.0
    assert slope > 0.045
    assert float(car.get("z")) == pytest.approx(float(road.ground(350.0, 1.7)), abs=5e-3)
    assert math.tan(math.radians(float(car.get("slope")))) == pytest.approx(slope, abs=2e-3)
    assert float(person.get("z")) == pytest.approx(float(road.ground(350.0, 0.9)), abs=2e-3)
    assert float(person.get("slope")) == 0.0
