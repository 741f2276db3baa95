"""Time and memory that fog saves: a foggy scene loaded whole and reduced, in one run.

Each is loaded in a process of its own, whose memory is told from the system's record of
its peak; what translation holds is taken off.  Figures are printed with -s.
"""

import json
import subprocess
import sys

import pytest

pytestmark = pytest.mark.bench

CHILD = """
import json, resource, sys, time
import numpy as np
from synfog_usd import camera, resources
from synfog_usd.render import backend, shot
from synfog_usd import cull
from synfog_usd.study.pages.culling import foggy

backend.start("auto")
scene = foggy(resources.folder("stages") / "crossroads.usda", "sky", float(sys.argv[1]))
began = time.perf_counter()
if sys.argv[2] == "reduced":
    noise = lambda luminance: camera.noise_floor(luminance, electrons_per_cd_m2=1.0, dark_noise_e=5.3)
    scene = cull.reduced(scene, cull.hide(scene, noise, np.geomspace(30.0, 3000.0, 100)))
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
loaded = shot.load(scene, boundaries=False)
after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(json.dumps({"seconds": time.perf_counter() - began, "mebibytes": (after - before) / 1024}))
"""


def cost(visibility_m, which):
    done = subprocess.run(
        [sys.executable, "-c", CHILD, str(visibility_m), which], capture_output=True, text=True, check=True, timeout=600
    )
    return json.loads(done.stdout)


def test_the_shipped_crossing_in_dense_fog_loads_with_less_time_and_memory():
    """At MOR 50 over half of the triangles are behind fog, not the textures; looking for them is counted in the reduced
    time.
    """
    whole, reduced = cost(50.0, "whole"), cost(50.0, "reduced")
    print(f"\nwhole {whole}, reduced {reduced}")
    assert reduced["mebibytes"] < 0.75 * whole["mebibytes"]
    assert reduced["seconds"] < whole["seconds"]
