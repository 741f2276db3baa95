"""The phone at 1920 x 1080 on two cores: its time node by node, and the memory of a process that runs it.

Time is that of `graph.run`, the least of three, metered before.  The scene has texture
and lamps, so that no blur is skipped.  The table is printed with -s.
"""

import os
import platform
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest

from synfog_usd import camera
from synfog_usd.base import photometry, resources, seeds
from synfog_usd.base.constants import LUMINOUS_EFFICACY_LM_W
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.demosaic import demosaic

pytestmark = pytest.mark.bench

SIZE = (1920, 1080)
RUNS = 3


def street(channels):
    """A sky above a textured ground, and three lamps; (H, W, C) of about 300 cd m-2, or of the power of such a
    light.
    """
    width, height = SIZE
    rng = seeds.stream(0, "bench", "street")
    rows = np.linspace(0.0, 1.0, height, dtype=np.float32)[:, None]
    grey = np.where(rows < 0.45, 900.0, 60.0 + 300.0 * rows) * (
        0.8 + 0.4 * rng.random((height, width), dtype=np.float32)
    )
    for x, y in ((400, 600), (960, 620), (1500, 590)):
        grey[y : y + 6, x : x + 8] = 2e5
    colour = (
        np.ones(3) if channels == ("R", "G", "B") else np.full(len(channels), 1.0 / (LUMINOUS_EFFICACY_LM_W * 100.0))
    )
    pixels = grey[..., None].astype(np.float32) * colour.astype(np.float32)
    return Image(pixels, channels, Quantity.RADIANCE, provenance={"fov_x_deg": 60.0})


def bands(count):
    width_nm = 400.0 / count
    return tuple(photometry.band_name(380.0 + width_nm * (index + 0.5)) for index in range(count))


def pass_s(frame, runs=9):
    """Processor seconds of one pass over the frame: every number is read, multiplied and written."""
    other, spent = np.empty_like(frame), []
    for _ in range(runs):
        began = time.process_time()
        np.multiply(frame, np.float32(1.1), out=other)
        spent.append(time.process_time() - began)
    return min(spent)


@pytest.mark.parametrize("channels, most", [(("R", "G", "B"), 150), (bands(16), 100)], ids=["RGB", "16 bands"])
def test_the_phone_takes_few_passes(channels, most):
    """Processor time of the graph, over that of one pass through the frame's memory: a measure that other work on the
    machine and its speed change little.  Node by node by their share of the time.  The first run, which also makes
    what is kept from one picture to the next, is not counted; of the others the middle one is.
    """
    graph = camera.load_graph(resources.folder("pipeline") / "phone.yaml")
    radiance = street(channels)
    settings = camera.meter(radiance, graph).settings
    outputs = tuple(graph.outputs.values())
    found = []
    for seed in range(1 + 3 * RUNS):
        one, began = pass_s(radiance.pixels), time.process_time()
        table = graph.run({"radiance": radiance}, seed=seed, settings=settings, keep=outputs).milliseconds
        found.append(((time.process_time() - began) / one, table))
    passes, table = sorted(found[1:], key=lambda row: row[0])[3 * RUNS // 2]
    print(
        f"\n{SIZE[0]} x {SIZE[1]}, {len(channels)} channels, {os.cpu_count()} cores, {platform.machine()}: passes over "
        f"{radiance.pixels.nbytes / 2**20:.0f} MiB by node, the middle one of {3 * RUNS} warm runs"
    )
    whole = sum(table.values())
    print("\n".join(f"  {name:<16} {passes * spent / whole:7.1f}" for name, spent in table.items()))
    print(f"  {'all':<16} {passes:7.1f}   (runs: {', '.join(f'{row[0]:.0f}' for row in found)})")
    assert passes <= most


def test_the_memory_of_a_run_in_sixteen_bands():
    """Metering, the run and both files in a process of its own: under 2 GiB at its peak, the radiance of 127 MiB
    included.
    """
    code = """
        import resource, sys, tempfile
        sys.path.insert(0, sys.argv[1])
        from pathlib import Path
        from test_camera import bands, street
        from synfog_usd import camera
        from synfog_usd.base import resources
        from synfog_usd.camera.writers import write_output

        graph = camera.load_graph(resources.folder("pipeline") / "phone.yaml")
        run = camera.develop(graph, {"radiance": street(bands(16))}, seed=0, keep=tuple(graph.outputs.values()))
        with tempfile.TemporaryDirectory() as folder:
            for name, node in graph.outputs.items():
                assert write_output(name, run[node], Path(folder)).stat().st_size > 1e5
        print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20)
    """
    command = [sys.executable, "-c", textwrap.dedent(code), str(Path(__file__).parent)]
    peak_gib = float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    print(f"\n{SIZE[0]} x {SIZE[1]}, 16 bands, peak memory: {peak_gib:.2f} GiB")
    assert peak_gib < 2.0


def test_directional_demosaicing_takes_a_part_of_menon_s():
    """Processor time of each algorithm for a frame, the least of three."""
    image = Image(
        seeds.stream(0, "mosaic").random((1080, 1920, 1), dtype=np.float32),
        ("Y",),
        Quantity.DN,
        provenance={"cfa_pattern": "RGGB"},
    )
    spent = {}
    for algorithm in ("linear", "mhc", "menon", "directional"):
        runs = []
        for _ in range(RUNS):
            began = time.process_time()
            demosaic(image, algorithm=algorithm)
            runs.append(time.process_time() - began)
        spent[algorithm] = min(runs)
    print("\n" + ", ".join(f"{name} {seconds:.2f} s" for name, seconds in spent.items()))
    assert spent["directional"] < 0.25 * spent["menon"]
