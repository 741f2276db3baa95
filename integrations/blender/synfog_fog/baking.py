"""synfog-usd from inside Blender: the scene is exported, checked or baked by the command, and the result shown.

The command runs in a process of its own, found by the add-on's preferences, the variable SYNFOG_USD or the
path.  What it says of a prim selects the object that the prim was made from.
"""

from __future__ import annotations

import json
import os
import queue
import re
import shutil
import subprocess
import threading
from pathlib import Path

import bpy

PROGRESS = re.compile(r"^\s*(\d+)%\s+(.*?)\s+\d+ s\b")
"""A line of progress as the command prints it where it has no terminal."""

PRIM = re.compile(r"(/[^\s:,;()<>]+)")
LOOK_EVERY_S = 0.25
MOST_SHOWN = 8


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


def command(context):
    """Path of the command, or None."""
    mine = context.preferences.addons.get(SynfogPreferences.bl_idname)
    told = bpy.path.abspath(mine.preferences.command) if mine is not None and mine.preferences else ""
    return shutil.which(told or os.environ.get("SYNFOG_USD", "") or "synfog-usd")


def exported(context):
    """The scene as a stage in a folder of its own beside the .blend file, else among Blender's temporary files."""
    place = Path(bpy.path.abspath("//")) if bpy.data.filepath else Path(bpy.app.tempdir)
    folder = place / "synfog"
    folder.mkdir(parents=True, exist_ok=True)
    stage = folder / "scene.usdc"
    bpy.ops.wm.usd_export(filepath=str(stage))
    return stage


def key(name):
    """A name as it becomes part of a prim's path."""
    return "".join(sign if sign.isalnum() else "_" for sign in name)


def thing_of(path):
    """The object that a prim was made from: by the innermost part of its path that is one's name."""
    by_key = {key(thing.name): thing for thing in bpy.data.objects}
    return next((by_key[part] for part in reversed(path.partition(".")[0].split("/")) if part in by_key), None)


def blame(context, lines):
    """Select the objects of which lines speak, the first of them active; their names."""
    found = [thing for line in lines for path in PRIM.findall(line) if (thing := thing_of(path)) is not None]
    found = [thing for thing in dict.fromkeys(found) if thing.name in context.view_layer.objects]
    if found:
        for thing in context.view_layer.objects:
            thing.select_set(thing in found)
        context.view_layer.objects.active = found[0]
    context.window_manager.synfog_told = "\n".join(lines[:MOST_SHOWN])
    return [thing.name for thing in found]


def environment():
    """Without what Blender sets for its own Python."""
    return {name: value for name, value in os.environ.items() if name not in ("PYTHONHOME", "PYTHONSTARTUP")}


class SYNFOG_OT_check(bpy.types.Operator):
    """Export the scene, and tell what in it is wrong; objects with faults are selected."""

    bl_idname = "synfog.check"
    bl_label = "Check"

    def execute(self, context):
        """Run `synfog-usd check --json`."""
        tool = command(context)
        if tool is None:
            self.report({"ERROR"}, "synfog-usd is not found: name it in the add-on's preferences")
            return {"CANCELLED"}
        words = [tool, "check", str(exported(context)), "--json"]
        done = subprocess.run(words, capture_output=True, encoding="utf-8", errors="replace", env=environment())
        try:
            found = json.loads(done.stdout)["findings"]
        except (ValueError, KeyError):
            lines = done.stderr.strip().splitlines()[-1:] or [f"it ended with code {done.returncode}"]
            blame(context, lines)
            self.report({"ERROR"}, lines[0])
            return {"CANCELLED"}
        lines = [f"{one['severity']}: {one['path']}: {one['text']}" for one in found if one["severity"] != "info"]
        blame(context, lines)
        for line in lines[:MOST_SHOWN]:
            self.report({"WARNING"}, line)
        if not lines:
            self.report({"INFO"}, "Nothing is wrong")
        return {"FINISHED"}


