"""Where the atmospheric scattering model fails: L = J t + A (1 - t) against transported light, over the shots of a set.

J is the clear frame, t the transmittance of each pixel's ray, and A one colour for the whole picture.  The model leaves
out lamps' glow, shadows in the fog and light that was scattered more than once.  The error is given in units of the
noise that the sensor has in that pixel (below 1 no camera sees it), and of the whole picture as FLIP.
"""

from __future__ import annotations

import importlib.util
import io
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
import typer
from scipy import ndimage

from docs.studies import command, statistics
from docs.studies.statistics import Mean
from synfog_usd import camera
from synfog_usd.base import files, photometry
from synfog_usd.base.arrays import Array
from synfog_usd.base.colour import srgb_decode, srgb_encode
from synfog_usd.base.errors import ImageError, ParameterError
from synfog_usd.base.progress import Progress, silent
from synfog_usd.base.seeds import stream
from synfog_usd.camera.writers import read_exr
from synfog_usd.cli.progress import shown
from synfog_usd.dataset.sets import index, layout

DEPTHS = (0.0, 0.1, 0.25, 0.5, 1.0, 2.0, 3.0, 5.0, math.inf)
"""Edges of the bins of optical depth, -ln t."""

FROM_LAMP_DEG = (0.0, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, math.inf)
"""Edges of the bins of the angle to the nearest lamp in the picture."""

LAMP_TIMES = 30.0
"""A pixel of the clear frame so many times brighter than its mean is a lamp."""

PATCH_PX = 15
MODELS = ("fitted", "horizon", "dark_channel", "srgb", "single", "two_percent")
"""fitted: the A that misses this very picture least in units of noise, better than anyone could know.

horizon: the truth's own colour where nothing is seen any more (t below 0.02), as a measured airlight.
dark_channel: of the truth by He et al. 2011, as SynFog-beta has it.
srgb: mixed in sRGB codes and not in light, as Foggy Cityscapes was (Sakaridis et al. 2018), with the A that misses the
codes least; above the picture's white both are white.
single: the truth without light that the fog scattered more than once on its way to the eye.
two_percent: fitted, in the fog that has the same visibility by Koschmieder's contrast of 2 % and not the WMO's of 5 %.
"""

LINEAR_WHITE_TIMES = 1.0 / 0.18
"""White of a picture, in log-averages of the clear frame's luminance (Reinhard et al. 2002)."""

THICKER = math.log(50.0) / math.log(20.0)
"""Extinction at a contrast of 2 % over that at 5 %, for one visibility."""

LEAST_DRAWN = 0.1
"""What is further below the sensor's noise is not in the drawing."""

FEWEST_PX = 50
"""A shot says nothing of a bin in which it has fewer pixels."""


@dataclass(frozen=True)
class ShotErrors:
    """What one shot says.

    Attributes:
        scene: shots of one are not independent.
        name, lighting, fog: of the shot.
        over_noise: median of |model - truth| over the sensor's noise, by (model, axis, bin).
        left: the same of the error that rendering left in truth and clear frame, as denoising tells it, by (axis, bin).
        flip: mean of FLIP against the truth, both as sRGB of one exposure, by model; empty without flip-evaluator.
    """

    scene: str
    name: str
    lighting: str
    fog: str
    over_noise: Mapping[tuple[str, str, int], float]
    left: Mapping[tuple[str, int], float]
    flip: Mapping[str, float]


