"""A menu "Synfog" for usdview: bake or preview what a camera of the stage sees, and show boxes of fog.

usdview finds it where PXR_PLUGINPATH_NAME and PYTHONPATH name this folder; see `synfog-usd plugin-path`.  The
stage is baked as it was saved, with the variants that are chosen in usdview, by the command that the variable
SYNFOG_USD names or that is on the path; what it says appears in the terminal.
"""

import os
import shutil
import subprocess
from pathlib import Path

from pxr import Tf, UsdGeom

try:
    from pxr.Usdviewq.plugin import PluginContainer
except ImportError:  # usd-core has no usdview
    PluginContainer = None

API = "SynFogMediumAPI"
OPACITY = 0.2
OWN_SETS = ("fog", "lighting")
"""Variant sets whose variants a bake makes into shots."""


def fog_boxes(stage):
    """Prims that carry fog: by the schema, its attributes, or custom properties of Blender."""
    return [
        prim
        for prim in stage.Traverse()
        if API in prim.GetPrimTypeInfo().GetAppliedAPISchemas()
        or any(name.startswith(("synfog:fog:", "userProperties:synfog_")) for name in prim.GetAuthoredPropertyNames())
    ]


def words(verb, stage, camera, frame):
    """The command line that draws what a camera sees, as lists of words.

    Args:
        verb: 'bake' or 'preview'.
        stage: opened from a file.
        camera: its path.
        frame: time code, or None for none.
    """
    file = stage.GetRootLayer().realPath
    line = [verb, file, "--camera", str(camera)]
    line += ["--out", str(Path(file).parent / "synfog" / f"{Path(file).stem}_{verb}")]
    if frame is not None and not frame.IsDefault():
        line += ["--frames", f"{frame.GetValue():g}"]
    for root in stage.GetPseudoRoot().GetChildren():
        sets = root.GetVariantSets()
        for name in OWN_SETS:
            if sets.HasVariantSet(name) and (chosen := sets.GetVariantSelection(name)):
                line += [f"--{name}", chosen]
    return [*line, *(f"--choose={choice}" for choice in chosen_here(stage))]


def chosen_here(stage):
    """Variants that are chosen on the session layer, those of fog and lighting aside: PRIM:SET=VARIANT each."""
    session, found = stage.GetSessionLayer(), []

    def visit(path):
        spec = session.GetPrimAtPath(path) if path.IsPrimPath() else None
        for name, variant in dict(spec.variantSelections).items() if spec else ():
            if name not in OWN_SETS or path.pathElementCount > 1:
                found.append(f"{path}:{name}={variant}")

    session.Traverse("/", visit)
    return found


def on_path(name):
    """As shutil.which, but never in the current folder, where Windows looks first and an empty entry of PATH points."""
    if Path(name).name != name:
        return shutil.which(name)
    endings = ["", *os.environ.get("PATHEXT", "").split(os.pathsep)] if os.name == "nt" else [""]
    folders = filter(os.path.isabs, os.environ.get("PATH", "").split(os.pathsep))
    tools = (shutil.which(str(Path(folder) / (name + ending))) for folder in folders for ending in endings)
    return next(filter(None, tools), None)


def environment():
    """Without what is set for usdview's own Python: the command's has its own packages."""
    return {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}


def draw(verb, usdview):
    """Start the command for the camera that usdview looks through; its process, or None with the reason as status."""
    stage, camera = usdview.stage, usdview.cameraPrim
    tool = on_path(os.environ.get("SYNFOG_USD", "") or "synfog-usd")
    if tool is None:
        usdview.PrintStatus("Synfog: synfog-usd is not on the path; name it by the variable SYNFOG_USD")
    elif not stage.GetRootLayer().realPath:
        usdview.PrintStatus("Synfog: the stage has no file yet; save it first")
    elif not camera:
        usdview.PrintStatus("Synfog: look through a camera of the stage first (menu Camera)")
    else:
        unsaved = [layer.GetDisplayName() for layer in stage.GetUsedLayers() if layer.dirty and not layer.anonymous]
        line = words(verb, stage, camera.GetPath(), usdview.frame)
        told = f" (as saved, without the changes of {', '.join(unsaved)})" if unsaved else ""
        usdview.PrintStatus(f"Synfog: pictures of {camera.GetPath()}{told} come to {line[line.index('--out') + 1]}")
        return subprocess.Popen([tool, *line], env=environment())
    return None


def show_fog(usdview):
    """Show or hide guides, and select the boxes of fog; a box without an opacity is shown faintly, on the session
    layer.
    """
    stage, settings = usdview.stage, usdview.dataModel.viewSettings
    settings.displayGuide = not settings.displayGuide
    boxes = fog_boxes(stage)
    usdview.ClearPrimSelection()
    session = stage.GetSessionLayer()
    before = stage.GetEditTarget()
    stage.SetEditTarget(session)
    try:
        for prim in boxes:
            usdview.AddPrimToSelection(prim)
            shape = UsdGeom.Gprim(prim)
            if shape and settings.displayGuide and not shape.GetDisplayOpacityAttr().HasAuthoredValue():
                shape.CreateDisplayOpacityAttr([OPACITY])
    finally:
        stage.SetEditTarget(before)
    usdview.PrintStatus(
        f"Synfog: {len(boxes)} boxes of fog, {'shown' if settings.displayGuide else 'hidden'} with all guides"
    )


class SynfogContainer(PluginContainer or object):
    """The menu."""

    def registerPlugins(self, registry, usdview):
        """Called by usdview: three commands."""
        self.commands = [
            registry.registerCommandPlugin(f"SynfogContainer.{name}", title, work, about)
            for name, title, work, about in (
                ("preview", "Preview This Camera", lambda api: draw("preview", api), "Every fog and light, small"),
                ("bake", "Bake This Camera", lambda api: draw("bake", api), "To radiance, RAW and sRGB"),
                ("fog", "Show Fog Boxes", show_fog, "With all guides, and selected"),
            )
        ]

    def configureView(self, registry, builder):
        """Called by usdview: a menu of them."""
        menu = builder.findOrCreateMenu("Synfog")
        for command in self.commands:
            menu.addItem(command)


if PluginContainer is not None:
    Tf.Type.Define(SynfogContainer)
