"""What is pasted into Houdini and Omniverse, without these programs."""

import sys
import types
from pathlib import Path

import pytest
from pxr import Usd
from support.stages import street

from synfog_usd.stage import open_stage
from synfog_usd.translate import translate

TOOLS = Path(__file__).resolve().parents[2] / "integrations"


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