@dataclass(frozen=True)
class FogPair:
    """A foggy shot and the clear frame of the same view.

    Attributes:
        scene: whose shots are not independent of each other.
        name: for people.
        lighting, fog: names.
        mor_m: visibility [m].
        foggy, clear: folders with radiance.exr; `foggy` has layers.exr, too.
        electrons_per_cd_m2, dark_noise_e: of the sensor, see `camera.noise_floor`.
    """

    scene: str
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
        shots: those that were compared.
        left_out: why others were not.
        lightings: names, in order.
    """

    shots: tuple[ShotErrors, ...]
    left_out: tuple[str, ...]
    lightings: tuple[str, ...]

    def over_noise(self, model: str, lighting: str, axis: str, place: int) -> Mean | None:
        """Geometric mean of the shots' medians in a bin, or None where no shot has one."""
        key = (model, axis, place)
        return _geometric([(shot.over_noise[key], shot.scene) for shot in self._of(lighting) if key in shot.over_noise])

    def ratio(self, model: str, baseline: str, lighting: str, axis: str, place: int) -> Mean | None:
        """Geometric mean of one model's medians over another's, shot by shot; None where no shot has both."""
        key, key_beside = (model, axis, place), (baseline, axis, place)
        both = [
            shot for shot in self._of(lighting) if key in shot.over_noise and shot.over_noise.get(key_beside, 0.0) > 0.0
        ]
        return _geometric([(shot.over_noise[key] / shot.over_noise[key_beside], shot.scene) for shot in both])

    def rendering(self, lighting: str, axis: str, place: int) -> Mean | None:
        """The same of what rendering left."""
        return _geometric(
            [(shot.left[axis, place], shot.scene) for shot in self._of(lighting) if (axis, place) in shot.left]
        )

    def flip(self, model: str, lighting: str, fog: str) -> Mean | None:
        """Mean of FLIP, or None where it was not measured."""
        values = [
            (shot.flip[model], shot.scene) for shot in self._of(lighting) if shot.fog == fog and model in shot.flip
        ]
        return statistics.mean(*zip(*values, strict=True)) if values else None

    def _of(self, lighting: str) -> list[ShotErrors]:
        return [shot for shot in self.shots if shot.lighting == lighting]


def _geometric(values: list[tuple[float, str]]) -> Mean | None:
    if not values:
        return None
    of_logs = statistics.mean([math.log(max(value, 1e-6)) for value, _ in values], [scene for _, scene in values])
    low, high = (None if end is None else math.exp(end) for end in (of_logs.low, of_logs.high))
    return replace(of_logs, value=math.exp(of_logs.value), low=low, high=high)


def pairs(source: Path) -> Iterator[FogPair | str]:
    """Foggy shots of a set or bake with their clear frames, and lines on those that cannot be used.

    Raises:
        ParameterError: neither a set that is finished nor a bake.
    """
    if not source.is_dir():
        raise ParameterError(f"{source}: no such folder")
    if (source / layout.INDEX).is_dir() or (source / layout.SET).is_file():
        bakes = dict(sorted({picture.bake: str(picture.scene) for picture in index.pictures(source)}.items()))
    elif (source / "bake.json").is_file():
        bakes = {source: source.name}
    else:
        raise ParameterError(f"{source}: neither a set (index/) nor a bake (bake.json)")
    for folder, scene in bakes.items():
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
                        scene,
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


def some(pairs_found: list[FogPair], limit: int | None) -> list[FogPair]:
    """At most so many, drawn from all; the same each time."""
    if limit is None or limit >= len(pairs_found):
        return pairs_found
    return [pairs_found[place] for place in sorted(stream(0, "study", "some").permutation(len(pairs_found))[:limit])]


def study(source: Path, *, limit: int | None = None, progress: Progress = silent) -> ScatteringStudy:
    """Compare the model with the truth over a set or a bake.

    Args:
        source: folder.
        limit: at most so many shots, drawn from all.
        progress: whom to tell.

    Raises:
        ParameterError: nothing in it that can be compared.
    """
    every = list(pairs(source))
    left_out = [entry for entry in every if isinstance(entry, str)]
    usable = some([entry for entry in every if isinstance(entry, FogPair)], limit)
    shots: list[ShotErrors] = []
    for number, pair in enumerate(usable):
        progress(pair.name, number / len(usable))
        try:
            shots.append(_compare(pair))
        except ImageError as error:
            left_out.append(f"{pair.name}: {error}")
    if not shots:
        raise ParameterError(
            f"{source}: no foggy shot with a clear frame; {left_out[0] if left_out else 'it is empty'}"
        )
    return ScatteringStudy(tuple(shots), tuple(left_out), tuple(dict.fromkeys(entry.lighting for entry in shots)))


