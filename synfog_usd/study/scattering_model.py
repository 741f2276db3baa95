"""Where the atmospheric scattering model fails: L = J t + A (1 - t) against transported light, over the shots of a set.

J is the clear frame, t the transmittance of each pixel's ray, and A one colour for the whole picture.  The model leaves
out lamps' glow, shadows in the fog and light that was scattered more than once.  The error is told in units of the
noise that the sensor has in that pixel: below 1 no camera sees it.
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from synfog_usd import camera, files, photometry
from synfog_usd.arrays import Array
from synfog_usd.errors import ImageError, ParameterError
from synfog_usd.progress import Progress, silent
from synfog_usd.seeds import stream
from synfog_usd.writers import read_exr

DEPTHS = (0.0, 0.1, 0.25, 0.5, 1.0, 2.0, 3.0, 5.0, math.inf)
"""Edges of the bins of optical depth, -ln t."""

FROM_LAMP_DEG = (0.0, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, math.inf)
"""Edges of the bins of the angle to the nearest lamp in the picture."""

LAMP_TIMES = 30.0
"""A pixel of the clear frame so many times brighter than its mean is a lamp."""

PATCH_PX = 15
STEPS = np.geomspace(1e-4, 1e5, 541)
"""Edges of the histogram that medians are read from: 4 % a step."""

MODELS = ("fitted", "horizon", "dark_channel")
"""fitted: the A that misses this very picture least, better than anyone could know.  horizon: the truth's own colour
where nothing is seen any more (t below 0.02), as a measured airlight.  dark_channel: of the truth by He et al. 2011, as
SynFog-beta has it.
"""


@dataclass
class Medians:
    """Histograms of positive numbers, by key."""

    counts: dict[tuple[Any, ...], npt.NDArray[np.int64]] = field(default_factory=dict)

    def add(self, key: tuple[Any, ...], numbers: Array) -> None:
        """Count finite numbers; what is beyond the histogram's ends counts there."""
        found = np.clip(numbers[np.isfinite(numbers)], STEPS[0], STEPS[-1] * (1 - 1e-9))
        counted = np.histogram(found, STEPS)[0]
        self.counts[key] = self.counts.get(key, 0) + counted

    def median(self, key: tuple[Any, ...]) -> float | None:
        """Median within 4 %, or None where nothing was counted."""
        counts = self.counts.get(key)
        if counts is None or not counts.sum():
            return None
        place = int(np.searchsorted(np.cumsum(counts), 0.5 * counts.sum()))
        return float(math.sqrt(STEPS[place] * STEPS[place + 1]))

    def number(self, key: tuple[Any, ...]) -> int:
        """How many were counted."""
        return int(self.counts[key].sum()) if key in self.counts else 0


@dataclass(frozen=True)
class FogPair:
    """A foggy shot and the clear frame of the same view.

    Attributes:
        name: for people.
        lighting, fog: names.
        mor_m: visibility [m].
        foggy, clear: folders with radiance.exr; `foggy` has layers.exr, too.
        electrons_per_cd_m2, dark_noise_e: of the sensor, see `camera.noise_floor`.
    """

    name: str
    lighting: str
    fog: str
    mor_m: float
    foggy: Path
    clear: Path
    electrons_per_cd_m2: float
    dark_noise_e: float


@dataclass(frozen=True)
class ScatteringStudy:
    """What came of it.

    Attributes:
        shots: how many were compared.
        left_out: why others were not.
        errors: median of |model - truth| over the sensor's noise, by (model, lighting, axis, bin).
        floor: of the error that truth and clear frame have themselves, as denoising tells it, over the same noise, by
            (lighting, axis, bin).
        lightings: names, in order.
    """

    shots: int
    left_out: tuple[str, ...]
    errors: Medians
    floor: Medians
    lightings: tuple[str, ...]


def pairs(source: Path) -> Iterator[FogPair | str]:
    """Foggy shots of a set or bake with their clear frames, and lines on those that cannot be used.

    Raises:
        ParameterError: neither a set nor a bake.
    """
    if (source / "index").is_dir():
        from synfog_usd.sets import index

        bakes = sorted({picture.bake for picture in index.pictures(source)})
    elif (source / "bake.json").is_file():
        bakes = [source]
    else:
        raise ParameterError(f"{source}: neither a set (index/) nor a bake (bake.json)")
    for folder in bakes:
        place = folder.relative_to(source).as_posix() if source in folder.parents else folder.name
        try:
            rows = json.loads((folder / "bake.json").read_text(encoding="utf-8"))["shots"]
            clear = {row["lighting"]: row for row in rows if row["mor_m"] is None}
            for row in rows:
                if row["mor_m"] is None:
                    continue
                name = f"{place}/{row['folder']}"
                sensor = ((row.get("target") or {}).get("sensor")) or {}
                if row["lighting"] not in clear:
                    yield f"{name}: no clear frame beside it"
                elif "rendered_px" in row:
                    yield f"{name}: its lens distorts, so that labels and radiance differ"
                elif "electrons_per_cd_m2" not in sensor:
                    yield f"{name}: the manifest does not say the sensor's noise"
                else:
                    light = row["lighting"]
                    yield FogPair(
                        name,
                        light,
                        row["fog"],
                        float(row["mor_m"]),
                        folder / row["folder"],
                        folder / clear[light]["folder"],
                        float(sensor["electrons_per_cd_m2"]),
                        float(sensor["dark_noise_e"]),
                    )
        except (OSError, ValueError, KeyError, TypeError) as error:
            yield f"{folder}: bake.json cannot be used ({error})"


