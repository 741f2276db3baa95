"""What to set so that other programs know the fog schema, and where the add-ons for them lie."""

from __future__ import annotations

import json
import sys
import zipfile
from pathlib import Path
from typing import Any

from synfog_usd.base import resources
from synfog_usd.base.errors import OutputError
from synfog_usd.base.files import write_whole

SCHEMA = resources.schema_plugin()
"""Folder with the codeless USD schema SynFogMediumAPI."""


def advice() -> str:
    """One paragraph for each program."""
    tools = resources.folder("integrations")
    return f"""\
The schema SynFogMediumAPI is codeless: a program that knows its folder shows the fog attributes with their
defaults and documentation. Without it files keep their fog all the same.

usdview, usdcat and other USD tools, and Omniverse (Kit), before they start:
  {_setting("PXR_PLUGINPATH_NAME", SCHEMA)}

Houdini, a line in houdini.env:
  PXR_PLUGINPATH_NAME = "{SCHEMA};&"

Houdini's Python Script LOP and Omniverse's Script Editor make a box of fog of what stands in this file:
  {tools / "fog_box.py"}

Blender (4.2 and newer) does not read USD schemas; pack its extension, and install the file under
Preferences > Get Extensions > Install from Disk:
  synfog-usd plugin-path --blender synfog_fog.zip

OpenVDB volumes of any of them become fog by way of
  blender --background --python {tools / "vdb2npz.py"} -- FILE.vdb"""


def _setting(name: str, folder: Path) -> str:
    """The line by which this system's shell puts a folder before those that a variable names; without an empty entry
    where it names none, since that is the current folder.
    """
    if sys.platform == "win32":
        return f'if defined {name} (set "{name}={folder};%{name}%") else (set "{name}={folder}")'
    return f'export {name}="{folder}${{{name}:+:${name}}}"'


def pack_extension(path: Path) -> None:
    """Write Blender's extension as the .zip that it installs; the same bytes each time.

    Raises:
        OutputError: the file's name does not end in .zip, or it cannot be written.
    """
    if path.suffix.lower() != ".zip":
        raise OutputError(f"--blender {path}: Blender installs a .zip; name the file synfog_fog.zip")
    folder = resources.folder("integrations") / "blender" / "synfog_fog"

    def put(archive: zipfile.ZipFile, name: str, data: bytes) -> None:
        archive.writestr(zipfile.ZipInfo(name, (2026, 1, 1, 0, 0, 0)), data)

    def pack(place: Path) -> None:
        with zipfile.ZipFile(place, "w", zipfile.ZIP_DEFLATED) as archive:
            for file in sorted([*folder.glob("*.py"), folder / "blender_manifest.toml"]):
                put(archive, file.name, file.read_bytes())
            put(archive, "sensors.json", (json.dumps(camera_presets(), indent=2) + "\n").encode())

    write_whole(path, pack)


def camera_presets() -> dict[str, dict[str, Any]]:
    """Every shipped sensor with the lens that a shipped graph gives it, else that of its own name.

    Returns:
        name -> 'title', 'about', 'sensor_width_mm', 'sensor_height_mm', 'focal_length_mm', 'f_number', 'width_px',
            'height_px'.
    """
    from synfog_usd.base.yamlio import load_file
    from synfog_usd.camera.profiles import load_lens, load_sensor, shipped

    graphs = [load_file(path).value for path in sorted(resources.folder("pipeline").glob("*.yaml"))]
    lens_of = {graph["sensor"].value: graph["lens"].value for graph in graphs if {"sensor", "lens"} <= graph.keys()}
    presets = {}
    for name in shipped("sensors"):
        sensor, lens = load_sensor(name), load_lens(lens_of.get(name, name))
        size = [round(pixels * sensor.pixel_pitch_um / 1000.0, 6) for pixels in (sensor.width_px, sensor.height_px)]
        presets[name] = {
            "title": sensor.title.partition(",")[0],
            "about": f"{sensor.title}: {size[0]:.2f} x {size[1]:.2f} mm, {lens.title}",
            "sensor_width_mm": size[0],
            "sensor_height_mm": size[1],
            "focal_length_mm": lens.focal_length_mm,
            "f_number": lens.f_number,
            "width_px": sensor.width_px,
            "height_px": sensor.height_px,
        }
    return presets
