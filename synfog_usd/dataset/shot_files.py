"""The files of a shot, its row of the manifest, and the labels of a bake.

Takes shots that are rendered; develops them, writes what a bake promises, and gives what `bake.json` says of them.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from synfog_usd.base import files
from synfog_usd.base.image import Image, Quantity
from synfog_usd.dataset import labels, lanes, objects, stereo, visibility
from synfog_usd.dataset.plan import TOGETHER, BakePlan, noise_seed
from synfog_usd.dataset.scenes import pinhole_of, size_of
from synfog_usd.dataset.session import METER_WIDTH_PX
from synfog_usd.dataset.shot import MeteredView, RenderedShot, density_of, pixel_noise, sensor_noise

if TYPE_CHECKING:
    import numpy as np

    from synfog_usd.camera.graph import NodeGraph
    from synfog_usd.camera.pinhole import Pinhole
    from synfog_usd.dataset.drops import FallTime
    from synfog_usd.render.film.aovs import Aovs
    from synfog_usd.render.load import MitsubaScene
    from synfog_usd.render.picture import Rendered
    from synfog_usd.scene import SceneDict

OF_SHOT = ("radiance.exr", "layers.exr", "instances.json")
"""Files of a shot beside what its graph makes."""


def write_shot(result: RenderedShot, graph: NodeGraph, plan: BakePlan, specimen: str | None) -> dict[str, Any]:
    """Develop a shot, write its files, and give its row of the manifest."""
    from synfog_usd import camera
    from synfog_usd.camera import writers

    shot, rendered, folder = result.shot, result.rendered, plan.out / result.shot.folder
    marks: dict[str, str | int | float] = {
        "synfog:lighting": shot.lighting,
        "synfog:fog": shot.fog,
        "synfog:mor_m": result.mor_m or 0.0,
        "synfog:model": rendered.model,
    }
    more = provenance_of(result, plan, specimen)
    radiance = rendered.radiance.with_metadata(**more)
    exposures = {name: part.with_metadata(**more) for name, part in result.exposures.items()}
    writers.write_exr(folder / "radiance.exr", radiance, attributes=marks)
    writers.write_exr(folder / "layers.exr", _layers(rendered), attributes=marks)
    files.write_json(folder / "instances.json", labels.instance_list(result.clear, result.scene, _left(result, graph)))
    for name, part in exposures.items():
        writers.write_exr(folder / f"{name}.exr", part, attributes=marks)
    results = camera.develop(
        graph,
        inputs_of(graph, rendered, radiance, exposures),
        seed=noise_seed(plan.seed, shot.lighting, shot.fog, same_noise=plan.same_noise),
        exposure=result.view.exposure if result.view else None,
        keep=list(graph.outputs.values()),
    )
    for name, node in graph.outputs.items():
        writers.write_output(name, results[node], folder, options=graph.options_of(name))
    names = sorted([*OF_SHOT, *(f"{name}.exr" for name in exposures), *graph.outputs])
    return _row(result, plan) | {"files": {name: files.sha256_of(folder / name) for name in names}}


def write_further(result: RenderedShot, plan: BakePlan, specimen: str | None, moment: FallTime) -> dict[str, str]:
    """Write the light of a shot with the streaks of each further graph, whose exposure and lens are others.

    Args:
        result: without drops.

    Returns:
        file, <name of the graph>/radiance.exr -> its hash.
    """
    from synfog_usd import camera
    from synfog_usd.camera import writers
    from synfog_usd.dataset.drops import with_drops

    more, written, exposing = provenance_of(result, plan, specimen), {}, plan.exposes
    for path in exposing.meter_for:
        graph = camera.exposed(camera.load_graph(path), exposure_s=exposing.exposure_s, iso=exposing.iso)
        view = result.view and replace(result.view, exposure=result.view.further.get(path.stem, result.view.exposure))
        light = with_drops(replace(result, view=view, exposures={}), graph, moment).rendered.radiance
        name = f"{path.stem}/radiance.exr"
        writers.write_exr(plan.out / result.shot.folder / name, light.with_metadata(**more))
        written[name] = files.sha256_of(plan.out / result.shot.folder / name)
    return written


def provenance_of(result: RenderedShot, plan: BakePlan, specimen: str | None) -> dict[str, Any]:
    """What a camera notes of a shot beside its light: what its graph reads from the image's provenance."""
    from synfog_usd.render.load import is_thin_lens

    more: dict[str, Any] = {}
    if result.pinhole is not None:
        more["view"] = [*result.pinhole[:3], *result.pinhole.shift]
    if is_thin_lens(result.scene.camera):
        more["sharp_at_m"] = result.scene.camera.focus_m
    if specimen is not None:
        more["specimen"] = specimen
    if plan.exposes.ev:
        more["exposure_bias_ev"] = plan.exposes.ev
    if plan.clip is not None:
        more |= {"frame_number": plan.clip.number, "frames_per_s": plan.clip.per_s}
    return more


