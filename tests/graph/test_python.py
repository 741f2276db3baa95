"""A graph written in Python, and one called function by function, give the bytes of the YAML."""

from __future__ import annotations

import numpy as np
import pytest

from synfog_usd import camera
from synfog_usd.base import resources, seeds
from synfog_usd.base.errors import GraphError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import blur, cleanup, demosaic, isp, optics, sensor, writers
from synfog_usd.camera.graph import make_graph

NODES = [
    {"name": "irradiance", "op": "optics.irradiance", "falloff": "cos4"},
    {"name": "diffraction", "op": "optics.diffraction", "spot_um": 0.8},
    {"name": "expose", "op": "sensor.expose", "exposure_s": "auto"},
    {"name": "prnu", "op": "sensor.prnu"},
    {"name": "dark_current", "op": "sensor.dark_current"},
    {"name": "shot_noise", "op": "sensor.shot_noise"},
    {"name": "full_well", "op": "sensor.full_well"},
    {"name": "dsnu", "op": "sensor.dsnu"},
    {"name": "read_noise", "op": "sensor.read_noise"},
    {"name": "gain", "op": "sensor.gain", "iso": "auto"},
    {"name": "adc_noise", "op": "sensor.adc_noise"},
    {"name": "black_clamp", "op": "sensor.black_clamp"},
    {"name": "adc", "op": "sensor.adc"},
    {"name": "black_level", "op": "isp.black_level"},
    {"name": "white_balance", "op": "isp.white_balance", "illuminant": "d65"},
    {"name": "demosaic", "op": "isp.demosaic"},
    {"name": "false_colour", "op": "isp.false_colour"},
    {"name": "colour", "op": "isp.colour_correct"},
    {"name": "srgb", "op": "isp.gamma"},
]
"""What `pipeline/synfog.yaml` says."""

OUTPUTS = {"raw.dng": "adc", "srgb.png": "srgb"}
SEED, SETTINGS = 11, {"exposure_s": 1 / 250, "iso": 200.0}


@pytest.fixture
def scene() -> Image:
    pixels = seeds.stream(0, "scene").random((24, 32, 3), dtype=np.float32) * np.float32(800)
    return Image(pixels, ("R", "G", "B"), Quantity.RADIANCE, provenance={"fov_x_deg": 60.0})


def written(graph, scene, folder):
    run = graph.run({"radiance": scene}, seed=SEED, settings=SETTINGS)
    return {
        name: writers.write_output(name, run[node], folder, options=graph.options_of(name)).read_bytes()
        for name, node in graph.outputs.items()
    }


def test_a_graph_from_python_writes_the_bytes_of_the_yaml(tmp_path, scene):
    yaml = camera.load_graph(resources.folder("pipeline") / "synfog.yaml")
    python = make_graph(camera.OPS, name="synfog", sensor="mi10pro", lens="mi10pro", nodes=NODES, outputs=OUTPUTS)
    assert python.hash == yaml.hash
    files = written(python, scene, tmp_path / "python")
    assert files == written(yaml, scene, tmp_path / "yaml") and set(files) == set(OUTPUTS)


def test_the_ops_called_one_by_one_give_the_bytes_of_the_graph(scene):
    """No engine in between: plain functions, the profile's numbers, and the streams that the nodes' names name."""
    chip, lens = camera.load_sensor("mi10pro"), camera.load_lens("mi10pro")
    image = optics.irradiance(
        scene, f_number=lens.f_number, transmission=lens.transmission, falloff="cos4", fov_x_deg=60.0
    )
    image = blur.diffraction(
        image, f_number=lens.f_number, pixel_pitch_um=chip.pixel_pitch_um, sensor=chip, spot_um=0.8
    )
    image = sensor.expose(
        image, exposure_s=1 / 250, pixel_pitch_um=chip.pixel_pitch_um, fill_factor=chip.fill_factor, sensor=chip
    )
    image = sensor.prnu(image, prnu_percent=chip.prnu_percent, serial=chip.serial)
    image = sensor.dark_current(image, dark_current_e_s=chip.dark_current_e_s)
    image = sensor.shot_noise(image, rng=seeds.stream(SEED, "node", "shot_noise"))
    image = sensor.full_well(image, full_well_e=chip.full_well_e)
    image = sensor.dsnu(image, dsnu_e=chip.dsnu_e, serial=chip.serial)
    image = sensor.read_noise(image, rng=seeds.stream(SEED, "node", "read_noise"), sigma_e=chip.read_noise_e)
    image = sensor.gain(image, iso=200.0, iso_base=chip.iso_base, gain_dn_e=chip.gain_dn_e)
    image = sensor.adc_noise(image, rng=seeds.stream(SEED, "node", "adc_noise"), sigma_dn=chip.adc_noise_dn)
    image = sensor.black_clamp(
        image, rng=seeds.stream(SEED, "node", "black_clamp"), optical_black_rows=chip.optical_black_rows
    )
    raw = sensor.adc(
        image, bits=chip.bits, black_level_dn=chip.black_level_dn, white_level_dn=chip.white_level_dn, sensor=chip
    )
    image = isp.black_level(raw, black_level_dn=chip.black_level_dn, white_level_dn=chip.white_level_dn)
    image = cleanup.false_colour(demosaic.demosaic(isp.white_balance(image, sensor=chip)))
    picture = isp.gamma(isp.colour_correct(image, sensor=chip))
    run = camera.load_graph(resources.folder("pipeline") / "synfog.yaml").run(
        {"radiance": scene}, seed=SEED, settings=SETTINGS
    )
    assert run["adc"].pixels.tobytes() == raw.pixels.tobytes()
    assert run["srgb"].pixels.tobytes() == picture.pixels.tobytes()


def test_faults_in_python_name_the_entry(registry):
    with pytest.raises(GraphError) as caught:
        make_graph(
            registry,
            chip="bad",
            nodes=[{"op": "lens.pass", "scale": -1}, {"op": "chip.expos"}, 3],
            outputs={"a.png": "pass"},
        )
    starts = [
        "graph: 5 errors",
        "chip: chip 'bad': no such chip",
        "nodes[0].scale: node 'pass' (lens.pass): scale is -1; it takes a number above 0, up to 10",
        "nodes[1].op: no op 'chip.expos';",
        "nodes[2]: node 3 is 3; it takes a mapping with an 'op'",
        "outputs.a.png: output 'a.png' takes display_rgb; node 'pass' gives irradiance",
    ]
    told = str(caught.value).splitlines()
    assert [line[: len(start)] for line, start in zip(told, starts, strict=True)] == starts
