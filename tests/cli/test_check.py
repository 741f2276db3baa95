"""`synfog-usd check` and `plugin-path` as a user runs them."""

import json
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from support.cli import command, process, run
from support.stages import street

from synfog_usd.camera.profiles import shipped
from synfog_usd.dataset import check as verb


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


@pytest.mark.parametrize(
    "changes, strict, code, rules",
    [
        ((), False, 0, {}),
        ((SMALL_CAR,), False, 0, {"units": "/World/Wall"}),
        ((SMALL_CAR,), True, 1, {"units": "/World/Wall"}),
        ((CLOSE,), False, 2, {"fog-cut": "/World/Fog"}),
        ((CROSSING,), False, 2, {"fog-crosses": "/World/Fog"}),
        ((BLIND,), False, 2, {"no-camera": ""}),
    ],
)
def test_the_exit_code_is_that_of_the_gravest(stage, changes, strict, code, rules):
    """0 where a bake goes through, 1 for warnings under --strict, 2 where a bake would stop; JSON says the same."""
    found, notes, _ = verb.look(stage(*changes))
    assert {one.rule: one.path for one in found if one.severity != "info"} == rules
    assert verb.exit_code(found, notes, strict=strict) == code
    told = json.loads(verb.as_json(Path("street.usda"), found, notes, code))
    assert (told["exit_code"], told["counts"]["error"] > 0) == (code, code == 2)
    text = verb.as_text(Path("street.usda"), found, notes)
    for one in found:
        assert f"[{one.rule}]" in text and all(f"    {tool}: {advice}" in text for tool, advice in one.mend.items())


def test_check_on_the_command_line(stage):
    """The child's exit code and JSON are the parent's, and nothing is told beside."""
    path = stage(SMALL_CAR)
    done = process("check", path, "--json", "--strict")
    assert done.returncode == 1 and done.stderr == ""
    told = json.loads(done.stdout)
    assert (
        told["exit_code"] == 1
        and [one["rule"] for one in told["findings"]] == ["units"]
        and set(told["findings"][0]["mend"]) == {"Blender", "Houdini", "Omniverse"}
    )


def test_a_stage_is_checked_as_it_would_be_baked(stage):
    """A wall labelled as a car, 20 m wide: in a tenth of the unit it is 2 m and no fault. Nonsense is refused."""
    path = stage(SMALL_CAR)
    assert "units" in {one.rule for one in verb.look(path)[0]}
    assert "units" not in {one.rule for one in verb.look(path, metres_per_unit=0.1)[0]}
    assert verb.look(path, choices=["/World:fog=clear"])  # a choice that there is
    done = process("check", path, "--choose", "/World:fog=none")
    assert done.returncode == 2 and "variant set 'fog' of /World has" in done.stderr
    assert len(done.stderr.splitlines()) == 1, done.stderr


def test_the_extension_is_packed_whole_and_alike(tmp_path):
    """Two packings are the same bytes: the manifest with its version, and the module; another suffix is refused."""
    for name in ("a.zip", "b.zip"):
        assert run("plugin-path", "--blender", tmp_path / name).returncode == 0
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()
    with zipfile.ZipFile(tmp_path / "a.zip") as archive:
        manifest = dict(
            re.findall(r"""^(\w+) = "(.*)"$""", archive.read("blender_manifest.toml").decode(), re.MULTILINE)
        )
        for name in archive.namelist():
            if name.endswith(".py"):
                compile(archive.read(name), name, "exec")
        sensors = json.loads(archive.read("sensors.json"))
    phone = sensors["imx363"]  # 4032 x 3024 pixels of 1.4 um behind 4.38 mm and f/1.73
    assert [phone[name] for name in ("sensor_width_mm", "sensor_height_mm", "focal_length_mm", "f_number")] == [
        5.6448,
        4.2336,
        4.38,
        1.73,
    ]
    assert set(sensors) == set(shipped("sensors")) and all(one["width_px"] > 0 for one in sensors.values())
    assert {one.date_time for one in archive.infolist()} == {(2026, 1, 1, 0, 0, 0)}  # not when it was packed
    assert (manifest["id"], manifest["type"], manifest["schema_version"]) == (
        "synfog_fog",
        "add-on",
        "1.0.0",
    ) and manifest["blender_version_min"] == "4.2.0"
    wrong = run("plugin-path", "--blender", tmp_path / "a.py")
    assert wrong.returncode == 2 and wrong.stderr.count("\n") == 1


def test_other_programs_learn_the_schema_by_the_printed_path():
    """A Python that has USD and not this package knows the schema, its defaults and its documentation."""
    folder = run("plugin-path", "--bare").stdout.strip()
    code = (
        "from pxr import Usd; found = Usd.SchemaRegistry().FindAppliedAPIPrimDefinition('SynFogMediumAPI'); "
        "print(found and found.GetAttributeFallbackValue('synfog:fog:mor'))"
    )
    known = [
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, env={**os.environ, **more}
        ).stdout.strip()
        for more in ({"PXR_PLUGINPATH_NAME": folder}, {})
    ]
    assert known == ["300.0", "None"]
    words = run("plugin-path").stdout
    assert all(name in words for name in ("usdview", "Houdini", "Omniverse", "Blender", folder))
    for line in words.splitlines():
        for word in line.split():
            if word.endswith(".py"):
                assert Path(word).is_file()


