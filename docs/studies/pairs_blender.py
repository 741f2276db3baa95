"""Run by Blender's Python: stages that its exporter writes, and pictures that Cycles makes of any stage.

    BLENDER_ENV/bin/python docs/studies/pairs_blender.py write FOLDER SAMPLES
    BLENDER_ENV/bin/python docs/studies/pairs_blender.py draw STAGE.usda OUT.npz SAMPLES [CAMERA]

A picture is what Blender's own import makes of the file, by path tracing without any of Cycles' savings: linear
radiance (H, W, 3) as `radiance`, and the share of a pixel that is not background (H, W) as `alpha`.
"""

import math
import sys
import tempfile
from pathlib import Path

import numpy as np

WIDTH, HEIGHT = 160, 90
COLOURS = {"red": (0.6, 0.1, 0.08), "green": (0.12, 0.45, 0.1), "grey": (0.5, 0.5, 0.5), "road": (0.2, 0.2, 0.22)}


def write(folder, samples):
    """One file for each kind of light, shape and material, and Cycles' picture of the scene itself."""
    scenes = {
        "sky": lambda: world(1000.0),
        "sun": lambda: (world(0.2), lamp("SUN", 3.0, rotation=(0.7, 0.3, 0.2), angle=0.009)),
        "point": lambda: (world(0.0), lamp("POINT", 2000.0, at=(2, 12, 5), shadow_soft_size=0.3)),
        "area": lambda: (world(0.0), lamp("AREA", 1000.0, at=(-2, 12, 6), rotation=(0.3, 0.2, 0), size=2.0)),
        "spot": lambda: (world(0.0), lamp("SPOT", 3000.0, at=(0, 8, 7), rotation=(0.5, 0, 0), shadow_soft_size=0.0,
                                          spot_size=1.2, spot_blend=0.0)),
        "smooth": lambda: (world(500.0), head()),
        "textured": lambda: (world(500.0), board(folder)),
        "gloss": lambda: (world(500.0), head(roughness=0.3, ior=1.45)),
        "rough": lambda: (world(500.0), rough()),
    }  # fmt: skip
    for name, make in scenes.items():
        fresh()
        make()
        bpy.ops.wm.usd_export(filepath=str(folder / f"{name}.usda"))
        picture(str(folder / f"{name}_direct.npz"), samples)


