"""Automatic exposure: metered on the clear frame, then locked for every fog.

Takes a radiance image and the graph that will develop it; gives exposure time and
ISO.  A lamp or the sun does not move it: it looks at the geometric mean of the
frame and keeps large bright areas, not points, from clipping.  Tells also what a
pixel makes of light, and how much its noise hides.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from synfog_usd.base import photometry
from synfog_usd.base.errors import GraphError, ParameterError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import cfa
from synfog_usd.camera.flare import block_means
from synfog_usd.camera.graph import GraphRun, Node, NodeGraph
from synfog_usd.camera.profiles import SensorProfile

DAY_KEY = 0.12
"""Where the frame's geometric mean goes by day [part of saturation].  Below the
photographer's 0.18: fog lifts a frame towards the luminance of its sky, and that
must not clip."""

NIGHT_KEY = 0.04
"""The same at night: night should look like night."""

DAY_CD_M2, NIGHT_CD_M2 = 50.0, 0.5
"""Geometric mean luminance from which on it is day, and up to which it is night; between them the logarithm counts."""

HIGHLIGHT_PERCENTILE = 95.0
"""Bright areas smaller than the other 5 % of the frame (lamps, sun, glints) may clip."""

DAY_HIGHLIGHT, NIGHT_HIGHLIGHT = 0.55, 0.07
"""Part of saturation that the percentile may reach: a day's sky, and a road under street lamps."""

BLURS = tuple(f"optics.{name}" for name in ("diffraction", "depth_of_field", "glare", "flare", "ghosts"))
"""Left out when metering: in a small copy they would spread a lamp over streets."""

METER_WIDTH_PX = 320

LIGHTGROUP = "lightgroup_"
"""How inputs begin that take the light of one group of lamps alone, as `layers.exr` names it."""

EXPOSURE = re.compile(r"exposure_(\d{1,3})_(\d{1,3})")
"""Inputs that take the view as it is in a part of the time in which a row is exposed, from so many per cent of it to so
many.
"""

BLINDING_CD_M2 = 1e12
"""Light in which every pixel is full, whatever the exposure."""


@dataclass(frozen=True)
class Exposure:
    """How a frame is exposed; hand `settings` to `NodeGraph.run` for every fog of the pair.

    Attributes:
        exposure_s: time [s].
        iso: ISO speed.
        mean_cd_m2: geometric mean luminance that was metered [cd m-2]; 0 where all is black.
        limit: 'none', or the end of the sensor's range that was reached: 'bright' or 'dark'.
    """

    exposure_s: float
    iso: float
    mean_cd_m2: float = 0.0
    limit: Literal["none", "bright", "dark"] = "none"

    @property
    def settings(self) -> dict[str, float]:
        """What the `auto` parameters of a graph look up."""
        return {"exposure_s": self.exposure_s, "iso": self.iso}

    def __str__(self) -> str:
        """As photographers say it: '1/200 s, ISO 400'."""
        limit = {
            "bright": "; as short as it goes, and still bright",
            "dark": "; as long and sensitive as it goes, and still dark",
        }.get(self.limit, "")
        return f"{as_time(self.exposure_s)}, ISO {self.iso:.4g}{limit}"


def as_time(seconds: float) -> str:
    """'1/200 s' below a second, '2 s' from there on."""
    return f"1/{float(f'{1 / seconds:.4g}'):g} s" if seconds < 1.0 else f"{seconds:.4g} s"


