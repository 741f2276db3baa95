"""Run by Blender's Python: the extension is installed and used as an artist would; what came of it, as JSON on the last
line.  Argument: its .zip.
"""

import importlib
import json
import sys


def use(file):
    import bpy

    addon_utils = importlib.import_module("addon_utils")  # which is there after bpy

    told = {}
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.preferences.edit.use_global_undo = True
    addon_utils.enable("bl_pkg")
    bpy.ops.extensions.package_install_files(filepath=file, repo="user_default", enable_on_install=True)
    told["add_ons"] = [one.module for one in bpy.context.preferences.addons]

    bpy.ops.mesh.primitive_cube_add(size=2)
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.synfog.add_fog(mor=120)
    bpy.ops.ed.undo_push(message="fog")
    box = bpy.data.objects["Fog"]
    told["size"] = list(box.dimensions)
    told["density"] = [density(box)]
    box["synfog_mor"] = 60.0
    box.update_tag()
    told["density"].append(density(box))
    bpy.ops.synfog.add_fog(mor=120)  # a second box is no larger: fog does not count
    told["again"] = list(bpy.context.active_object.dimensions)
    bpy.ops.ed.undo_push(message="more")
    bpy.ops.ed.undo()
    bpy.ops.ed.undo()
    told["undone"] = [[thing.name for thing in bpy.data.objects], len(bpy.data.materials)]

    try:
        bpy.ops.synfog.variants(names="clear,fog9")
    except RuntimeError as error:
        told["wrong"] = str(error)
    told["set"] = "synfog_variants" in bpy.context.scene
    bpy.context.view_layer.objects.active = bpy.data.objects["Cube"]
    bpy.ops.object.mode_set(mode="EDIT")
    told["while_editing"] = bpy.ops.synfog.add_fog.poll()
    print("\n" + json.dumps(told))


def density(box):
    """What the box's volume is for a renderer, drivers worked out."""
    import bpy

    material = box.data.materials[0].evaluated_get(bpy.context.evaluated_depsgraph_get())
    (scatter,) = [node for node in material.node_tree.nodes if node.type == "VOLUME_SCATTER"]
    return scatter.inputs["Density"].default_value


if __name__ == "__main__":
    use(sys.argv[1])