def _compare(pair: FogPair) -> ShotErrors:
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

    bright, bright_clear = luminance(truth), luminance(clear)
    noise = camera.noise_floor(bright, electrons_per_cd_m2=pair.electrons_per_cd_m2, dark_noise_e=pair.dark_noise_e)
    bins = {
        "depth": np.digitize(-np.log(np.maximum(t, 1e-12)), DEPTHS[1:-1]),
        "lamp": np.digitize(_from_lamp_deg(bright_clear, truth_image.provenance.get("fov_x_deg")), FROM_LAMP_DEG[1:-1]),
    }

    def medians(numbers: Array) -> Iterator[tuple[str, int, float]]:
        for axis, where in bins.items():
            for place in np.unique(where):
                if (inside := numbers[where == place]).size >= FEWEST_PX:
                    yield axis, int(place), float(np.median(inside))

    white = LINEAR_WHITE_TIMES * float(np.exp(np.log(np.maximum(bright_clear, 1e-6)).mean()))
    by_model = models(truth, clear, t, white=white, noise=noise)
    if (scattered := _channels(pair.foggy, [f"airlight_multiple.{name}" for name in truth_image.channels])) is not None:
        by_model["single"] = truth - scattered
    over_noise: dict[tuple[str, str, int], float] = {}
    for name, model in by_model.items():
        reference = (
            by_model["fitted"] if name == "two_percent" else np.minimum(truth, white) if name == "srgb" else truth
        )
        miss = np.abs(luminance(np.minimum(model, white) if name == "srgb" else model) - luminance(reference)) / noise
        over_noise |= {(name, axis, place): median for axis, place, median in medians(miss)}
    rendering = {}
    of_truth, of_clear = (_channels(folder, ["error.Y"]) for folder in (pair.foggy, pair.clear))
    if of_truth is not None and of_clear is not None:
        renders = np.hypot(of_truth[..., 0], t * of_clear[..., 0]) / noise
        rendering = {(axis, place): median for axis, place, median in medians(renders)}
    flip = {}
    if truth.shape[2] == 3 and importlib.util.find_spec("flip_evaluator"):
        coded = {name: _coded(model, white) for name, model in {**by_model, "truth": truth}.items()}
        flip = {name: _flip(coded[name], coded["fitted" if name == "two_percent" else "truth"]) for name in by_model}
    return ShotErrors(pair.scene, pair.name, pair.lighting, pair.fog, over_noise, rendering, flip)


def _channels(folder: Path, names: list[str]) -> Array | None:
    """Layers of a shot, or None where it has no such layer."""
    try:
        return read_exr(folder / "layers.exr", channels=names).pixels.astype(np.float64)
    except ImageError:
        return None


def _coded(pixels: Array, white: float) -> npt.NDArray[np.uint8]:
    return np.rint(255.0 * srgb_encode(np.clip(pixels / white, 0.0, 1.0))).astype(np.uint8)


def _flip(picture: npt.NDArray[np.uint8], truth: npt.NDArray[np.uint8]) -> float:
    """Mean of LDR-FLIP at 67 pixels a degree (Andersson et al. 2020)."""
    import flip_evaluator

    reference, test = (image.astype(np.float32) / 255.0 for image in (truth, picture))
    return float(flip_evaluator.evaluate(reference, test, "LDR")[1])


def models(truth: Array, clear: Array, t: Array, *, white: float, noise: Array) -> dict[str, Array]:
    """J t + A (1 - t) by each way to choose A; see `MODELS`.

    Args:
        truth, clear: (H, W, C) radiance.
        t: (H, W) transmittance.
        white: radiance that is white in a picture.
        noise: (H, W) of the sensor, as a luminance.
    """
    rest = 1.0 - t[..., None]
    fitted = fitted_airlight(truth, clear, t, 1.0 / noise)
    airlights: dict[str, Array | None] = {
        "fitted": fitted,
        "horizon": np.median(truth[t < 0.02], axis=0) if (t < 0.02).sum() >= 9 else None,
        "dark_channel": _dark_channel(truth),
    }
    result = {
        name: clear * t[..., None] + airlight * rest for name, airlight in airlights.items() if airlight is not None
    }
    coded, coded_clear = (srgb_encode(np.clip(picture / white, 0.0, 1.0)) for picture in (truth, clear))
    mixed = coded_clear * t[..., None] + fitted_airlight(coded, coded_clear, t, np.ones_like(t)) * rest
    thicker = (t**THICKER)[..., None]
    return result | {"srgb": white * srgb_decode(mixed), "two_percent": clear * thicker + fitted * (1.0 - thicker)}