def some(found: list[FogPair], limit: int | None) -> list[FogPair]:
    """At most so many, drawn from all; the same each time."""
    if limit is None or limit >= len(found):
        return found
    return [found[place] for place in sorted(stream(0, "study", "some").permutation(len(found))[:limit])]


def study(source: Path, *, limit: int | None = None, progress: Progress = silent) -> ScatteringStudy:
    """Compare the model with the truth over a set or a bake.

    Args:
        source: folder.
        limit: at most so many shots, drawn from all.
        progress: whom to tell.

    Raises:
        ParameterError: nothing in it that can be compared.
    """
    found = list(pairs(source))
    left_out = [one for one in found if isinstance(one, str)]
    usable = some([one for one in found if isinstance(one, FogPair)], limit)
    errors, floor, shots = Medians(), Medians(), 0
    for number, pair in enumerate(usable):
        progress(pair.name, number / len(usable))
        try:
            _compare(pair, errors, floor)
            shots += 1
        except ImageError as error:
            left_out.append(f"{pair.name}: {error}")
    if not shots:
        raise ParameterError(
            f"{source}: no foggy shot with a clear frame; {left_out[0] if left_out else 'it is empty'}"
        )
    return ScatteringStudy(shots, tuple(left_out), errors, floor, tuple(dict.fromkeys(one.lighting for one in usable)))


def _compare(pair: FogPair, errors: Medians, floor: Medians) -> None:
    truth_image = read_exr(pair.foggy / "radiance.exr")
    truth, clear = (
        truth_image.pixels.astype(np.float64),
        read_exr(pair.clear / "radiance.exr").pixels.astype(np.float64),
    )
    t = read_exr(pair.foggy / "layers.exr", channels=["transmittance.Y"]).pixels[..., 0].astype(np.float64)
    if truth.shape != clear.shape or truth.shape[:2] != t.shape:
        raise ImageError("the foggy and the clear frame differ in size or channels")

    def luminance(pixels: Array) -> Array:
        return photometry.luminance(truth_image.with_pixels(pixels.astype(np.float32))).astype(np.float64)

    bright = luminance(truth)
    noise = camera.noise_floor(bright, electrons_per_cd_m2=pair.electrons_per_cd_m2, dark_noise_e=pair.dark_noise_e)
    bins = {
        "depth": np.digitize(-np.log(np.maximum(t, 1e-12)), DEPTHS[1:-1]),
        "lamp": np.digitize(
            _from_lamp_deg(luminance(clear), truth_image.provenance.get("fov_x_deg")), FROM_LAMP_DEG[1:-1]
        ),
    }
    for name, model in models(truth, clear, t).items():
        miss = np.abs(luminance(model) - bright) / noise
        for axis, where in bins.items():
            for place in np.unique(where):
                errors.add((name, pair.lighting, axis, int(place)), miss[where == place])
    try:
        of_truth, of_clear = (
            read_exr(folder / "layers.exr", channels=["error.Y"]).pixels[..., 0].astype(np.float64)
            for folder in (pair.foggy, pair.clear)
        )
    except ImageError:
        return
    left = np.hypot(of_truth, t * of_clear) / noise
    for axis, where in bins.items():
        for place in np.unique(where):
            floor.add((pair.lighting, axis, int(place)), left[where == place])


def models(truth: Array, clear: Array, t: Array) -> Mapping[str, Array]:
    """J t + A (1 - t) by each way to choose A; see `MODELS`.

    Args:
        truth, clear: (H, W, C) radiance.
        t: (H, W) transmittance.
    """
    rest = 1.0 - t[..., None]
    attenuated = clear * t[..., None]
    away = np.maximum((rest * rest).sum(axis=(0, 1)), 1e-30)
    airlights: dict[str, Array | None] = {
        "fitted": ((truth - attenuated) * rest).sum(axis=(0, 1)) / away,
        "horizon": np.median(truth[t < 0.02], axis=0) if (t < 0.02).sum() >= 9 else None,
        "dark_channel": _dark_channel(truth),
    }
    return {name: attenuated + found * rest for name, found in airlights.items() if found is not None}


