"""Contrast that the lenses of shipped cameras leave, at centre, half field and corner of 160 x 120 pixels.

Waves of 10 % go in as each pixel averages them, through all nodes before the sensor.  Theory: the pixel, the aperture's
disc, the lens's own spot, and what veiling glare takes, multiplied.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from synfog_usd import camera
from synfog_usd.base import photometry, resources
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import distortion
from synfog_usd.camera.graph import NodeGraph

pytestmark = pytest.mark.physics

GRAPHS = (
    "phone",
    "dashcam",
    "automotive_hdr",
    "staggered_hdr",
    "machine_vision_mono",
    "linear_exr",
    "surround",
    "synfog",
)
CHANNELS = tuple(photometry.band_name(centre) for centre in (549.0, 550.0, 551.0))
WAVE_UM = 0.550
TAKEN = distortion.Pinhole(120, 160, 50.0, (0.0, 0.0))
SURROUND = (960, 1280)
PLACES = {"centre": (0.5, 0.5), "half field": (0.25, 0.25), "corner": (0.0, 0.0)}
"""Parts of the picture's height and width; its rim keeps `RIM_PX` away."""

RIM_PX = 12
CYCLES = (0.1, 0.25, 0.4)


def size(graph: NodeGraph) -> tuple[int, int]:
    """Height and width of the picture that is taken: a fisheye's own, whose spots change from pixel to pixel else."""
    return SURROUND if graph.nodes_with("optics.fisheye") else (TAKEN.height_px, TAKEN.width_px)


def radiance(graph: NodeGraph, cycles: float, down: bool) -> Image:
    """A wave of so many cycles per pixel that is taken, as what is rendered averages it, with a bake's provenance."""
    if not graph.nodes_with("optics.distortion"):
        height, width = size(graph)
        along = np.arange(height)[:, None] if down else np.arange(width)[None, :]
        wave = 1.0 + 0.1 * np.sinc(cycles) * np.cos(2 * np.pi * cycles * along) + np.zeros((height, width))
        view = {} if graph.nodes_with("optics.fisheye") else {"fov_x_deg": TAKEN.fov_x_deg}
        return Image(
            np.repeat(wave[..., None], 3, axis=2).astype(np.float32), CHANNELS, Quantity.RADIANCE, provenance=view
        )
    shown = distortion.to_render(graph, TAKEN)
    k1, k2, *none = graph.profiles["lens"].distortion
    assert not any(none)
    x, y = (
        ((np.arange(length * 6) + 0.5) / 6 - 0.5 - middle) / shown.focal_px
        for length, middle in zip((shown.width_px, shown.height_px), shown.axis_px, strict=True)
    )
    r2 = x[None, :] ** 2 + y[:, None] ** 2
    bent = (y[:, None] if down else x[None, :]) * (1.0 + k1 * r2 + k2 * r2**2)
    wave = 1.0 + 0.1 * np.cos(2 * np.pi * cycles * (bent * TAKEN.focal_px + TAKEN.axis_px[1 if down else 0]))
    wave = wave.reshape(shown.height_px, 6, shown.width_px, 6).mean(axis=(1, 3))
    view = {"fov_x_deg": shown.fov_x_deg, "shift_x": shown.shift[0], "shift_y": shown.shift[1]}
    view["view"] = [TAKEN.height_px, TAKEN.width_px, TAKEN.fov_x_deg, *TAKEN.shift]
    return Image(np.repeat(wave[..., None], 3, axis=2).astype(np.float32), CHANNELS, Quantity.RADIANCE, provenance=view)


def contrast(plane: np.ndarray, place: tuple[int, int], cycles: float, down: bool) -> float:
    """Of the wave in the 20 x 20 pixels around a place, by least squares; brightness may slope."""
    rows, columns = (np.arange(middle - 10, middle + 10) for middle in place)
    patch = plane[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1].astype(np.float64)
    y, x = np.meshgrid(rows, columns, indexing="ij")
    phase = 2 * np.pi * cycles * (y if down else x)
    terms = [np.ones_like(phase), y - place[0], x - place[1], np.cos(phase), np.sin(phase)]
    found = np.linalg.lstsq(np.stack([term.ravel() for term in terms], axis=1), patch.ravel(), rcond=None)[0]
    return float(np.hypot(*found[3:]) / found[0]) / 0.1


def spots(graph: NodeGraph, place: tuple[int, int], down: bool) -> float:
    """Standard deviation [px] along rows or columns of the spot that the lens's table tells there."""
    if not graph.nodes_with("optics.aberrations"):
        return 0.0
    lens, pitch_um = graph.profiles["lens"], graph.profiles["sensor"].pixel_pitch_um
    height, width = size(graph)
    y, x = place[0] - (height - 1) / 2, place[1] - (width - 1) / 2
    angles = np.linspace(0.0, 2.2, 2201)
    radius = sum(c * angles ** (power + 1) for power, c in enumerate(lens.fisheye))
    radius *= width / 2 / np.interp(math.radians(lens.fisheye_fov_x_deg / 2), angles, radius)
    angle_deg = math.degrees(np.interp(math.hypot(x, y), radius, angles))
    along, across = (
        np.interp(angle_deg, lens.aberration_field_deg, um) for um in (lens.tangential_um, lens.sagittal_um)
    )
    part = (y if down else x) ** 2 / (x * x + y * y)
    return math.sqrt(part * along**2 + (1.0 - part) * across**2) / pitch_um


@pytest.mark.parametrize("name", GRAPHS)
def test_a_shipped_camera_is_as_sharp_as_its_lens(name):
    """Within 0.01, across and down."""
    graph = camera.load_graph(resources.folder("pipeline") / f"{name}.yaml")
    graph = graph.with_overrides({f"{node.name}.falloff": "none" for node in graph.nodes_with("optics.irradiance")})
    lens, chip = graph.profiles["lens"], graph.profiles["sensor"]
    last = [node.name for node in graph.nodes.values() if node.op.name.startswith("optics.")][-1]
    found, wanted = {}, {}
    for cycles in CYCLES:
        v = WAVE_UM * lens.f_number / chip.pixel_pitch_um * cycles
        sharp = np.sinc(cycles) * 2 / math.pi * (math.acos(v) - v * math.sqrt(1 - v * v))
        spot_um = graph.nodes_with("optics.diffraction")[0].params["spot_um"].value
        sharp *= math.exp(-2 * (math.pi * spot_um / chip.pixel_pitch_um * cycles) ** 2)
        sharp *= 1.0 - (lens.glare_fraction if graph.nodes_with("optics.glare") else 0.0)
        for down in (False, True):
            image = radiance(graph, cycles, down)
            out = graph.run(dict.fromkeys(graph.inputs, image), seed=0, until=last)[last]
            assert out.pixels.shape == (*size(graph), 3)
            for where, parts in PLACES.items():
                place = tuple(max(RIM_PX, int(part * length)) for part, length in zip(parts, size(graph), strict=True))
                key = cycles, where, "down" if down else "across"
                found[key] = contrast(out.pixels[..., 1], place, cycles, down)
                wanted[key] = sharp * math.exp(-2 * (math.pi * spots(graph, place, down) * cycles) ** 2)
    print(f"\n{name}", *(f"{key}: {value:.3f} ({wanted[key]:.3f})" for key, value in found.items()), sep="\n  ")
    assert found == pytest.approx(wanted, abs=0.01)
