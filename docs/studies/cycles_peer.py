"""Blender Cycles as a peer: draws what `cycles_scene.py` exported, and says how long it took.

Runs in Blender's Python (bpy 5.0.1, which wants Python 3.11) and imports nothing of
ours.  Takes `<stem>.npz` and `<stem>.json`; leaves an .npz with the radiance of every
render, its samples, its seed, wall and processor seconds, and Cycles' settings.

    BLENDER_ENV/bin/python docs/studies/cycles_peer.py out/canyon out/canyon_cycles.npz --samples 64,256 --seeds 4
    --threads 2

Everything that trades bias for noise is off, unless `--denoise` asks for its denoiser: clamping, adaptive sampling,
light threshold, caustic filter, path guiding.  `BOUNCES` is far beyond what matters:
with albedo 1 a path scatters until it leaves, some tens of times in MOR 50.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import tempfile
import time
from pathlib import Path

import numpy as np

try:
    import bpy
    from mathutils import Matrix, Vector
except ImportError:  # pytest looks for doctests in every module, in a Python without Blender
    bpy = None

BOUNCES = 1024
"""Cycles' largest number.  A path in 60 m of MOR 50 fog (3.6 mean free paths, g 0.87) scatters some tens of times."""

WATTS_PER_CANDELA = 4.0 * math.pi
"""Cycles' watts of a point for each unit of radiant intensity, I = P / (4 pi); of a spot too, whose cone cuts off and
does not gather.  Measured: 1.000.
"""


def build(stem: Path) -> None:
    """The exported scene as the one scene of an empty Blender file."""
    arrays, plain = np.load(stem.with_suffix(".npz")), json.loads(stem.with_suffix(".json").read_text())
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    _meshes(arrays, plain["materials"])
    for index, lamp in enumerate(plain["lamps"]):
        _lamp(f"lamp_{index}", lamp)
    _sky(plain["sky"], arrays)
    if plain["fog"]:
        _fog(plain["fog"])
    _camera(plain["camera"])
    scene.render.engine = "CYCLES"
    settings = {
        "device": "CPU",
        "use_denoising": False,
        "use_adaptive_sampling": False,
        "use_guiding": False,
        "use_light_tree": True,
        "sample_clamp_direct": 0.0,
        "sample_clamp_indirect": 0.0,
        "light_sampling_threshold": 0.0,
        "blur_glossy": 0.0,
        "max_bounces": BOUNCES,
        "diffuse_bounces": BOUNCES,
        "glossy_bounces": BOUNCES,
        "transmission_bounces": BOUNCES,
        "volume_bounces": BOUNCES,
        "transparent_max_bounces": BOUNCES,
        "pixel_filter_type": "BOX",
        "filter_width": 1.0,
        "film_transparent_glass": False,
        "use_auto_tile": False,
    }
    for name, value in settings.items():
        setattr(scene.cycles, name, value)
    scene.render.use_persistent_data = True  # the search tree is built once, not for every render
    scene.render.film_transparent = False
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.render.image_settings.color_mode = "RGB"
    scene.render.image_settings.exr_codec = "ZIP"
    scene.render.use_compositing = scene.render.use_sequencer = False


def draw(*, samples: int, seed: int) -> tuple[np.ndarray, float, float]:
    """Radiance (H, W, 3), row 0 at the top, and the wall and processor seconds of the whole render call."""
    scene = bpy.context.scene
    scene.cycles.samples, scene.cycles.seed = samples, seed
    with tempfile.TemporaryDirectory() as folder:
        scene.render.filepath = f"{folder}/picture.exr"
        begin, work = time.perf_counter(), _processor_s()
        bpy.ops.render.render(write_still=True)
        wall, processor = time.perf_counter() - begin, _processor_s() - work
        image = bpy.data.images.load(scene.render.filepath)
        image.colorspace_settings.name = "Non-Color"
        width, height = image.size
        pixels = np.empty(width * height * 4, dtype=np.float32)
        image.pixels.foreach_get(pixels)
        bpy.data.images.remove(image)
    return pixels.reshape(height, width, 4)[::-1, :, :3].copy(), wall, processor


