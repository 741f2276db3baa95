"""Rain and snow before a camera: drops and flakes that it tells apart, drawn into the light before lens and sensor.

Takes a rendered shot in rain or snow; gives the same with drops, out of whose light the same part of the medium is
taken, so that the mean over all drops is the medium's own picture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from synfog_usd.base.arrays import Array, FloatArray, total
from synfog_usd.base.image import Image
from synfog_usd.base.numbers import RGB
from synfog_usd.base.seeds import seed32
from synfog_usd.dataset.drop_light import (
    FARTHEST_M,
    PointLamp,
    Sightlines,
    falling_in,
    lamps_of,
    scattered,
    volumes_around,
)
from synfog_usd.dataset.objects import Projection
from synfog_usd.fog import falling
from synfog_usd.fog.falling import Cone, Drops, SizeClasses
from synfog_usd.fog.medium import FogMedium

if TYPE_CHECKING:
    from synfog_usd.camera.graph import NodeGraph
    from synfog_usd.camera.streaks import Shutter, Streaks
    from synfog_usd.dataset.session import Session
    from synfog_usd.dataset.shot import RenderedShot
    from synfog_usd.scene import Camera

RESOLVED_PX = 0.15
"""Diameter in the picture of the drops that are drawn [px]; what is smaller there stays in the medium."""

UNKNOWN_EXPOSURE_S = 1.0 / 60.0
"""Of a graph that exposes nothing."""

AROUND = 1.0 / 40.0
"""Part of the picture's width over which the light on drops is a mean, as a Gaussian's deviation."""

LEAST_AHEAD_M = 0.05
"""Before a pinhole's plane."""


@dataclass(frozen=True)
class FallTime:
    """When drops are seen, and which drops they are.

    Attributes:
        time_s: of the frame on its stage [s].
        seed: of all frames and cameras.
    """

    time_s: float
    seed: int

    @classmethod
    def of(cls, session: Session) -> FallTime:
        """That of a session's frame."""
        from synfog_usd.translate import own_frame

        plan, rate = session.plan, float(session.stage.GetTimeCodesPerSecond())
        code = plan.frame if plan.frame is not None else own_frame(session.stage) or 0.0
        return cls(code / rate if 0.0 < rate < math.inf else 0.0, plan.paths)


def with_drops(result: RenderedShot, graph: NodeGraph, moment: FallTime) -> RenderedShot:
    """A shot with the drops and flakes that its camera tells apart; the shot itself where none fall.

    A drop shows a wide view of what is around it, upside down (Garg and Nayar 2007), and a flake scatters all round.
    Both send what the medium itself sends to the camera: the airlight of the picture over the share of light that the
    medium stops, a mean over `AROUND`, without that of lamps.  Each lamp lights each drop by itself, see `drop_light`.

    A pixel L becomes M (L - (1 - T) J) / T + (1 - M) K, whose mean over drops is L.  T is the mean share of light that
    the drops let through, M what they let through now; J is their light on average, K now.
    """
    from synfog_usd.camera.exposure import moments_of

    scene, rendered = result.scene, result.rendered
    kinds = falling_in(scene)
    if not kinds or scene.camera.width_m > 0.0:
        return result
    parts, shutter = moments_of(graph), shutter_of(result, graph)
    lamps = lamps_of(scene) if rendered.radiance.pixels.shape[2] == RGB else []
    falls, mean = _falls(kinds, result, graph, shutter.exposure_s, moment, lamps)
    light, distance_m = light_on_drops(result, lamps), rendered.aovs.distance_m.astype(np.float32)
    radiance = _through(rendered.radiance, mean, _depth(falls, shutter, distance_m), light)
    components = dict(rendered.components)
    if components:
        components["drops"] = radiance.pixels - rendered.radiance.pixels
    exposures = {
        name: _through(picture, mean, _depth(falls, replace(shutter, part=parts[name]), distance_m), light)
        for name, picture in result.exposures.items()
    }
    return replace(result, rendered=replace(rendered, radiance=radiance, components=components), exposures=exposures)


