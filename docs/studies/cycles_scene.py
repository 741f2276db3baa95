"""One of our scenes as Blender Cycles can draw it too: matt flat colours, the same lamps, sky, fog and camera.

Takes a stage; gives the simplified `SceneDict` that our own renderer draws, and
`<stem>.npz` + `<stem>.json`, which `cycles_peer.py` reads in Blender's Python.  The
two then draw one and the same instance, so that their means must agree and their
errors can be compared.

What the files hold: lengths in metres, Z up; triangles with one colour each; radiance
in nits, intensities in candela, linear Rec.709.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import trimesh

from synfog_usd.render.flatten import flatten
from synfog_usd.scene import SceneDict

Array = npt.NDArray[np.float64]
GREY = (0.18, 0.18, 0.18)
COLOURS = ("base_color", "reflectance", "diffuse_reflectance", "vertex_color")
BALL_SUBDIVISIONS = 3
"""1280 faces: the area of a sphere to 0.6 %, and both renderers get the same faces."""
DISK_SIDES = 64


def simplified(scene: SceneDict) -> SceneDict:
    """The same geometry and light with one matt colour a material, flat faces and lamps made of triangles.

    Dropped: textures (their mean is kept), gloss, metal, smooth normals, masks, instances and their labels.

    Raises:
        ValueError: a light or shape that Cycles is not given here.
    """
    flat, *_ = flatten(scene)
    world: dict[str, Any] = {"type": "scene"}
    parts: dict[tuple[float, ...], list[tuple[Array, npt.NDArray[np.int64]]]] = {}
    for key, part in flat.world.items():
        if key == "type" or key.startswith("mat_"):
            continue
        if key.startswith("light_"):
            if part["type"] not in ("spot", "point", "constant", "envmap"):
                raise ValueError(f"{key}: a light of type {part['type']} is not exported")
            world[key] = dict(part)
            continue
        points, faces = _triangles(key, part)
        colour = mean_colour(_material(flat.world, part["bsdf"]), part)
        if "emitter" not in part:
            parts.setdefault(colour, []).append((points, faces))
            continue
        radiance = part["emitter"]["radiance"]
        emitter = dict(part["emitter"]) | {"radiance": {"type": "rgb", "value": list(_flat_colour(radiance))}}
        world[key] = _mesh(points, faces, _matt(world, colour)) | {"emitter": emitter}
    for index, (colour, meshes) in enumerate(parts.items()):
        starts = np.cumsum([0, *(len(points) for points, _ in meshes[:-1])])
        joined = (
            np.concatenate([points for points, _ in meshes]),
            np.concatenate([faces + start for (_, faces), start in zip(meshes, starts, strict=True)]),
        )
        world[f"shape_{index:03d}_flat"] = _mesh(*joined, _matt(world, colour))
    return replace(scene, world=world, instances=(), instance_of={}, notes=())


def export(scene: SceneDict, stem: Path) -> None:
    """Write `<stem>.npz` and `<stem>.json` of a scene that `simplified` made.

    Raises:
        ValueError: fog that is not one uniform box, or a camera with a lens.
    """
    if len(scene.fog) > 1 or any(v.boundary.kind != "box" or v.medium.profile != "uniform" for v in scene.fog):
        raise ValueError("only one uniform box of fog, or none, is exported")
    if scene.camera.f_number > 0.0 or scene.camera.shift != (0.0, 0.0):
        raise ValueError("only a pinhole that looks straight ahead is exported")
    positions, faces, which, arrays = [], [], [], {}
    materials: list[dict[str, Any]] = []
    lamps: list[dict[str, Any]] = []
    start = 0
    sky: list[float] | str | None = None
    for key, part in scene.world.items():
        if key.startswith("shape_"):
            emission = [float(c) for c in part["emitter"]["radiance"]["value"]] if "emitter" in part else None
            colour = _material(scene.world, part["bsdf"])["reflectance"]["value"]
            positions.append(np.asarray(part["positions"], dtype=np.float32))
            faces.append(np.asarray(part["faces"], dtype=np.int32) + start)
            which.append(np.full(len(faces[-1]), len(materials), dtype=np.int32))
            materials.append({"colour": [float(c) for c in colour], "emission": emission})
            start += len(positions[-1])
        elif key.startswith("light_"):
            if part["type"] == "constant":
                sky = [float(c) for c in part["radiance"]["value"]]
            elif part["type"] == "envmap":
                arrays["sky"], sky = _cycles_sky(part), "sky"
            else:
                lamps.append(_lamp(part))
    fog = None
    if scene.fog:
        volume = scene.fog[0]
        medium = volume.medium
        fog = {
            "to_world": volume.boundary.to_world.tolist(),
            "sigma_t": medium.sigma_t_per_m,
            "albedo": medium.albedo,
            "g": medium.g,
        }
    camera = scene.camera
    plain = {
        "camera": {
            "to_world": camera.to_world.tolist(),
            "fov_x_deg": camera.fov_x_deg,
            "width": camera.width_px,
            "height": camera.height_px,
        },
        "fog": fog,
        "sky": sky,
        "lamps": lamps,
        "materials": materials,
    }
    np.savez_compressed(
        stem.with_suffix(".npz"),
        positions=np.concatenate(positions),
        faces=np.concatenate(faces),
        material=np.concatenate(which),
        **arrays,
    )
    stem.with_suffix(".json").write_text(json.dumps(plain, indent=1))


def mean_colour(material: Mapping[str, Any], mesh: Mapping[str, Any]) -> tuple[float, float, float]:
    """Mean linear base colour of a material; of the mesh's corners where it takes its colour from them."""
    for name in COLOURS:
        if name in material:
            value = material[name]
            if isinstance(value, Mapping) and value.get("type") == "mesh_attribute":
                return _three(np.asarray(mesh["vertex_color"], dtype=np.float64).mean(axis=0))
            return _flat_colour(value)
    for value in material.values():
        if isinstance(value, Mapping) and "type" in value and any(name in value or "bsdf" in value for name in COLOURS):
            return mean_colour(value, mesh)
    return GREY


