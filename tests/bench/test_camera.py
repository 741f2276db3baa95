"""Processor time of demosaicing a frame of 1920 x 1080, the least of three; printed with -s."""

import functools
import time

import numpy as np
import pytest

from synfog_usd.base import seeds
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.demosaic import demosaic

pytestmark = pytest.mark.bench

RUNS = 3


def test_directional_demosaicing_takes_a_part_of_menon_s():
    """Processor time of each algorithm for a frame, the least of three; Menon's is colour-demosaicing's."""
    import colour_demosaicing

    pixels = seeds.stream(0, "mosaic").random((1080, 1920, 1), dtype=np.float32)
    image = Image(pixels, ("Y",), Quantity.DN, provenance={"cfa_pattern": "RGGB"})
    work = {name: functools.partial(demosaic, image, algorithm=name) for name in ("linear", "mhc", "directional")}
    work["menon"] = lambda: colour_demosaicing.demosaicing_CFA_Bayer_Menon2007(pixels[..., 0], "RGGB")
    spent = {}
    for name, run in work.items():
        runs = []
        for _ in range(RUNS):
            began = time.process_time()
            run()
            runs.append(time.process_time() - began)
        spent[name] = min(runs)
    print("\n" + ", ".join(f"{name} {seconds:.2f} s" for name, seconds in spent.items()))
    assert spent["directional"] < 0.25 * spent["menon"]
