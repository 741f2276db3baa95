"""synfog-usd from inside Blender: the scene is exported, checked or baked by the command, and the result shown.

The command runs in a process of its own, found by the add-on's preferences, the variable SYNFOG_USD or the
path.  What it says of a prim selects the object that the prim was made from.
"""

from __future__ import annotations

import functools
import json
import os
import queue
import re
import shutil
import subprocess
import threading
import time
from pathlib import Path

import bpy

from . import presets

PROGRESS = re.compile(r"^\s*(\d+)%\s+(.*?)\s+\d+ s\b(?:, about (\d+) s left)?")
"""A line of progress as the command prints it where it has no terminal."""

PRIM = re.compile(r"(/[^\s:,;()<>]+)")
FINDING = re.compile(r"^(?:(error|warning|info): )?(.*)$", re.DOTALL)
ONLY_SHOT = "authored/authored: "
"""Before the steps of a scene without variants."""

LOOK_EVERY_S = 0.25
FIT_AFTER_S = 0.3
MOST_SHOWN = 8

NO_USD = "This Blender was built without USD, so it can neither check nor bake; blender.org's has it"
NO_COMMAND = "synfog-usd is not found: name it in the add-on's preferences"

PROPERTIES = {
    bpy.types.Scene: {
        "synfog_percentage": bpy.props.IntProperty(
            name="Size",
            description="Of the picture that is baked, in percent of the render's resolution",
            default=25,
            min=1,
            max=100,
            subtype="PERCENTAGE",
        ),
        "synfog_samples": bpy.props.IntProperty(
            name="Samples", description="For each pixel; more of them take longer", default=16, min=2, soft_max=1024
        ),
    },
    bpy.types.WindowManager: {
        "synfog_told": bpy.props.StringProperty(name="What the last check or bake told, as JSON"),
        "synfog_done": bpy.props.FloatProperty(name="Share of the bake that is done"),
        "synfog_doing": bpy.props.StringProperty(name="What the bake does"),
    },
}
"""Of the panel: the bake's settings, which a file keeps, and what the window shows."""


class SynfogPreferences(bpy.types.AddonPreferences):
    """Where the command is."""

    bl_idname = __package__ or "synfog_fog"

    command: bpy.props.StringProperty(
        name="synfog-usd",
        subtype="FILE_PATH",
        description="The command, as .venv/bin/synfog-usd; empty where it is on the path",
    )

    def draw(self, context):
        """One line."""
        self.layout.prop(self, "command")


def on_path(name):
    """As shutil.which, but never in the current folder, where Windows looks first and an empty entry of PATH points."""
    if Path(name).name != name:
        return shutil.which(name)
    endings = ["", *os.environ.get("PATHEXT", "").split(os.pathsep)] if os.name == "nt" else [""]
    folders = filter(os.path.isabs, os.environ.get("PATH", "").split(os.pathsep))
    tools = (shutil.which(str(Path(folder) / (name + ending))) for folder in folders for ending in endings)
    return next(filter(None, tools), None)


def command(context):
    """Path of the command, or None."""
    mine = context.preferences.addons.get(SynfogPreferences.bl_idname)
    told = bpy.path.abspath(mine.preferences.command) if mine is not None and mine.preferences else ""
    return on_path(told or os.environ.get("SYNFOG_USD", "") or "synfog-usd")


def exported(context):
    """The scene as a stage in a folder of its own beside the .blend file, else among Blender's temporary files."""
    place = Path(bpy.path.abspath("//")) if bpy.data.filepath else Path(bpy.app.tempdir)
    folder = place / "synfog"
    folder.mkdir(parents=True, exist_ok=True)
    light = presets.light_now(bpy.context.scene)
    stage = folder / (f"scene_{light}.usdc" if light else "scene.usdc")  # a bake doubts a dim sky that no name explains
    bpy.ops.wm.usd_export(filepath=str(stage))
    return stage


def key(name):
    """A name as it becomes part of a prim's path."""
    return "".join(sign if sign.isalnum() else "_" for sign in name)