def exposed(graph: NodeGraph, *, exposure_s: float | None = None, iso: float | None = None) -> NodeGraph:
    """A graph with an exposure time, an ISO speed or both instead of its own; the meter makes up for what is left open.

    Args:
        graph: with a sensor that exposes.
        exposure_s: time [s]; iso: ISO speed.

    Raises:
        ParameterError: outside what the sensor does, or there is none.
    """
    if exposure_s is None and iso is None:
        return graph
    sensor = graph.profiles.get("sensor")
    if not isinstance(sensor, SensorProfile) or not graph.nodes_with("sensor.expose"):
        raise ParameterError(f"--exposure, --iso: the graph {graph.name!r} has no sensor that exposes; leave them out")
    values: dict[str, float] = {}
    if exposure_s is not None:
        low, high = sensor.shortest_exposure_s, sensor.longest_exposure_s
        if not low <= exposure_s <= high:
            raise ParameterError(
                f"--exposure {as_time(exposure_s)}: the sensor {sensor.name} takes {as_time(low)} to {as_time(high)}"
            )
        values["sensor.exposure_s"] = exposure_s
    if iso is not None:
        if not graph.nodes_with("sensor.gain"):
            raise ParameterError(f"--iso {iso:g}: the graph {graph.name!r} has no sensor.gain, which an ISO speed sets")
        if not sensor.iso_base <= iso <= sensor.iso_max:
            raise ParameterError(
                f"--iso {iso:g}: the sensor {sensor.name} takes {sensor.iso_base:g} to {sensor.iso_max:g}"
            )
        values["sensor.iso"] = iso
    return graph.with_overrides(values)


def meter(
    radiance: Image, graph: NodeGraph, *, side_frames: Sequence[Image] = (), compensation_ev: float = 0.0
) -> Exposure:
    """Exposure for a clear frame, by running the graph's own lens and pixels on a small copy of it.

    The geometric mean of the signal behind the green (or clear) filters goes to a key between
    `NIGHT_KEY` and `DAY_KEY` of saturation; the brightest 5 % are cut to their lower edge
    before.  The 95th percentile of the strongest filter stays at or below `NIGHT_HIGHLIGHT` to
    `DAY_HIGHLIGHT`.  Time first, from the sensor's shortest to
    its longest; then ISO.  What the graph gives as a number stays, and the other
    makes up for it.

    Of several exposures that are merged the most sensitive is metered: the key
    counts in its own saturation, highlights in that of the merged range.

    Args:
        radiance: the clear frame.
        graph: has 'sensor.expose' and a sensor profile.
        side_frames: clear frames of other cameras that are exposed alike: the pixels of all count.
        compensation_ev: + is brighter [EV].

    Raises:
        GraphError: the graph exposes nothing.
    """
    nodes = graph.nodes_with("sensor.expose")
    sensor = graph.profiles.get("sensor")
    if not nodes or not isinstance(sensor, SensorProfile) or not _view_input(graph):
        raise GraphError(
            f"graph {graph.name!r} cannot be metered: it needs a sensor.expose node, a sensor and one radiance input; "
            f"give exposure_s a number"
        )
    sharp = graph.without([node.name for op in BLURS for node in graph.nodes_with(op)])
    a_second = {f"{node.name}.exposure_s": 1.0 for node in nodes} | {f"{node.name}.readout_s": 0.0 for node in nodes}

    def electrons(node: Node, frame: Image) -> Image:
        inputs, name = _steady(graph, frame), node.name
        return sharp.run(inputs, seed=0, settings={"exposure_s": 1.0}, overrides=a_second, until=name)[name]

    frames = [_small(picture) for picture in (radiance, *side_frames)]
    exposed_frames = {node.name: electrons(node, frames[0]) for node in nodes}
    chosen = max(nodes, key=lambda node: float(exposed_frames[node.name].pixels.mean(dtype=np.float64)))
    own_e, merged_e = _saturation_e(sharp, radiance, sensor)
    sites = [_sites(exposed_frames[chosen.name]), *(_sites(electrons(chosen, frame)) for frame in frames[1:])]
    fixed_s = None if chosen.params["exposure_s"].is_auto else float(chosen.params["exposure_s"].value)
    gains = graph.nodes_with("sensor.gain")
    fixed_iso = float(gains[0].params["iso"].value) if gains and not gains[0].params["iso"].is_auto else None
    return _chosen(
        np.concatenate([picture["G" if "G" in picture else "C"] for picture in sites]) / own_e,
        np.concatenate([np.max(list(picture.values()), axis=0) for picture in sites]) / merged_e,
        np.concatenate([photometry.luminance(frame)[::2, ::2].ravel() for frame in frames]).astype(np.float64),
        sensor,
        2.0**compensation_ev,
        fixed_s,
        fixed_iso,
    )


