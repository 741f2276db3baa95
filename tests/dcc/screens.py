"""Draws the add-on's screens in docs/images, in a Blender that has windows; where there is no screen, in Xvfb:

    export SYNFOG_USD=$PWD/.venv/bin/synfog-usd BLENDER_USER_RESOURCES=$(mktemp -d) LIBGL_ALWAYS_SOFTWARE=1
    xvfb-run -s "-screen 0 1280x800x24" blender --factory-startup --window-geometry 0 0 1280 800 \
        --python tests/dcc/screens.py -- docs/images

It needs ImageMagick's `import`: by software GL Blender's own screenshots are black.  A Blender without USD, as
Debian's, leaves import and export to the Python that SYNFOG_BPY names, with a bpy of the same version.  Takes three
minutes.  Bakes that are stopped are tried too; Blender must not print a traceback.
"""

import importlib
import math
import os
import subprocess
import sys
import tempfile
import traceback
from pathlib import Path

import bpy

ROOT = Path(__file__).resolve().parents[2]
ADD_ON = "bl_ext.user_default.synfog_fog"

MODELS = (
    ("house_cream", (-8.7, 14, 0), -90, "building"),
    ("house_brick", (-8.7, 29, 0), -90, "building"),
    ("house_grey", (-8.7, 43.5, 0), -90, "building"),
    ("house_rose", (8.7, 14, 0), 90, "building"),
    ("house_ochre", (8.7, 25, 0), 90, "building"),
    ("church", (13, 48, 0), 90, "building"),
    ("taxi", (1.75, 16, 0), 0, "car"),
    ("saloon", (-1.75, 26, 0), 180, "car"),
    ("bus", (-1.75, 44, 0), 180, "bus"),
    ("van", (1.75, 34, 0), 0, "truck"),
    ("woman_walking", (5.2, 13, 0.12), 0, "person"),
    ("cyclist", (3.1, 24, 0), 0, "rider"),
    ("lime_tree", (-5.6, 21, 0.12), 0, "vegetation"),
    ("lime_tree", (5.9, 27, 0.12), 40, "vegetation"),
    ("street_lamp", (5.2, 20, 0.12), 90, "pole"),
    ("street_lamp", (-5.2, 36, 0.12), -90, "pole"),
)
"""Models of the library, where each stands and how it is turned [degrees], and its label."""

SLABS = (
    ("Road", 0, 8, 0.0, (0.06, 0.06, 0.065), "road"),
    ("Pavement left", -5.75, 3.5, 0.12, (0.25, 0.24, 0.22), "sidewalk"),
    ("Pavement right", 5.75, 3.5, 0.12, (0.25, 0.24, 0.22), "sidewalk"),
    ("Ground left", -27.5, 40, 0.0, (0.08, 0.11, 0.04), "terrain"),
    ("Ground right", 27.5, 40, 0.0, (0.08, 0.11, 0.04), "terrain"),
)
"""Name, middle and width [m] across the street, height of the top [m], colour, label."""


# -- in a Blender with USD