def _through(picture: Image, mean: FloatArray, drops: FloatArray, light: FloatArray) -> Image:
    """A picture behind drops, whose light without lamps is `light`.

    Args:
        mean: (H, W, 1 + C) optical depth in the medium, and times the light of lamps; drops: the same, now.
    """

    def veil(depth: FloatArray) -> tuple[FloatArray, FloatArray]:
        free = np.exp(-depth[:, :, :1])
        of_lamps = depth[:, :, 1:] / np.maximum(depth[:, :, :1], 1e-9) if depth.shape[2] > 1 else 0.0
        return free, (1.0 - free) * (light + of_lamps)

    (through, expected), (free, sent) = veil(mean), veil(drops)
    behind = np.maximum((picture.pixels - expected) / through, 0.0)
    return picture.with_pixels(behind * free + sent, variance=picture.variance)


def _falls(
    kinds: Sequence[tuple[SizeClasses, FogMedium, Array]],
    result: RenderedShot,
    graph: NodeGraph,
    exposure_s: float,
    moment: FallTime,
    lamps: Sequence[PointLamp],
) -> tuple[list[Streaks], FloatArray]:
    """Drops of each kind, and (H, W, 1 + C) the mean optical depth of all of them, and times the light of lamps."""
    camera, distance_m = result.scene.camera, result.rendered.aovs.distance_m
    view, (aperture_m, focus_m) = Projection.of(camera), _lens(camera, graph)
    eye_m = camera.to_world[:3, 3] + np.asarray(result.scene.origin_m)
    towards = Cone(eye_m, -camera.to_world[:3, 2], _half_angle(camera))
    depth, falls = np.zeros((*distance_m.shape, 4 if lamps else 1), np.float32), []
    for number, (sizes, medium, wind) in enumerate(kinds):
        reach_m = reach_of(sizes, view)
        drops = falling.falling(
            sizes, reach_m, towards, time_s=moment.time_s, wind_m_s=wind, seed=seed32(moment.seed, "falling", number)
        )
        depth[:, :, 0] += sizes.optical_depth(reach_m, distance_m)
        light = np.zeros((len(drops.place_m), 0))
        if lamps:
            way = drops.place_m / np.linalg.norm(drops.place_m, axis=1)[:, None]
            light = scattered(lamps, drops.place_m + camera.to_world[:3, 3], -way, medium, result.shade)
            lines = Sightlines.of(camera, lamps, medium, falling.FAR_M, result.shade)
            depth[:, :, 1:] += lines.sum(sizes.optical_depth(reach_m, lines.ends_m), distance_m)
        falls.append(streaks_of(drops, view, exposure_s, aperture_m, focus_m, light))
    return falls, depth


def reach_of(sizes: SizeClasses, view: Projection) -> Array:
    """(K,) distance [m] within which a camera tells the drops of a class apart, and they are drawn."""
    middles = 0.5 * (sizes.edges_m[1:] + sizes.edges_m[:-1])
    return np.minimum(middles * view.scale_px / RESOLVED_PX, falling.FAR_M)


def shutter_of(result: RenderedShot, graph: NodeGraph) -> Shutter:
    """When the rows of the graph's sensor expose."""
    from synfog_usd.camera.profiles import SensorProfile
    from synfog_usd.camera.streaks import Shutter

    nodes, sensor = graph.nodes_with("sensor.expose"), graph.profiles.get("sensor")
    exposure_s = UNKNOWN_EXPOSURE_S
    if nodes and not nodes[0].params["exposure_s"].is_auto:
        exposure_s = float(nodes[0].params["exposure_s"].value)
    elif result.view and result.view.exposure:
        exposure_s = result.view.exposure.exposure_s
    return Shutter(exposure_s, sensor.readout_s if isinstance(sensor, SensorProfile) else 0.0)


