"""Light by the hour and cameras by their sensor, in the numbers that a bake reads as they are meant.

A bake takes a sun's Strength as lux and a world's as nits (cd m-2).  Blender's own view is brought to the
same light by the scene's exposure, which changes no file.
"""

from __future__ import annotations

import functools
import json
import math
from pathlib import Path

import bpy

SENSORS = Path(__file__).with_name("sensors.json")
"""Made from the camera profiles when the extension is packed."""

LIGHTS = {
    "noon": (85000.0, 50.0, 5000.0, "Clear noon: a sun of 85 000 lux at 50 degrees, a sky of 5 000 nits"),
    "overcast": (0.0, 50.0, 4000.0, "Overcast noon: no sun, a sky of 4 000 nits, 12 600 lux on the ground"),
    "dusk": (0.0, 5.0, 3.0, "Dusk: half an hour after sunset, a sky of 3 nits, 9 lux on the ground"),
    "night": (0.25, 40.0, 0.01, "Night: a full moon of a quarter of a lux, and a sky of 0.01 nits"),
}
"""Sun across its rays [lux], its height [degrees], sky [nits], what it is.  Within the usual ranges: a sun of 80 000 to
100 000 lux, an overcast sky of 2 000 to 10 000 nits, 400 lux at sunset and 3.4 at the end of civil twilight, a full
moon of 0.05 to 0.3 lux.
"""

SUN_DEG = 0.53
"""Across the sun's disk, and the moon's."""


@functools.cache
def sensors():
    """Name -> what is shipped of a sensor and its lens; none where the extension was not packed."""
    try:
        return json.loads(SENSORS.read_text(encoding="utf-8"))
    except OSError:
        return {}


def sensor_items(_operator, _context):
    """For a menu; Blender wants the words to be kept."""
    sensor_items.kept = [(name, one["title"], one["about"]) for name, one in sensors().items()]
    return sensor_items.kept or [("none", "none", "Pack the extension by synfog-usd plugin-path --blender")]


def background(world):
    """The world's Background node, made where there is none."""
    if world.node_tree is None:
        world.use_nodes = True
    nodes = world.node_tree.nodes
    found = next((node for node in nodes if node.type == "BACKGROUND"), None)
    if found is None:
        found = nodes.new("ShaderNodeBackground")
        out = next((node for node in nodes if node.type == "OUTPUT_WORLD"), None) or nodes.new("ShaderNodeOutputWorld")
        world.node_tree.links.new(found.outputs["Background"], out.inputs["Surface"])
    return found


def light_now(scene):
    """Name of the preset whose sun and sky the scene has, or None."""
    suns = [thing.data.energy for thing in scene.objects if thing.type == "LIGHT" and thing.data.type == "SUN"]
    tree = scene.world.node_tree if scene.world else None
    sky = next((node.inputs["Strength"] for node in tree.nodes if node.type == "BACKGROUND"), None) if tree else None
    for name, (sun_lux, _, sky_nits, _) in LIGHTS.items():
        wanted, found = [sun_lux, sky_nits], [suns[0] if suns else 0.0, sky.default_value if sky else 0.0]
        if all(math.isclose(one, other, rel_tol=1e-4) for one, other in zip(wanted, found, strict=True)):
            return name
    return None


def camera_now(scene):
    """Name of the sensor that the scene's camera has, behind its lens and with its pixels, or None."""
    if scene.camera is None:
        return None
    lens, render = scene.camera.data, scene.render
    found = [lens.sensor_width, lens.lens, render.resolution_x, render.resolution_y]
    for name, one in sensors().items():
        wanted = [one["sensor_width_mm"], one["focal_length_mm"], one["width_px"], one["height_px"]]
        if all(math.isclose(one, other, rel_tol=1e-4) for one, other in zip(wanted, found, strict=True)):
            return name
    return None


class SYNFOG_OT_light(bpy.types.Operator):
    """Light the scene as by the hour, in lux and nits."""

    bl_idname = "synfog.light"
    bl_label = "Set Light"
    bl_options = {"REGISTER", "UNDO"}

    preset: bpy.props.EnumProperty(
        name="Light", items=[(name, name.capitalize(), one[3]) for name, one in LIGHTS.items()], default="overcast"
    )

    def execute(self, context):
        """Set the first sun, or a new one, and the world's background; lamps stay as they are."""
        sun_lux, height_deg, sky_nits, about = LIGHTS[self.preset]
        scene = context.scene
        suns = [thing for thing in scene.objects if thing.type == "LIGHT" and thing.data.type == "SUN"]
        if not suns and sun_lux:
            suns = [bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))]
            scene.collection.objects.link(suns[0])
        for thing in suns[:1]:
            thing.data.energy, thing.data.angle, thing.data.color = sun_lux, math.radians(SUN_DEG), (1.0, 1.0, 1.0)
            thing.rotation_mode = "XYZ"
            thing.rotation_euler = (math.radians(90.0 - height_deg), 0.0, thing.rotation_euler.z)
        if len(suns) > 1:
            self.report({"WARNING"}, f"{len(suns) - 1} more suns shine as they did; hide or delete them")
        scene.world = scene.world or bpy.data.worlds.new("World")
        sky = background(scene.world)
        for link in list(sky.inputs["Color"].links):
            scene.world.node_tree.links.remove(link)
        sky.inputs["Color"].default_value, sky.inputs["Strength"].default_value = (1.0, 1.0, 1.0, 1.0), sky_nits
        ground = sun_lux * math.sin(math.radians(height_deg)) + math.pi * sky_nits
        scene.view_settings.exposure = -math.log2(ground / math.pi)  # to 32 stops, though its slider ends at 10
        self.report({"INFO"}, about)
        return {"FINISHED"}


class SYNFOG_OT_camera(bpy.types.Operator):
    """Give the camera the sensor, the lens and the pixels of a camera that synfog-usd knows."""

    bl_idname = "synfog.camera"
    bl_label = "Set Camera"
    bl_options = {"REGISTER", "UNDO"}

    sensor: bpy.props.EnumProperty(name="Sensor", items=sensor_items)

    @classmethod
    def poll(cls, context):
        """Where there is a camera."""
        return context.scene.camera is not None

    def execute(self, context):
        """Set sensor size, focal length, f-number and the picture's size; depth of field stays on or off."""
        one = sensors().get(self.sensor)
        if one is None:
            self.report({"ERROR"}, "No sensors: pack the extension by synfog-usd plugin-path --blender")
            return {"CANCELLED"}
        camera, render = context.scene.camera.data, context.scene.render
        camera.type, camera.sensor_fit = "PERSP", "HORIZONTAL"
        camera.sensor_width, camera.sensor_height = one["sensor_width_mm"], one["sensor_height_mm"]
        camera.lens_unit, camera.lens = "MILLIMETERS", one["focal_length_mm"]
        camera.dof.aperture_fstop = one["f_number"]
        render.resolution_x, render.resolution_y = one["width_px"], one["height_px"]
        render.pixel_aspect_x = render.pixel_aspect_y = 1.0
        self.report({"INFO"}, one["about"])
        return {"FINISHED"}


CLASSES = (SYNFOG_OT_light, SYNFOG_OT_camera)