def inputs_of(
    graph: NodeGraph, rendered: Rendered, radiance: Image, exposures: Mapping[str, Image]
) -> dict[str, Image]:
    """What a graph is given of a shot: its light, and that of parts of the exposure and of groups of lamps."""
    whole = {} if exposures and "radiance" not in graph.inputs else {"radiance": radiance}
    return {**whole, **exposures, **_groups_of(graph, rendered)}


def _groups_of(graph: NodeGraph, rendered: Rendered) -> dict[str, Image]:
    """The light of groups of lamps alone, for inputs that ask for it by name; 0 where no such lamp is lit."""
    import numpy as np

    from synfog_usd.camera.exposure import LIGHTGROUP

    radiance = rendered.radiance
    return {
        name: radiance.with_pixels(
            rendered.groups.get(name.removeprefix(LIGHTGROUP), np.zeros_like(radiance.pixels)).astype(np.float32)
        )
        for name in graph.inputs
        if name.startswith(LIGHTGROUP)
    }


def _layers(rendered: Rendered) -> list[Image]:
    """What layers.exr holds."""
    variance = rendered.radiance.variance
    assert variance is not None
    named = {
        **rendered.components,
        "variance": variance,
        **{f"lightgroup_{name}": pixels for name, pixels in rendered.groups.items()},
    }
    channels = rendered.radiance.channels
    images = [rendered.aovs.transmittance_image()]
    images += [
        Image(pixels, tuple(f"{name}.{channel}" for channel in channels), Quantity.DATA)
        for name, pixels in named.items()
    ]
    if rendered.error is not None:
        images.append(Image(rendered.error[:, :, None], ("error.Y",), Quantity.DATA))
    return images


def _row(result: RenderedShot, plan: BakePlan) -> dict[str, Any]:
    """What the manifest says of a shot, but for its files."""
    shot, scene, view, pinhole, rendered = result.shot, result.scene, result.view, result.pinhole, result.rendered
    size = [scene.camera.width_px, scene.camera.height_px]
    row: dict[str, Any] = {
        "lighting": shot.lighting,
        "fog": shot.fog,
        "folder": shot.folder,
        "mor_m": None if result.mor_m is None else round(result.mor_m, 6),
        "camera": scene.camera.path,
        "size_px": [pinhole.width_px, pinhole.height_px] if pinhole else size,
    }
    if pinhole:
        row["rendered_px"] = size
    row |= {
        "model": {"name": rendered.model, "bands": len(rendered.radiance.channels), "why": rendered.why},
        "samples": float(f"{rendered.samples:.5g}"),
        "denoised": bool(rendered.radiance.provenance.get("denoised", False)),
        "target": _target(plan, view.pixel if view else None, rendered),
        "relative_error": float(f"{rendered.relative_error:.4g}"),
        "mottle": None if rendered.mottle is None else float(f"{rendered.mottle:.4g}"),
        "exposure": _exposure(view, plan) if view and view.exposure else None,
    }
    if view and view.further:
        row["further_exposures"] = {
            name: {"exposure_s": exposure.exposure_s, "iso": exposure.iso} for name, exposure in view.further.items()
        }
    if plan.clip and rendered.radiance.provenance.get("denoised"):
        row["rounds"] = list(rendered.rounds)
    black = _why_black(rendered.radiance, scene)
    return row | {"warnings": [*rendered.warnings, *([black] if black else [])]}


def _exposure(view: MeteredView, plan: BakePlan) -> dict[str, Any]:
    assert view.exposure is not None
    row: dict[str, Any] = {"exposure_s": view.exposure.exposure_s, "iso": view.exposure.iso}
    if view.metered:
        row["metered"] = view.metered
    if None in (plan.exposes.exposure_s, plan.exposes.iso):
        row |= _metered_on(plan)
    return row | ({"ev": plan.exposes.ev} if plan.exposes.ev else {})


def _metered_on(plan: BakePlan) -> dict[str, str]:
    together = f", of {len(plan.rig)} cameras together" if len(plan.rig) > 1 and plan.exposes.meter == TOGETHER else ""
    return {"metered_on": f"the clear frame, {METER_WIDTH_PX} px wide{together}"}


def _left(result: RenderedShot, graph: NodeGraph) -> dict[int, dict[str, Any]]:
    """What the fog leaves of each instance that is seen, by label id."""
    from synfog_usd import camera
    from synfog_usd.base import photometry

    radiance, visible, noise = result.rendered.radiance, result.rendered.aovs, result.noise
    luminance = photometry.luminance(radiance)
    if (
        noise is None and not (result.view and result.view.exposure) and (luminance > 0.0).any()
    ):  # the graph says itself how it exposes
        exposure = camera.Exposure(1.0, 1.0, float(luminance.mean()))
        pixel = camera.sensitivity(radiance, graph, exposure)
        if pixel:
            noise = pixel_noise(sensor_noise(pixel), density_of(result.scene, result.pinhole))
    surface = result.rendered.components.get("surface")
    unscattered = None if surface is None else photometry.luminance(radiance.with_pixels(surface))
    return visibility.rows(visible.instance_id, visible.transmittance, luminance, unscattered, noise)


