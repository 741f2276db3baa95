"""Two skies as lat-long pictures: an overcast noon and a clear dusk after sunset.

Luminances relative to the dome's intensity; row 0 is the zenith.  The dome's own
axes: centre of the picture is +Z, a quarter from the left is +X, up is +Y.  The
lights of `crossroads` turn +Y to the zenith, so that the left edge of the picture
lies ahead of the camera.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import OpenImageIO
from scipy import ndimage

from synfog_usd.errors import OutputError
from synfog_usd.files import write_whole
from synfog_usd.world.textures import ORIGIN, noise

Array = npt.NDArray[np.float64]
SIZE = (512, 1024)
OVERCAST_NITS = 5000.0  # at the zenith
DUSK_NITS = 5.0


def write_skies(folder: Path) -> list[Path]:
    """Write both skies into `folder` as half-float EXR; gives the files."""
    skies = {"overcast.exr": overcast(), "dusk.exr": dusk()}
    return [_write(folder / name, picture) for name, picture in skies.items()]


def overcast() -> Array:
    """CIE overcast sky, L = Lz (1 + 2 sin h) / 3, under a textured layer of cloud; 1 at the zenith on average."""
    azimuth, height = _directions()
    base = (1 + 2 * np.sin(np.maximum(height, 0))) / 3
    cloud = _layer(azimuth, height, "overcast", 0, 2.6) * 0.75 + _layer(azimuth, height, "overcast", 1, 1.9) * 0.25
    luminance = base * np.clip(1 + 0.15 * cloud, 0.6, 1.5)
    brighter = 1 + 0.14 * np.cos(azimuth - 0.7) * np.cos(height)  # where the sun is behind the cloud
    tint = np.stack([0.975 + 0.02 * cloud, np.ones_like(cloud), 1.06 - 0.03 * cloud], axis=-1)
    sky = (luminance * brighter)[..., None] * np.clip(tint, 0.8, 1.2)
    return np.where(height[..., None] > 0, sky, 0.035 * np.ones(3))


def dusk() -> Array:
    """A quarter of an hour after sunset ahead: blue above, a low band of orange, thin streaks of cloud."""
    azimuth, height = _directions()
    up = np.clip(np.sin(np.maximum(height, 0)), 0, 1)
    towards = 0.5 + 0.5 * np.cos(azimuth)
    zenith, rim = np.array([0.34, 0.52, 1.12]), np.array([0.72, 0.78, 1.05])
    sky = zenith + (rim - zenith) * (np.exp(-4.0 * up) * (0.45 + 0.75 * towards))[..., None]
    sky = sky + np.array([2.7, 1.15, 0.36]) * (np.exp(-9.0 * up) * towards**3)[..., None] * 1.2
    streak = _layer(azimuth, height, "dusk", 0, 2.5)
    cover = np.clip(0.35 + 0.5 * streak, 0, 1)[..., None] * (1 - np.exp(-8 * up))[..., None]
    cloud = np.array([0.42, 0.44, 0.62]) + np.array([1.2, 0.5, 0.35]) * (towards**2 * np.exp(-3 * up))[..., None]
    sky = sky * (1 - 0.65 * cover) + 0.65 * cover * cloud
    return np.where(height[..., None] > 0, sky, 0.03 * np.ones(3))


def _directions() -> tuple[Array, Array]:
    """Angle from straight ahead (the picture's left edge) and height above the horizon [rad]."""
    h, w = SIZE
    height = np.pi / 2 - (np.arange(h) + 0.5) / h * np.pi
    azimuth = (np.arange(w) + 0.5) / w * 2 * np.pi
    grid = np.meshgrid(height, azimuth, indexing="ij")
    return grid[1], grid[0]


def _layer(azimuth: Array, height: Array, name: str, index: int, beta: float) -> Array:
    """Noise on a flat layer overhead, seen in perspective; fades to its mean at the horizon."""
    field = noise((512, 512), beta, "sky", name, index, low=2, high=120)
    flat = 1.0 / (np.sin(np.maximum(height, 0.0)) + 0.09)
    x, y = 62 * flat * np.cos(azimuth) * np.cos(height), 62 * flat * np.sin(azimuth) * np.cos(height)
    value = ndimage.map_coordinates(field, [x, y], order=1, mode="grid-wrap")
    return value * np.clip(height / 0.25, 0, 1)


def _write(path: Path, picture: Array) -> Path:
    rounded = np.round(picture * 512) / 512  # fewer bits to store; 0.2 % of the zenith
    pixels = np.ascontiguousarray(rounded.astype(np.float16))

    def put(target: Path) -> None:
        spec = OpenImageIO.ImageSpec(pixels.shape[1], pixels.shape[0], 3, "half")
        spec.attribute("compression", "zip")
        spec.attribute("whiteLuminance", 1.0)
        spec.attribute("ImageDescription", ORIGIN)
        spec.attribute("DateTime", "2000:01:01 00:00:00")  # else the hour of writing would change the bytes
        output = OpenImageIO.ImageOutput.create(str(target))
        if output is None or not output.open(str(target), spec) or not output.write_image(pixels) or not output.close():
            raise OutputError(f"{path}: cannot be written; choose another output folder")

    write_whole(path, put)
    return path
