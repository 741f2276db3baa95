"""What to set so that other programs know the fog schema, and where the add-ons for them lie."""

from __future__ import annotations

from synfog_usd import resources

SCHEMA = resources.schema_plugin()
"""Folder with the codeless USD schema SynFogMediumAPI."""


def advice() -> str:
    """One paragraph for each program."""
    tools = resources.folder("integrations")
    return f"""\
The schema SynFogMediumAPI is codeless: a program that is told of its folder shows the fog attributes with their
defaults and documentation. Without it files keep their fog all the same.

usdview, usdcat and other USD tools, before they start:
  export PXR_PLUGINPATH_NAME={SCHEMA}:$PXR_PLUGINPATH_NAME

Houdini, a line in houdini.env:
  PXR_PLUGINPATH_NAME = "{SCHEMA};&"

Omniverse (Kit), before it starts; on Windows with ';' in place of ':':
  export PXR_PLUGINPATH_NAME={SCHEMA}:$PXR_PLUGINPATH_NAME

Blender does not read USD schemas; install its add-on under Preferences > Add-ons > Install from Disk:
  {tools / "blender" / "synfog_fog.py"}

OpenVDB volumes of any of them become fog by way of
  blender --background --python {tools / "vdb2npz.py"} -- FILE.vdb"""