def street(file):
    """Models of the library along a street, each one object, and a camera; as a .blend file."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    for model, at, turn, label in MODELS:
        before = set(bpy.data.objects)
        bpy.ops.wm.usd_import(filepath=str(ROOT / "assets" / "models" / model / f"{model}.usda"), import_lights=False)
        meshes = [thing for thing in bpy.data.objects if thing not in before and thing.type == "MESH"]
        for thing in bpy.data.objects:
            thing.select_set(thing in meshes)
        for thing in meshes:
            for layer in thing.data.uv_layers[1:]:
                thing.data.uv_layers.remove(layer)
            for layer in thing.data.uv_layers:
                layer.name = "st"
        bpy.context.view_layer.objects.active = meshes[0]
        bpy.ops.object.parent_clear(type="CLEAR_KEEP_TRANSFORM")
        if len(meshes) > 1:
            bpy.ops.object.join()
        one = bpy.context.view_layer.objects.active
        bpy.ops.object.transform_apply(location=True, rotation=True, scale=True)
        one.name, one["cityscapes"] = model.replace("_", " ").capitalize(), label
        one.location, one.rotation_mode, one.rotation_euler = at, "XYZ", (0, 0, math.radians(turn))
        for thing in [one for one in bpy.data.objects if one not in before and one.type == "EMPTY"]:
            bpy.data.objects.remove(thing)
    for name, x, width, top, colour, label in SLABS:
        bpy.ops.mesh.primitive_cube_add(size=1.0, location=(x, 60, top - 0.3), scale=(width, 160, 0.6))
        slab = bpy.context.active_object
        slab.name, slab["cityscapes"] = name, label
        material = bpy.data.materials.new(name)
        if material.node_tree is None:
            material.use_nodes = True
        material.diffuse_color = (*colour, 1.0)
        shader = material.node_tree.nodes["Principled BSDF"]
        shader.inputs["Base Color"].default_value, shader.inputs["Roughness"].default_value = (*colour, 1.0), 0.8
        slab.data.materials.append(material)
    bpy.ops.object.camera_add(location=(1.6, -2, 1.6), rotation=(math.radians(90), 0, 0))
    bpy.context.scene.camera = bpy.context.active_object
    bpy.ops.object.select_all(action="DESELECT")
    bpy.ops.file.pack_all()
    bpy.ops.wm.save_as_mainfile(filepath=file)


def export(file, stage):
    """A .blend file as the add-on exports it."""
    sys.path.insert(0, str(ROOT / "integrations" / "blender"))
    import synfog_fog

    bpy.ops.wm.open_mainfile(filepath=file)
    synfog_fog.register()
    bpy.ops.wm.usd_export(filepath=stage)


def aside(*words):
    """Run this script's `street` or `export` in a Blender without windows."""
    python = os.environ.get("SYNFOG_BPY")
    program = [bpy.app.binary_path, "--background", "--factory-startup", "--python", __file__, "--"]
    plain = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run(
        [*([python, __file__] if python else program), *words], capture_output=True, text=True, env=plain
    )
    if not Path(words[-1]).is_file():
        raise RuntimeError(done.stdout + done.stderr)


class WM_OT_usd_export(bpy.types.Operator):  # noqa: N801
    """In the place of Blender's own, where it was built without USD."""

    bl_idname = "wm.usd_export"
    bl_label = "Export USD"

    filepath: bpy.props.StringProperty()

    def execute(self, context):
        with tempfile.TemporaryDirectory() as folder:
            file = str(Path(folder) / "copy.blend")
            bpy.ops.wm.save_as_mainfile(filepath=file, copy=True)
            aside("export", file, self.filepath)
        return {"FINISHED"}


# -- in the Blender with windows


def over(kind="VIEW_3D", region="WINDOW"):
    """As if the pointer were in that editor of the first window."""
    window = bpy.context.window_manager.windows[0]
    area = next(one for one in window.screen.areas if one.type == kind)
    return bpy.context.temp_override(
        window=window, area=area, region=next(one for one in area.regions if one.type == region)
    )


def drawn():
    """Wait until the window is drawn, which an event brings about; the pointer is out of the way."""
    for x in (2, 4):
        bpy.context.window_manager.windows[0].cursor_warp(x, 2)
        yield 1.0


def snap(file, x, y, width, height):
    """A part of the screen as a file, from its lower left corner as Blender counts."""
    screen = bpy.context.window_manager.windows[0]
    part = f"{width}x{height}+{x}+{screen.height - y - height}"
    subprocess.run(["import", "-window", "root", "-crop", part, "+repage", "-quality", "88", str(file)], check=True)


def snap_view(file, width, height):
    """The 3D view's upper right part, with the sidebar."""
    view = next(one for one in bpy.context.window_manager.windows[0].screen.areas if one.type == "VIEW_3D")
    width, height = min(width, view.width), min(height, view.height)
    snap(file, view.x + view.width - width, view.y + view.height - height, width, height)