def _small(radiance: Image) -> Image:
    """A copy of at most `METER_WIDTH_PX` columns, each of its pixels as one of each colour of the filter's pattern."""
    means = block_means(radiance.pixels, max(1, -(-radiance.width_px // METER_WIDTH_PX)))
    return radiance.with_pixels(np.repeat(np.repeat(means, 2, axis=0), 2, axis=1))


def adapted(
    metered: Exposure,
    before: tuple[float, float],
    graph: NodeGraph,
    *,
    elapsed_s: float,
    constant_s: float,
) -> Exposure:
    """The exposure of a frame whose camera follows what it meters with a time constant.

    The logarithm of time x ISO goes to the metered one as 1 - exp(-t / tau), as auto exposure loops are tuned;
    what the graph gives as a number stays.

    Args:
        metered: what this frame asks for.
        before: exposure time [s] and ISO of the frame before.
        graph: that was metered.
        elapsed_s: between the two frames.
        constant_s: tau; 0 follows without delay.
    """
    sensor = graph.profiles.get("sensor")
    if constant_s <= 0.0 or not isinstance(sensor, SensorProfile):
        return metered
    old, new = np.log(before[0] * before[1]), np.log(metered.exposure_s * metered.iso)
    product = float(np.exp(new + (old - new) * np.exp(-elapsed_s / constant_s)))
    open_nodes = [
        node
        for op, name in (("sensor.expose", "exposure_s"), ("sensor.gain", "iso"))
        for node in graph.nodes_with(op)
        if node.params[name].is_auto
    ]
    auto = {node.op.name for node in open_nodes}
    exposure_s, iso = metered.exposure_s, metered.iso
    if "sensor.expose" in auto:
        base = sensor.iso_base if "sensor.gain" in auto else iso
        exposure_s = min(max(product / base, sensor.shortest_exposure_s), sensor.longest_exposure_s)
    if "sensor.gain" in auto:
        iso = min(max(product / exposure_s, sensor.iso_base), sensor.iso_max)
    return Exposure(exposure_s, iso, metered.mean_cd_m2, metered.limit)


def sensitivity(radiance: Image, graph: NodeGraph, exposure: Exposure) -> tuple[float, float] | None:
    """What a pixel makes of light, by running the graph on an even grey frame.

    Args:
        radiance: any frame of the shot; its geometry is used, not its pixels.
        graph: with one 'sensor.adc' node, or with several and a 'sensor.merge_hdr',
            whose most sensitive reading counts then.
        exposure: that it will be developed with.

    Returns:
        electrons of 1 cd m-2 in the middle of the frame [e-], the mean over the colour filters, and the noise that does
        not depend on light [e-]; None where the graph has no such node.
    """
    nodes = graph.nodes_with("sensor.merge_hdr")[-1:] or graph.nodes_with("sensor.adc")
    exposes = [node.name for node in graph.nodes_with("sensor.expose")]
    if len(nodes) != 1 or not _view_input(graph) or not exposes or not exposure.mean_cd_m2 > 0.0:
        return None
    level = np.float32(0.3 * exposure.mean_cd_m2)
    grey = radiance.with_pixels(np.full((32, 48, len(radiance.channels)), level, dtype=np.float32))
    run = graph.run(
        _steady(graph, grey), seed=0, settings=exposure.settings, until=nodes[0].name, keep=[*exposes, nodes[0].name]
    )
    signal_e = max(float(run[name].pixels[8:-8, 12:-12].mean(dtype=np.float64)) for name in exposes if name in run)
    metadata, nits = run[nodes[0].name].provenance, float(photometry.luminance(grey).mean())
    return (
        (signal_e / nits, float(metadata["total_dark_noise_dn"]) / float(metadata["system_gain_dn_e"]))
        if signal_e > 0.0
        else None
    )


def noise_floor(
    luminance_cd_m2: npt.NDArray[np.float64], *, electrons_per_cd_m2: float, dark_noise_e: float
) -> npt.NDArray[np.float64]:
    """What a pixel's own noise hides: the standard deviation of what it reads, as luminance.

    sigma = sqrt(n L + sigma_d^2) / n, of shot noise and the noise in the dark.  Fixed
    patterns are not in it: they are the same in every frame.

    Args:
        luminance_cd_m2: L [cd m-2], any shape; below 0 counts as 0.
        electrons_per_cd_m2, dark_noise_e: n and sigma_d, as `sensitivity` gives them.

    Returns:
        sigma [cd m-2], float64, shape of `luminance_cd_m2`; the mean over the colour
        filters in variance.  Above the first hand-over of a merged range the noise
        is larger.

    Source: EMVA 1288 release 4.0, section 2.4.
    """
    signal_e = np.maximum(luminance_cd_m2, 0.0) * electrons_per_cd_m2
    return np.asarray(np.sqrt(signal_e + dark_noise_e**2) / max(electrons_per_cd_m2, 1e-30))


def moments_of(graph: NodeGraph) -> dict[str, tuple[float, float]]:
    """The inputs that take the view in a part of a row's exposure, and the begin and end of that part, 0 to 1.

    Raises:
        GraphError: a part that does not begin before it ends, or ends after the exposure; an output of its name.
    """
    moments = {}
    for name in graph.inputs:
        if match := EXPOSURE.fullmatch(name):
            begin, end = (int(part) / 100.0 for part in match.groups())
            if not begin < end <= 1.0:
                raise GraphError(
                    f"graph {graph.name!r}: the input {name!r} is the view from {begin:.0%} to {end:.0%} of an "
                    f"exposure; the first is below the second, and that at most 100"
                )
            if f"{name}.exr" in graph.outputs:
                raise GraphError(
                    f"graph {graph.name!r}: the output {name}.exr is where a bake writes the input {name!r}"
                )
            moments[name] = begin, end
    return moments


def _view_input(graph: NodeGraph) -> str:
    """The input that takes the radiance of the whole view, or that of the longest exposure, or ''; others take that of
    groups of lamps.
    """
    parts = moments_of(graph)
    inputs = [
        name
        for name, port in graph.inputs.items()
        if port.quantity is Quantity.RADIANCE and not name.startswith(LIGHTGROUP) and name not in parts
    ]
    if not inputs and parts:
        return max(parts, key=lambda name: parts[name][1] - parts[name][0])
    return inputs[0] if len(inputs) == 1 else ""


def _steady(graph: NodeGraph, frame: Image) -> dict[str, Image]:
    """What to run a graph on so that nothing moves and no lamp of its flickers: their own light is 0, beside that of
    the whole view.
    """
    dark = frame.with_pixels(np.zeros_like(frame.pixels))
    lit = [name for name, port in graph.inputs.items() if port.quantity is not Quantity.DATA]
    return {name: dark if name.startswith(LIGHTGROUP) else frame for name in lit}


def _sites(mosaic: Image) -> dict[str, npt.NDArray[np.float64]]:
    """The pixels behind each filter of a mosaic that is even over 2 x 2 pixels, one of each two by two."""
    rows = cfa.PATTERNS[mosaic.provenance["cfa_pattern"]]
    corners = ((row, column) for row in (1, 0) for column in (0, 1))
    return {
        rows[row % len(rows)][column % len(rows[0])]: mosaic.pixels[row::2, column::2, 0].astype(np.float64).ravel()
        for row, column in corners
    }


def _saturation_e(graph: NodeGraph, radiance: Image, sensor: SensorProfile) -> tuple[float, float]:
    """Electrons of the most sensitive exposure, at base ISO, at which it is full, and at which the merged range is."""
    merges = graph.nodes_with("sensor.merge_hdr")
    if not merges:
        return sensor.saturation_e, sensor.saturation_e
    blinding = radiance.with_pixels(np.full((16, 16, len(radiance.channels)), BLINDING_CD_M2, dtype=np.float32))
    settings = {"exposure_s": sensor.longest_exposure_s, "iso": sensor.iso_base}
    run: GraphRun = graph.run(_steady(graph, blinding), seed=0, settings=settings, until=merges[-1].name)
    readings = [image for node, image in run.items() if graph.nodes[node].op.name == "sensor.adc"]
    gathered = max(float(image.provenance["gathered_um2_s"]) for image in readings)

    def full_e(image: Image) -> float:
        metadata = image.provenance
        signal_dn = float(np.median(image.pixels)) - float(metadata["black_level_dn"])
        return signal_dn / float(metadata["system_gain_dn_e"]) * gathered / float(metadata["gathered_um2_s"])

    full = max(full_e(image) for image in readings if image.provenance["gathered_um2_s"] == gathered)
    return full, full_e(run[merges[-1].name])


def _chosen(
    green: np.ndarray,
    strongest: np.ndarray,
    luminance: np.ndarray,
    sensor: SensorProfile,
    compensation: float,
    fixed_s: float | None,
    fixed_iso: float | None,
) -> Exposure:
    key_per_s, mean_cd_m2 = _geometric_mean(green), _geometric_mean(luminance)
    if key_per_s <= 0.0:
        return Exposure(fixed_s or sensor.longest_exposure_s, fixed_iso or sensor.iso_max, 0.0, "dark")
    day = float(np.interp(np.log10(max(mean_cd_m2, 1e-30)), np.log10([NIGHT_CD_M2, DAY_CD_M2]), [0.0, 1.0]))
    wanted_s = (NIGHT_KEY + day * (DAY_KEY - NIGHT_KEY)) / key_per_s
    highlight_per_s = float(np.percentile(strongest, HIGHLIGHT_PERCENTILE))
    if highlight_per_s > 0.0:
        wanted_s = min(wanted_s, (NIGHT_HIGHLIGHT + day * (DAY_HIGHLIGHT - NIGHT_HIGHLIGHT)) / highlight_per_s)
    wanted_s *= compensation
    at_iso = (fixed_iso or sensor.iso_base) / sensor.iso_base
    exposure_s = fixed_s or min(max(wanted_s / at_iso, sensor.shortest_exposure_s), sensor.longest_exposure_s)
    iso = fixed_iso or min(max(sensor.iso_base * (wanted_s / exposure_s), sensor.iso_base), sensor.iso_max)
    reached_s = exposure_s * iso / sensor.iso_base
    limit: Literal["none", "bright", "dark"] = (
        "bright" if reached_s > wanted_s * (1.0 + 1e-9) else "dark" if reached_s < wanted_s * (1.0 - 1e-9) else "none"
    )
    if fixed_s is not None and fixed_iso is not None:  # what is too bright or dark then is meant to be
        limit = "none"
    return Exposure(exposure_s, iso, mean_cd_m2, limit)


def _geometric_mean(values: np.ndarray) -> float:
    """Geometric mean between a thousandth of the 95th percentile and that percentile; 0 where nothing shines."""
    for percentile in (HIGHLIGHT_PERCENTILE, 99.0, 99.9, 100.0):
        top = float(np.percentile(values, percentile))
        if top > 0.0:
            return float(np.exp(np.mean(np.log(np.clip(values, top * 1e-3, top)))))
    return 0.0
