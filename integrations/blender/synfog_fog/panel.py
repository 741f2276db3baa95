"""The tab in the 3D view's sidebar: fog, labels, light and camera, and the bake with what it told.

A line that the sidebar is too narrow for is broken, and what is told of an object stands below a button that selects
it.
"""

from __future__ import annotations

import json

import blf
import bpy

from . import baking, presets

VARIANTS = "synfog_variants"
"""Custom property of the scene: names of fogs, as 'clear,mor600,mor300,mor150'; empty for none."""

NAMES = {
    "mor": "Visibility (m)",
    "sigma_t": "Extinction (1/m)",
    "contrast": "Contrast Threshold",
    "albedo": "Albedo",
    "g": "Mean Cosine",
    "scaleHeight": "Scale Height (m)",
    "outerScale": "Outer Scale (m)",
    "deviation": "Deviation",
    "seed": "Seed",
    "dropletDiameter": "Droplets (µm)",
    "angstrom": "Angstrom Exponent",
    "priority": "Priority",
    "enabled": "Enabled",
    "phase": "Phase Function",
    "profile": "Profile",
}
"""What the panel calls a box's custom properties synfog_<name>."""

ICONS = {"error": "CANCEL", "warning": "ERROR", "info": "INFO", "done": "CHECKMARK"}
"""Blender's icon ERROR is the triangle of a warning."""

SIDEBAR_PX = 280
BESIDE_PX = 104
"""Of the sidebar's width: its tabs, the margins of a box, and an icon before the words."""

MOST_BOXES = 4
MOST_OBJECTS = 3


def wrapped(text, width, measure):
    """Lines no wider than a width by some measure; a word that is wider alone stands on a line of its own."""
    lines = []
    for word in text.split():
        if lines and measure(f"{lines[-1]} {word}") <= width:
            lines[-1] += f" {word}"
        else:
            lines.append(word)
    return lines


def ui_scale(context):
    """How large Blender draws its interface; 1 where there is no screen."""
    return context.preferences.system.ui_scale or 1.0


def text_width(context):
    """How wide a string is in the sidebar, in pixels, as a function."""
    blf.size(0, context.preferences.ui_styles[0].widget.points * ui_scale(context))
    return lambda text: blf.dimensions(0, text)[0]


def tell(context, layout, severity, text):
    """A text over as many lines as it needs, an icon before the first."""
    scale, region = ui_scale(context), context.region
    room = (region.width if region is not None else SIDEBAR_PX * scale) - BESIDE_PX * scale
    column = layout.column(align=True)
    column.scale_y = 0.8
    for number, line in enumerate(wrapped(text[:1].upper() + text[1:], room, text_width(context))):
        column.label(text=line, icon="BLANK1" if number else ICONS[severity])


def is_fog(thing):
    """Whether an object is a box of fog, by its properties."""
    return any(name.startswith("synfog_") for name in thing.keys())


def draw_all(context, layout):
    """The panel, from top to bottom in the order of the work."""
    draw_fog(context, layout)
    draw_labels(context, layout)
    draw_light_and_camera(context, layout)
    draw_bake(context, layout)


def draw_fog(context, layout):
    """The boxes and their properties, and the fogs that are baked in turn."""
    scene = context.scene
    column = layout.column(align=True)
    column.label(text="Fog")
    column.operator("synfog.add_fog", icon="OUTLINER_OB_VOLUME")
    boxes = [thing for thing in scene.objects if is_fog(thing)]
    for box in boxes[:MOST_BOXES]:
        if len(boxes) > 1:
            column.operator("synfog.select", text=box.name, icon="RESTRICT_SELECT_OFF").name = box.name
        for name in box.keys():
            if name.startswith("synfog_"):
                short = name.removeprefix("synfog_").removeprefix("fog_")
                column.prop(box, f'["{name}"]', text=NAMES.get(short, short))
    if len(boxes) > MOST_BOXES:
        column.label(text=f"and {len(boxes) - MOST_BOXES} more boxes")
    column.operator("synfog.variants", icon="RENDERLAYERS")
    if fogs := str(scene.get(VARIANTS, "")):
        tell(context, column, "info", f"bakes {', '.join(name.strip() for name in fogs.split(','))}")


def draw_labels(context, layout):
    """The menu of labels, and the active object's."""
    thing = context.active_object
    column = layout.column(align=True)
    column.label(text="Labels")
    row = column.row(align=True)
    row.enabled = bpy.ops.synfog.label.poll()  # a menu is not greyed by itself
    row.operator_menu_enum("synfog.label", "label", icon="BOOKMARKS")
    if thing is not None and "cityscapes" in thing.keys():
        column.prop(thing, '["cityscapes"]', text=thing.name)


def draw_light_and_camera(context, layout):
    """The menus of presets, with the name of the one that is set."""
    column = layout.column(align=True)
    column.label(text="Light and Camera")
    scene = context.scene
    light = presets.light_now(scene)
    text = f"Light: {light.capitalize()}" if light else "Set Light"
    column.operator_menu_enum("synfog.light", "preset", text=text, icon="LIGHT_SUN")
    if sensors := presets.sensors():
        camera = presets.camera_now(scene)
        text = f"Camera: {sensors[camera]['title']}" if camera else "Set Camera"
        row = column.row(align=True)
        row.enabled = scene.camera is not None
        row.operator_menu_enum("synfog.camera", "sensor", text=text, icon="CAMERA_DATA")


def draw_bake(context, layout):
    """Size and samples, the buttons or how far the bake is, and what the last one told."""
    scene, manager = context.scene, context.window_manager
    column = layout.column(align=True)
    column.label(text="Bake")
    if not baking.has_usd():
        tell(context, column, "error", baking.NO_USD)
    column.prop(scene, "synfog_percentage")
    column.prop(scene, "synfog_samples")
    if baking.running():
        column.progress(factor=manager.synfog_done, text=f"{100 * manager.synfog_done:.0f} %")
        column.operator("synfog.stop", icon="CANCEL")
        tell(context, column, "info", manager.synfog_doing)
    else:
        row = column.row(align=True)
        row.operator("synfog.check", icon="CHECKMARK")
        row.operator("synfog.bake", icon="RENDER_STILL", text="Bake {}x{}".format(*baking.size(scene)))
    for one in json.loads(manager.synfog_told or "[]"):
        box = layout.box().column(align=True)
        for name in one["objects"][:MOST_OBJECTS]:
            box.operator("synfog.select", text=name, icon="RESTRICT_SELECT_OFF").name = name
        if len(one["objects"]) > MOST_OBJECTS:
            box.label(text=f"and {len(one['objects']) - MOST_OBJECTS} more objects")
        tell(context, box, one["severity"], one["text"])


class SYNFOG_OT_select(bpy.types.Operator):
    """Select this object alone and make it the active one."""

    bl_idname = "synfog.select"
    bl_label = "Select"
    bl_options = {"UNDO"}

    name: bpy.props.StringProperty(name="Object")

    def execute(self, context):
        """Select it where it still is."""
        thing = context.view_layer.objects.get(self.name)
        if thing is None:
            self.report({"WARNING"}, f"{self.name} is no longer in the scene")
            return {"CANCELLED"}
        baking.select(context, [thing])
        return {"FINISHED"}


class SYNFOG_PT_panel(bpy.types.Panel):
    """The tab in the sidebar."""

    bl_label = "Synfog"
    bl_idname = "SYNFOG_PT_panel"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Synfog"

    def draw(self, context):
        """From top to bottom in the order of the work."""
        draw_all(context, self.layout)


CLASSES = (SYNFOG_OT_select, SYNFOG_PT_panel)
