"""Blender extension (4.2 and newer): fog, labels and variants for synfog-usd.

`synfog-usd plugin-path --blender synfog_fog.zip` packs this folder; install the file under
Edit > Preferences > Get Extensions > Install from Disk.  A tab "Synfog" in the 3D view's sidebar (N)
puts a box of fog around the scene, gives it a visibility, gives objects their Cityscapes label, sets light and
camera by presets, and checks and bakes the scene.
File > Export > Universal Scene Description then writes them as synfog-usd and other USD programs
expect: an API schema on a guide prim, semantic labels, variant sets.

All that the panel sets are custom properties (synfog_mor [m], synfog_g, ..., cityscapes), so a scene
keeps them without the extension.  The box wears a volume of the same density, so that Cycles shows it.
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import bpy
from mathutils import Vector

from . import baking, panel, presets
from .panel import VARIANTS, is_fog

API = "SynFogMediumAPI"
FOG = {
    "mor": "float",
    "sigma_t": "float",
    "contrast": "float",
    "albedo": "float",
    "g": "float",
    "scaleHeight": "float",
    "outerScale": "float",
    "deviation": "float",
    "seed": "int",
    "dropletDiameter": "float",
    "angstrom": "float",
    "priority": "int",
    "enabled": "bool",
    "phase": "token",
    "profile": "token",
}
"""Attributes of the schema and their USD types; custom properties are called synfog_<name>."""

LABELS = (
    "road",
    "sidewalk",
    "building",
    "wall",
    "fence",
    "guard rail",
    "bridge",
    "tunnel",
    "pole",
    "traffic light",
    "traffic sign",
    "vegetation",
    "terrain",
    "sky",
    "person",
    "rider",
    "car",
    "truck",
    "bus",
    "caravan",
    "trailer",
    "train",
    "motorcycle",
    "bicycle",
    "license plate",
)
MARGIN_M = 20.0
SOLID = frozenset({"MESH", "CURVE", "CURVES", "SURFACE", "META", "FONT", "POINTCLOUD", "VOLUME"})
"""Objects whose bounds count; of cameras, lights and empties their place does."""

EXTINCTION = 2.996
"""-ln 0.05: times 1 / visibility it is the extinction [1/m] of fog."""

FORWARDNESS = 0.87
"""Henyey-Greenstein's g where the box says none."""


# -- what is written


class SynfogHook(getattr(bpy.types, "USDHook", object)):
    """Turns custom properties into schemas while Blender writes a USD file."""

    bl_idname = "synfog_hook"
    bl_label = "Synfog"
    bl_description = "Fog, labels and variants for synfog-usd"

    @staticmethod
    def on_export(context):
        """Called by Blender when the stage is whole and not yet saved."""
        stage = context.get_stage()
        scene = context.get_depsgraph().scene
        fogs = [path for prim in list(stage.TraverseAll()) if (path := author_fog(stage, prim)) is not None]
        for prim in stage.TraverseAll():
            author_label(prim)
        author_variants(stage, fogs, fog_names(str(scene.get(VARIANTS, ""))))
        return True


def author_fog(stage, prim):
    """The schema on the one shape below a prim with synfog properties; its path, or None."""
    from pxr import Sdf, UsdGeom, Vt

    found = {}
    for attribute in prim.GetAuthoredAttributes():
        name = attribute.GetName()
        for prefix in ("synfog:fog:", "userProperties:synfog_fog_", "userProperties:synfog_"):
            if name.startswith(prefix) and name[len(prefix) :] in FOG:
                found.setdefault(name[len(prefix) :], attribute.Get())
                prim.RemoveProperty(name)
                break
    if not found:
        return None
    shapes = [child for child in [prim, *prim.GetChildren()] if child.IsA(UsdGeom.Gprim)]
    if len(shapes) != 1:
        print(f"Synfog: {prim.GetPath()} has fog properties and {len(shapes)} shapes; put them on an object with one")
        return None
    (shape,) = shapes
    shape.AddAppliedSchema(API)
    types = {
        "float": Sdf.ValueTypeNames.Float,
        "int": Sdf.ValueTypeNames.Int,
        "bool": Sdf.ValueTypeNames.Bool,
        "token": Sdf.ValueTypeNames.Token,
    }
    for name, value in found.items():
        uniform = Sdf.VariabilityUniform if FOG[name] == "token" else Sdf.VariabilityVarying
        kind = {"float": float, "int": int, "bool": bool, "token": str}[FOG[name]]
        shape.CreateAttribute(f"synfog:fog:{name}", types[FOG[name]], False, uniform).Set(kind(value))
    imageable = UsdGeom.Gprim(shape)
    imageable.CreatePurposeAttr(UsdGeom.Tokens.guide)
    imageable.CreateDisplayColorAttr(Vt.Vec3fArray([(0.8, 0.85, 0.9)]))
    imageable.CreateDisplayOpacityAttr(Vt.FloatArray([0.2]))
    shape.RemoveProperty("material:binding")
    shape.ClearActive()  # Blender writes active = true, which would beat the variant without fog
    return shape.GetPath()


