"""How the camera was checked, drawn: photon transfer, noise in fog, sharpness, colour.

From a shell: `python -m docs.studies.camera docs/images` draws the four pictures
of docs/measurements/camera.md anew.  Takes shipped graphs and profiles; what the tests in
`tests/physics` hold to a bound is computed here or in `study.bench`.
"""

from __future__ import annotations

import contextlib
import io
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from docs.studies.sensor_bench import photon_transfer, readings, transfer
from synfog_usd import camera
from synfog_usd.base import files, photometry, resources, seeds
from synfog_usd.base.arrays import Array
from synfog_usd.base.colour import LUMINANCE
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import cfa, response
from synfog_usd.camera.profiles import LensProfile, SensorProfile, load_sensor, shipped
from synfog_usd.lab import drawing

# ---- noise and fog ---------------------------------------------------------------------

WALL_M = 100.0
"""Distance of the wall that is photographed through fog."""

FOGS_M = (math.inf, 600.0, 300.0, 150.0)
"""Meteorological optical range of the air before it."""


def wall_in_fog(visibility_m: float, *, size: tuple[int, int] = (480, 320)) -> Image:
    """Radiance of a brick wall at `WALL_M` under an overcast sky, seen through even fog.

    L = T L_wall + (1 - T) L_air with T = exp(-ln(20) d / V); the air is as bright as
    a white wall, 3000 cd m-2.

    Source: Koschmieder (1924), at the 5 % contrast of WMO-No. 8.
    """
    width, height = size
    rows, columns = np.mgrid[:height, :width]
    course = rows // 20
    shifted = columns + 20 * (course % 2)
    brick = seeds.stream(0, "study", "wall").random((height // 20 + 1, width // 40 + 2))[course, shifted // 40]
    joint = (rows % 20 < 2) | (shifted % 40 < 2)
    reflectance = np.where(joint[..., None], 0.55, (0.15 + 0.25 * brick)[..., None] * (1.15, 1.0, 0.85))
    passed = math.exp(-math.log(20.0) * WALL_M / visibility_m)
    pixels = 3000.0 * (passed * reflectance + 1.0 - passed)
    return Image(pixels.astype(np.float32), ("R", "G", "B"), Quantity.RADIANCE, provenance={"fov_x_deg": 20.0})


def frames_in_fog(visibility_m: float, *, count: int, quiet: bool = False) -> Array:
    """(N, H, W, 3) pictures of the wall, 8 bits as 0 to 1, by the phone without its denoising; exposed for clear air,
    each with its own temporal noise.

    Args:
        visibility_m: see `wall_in_fog`.
        count: N.
        quiet: the phone without temporal noise.
    """
    graph = camera.load_graph(resources.folder("pipeline") / "phone.yaml").without(["denoise"])
    settings = camera.meter(wall_in_fog(math.inf), graph).settings
    if quiet:
        graph = graph.without(["shot_noise", "read_noise", "adc_noise", "black_clamp"])
    radiance = {"radiance": wall_in_fog(visibility_m)}
    runs = (graph.run(radiance, seed=seed, settings=settings, until="srgb", keep=["srgb"]) for seed in range(count))
    return np.array([np.rint(255.0 * run["srgb"].pixels) / 255.0 for run in runs], dtype=np.float64)


def stretched(frames: Array, like: Array, *, window_px: int = 61, deviation: float = 0.2) -> Array:
    """Frames with the contrast of every region brought to the same size: y = 0.5 + deviation (x - m) / s.

    m and s are mean and standard deviation of the luma of `like` in a square around
    the pixel: one map for all frames, of the scene and not of its noise.

    Args:
        frames: (N, H, W, 3).
        like: (H, W, 3), the same without noise.
        window_px: side of the square [px].
        deviation: standard deviation of every region afterwards [1].
    """
    from scipy.ndimage import uniform_filter

    luma = like @ LUMINANCE
    mean = uniform_filter(luma, window_px)
    spread = np.sqrt(np.maximum(uniform_filter(luma**2, window_px) - mean**2, 1e-12))
    return np.asarray(0.5 + deviation * (frames - mean[..., None]) / spread[..., None])


def noise(frames: Array) -> Array:
    """(N / 2,) temporal noise of each pair of frames: RMS of their difference over the square root of 2."""
    return np.asarray(np.sqrt(np.mean((frames[0::2] - frames[1::2]) ** 2, axis=(1, 2, 3)) / 2.0))


# ---- sharpness -------------------------------------------------------------------------

TILT = math.radians(5.0)
CAMERAS = ("phone", "dashcam", "automotive_hdr", "machine_vision_mono")


def slanted_edge(pipeline: str) -> tuple[Array, Array, Array]:
    """Contrast that the lens and the pixels of a shipped camera leave, after ISO 12233, in light of 550 nm.

    Returns:
        frequency [cycles/pixel] up to 0.5, contrast found, and by theory: a disc's
        diffraction times the lens's own spot and the pixel's square.
    """
    graph = camera.load_graph(resources.folder("pipeline") / f"{pipeline}.yaml")
    height, width, reach, bins = 200, 150, 30, 4
    fine = (np.arange(12) + 0.5) / 12 - 0.5
    across = (np.arange(width) - (width - 1) / 2)[None, :, None, None] + fine
    down = (np.arange(height) - (height - 1) / 2)[:, None, None, None] + fine[:, None]
    edge = 1.0 + 2.0 * (across * math.cos(TILT) + down * math.sin(TILT) > 0.0).mean(axis=(2, 3))
    names = tuple(photometry.band_name(centre) for centre in (549.0, 550.0, 551.0))
    light = Image(
        np.repeat(edge[..., None].astype(np.float32), 3, axis=2),
        names,
        Quantity.RADIANCE,
        provenance={"fov_x_deg": 1.0},
    )
    picture = graph.run({"radiance": light}, seed=0, overrides={"diffraction.mode": "band"}, until="diffraction")[
        "diffraction"
    ].pixels[..., 1]
    distance = across[..., 0, 0] * math.cos(TILT) + down[..., 0, 0] * math.sin(TILT)
    place = np.floor(distance * bins).astype(int) + reach * bins
    used = (place >= 0) & (place < 2 * reach * bins)
    spread = np.bincount(place[used], weights=picture[used]) / np.bincount(place[used])
    line = (spread[2:] - spread[:-2]) * np.hamming(spread.size - 2)
    f = np.fft.rfftfreq(line.size, 1 / bins)
    found = np.abs(np.fft.rfft(line))
    found /= found[0] * np.sinc(2 * f / bins) * np.sinc(f / bins)  # the difference over two bins, and the bins
    lens, chip = graph.profiles["lens"], graph.profiles["sensor"]
    assert isinstance(lens, LensProfile) and isinstance(chip, SensorProfile)
    v = np.minimum(f * 0.550 * lens.f_number / chip.pixel_pitch_um, 1.0)
    theory = (
        2
        / math.pi
        * (np.arccos(v) - v * np.sqrt(1 - v * v))
        * np.exp(-2 * (math.pi * lens.spot_um / chip.pixel_pitch_um * f) ** 2)
        * np.sinc(f * math.cos(TILT))
        * np.sinc(f * math.sin(TILT))
    )
    wanted = f <= 0.5
    return (
        np.asarray(f[wanted], np.float64),
        np.asarray(found[wanted], np.float64),
        np.asarray(theory[wanted], np.float64),
    )


# ---- drawings --------------------------------------------------------------------------

LIGHTS = {"D65": "daylight, D65", "A": "tungsten, A", "LED": "white LED, LED-B3", "HPS": "sodium, HP1"}
COLOURS = ("#0b5fa5", "#c1440e", "#12805c", "#7a4fa3")


def draw(folder: Path) -> list[Path]:
    """Draw everything, as PNG in a folder; the paths."""
    kinds = {"transfer": draw_transfer, "noise_fog": draw_fog, "mtf": draw_sharpness, "colour": draw_colour}
    paths = []
    for name, drawn in kinds.items():
        paths.append(folder / f"camera_{name}.png")
        files.write_bytes(paths[-1], drawn())
    return paths


def draw_transfer() -> bytes:
    """Variance against mean of every reading, measured and by theory: PNG."""
    found = readings()
    rows = math.ceil(len(found) / 3)
    with _figure(3, rows, (11.0, 2.6 * rows)) as (figure, grid):
        for axes in grid.flat[len(found) :]:
            axes.set_visible(False)
        for axes, (name, reading) in zip(grid.flat, found.items(), strict=False):
            part = np.concatenate([np.geomspace(1e-3, 0.85, 14), np.linspace(0.9, 1.1, 11)])
            mean, variance = photon_transfer(reading, (part * reading.saturation_e).tolist())
            smooth = np.concatenate([np.geomspace(5e-4, 0.85, 60), np.linspace(0.86, 1.12, 60)]) * reading.saturation_e
            line = transfer(reading, smooth)
            axes.loglog(*line, color=COLOURS[0], lw=1.2, label="theory, from the profile")
            axes.loglog(
                mean[variance > 0],
                variance[variance > 0],
                "o",
                color=COLOURS[1],
                ms=3.5,
                label="measured, two frames a level",
            )
            dark = (reading.gain_dn_e * reading.dark_noise_e) ** 2 + (1 / 12 if reading.dark_noise_e else 0.0)
            axes.set_ylim(max(0.3 * line[1].min(), 0.1 * max(dark, 0.5)), 4 * line[1].max())
            axes.set_title(name, loc="left", fontsize=10, fontweight="bold")
            text = (
                f"K {reading.gain_dn_e:.3g} DN/e-\ndark {reading.dark_noise_e:.3g} e-\nfull "
                f"{reading.saturation_e:,.0f} e-"
            )
            axes.annotate(text, (0.04, 0.95), xycoords="axes fraction", va="top", fontsize=8.5, color=drawing.FAINT)
        figure.supxlabel("mean above black [DN]", fontsize=10)
        figure.supylabel("temporal variance [DN²]", fontsize=10)
        figure.legend(
            *grid.flat[0].get_legend_handles_labels(), loc="outside upper center", ncols=2, frameon=False, fontsize=9
        )
        return _png(figure)


def draw_fog() -> bytes:
    """The wall in ever thicker fog, contrast stretched, and its noise: PNG."""
    seen = {visibility_m: frames_in_fog(visibility_m, count=8) for visibility_m in FOGS_M}
    brought = [
        stretched(frames, frames_in_fog(visibility_m, count=1, quiet=True)[0]) for visibility_m, frames in seen.items()
    ]
    names = ["clear" if math.isinf(visibility_m) else f"MOR {visibility_m:.0f} m" for visibility_m in FOGS_M]
    with _figure(4, 3, (11.0, 8.6), height_ratios=(1.0, 1.0, 1.35)) as (figure, grid):
        for column, (name, frames) in enumerate(zip(names, seen.values(), strict=True)):
            for row, shown in enumerate((frames[0], brought[column][0])):
                axes = grid[row, column]
                axes.imshow(shown[80:200, 120:300].clip(0.0, 1.0), interpolation="nearest")
                axes.set_axis_off()
                axes.set_title(f"{name}{', stretched' if row else ', as taken'}", loc="left", fontsize=10)
        for axes in grid[2]:
            axes.remove()
        axes = figure.add_subplot(grid[2, 0].get_gridspec()[2, :])
        density = [0.0 if math.isinf(visibility_m) else math.log(20.0) / visibility_m for visibility_m in FOGS_M]
        for label, colour, marker, pictures in (
            ("contrast of every region stretched to the same", COLOURS[1], "o", brought),
            ("as taken", COLOURS[0], "s", list(seen.values())),
        ):
            axes.semilogy(
                density, [255 * noise(frames).mean() for frames in pictures], f"-{marker}", color=colour, label=label
            )
        axes.set_xticks(density, [f"{name}\n{1e3 * value:.1f}" for name, value in zip(names, density, strict=True)])
        axes.set_xlabel("extinction of the fog [1/km]")
        axes.set_ylabel("temporal noise [1/255]")
        axes.set_yticks([2, 5, 10, 20, 50, 100], ["2", "5", "10", "20", "50", "100"])
        axes.minorticks_off()
        axes.legend(frameon=False, fontsize=9)
        return _png(figure)


def draw_sharpness() -> bytes:
    """Contrast of a slanted edge against frequency, measured and by theory: PNG."""
    with _figure(1, 1, (7.0, 4.6)) as (figure, grid):
        axes = grid[0, 0]
        for colour, marker, name in zip(COLOURS, "osD^", CAMERAS, strict=True):
            graph = camera.load_graph(resources.folder("pipeline") / f"{name}.yaml")
            lens, chip = graph.profiles["lens"], graph.profiles["sensor"]
            assert isinstance(lens, LensProfile) and isinstance(chip, SensorProfile)
            f, found, theory = slanted_edge(name)
            axes.plot(f, theory, color=colour, lw=1.3)
            axes.plot(
                f,
                found,
                marker,
                color=colour,
                ms=4.5,
                mfc="none",
                label=f"{name}: {chip.pixel_pitch_um:g} um, f/{lens.f_number:g}",
            )
        axes.plot([], [], color=drawing.INK, lw=1.3, label="theory: disc x spot of the lens x pixel")
        axes.set(xlabel="spatial frequency [cycles/pixel]", ylabel="contrast [1]", xlim=(0.0, 0.5), ylim=(0.0, 1.02))
        axes.set_title("Slanted edge through lens and pixels, 550 nm", loc="left", fontsize=11, fontweight="bold")
        axes.legend(frameon=False, fontsize=9, loc="lower left")
        return _png(figure)


def draw_colour() -> bytes:
    """Mean and largest colour difference over a ColorChecker, by sensor and light; sensors of the same curves together:
    PNG.
    """
    alike: dict[Any, list[SensorProfile]] = {}
    for chip in map(load_sensor, shipped("sensors")):
        if len(cfa.filters(chip.cfa)) > 2:
            alike.setdefault((chip.qe, chip.cfa), []).append(chip)
    with _figure(1, 1, (8.0, 4.2)) as (figure, grid):
        axes = grid[0, 0]
        for index, (light, name) in enumerate(LIGHTS.items()):
            fits = [response.colour_matrix(chips[0], light) for chips in alike.values()]
            places = np.arange(len(alike)) + (index - 1.5) * 0.2
            axes.bar(places, [fit.mean_de00 for fit in fits], 0.17, color=COLOURS[index], label=name)
            axes.plot(places, [fit.max_de00 for fit in fits], "_", color=COLOURS[index], ms=22, mew=2.0)
            for place, fit in zip(places, fits, strict=True):
                axes.annotate(
                    f"{fit.mean_de00:.2f}",
                    (place, fit.mean_de00),
                    (0, 5),
                    textcoords="offset points",
                    ha="center",
                    fontsize=8.5,
                )
        axes.plot([], [], "_", color=drawing.INK, ms=14, mew=2.0, label="worst patch")
        names = [
            ", ".join(chip.name for chip in chips) + f"\n({chips[0].qe.camera or chips[0].qe.observer or 'own curves'})"
            for chips in alike.values()
        ]
        axes.set_xticks(range(len(names)), names)
        axes.set_ylabel("CIEDE2000, mean of 24 patches [1]")
        axes.set_title(
            "What the fitted matrix leaves of a ColorChecker's colours", loc="left", fontsize=11, fontweight="bold"
        )
        figure.legend(loc="outside lower center", ncols=5, frameon=False, fontsize=9)
        return _png(figure)


@contextlib.contextmanager
def _figure(columns: int, rows: int, size: tuple[float, float], **ratios: Sequence[float]) -> Iterator[tuple[Any, Any]]:
    """A figure of `size` inches and its (rows, columns) axes, in the style of the other drawings."""
    import matplotlib
    from matplotlib.figure import Figure

    style: dict[Any, Any] = {**drawing.STYLE, **dict.fromkeys(drawing.COLOUR_KEYS, drawing.INK), "font.size": 9}
    with matplotlib.rc_context(style):
        figure = Figure(figsize=size, layout="constrained")
        yield figure, figure.subplots(rows, columns, squeeze=False, gridspec_kw=ratios)


def _png(figure: Any) -> bytes:
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=110, facecolor=drawing.PAPER, metadata={"Software": None})
    return data.getvalue()


if __name__ == "__main__":
    for written in draw(Path(sys.argv[1] if len(sys.argv) > 1 else "docs/images")):
        print(written)
