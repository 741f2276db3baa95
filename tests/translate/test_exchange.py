"""Fogs that are exchanged in a scene that was translated once, against translations of their own."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Usd
from support.stages import street

from synfog_usd import stage as usd
from synfog_usd.base import resources
from synfog_usd.fog import Fog
from synfog_usd.translate import Exchange, StageView, translate

THICK = """        "mor150" {
            over "Fog"
            {"""

MORE = {
    "an attribute of a light": ("", 'over "Sky"\n{\nfloat inputs:exposure = 1\n}'),
    "a light that is gone": ("", 'over "Lamp" (\nactive = false\n)\n{\n}'),
    "a material": ("", 'over "Paint"\n{\nover "Shader"\n{\nfloat inputs:roughness = 0.2\n}\n}'),
    "a new prim": ("", 'def Cube "Post"\n{\n}'),
    "the camera": ("", 'over "Ego"\n{\nfloat focalLength = 30\n}'),
    "the root": ("", "float3 xformOp:rotateXYZ = (0, 0, 9)"),
    "a choice of another variant": ("", 'over "Wall" (\nvariants = {\nstring look = "wet"\n}\n)\n{\n}'),
    "a house in the fog's own scope": ('def Cube "Post"\n{\n}', ""),
}


def stage_of(text):
    stage = Usd.Stage.CreateInMemory()
    stage.GetRootLayer().ImportFromString(text)
    return stage


def same(one, other):
    """Whether two scenes are the same in every number."""
    assert one.world.keys() == other.world.keys()
    first, second = (
        [dict(scene.world), vars(scene.camera), scene.instance_of, scene.group_of] for scene in (one, other)
    )
    np.testing.assert_equal(first, second)
    np.testing.assert_equal(
        [vars(part.boundary) | vars(part.medium) for part in one.fog],
        [vars(part.boundary) | vars(part.medium) for part in other.fog],
    )
    assert [(part.path, part.parent, part.priority) for part in one.fog] == [
        (part.path, part.parent, part.priority) for part in other.fog
    ]


@pytest.mark.parametrize("begin", ["clear", "mor150"])
@pytest.mark.parametrize("mor_m", [None, 80.0, np.inf])
def test_each_fog_is_as_if_it_were_translated(begin, mor_m):
    """From clear air or from fog, as authored, with a visibility instead, and without any."""
    stage = stage_of(street(lamp=True))
    usd.select(stage, fog=begin)
    exchange = Exchange(stage, StageView(resolution=(32, 18)))
    for name in ("clear", "mor600", "mor150"):
        usd.select(stage, fog=name)
        found = exchange.within(stage, fog=mor_m and Fog(mor_m))
        assert found is not None and found.world is exchange.scene.world
        same(found, translate(stage, resolution=(32, 18), fog=mor_m and Fog(mor_m)))


@pytest.mark.parametrize("name", [pytest.param("crossroads", marks=pytest.mark.slow), "bench/fog_bank"])
def test_the_shipped_stages_exchange_their_fogs(name):
    """The crossing and the bank of fog, whose second volume no variant names."""
    stage = usd.open_stage(resources.folder("stages") / f"{name}.usda")
    exchange = Exchange(stage, StageView(resolution=(32, 18)))
    for fog in usd.variants(stage)["fog"]:
        usd.select(stage, fog=fog)
        found = exchange.within(stage)
        assert found is not None and len(found.fog) == (0 if fog == "clear" else 2 if "bank" in name else 1), fog


@pytest.mark.parametrize("what", MORE)
def test_a_variant_that_says_more_is_not_exchanged(what):
    """Whatever else a fog's variant touches, in either direction: no scene, so that the caller translates."""
    within, beside = MORE[what]
    text = street(lamp=True)
    assert THICK in text
    text = text.replace(
        "        uniform token purpose", within + "\n        uniform token purpose", 1
    )  # it goes with the fog when that is switched off
    text = text.replace(THICK, '        "mor150" {\n' + beside + '\n            over "Fog"\n            {', 1)
    for begin, other in (("mor150", "clear"), ("clear", "mor150")):
        stage = stage_of(text)
        usd.select(stage, fog=begin)
        exchange = Exchange(stage, StageView(resolution=(32, 18)))
        usd.select(stage, fog=other)
        assert exchange.within(stage) is None, (begin, other)


def test_a_variant_of_a_file_that_is_referred_to_counts(tmp_path):
    """The set stands in another file, under another name: its prims are found in the stage all the same."""
    (tmp_path / "street.usda").write_text(street())
    text = (
        '#usda 1.0\n(\n    defaultPrim = "Town"\n    metersPerUnit = 1\n    upAxis = "Z"\n)\ndef Xform "Town" (\n    '
        "references = @street.usda@\n)\n{\n}\n"
    )
    (tmp_path / "town.usda").write_text(text)
    for more, exchanged in (("", True), ('over "Sky"\n{\nfloat inputs:exposure = 1\n}\n', False)):
        (tmp_path / "street.usda").write_text(
            street().replace(THICK, '        "mor150" {\n' + more + '            over "Fog"\n            {', 1)
        )
        stage = usd.open_stage(tmp_path / "town.usda")
        usd.select(stage, fog="clear")
        exchange = Exchange(stage, StageView(resolution=(32, 18)))
        usd.select(stage, fog="mor150")
        found = exchange.within(stage)
        assert (found is not None) == exchanged
        if found is not None:
            same(found, translate(stage, resolution=(32, 18)))
        del stage, exchange, found


TWO = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Z"
)
def Xform "World" (
    variants = {
        string lighting = "day"
    }
    prepend variantSets = "lighting"
) {
    def Camera "Ego" {
        float3 xformOp:rotateXYZ = (90, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:rotateXYZ"]
    }
    def Xform "One" (
        instanceable = true
        references = </Model>
    ) {}
    def Xform "Two" (
        instanceable = true
        references = </Model>
    ) {
        double3 xformOp:translate = (2, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def Xform "Own" (references = </Model>) {}
    variantSet "lighting" = {
        "day" {
            def DistantLight "Sun" {}
        }
        "night" {
            over "Own" {
                SAID
            }
        }
    }
}
def Xform "Model" {
    def Mesh "Plate" (prepend apiSchemas = ["MaterialBindingAPI"]) {
        point3f[] points = [(0, 5, 0), (1, 5, 0), (1, 5, 1), (0, 5, 1)]
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        uniform token subdivisionScheme = "none"
        rel material:binding = </Model/Paint>
        texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (interpolation = "vertex")
    }
    def Material "Paint" {
        token outputs:surface.connect = </Model/Paint/Surface.outputs:surface>
        def Shader "Surface" {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor = (0.8, 0.1, 0.1)
            token outputs:surface
        }
    }
}
"""

SAID = {
    "nothing": "",
    "points": 'over "Plate"\n{\npoint3f[] points = [(0, 5, 0), (3, 5, 0), (3, 5, 1), (0, 5, 1)]\n}',
    "an orientation": 'over "Plate"\n{\nuniform token orientation = "leftHanded"\n}',
    "a place": 'double3 xformOp:translate = (0, 4, 0)\nuniform token[] xformOpOrder = ["xformOp:translate"]',
    "a colour": 'over "Paint"\n{\nover "Surface"\n{\ncolor3f inputs:diffuseColor = (0.1, 0.1, 0.8)\n}\n}',
    "a subset": 'over "Plate"\n{\ndef GeomSubset "Part"\n{\nint[] indices = [0]\n'
    "rel material:binding = </Model/Paint>\n}\n}",
}


@pytest.mark.parametrize("what", SAID)
def test_what_another_variant_leaves_alone_is_taken_over(what):
    """A second lighting that says something of one of three plates: the scene is as if it were translated by itself."""
    text = TWO.replace("SAID", SAID[what])
    stage, alone = stage_of(text), stage_of(text)
    day = Exchange(stage, StageView(resolution=(32, 18)))
    usd.select(stage, lighting="night")
    usd.select(alone, lighting="night")
    night = Exchange(stage, StageView(resolution=(32, 18)), before=day)
    same(night.scene, translate(alone, resolution=(32, 18)))

    def arrays(exchange):
        world = exchange.scene.world
        return {
            id(part["positions"])
            for group in world.values()
            if isinstance(group, dict)
            for part in group.values()
            if isinstance(part, dict) and "positions" in part
        }

    assert arrays(day) == arrays(night) != set()


def test_meshes_are_read_each_by_itself_where_value_clips_may_fill_them(tmp_path):
    """Two plates of the same specs, of which clips give one other points at the frame that is drawn."""
    points = "[(0, 5, 0), ({0}, 5, 0), ({0}, 5, 1), (0, 5, 1)]"
    for name, width in (("a", 1), ("b", 3)):
        (tmp_path / f"{name}.usda").write_text(
            f'#usda 1.0\ndef Xform "Model"\n{{\ndef Mesh "Plate"\n{{\npoint3f[] points.timeSamples = '
            f"{{ 1: {points.format(width)} }}\n}}\n}}\n"
        )
    clips = (
        'clips = {{ dictionary default = {{ asset[] assetPaths = [@./{0}.usda@]\nstring primPath = "/Model"\n'
        "double2[] active = [(1, 0)]\ndouble2[] times = [(1, 1)]\nasset manifestAssetPath = @./manifest.usda@ }} }}"
    )
    (tmp_path / "manifest.usda").write_text(
        '#usda 1.0\ndef Xform "Model"\n{\ndef Mesh "Plate"\n{\npoint3f[] points\n}\n}\n'
    )
    model = TWO[TWO.index('def Xform "Model"') :].replace(
        "point3f[] points = [(0, 5, 0), (1, 5, 0), (1, 5, 1), (0, 5, 1)]", ""
    )
    prims = "".join(
        f'def Xform "{name}" (\nreferences = </Model>\n{clips.format(name)}\n)\n{{\n}}\n' for name in ("a", "b")
    )
    camera = TWO[TWO.index("def Camera") : TWO.index('def Xform "One"')]
    (tmp_path / "stage.usda").write_text(f'#usda 1.0\n(\nmetersPerUnit = 1\nupAxis = "Z"\n)\n{camera}{prims}{model}')
    scene = translate(usd.open_stage(tmp_path / "stage.usda"), frame=1.0, resolution=(32, 18))
    widths = sorted(
        float(np.ptp(part["positions"][:, 0])) for key, part in scene.world.items() if key.startswith("shape_")
    )
    assert widths[-2:] == [1.0, 3.0]
