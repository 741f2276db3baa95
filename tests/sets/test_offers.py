"""Stages of one's own in a set: with no variants, with other programs' variants, with some of ours."""

from pathlib import Path

import pytest

from synfog_usd.base.errors import SetError
from synfog_usd.dataset.sets import index, offers
from synfog_usd.dataset.sets.load import define_set
from synfog_usd.dataset.sets.scenes import scenes
from tests.support.cli import run

STAGE = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Z"
)
def Xform "World" {variants}
{{
    def Cube "Box"
    {{
        double size = 2
        double3 xformOp:translate = (0, 9, 1)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }}
    {fog}
    def DomeLight "Sky"
    {{
        float inputs:intensity = 1000
    }}
    def Camera "Ego"
    {{
        float focalLength = 24
        float xformOp:rotateX = 90
        uniform token[] xformOpOrder = ["xformOp:rotateX"]
    }}
    {bodies}
}}
"""
FOG = """def Cube "Fog" (
        prepend apiSchemas = ["SynFogMediumAPI"]
    )
    {
        double size = 200
        float synfog:fog:mor = 90
    }"""


def stage(path, *, sets=None, fog=False):
    """A box under a sky; `sets`: name -> variants, without a choice."""
    variants = "".join(f'"{name}", ' for name in sets or {})
    bodies = "".join(
        f'variantSet "{name}" = {{\n' + "".join(f'"{one}" {{\n}}\n' for one in names) + "}\n"
        for name, names in (sets or {}).items()
    )
    head = f"(\n    prepend variantSets = [{variants[:-2]}]\n)" if sets else ""
    path.write_text(STAGE.format(variants=head, fog=FOG if fog else "", bodies=bodies))
    return path


def planned(folder, **words):
    found = define_set(folder=folder, **{"scenes": 1, "stages": ["*.usda"], **words})
    (one,) = scenes(found)
    return one.lightings, one.fogs


@pytest.mark.parametrize(
    "sets, lightings",
    [
        (None, ("authored",)),
        ({"look": ("red", "blue"), "LOD": ("high", "low")}, ("authored",)),
        ({"lighting": ("night", "day")}, ("day", "night")),
        ({"lighting": ("active", "sky")}, ("sky", "active")),
    ],
)
def test_a_stage_has_all_its_lightings_unless_some_are_named(tmp_path, sets, lightings):
    """As a bake has them; without a variant set it is one, as authored.  An empty list is none named."""
    stage(tmp_path / "own.usda", sets=sets)
    assert planned(tmp_path) == (lightings, ("clear", "mor600", "mor300", "mor150"))
    assert planned(tmp_path, lightings=[])[0] == lightings


@pytest.mark.parametrize("named", [["authored"], ["sky", "active"], [{"choice": {"authored": 1, "sky": 1}}]])
def test_a_stage_without_variants_is_as_authored_by_whatever_name(tmp_path, named):
    """So that a set may draw from recipes, which have sky and active, and from it."""
    stage(tmp_path / "own.usda")
    assert planned(tmp_path, lightings=named) == (("authored",), ("clear", "mor600", "mor300", "mor150"))
    assert planned(tmp_path, fogs=["authored", "clear"])[1] == ("authored", "clear")


def test_names_that_a_stage_has_are_told_from_those_that_it_has_not(tmp_path):
    """One that has variants takes their names, and authored; another name is refused with those."""
    stage(tmp_path / "own.usda", sets={"lighting": ("day", "night"), "fog": ("thin", "thick")})
    words = {"lightings": ["night", "authored"], "fogs": ["thick", 80, "clear"]}
    assert planned(tmp_path, **words) == (("night", "authored"), ("thick", "mor80", "clear"))
    with pytest.raises(SetError, match=r"own\.usda: has the lightings day, night, .* asks for 'sky'"):
        planned(tmp_path, lightings=["sky"])


def test_a_name_that_no_stage_has_is_refused_before_anything_is_made(tmp_path):
    """With those that there are, and the one that was meant."""
    stage(tmp_path / "bare.usda")
    stage(tmp_path / "other.usda", sets={"lighting": ("day",), "fog": ("thick",)})
    for words, told in (
        ({"lightings": ["own"]}, r"lightings has 'own', .* they have authored, day\."),
        ({"lightings": ["autored"]}, r"lightings has 'autored', .* Did you mean 'authored'\?"),
        ({"fogs": ["hail3"]}, r"fogs has 'hail3': 'hail' is no medium"),
        ({"fogs": ["thik"]}, r"fogs has 'thik', .* authored, thick, and all take clear .* Did you mean 'thick'\?"),
    ):
        with pytest.raises(SetError, match=told):
            offers.with_offers(define_set(folder=tmp_path, scenes=2, stages=["*.usda"], **words))


def test_a_payload_of_the_root_may_hold_the_variants(tmp_path):
    """Payloads further down are not read, since they may be all of a city."""
    stage(tmp_path / "part.usda", sets={"lighting": ("day", "night")})
    (tmp_path / "whole.usda").write_text(
        '#usda 1.0\ndef Xform "World" (\n prepend payload = @part.usda@</World>\n)\n{\n}\n'
    )
    assert offers.of_stage(tmp_path / "whole.usda")["lighting"] == ["day", "night"]


@pytest.mark.slow
def test_a_set_of_stages_without_variants_is_made_as_authored(tmp_path):
    """By the command, from another folder than the stages': the word is the same in folders, manifest and index; a file
    that is no USD is set aside with its own error, and costs no other unit.
    """
    own, elsewhere = tmp_path / "own", tmp_path / "elsewhere"
    own.mkdir()
    elsewhere.mkdir()
    stage(own / "a.usda", fog=True)
    (own / "b.usda").write_text("#usda 1.0\ndef broken {")
    (own / "set.yaml").write_text(
        "synfog: set/1\nscenes: 2\nstages: ['*.usda']\nfogs: [clear, authored]\nsize: [24, 14]\n"
        "quality: {word: reference, samples: 2, model: single}\n"
    )
    told = run("dataset", "plan", own / "set.yaml", cwd=elsewhere)
    assert "2 in authored" in told.stdout and "4, as 4 pictures" in told.stdout
    done = run("dataset", "run", own / "set.yaml", "-o", "made", "--workers", "1", cwd=elsewhere)
    assert done.returncode == 1 and "b.usda: cannot be read as USD" in done.stderr
    assert "1 units made, 0 were there, 1 set aside" in done.stdout
    out = elsewhere / "made"
    found = [(one.scene, one.lighting, one.fog, one.mor_m) for one in index.pictures(out)]
    assert found == [(0, "authored", "clear", None), (0, "authored", "authored", pytest.approx(90.0))]
    assert (out / "scenes/000/000000/authored/authored/radiance.exr").is_file()
    assert "nothing wrong, 1 units are not made" in run("dataset", "verify", out).stdout
    assert not list(Path(own).glob("out*"))
