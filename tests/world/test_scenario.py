"""OpenSCENARIO's environment: fog with and without a box, sun and time of day by hand, and broken files."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from synfog_usd.base.errors import RecipeError
from synfog_usd.fog.medium import extinction_from_visibility
from synfog_usd.world import compose
from synfog_usd.world.traffic import scenario

BOX = '<BoundingBox><Center x="10" y="60" z="4"/><Dimensions width="40" length="80" height="8"/></BoundingBox>'


def scene(weather, *, minor=2, time="2026-11-27T18:30:00", declared=""):
    """A file with one environment in its Init."""
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<OpenSCENARIO>
  <FileHeader revMajor="1" revMinor="{minor}" date="2026-11-27T00:00:00" description="by hand" author="a"/>
  <ParameterDeclarations>{declared}</ParameterDeclarations>
  <Storyboard><Init><Actions><GlobalAction><EnvironmentAction><Environment name="e">
    <TimeOfDay animation="false" dateTime="{time}"/>
    <Weather cloudState="free">{weather}</Weather>
    <RoadCondition frictionScaleFactor="1"/>
  </Environment></EnvironmentAction></GlobalAction></Actions></Init></Storyboard>
</OpenSCENARIO>
"""


def written(folder, text):
    """The file, and what is read of it."""
    path = folder / "s.xosc"
    path.write_text(text)
    return path, scenario.read(path)


@pytest.mark.parametrize("box", ["", BOX])
@pytest.mark.parametrize("minor", range(4))
def test_versions_say_the_same(tmp_path, minor, box):
    """The sun's lux have two names: intensity up to version 1.1, illuminance from 1.2 on."""
    lux = 'intensity="42000"' if minor < 2 else 'illuminance="42000"'
    weather = f'<Sun azimuth="1.5" elevation="0.5" {lux}/><Fog visualRange="150">{box}</Fog>'
    _, said = written(tmp_path, scene(weather, minor=minor))
    where = scenario.Box((10.0, 60.0, 4.0), (80.0, 40.0, 8.0)) if box else None
    assert said == scenario.Environment(150.0, where, 42000.0, 1.5, 0.5, 18.5)
    assert not said.night


def drawn(folder, weather, **more):
    """A stage with the environment of a file."""
    path, _ = written(folder, scene(weather, **more))
    compose.compose("tunnel", folder / "street.usda", seed=3, environment=path)
    return Usd.Stage.Open(str(folder / "street.usda"))


def test_fog_is_in_its_box_alone(tmp_path):
    """The boundary is the file's box, and 5 % of a contrast are left at the visual range."""
    stage = drawn(tmp_path, f'<Fog visualRange="150">{BOX}</Fog>')
    fog = stage.GetPrimAtPath("/World/Fog/Global")
    assert stage.GetPrimAtPath("/World").GetVariantSet("fog").GetVariantSelection() == "scenario"
    assert stage.GetPrimAtPath("/World").GetVariantSet("fog").GetVariantNames() == ["clear", "scenario"]
    mor = fog.GetAttribute("synfog:fog:mor").Get()
    assert np.exp(-float(extinction_from_visibility(mor)) * 150.0) == pytest.approx(0.05, rel=1e-6)
    bounds = UsdGeom.BBoxCache(0.0, [UsdGeom.Tokens.default_, UsdGeom.Tokens.guide]).ComputeWorldBound(fog)
    around = bounds.ComputeAlignedRange()
    np.testing.assert_allclose(np.array([*around.GetMin(), *around.GetMax()]), [-30, 40, 0, 50, 80, 8], atol=1e-5)


def test_fog_without_a_box_is_everywhere(tmp_path):
    """The boundary is the stage's own; a visual range of 100 km is clear air; without a sun, half past six is day."""
    stage = drawn(tmp_path, '<Fog visualRange="150"/>')
    assert stage.GetPrimAtPath("/World/Fog/Global").GetAttribute("xformOp:scale").Get()[0] == 900.0
    assert stage.GetPrimAtPath("/World").GetVariantSet("lighting").GetVariantSelection() == "sky"
    (tmp_path / "clear").mkdir()
    clear = drawn(tmp_path / "clear", '<Fog visualRange="100000"/>', time="2026-11-27T23:30:00+01:00")
    assert not clear.GetPrimAtPath("/World/Fog").IsActive()
    assert clear.GetPrimAtPath("/World").GetVariantSet("lighting").GetVariantSelection() == "active"


def test_the_sun_is_where_the_file_says(tmp_path):
    """Azimuth 90 degrees is east (+X), clockwise from +Y; the light is normalized, so that its intensity is in lux."""
    weather = f'<Sun azimuth="{np.pi / 2}" elevation="{np.pi / 6}" illuminance="42000"/><Fog visualRange="2000"/>'
    stage = drawn(tmp_path, weather)
    sun = stage.GetPrimAtPath("/World/Sky/Sun")
    assert (sun.GetAttribute("inputs:intensity").Get(), sun.GetAttribute("inputs:normalize").Get()) == (42000.0, True)
    ray = -np.array(UsdGeom.XformCache().GetLocalToWorldTransform(sun))[2, :3]
    np.testing.assert_allclose(-ray, [3**0.5 / 2, 0.0, 0.5], atol=1e-6)


def test_a_parameter_has_its_declared_value(tmp_path):
    """$range stands for what was declared before."""
    declared = '<ParameterDeclaration name="range" parameterType="double" value="75"/>'
    _, said = written(tmp_path, scene('<Fog visualRange="$range"/>', declared=declared))
    assert said.visual_range_m == 75.0


BOMB = '<!DOCTYPE a [<!ENTITY b "cccccccc"><!ENTITY d "&b;&b;&b;&b;&b;&b;&b;&b;&b;">]>'


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("", "s.xosc:1:1: no XML"),
        ("<OpenSCENARIO><FileHeader", "s.xosc:1:"),
        ("<osm/>", "osm is not OpenSCENARIO"),
        ("<OpenSCENARIO/>", "no Environment in it"),
        (BOMB + "<OpenSCENARIO/>", "document type, which OpenSCENARIO has not"),
        (scene("").replace('revMajor="1"', 'revMajor="2"'), "version 2.2; versions 1.0 to 1.3"),
        (scene('<Fog visualRange="0"/>'), "visualRange is 0; it takes a length over 0"),
        (scene('<Fog visualRange="nan"/>'), "Fog: visualRange is 'nan'"),
        (scene("<Fog/>"), "s.xosc:7:32: Fog has no visualRange"),
        (scene('<Fog visualRange="$a"/>'), r"'\$a' is no parameter"),
        (scene('<Fog visualRange="${1+1}"/>'), r"'\$\{1\+1\}' is no parameter"),
        (scene(f'<Fog visualRange="9">{BOX.replace("80", "-80")}</Fog>'), "BoundingBox of the fog"),
        (scene('<Sun azimuth="0" elevation="1"/>'), "Sun has no intensity; add illuminance"),
        (scene('<Sun azimuth="0" elevation="1" illuminance="-1"/>'), "illuminance is -1"),
        (scene("", time="noon"), "TimeOfDay: dateTime is 'noon'"),
    ],
)
def test_a_broken_file_is_one_line(tmp_path, text, line):
    """With its place and what is wrong."""
    (tmp_path / "s.xosc").write_text(text)
    with pytest.raises(RecipeError, match=line) as error:
        scenario.read(tmp_path / "s.xosc")
    assert len(str(error.value).splitlines()) == 1