def streaks_of(
    drops: Drops, view: Projection, exposure_s: float, aperture_m: float, focus_m: float, light: Array | None = None
) -> Streaks:
    """What a camera makes of drops.

    A point at distance d is a disc as wide as the lens's opening is seen from there, less than from the plane of focus
    s: aperture x |1/d - 1/s| [rad].

    Args:
        drops: in the scene's axes, from the camera's place.
        view: of the camera.
        exposure_s: over which speeds across the picture are taken [s].
        aperture_m: width of the lens's opening [m].
        focus_m: distance of sharp focus [m]; may be infinite.
        light: (N, C) radiance of each drop by lamps.
    """
    from synfog_usd.camera.streaks import Streaks

    light = np.zeros((len(drops.place_m), 0)) if light is None else light
    local = drops.place_m @ view.rotation.T
    half = (drops.velocity_m_s - np.array(view.camera.velocity_m_s)) @ view.rotation.T * (0.5 * exposure_s)
    if view.camera.fisheye is None:
        ahead = (local[:, 2] - np.abs(half[:, 2])) > LEAST_AHEAD_M
        drops, local, half, light = drops[ahead], local[ahead], half[ahead], light[ahead]
    distance = np.linalg.norm(local, axis=1)
    if view.camera.fisheye is None:
        scale = view.scale_px * (distance / local[:, 2]) ** 1.5
    else:
        angle = np.arccos(np.clip(local[:, 2] / distance, -1.0, 1.0))
        scale = view.scale_px / np.sqrt(view.camera.fisheye.solid_angle(angle))
    width = drops.diameter_m / distance * scale
    return Streaks(
        view.places_px(local),
        (view.places_px(local + half) - view.places_px(local - half)) / exposure_s,
        math.pi / 4.0 * width**2 * drops.share,
        width * np.sqrt(np.maximum(drops.share, 1.0)),
        drops.turn_rad,
        scale * aperture_m * np.abs(1.0 / distance - 1.0 / focus_m),
        distance,
        light,
    )


def light_on_drops(result: RenderedShot, lamps: Sequence[PointLamp]) -> FloatArray:
    """(H, W, C) radiance of drops: what the medium sends to the camera over the share that it stops, a mean around each
    pixel, without what lamps send by way of it; the picture's mean where a model tells no airlight apart.
    """
    from scipy.ndimage import gaussian_filter

    rendered, scene = result.rendered, result.scene
    picture = rendered.radiance.pixels
    airlight = [part for name, part in rendered.components.items() if name.startswith("airlight")]
    if not airlight:
        return np.broadcast_to(picture.mean(axis=(0, 1)), picture.shape)
    spread = AROUND * picture.shape[1]
    stopped = gaussian_filter(1.0 - rendered.aovs.transmittance, spread)
    sent = np.maximum(total(airlight), 0.0)
    if lamps:
        medium = next(volume.medium for volume in volumes_around(scene) if volume.medium.falls)
        lines = Sightlines.of(scene.camera, lamps, medium, FARTHEST_M, result.shade)
        share = medium.albedo * (1.0 - np.exp(-medium.sigma_t_per_m * lines.ends_m))
        sent = sent - lines.sum(share, rendered.aovs.distance_m)
    planes = [gaussian_filter(plane, spread) for plane in np.moveaxis(sent, 2, 0)]
    return np.stack([np.maximum(plane, 0.0) / np.maximum(stopped, 1e-6) for plane in planes], axis=2).astype(np.float32)


def _lens(camera: Camera, graph: NodeGraph) -> tuple[float, float]:
    """Width of the opening and distance of focus [m]: the stage's, where its lens has an f-number, else those of the
    graph's lens focused far away.
    """
    from synfog_usd.camera.profiles import LensProfile

    if camera.f_number > 0.0:
        return camera.focal_length_m / camera.f_number, camera.focus_m
    lens = graph.profiles.get("lens")
    return (1e-3 * lens.focal_length_mm / lens.f_number if isinstance(lens, LensProfile) else 0.0), math.inf


def _half_angle(camera: Camera) -> float:
    """Angle [rad] between the camera's axis and the farthest corner of its picture."""
    corners = camera.directions(np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)]))
    angles = np.arccos(np.clip(corners @ -camera.to_world[:3, 2], -1.0, 1.0))
    reach = camera.fisheye.reach_rad if camera.fisheye else 0.0
    return float(np.where(np.isnan(angles), reach, angles).max())


def _depth(falls: Sequence[Streaks], shutter: Shutter, distance_m: FloatArray) -> FloatArray:
    """`depth_of` all kinds of drops together."""
    from synfog_usd.camera.streaks import depth_of

    return total([depth_of(streaks, shutter, distance_m) for streaks in falls])
