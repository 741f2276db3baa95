"""The menu for usdview and what is pasted into Houdini and Omniverse, without these programs.

usd-core has no usdview: its module is loaded by USD's own plugin registry, and given a registry, a menu and an
application interface with the calls that usdview documents (pxr/usdImaging/usdviewq/plugin.py, usdviewApi.py).
That usdview shows the menu is not tested.
"""

import json
import os
import subprocess
import sys
import textwrap
import types
from pathlib import Path

import pytest
from pxr import Usd, UsdGeom
from support.stages import street

from synfog_usd.stage import open_stage
from synfog_usd.translate import translate

TOOLS = Path(__file__).resolve().parents[2] / "integrations"


def test_usd_finds_and_loads_the_plugin():
    """By the folder alone, as usdview does it; the container's type is declared with usdview's as base."""
    code = """
    import sys
    from pxr import Plug, Tf
    Plug.Registry().RegisterPlugins(sys.argv[1])
    plugin = Plug.Registry().GetPluginWithName("synfog_usdview")
    assert plugin and plugin.Load() and plugin.isPythonModule
    import synfog_usdview
    assert hasattr(synfog_usdview.SynfogContainer, "registerPlugins")
    found = Tf.Type.FindByName("synfog_usdview.SynfogContainer")
    print([base.typeName for base in found.baseTypes])
    """
    folder = TOOLS / "usdview"
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code), folder],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])},
    )
    assert done.returncode == 0, done.stderr
    assert "pxr.Usdviewq.plugin.PluginContainer" in done.stdout


@pytest.fixture
def plugin(monkeypatch):
    monkeypatch.syspath_prepend(str(TOOLS / "usdview"))
    import synfog_usdview

    return synfog_usdview


class Application:
    """What the menu asks of usdview."""

    def __init__(self, stage, camera=None, frame=None):
        self.stage, self.frame = stage, frame or Usd.TimeCode.Default()
        self.cameraPrim = stage.GetPrimAtPath(camera) if camera else None
        self.dataModel = types.SimpleNamespace(viewSettings=types.SimpleNamespace(displayGuide=False))
        self.status, self.chosen, self.commands, self.menus = [], [], {}, {}

    def PrintStatus(self, text):
        self.status.append(text)

    def ClearPrimSelection(self):
        self.chosen.clear()

    def AddPrimToSelection(self, prim):
        self.chosen.append(str(prim.GetPath()))

    def registerCommandPlugin(self, name, title, callback, description=""):
        assert name not in self.commands
        self.commands[name] = callback
        return name

    def findOrCreateMenu(self, name):
        return types.SimpleNamespace(addItem=self.menus.setdefault(name, []).append)


@pytest.fixture
def stage(tmp_path):
    path = tmp_path / "street.usda"
    path.write_text(street(lamp=True), encoding="utf-8")
    return Usd.Stage.Open(str(path))


def menu(plugin, usdview):
    """The commands that the container registers, by their last name."""
    container = plugin.SynfogContainer()
    container.registerPlugins(usdview, usdview)
    container.configureView(usdview, usdview)
    assert usdview.menus == {"Synfog": list(usdview.commands)}
    return {name.rpartition(".")[2]: work for name, work in usdview.commands.items()}


def test_boxes_of_fog_are_shown_where_they_are(plugin, stage):
    """Guides are switched on and off, the box is selected and faint on the session layer."""
    usdview = Application(stage)
    fog = menu(plugin, usdview)["fog"]
    target, before = stage.GetEditTarget(), stage.GetRootLayer().ExportToString()
    fog(usdview)
    assert usdview.dataModel.viewSettings.displayGuide and usdview.chosen == ["/World/Fog"]
    box = UsdGeom.Gprim(stage.GetPrimAtPath("/World/Fog"))
    assert list(box.GetDisplayOpacityAttr().Get()) == pytest.approx([0.2]) and box.ComputePurpose() == "guide"
    assert stage.GetRootLayer().ExportToString() == before and stage.GetEditTarget() == target
    fog(usdview)
    assert not usdview.dataModel.viewSettings.displayGuide


def test_the_command_line_has_camera_frame_and_chosen_variants(plugin, stage):
    """Fog and lighting as they are chosen, another set by --choose where usdview chose it."""
    wall = stage.GetPrimAtPath("/World/Wall")
    with Usd.EditContext(stage, stage.GetRootLayer()):
        wall.GetVariantSets().AddVariantSet("paint").AddVariant("red")
    with Usd.EditContext(stage, stage.GetSessionLayer()):
        wall.GetVariantSet("paint").SetVariantSelection("red")
        stage.GetPrimAtPath("/World").GetVariantSet("fog").SetVariantSelection("mor600")
    line = plugin.words("bake", stage, "/World/Ego", Usd.TimeCode(12))
    assert line[:4] == ["bake", stage.GetRootLayer().realPath, "--camera", "/World/Ego"]
    assert line[6:] == ["--frames", "12", "--fog", "mor600", "--lighting", "sky", "--choose=/World/Wall:paint=red"]


