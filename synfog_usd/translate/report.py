"""A scene in a few numbers, for the terminal."""

from __future__ import annotations

from collections import Counter
from typing import Any

from synfog_usd.scene import SceneDict


def summary(scene: SceneDict) -> dict[str, Any]:
    """Counts of what a scene holds; plain values that JSON takes.

    Returns:
        'shapes', 'triangles' (stored), 'triangles_drawn' (instances counted),
        'materials', 'textures', 'groups', 'instances', 'lights' {type: count},
        'fog' [{path, kind, visibility_m, parent}], 'labels' {name: instances},
        'camera', 'size_px', 'origin_m', 'notes' {severity: count}.
    """
    shapes = {key: part for key, part in scene.world.items() if key.startswith("shape_")}
    groups = {key: part for key, part in scene.world.items() if key.startswith("group_")}
    instances = [part for key, part in scene.world.items() if key.startswith("instance_")]
    inside = {
        key: sum(_triangles(shape) for name, shape in group.items() if name != "type") for key, group in groups.items()
    }
    own = sum(_triangles(shape) for shape in shapes.values())
    lights = Counter(part["type"] for key, part in scene.world.items() if key.startswith("light_"))
    lights.update("area" for shape in shapes.values() if "emitter" in shape)
    materials = [part for key, part in scene.world.items() if key.startswith("mat_")]
    return {
        "shapes": len(shapes) + sum(len(group) - 1 for group in groups.values()),
        "triangles": own + sum(inside.values()),
        "triangles_drawn": own + sum(inside[part["shapegroup"]["id"]] for part in instances),
        "materials": len(materials),
        "textures": len({id(bitmap) for material in materials for bitmap in _bitmaps(material)}),
        "groups": len(groups),
        "instances": len(instances),
        "lights": dict(lights),
        "fog": [
            {
                "path": volume.path,
                "kind": volume.boundary.kind,
                "visibility_m": volume.medium.visibility_m,
                "profile": volume.medium.profile,
                "parent": None if volume.parent is None else scene.fog[volume.parent].path,
            }
            for volume in scene.fog
        ],
        "labels": dict(Counter(instance.label for instance in scene.instances)),
        "camera": scene.camera.path,
        "size_px": [scene.camera.width_px, scene.camera.height_px],
        "origin_m": list(scene.origin_m),
        "notes": dict(Counter(note.severity for note in scene.notes)),
    }


def _triangles(shape: Any) -> int:
    return len(shape["faces"]) if shape["type"] == "mesh" else 0


def _bitmaps(part: Any) -> list[Any]:
    """Pixel arrays anywhere within a BSDF."""
    found = []
    for name, value in part.items():
        if name == "bitmap":
            found.append(value)
        elif isinstance(value, dict):
            found += _bitmaps(value)
    return found