def fitted_airlight(truth: Array, clear: Array, t: Array, weight: Array) -> Array:
    """(C,) the A with the least sum of weighted squares."""
    rest = weight[..., None] * (1.0 - t[..., None])
    away = np.maximum((rest * rest).sum(axis=(0, 1)), 1e-30)
    return np.asarray(((weight[..., None] * (truth - clear * t[..., None])) * rest).sum(axis=(0, 1)) / away)


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


def crossing(result: ScatteringStudy, model: str, lighting: str, axis: str) -> str:
    """From which bin on the error exceeds the sensor's noise, in words."""
    edges, reach = (
        (DEPTHS, "from optical depth {}") if axis == "depth" else (FROM_LAMP_DEG, "up to {} degrees from a lamp")
    )
    over = [
        place
        for place in range(len(edges) - 1)
        if (mean := result.over_noise(model, lighting, axis, place)) is not None and mean.value > 1.0
    ]
    if not over:
        return "nowhere"
    if edges[min(over)] == 0.0 and (axis == "depth" or edges[max(over) + 1] == math.inf):
        return "everywhere"
    return reach.format(f"{edges[min(over)]:g}" if axis == "depth" else f"{edges[max(over) + 1]:g}")


def markdown(result: ScatteringStudy) -> str:
    """Findings and tables."""
    lines = [
        "# Where the scattering model fails",
        "",
        f"{len(result.shots)} foggy shots of {len({shot.scene for shot in result.shots})} scenes. "
        "|J t + A (1 - t) - truth| over the noise of the sensor in that pixel: above 1 a camera sees the difference. "
        "Medians of each shot's pixels, their geometric mean over shots, and intervals of 95 % by bootstrap over "
        "scenes. The last row is the error that rendering left in truth and clear frame: what is not well above it is "
        "not resolved. `two_percent` is told beside `fitted` and not beside the truth.",
    ]
    titles = {"depth": ("optical depth", DEPTHS), "lamp": ("degrees from the nearest lamp", FROM_LAMP_DEG)}
    for lighting in result.lightings:
        for axis, (title, edges) in titles.items():
            places = [p for p in range(len(edges) - 1) if result.over_noise(MODELS[0], lighting, axis, p)]
            if axis == "lamp" and places in ([], [len(edges) - 2]):
                continue
            heads = [_span(edges[p], edges[p + 1]) for p in places]
            lines += [
                "",
                f"## {lighting}, by {title}",
                "",
                f"| model | {' | '.join(heads)} | a camera sees it |",
                f"|---|{'---|' * len(places)}---|",
            ]
            for model in MODELS:
                cells = [_cell(result.over_noise(model, lighting, axis, p)) for p in places]
                if any(cell != "-" for cell in cells):
                    lines.append(f"| {model} | {' | '.join(cells)} | {crossing(result, model, lighting, axis)} |")
            cells = [_cell(result.ratio("srgb", "fitted", lighting, axis, p)) for p in places]
            lines.append(f"| srgb over fitted, shot by shot | {' | '.join(cells)} | |")
            cells = [_cell(result.rendering(lighting, axis, p)) for p in places]
            lines.append(f"| error of the renders | {' | '.join(cells)} | |")
        fogs = list(dict.fromkeys(shot.fog for shot in result.shots if shot.lighting == lighting and shot.flip))
        if fogs:
            lines += ["", f"## {lighting}, FLIP", "", f"| model | {' | '.join(fogs)} |", f"|---|{'---|' * len(fogs)}"]
            for model in MODELS:
                cells = [_cell(result.flip(model, lighting, fog)) for fog in fogs]
                if any(cell != "-" for cell in cells):
                    lines.append(f"| {model} | {' | '.join(cells)} |")
    for line in result.left_out[:5]:
        lines += ["", f"Left out: {line}"]
    if len(result.left_out) > 5:
        lines += ["", f"and {len(result.left_out) - 5} more."]
    return "\n".join([*lines, ""])