def _dark_channel(picture: Array) -> Array:
    dark = ndimage.minimum_filter(picture.min(axis=2), PATCH_PX, mode="nearest")
    most = max(1, dark.size // 1000)
    candidates = picture.reshape(-1, picture.shape[2])[np.argpartition(dark.ravel(), -most)[-most:]]
    return np.asarray(candidates[candidates.sum(axis=1).argmax()])


def _from_lamp_deg(clear: Array, fov_x_deg: float | None) -> Array:
    """Angle of each pixel to the nearest lamp of the picture [degrees], as small angles are; inf without a lamp."""
    lamps = clear > LAMP_TIMES * clear.mean()
    if fov_x_deg is None or not lamps.any():
        return np.full(clear.shape, np.inf)
    a_pixel = math.degrees(2.0 * math.tan(math.radians(fov_x_deg) / 2.0) / clear.shape[1])
    return np.asarray(ndimage.distance_transform_edt(~lamps)) * a_pixel


def crossing(found: ScatteringStudy, model: str, lighting: str, axis: str) -> str:
    """From which bin on the error exceeds the sensor's noise, in words."""
    edges, reach = (
        (DEPTHS, "from optical depth {}") if axis == "depth" else (FROM_LAMP_DEG, "up to {} degrees from a lamp")
    )
    over = [
        place
        for place in range(len(edges) - 1)
        if (median := found.errors.median((model, lighting, axis, place))) is not None and median > 1.0
    ]
    if not over:
        return "nowhere"
    if edges[min(over)] == 0.0 and (axis == "depth" or edges[max(over) + 1] == math.inf):
        return "everywhere"
    return reach.format(f"{edges[min(over)]:g}" if axis == "depth" else f"{edges[max(over) + 1]:g}")


def markdown(found: ScatteringStudy) -> str:
    """Findings and tables."""
    lines = [
        "# Where the scattering model fails",
        "",
        f"{found.shots} foggy shots. Medians of |J t + A (1 - t) - truth| over the noise of the sensor in that "
        "pixel: above 1 a camera sees the difference. The last row is the error that rendering left in truth and "
        "clear frame: what is not well above it is not resolved.",
    ]
    titles = {"depth": ("optical depth", DEPTHS), "lamp": ("degrees from the nearest lamp", FROM_LAMP_DEG)}
    for lighting in found.lightings:
        for axis, (title, edges) in titles.items():
            places = [p for p in range(len(edges) - 1) if found.errors.number((MODELS[0], lighting, axis, p))]
            if axis == "lamp" and places in ([], [len(edges) - 2]):
                continue
            heads = [_span(edges[p], edges[p + 1]) for p in places]
            lines += [
                "",
                f"## {lighting}, by {title}",
                "",
                f"| airlight | {' | '.join(heads)} | a camera sees it |",
                f"|---|{'---|' * len(places)}---|",
            ]
            for model in MODELS:
                cells = [_cell(found.errors.median((model, lighting, axis, p))) for p in places]
                lines.append(f"| {model} | {' | '.join(cells)} | {crossing(found, model, lighting, axis)} |")
            cells = [_cell(found.floor.median((lighting, axis, p))) for p in places]
            lines.append(f"| error of the renders | {' | '.join(cells)} | |")
    for line in found.left_out[:5]:
        lines += ["", f"Left out: {line}"]
    if len(found.left_out) > 5:
        lines += ["", f"and {len(found.left_out) - 5} more."]
    return "\n".join([*lines, ""])


def write(found: ScatteringStudy, out: Path) -> None:
    """Write findings.md, findings.csv and findings.png.

    Raises:
        OutputError: the folder cannot be written.
    """
    files.write_bytes(out / "findings.md", markdown(found).encode())
    rows = ["model,lighting,axis,low,high,median_over_noise,pixels"]
    for (model, lighting, axis, place), _ in sorted(found.errors.counts.items()):
        edges = DEPTHS if axis == "depth" else FROM_LAMP_DEG
        key = (model, lighting, axis, place)
        rows.append(
            f"{model},{lighting},{axis},{edges[place]:g},{edges[place + 1]:g},{found.errors.median(key):.4g},"
            f"{found.errors.number(key)}"
        )
    files.write_bytes(out / "findings.csv", "\n".join([*rows, ""]).encode())
    files.write_bytes(out / "findings.png", _drawn(found))


def _drawn(found: ScatteringStudy) -> bytes:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.0 * len(found.lightings), 4.0), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    colours = dict(zip(MODELS, ("#0b5fa5", "#12805c", "#c1440e"), strict=True))
    for column, lighting in enumerate(found.lightings):
        axes = figure.add_subplot(1, len(found.lightings), column + 1)
        places = range(len(DEPTHS) - 1)
        for model in MODELS:
            medians = [found.errors.median((model, lighting, "depth", p)) or math.nan for p in places]
            axes.plot(places, medians, "o-", color=colours[model], label=model.replace("_", " "))
        own = [found.floor.median((lighting, "depth", p)) or math.nan for p in places]
        axes.plot(places, own, "--", color="#666b70", label="error of the renders")
        axes.axhline(1.0, color="#22262a", linewidth=0.8)
        axes.set_yscale("log")
        axes.set_xticks(list(places), [_span(DEPTHS[p], DEPTHS[p + 1]) for p in places], rotation=45, ha="right")
        axes.set_title(lighting)
        axes.set_xlabel("optical depth")
        if column == 0:
            axes.set_ylabel("error over the sensor's noise, median")
            axes.legend(frameon=False, fontsize=8)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()


def _span(low: float, high: float) -> str:
    return f"{low:g} to {high:g}" if math.isfinite(high) else f"over {low:g}"


def _cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.2g}"
