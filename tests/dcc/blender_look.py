"""Run by Blender's Python: what it finds in a USD file, as JSON on the last line.  Arguments: the file, names of fog
boxes.
"""

import json
import sys


def look(file, *fogs):
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.usd_import(filepath=file, import_guide=True, support_scene_instancing=True)
    shown = bpy.context.evaluated_depsgraph_get()
    found = {"cameras": {}, "lights": [], "instances": [], "points": 0, "fog": {}, "meshes": 0}
    for thing in bpy.data.objects:
        if thing.type == "CAMERA":
            found["cameras"][thing.name] = {"matrix": rows(thing), "fov_x": thing.data.angle_x}
        elif thing.type == "EMPTY" and thing.instance_type == "COLLECTION":
            found["instances"].append(rows(thing))
        elif thing.type == "POINTCLOUD":
            found["points"] += len(thing.data.points)
        elif thing.type == "MESH" and thing.name in fogs:
            corners = [list(thing.matrix_world @ vertex.co) for vertex in thing.data.vertices]
            found["fog"][thing.name] = [[min(axis), max(axis)] for axis in zip(*corners, strict=True)]
        found["meshes"] += thing.type == "MESH"
    found["lights"] = [
        list(one.matrix_world.translation) for one in shown.object_instances if one.object.type == "LIGHT"
    ]
    print("\n" + json.dumps(found))


def rows(thing):
    return [list(row) for row in thing.matrix_world]


if __name__ == "__main__":
    look(*sys.argv[1:])
