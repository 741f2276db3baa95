"""The graphs that ship: each loads, runs, repeats itself byte for byte, and its files can be read."""

from __future__ import annotations

import inspect
import math
import re

import numpy as np
import pytest

from synfog_usd import camera
from synfog_usd.base import photometry, resources, seeds
from synfog_usd.base.errors import GraphError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import cfa
from synfog_usd.camera.graph import Cache, make_graph, outputs
from synfog_usd.camera.writers import WRITERS, write_output

GRAPHS = [path for path in sorted(resources.folder("pipeline").glob("*.yaml")) if path.stem != "raw"]
"""Whole cameras; raw.yaml is half of one, see tests/writers/test_raw.py."""


def scene(channels=("R", "G", "B"), scale=500.0, graph=None) -> Image:
    """Noise; where a graph's lens is a fisheye, of no angle of view, since that tells its own."""
    pixels = seeds.stream(0, "scene").random((48, 64, len(channels)), dtype=np.float32) * np.float32(scale)
    provenance = {} if graph and graph.nodes_with("optics.fisheye") else {"fov_x_deg": 60.0}
    return Image(pixels, channels, Quantity.RADIANCE, provenance=provenance)


def test_these_graphs_ship():
    assert {path.stem for path in GRAPHS} >= {"phone", "synfog", "linear_exr", "dashcam", "noise_free"}


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


@pytest.mark.parametrize(
    "channels", [("R", "G", "B"), tuple(map(photometry.band_name, (430.0, 500.0, 570.0, 640.0)))], ids=["RGB", "bands"]
)
def test_the_order_in_memory_changes_no_number(channels, tmp_path):
    """Ops keep channels one behind the other, and a kept result has them side by side: each node of the phone gives
    the same bytes for both.
    """
    graph = camera.load_graph(resources.folder("pipeline") / "phone.yaml")
    radiance = scene(channels)
    settings = camera.meter(radiance, graph).settings
    whole = graph.run({"radiance": radiance}, seed=3, settings=settings)
    store = Cache(tmp_path / "cache")
    for number, name in enumerate(graph.nodes):
        run = graph.run({"radiance": radiance}, seed=3, settings=settings, until=name, keep=[name], cache=store)
        assert len(run.cached) == number  # the node before it was read
        np.testing.assert_array_equal(run[name].pixels, whole[name].pixels, err_msg=name)


@pytest.mark.parametrize("shape", [(2, 2), (3, 5), (2, 301)])
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


def test_light_in_bands_goes_through_the_phone_too():
    """D65 as 16 bands and as RGB look alike: the same mean picture within a few 255ths (25 nm bands)."""
    graph = camera.load_graph(resources.folder("pipeline") / "phone.yaml")
    centres = np.arange(392.5, 780.0, 25.0)
    spectrum = 1000 * np.interp(
        centres, photometry.WAVELENGTHS_NM, photometry.channel_spectra(("R", "G", "B")).sum(axis=0)
    )
    bands = Image(
        np.broadcast_to(spectrum.astype(np.float32), (32, 32, 16)).copy(),
        tuple(map(photometry.band_name, centres)),
        Quantity.RADIANCE,
        provenance={"fov_x_deg": 60.0},
    )
    rgb = Image(
        np.full((32, 32, 3), 1000.0, np.float32), ("R", "G", "B"), Quantity.RADIANCE, provenance={"fov_x_deg": 60.0}
    )
    exposure = camera.meter(rgb, graph)
    one, two = (
        graph.run({"radiance": image}, seed=0, settings=exposure.settings)["srgb"].pixels.mean(axis=(0, 1))
        for image in (bands, rgb)
    )
    np.testing.assert_allclose(one, two, atol=4 / 255)


def test_the_fixed_pattern_is_in_every_frame_and_the_rest_is_not():
    """Mean of 40 dark frames at two sets of seeds: the averages correlate by their DSNU.

    Per pixel, DSNU has 5 e- and the average of 40 frames has 2.5 / sqrt(40) = 0.4 e- of noise: correlation 0.99.
    """
    graph = camera.load_graph(resources.folder("pipeline") / "phone.yaml")
    black = scene(scale=0.0)
    averages = []
    for first in (0, 100):
        frames = [
            graph.run(
                {"radiance": black},
                seed=seed,
                settings={"exposure_s": 0.001, "iso": 55},
                until="read_noise",
                keep=["read_noise"],
                overrides={"dsnu.dsnu_e": 5},
            )
            for seed in range(first, first + 40)
        ]
        stack = np.stack([frame["read_noise"].pixels for frame in frames])
        averages.append(stack.mean(axis=0).ravel())
        assert np.corrcoef((stack[0] - stack.mean(axis=0)).ravel(), (stack[1] - stack.mean(axis=0)).ravel())[0, 1] < 0.1
    assert np.corrcoef(*averages)[0, 1] > 0.97