def _why_black(radiance: Image, scene: SceneDict) -> str | None:
    from synfog_usd.translate import why_black

    return (
        None
        if (radiance.pixels > 0.0).any()
        else why_black(scene) or "the picture is black: no light reaches the camera"
    )


def _target(plan: BakePlan, pixel: tuple[float, float] | None, rendered: Rendered) -> dict[str, Any]:
    """What the render was to reach, the share of its pixels that did, and the sensor's noise where it is known.

    For the quality `sensor`: the shares of its noise under which what differs from seed to seed and the whole error are
    to stay.
    """
    sampling, quality = plan.sampling, plan.sampling.promise
    target: dict[str, Any] = {}
    if sampling.target_error is not None:
        target = {"relative_error": sampling.target_error}
    elif quality.error is not None:
        target = {"relative_error": quality.error, "mottle": quality.mottle}
    elif not quality.sensor or pixel is None:
        target = {"samples": sampling.samples}
    if pixel is not None:
        target["sensor"] = {
            "electrons_per_cd_m2": float(f"{pixel[0]:.4g}"),
            "dark_noise_e": float(f"{pixel[1]:.4g}"),
        }
        if quality.sensor and sampling.target_error is None:
            whole = 1.0 if rendered.radiance.provenance.get("denoised") else 1 / 3
            target["sensor"] |= {"share": 1 / 3, "whole_share": whole}
    return target | ({} if rendered.under_target is None else {"pixels_under_it": round(rendered.under_target, 4)})


def write_labels(
    visible: Aovs,
    scene: SceneDict,
    plan: BakePlan,
    graph: NodeGraph | None = None,
    pinhole: Pinhole | None = None,
    pierced: tuple[np.ndarray, np.ndarray] | None = None,
    loaded: MitsubaScene | None = None,
) -> dict[str, str]:
    """Write what is seen where in clear air, bent as the graph's lens bends the picture; radiance.exr and layers.exr
    stay those of a pinhole.

    `pierced` tells what stands behind, see `aovs.pierced`; `loaded`, what the right eye of a rig sees of it.
    """
    from synfog_usd.camera import distortion, writers

    metadata: dict[str, Any] = {}
    nearest = None
    bent = graph and distortion.of_graph(graph, pinhole_of(scene.camera), pinhole)
    pair, disparity = stereo.pair_of(scene), None
    if pair and loaded and not bent:
        disparity = stereo.planes(visible, pair, loaded)
    area, bend = (lanes.ids(visible, scene) if scene.lanes else None), None
    if bent:
        node, warp = bent
        nearest, bend = warp.nearest(), functools.partial(warp.bent, pinhole_of(scene.camera))
        area = None if area is None else area[nearest]
        visible = labels.warped(visible, nearest)
        metadata = {
            "warped": f"distortion of node {node!r}; radiance.exr and layers.exr are not",
            "camera_matrix_px": warp.camera_matrix(),
            "distortion_coefficients": list(warp.coefficients),
        }
    image = labels.label_image(visible, scene.instances, area, disparity, parts=bool(scene.parts))
    header = {
        name: str(value) for name, value in image.provenance.items() if name.startswith("cryptomatte/")
    }  # where Cryptomatte's readers look
    writers.write_exr(plan.out / "labels.exr", image.with_metadata(**metadata), attributes=header)
    more = {}
    if pierced is not None:
        view = objects.Projection.of(scene.camera if pinhole is None else replace(scene.camera, **size_of(pinhole)))
        more = objects.rows(scene, pierced, view, nearest)
        eye = view.metadata(scene.origin_m)
        if bent:
            eye |= {
                "model": "opencv",
                "camera_matrix_px": metadata["camera_matrix_px"],
                "distortion_coefficients": metadata["distortion_coefficients"],
            }
        metadata = {"camera": eye} | metadata
    if pair and disparity is not None:
        metadata |= {"stereo": pair.metadata()}
    elif pair:
        metadata |= {"stereo": {"right": pair.right.path, "no_disparity": "the lens distorts: rows do not match"}}
    if scene.parts:
        metadata |= {"parts": objects.moving_parts(scene)}
    if area is not None:
        metadata |= {"lanes": lanes.rows(area, scene, bend)}
    files.write_json(plan.out / "labels.json", labels.label_list(visible, scene.instances, more) | metadata)
    return {name: files.sha256_of(plan.out / name) for name in ("labels.exr", "labels.json")}