def author_label(prim):
    """`SemanticsLabelsAPI:cityscapes` from a custom property 'cityscapes'."""
    from pxr import Sdf, Vt

    attribute = prim.GetAttribute("userProperties:cityscapes")
    label = str(attribute.Get() or "") if attribute else ""
    if not label:
        return
    prim.RemoveProperty("userProperties:cityscapes")
    prim.AddAppliedSchema("SemanticsLabelsAPI:cityscapes")
    prim.CreateAttribute("semantics:labels:cityscapes", Sdf.ValueTypeNames.TokenArray, False).Set(
        Vt.TokenArray([label])
    )


def fog_names(text):
    """The names within 'clear,mor600, mor150'."""
    return [name.strip() for name in text.split(",") if name.strip()]


def no_fogs(names):
    """Those of some names that say no fog."""
    return [
        name
        for name in names
        if name != "clear" and not (name.startswith("mor") and name[3:].isdecimal() and int(name[3:]) > 0)
    ]


def author_variants(stage, fogs, names):
    """Variant sets 'fog' (visibilities of the fog) and 'lighting' ('sky' without lamps, 'active' with them) on the
    default prim.
    """
    from pxr import Sdf, UsdLux

    root = stage.GetDefaultPrim()
    if not names:
        return
    if not root:
        print(
            "Synfog: no variants were written, because the file has no default prim; give the export a Root Prim, as "
            "/root"
        )
        return
    if wrong := no_fogs(names):
        print(f"Synfog: {', '.join(wrong)} are no fogs; write clear, or mor and metres, as mor150")
        return
    if fogs:
        for path in fogs:
            stage.GetPrimAtPath(path).RemoveProperty(
                "synfog:fog:mor"
            )  # a value on the prim itself would beat those of the variants
            stage.GetPrimAtPath(path).RemoveProperty("synfog:fog:sigma_t")
        chosen = root.GetVariantSets().AddVariantSet("fog")
        for name in names:
            chosen.AddVariant(name)
            chosen.SetVariantSelection(name)
            with chosen.GetVariantEditContext():
                for path in fogs:
                    if name == "clear":
                        stage.OverridePrim(path).SetActive(False)
                    else:
                        stage.OverridePrim(path).CreateAttribute("synfog:fog:mor", Sdf.ValueTypeNames.Float, False).Set(
                            float(name[3:])
                        )
        chosen.SetVariantSelection(names[-1])
    lamps = [
        prim.GetPath()
        for prim in stage.Traverse()
        if prim.HasAPI(UsdLux.LightAPI) and prim.GetTypeName() not in ("DomeLight", "DistantLight")
    ]
    for path in lamps:
        stage.GetPrimAtPath(path).ClearActive()
    if lamps:
        lighting = root.GetVariantSets().AddVariantSet("lighting")
        for name in ("sky", "active"):
            lighting.AddVariant(name)
            lighting.SetVariantSelection(name)
            with lighting.GetVariantEditContext():
                for path in lamps if name == "sky" else ():
                    stage.OverridePrim(path).SetActive(False)
        lighting.SetVariantSelection("active")


# -- what is shown


def bounds(context):
    """Corners and places of all that is shown, what stands in instances included; fog boxes do not count."""
    for one in context.evaluated_depsgraph_get().object_instances:
        if is_fog(one.object):
            continue
        if one.object.type in SOLID:
            yield from (one.matrix_world @ Vector(corner) for corner in one.object.bound_box)
        elif one.object.type in ("CAMERA", "LIGHT"):
            yield one.matrix_world.translation.copy()


