"""A clip as time samples of a stage: where everything that moves is, and the cameras of the car.

Takes a layer with the drawn street and the tracks of what moves in it.  What stands has no samples.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pxr import Gf, Sdf

from synfog_usd.base.arrays import Array
from synfog_usd.fog import Fog
from synfog_usd.world import authoring
from synfog_usd.world.roads import spray, stage
from synfog_usd.world.shapes import shift, turn
from synfog_usd.world.spec import Placement, View, WorldSpec
from synfog_usd.world.traffic.motion import Clip, Track
from synfog_usd.world.traffic.pedals import PEDALLERS
from synfog_usd.world.traffic.samples import KINDS, attribute, order, sample
from synfog_usd.world.traffic.write_people import author_walker, rise_of
from synfog_usd.world.traffic.write_signals import author_signal
from synfog_usd.world.traffic.write_vehicles import author_vehicle


def author(layer: Sdf.Layer, spec: WorldSpec, clip: Clip) -> None:
    """Put a street into motion.

    Args:
        layer: `roads.stage.author` made it of `spec`.
        spec: what stands where at frame 0.
        clip: of the same street.
    """
    layer.startTimeCode, layer.endTimeCode = 0.0, float(clip.codes[-2])
    layer.timeCodesPerSecond = layer.framesPerSecond = clip.fps
    for index, track in sorted(clip.tracks.items()):
        p = spec.placed[index]
        prim = layer.GetPrimAtPath(f"/World/{p.group}/{p.name}")
        _author_track(layer, prim, p, track, clip)
        if p.group == "Vehicles":
            author_vehicle(layer, prim, p, track, clip.codes)
        if p.group == "People" or p.asset in PEDALLERS:
            author_walker(layer, prim, p, track, clip)
    for index, lenses in sorted(clip.signals.items()):
        author_signal(layer, spec.placed[index], lenses, clip.codes)
    _author_cameras(layer, spec, clip)
    drift = layer.GetAttributeAtPath("/World/Fog/Global.xformOp:translate")
    way = np.outer(clip.codes / clip.fps, [*spec.wind_m_s, 0.0])
    places = [Gf.Vec3d(*row) for row in np.round(np.array(drift.default) + way, 4).tolist()]
    sample(layer, drift.path, clip.codes, places)
    for variant, fog in spec.falls.items():
        _author_spray(layer, spec, clip, variant, fog)


def _author_spray(layer: Sdf.Layer, spec: WorldSpec, clip: Clip, variant: str, fog: Fog) -> None:
    """Clouds of spray go with their vehicles, as dense as their speed makes them, and are none in frames in which one
    meets the camera or a cloud before it.
    """
    areas = [spray.around(clip.ego.x, clip.ego.y)]
    for number, cloud in enumerate(spray.clouds(spec.placed, spec.view, fog), 1):
        track = clip.tracks.get(cloud.vehicle)
        prim = layer.GetPrimAtPath(spray.PATH.format(number).replace("/World/", f"/World{{fog={variant}}}"))
        if track is None or prim is None:
            continue
        rows = np.stack([track.x, track.y, track.z, track.heading, track.pitch], axis=1)
        places = [Gf.Matrix4d(np.round(cloud.to_world(*row).T, 5).tolist()) for row in rows.tolist()]
        sample(layer, prim.attributes["xformOp:transform"].path, clip.codes, places)
        dense = cloud.densest(track.speed, stage.spray_water(spec, fog))
        sample(layer, prim.attributes["synfog:fog:sigma_t"].path, clip.codes, np.round(dense, 6).tolist())
        here = spray.corners(track.x, track.y, track.heading, cloud.behind_m, cloud.half_m)
        free = track.shown & (dense > 0.0)
        for area in areas:
            free &= ~spray.meet(here, area)
        sample(layer, attribute(prim, "synfog:fog:enabled", KINDS.Bool, True), clip.codes, free.tolist())
        areas.append(here)


def _author_track(layer: Sdf.Layer, prim: Sdf.PrimSpec, p: Placement, track: Track, clip: Clip) -> None:
    names, codes = ["xformOp:translate"], clip.codes
    rise = rise_of(p, track, codes / clip.fps) if p.group == "People" else 0.0
    places = np.round(np.stack([track.x, track.y, track.z + rise], axis=1), 4)
    sample(layer, prim.attributes[names[0]].path, codes, [Gf.Vec3d(*row) for row in places.tolist()])
    for axis, angle in (("Z", track.heading), ("X", track.pitch), ("Y", track.roll)):
        name, angles = f"xformOp:rotate{axis}", np.round(angle, 3)
        if name in prim.attributes or np.ptp(angles) > 0.0:
            names.append(name)
            sample(layer, attribute(prim, name, KINDS.Float, 0.0), codes, angles.tolist())
    if p.size != 1.0:
        names.append("xformOp:scale")
    order(prim, names)
    if not track.shown.all():
        shown = ["inherited" if item else "invisible" for item in track.shown]
        sample(layer, attribute(prim, "visibility", KINDS.Token, shown[1]), codes, shown)
    if p.group == "Vehicles":
        h, up = np.radians(track.heading), np.radians(track.pitch)
        ahead = np.stack([-np.sin(h) * np.cos(up), np.cos(h) * np.cos(up), np.sin(up)], axis=1)
        velocity = np.round(track.speed[:, None] * ahead, 3) + 0.0
        still = Gf.Vec3f(*velocity[1].tolist())
        path = attribute(prim, authoring.VELOCITY, KINDS.Vector3f, still)
        sample(layer, path, codes, [Gf.Vec3f(*row) for row in velocity.tolist()])


# -- the camera's car


def _author_cameras(layer: Sdf.Layer, spec: WorldSpec, clip: Clip) -> None:
    """The ego's camera, those of its rig, and its headlights."""
    views, rolls = _views(spec.view, clip.ego), np.round(clip.ego.roll, 4).tolist()
    ego = layer.GetPrimAtPath(authoring.EGO)
    for name, values in (
        ("xformOp:translate", [Gf.Vec3d(item.x, item.y, item.z) for item in views]),
        (
            "xformOp:rotateXYZ",
            [Gf.Vec3f(item.tilt, roll, item.heading) for item, roll in zip(views, rolls, strict=True)],
        ),
    ):
        sample(layer, ego.attributes[name].path, clip.codes, values)
    above = spec.view.z - float(spec.road.height(spec.view.x, spec.view.y))
    places = {f"{authoring.RIG}/{item.name}": [authoring.rig_place(view, item) for view in views] for item in spec.rig}
    lamps = [dict(stage.headlights(view, view.z - above)) for view in views]
    for name in lamps[0]:
        places[f"/World/Lights/Headlights/{name}"] = [item[name] for item in lamps]
    for path, matrices in places.items():
        prim = layer.GetPrimAtPath(path)
        if prim:
            rolled = [_rolled(view, roll) @ item for view, roll, item in zip(views, rolls, matrices, strict=True)]
            values = [Gf.Matrix4d(np.round(item.T, 6).tolist()) for item in rolled]
            sample(layer, prim.attributes["xformOp:transform"].path, clip.codes, values)


def _rolled(view: View, roll: float) -> Array:
    """(4, 4) turn of all that is fixed to the car about the line through the lens along which the car looks."""
    car = shift(view.x, view.y, view.z) @ turn(view.heading - view.yaw)
    return np.asarray(car @ turn(roll, "y") @ np.linalg.inv(car))


def _views(view: View, track: Track) -> list[View]:
    """The view at each frame; at frame 0 as it was drawn."""
    rows = np.stack([track.x, track.y, track.z, track.heading + view.yaw, view.tilt + track.pitch], axis=1)
    result = [replace(view, x=x, y=y, z=z, heading=h, tilt=t) for x, y, z, h, t in np.round(rows, 4).tolist()]
    result[1] = view
    return result
