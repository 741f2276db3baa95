"""Run by Blender's Python: the extension is installed, and the scene lit, seen, checked and baked by it; what came of
it and what its panel then showed, as JSON on the last line.  Arguments: its .zip, a folder to write to, the command.
"""

import importlib
import json
import subprocess
import sys
from pathlib import Path


def bake(file, out, tool):
    import bpy

    addon_utils = importlib.import_module("addon_utils")  # which is there after bpy

    told = {"version": bpy.app.version_string}
    bpy.ops.wm.read_factory_settings(use_empty=True)
    addon_utils.enable("bl_pkg")
    bpy.ops.extensions.package_install_files(filepath=file, repo="user_default", enable_on_install=True)
    module = "bl_ext.user_default.synfog_fog"
    bpy.context.preferences.addons[module].preferences.command = tool
    baking, panel = (importlib.import_module(f"{module}.{name}") for name in ("baking", "panel"))

    def box(name, at, size):
        bpy.ops.mesh.primitive_cube_add(size=1.0, location=at, scale=size)
        bpy.context.active_object.name = name

    box("Red Car.001", (1, 20, 0.75), (2, 4, 1.5))
    bpy.ops.synfog.label(label="car")
    box("Road", (0, 40, -0.5), (20, 120, 1))
    bpy.ops.synfog.label(label="road")
    bpy.ops.object.camera_add(location=(0, 0, 1.5), rotation=(1.5707963, 0, 0))
    eye = bpy.context.active_object
    eye.name, bpy.context.scene.camera = "Ego", eye
    bpy.ops.synfog.add_fog(mor=120.0)

    told["cameras"] = {}
    for name in importlib.import_module(f"{module}.presets").sensors():
        bpy.ops.synfog.camera(sensor=name)
        stage = Path(out) / f"camera_{name}.usda"
        bpy.ops.wm.usd_export(filepath=str(stage))
        told["cameras"][name] = [str(stage), eye.data.dof.aperture_fstop]
    told["lights"] = {}
    for name in ("noon", "overcast", "dusk", "night"):
        bpy.ops.synfog.light(preset=name)
        told["lights"][name] = str(Path(out) / f"light_{name}.usda")
        bpy.ops.wm.usd_export(filepath=told["lights"][name])

    bpy.ops.synfog.light(preset="dusk")
    bpy.ops.synfog.camera(sensor="mt9v024")
    bpy.ops.synfog.bake(percentage=5, samples=2)
    told["dusk"] = said(bpy)
    bpy.ops.synfog.light(preset="overcast")
    bpy.ops.wm.save_as_mainfile(filepath=str(Path(out) / "scene.blend"))
    told["label"] = label(bpy)
    told["check"] = [list(bpy.ops.synfog.check()), said(bpy)]
    baking.SYNFOG_OT_bake.process = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    bpy.context.window_manager.synfog_done, bpy.context.window_manager.synfog_doing = 0.42, "rendering, 7 s"
    told["while baking"] = [drawn(bpy, panel), bpy.ops.synfog.bake.poll(), bpy.ops.synfog.check.poll()]
    told["stop"] = [list(bpy.ops.synfog.stop()), baking.SYNFOG_OT_bake.process.wait(20) != 0]
    told["may bake"] = bpy.ops.synfog.bake.poll()
    told["bake"] = list(bpy.ops.synfog.bake(percentage=5, samples=2))
    told["images"] = {image.name: list(image.size) for image in bpy.data.images if image.name.startswith("Synfog")}
    shown = [
        area.spaces.active.image
        for window in bpy.context.window_manager.windows
        for area in window.screen.areas
        if area.type == "IMAGE_EDITOR"
    ]
    told["after"] = said(bpy)
    told["shown"] = [image.name for image in shown if image]
    told["progress"] = bool(baking.PROGRESS.match(" 11%  sky/clear: translating  29 s, about 238 s left"))

    bpy.data.objects["Red Car.001"].scale = (5, 5, 5)  # a car of 20 m
    told["faults"] = []
    bpy.ops.synfog.check()
    told["faults"].append([selected(bpy), said(bpy)])
    bpy.data.objects["Red Car.001"].scale = (1, 1, 1)
    bpy.ops.synfog.add_fog(mor=50.0)
    bank = bpy.context.active_object
    bank.name, bank.dimensions = "Bank", (10, 10, 100)  # cuts through the first box
    bpy.ops.object.select_all(action="DESELECT")
    try:
        bpy.ops.synfog.bake(percentage=5, samples=2)
    except RuntimeError as error:
        told["faults"].append([selected(bpy), str(error)])
    print("\n" + json.dumps(told))


def said(bpy):
    """Severities, objects and texts in the panel."""
    return [
        [one["severity"], one["objects"], one["text"]] for one in json.loads(bpy.context.window_manager.synfog_told)
    ]


def label(bpy):
    """Labels after all is labelled as a bus, and as before again; whether a box of fog alone can be."""
    labels = {thing.name: thing.get("cityscapes") for thing in bpy.data.objects}
    bpy.ops.object.select_all(action="SELECT")
    bpy.ops.synfog.label(label="bus")
    found = {thing.name: thing.get("cityscapes") for thing in bpy.data.objects}
    for thing in bpy.data.objects:
        if labels[thing.name] is not None:
            thing["cityscapes"] = labels[thing.name]
        elif "cityscapes" in thing.keys():  # noqa: SIM118
            del thing["cityscapes"]
    bpy.ops.synfog.select(name="Fog")
    return [found, bpy.ops.synfog.label.poll()]


def drawn(bpy, panel):
    """What the panel shows, from top to bottom: texts, else names of operators and properties."""
    shown = []

    class Layout:
        def __getattr__(self, kind):
            def put(*what, text=None, **more):
                if kind not in ("row", "column", "box"):
                    shown.append([kind, what[-1] if text is None else text])
                return Layout()

            return put

    panel.draw_all(bpy.context, Layout())
    return shown


def selected(bpy):
    return sorted(thing.name for thing in bpy.context.selected_objects)


if __name__ == "__main__":
    bake(*sys.argv[1:])
