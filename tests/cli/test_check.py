"""`synfog-usd check` and `plugin-path` as a user runs them."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.stages import street

from synfog_usd.cli import check as verb
from synfog_usd.scene import Note
from synfog_usd.stage.rules import finding


def run(*arguments):
    return subprocess.run([sys.executable, "-m", "synfog_usd.cli.main", *map(str, arguments)], capture_output=True, text=True, timeout=120)


@pytest.fixture
def stage(tmp_path):
    """Write a street with some text changed."""

    def make(*changes):
        text = street(lamp=True)
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "street.usda"
        path.write_text(text, encoding="utf-8")
        return path

    return make


SMALL_CAR = ('["wall"]', '["car"]')  # the wall is 20 m wide: no car
CLOSE = ("float2 clippingRange = (0.1, 1000.0)", "float2 clippingRange = (230, 1000.0)")  # the fog ends 220 m ahead
BANK = """def Cube "Bank" (
        prepend apiSchemas = ["SynFogMediumAPI"]
    )
    {
        uniform token purpose = "guide"
        double3 xformOp:translate = (0, 220, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    """
CROSSING = ('def Mesh "Wall"', f'{BANK}def Mesh "Wall"')
BLIND = ('def Camera "Ego"', 'def Xform "Ego"')


@pytest.mark.parametrize("changes, strict, code, rules", [
    ((), False, 0, {}), ((SMALL_CAR,), False, 0, {"units": "/World/Wall"}), ((SMALL_CAR,), True, 1, {"units": "/World/Wall"}),
    ((CLOSE,), False, 2, {"fog-cut": "/World/Fog"}), ((CROSSING,), False, 2, {"fog-crosses": "/World/Fog"}), ((BLIND,), False, 2, {"no-camera": ""}),
    ((("float synfog:fog:albedo = 1.0", "float synfog:fog:albedo = 7"),), False, 2, {"refused": ""}),
])  # fmt: skip
def test_the_exit_code_is_that_of_the_gravest(stage, changes, strict, code, rules):
    """0 where a bake goes through, 1 for warnings under --strict, 2 where a bake would stop; JSON says the same."""
    found, notes = verb.look(stage(*changes))
    assert {one.rule: one.path for one in found if one.severity != "info"} == rules
    assert verb.exit_code(found, notes, strict=strict) == code
    told = json.loads(verb.as_json(Path("street.usda"), found, notes, code))
    assert (told["exit_code"], told["counts"]["error"] > 0) == (code, code == 2)
    text = verb.as_text(Path("street.usda"), found, notes)
    for one in found:
        assert f"[{one.rule}]" in text and all(f"    {tool}: {advice}" in text for tool, advice in one.mend.items())


def test_a_rule_is_explained_once_and_simplifications_are_counted():
    """Two findings of a rule, one explanation; ten notes of one text and a count are one line of the table."""
    found = [finding("label-unknown", f"/A{n}", "label") for n in range(2)]
    notes = [Note("warning", f"/N{n}", "is left out") for n in range(10)] + [
        Note("warning", "/N10", "is left out (and 4 more prims)"),
        Note("info", "", "frame 1"),
    ]
    text = verb.as_text(Path("s.usda"), found, notes)
    assert text.count("Blender:") == 1 and text.count("label-unknown") == 2
    rows = [line.split(maxsplit=2) for line in text.splitlines() if line.startswith(("warning  ", "info  "))]
    assert rows == [["warning", "15", "is left out (/N0)"], ["info", "1", "frame 1 (s.usda)"]]


def test_check_on_the_command_line(stage):
    path = stage(SMALL_CAR)
    done = run("check", path, "--json", "--strict")
    assert done.returncode == 1 and done.stderr == ""
    told = json.loads(done.stdout)
    assert (
        told["exit_code"] == 1
        and [one["rule"] for one in told["findings"]] == ["units"]
        and set(told["findings"][0]["mend"]) == {"Blender", "Houdini", "Omniverse"}
    )


def test_other_programs_learn_the_schema_by_the_printed_path():
    """A Python that has USD and not this package knows the schema, its defaults and its documentation."""
    folder = run("plugin-path", "--bare").stdout.strip()
    code = (
        "from pxr import Usd; found = Usd.SchemaRegistry().FindAppliedAPIPrimDefinition('SynFogMediumAPI'); "
        "print(found and found.GetAttributeFallbackValue('synfog:fog:mor'))"
    )
    known = [
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env={**os.environ, **more}).stdout.strip()
        for more in ({"PXR_PLUGINPATH_NAME": folder}, {})
    ]
    assert known == ["300.0", "None"]
    words = run("plugin-path").stdout
    assert all(name in words for name in ("usdview", "Houdini", "Omniverse", "Blender", folder))
    for line in words.splitlines():
        for word in line.split():
            if word.endswith(".py"):
                assert Path(word).is_file()
