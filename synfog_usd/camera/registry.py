"""The ops that this camera knows; `optics`, `sensor` and `isp` fill it."""

from __future__ import annotations

from pathlib import Path

from synfog_usd.camera import profiles
from synfog_usd.camera.graph import Auto, Registry
from synfog_usd.camera.graph.op import Profile

FOV = Auto(hint="say the picture's field of view: --fov DEGREES, or the camera's attributes in the EXR")
"""A field of view that the image says, or the run."""

OPS = Registry()
"""Read-only once `synfog_usd.camera` is imported; `Registry(OPS)` starts an own one."""


def _sensor(reference: str, folder: Path) -> Profile:
    return profiles.load_sensor(reference, folder)


def _lens(reference: str, folder: Path) -> Profile:
    return profiles.load_lens(reference, folder)


OPS.profile("sensor", _sensor)
OPS.profile("lens", _lens)