def _processor_s() -> float:
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def _meshes(arrays: np.lib.npyio.NpzFile, materials: list[dict]) -> None:
    points, faces, which = arrays["positions"], arrays["faces"], arrays["material"]
    mesh = bpy.data.meshes.new("world")
    mesh.vertices.add(len(points))
    mesh.vertices.foreach_set("co", points.astype(np.float32).ravel())
    mesh.loops.add(faces.size)
    mesh.loops.foreach_set("vertex_index", faces.astype(np.int32).ravel())
    mesh.polygons.add(len(faces))
    mesh.polygons.foreach_set("loop_start", np.arange(0, faces.size, 3, dtype=np.int32))
    mesh.polygons.foreach_set("material_index", which.astype(np.int32))
    mesh.polygons.foreach_set("use_smooth", np.zeros(len(faces), dtype=bool))
    for index, material in enumerate(materials):
        mesh.materials.append(_material(f"matt_{index}", material))
    mesh.update(calc_edges=True)
    bpy.context.collection.objects.link(bpy.data.objects.new("world", mesh))


def _material(name: str, material: dict) -> bpy.types.Material:
    """Lambert's law, and emission from the front where it shines."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    nodes, links = made.node_tree.nodes, made.node_tree.links
    nodes.clear()
    out, matt = nodes.new("ShaderNodeOutputMaterial"), nodes.new("ShaderNodeBsdfDiffuse")
    matt.inputs["Color"].default_value = (*material["colour"], 1.0)
    matt.inputs["Roughness"].default_value = 0.0
    if material["emission"] is None:
        links.new(matt.outputs[0], out.inputs["Surface"])
        return made
    shine, both = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeAddShader")
    geometry, front = nodes.new("ShaderNodeNewGeometry"), nodes.new("ShaderNodeMath")
    strength = max(material["emission"])
    shine.inputs["Color"].default_value = (*(c / strength for c in material["emission"]), 1.0)
    front.operation = "MULTIPLY_ADD"  # strength where the front is seen, 0 from behind
    front.inputs[1].default_value, front.inputs[2].default_value = -strength, strength
    links.new(geometry.outputs["Backfacing"], front.inputs[0])
    links.new(front.outputs[0], shine.inputs["Strength"])
    links.new(matt.outputs[0], both.inputs[0])
    links.new(shine.outputs[0], both.inputs[1])
    links.new(both.outputs[0], out.inputs["Surface"])
    made.cycles.emission_sampling = "FRONT"
    return made


def _lamp(name: str, lamp: dict) -> None:
    """A point without size; a spot whose light fades linearly with the angle, by nodes, since Blender's own fades
    otherwise.
    """
    spot = lamp["type"] == "spot"
    data = bpy.data.lights.new(name, "SPOT" if spot else "POINT")
    peak = max(lamp["intensity"])
    data.energy = peak * WATTS_PER_CANDELA
    data.color = [c / peak for c in lamp["intensity"]]
    data.shadow_soft_size = 0.0
    made = bpy.data.objects.new(name, data)
    made.location = lamp["position"]
    if spot:
        data.spot_size, data.spot_blend = 2.0 * math.radians(lamp["cutoff_deg"]), 0.0
        made.rotation_mode = "QUATERNION"
        made.rotation_quaternion = Vector(lamp["axis"]).to_track_quat("-Z", "Y")
        data.use_nodes = True
        nodes, links = data.node_tree.nodes, data.node_tree.links
        nodes.clear()
        out, shine, geometry = (
            nodes.new("ShaderNodeOutputLight"),
            nodes.new("ShaderNodeEmission"),
            nodes.new("ShaderNodeNewGeometry"),
        )
        along, angle, fade = (
            nodes.new("ShaderNodeVectorMath"),
            nodes.new("ShaderNodeMath"),
            nodes.new("ShaderNodeMapRange"),
        )
        along.operation, angle.operation = "DOT_PRODUCT", "ARCCOSINE"
        along.inputs[1].default_value = lamp["axis"]
        fade.clamp = True
        fade.inputs["From Min"].default_value, fade.inputs["From Max"].default_value = (
            math.radians(lamp["beam_deg"]),
            math.radians(lamp["cutoff_deg"]),
        )
        fade.inputs["To Min"].default_value, fade.inputs["To Max"].default_value = 1.0, 0.0
        links.new(geometry.outputs["Incoming"], along.inputs[0])  # from the lamp to what it lights
        links.new(along.outputs["Value"], angle.inputs[0])
        links.new(angle.outputs[0], fade.inputs["Value"])
        links.new(fade.outputs[0], shine.inputs["Strength"])
        links.new(shine.outputs[0], out.inputs["Surface"])
    bpy.context.collection.objects.link(made)


def _sky(sky: object, arrays: np.lib.npyio.NpzFile) -> None:
    world = bpy.data.worlds.new("sky")
    bpy.context.scene.world = world
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    nodes.clear()
    out, back = nodes.new("ShaderNodeOutputWorld"), nodes.new("ShaderNodeBackground")
    links.new(back.outputs[0], out.inputs["Surface"])
    if sky is None:
        back.inputs["Strength"].default_value = 0.0
    elif sky == "sky":
        pixels = arrays["sky"]
        height, width = pixels.shape[:2]
        image = bpy.data.images.new("sky", width, height, float_buffer=True, is_data=True)
        image.pixels.foreach_set(
            np.concatenate([pixels[::-1], np.ones((height, width, 1), np.float32)], axis=2).astype(np.float32).ravel()
        )
        image.update()
        image.pack()
        texture = nodes.new("ShaderNodeTexEnvironment")
        texture.image = image
        links.new(texture.outputs[0], back.inputs["Color"])
    else:
        back.inputs["Color"].default_value = (*sky, 1.0)  # type: ignore[misc]


def _fog(fog: dict) -> None:
    """A cube of homogeneous scattering, without a surface."""
    if fog["albedo"] != 1.0:
        raise SystemExit(
            "only fog that absorbs nothing is drawn: the colour of Cycles' scatter node does not mean the same"
        )
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    matrix = np.array(fog["to_world"])
    points = corners @ matrix[:3, :3].T + matrix[:3, 3]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    mesh = bpy.data.meshes.new("fog")
    mesh.from_pydata(points.tolist(), [], faces)
    material = bpy.data.materials.new("fog")
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    out, scatter = nodes.new("ShaderNodeOutputMaterial"), nodes.new("ShaderNodeVolumeScatter")
    scatter.phase = "HENYEY_GREENSTEIN"
    scatter.inputs["Color"].default_value = (fog["albedo"],) * 3 + (1.0,)
    scatter.inputs["Density"].default_value, scatter.inputs["Anisotropy"].default_value = fog["sigma_t"], fog["g"]
    links.new(scatter.outputs[0], out.inputs["Volume"])
    mesh.materials.append(material)
    bpy.context.collection.objects.link(bpy.data.objects.new("fog", mesh))


def _camera(camera: dict) -> None:
    data = bpy.data.cameras.new("ego")
    data.sensor_fit = "HORIZONTAL"
    data.angle_x = math.radians(camera["fov_x_deg"])
    data.clip_start, data.clip_end = 1e-3, 1e5
    made = bpy.data.objects.new("ego", data)
    made.matrix_world = Matrix(camera["to_world"])
    bpy.context.collection.objects.link(made)
    scene = bpy.context.scene
    scene.camera = made
    scene.render.resolution_x, scene.render.resolution_y = camera["width"], camera["height"]
    scene.render.resolution_percentage = 100


def main() -> None:
    """Measure what the command line asks for."""
    parser = argparse.ArgumentParser()
    parser.add_argument("stem", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--samples", default="16,64", help="comma-separated; seconds a sample come from the slope")
    parser.add_argument("--seeds", type=int, default=4, help="renders of each, with seeds 1, 2, …")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--denoise", action="store_true", help="Cycles' own OpenImageDenoise, with albedo and normal")
    arguments = parser.parse_args()
    build(arguments.stem)
    scene = bpy.context.scene
    if arguments.denoise:
        scene.cycles.use_denoising = True
        scene.cycles.denoiser = "OPENIMAGEDENOISE"
        scene.cycles.denoising_input_passes = "RGB_ALBEDO_NORMAL"
        scene.cycles.denoising_prefilter = "ACCURATE"
    scene.render.threads_mode, scene.render.threads = "FIXED", arguments.threads
    counts = [int(n) for n in arguments.samples.split(",")]
    draw(samples=1, seed=999)  # builds the search tree
    rows = []
    for count in counts:
        for seed in range(1, arguments.seeds + 1):
            pixels, wall, processor = draw(samples=count, seed=seed)
            rows.append((pixels, count, seed, wall, processor))
            print(
                f"{count} samples, seed {seed}: {wall:.2f} s wall, {processor:.2f} s processor, mean "
                f"{pixels.mean(dtype=np.float64):.6g}",
                flush=True,
            )
    images, samples, seeds, walls, processors = (np.array(column) for column in zip(*rows, strict=True))
    np.savez_compressed(
        arguments.out,
        images=images,
        samples=samples,
        seed=seeds,
        wall_s=walls,
        processor_s=processors,
        threads=arguments.threads,
    )


if __name__ == "__main__":
    main()