def write(result: ScatteringStudy, out: Path) -> None:
    """Write findings.md, findings.csv (a row for each shot, model and bin) and findings.png.

    Raises:
        OutputError: the folder cannot be written.
    """
    files.write_bytes(out / "findings.md", markdown(result).encode())
    rows = ["scene,shot,lighting,fog,model,axis,low,high,median_over_noise,flip"]
    for shot in result.shots:
        name = f"{shot.scene},{shot.name},{shot.lighting},{shot.fog}"
        for (model, axis, place), median in sorted(shot.over_noise.items()):
            edges = DEPTHS if axis == "depth" else FROM_LAMP_DEG
            rows.append(f"{name},{model},{axis},{edges[place]:g},{edges[place + 1]:g},{median:.4g},")
        rows += [f"{name},{model},picture,,,,{value:.4g}" for model, value in sorted(shot.flip.items())]
    files.write_bytes(out / "findings.csv", "\n".join([*rows, ""]).encode())
    files.write_bytes(out / "findings.png", _drawn(result))


def _drawn(result: ScatteringStudy) -> bytes:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(1.5 + 4.5 * len(result.lightings), 4.0), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    colours = dict(zip(MODELS, ("#0b5fa5", "#12805c", "#c1440e", "#8a5a9e", "#b8860b", "#7a7f85"), strict=True))
    for column, lighting in enumerate(result.lightings):
        axes = figure.add_subplot(1, len(result.lightings), column + 1)
        places = range(len(DEPTHS) - 1)
        for model in MODELS:
            cells = [result.over_noise(model, lighting, "depth", p) for p in places]
            if not any(cells):
                continue
            axes.plot(
                places, [_value(cell) for cell in cells], "o-", color=colours[model], label=model.replace("_", " ")
            )
            ends = [
                (_value(cell) if end is None else end)
                for cell in cells
                for end in ((cell.low, cell.high) if cell else (None, None))
            ]
            axes.fill_between(places, ends[::2], ends[1::2], color=colours[model], alpha=0.15, linewidth=0)
        rendering = [_value(result.rendering(lighting, "depth", p)) for p in places]
        axes.plot(places, rendering, "--", color="#666b70", label="error of the renders")
        axes.axhline(1.0, color="#22262a", linewidth=0.8)
        axes.set_yscale("log")
        axes.set_ylim(bottom=LEAST_DRAWN)
        axes.set_xticks(list(places), [_span(DEPTHS[p], DEPTHS[p + 1]) for p in places], rotation=45, ha="right")
        axes.set_title(lighting)
        axes.set_xlabel("optical depth")
        if column == 0:
            axes.set_ylabel("error over the sensor's noise, median")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside right upper", frameon=False, fontsize=8)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()


def _span(low: float, high: float) -> str:
    return f"{low:g} to {high:g}" if math.isfinite(high) else f"over {low:g}"


def _value(mean: Mean | None) -> float:
    return math.nan if mean is None else mean.value


def _cell(mean: Mean | None) -> str:
    if mean is None:
        return "-"
    return f"{mean.value:.2g}" + ("" if mean.low is None else f" ({mean.low:.2g} to {mean.high:.2g})")


def main(
    source: Annotated[Path, typer.Argument(help="Folder of a set or of a bake.")],
    out: command.Out,
    limit: Annotated[int | None, typer.Option(min=1, help="At most so many shots, drawn from all.")] = None,
) -> None:
    """Map where the atmospheric scattering model errs by more than the sensor's noise."""
    command.writable(out)
    with shown(quiet=False) as (progress, _):
        result = study(source, limit=limit, progress=progress)
    write(result, out)
    print(markdown(result))


if __name__ == "__main__":
    command.run(main)