def cuboid(size):
    """A mesh around the origin; its object needs no scale, of which Blender warns where it differs by axis."""
    half = size / 2.0
    corners = [(x, y, z) for x in (-half.x, half.x) for y in (-half.y, half.y) for z in (-half.z, half.z)]
    mesh = bpy.data.meshes.new("Fog")
    mesh.from_pydata(corners, [], [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
    return mesh


def fog_material(box, unit):
    """A volume as dense as the box's visibility says, now and when that is changed; without it a render shows a solid
    box.
    """
    material = bpy.data.materials.new("Fog")
    if material.node_tree is None:
        material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    scatter, out = nodes.new("ShaderNodeVolumeScatter"), nodes.new("ShaderNodeOutputMaterial")
    scatter.inputs["Anisotropy"].default_value = FORWARDNESS
    material.node_tree.links.new(scatter.outputs["Volume"], out.inputs["Volume"])
    driver = scatter.inputs["Density"].driver_add("default_value").driver
    variable = driver.variables.new()
    variable.name, variable.targets[0].id, variable.targets[0].data_path = "mor", box, '["synfog_mor"]'
    driver.expression = f"{EXTINCTION * unit} / mor"
    return material


class SYNFOG_OT_add_fog(bpy.types.Operator):
    """Put a box of fog around everything, the cameras included, with its bottom below the ground."""

    bl_idname = "synfog.add_fog"
    bl_label = "Add Fog Around Everything"
    bl_options = {"REGISTER", "UNDO"}

    mor: bpy.props.FloatProperty(name="Visibility (m)", default=150.0, min=1.0, soft_max=10000.0)

    @classmethod
    def poll(cls, context):
        """Not while a mesh is edited."""
        return context.mode == "OBJECT"

    def execute(self, context):
        """Make the box; its properties are custom properties of the object."""
        unit = context.scene.unit_settings.scale_length or 1.0
        corners = list(bounds(context))
        if not corners:
            self.report({"WARNING"}, "The scene is empty: add what shall stand in the fog first")
            return {"CANCELLED"}
        margin = MARGIN_M / unit
        low = Vector(
            [min(corner[axis] for corner in corners) - (margin if axis < 2 else 1.0 / unit) for axis in range(3)]
        )
        high = Vector([max(corner[axis] for corner in corners) + margin for axis in range(3)])
        box = bpy.data.objects.new("Fog", cuboid(high - low))
        box.location, box.display_type = (low + high) / 2.0, "BOUNDS"
        box["synfog_mor"] = self.mor
        box.id_properties_ui("synfog_mor").update(
            min=1.0, soft_max=10000.0, description="Visibility (meteorological optical range) in metres"
        )
        box.data.materials.append(fog_material(box, unit))
        context.scene.collection.objects.link(box)
        for thing in context.selected_objects:
            thing.select_set(False)
        box.select_set(True)
        context.view_layer.objects.active = box
        return {"FINISHED"}


class SYNFOG_OT_label(bpy.types.Operator):
    """Give the selected objects a Cityscapes label; boxes of fog stay as they are."""

    bl_idname = "synfog.label"
    bl_label = "Label Selected"
    bl_options = {"REGISTER", "UNDO"}

    label: bpy.props.EnumProperty(name="Label", items=[(name, name, "") for name in LABELS], default="car")

    @classmethod
    def poll(cls, context):
        """Where something other than fog is selected."""
        cls.poll_message_set("Select objects first; a box of fog has no label")
        return any(not is_fog(thing) for thing in context.selected_objects)

    def execute(self, context):
        """Set the custom property 'cityscapes'."""
        for thing in context.selected_objects:
            if not is_fog(thing):
                thing["cityscapes"] = self.label
        return {"FINISHED"}


class SYNFOG_OT_variants(bpy.types.Operator):
    """Write variants: several visibilities, and lamps on and off."""

    bl_idname = "synfog.variants"
    bl_label = "Set Variants"
    bl_options = {"REGISTER", "UNDO"}

    names: bpy.props.StringProperty(name="Fogs", default="clear,mor600,mor300,mor150")

    def execute(self, context):
        """Set the scene's custom property."""
        if wrong := no_fogs(fog_names(self.names)):
            self.report({"ERROR"}, f"{', '.join(wrong)}: no fog; write clear, or mor and metres, as mor150")
            return {"CANCELLED"}
        context.scene[VARIANTS] = self.names
        return {"FINISHED"}

    def invoke(self, context, event):
        """Ask for the names, those that are set first."""
        self.names = str(context.scene.get(VARIANTS, self.names))
        return context.window_manager.invoke_props_dialog(self, width=360)

    def draw(self, context):
        """The names, and how they are written."""
        self.layout.prop(self, "names")
        self.layout.label(text="clear, or mor and metres, with commas between; empty for none", icon="INFO")


CLASSES = (
    SynfogHook,
    SYNFOG_OT_add_fog,
    SYNFOG_OT_label,
    SYNFOG_OT_variants,
    *presets.CLASSES,
    *baking.CLASSES,
    *panel.CLASSES,
)
_registered = []


def find_pxr():
    """Let Python find the USD library that Blender has with it; `import bpy` without Blender leaves it off the path,
    and hooks then end the process.  Whether it is there.
    """
    packages = Path(bpy.utils.system_resource("SCRIPTS")).parent / "python" / "lib"
    sys.path += [str(folder) for folder in packages.glob("python3*/site-packages") if str(folder) not in sys.path]
    return importlib.util.find_spec("pxr") is not None


def register():
    """Called by Blender when the add-on is switched on."""
    found = find_pxr()  # `import bpy` 4.2 brings none; files then keep custom properties, which a bake reads too
    hooked = found and hasattr(bpy.types, "USDHook")  # Blenders of Linux distributions may be built without USD
    for one in CLASSES if hooked else CLASSES[1:]:
        bpy.utils.register_class(one)
        _registered.append(one)
    for owner, properties in baking.PROPERTIES.items():
        for name, one in properties.items():
            setattr(owner, name, one)


def unregister():
    """Called by Blender when the add-on is switched off."""
    for owner, properties in baking.PROPERTIES.items():
        for name in properties:
            delattr(owner, name)
    while _registered:
        bpy.utils.unregister_class(_registered.pop())