NOISES = ("prnu", "dark_current", "shot_noise", "dsnu", "read_noise", "adc_noise", "black_clamp")


def papers_cameras():
    return (camera.load_graph(resources.folder("pipeline") / f"{name}.yaml") for name in ("synfog", "noise_free"))


def test_the_noise_free_camera_differs_from_the_papers_in_noise_alone():
    """Node by node: what is left has the same op and parameters and reads the nearest node that is left; profiles and
    outputs are the same.
    """
    noisy, free = papers_cameras()
    assert [name for name in noisy.nodes if name not in free.nodes] == list(NOISES)
    assert [noisy.nodes[name].op.name for name in NOISES] == [f"sensor.{name}" for name in NOISES]
    kept = [name for name in noisy.nodes if name not in NOISES]
    assert list(free.nodes) == kept and free.profiles == noisy.profiles and free.outputs == noisy.outputs
    before = "radiance"
    for name in kept:
        mine, theirs = free.nodes[name], noisy.nodes[name]
        assert (mine.op, mine.params, mine.inputs) == (theirs.op, theirs.params, (before,)), name
        before = name


def test_the_papers_lens_follows_its_formula():
    """E = tau pi L / (1 + 4 (N (1 - m))^2) cos^4 behind the Mi 10 Pro's f/1.69, far away and at m = -0.1; the angle is
    that of each pixel's centre under 60 degrees.
    """
    graph, _ = papers_cameras()
    even = scene().with_pixels(np.full((48, 64, 3), 300.0, np.float32)).with_metadata(fov_x_deg=60.0)
    x, y = (np.arange(64) - 31.5)[None, :], (np.arange(48) - 23.5)[:, None]
    cos = 1 / np.sqrt(1 + (x * x + y * y) * (math.tan(math.radians(30.0)) / 32) ** 2)
    for m in (0.0, -0.1):
        seen = graph.run(
            {"radiance": even},
            seed=0,
            until="irradiance",
            keep=["irradiance"],
            overrides={"irradiance.magnification": m},
        )["irradiance"]
        wanted = 0.9 * math.pi * 300.0 / (1 + 4 * (1.69 * (1 - m)) ** 2) * cos**4
        np.testing.assert_allclose(seen.pixels[..., 1], wanted, rtol=1e-5)  # float32


@pytest.mark.parametrize("width_px", [320, 1280])
def test_the_papers_pixels_reach_as_far_as_binned_ones(width_px):
    """Variance of where a binned pixel gathers light: N samples of its colour, two sensor pixels apart, each one wide.

    It is that of a square pixel and of the graph's spot, within a twentieth at 1280 pixels, where N is 4.7.
    """
    graph, _ = papers_cameras()
    sensor = graph.profiles["sensor"]
    n = round(sensor.width_px / width_px)
    places = (2 * np.arange(n) - (n - 1)) / n
    binned = places.var() + (1 / n) ** 2 / 12
    spot_px = graph.nodes["diffraction"].params["spot_um"].value / sensor.pixel_pitch_um
    assert 1 / 12 + spot_px**2 == pytest.approx(binned, rel=0.05)


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


def test_a_phone_with_everything_that_may_be_put_in():
    """Defects, denoising, Menon and sharpening by name into the shipped graph: a clean grey gets smoother, and stays
    the same grey.
    """
    graph = make_graph(
        camera.OPS,
        extends="phone",
        nodes=[
            {"name": "defects", "op": "isp.defects", "after": "black_level"},
            {"name": "denoise", "op": "isp.denoise", "after": "defects"},
            {"name": "demosaic", "algorithm": "menon"},
            {"name": "crisp", "op": "isp.sharpen", "after": "srgb"},
        ],
        outputs={"crisp.png": "crisp"},
    )
    even = scene().with_pixels(np.full((48, 64, 3), 300.0, np.float32))
    plain = camera.develop(camera.load_graph(resources.folder("pipeline") / "phone.yaml"), {"radiance": even}, seed=0)[
        "srgb"
    ].pixels
    out = camera.develop(graph, {"radiance": even}, seed=0)["crisp"].pixels
    assert out.std() < 0.5 * plain.std()
    np.testing.assert_allclose(out.mean(axis=(0, 1)), plain.mean(axis=(0, 1)), atol=2 / 255)


