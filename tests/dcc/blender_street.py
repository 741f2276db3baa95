"""Run by Blender's Python: a street with fog by the add-on, exported to USD.  Arguments: the add-on's folder, the file
to write, fogs or ''.
"""

import math
import sys


def street(add_on, file, fogs):
    import bpy

    sys.path.insert(0, add_on)
    import synfog_fog

    def box(name, at, size, label):
        bpy.ops.mesh.primitive_cube_add(size=1.0, location=at, scale=size)
        bpy.context.active_object.name = name
        bpy.ops.object.select_all(action="DESELECT")
        bpy.context.active_object.select_set(True)
        bpy.ops.synfog.label(label=label)

    bpy.ops.wm.read_factory_settings(use_empty=True)
    synfog_fog.register()
    box("Car", (1, 20, 0.75), (2, 4, 1.5), "car")
    box("Road", (0, 40, -0.5), (20, 120, 1), "road")
    bpy.ops.object.camera_add(location=(0, 0, 1.5), rotation=(math.pi / 2, 0, 0))
    eye = bpy.context.active_object
    eye.name, eye.data.lens, eye.data.sensor_width = "Ego", 35.0, 36.0
    bpy.context.scene.camera = eye
    bpy.ops.object.light_add(type="POINT", location=(3, 15, 5))
    bpy.context.active_object.data.energy = 1000.0
    world = bpy.data.worlds.new("World")
    bpy.context.scene.world = world
    if world.node_tree is None:  # before 5.0
        world.use_nodes = True
    background = world.node_tree.nodes["Background"]
    background.inputs["Color"].default_value, background.inputs["Strength"].default_value = (1.0, 1.0, 1.0, 1.0), 1000.0
    bpy.ops.synfog.add_fog(mor=150.0)
    if fogs:
        bpy.ops.synfog.variants(names=fogs)
    bpy.ops.wm.usd_export(filepath=file)
    synfog_fog.unregister()


if __name__ == "__main__":
    street(*sys.argv[1:4])