def fresh():
    """A road, two boxes and a camera."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    box("Road", (0, 25, -0.5), (40, 80, 1), "road")
    box("Car", (1.5, 12, 0.75), (2, 4, 1.5), "red")
    box("House", (-6, 22, 3), (5, 6, 6), "grey")
    bpy.ops.object.camera_add(location=(0, 0, 1.7), rotation=(math.pi / 2, 0, 0))
    camera = bpy.context.active_object
    camera.name, camera.data.sensor_fit = "Ego", "HORIZONTAL"
    camera.data.sensor_width, camera.data.sensor_height, camera.data.lens = 36.0, 20.25, 30.0
    camera.data.shift_y = 0.05
    bpy.context.scene.camera = camera
    bpy.context.scene.render.resolution_x, bpy.context.scene.render.resolution_y = 1920, 1080


def box(name, at, size, colour):
    """A matt box."""
    bpy.ops.mesh.primitive_cube_add(size=1.0, location=at, scale=size)
    thing = bpy.context.active_object
    thing.name = name
    thing.data.materials.append(matt(colour))


def matt(colour, *, roughness=1.0, ior=1.0):
    """Lambert's law where the index of refraction is 1; else with a coat of reflection."""
    made = bpy.data.materials.new(colour)
    if made.node_tree is None:
        made.use_nodes = True
    shader = next(node for node in made.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Base Color"].default_value = (*COLOURS[colour], 1.0)
    shader.inputs["Roughness"].default_value, shader.inputs["IOR"].default_value = roughness, ior
    return made


def rough():
    """Everything as rough as asphalt, with the index that a file means which says none."""
    for made in bpy.data.materials:
        shader = next(node for node in made.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
        shader.inputs["Roughness"].default_value, shader.inputs["IOR"].default_value = 0.9, 1.5


def head(**finish):
    """Suzanne as a subdivision surface."""
    bpy.ops.mesh.primitive_monkey_add(size=3.0, location=(-0.8, 9, 1.6), rotation=(0, 0, math.pi + 0.4))
    thing = bpy.context.active_object
    thing.modifiers.new("Subdivision", "SUBSURF").levels = 2
    thing.modifiers[0].render_levels = 2
    thing.data.materials.append(matt("green", **finish))


def board(folder):
    """A board with a picture of 64 x 64 texels, some of them bright, written as linear numbers."""
    bpy.ops.mesh.primitive_plane_add(size=4.0, location=(-1, 9, 2.1), rotation=(math.pi / 2, 0, 0))
    numbers = np.random.default_rng(5).uniform(0.05, 0.8, (8, 8, 3)).repeat(8, axis=0).repeat(8, axis=1)
    image = bpy.data.images.new("tiles", 64, 64, float_buffer=True, is_data=True)
    image.pixels.foreach_set(np.dstack([numbers, np.ones((64, 64))]).astype(np.float32).ravel())
    image.filepath_raw, image.file_format = str(folder / "tiles.exr"), "OPEN_EXR"
    image.save()
    made = matt("grey")
    picture = made.node_tree.nodes.new("ShaderNodeTexImage")
    picture.image, picture.interpolation = bpy.data.images.load(image.filepath_raw), "Closest"
    picture.image.colorspace_settings.name = "Non-Color"
    shader = next(node for node in made.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    made.node_tree.links.new(picture.outputs["Color"], shader.inputs["Base Color"])
    bpy.context.active_object.data.materials.append(made)


def world(strength):
    """A white sky."""
    made = bpy.data.worlds.new("World")
    if made.node_tree is None:
        made.use_nodes = True
    bpy.context.scene.world = made
    background = next(node for node in made.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    background.inputs["Strength"].default_value = strength


def lamp(kind, strength, *, at=(0, 0, 10), rotation=(0, 0, 0), **more):
    """One of Blender's lamps."""
    bpy.ops.object.light_add(type=kind, location=at, rotation=rotation)
    data = bpy.context.active_object.data
    data.energy = strength
    for name, value in more.items():
        setattr(data, name, value)


def draw(stage, out, samples, camera=""):
    """See the head of this file."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    world(0.0)  # Blender 5.0 leaves a DomeLight out where the scene has no world
    bpy.ops.wm.usd_import(filepath=str(stage), import_guide=False)
    scene = bpy.context.scene
    cameras = [thing for thing in bpy.data.objects if thing.type == "CAMERA" and thing.name.startswith(camera)]
    scene.camera = cameras[0]
    scene.frame_set(scene.frame_start)
    picture(out, samples)


def picture(out, samples):
    """The scene as it stands, by Cycles."""
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.device = "CYCLES", "CPU"
    settings = {
        "use_denoising": False, "use_adaptive_sampling": False, "sample_clamp_direct": 0.0,
        "sample_clamp_indirect": 0.0,
        "light_sampling_threshold": 0.0, "blur_glossy": 0.0, "max_bounces": 64, "diffuse_bounces": 64,
        "glossy_bounces": 64, "transmission_bounces": 64, "transparent_max_bounces": 64, "pixel_filter_type": "BOX",
        "filter_width": 1.0, "samples": samples,
    }  # fmt: skip
    for name, value in settings.items():
        setattr(scene.cycles, name, value)
    render = scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = WIDTH, HEIGHT, 100
    render.pixel_aspect_x = render.pixel_aspect_y = 1.0
    render.image_settings.file_format, render.image_settings.color_depth = "OPEN_EXR", "32"
    render.image_settings.color_mode = "RGBA"
    pictures = {}
    for name, clear in (("radiance", False), ("alpha", True)):
        render.film_transparent = clear
        with tempfile.TemporaryDirectory() as folder:
            render.filepath = f"{folder}/picture.exr"
            bpy.ops.render.render(write_still=True)
            image = bpy.data.images.load(render.filepath)
            image.colorspace_settings.name = "Non-Color"
            image.alpha_mode = "NONE" if not clear else "CHANNEL_PACKED"
            pixels = np.empty(WIDTH * HEIGHT * 4, dtype=np.float32)
            image.pixels.foreach_get(pixels)
        pictures[name] = pixels.reshape(HEIGHT, WIDTH, 4)[::-1]
    np.savez(out, radiance=pictures["radiance"][..., :3], alpha=pictures["alpha"][..., 3])


if __name__ == "__main__":
    import bpy

    if sys.argv[1] == "write":
        write(Path(sys.argv[2]), int(sys.argv[3]))
    else:
        draw(Path(sys.argv[2]), sys.argv[3], int(sys.argv[4]), *sys.argv[5:6])