def thing_of(path):
    """The object that a prim was made from: by the innermost part of its path that is one's name."""
    by_key = {key(thing.name): thing for thing in bpy.data.objects}
    return next((by_key[part] for part in reversed(path.partition(".")[0].split("/")) if part in by_key), None)


def has_usd():
    """Whether Blender can export USD, by itself or by an add-on's operator."""
    return bpy.app.build_options.usd or hasattr(bpy.types, "WM_OT_usd_export")


def size(scene):
    """Width and height [px] of the pictures that the panel's Bake makes."""
    return scaled(scene, scene.synfog_percentage)


def scaled(scene, percentage):
    """Width and height [px] of the render at a percentage."""
    return [
        max(1, round(pixels * percentage / 100)) for pixels in (scene.render.resolution_x, scene.render.resolution_y)
    ]


def findings(lines, names):
    """Lines as the panel shows them: 'severity', 'objects' and 'text', with names of objects in place of prims' paths;
    lines that differ in their objects alone are one.  `names` gives the name of a path's object, or None.
    """
    found = {}
    for line in lines:
        severity, text = FINDING.match(line).groups()
        things = [name for path in PRIM.findall(text) if (name := names(path)) is not None]
        text = PRIM.sub(lambda path: names(path[1]) or path[1], text)
        if things and text.startswith(f"{things[0]}: "):  # the button above says it
            text = text.removeprefix(f"{things[0]}: ")
        one = found.setdefault((severity or "error", text), [])
        one += [name for name in things if name not in one]
    return [{"severity": severity, "objects": one, "text": text} for (severity, text), one in found.items()]


def tell(context, told):
    """Show findings in the panel, of many the first."""
    if len(told) > MOST_SHOWN:
        more = {"severity": "info", "objects": [], "text": f"and {len(told) - MOST_SHOWN} more"}
        told = [*told[:MOST_SHOWN], more]
    context.window_manager.synfog_told = json.dumps(told, ensure_ascii=False)
    redraw(context)


def redraw(context):
    """Draw the sidebars again."""
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()


def select(context, things):
    """Select these objects alone, the first of them active."""
    for thing in context.view_layer.objects:
        thing.select_set(thing in things)
    context.view_layer.objects.active = things[0]


def blame(context, lines):
    """Show lines in the panel, and select the objects of which they speak, the first of them active."""
    found = [thing for line in lines for path in PRIM.findall(line) if (thing := thing_of(path)) is not None]
    found = [thing for thing in dict.fromkeys(found) if thing.name in context.view_layer.objects]
    if found and context.mode == "OBJECT":
        select(context, found)
    tell(context, findings(lines, name_of))


def name_of(path):
    """The name of the object that a prim was made from, or None."""
    thing = thing_of(path)
    return thing.name if thing is not None else None


def environment():
    """Without what is set for Blender's own Python: the command's has its own packages."""
    return {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}


class SYNFOG_OT_check(bpy.types.Operator):
    """Export the scene, and tell what in it is wrong; objects with faults are selected."""

    bl_idname = "synfog.check"
    bl_label = "Check"

    @classmethod
    def poll(cls, context):
        """Where Blender can export, and no bake runs."""
        return may_export(cls)

    def execute(self, context):
        """Run `synfog-usd check --json`."""
        tool = command(context)
        if tool is None:
            self.report({"ERROR"}, NO_COMMAND)
            return {"CANCELLED"}
        if context.window is not None:
            context.window.cursor_set("WAIT")
        try:
            words = [tool, "check", str(exported(context)), "--json"]
            done = subprocess.run(words, capture_output=True, encoding="utf-8", errors="replace", env=environment())
        finally:
            if context.window is not None:
                context.window.cursor_set("DEFAULT")
        try:
            found = json.loads(done.stdout)["findings"]
        except (ValueError, KeyError):
            lines = done.stderr.strip().splitlines()[-1:] or [f"it ended with code {done.returncode}"]
            blame(context, [line.removeprefix("synfog-usd: ") for line in lines])
            self.report({"ERROR"}, lines[0])
            return {"CANCELLED"}
        found = [one for one in found if one["severity"] != "info"]
        lines = [f"{one['severity']}: {one['path']}: {one['text']}" for one in found]
        mends = [one["mend"].get("Blender", "") for one in found]
        blame(context, [f"{line}. Mend: {mend}" if mend else line for line, mend in zip(lines, mends, strict=True)])
        for line in lines[:MOST_SHOWN]:
            self.report({"WARNING"}, line)
        if not lines:
            tell(context, [{"severity": "done", "objects": [], "text": "Nothing is wrong"}])
            self.report({"INFO"}, "Nothing is wrong")
        return {"FINISHED"}


