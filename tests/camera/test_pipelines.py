"""The graphs that ship: each loads, runs, repeats itself byte for byte, and its files can be read."""

from __future__ import annotations

import numpy as np
import pytest

from synfog_usd import camera
from synfog_usd.base import resources, seeds
from synfog_usd.base.errors import GraphError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.graph import make_graph
from synfog_usd.camera.writers import write_output

GRAPHS = [path for path in sorted(resources.folder("pipeline").glob("*.yaml")) if path.stem != "raw"]
"""Whole cameras; raw.yaml is half of one, see tests/writers/test_raw.py."""


def scene(channels=("R", "G", "B"), scale=500.0, graph=None) -> Image:
    """Noise; where a graph's lens is a fisheye, of no angle of view, since that tells its own."""
    pixels = seeds.stream(0, "scene").random((48, 64, len(channels)), dtype=np.float32) * np.float32(scale)
    provenance = {} if graph and graph.nodes_with("optics.fisheye") else {"fov_x_deg": 60.0}
    return Image(pixels, channels, Quantity.RADIANCE, provenance=provenance)


@pytest.mark.parametrize("path", GRAPHS, ids=lambda path: path.stem)
def test_a_shipped_graph_runs_and_repeats_itself(path, tmp_path):
    graph = camera.load_graph(path)
    radiance = scene(graph=graph)
    exposure = camera.meter(radiance, graph)
    files = {}
    for folder in ("one", "two"):
        run = graph.run(dict.fromkeys(graph.inputs, radiance), seed=7, settings=exposure.settings)
        for name, node in graph.outputs.items():
            files.setdefault(name, []).append(write_output(name, run[node], tmp_path / folder).read_bytes())
        for node in graph.nodes_with("sensor.adc"):
            mosaic = run[node.name].pixels
            assert (
                mosaic.min() >= 0
                and mosaic.max() <= graph.profiles["sensor"].white_level_dn
                and (mosaic == np.rint(mosaic)).all()
            )
    assert files and all(one == two for one, two in files.values())


@pytest.mark.parametrize("shape", [(2, 2), (2, 301)])
def test_small_pictures_with_a_lamp_go_through_the_phone(shape):
    graph = camera.load_graph(resources.folder("pipeline") / "phone.yaml")
    pixels = np.full((*shape, 3), 0.3, np.float32)
    pixels[1, 1] = 1e6
    out = camera.develop(graph, {"radiance": scene().with_pixels(pixels)}, seed=0)["srgb"].pixels
    assert out.shape == (*shape, 3) and np.isfinite(out).all() and out.min() >= 0 and out[1, 1].max() > 0.99


@pytest.mark.parametrize("path", GRAPHS, ids=lambda path: path.stem)
def test_an_unlit_picture_is_black(path):
    """At the exposure that is metered on it, which is the longest at the highest ISO: mean within 1 of 255 of 0 in
    every channel.
    """
    graph = camera.load_graph(path)
    black = scene(graph=graph).with_pixels(np.zeros((96, 128, 3), np.float32))
    exposure = camera.meter(black, graph)
    assert exposure.iso == graph.profiles["sensor"].iso_max
    run = graph.run(dict.fromkeys(graph.inputs, black), seed=3, settings=exposure.settings)
    for name, node in graph.outputs.items():
        if name.endswith(".png"):
            assert run[node].pixels.mean(axis=(0, 1)).max() < 1 / 255
    for node in graph.nodes_with("sensor.adc"):
        metadata, numbers = run[node.name].provenance, run[node.name].pixels
        limit = (
            5 * metadata["total_dark_noise_dn"] * np.sqrt(1 / (16 * 128) + 1 / numbers.size) + 0.15
        )  # of rows and columns, where they are
        assert abs(float(numbers.mean(dtype=np.float64)) - metadata["black_level_dn"]) < limit
        assert numbers.min() > 0


def papers_cameras():
    return (camera.load_graph(resources.folder("pipeline") / f"{name}.yaml") for name in ("synfog", "noise_free"))


def test_the_papers_camera_averages_to_the_noise_free_one():
    """Any seed gives the same bytes without noise, and 64 frames of the paper's camera average to its numbers.

    RAW, even grey: temporal noise is 5 DN a pixel, and 0.7 % of the signal differs from pixel to pixel, at most 6 DN
    in 768 pixels of a colour, so the mean is known to 0.25 DN; rounding whole numbers of one level may put the
    noise-free one 0.5 DN off.
    """
    noisy, free = papers_cameras()
    even = scene().with_pixels(np.full((48, 64, 3), 300.0, np.float32))
    settings = camera.meter(even, noisy).settings
    one, two = (free.run({"radiance": even}, seed=seed, settings=settings) for seed in (0, 1))
    assert one["srgb"].pixels.tobytes() == two["srgb"].pixels.tobytes()
    frames = [
        noisy.run({"radiance": even}, seed=seed, settings=settings, until="adc")["adc"].pixels for seed in range(64)
    ]
    for where in (
        (slice(0, None, 2), slice(0, None, 2)),
        (slice(0, None, 2), slice(1, None, 2)),
        (slice(1, None, 2), slice(1, None, 2)),
    ):
        mean = np.mean([frame[where].mean(dtype=np.float64) for frame in frames])
        assert 100 < mean < 900
        assert abs(mean - one["adc"].pixels[where].mean()) < 0.5 + 4 * 0.25


@pytest.mark.parametrize(
    "nodes, said",
    [
        (
            [{"op": "sensor.shot_noise", "name": "again", "after": "shot_noise"}],
            "'shot_noise' gives electrons (mosaic, with shot noise)",
        ),
        (
            [{"op": "sensor.full_well", "name": "late", "after": "read_noise"}],
            "'read_noise' gives electrons (mosaic, with read noise)",
        ),
        (
            [{"op": "isp.denoise", "name": "late", "after": "white_balance"}],
            "'white_balance' gives linear_rgb (mosaic, white-balanced)",
        ),
        ([{"name": "adc", "bits": 8}], "white_level_dn 1023 <= 255, the most of 8 bits, does not hold"),
    ],
)
def test_a_wrong_order_is_refused_when_the_graph_is_loaded(nodes, said):
    """Noise of counting before noise of reading, each once; what needs the noise profile before what changes it."""
    with pytest.raises(GraphError) as caught:
        make_graph(camera.OPS, extends="phone", nodes=nodes, outputs={})
    assert said in str(caught.value)