def story(out, folder):
    """What an artist does; each number is a wait in seconds."""
    manager, add_on = bpy.context.window_manager, str(folder / "synfog_fog.zip")
    subprocess.run([os.environ["SYNFOG_USD"], "plugin-path", "--blender", add_on], check=True, capture_output=True)
    if not bpy.app.build_options.usd:
        bpy.utils.register_class(WM_OT_usd_export)
    aside("street", str(folder / "street.blend"))
    bpy.ops.extensions.package_install_files(filepath=add_on, repo="user_default", enable_on_install=True)
    if ADD_ON not in bpy.context.preferences.addons:
        raise RuntimeError("the add-on was not installed")
    bpy.ops.wm.open_mainfile(filepath=str(folder / "street.blend"), load_ui=False)
    yield 1.0
    with over():
        view = bpy.context.space_data
        view.show_region_ui = True
        view.shading.color_type, view.shading.background_type = "TEXTURE", "VIEWPORT"
        view.shading.background_color = (0.4, 0.42, 0.44)
        view.overlay.show_floor = view.overlay.show_axis_x = view.overlay.show_axis_y = False
        view.overlay.show_cursor = False
        bpy.ops.view3d.view_camera()
    yield from drawn()
    with over(region="UI"):
        bpy.context.region.active_panel_category = "Synfog"
    with over():
        bpy.ops.synfog.add_fog("INVOKE_DEFAULT", mor=150.0)
        bpy.ops.synfog.light("INVOKE_DEFAULT", preset="overcast")
        bpy.ops.synfog.camera("INVOKE_DEFAULT", sensor="imx490_like")
    yield from drawn()
    with over():
        bpy.ops.view3d.view_center_camera()
    bpy.context.scene.synfog_samples = 64
    yield 8.0  # what was reported has gone from the status bar
    yield from drawn()
    snap_view(out / "blender-panel.jpg", 800, 570)

    taxi = bpy.data.objects["Taxi"]
    taxi.scale = (2.0, 2.0, 2.0)
    with over():
        bpy.ops.synfog.check("INVOKE_DEFAULT")
    yield 1.0
    yield from drawn()
    snap_view(out / "blender-check.jpg", 800, 570)
    taxi.scale = (1.0, 1.0, 1.0)

    with over():
        bpy.ops.synfog.select(name="Fog")
        bpy.ops.synfog.bake("INVOKE_DEFAULT")
    while "rendering" not in manager.synfog_doing:
        yield 0.5
    yield from drawn()
    snap_view(out / "blender-progress.jpg", 520, 480)
    while not manager.synfog_told.startswith("[{"):
        yield 0.5
    yield 2.0
    yield from drawn()
    shown = manager.windows[-1]
    first = manager.windows[0]
    snap(out / "blender-result.jpg", shown.x - first.x, shown.y - first.y, shown.width, shown.height)

    # What a Blender without windows cannot do, as it has no bakes beside the work.
    bake = importlib.import_module(f"{ADD_ON}.baking").SYNFOG_OT_bake
    for end in (bpy.ops.synfog.stop, lambda: bpy.ops.wm.open_mainfile(filepath=str(folder / "street.blend"))):
        bpy.context.scene.synfog_samples = 100000
        with over():
            bpy.ops.synfog.bake("INVOKE_DEFAULT")
        yield 3.0
        if bake.process.poll() is not None:
            raise RuntimeError("the bake did not begin")
        end()
        yield 5.0
        if bake.process.poll() is None:
            raise RuntimeError("the bake went on")


def tell(out):
    """Step through the story by a timer, so that windows are drawn between its steps; then quit."""
    folder = tempfile.TemporaryDirectory()
    steps = story(Path(out).resolve(), Path(folder.name))

    def step():
        try:
            return next(steps)
        except StopIteration:
            code = 0
        except Exception:
            traceback.print_exc()
            code = 1
        folder.cleanup()
        sys.stdout.flush()
        os._exit(code)

    bpy.context.preferences.view.show_splash = False
    bpy.app.timers.register(step, first_interval=2.0, persistent=True)


if __name__ == "__main__":
    words = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    {"street": street, "export": export}.get(words[0], tell)(*(words[1:] if len(words) > 1 else words))
