"""What a set's file may say, and what its mistakes are told as."""

from fractions import Fraction
from pathlib import Path

import pytest
from support.stages import street

from synfog_usd.base.errors import SynfogError
from synfog_usd.dataset.sets.load import define_set, load_set, shipped
from synfog_usd.dataset.sets.scenes import scenes

SMALL = """\
synfog: set/1
scenes: 4
recipes: [tunnel]
fogs: [clear, 600]
"""


def written(folder, text, name="own.yaml"):
    path = folder / name
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    "name", [name if name in ("mini", "synfog") else pytest.param(name, marks=pytest.mark.slow) for name in shipped()]
)
def test_every_shipped_set_loads(name):
    """And its words make the same scenes in Python."""
    found = load_set(Path(name))
    again = define_set(found.name, folder=found.folder, **found.words)
    assert list(scenes(again, range(6))) == list(scenes(found, range(6)))
    assert again.words == found.words and found.about


def test_the_set_of_the_paper_has_its_numbers():
    """500 scenes in two lightings and four fogs, 450 and 50: 1350 training pairs a lighting."""
    found = list(scenes(load_set(Path("synfog"))))
    assert len(found) == 500 and sum(one.shots for one in found) == 4000
    train = [one for one in found if one.split.name == "train"]
    assert len(train) == 450 and sum(len(one.fogs) - 1 for one in train) == 1350
    assert all(one.fogs == ("clear", "mor600", "mor300", "mor150") for one in found)
    assert all(one.lightings == ("sky", "active") for one in found)


def test_a_set_extends_another_section_by_section(tmp_path):
    written(tmp_path, SMALL + "splits: {train: 3, test: 1}\n", "base.yaml")
    found = load_set(written(tmp_path, "synfog: set/1\nextends: base.yaml\nscenes: 8\nfogs: [150]\n"))
    assert found.scenes == 8 and [split.share for split in found.splits] == [Fraction(3), Fraction(1)]
    assert [one.fogs for one in scenes(found, [0])] == [("mor150",)]


def test_an_exposure_is_that_of_all_pipelines(tmp_path):
    """Seconds as photographers write them; each pipeline's sensor is asked."""
    found = load_set(written(tmp_path, SMALL + "exposure: {time: 1/500, ev: -1}\n"))
    assert found.exposure == {"exposure_s": 1 / 500, "ev": -1.0}
    for words, told in (
        ("{time: x}", r"own.yaml:\d+:\d+: exposure.time: --exposure x: it takes seconds"),
        ("{time: 1/500, iso: 100, ev: 1}", r"exposure: --ev 1: .* leave nothing to the meter"),
        ("{iso: 7}", r"pipelines: --iso 7: the sensor \w+ takes"),
        ("{speed: 7}", r"exposure has no 'speed'; it takes time, iso, ev"),
    ):
        with pytest.raises(SynfogError, match=told):
            load_set(written(tmp_path, SMALL + f"exposure: {words}\n"))


def test_paths_start_from_the_file_that_names_them(tmp_path):
    """Also where that file is extended by one elsewhere, and where its words are used again from another folder."""
    (tmp_path / "base" / "worlds").mkdir(parents=True)
    for number in range(3):
        (tmp_path / "base" / "worlds" / f"{number}.usda").write_text(street())
    written(tmp_path / "base", "synfog: set/1\nscenes: 3\nstages: [worlds/*.usda]\n")
    (tmp_path / "other").mkdir()
    found = load_set(written(tmp_path / "other", "synfog: set/1\nextends: ../base/own.yaml\n"))
    again = define_set(found.name, folder=found.folder, **found.words)
    expected = [(tmp_path / "base" / "worlds" / f"{number}.usda").resolve() for number in range(3)]
    assert [one.stage for one in scenes(found)] == [one.stage for one in scenes(again)] == expected


@pytest.mark.parametrize(
    "text, told",
    [
        ("scenes: 0\nrecipes: [tunnel]", r"own.yaml:2:9: scenes 0 is outside 1 to 1e\+06"),
        ("scenes: 4\nrecipes: [tunel]", r"own.yaml:3:11: recipes has no 'tunel'.* Did you mean 'tunnel'\?"),
        ("scenes: 4\nrecipes: {tunnel: .nan}", r"own.yaml:3:19: recipes: the share of 'tunnel' is nan"),
        ("scenes: 4\nstages: ['none/*.usda']", r"own.yaml:3:10: stages: 'none/\*.usda' matches no USD file"),
        (
            "scenes: 4\nrecipes: [tunnel]\npipelines: [staggered_hdr]",
            r"own.yaml:4:13: pipelines: staggered_hdr does not take radiance alone",
        ),
        (
            "scenes: 4\nrecipes: [tunnel]\nfogs: [300]\npipelines: [phone, noise_free]",
            r"own.yaml:5:12: pipelines after the first are metered on the clear frame",
        ),
        (
            "scenes: 4\nrecipes: [tunnel]\nsplits: {test: {models: [bus]}}",
            r"own.yaml:4:16: splits: test has no 'share'",
        ),
        (
            "scenes: 4\nrecipes: [tunnel]\nsplits: {a: 1, b: {share: 1, models: [bos]}}",
            r"own.yaml:4:9: splits: b: no model 'bos' ships. Did you mean 'bus'\?",
        ),
        ("extends: own.yaml", r"own.yaml:2:10: more than 8 files extend each other"),
    ],
)
def test_a_mistake_is_one_line_with_its_place(tmp_path, text, told):
    with pytest.raises(SynfogError, match=told) as problem:
        load_set(written(tmp_path, f"synfog: set/1\n{text}\n"))
    assert "\n" not in str(problem.value) and problem.value.exit_code == 2


def test_python_says_the_same_of_the_same_mistake():
    with pytest.raises(SynfogError, match=r"^fogs\[1\]: fogs 5 is outside 10 to 20000"):
        define_set(scenes=4, recipes=["tunnel"], fogs=["clear", 5])


def test_a_stage_is_no_two_scenes(tmp_path):
    """More scenes than stages is refused, counted split by split."""
    for number in range(4):
        (tmp_path / f"{number}.usda").write_text(street())
    text = "synfog: set/1\nscenes: {}\nstages: ['*.usda']\nsplits: {{train: 3, test: 1}}\n"
    found = list(scenes(load_set(written(tmp_path, text.format(4)))))
    assert len({one.stage for one in found}) == 4
    with pytest.raises(SynfogError, match=r"4 scenes of the split 'train' are to come from .* which has 3 stages"):
        load_set(written(tmp_path, text.format(5)))
