"""A set of one scene as a bake leaves it: 300 cars and some people, traced but not lit, with every number known."""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image as Picture

from synfog_usd.base import files
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import writers
from synfog_usd.dataset import labels, objects, visibility
from synfog_usd.fog import FogMedium, FogVolume
from synfog_usd.render.film import aovs
from synfog_usd.render.load import in_fog, to_mitsuba
from synfog_usd.scene import Instance
from synfog_usd.scene.testing import black, box, scene
from synfog_usd.scene.transmittance import of_instances

PAINT = {"type": "ref", "id": "mat_black"}
FOGS = {"clear": None, "mor150": 150.0, "mor50": 50.0}


@dataclass(frozen=True)
class Baked:
    folder: Path
    seen: aovs.Aovs
    listed: dict
    left: dict


def car(place, size=(1.8, 4.4, 1.5)):
    made = trimesh.creation.box(size)
    made.apply_translation(place)
    return {"type": "mesh", "positions": np.array(made.vertices), "faces": np.array(made.faces), "bsdf": PAINT}


def street():
    """300 cars in rows, three people before them, a bus, ground and a wall."""
    world = {
        "mat_black": black()["bsdf"],
        "shape_ground": car((0.0, 100.0, -6.1), (400.0, 260.0, 0.2)),
        "shape_wall": car((0.0, 220.0, 10.0), (60.0, 1.0, 20.0)),
    }
    kinds = ["road", "building"]
    for number in range(300):
        world[f"shape_car_{number}"] = car((4.0 * (number % 20) - 38.0, 24.0 + 10.0 * (number // 20), -5.25))
        kinds.append("car")
    for number in range(3):
        world[f"shape_person_{number}"] = car((3.0 * number - 3.0, 18.0, -5.15), (0.5, 0.4, 1.7))
        kinds.append("person")
    world["shape_bus"] = car((44.0, 60.0, -4.5), (2.5, 11.0, 3.0))
    kinds.append("bus")
    made = scene(world, width_px=192, height_px=108, fov_x_deg=70.0)
    instances = []
    for one, kind in zip(made.instances, kinds, strict=True):
        frame = np.eye(4)
        frame[:3, 3] = made.world[one.path[1:]]["positions"].mean(axis=0)
        instances.append(Instance(one.id, one.path, kind, frame))
    return replace(made, instances=tuple(instances))


LANE = {"id": 1, "type": "driving", "drivable": True, "pixels": 0, "left_px": [[[1.0, 2.0], [3.0, 4.0]]]}
LANE |= {"left_world_m": [[0.0, 0.0, 0.0]]}


def bake(folder: Path, source=None) -> Baked:
    source = source or street()
    loaded = to_mitsuba(source, boundaries=False)
    seen = aovs.measure(loaded)
    projection = objects.Projection.of(source.camera)
    listed = labels.label_list(seen, source.instances, objects.rows(source, aovs.pierced(loaded), projection))
    listed |= {"camera": projection.metadata(source.origin_m), "lanes": [LANE]}
    writers.write_exr(folder / "labels.exr", labels.label_image(seen, source.instances))
    files.write_json(folder / "labels.json", listed)
    rng = np.random.default_rng(3)
    shots, left = [], {}
    for fog, mor in FOGS.items():
        volume = () if mor is None else (FogVolume("/Fog", box(1000.0), FogMedium.from_visibility(mor)),)
        foggy = replace(source, fog=volume)
        here = aovs.measure(in_fog(loaded, volume))
        shade = 20.0 + 100.0 * rng.random(max(len(source.instances), 1) + 1)[seen.instance_id]
        light = here.transmittance * shade + (1.0 - here.transmittance) * 300.0
        rows = visibility.rows(
            seen.instance_id, here.transmittance, light, here.transmittance * shade, lambda L: 0.02 * L
        )
        place = folder / "sky" / fog
        files.write_json(place / "instances.json", labels.instance_list(of_instances(foggy), foggy, rows))
        left[fog] = json.loads((place / "instances.json").read_text())
        pixels = np.repeat(light[:, :, None], 3, axis=2).astype(np.float32)
        radiance = Image(pixels, ("R", "G", "B"), Quantity.RADIANCE, provenance={"fov_x_deg": 70.0})
        writers.write_exr(place / "radiance.exr", radiance)
        writers.write_exr(place / "layers.exr", [here.transmittance_image()])
        Picture.fromarray(np.clip(pixels * 0.7, 0, 255).astype(np.uint8)).save(place / "srgb.png")
        names = ("radiance.exr", "layers.exr", "instances.json", "srgb.png")
        shots.append(
            {
                "lighting": "sky",
                "fog": fog,
                "folder": f"sky/{fog}",
                "mor_m": mor,
                "size_px": [source.camera.width_px, source.camera.height_px],
                "files": {name: files.sha256_of(place / name) for name in names},
            }
        )
    manifest = {
        "schema": "synfog-usd/bake",
        "stage": {"name": "three_hundred.usda"},
        "pipeline": {"name": "phone.yaml"},
        "plan": {"seed": 5},
        "shots": shots,
    }
    files.write_json(folder / "bake.json", manifest)
    return Baked(folder, seen, listed, left)


@pytest.fixture(scope="session")
def trace():
    """`bake` itself: trace(folder, scene) leaves the files of a bake."""
    return bake


@pytest.fixture(scope="session")
def baked(tmp_path_factory):
    return bake(tmp_path_factory.mktemp("set") / "street")


@pytest.fixture(scope="session")
def exported(baked, tmp_path_factory):
    """Export once and give the folder: `exported("coco")`."""
    from synfog_usd.dataset.exports.record import exporter
    from synfog_usd.dataset.exports.run import export

    made = {}

    def get(name, **more):
        key = name, *sorted(more.items())
        if key not in made:
            target = tmp_path_factory.mktemp("exports") / name
            export(baked.folder, exporter(name), target, **more)
            made[key] = target
        return made[key]

    return get