def _flat_colour(value: Any) -> tuple[float, float, float]:
    if isinstance(value, Mapping) and value["type"] == "bitmap":
        pixels = np.asarray(value["bitmap"])
        texels = pixels.astype(np.float64)
        if pixels.dtype == np.uint8:
            texels = texels / 255.0
            if not value.get("raw", False):
                texels = np.where(texels <= 0.04045, texels / 12.92, ((texels + 0.055) / 1.055) ** 2.4)
        return _three(texels.reshape(-1, texels.shape[-1])[:, :3].mean(axis=0))
    return _three(value["value"] if isinstance(value, Mapping) else value)


def _three(value: Any) -> tuple[float, float, float]:
    numbers = (
        np.broadcast_to(np.asarray(value, dtype=np.float64).ravel(), 3)
        if np.size(value) == 1
        else np.asarray(value, dtype=np.float64).ravel()[:3]
    )
    r, g, b = (round(float(c), 6) for c in numbers)
    return r, g, b


def _material(world: Mapping[str, Any], reference: Mapping[str, Any]) -> Mapping[str, Any]:
    found = world[reference["id"]] if reference.get("type") == "ref" else reference
    return found["bsdf"] if found.get("type") == "twosided" and "bsdf" in found else found


def _matt(world: dict[str, Any], colour: tuple[float, ...]) -> dict[str, str]:
    """Reference to the matt material of a colour, which is added to the world."""
    key = "mat_" + "_".join(f"{round(c * 1e6):07d}" for c in colour)
    world.setdefault(
        key, {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(colour)}}}
    )
    return {"type": "ref", "id": key}


def _mesh(points: Array, faces: npt.NDArray[np.int64], bsdf: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "type": "mesh",
        "positions": points.astype(np.float32),
        "faces": faces.astype(np.uint32),
        "face_normals": True,
        "bsdf": bsdf,
    }


