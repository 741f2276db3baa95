"""What to set so that other programs know the fog schema, and where the add-ons for them lie."""

from __future__ import annotations

import zipfile
from pathlib import Path

from synfog_usd import resources
from synfog_usd.errors import OutputError
from synfog_usd.files import write_whole

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

Blender (4.2 and newer) does not read USD schemas; pack its extension, and install the file under
Preferences > Get Extensions > Install from Disk:
  synfog-usd plugin-path --blender synfog_fog.zip

OpenVDB volumes of any of them become fog by way of
  blender --background --python {tools / "vdb2npz.py"} -- FILE.vdb"""


def pack_extension(path: Path) -> None:
    """Write Blender's extension as the .zip that it installs; the same bytes each time.

    Raises:
        OutputError: the file's name does not end in .zip, or it cannot be written.
    """
    if path.suffix.lower() != ".zip":
        raise OutputError(f"--blender {path}: Blender installs a .zip; name the file synfog_fog.zip")
    folder = resources.folder("integrations") / "blender" / "synfog_fog"

    def pack(place: Path) -> None:
        with zipfile.ZipFile(place, "w", zipfile.ZIP_DEFLATED) as archive:
            for name in ("__init__.py", "blender_manifest.toml"):
                archive.writestr(zipfile.ZipInfo(name, (2026, 1, 1, 0, 0, 0)), (folder / name).read_bytes())

    write_whole(path, pack)