def may_export(operator):
    """Whether Blender can export and no bake runs; if not, the button's tooltip says why."""
    if not has_usd():
        operator.poll_message_set(NO_USD)
    elif running():
        operator.poll_message_set("A bake runs")
    return has_usd() and not running()


def running():
    """Whether a bake runs."""
    process = SYNFOG_OT_bake.process
    return process is not None and process.poll() is None


def listen(stream, said):
    """In a thread: what the command says.  It may outlive the operator, which is gone when another file is opened."""
    for line in stream:
        said.put(line.rstrip())


class SYNFOG_OT_stop(bpy.types.Operator):
    """End the bake that runs."""

    bl_idname = "synfog.stop"
    bl_label = "Stop"

    def execute(self, context):
        """The bake itself sees that it has ended."""
        if not running():
            return {"CANCELLED"}
        SYNFOG_OT_bake.stopped = True
        SYNFOG_OT_bake.process.terminate()
        return {"FINISHED"}


class SYNFOG_OT_bake(bpy.types.Operator):
    """Export the scene, bake it, and open the pictures in the image editor; Escape ends it."""

    bl_idname = "synfog.bake"
    bl_label = "Bake"

    percentage: bpy.props.IntProperty(name="Size (%)", default=25, min=1, max=100, subtype="PERCENTAGE")
    samples: bpy.props.IntProperty(name="Samples", default=16, min=2, soft_max=1024)

    process = None
    """The last bake's, of all that were begun."""
    stopped = False
    """Whether it was ended by hand."""

    @classmethod
    def poll(cls, context):
        """Where Blender can export, and no bake runs."""
        return may_export(cls)

    def begin(self, context):
        """Export and start the command; False where that is not to be had."""
        tool = command(context)
        if tool is None:
            self.report({"ERROR"}, NO_COMMAND)
            return False
        if context.scene.camera is None:
            self.report({"ERROR"}, "The scene has no camera")
            return False
        stage, pixels = exported(context), scaled(context.scene, self.percentage)
        self.out = stage.parent / "bake"
        words = [tool, "bake", str(stage), "-o", str(self.out), "--resolution", "{}x{}".format(*pixels)]
        words += ["--samples", str(self.samples)]
        SYNFOG_OT_bake.stopped, self.began = False, time.monotonic()
        SYNFOG_OT_bake.process = subprocess.Popen(
            words,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            encoding="utf-8",
            errors="replace",
            env=environment(),
        )
        self.said, self.lines, self.doing = queue.Queue(), [], "starting"
        self.listener = threading.Thread(target=listen, args=(self.process.stderr, self.said), daemon=True)
        self.listener.start()
        context.window_manager.synfog_done = 0.0
        tell(context, [])
        return True

    def hear(self, context):
        """Show progress, and keep what is no progress."""
        manager = context.window_manager
        while not self.said.empty():
            line = self.said.get()
            if found := PROGRESS.match(line):
                manager.synfog_done = int(found[1]) / 100
                self.doing = found[2].removeprefix(ONLY_SHOT)
            elif line:
                self.lines.append(line)
        manager.synfog_doing = f"{self.doing}, {time.monotonic() - self.began:.0f} s"
        if context.workspace is not None:
            percent = f"{100 * manager.synfog_done:.0f} %"
            context.workspace.status_text_set(f"Synfog: {percent}, {manager.synfog_doing} (Escape ends it)")
        redraw(context)

    def end(self, context):
        """Show what came of it."""
        self.listener.join()
        self.process.stderr.close()
        self.hear(context)
        if context.workspace is not None:
            context.workspace.status_text_set(None)
        faults = [line.removeprefix("synfog-usd: ") for line in self.lines if line.startswith("synfog-usd: ")]
        warnings = [line for line in self.lines if line.startswith("warning: ")]
        if self.stopped:
            tell(context, [{"severity": "warning", "objects": [], "text": "The bake was stopped"}])
            self.report({"WARNING"}, "The bake was stopped")
            return {"CANCELLED"}
        if self.process.returncode:
            last = (faults or self.lines or ["the bake ended without a word"])[-1]
            blame(context, faults or [last])
            self.report({"ERROR"}, last)
            return {"CANCELLED"}
        for line in warnings[:MOST_SHOWN]:
            self.report({"WARNING"}, line)
        opened = show(context, self.out)
        text = f"{len(opened)} pictures in {time.monotonic() - self.began:.0f} s: {self.out}"
        done = {"severity": "done", "objects": [], "text": text}
        tell(context, [done, *findings(warnings, name_of)])
        self.report({"INFO"}, text)
        return {"FINISHED"}

    def execute(self, context):
        """At once and to the end, as scripts want it."""
        if not self.begin(context):
            return {"CANCELLED"}
        self.process.wait()
        return self.end(context)

    def invoke(self, context, event):
        """Beside the work on the scene, with the panel's settings."""
        self.percentage, self.samples = context.scene.synfog_percentage, context.scene.synfog_samples
        if not self.begin(context):
            return {"CANCELLED"}
        self.timer = context.window_manager.event_timer_add(LOOK_EVERY_S, window=context.window)
        context.window_manager.modal_handler_add(self)
        self.hear(context)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        """Look whether it is done; Escape ends it."""
        if event.type == "ESC" and event.value == "PRESS" and running():
            SYNFOG_OT_bake.stopped = True
            self.process.terminate()
            return {"RUNNING_MODAL"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        self.hear(context)
        if running():
            return {"PASS_THROUGH"}
        context.window_manager.event_timer_remove(self.timer)
        return self.end(context)

    def cancel(self, context):
        """Blender ends, or opens another file."""
        self.process.terminate()


def show(context, out):
    """Load the pictures of a bake and open the first of them whole: all shots side by side, or the only one; names of
    Blender's images.
    """
    rows = json.loads((out / "bake.json").read_text(encoding="utf-8"))["shots"]
    files = [out / "contact.png"]
    for row in rows:
        files += [out / row["lighting"] / row["fog"] / name for name in row["files"] if name.endswith(".png")]
    if len(rows) == 1:
        files = [*files[1:], files[0]]
    images = []
    for file in files:
        parts = file.relative_to(out).with_suffix("").parts
        name = " ".join(["Synfog", *(part for part in parts if part != "authored")])
        image = bpy.data.images.get(name)  # the last bake's, which may have been beside another file
        if image is None:
            image = bpy.data.images.load(str(file))
            image.name = name
        else:
            image.filepath = str(file)
            image.reload()
        images.append(image)
    windows = context.window_manager.windows
    areas = [area for window in windows for area in window.screen.areas]
    area = next((area for area in areas if area.type == "IMAGE_EDITOR"), None)
    if area is None and areas and not bpy.app.background:
        bpy.ops.wm.window_new()
        area = windows[-1].screen.areas[0]
    elif area is None and areas:
        area = max(areas, key=lambda one: one.width * one.height)
    if area is not None:
        area.type = "IMAGE_EDITOR"
        area.spaces.active.image = images[0]
        window = next(one for one in windows if area in one.screen.areas[:])
        if not bpy.app.background:
            bpy.app.timers.register(functools.partial(fit, window, area), first_interval=FIT_AFTER_S)
    return [image.name for image in images]


def fit(window, area):
    """Let a picture fill its editor, once that has its size."""
    if window not in bpy.context.window_manager.windows[:]:
        return
    region = next((one for one in area.regions if one.type == "WINDOW"), None)
    if region is not None and area.type == "IMAGE_EDITOR":
        with bpy.context.temp_override(window=window, area=area, region=region):
            bpy.ops.image.view_all(fit_view=True)


CLASSES = (SynfogPreferences, SYNFOG_OT_check, SYNFOG_OT_stop, SYNFOG_OT_bake)
