"""What each way of demosaicing makes of a neutral edge and of even grey, through the shipped graphs, noise and all.

The edge is 8 : 1 in grey light of D65, metered, at five angles; its light on square pixels is the mean of 8 x 8 places.
Colour is CIELAB of the picture for the screen, contrast that of luminance behind the colour matrix.  A distortion is
left out, since a picture of the sensor's own size loses sharpness by it.  `python -m docs.studies.demosaicing` prints
the table of docs/measurements/camera.md.
"""

from __future__ import annotations

import math

import colour
import numpy as np

from synfog_usd import camera
from synfog_usd.base import resources
from synfog_usd.base.image import Image, Quantity

SRGB = colour.RGB_COLOURSPACES["sRGB"]
SIZE_PX, RIM_PX, NEAR_PX, BINS = 160, 16, 3.0, 4
ANGLES_DEG = (3.0, 20.0, 45.0, 70.0, 87.0)
TILTS_DEG = (5.0, 85.0)
BRIGHT_CD_M2 = 800.0


def distance_px(angle_deg: float, finer: int = 1) -> np.ndarray:
    """Of places from an edge through the middle, + on its bright side."""
    at = (np.arange(SIZE_PX * finer) + 0.5) / finer - SIZE_PX / 2
    return at[None, :] * math.cos(math.radians(angle_deg)) + at[:, None] * math.sin(math.radians(angle_deg))


def edge(angle_deg: float) -> Image:
    """The edge as it is metered and developed."""
    side = (distance_px(angle_deg, 8) > 0.0).reshape(SIZE_PX, 8, SIZE_PX, 8).mean(axis=(1, 3))
    plane = BRIGHT_CD_M2 * (1.0 + 7.0 * side) / 8.0
    return Image(
        plane.astype(np.float32)[..., None].repeat(3, axis=2),
        ("R", "G", "B"),
        Quantity.RADIANCE,
        provenance={"fov_x_deg": 1.0},
    )


def half_contrast(luminance: np.ndarray, angle_deg: float) -> float:
    """Frequency [cycles/pixel] at which the edge has half its contrast, after ISO 12233 with the angle known."""
    reach = 16
    place = np.floor(distance_px(angle_deg) * BINS).astype(int) + reach * BINS
    used = (place >= 0) & (place < 2 * reach * BINS)
    spread = np.bincount(place[used], weights=luminance[used]) / np.bincount(place[used])
    line = (spread[2:] - spread[:-2]) * np.hamming(spread.size - 2)
    f = np.arange(0.0, 1.0, 0.002)
    waves = np.exp(-2j * np.pi * np.outer(f, np.arange(line.size) / BINS))
    contrast = np.abs(waves @ line) / line.sum() / np.sinc(2 * f / BINS) / np.sinc(f / BINS)
    return float(f[np.argmax(contrast < 0.5)])


def measured(name: str, algorithm: str) -> tuple[float, ...]:
    """Figures of a camera with one way of demosaicing.

    Mean C*ab within 3 pixels of the edge; standard deviation of L* of even grey, and mean distance of its a*, b* from
    their mean, at the dark side; frequency at which half the contrast is left [cycles/pixel].
    """
    graph = camera.load_graph(resources.folder("pipeline") / f"{name}.yaml")
    graph = graph.without([node.name for op in ("optics.distortion", "isp.denoise") for node in graph.nodes_with(op)])
    graph = graph.with_overrides({"demosaic.algorithm": algorithm})

    def run(angle_deg: float) -> tuple[np.ndarray, np.ndarray]:
        """CIELAB and linear luminance."""
        image = edge(angle_deg)
        shown = graph.run(
            {"radiance": image}, seed=0, settings=camera.meter(image, graph).settings, keep=["colour", "srgb"]
        )
        screen = colour.RGB_to_XYZ(shown["srgb"].pixels.astype(np.float64), SRGB, apply_cctf_decoding=True)
        return colour.XYZ_to_Lab(screen, SRGB.whitepoint), shown["colour"].pixels @ np.array([0.2126, 0.7152, 0.0722])

    inner = np.zeros((SIZE_PX, SIZE_PX), dtype=bool)
    inner[RIM_PX:-RIM_PX, RIM_PX:-RIM_PX] = True
    chroma, noise, specks = [], [], []
    for angle_deg in ANGLES_DEG:
        lab, away = run(angle_deg)[0], distance_px(angle_deg)
        chroma.append(np.hypot(lab[..., 1], lab[..., 2])[inner & (np.abs(away) < NEAR_PX)].mean())
        dark = lab[inner & (away < -12.0)]
        noise.append(dark[:, 0].std())
        specks.append(np.hypot(*(dark[:, 1:] - dark[:, 1:].mean(axis=0)).T).mean())
    sharp = [half_contrast(run(tilt)[1], tilt) for tilt in TILTS_DEG]
    return tuple(float(np.mean(part)) for part in (chroma, noise, specks, sharp))


if __name__ == "__main__":
    for way in ("linear", "mhc", "directional"):
        for camera_name in ("phone", "dashcam", "automotive_hdr"):
            print(f"| {camera_name}, {way} |", " | ".join(f"{value:.3f}" for value in measured(camera_name, way)), "|")