@pytest.mark.parametrize("what", ["no tool", "no file", "no camera"])
def test_what_cannot_be_drawn_is_told_as_status(plugin, stage, monkeypatch, what):
    """One line, and no process."""
    monkeypatch.setenv("SYNFOG_USD", "no-such-command" if what == "no tool" else sys.executable)
    usdview = Application(Usd.Stage.CreateInMemory() if what == "no file" else stage, None)
    menu(plugin, usdview)["bake"](usdview)
    (told,) = usdview.status
    assert {"no tool": "SYNFOG_USD", "no file": "save it first", "no camera": "look through a camera"}[what] in told


@pytest.mark.slow
def test_the_menu_draws_what_the_camera_sees(plugin, stage, tmp_path, monkeypatch):
    """The command that a user has: a preview of the chosen variants, and unsaved changes are told."""
    tool = tmp_path / "synfog-usd"
    tool.write_text(f'#!/bin/sh\nexec {sys.executable} -m synfog_usd.cli.main "$@" --resolution 32x18 --samples 2\n')
    tool.chmod(0o755)
    monkeypatch.setenv("SYNFOG_USD", str(tool))
    stage.GetPrimAtPath("/World/Lamp").GetAttribute("inputs:radius").Set(0.7)
    usdview = Application(stage, "/World/Ego")
    child = plugin.draw("preview", usdview)
    assert child.wait(120) == 0 and "without the changes of street.usda" in usdview.status[0]
    manifest = json.loads((tmp_path / "synfog" / "street_preview" / "bake.json").read_text())
    assert [(row["lighting"], row["fog"], row["camera"]) for row in manifest["shots"]] == [
        ("sky", "mor150", "/World/Ego")
    ]


@pytest.mark.parametrize("up, metres", [("Z", 1.0), ("Y", 0.01)])
def test_what_is_pasted_puts_fog_around_everything(tmp_path, monkeypatch, up, metres):
    """In each program by the call that its manual names for its stage: 20 m around wall and camera, 1 m below, of the
    visibility that was asked for, whatever unit and up axis.
    """
    text = street(up=up, meters_per_unit=metres)
    path = tmp_path / "street.usda"
    path.write_text(text.replace('def Cube "Fog"', 'over "Fog"').replace('["fog", "lighting"]', '["lighting"]'))
    snippet = (TOOLS / "fog_box.py").read_text(encoding="utf-8")
    layers = []
    for program in ("hou", "omni", "usdview"):
        stage = Usd.Stage.Open(str(path))
        stage.GetRootLayer().Reload(force=True)
        here = {"__name__": "__main__"}
        node = types.SimpleNamespace(editableStage=lambda stage=stage: stage)
        context = types.SimpleNamespace(get_stage=lambda stage=stage: stage)
        known = {"hou": {"hou": types.SimpleNamespace(pwd=lambda node=node: node)}}
        usd = types.SimpleNamespace(get_context=lambda context=context: context)
        known["omni"] = {"hou": None, "omni": types.SimpleNamespace(usd=usd), "omni.usd": usd}
        for name, module in known.get(program, {}).items():
            monkeypatch.setitem(sys.modules, name, module)
        if program == "usdview":
            here["usdviewApi"] = types.SimpleNamespace(stage=stage)
        exec(compile(snippet, "pasted", "exec"), here)
        layers.append(stage.GetRootLayer().ExportToString())
    assert layers[0] == layers[1] == layers[2]
    (tmp_path / "foggy.usda").write_text(layers[0], encoding="utf-8")
    scene = translate(open_stage(tmp_path / "foggy.usda"))
    (fog,) = scene.fog
    assert fog.medium.visibility_m == pytest.approx(150.0)
    corners = fog.boundary.surface_points() + scene.origin_m
    plain = translate(open_stage(path))
    wall = next(part["positions"] for part in plain.world.values() if isinstance(part, dict) and "positions" in part)
    points = [*(wall + plain.origin_m), plain.camera.to_world[:3, 3] + plain.origin_m]
    assert list(corners.max(axis=0)) == pytest.approx([max(one[k] for one in points) + 20 for k in range(3)], rel=1e-4)
    low = [min(one[k] for one in points) for k in range(3)]
    assert list(corners.min(axis=0)) == pytest.approx([low[0] - 20, low[1] - 20, low[2] - 1], rel=1e-4)