@pytest.mark.parametrize("pattern", cfa.BAYER)
def test_a_phone_of_each_phase_takes_the_same_picture(pattern, tmp_path):
    """The four Bayer phases of one sensor on a smooth scene: the pictures agree to a few 255ths (their noise is their
    own).
    """
    source = resources.folder("assets") / "sensors" / "mi10pro.yaml"
    (tmp_path / "mine.yaml").write_text(
        re.sub(r"^cfa:.*\n", "", source.read_text(), flags=re.M).replace("serial:", f"cfa: {pattern}\nserial:", 1)
    )
    graph = make_graph(camera.OPS, extends="noise_free", folder=tmp_path, sensor="./mine.yaml", nodes=[], outputs={})
    ramp = (
        np.linspace(50, 500, 64, dtype=np.float32)[None, :, None]
        * np.array([1.0, 0.7, 0.4], np.float32)
        * np.ones((48, 1, 1), np.float32)
    )
    run = graph.run({"radiance": scene().with_pixels(ramp)}, seed=0, settings={"exposure_s": 1 / 250, "iso": 50})
    assert run["adc"].provenance["cfa_pattern"] == pattern
    expected = make_graph(camera.OPS, extends="noise_free", nodes=[], outputs={}).run(
        {"radiance": scene().with_pixels(ramp)}, seed=0, settings={"exposure_s": 1 / 250, "iso": 50}
    )
    np.testing.assert_allclose(run["srgb"].pixels[2:-2, 2:-2], expected["srgb"].pixels[2:-2, 2:-2], atol=3 / 255)


def test_what_a_graph_may_write_and_what_writers_can_write_are_the_same():
    """Formats; and of each, the words that say how."""
    assert set(outputs.FORMATS) == set(outputs.OPTIONS) == set(WRITERS)
    for suffix, options in outputs.OPTIONS.items():
        words = inspect.signature(WRITERS[suffix]).parameters
        assert set(options) == {name for name, word in words.items() if word.kind is word.KEYWORD_ONLY} - {"attributes"}
        assert all(
            words[name].default in (option.choices[0], None)
            or (isinstance(option.choices, range) and f"if left out {words[name].default}" in option.help)
            for name, option in options.items()
        )


def test_wrong_order_in_the_phone_is_refused_when_it_is_loaded(tmp_path):
    """Read noise before exposure, colour correction before demosaicing, a DNG of the picture: none of them runs."""
    text = (resources.folder("pipeline") / "phone.yaml").read_text()
    changes = [
        ("    op: sensor.expose\n    exposure_s: auto", "    op: sensor.read_noise"),
        ("    op: isp.demosaic\n    algorithm: directional", "    op: isp.colour_correct"),
        ("raw.dng: adc", "raw.dng: srgb"),
        ("raw.dng: adc", "raw.dng: gain"),
    ]
    for old, new in changes:
        assert text.count(old) == 1
        (tmp_path / "g.yaml").write_text(text.replace(old, new))
        with pytest.raises(GraphError, match=r"g\.yaml:\d+:\d+: .* takes "):
            camera.load_graph(tmp_path / "g.yaml")


@pytest.mark.parametrize(
    "nodes, said",
    [
        (
            [{"op": "sensor.shot_noise", "name": "again", "after": "shot_noise"}],
            "'shot_noise' gives electrons (mosaic, with shot noise)",
        ),
        (
            [{"op": "sensor.shot_noise", "name": "late", "after": "read_noise"}],
            "'read_noise' gives electrons (mosaic, with read noise)",
        ),
        (
            [{"op": "sensor.dark_current", "name": "late", "after": "shot_noise"}],
            "'shot_noise' gives electrons (mosaic, with shot noise)",
        ),
        ([{"op": "sensor.prnu", "name": "late", "after": "dsnu"}], "'dsnu' gives electrons (mosaic, with read noise)"),
        (
            [{"op": "sensor.full_well", "name": "late", "after": "read_noise"}],
            "'read_noise' gives electrons (mosaic, with read noise)",
        ),
        (
            [{"op": "isp.denoise", "after": "white_balance"}],
            "'white_balance' gives linear_rgb (mosaic, white-balanced)",
        ),
        (
            [{"op": "isp.denoise", "after": "lens_shading"}],
            "'lens_shading' gives linear_rgb (mosaic, shading corrected)",
        ),
        (
            [{"op": "isp.white_balance", "name": "again", "after": "white_balance"}],
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


def test_a_value_that_does_not_fit_another_is_refused_before_the_run():
    with pytest.raises(GraphError, match=r"overrides adc.bits: node 'adc' .*white_level_dn 1023 <= 255"):
        camera.load_graph(resources.folder("pipeline") / "phone.yaml").with_overrides({"adc.bits": 8})


def test_taking_a_node_away_leaves_the_next_one_on_its_branch():
    """The node behind the first of a branch stood on that branch by its place alone; it goes on there, and a replaced
    one too.
    """
    graph = make_graph(
        camera.OPS, extends="automotive_hdr", nodes=[{"name": "read_noise_low", "remove": True}], outputs={}
    )
    assert graph.nodes["gain_low"].inputs == ("dsnu",)
    graph = make_graph(
        camera.OPS,
        extends="automotive_hdr",
        nodes=[{"name": "read_noise_low", "op": "sensor.read_noise", "sigma_e": 3}],
        outputs={},
    )
    assert graph.nodes["read_noise_low"].inputs == ("dsnu",)