def test_every_variant_is_looked_at_and_clear_air_is_no_fault(stage):
    """Clear air is the chosen variant, so that the stage as it stands has no fog; a lamp that only 'active' has is far
    too bright.
    """
    lamp = """over "Sky"
            {
                float inputs:exposure = -5
            }
            def SphereLight "Beacon"
            {
                float inputs:intensity = 1e12
            }"""
    sky = """over "Sky"
            {
                float inputs:exposure = -5
            }"""
    found, *_ = verb.look(stage(('string fog = "mor150"', 'string fog = "clear"'), (sky, lamp)))
    assert {(one.rule, one.path) for one in found} == {("light-bright", "/World/Beacon")}


def test_a_camera_outside_of_its_fog_is_found_whatever_variant_is_chosen(stage):
    """The camera far behind the box, with clear air chosen; with a bank ahead of it and a box around both, nothing is
    found.
    """
    clear = ('string fog = "mor150"', 'string fog = "clear"')
    away = (
        "float xformOp:rotateX = 90\n",
        "float xformOp:rotateX = 90\n        double3 xformOp:translate = (0, -900, 0)\n",
    )
    order = ('["xformOp:rotateX"]', '["xformOp:translate", "xformOp:rotateX"]')
    found, *_ = verb.look(stage(clear, away, order))
    assert {(one.rule, one.path) for one in found} == {("camera-outside-fog", "/World/Ego")}
    ahead = CROSSING[1].replace("(0, 220, 0)", "(0, 20, 0)")
    assert verb.look(stage(clear, (CROSSING[0], ahead)))[0] == []


def test_what_stands_in_a_prototype_is_told_at_an_instance(tmp_path):
    """USD numbers its prototypes as it likes; an author knows the instances only."""
    path = tmp_path / "kit.usda"
    placed = "".join(
        f'def Xform "{name}" (\n    instanceable = true\n    references = </Kit>\n)\n{{\n}}\n'
        for name in ("Zoe", "Ann")
    )
    head = '#usda 1.0\n(\n    defaultPrim = "Kit"\n    upAxis = "Z"\n    metersPerUnit = 1\n)\ndef Camera "Ego"\n{\n}\n'
    path.write_text(
        head
        + 'class "Kit"\n{\n    def Mesh "Empty"\n    {\n    }\n    def NurbsPatch "Patch"\n    {\n    }\n}\n'
        + placed
    )
    found, notes, _ = verb.look(path)
    assert {one.path for one in found if one.rule == "unlabelled"} == {"/Ann/Empty"}
    assert "/Ann/Patch" in {note.path for note in notes} and not [note for note in notes if "Prototype" in note.path]


def test_a_missing_file_is_told_once_where_it_is_named(stage):
    """A texture at its attribute, a reference as what does not compose; and not once more by USD's validators."""
    found, *_ = verb.look(
        stage(
            (
                "float inputs:intensity = 1000.0",
                "float inputs:intensity = 1000.0\n        asset inputs:texture:file = @./gone.exr@",
            )
        )
    )
    told = [one for one in found if "gone.exr" in one.text]
    assert [(one.path, one.severity) for one in told] == [("/World/Sky.inputs:texture:file", "warning")]
    found, *_ = verb.look(stage(('def Mesh "Wall" (\n', 'def Mesh "Wall" (\n        references = @./gone.usda@\n')))
    assert [(one.rule, one.path) for one in found if "gone.usda" in one.text] == [("composition", "/World/Wall")]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="only Linux has a device that is always full")
@pytest.mark.parametrize("verb, unbuffered", [("check", False), ("info", True)])
def test_what_cannot_be_printed_is_one_line_and_no_success(verb, unbuffered, tmp_path):
    """Of a child, which ends by itself, and without one; where each line is written at once, as containers ask Python
    to, and where all are at the end.
    """
    (tmp_path / "street.usda").write_text(street())
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    environment |= {"PYTHONUNBUFFERED": "1"} if unbuffered else {}
    words = (verb, tmp_path / "street.usda") if verb == "check" else (verb,)
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(command(*words), stdout=full, stderr=subprocess.PIPE, text=True, env=environment)
    assert done.returncode == 2 and "could not be written" in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("node, told", [("ND_standard_surface_surfaceshader", False), ("ND_no_such_node", True)])
def test_a_shader_that_usd_has_not_and_we_draw_is_no_finding(tmp_path, node, told):
    stage = tmp_path / "a.usda"
    stage.write_text(
        f"""#usda 1.0
def Camera "Eye"
{{
}}
def Material "Paint"
{{
    token outputs:surface.connect = </Paint/Surface.outputs:surface>
    def Shader "Surface"
    {{
        uniform token info:id = "{node}"
        token outputs:surface
    }}
}}
""",
        encoding="utf-8",
    )
    assert ("MissingShaderIdInRegistry" in run("check", stage).stdout) == told
