"""A ColorChecker at the centre and in the corner of what the shipped colour cameras see, by our own ISP.

The chart is 24 patches of 16 x 16 pixels in a picture of the whole field of view, 320 x 240 pixels of the sensor's
pitch.  A patch is the mean of its inner 8 x 8 pixels; of all of them, its edges count too, where the lens's blur,
lateral colour and demosaicing mix it with its neighbours.  The truth is colour-science's XYZ of the measured spectra
under D65.  Graphs are as they ship, noise and all, and metered; only the distortion is left out, which moves the chart
and changes no colour.  `python -m docs.studies.corner_colour` prints the table of docs/measurements/camera.md.
"""

from __future__ import annotations

import math

import colour
import numpy as np

from synfog_usd import camera
from synfog_usd.base import photometry, resources
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.exposure import meter
from synfog_usd.camera.profiles import LensProfile, SensorProfile

SRGB = colour.RGB_COLOURSPACES["sRGB"]
BANDS_NM = np.arange(385.0, 776.0, 10.0)
PATCH_PX, RIM_PX, HEIGHT_PX, WIDTH_PX = 16, 4, 240, 320
WATTS = 1.4e-4
"""W m-2 sr-1 nm-1 by which D65's table makes white of about 1000 cd m-2."""

CAMERAS = ("phone", "dashcam", "automotive_hdr", "staggered_hdr", "surround", "synfog")


def truth() -> np.ndarray:
    """(24, 3) XYZ, white of Y = 1."""
    with colour.utilities.suppress_warnings(colour_runtime_warnings=True):  # it interpolates its own tables
        light, chart = colour.SDS_ILLUMINANTS["D65"], colour.SDS_COLOURCHECKERS["ISO 17321-1"]
        return np.array([colour.sd_to_XYZ(patch, illuminant=light) for patch in chart.values()]) / 100


def radiance(provenance: dict[str, float]) -> Image:
    """Charts at the centre and in the upper left corner, before grey of 18 %."""
    tables = (colour.SDS_ILLUMINANTS["D65"], *colour.SDS_COLOURCHECKERS["ISO 17321-1"].values())
    light, *patches = (np.interp(BANDS_NM, table.wavelengths, table.values) for table in tables)
    lit = (np.array(patches) * light).reshape(4, 6, -1) * WATTS
    chart = np.repeat(np.repeat(lit, PATCH_PX, axis=0), PATCH_PX, axis=1).astype(np.float32)
    pixels = np.empty((HEIGHT_PX, WIDTH_PX, BANDS_NM.size), dtype=np.float32)
    pixels[:] = 0.18 * WATTS * light
    high, wide = chart.shape[:2]
    for top, left in (places := (((HEIGHT_PX - high) // 2, (WIDTH_PX - wide) // 2), (0, 0))):
        pixels[top : top + high, left : left + wide] = chart
    assert places[0][0] > high
    names = tuple(photometry.band_name(centre) for centre in BANDS_NM)
    return Image(pixels, names, Quantity.RADIANCE, provenance=provenance)


def patches(linear: np.ndarray, top: int, left: int, rim: int) -> np.ndarray:
    """(24, 3) XYZ of the means of a chart's patches within a rim."""
    chart = linear[top : top + 4 * PATCH_PX, left : left + 6 * PATCH_PX].astype(np.float64)
    inner = chart.reshape(4, PATCH_PX, 6, PATCH_PX, 3)[:, rim : PATCH_PX - rim, :, rim : PATCH_PX - rim]
    means = inner.mean(axis=(1, 3)).reshape(24, 3)
    return np.asarray(means @ SRGB.matrix_RGB_to_XYZ.T)


def difference(xyz: np.ndarray) -> float:
    """CIEDE2000 to the truth, mean of 24 patches (24, 3)."""
    labs = (colour.XYZ_to_Lab(part, SRGB.whitepoint) for part in (truth(), xyz))
    return float(np.mean(colour.delta_E(*labs, method="CIE 2000")))


def measured(name: str) -> list[float]:
    """CIEDE2000, mean of 24 patches.

    At the centre; in the corner, as bright as the centre's exposure leaves it; there with a brightness of its own, so
    that colour alone counts; and the first and the last again with the patches' edges.
    """
    graph = camera.load_graph(resources.folder("pipeline") / f"{name}.yaml")
    lens, chip = graph.profiles["lens"], graph.profiles["sensor"]
    assert isinstance(lens, LensProfile) and isinstance(chip, SensorProfile)
    half = chip.width_px * chip.pixel_pitch_um * 0.5e-3 / lens.focal_length_mm
    image = radiance({} if lens.fisheye else {"fov_x_deg": 2.0 * math.degrees(math.atan(half))})
    graph = graph.without([node.name for node in graph.nodes_with("optics.distortion")])
    shots = dict.fromkeys(graph.inputs, image)
    last = graph.nodes_with("isp.colour_correct")[-1].name
    linear = graph.run(shots, seed=0, settings=meter(image, graph).settings, until=last)[last].pixels
    values: list[float] = []
    for rim in (RIM_PX, 0):
        centre = patches(linear, (HEIGHT_PX - 4 * PATCH_PX) // 2, (WIDTH_PX - 6 * PATCH_PX) // 2, rim)
        corner = patches(linear, 0, 0, rim)
        scale, own = (truth()[:, 1].sum() / place[:, 1].sum() for place in (centre, corner))
        values += [difference(centre * scale), difference(corner * scale), difference(corner * own)]
    return [*values[:4], values[5]]


if __name__ == "__main__":
    for camera_name in CAMERAS:
        print(f"| {camera_name} |", " | ".join(f"{value:.2f}" for value in measured(camera_name)), "|")