def _triangles(key: str, part: Mapping[str, Any]) -> tuple[Array, npt.NDArray[np.int64]]:
    kind = part["type"]
    if kind == "mesh":
        return np.asarray(part["positions"], dtype=np.float64), np.asarray(part["faces"], dtype=np.int64)
    if kind == "sphere":
        ball = trimesh.creation.icosphere(subdivisions=BALL_SUBDIVISIONS)
        points, faces = np.asarray(ball.vertices) * part["radius"] + np.asarray(part["center"]), np.asarray(ball.faces)
    elif kind == "disk":
        angle = np.arange(DISK_SIDES) / DISK_SIDES * 2 * np.pi
        points = np.vstack([[0.0, 0.0, 0.0], np.c_[np.cos(angle), np.sin(angle), 0 * angle]])
        ring = 1 + np.arange(DISK_SIDES)
        faces = np.c_[np.zeros(DISK_SIDES, dtype=np.int64), ring, np.roll(ring, -1)]
    elif kind == "rectangle":
        points, faces = np.array([(-1.0, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]), np.array([(0, 1, 2), (0, 2, 3)])
    else:
        raise ValueError(f"{key}: a shape of type {kind} is not exported")
    if "to_world" in part:
        matrix = np.asarray(part["to_world"], dtype=np.float64)
        points = points @ matrix[:3, :3].T + matrix[:3, 3]
        if np.linalg.det(matrix[:3, :3]) < 0.0:
            faces = faces[:, ::-1]
    return points, faces


def _lamp(part: Mapping[str, Any]) -> dict[str, Any]:
    """Candela, position; for a spot its axis and the angles [deg] between which it fades linearly, as Mitsuba's
    does.
    """
    intensity = [float(c) for c in part["intensity"]["value"]]
    if part["type"] == "point":
        return {"type": "point", "intensity": intensity, "position": [float(x) for x in part["position"]]}
    place = np.asarray(part["to_world"], dtype=np.float64)
    axis = place[:3, 2] / np.linalg.norm(place[:3, 2])
    cutoff = float(part["cutoff_angle"])
    angles = {"cutoff_deg": cutoff, "beam_deg": float(part.get("beam_width", 0.75 * cutoff))}
    return {"type": "spot", "intensity": intensity, "position": place[:3, 3].tolist(), "axis": axis.tolist(), **angles}


def _cycles_sky(part: Mapping[str, Any]) -> npt.NDArray[np.float32]:
    """The map that Mitsuba sees, at the directions of Cycles' latitude-longitude pixels; row 0 is the zenith.

    Mitsuba's first and last row lie on the poles, and its columns begin on the left edge.
    """
    pixels = np.asarray(part["bitmap"], dtype=np.float64)
    rows, columns = pixels.shape[:2]
    height, width = rows, max(columns, 2 * 16)
    theta = (np.arange(height) + 0.5) / height * np.pi
    phi = np.pi - (np.arange(width) + 0.5) / width * 2 * np.pi  # Cycles: u = 1/2 - atan2(y, x) / (2 pi)
    t, p = np.meshgrid(theta, phi, indexing="ij")
    direction = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=-1)
    local = direction @ np.asarray(part["to_world"], dtype=np.float64)[:3, :3]
    u = np.arctan2(local[..., 0], -local[..., 2]) / (2 * np.pi) % 1.0 * columns
    v = np.arccos(np.clip(local[..., 1], -1, 1)) / np.pi * (rows - 1)
    j, i = np.floor(u).astype(int), np.minimum(np.floor(v).astype(int), rows - 2)
    a, b = (u - j)[..., None], (v - i)[..., None]
    left, right = j % columns, (j + 1) % columns
    return (
        (1 - b) * ((1 - a) * pixels[i, left] + a * pixels[i, right])
        + b * ((1 - a) * pixels[i + 1, left] + a * pixels[i + 1, right])
    ).astype(np.float32)


def from_stage(path: Path, *, fog: str | None, size: tuple[int, int]) -> SceneDict:
    """The simplified scene of one of our stages."""
    from synfog_usd.stage import open_stage, select
    from synfog_usd.translate import translate

    stage = open_stage(path)
    select(stage, fog=fog)
    return simplified(translate(stage, resolution=size))
