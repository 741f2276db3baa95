"""What a bake will make, before anything is opened."""

from pathlib import Path

import pytest

from synfog_usd.base.errors import ParameterError
from synfog_usd.dataset.plan import AS_AUTHORED, BakePlan, Sampling, Shot, shots
from synfog_usd.fog import Fog

OFFERED = {"fog": ("clear", "mor600", "mor150"), "lighting": ("sky", "active")}


def planned(variants=OFFERED, **asked):
    return shots(BakePlan(Path("street.usda"), Path("out"), **asked), variants)


def test_all_lightings_in_all_fogs_unless_asked():
    """Lightings outside, fogs inside, in the stage's order; a variant is selected and brings its own visibility."""
    found = planned()
    assert [shot.folder for shot in found] == [
        "sky/clear",
        "sky/mor600",
        "sky/mor150",
        "active/clear",
        "active/mor600",
        "active/mor150",
    ]
    assert all(
        (shot.lighting_variant, shot.fog_variant, shot.fog_override) == (shot.lighting, shot.fog, None)
        for shot in found
    )


def test_a_million_shots_are_made_only_where_they_are_named():
    """A thousand lightings in a thousand fogs, or in one that is named; the refusal says how many and what to type."""
    names = tuple(f"n{index}" for index in range(1001))
    for asked in ({}, {"fog": ("clear",)}, {"lighting": ("n7",)}):
        with pytest.raises(ParameterError, match=r"(1002001|1001) shots, .* as in --lighting n[07] --fog (n0|clear)"):
            planned({"fog": names, "lighting": names}, **asked)
    with pytest.raises(ParameterError, match=r"as in --lighting authored --fog n0$"):
        planned({"fog": names})
    assert len(planned({"fog": names, "lighting": ("sky",)}, fog=names, lighting=("sky",))) == 1001
    assert len(planned({"fog": names[:1000]})) == 1000


def test_what_is_asked_for_comes_once_and_in_the_asked_order():
    found = planned(lighting=("active",), fog=("mor150", "clear", "mor150"))
    assert [shot.folder for shot in found] == ["active/mor150", "active/clear"]


@pytest.mark.parametrize("name, metres", [("mor75.5", 75.5), ("mor600", None)])
def test_any_visibility_can_be_asked_for_by_its_metres(name, metres):
    """A name that the stage has is its variant; another mor<metres> replaces the visibility and leaves the stage's own
    fog selected.
    """
    (shot,) = planned(lighting=("sky",), fog=(name,))
    assert (
        (shot.fog, shot.fog_variant, shot.fog_override) == (name, None, Fog(metres)) if metres else (name, name, None)
    )


def test_clear_air_needs_no_variant():
    """Infinite visibility where the stage has no variant of that name; the variant where it has one."""
    (bare,) = planned({}, fog=("clear",))
    assert bare.fog_variant is None and bare.fog_override.clear and bare.folder == "authored/clear"
    (variant,) = planned(fog=("clear",), lighting=("sky",))
    assert variant.fog_variant == "clear" and variant.fog_override is None


@pytest.mark.parametrize("name", ["mor0", "mor15O", "fog", "morinf"])
def test_a_fog_that_nobody_knows_is_refused(name):
    """The message names it, what the stage offers, and what any stage takes."""
    with pytest.raises(ParameterError) as refusal:
        planned(fog=(name,))
    for word in (f"--fog {name}", "clear, mor600, mor150", "mor<metres>"):
        assert word in str(refusal.value)


def test_the_likely_name_is_told():
    with pytest.raises(ParameterError, match="Did you mean 'mor150'"):
        planned(fog=("mor15O",))
    with pytest.raises(ParameterError, match="Did you mean 'active'"):
        planned(lighting=("aktive",))


def test_a_lighting_must_be_a_variant_or_the_stage_as_it_is():
    """A stage without the set says so, and what it takes instead."""
    with pytest.raises(ParameterError) as refusal:
        planned({"fog": ("clear",)}, lighting=("clear",))
    assert "no variant set 'lighting'; it also takes authored" in str(refusal.value)
    assert "mor<metres>" not in str(refusal.value)


@pytest.mark.parametrize("offered", [{}, {"lighting": ("day", "night"), "fog": ("dense",)}, OFFERED])
def test_what_a_stage_has_without_a_choice_is_called_authored(offered):
    """Any stage takes the name, for light and fog alike, and no variant is chosen; beside it variants can be named."""
    (shot,) = planned(offered, lighting=(AS_AUTHORED,), fog=(AS_AUTHORED,))
    assert shot == Shot("authored", "authored", None, None, None)
    if offered:
        last = offered["lighting"][-1]
        assert [shot.lighting_variant for shot in planned(offered, lighting=(AS_AUTHORED, last), fog=("mor77",))] == [
            None,
            last,
        ]


def test_a_quality_is_a_word_and_decides_what_is_left_open():
    """Samples are its own unless they are said, and the reference is not clean; another word is refused with a hint."""
    plan = Sampling()
    assert (plan.quality, plan.samples, plan.promise.clean) == ("standard", 64, True)
    truth = Sampling(quality="reference", samples=8)
    assert (truth.samples, truth.promise.clean) == (8, False)
    with pytest.raises(ParameterError, match=r"^--quality standart: .* Did you mean 'standard'\?$"):
        Sampling(quality="standart")
    with pytest.raises(ParameterError, match=r"^--quality None: not known; it takes draft, standard, "):
        Sampling(quality=None)