class SYNFOG_OT_bake(bpy.types.Operator):
    """Export the scene, bake it, and open the pictures in the image editor; Escape ends it."""

    bl_idname = "synfog.bake"
    bl_label = "Bake"

    percentage: bpy.props.IntProperty(name="Size (%)", default=25, min=1, max=100, subtype="PERCENTAGE")
    samples: bpy.props.IntProperty(name="Samples", default=16, min=1, soft_max=1024)

    def begin(self, context):
        """Export and start the command; False where that is not to be had."""
        tool = command(context)
        if tool is None:
            self.report({"ERROR"}, "synfog-usd is not found: name it in the add-on's preferences")
            return False
        if context.scene.camera is None:
            self.report({"ERROR"}, "The scene has no camera")
            return False
        stage, render = exported(context), context.scene.render
        size = [max(1, round(pixels * self.percentage / 100)) for pixels in (render.resolution_x, render.resolution_y)]
        self.out = stage.parent / "bake"
        words = [tool, "bake", str(stage), "-o", str(self.out), "--resolution", f"{size[0]}x{size[1]}"]
        words += ["--samples", str(self.samples)]
        self.process = subprocess.Popen(
            words,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            encoding="utf-8",
            errors="replace",
            env=environment(),
        )
        self.said, self.lines = queue.Queue(), []
        self.listener = threading.Thread(target=self.listen, daemon=True)
        self.listener.start()
        context.window_manager.progress_begin(0, 100)
        return True

    def listen(self):
        """In a thread: what the command says."""
        for line in self.process.stderr:
            self.said.put(line.rstrip())

    def hear(self, context):
        """Show progress, and keep what is no progress."""
        while not self.said.empty():
            line = self.said.get()
            if found := PROGRESS.match(line):
                context.window_manager.progress_update(int(found[1]))
                if context.workspace is not None:
                    context.workspace.status_text_set(f"Synfog: {found[1]} %, {found[2]}")
            elif line:
                self.lines.append(line)

    def end(self, context):
        """Show what came of it."""
        self.listener.join()
        self.process.stderr.close()
        self.hear(context)
        context.window_manager.progress_end()
        if context.workspace is not None:
            context.workspace.status_text_set(None)
        faults = [line.removeprefix("synfog-usd: ") for line in self.lines if line.startswith("synfog-usd: ")]
        warnings = [line for line in self.lines if line.startswith("warning: ")]
        blame(context, faults or warnings)
        if self.process.returncode:
            self.report({"ERROR"}, (faults or self.lines or ["the bake ended without a word"])[-1])
            return {"CANCELLED"}
        for line in warnings[:MOST_SHOWN]:
            self.report({"WARNING"}, line)
        opened = show(context, self.out)
        self.report({"INFO"}, f"{len(opened)} pictures: {self.out}")
        return {"FINISHED"}

    def execute(self, context):
        """At once and to the end, as scripts want it."""
        if not self.begin(context):
            return {"CANCELLED"}
        self.process.wait()
        return self.end(context)

    def invoke(self, context, event):
        """Beside the work on the scene."""
        if not self.begin(context):
            return {"CANCELLED"}
        self.timer = context.window_manager.event_timer_add(LOOK_EVERY_S, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        """Look whether it is done; Escape ends it."""
        if event.type == "ESC":
            self.process.terminate()
            self.process.wait()
        elif event.type != "TIMER":
            return {"PASS_THROUGH"}
        self.hear(context)
        if self.process.poll() is None:
            return {"PASS_THROUGH"}
        context.window_manager.event_timer_remove(self.timer)
        return self.end(context)


def show(context, out):
    """Load the pictures of a bake, all shots side by side first, and open that one; names of Blender's images."""
    rows = json.loads((out / "bake.json").read_text(encoding="utf-8"))["shots"]
    files = [out / "contact.png"]
    for row in rows:
        files += [out / row["lighting"] / row["fog"] / name for name in row["files"] if name.endswith(".png")]
    images = []
    for file in files:
        image = bpy.data.images.load(str(file), check_existing=True)
        image.name = "Synfog " + " ".join(file.relative_to(out).with_suffix("").parts)
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
    return [image.name for image in images]


CLASSES = (SynfogPreferences, SYNFOG_OT_check, SYNFOG_OT_bake)
