"""Blender add-on: fog, labels and variants for synfog-usd.

Install this file under Edit > Preferences > Add-ons > Install from Disk.  A tab "Synfog" in the
3D view's sidebar (N) puts a box of fog around the scene, gives it a visibility, and gives objects their
Cityscapes label.  File > Export > Universal Scene Description then writes them as synfog-usd and
other USD programs expect: an API schema on a guide prim, semantic labels, variant sets.

All that the panel sets are custom properties (synfog_mor [m], synfog_g, ..., cityscapes), so a scene
keeps them without the add-on.
"""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
from mathutils import Vector

bl_info = {
    "name": "Synfog: fog, labels and variants in USD",
    "author": "synfog-usd",
    "version": (1, 0, 0),
    "blender": (4, 2, 0),
    "location": "View3D > Sidebar > Synfog",
    "description": "Authors fog with a visibility, Cityscapes labels and variants for synfog-usd",
    "category": "Import-Export",
}

API = "SynFogMediumAPI"
FOG = {"mor": "float", "sigma_t": "float", "contrast": "float", "albedo": "float", "g": "float", "scaleHeight": "float", "dropletDiameter": "float",
       "angstrom": "float", "priority": "int", "enabled": "bool", "phase": "token", "profile": "token"}  # fmt: skip
"""Attributes of the schema and their USD types; custom properties are called synfog_<name>."""

LABELS = ("road", "sidewalk", "building", "wall", "fence", "guard rail", "bridge", "tunnel", "pole", "traffic light", "traffic sign", "vegetation", "terrain",
          "sky", "person", "rider", "car", "truck", "bus", "caravan", "trailer", "train", "motorcycle", "bicycle", "license plate")  # fmt: skip
VARIANTS = "synfog_variants"
"""Custom property of the scene: names of fogs, as 'clear,mor600,mor300,mor150'; empty for none."""

MARGIN_M = 20.0


# -- what is written


class SynfogHook(bpy.types.USDHook):
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
        author_variants(stage, fogs, [name.strip() for name in str(scene.get(VARIANTS, "")).split(",") if name.strip()])
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
    types = {"float": Sdf.ValueTypeNames.Float, "int": Sdf.ValueTypeNames.Int, "bool": Sdf.ValueTypeNames.Bool, "token": Sdf.ValueTypeNames.Token}
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
    prim.CreateAttribute("semantics:labels:cityscapes", Sdf.ValueTypeNames.TokenArray, False).Set(Vt.TokenArray([label]))


def author_variants(stage, fogs, names):
    """Variant sets 'fog' (visibilities of the fog) and 'lighting' ('sky' without lamps, 'active' with them) on the default prim."""
    from pxr import Sdf, UsdLux

    root = stage.GetDefaultPrim()
    if not root or not names:
        return
    wrong = [name for name in names if name != "clear" and not (name.startswith("mor") and name[3:].isdecimal() and int(name[3:]) > 0)]
    if wrong:
        print(f"Synfog: {', '.join(wrong)} are no fogs; write clear, or mor and metres, as mor150")
        return
    if fogs:
        for path in fogs:
            stage.GetPrimAtPath(path).RemoveProperty("synfog:fog:mor")  # a value on the prim itself would beat those of the variants
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
                        stage.OverridePrim(path).CreateAttribute("synfog:fog:mor", Sdf.ValueTypeNames.Float, False).Set(float(name[3:]))
        chosen.SetVariantSelection(names[-1])
    lamps = [prim.GetPath() for prim in stage.Traverse() if prim.HasAPI(UsdLux.LightAPI) and prim.GetTypeName() not in ("DomeLight", "DistantLight")]
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


class SYNFOG_OT_add_fog(bpy.types.Operator):
    """Put a box of fog around everything, the cameras included, with its bottom below the ground."""

    bl_idname = "synfog.add_fog"
    bl_label = "Add Fog Around Everything"
    bl_options = {"REGISTER", "UNDO"}

    mor: bpy.props.FloatProperty(name="Visibility (m)", default=150.0, min=1.0, soft_max=10000.0)

    def execute(self, context):
        """Make the box; its properties are custom properties of the object."""
        unit = context.scene.unit_settings.scale_length or 1.0
        corners = [thing.matrix_world @ Vector(corner) for thing in context.scene.objects if thing.type != "CAMERA" for corner in thing.bound_box]
        corners += [thing.matrix_world.translation for thing in context.scene.objects if thing.type in ("CAMERA", "LIGHT")]
        if not corners:
            self.report({"WARNING"}, "the scene is empty")
            return {"CANCELLED"}
        margin = MARGIN_M / unit
        low = Vector([min(corner[axis] for corner in corners) - (margin if axis < 2 else 1.0 / unit) for axis in range(3)])
        high = Vector([max(corner[axis] for corner in corners) + margin for axis in range(3)])
        bpy.ops.mesh.primitive_cube_add(size=1.0, location=(low + high) / 2.0, scale=high - low)
        box = context.active_object
        box.name = "Fog"
        box.display_type = "BOUNDS"
        box["synfog_mor"] = self.mor
        return {"FINISHED"}


class SYNFOG_OT_label(bpy.types.Operator):
    """Give the selected objects a Cityscapes label."""

    bl_idname = "synfog.label"
    bl_label = "Label Selected"
    bl_options = {"REGISTER", "UNDO"}

    label: bpy.props.EnumProperty(name="Label", items=[(name, name, "") for name in LABELS], default="car")

    def execute(self, context):
        """Set the custom property 'cityscapes'."""
        for thing in context.selected_objects:
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
        context.scene[VARIANTS] = self.names
        return {"FINISHED"}


class SYNFOG_PT_panel(bpy.types.Panel):
    """The tab in the sidebar."""

    bl_label = "Synfog"
    bl_idname = "SYNFOG_PT_panel"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Synfog"

    def draw(self, context):
        """Buttons, and the properties of the active object."""
        layout, thing = self.layout, context.active_object
        layout.operator("synfog.add_fog", icon="OUTLINER_OB_VOLUME")
        layout.operator("synfog.label", icon="BOOKMARKS")
        layout.operator("synfog.variants", icon="RENDERLAYERS")
        if thing is not None:
            for name in thing.keys():
                if name.startswith("synfog_") or name == "cityscapes":
                    layout.prop(thing, f'["{name}"]', text=name)
        if VARIANTS in context.scene:
            layout.prop(context.scene, f'["{VARIANTS}"]', text="fogs")


CLASSES = (SynfogHook, SYNFOG_OT_add_fog, SYNFOG_OT_label, SYNFOG_OT_variants, SYNFOG_PT_panel)


def find_pxr():
    """Let Python find the USD library that Blender has with it; `import bpy` without Blender leaves it off the path, and hooks then end the process."""
    packages = Path(bpy.utils.system_resource("SCRIPTS")).parent / "python" / "lib"
    sys.path += [str(folder) for folder in packages.glob("python3*/site-packages") if str(folder) not in sys.path]


def register():
    """Called by Blender when the add-on is switched on."""
    find_pxr()
    for one in CLASSES:
        bpy.utils.register_class(one)


def unregister():
    """Called by Blender when the add-on is switched off."""
    for one in reversed(CLASSES):
        bpy.utils.unregister_class(one)


if __name__ == "__main__":
    register()
