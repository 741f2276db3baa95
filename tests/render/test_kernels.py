"""Which kernels a bake compiles, and that another process needs none of them anew."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.stages import street

SIZE = 32, 18, 4
LARGE = 1000
"""Operations of a kernel that takes as long to compile as a small picture to render."""

BAKE = """
import json, sys
from pathlib import Path
from synfog_usd.dataset.bake import bake
from synfog_usd.dataset.plan import BakePlan, Sampling
from synfog_usd.render import backend
if backend.start("auto").name != "llvm":
    print(json.dumps(None))
    raise SystemExit
import drjit as dr
folder, out, width, height, samples = Path(sys.argv[1]), sys.argv[2], *map(int, sys.argv[3:6])
dr.set_flag(dr.JitFlag.KernelHistory, True)
read, clear = dr.kernel_history, dr.kernel_history_clear
def keep(types=(dr.KernelType.JIT,)):
    rows = read(types)
    for kernel in rows:
        key = kernel["hash"], lighting
        new = not (kernel["cache_hit"] or kernel["cache_disk"])
        before = found.get(key, (0, False))
        found[key] = kernel["operation_count"], before[1] or new
    return rows
dr.kernel_history, dr.kernel_history_clear = keep, lambda: (keep(), clear())  # the bake reads it too
def progress(what, fraction):
    global lighting
    keep()
    lighting = what.split("/")[0] if "/" in what else lighting
lighting, found = "", {}
plan = BakePlan(folder / "street.usda", folder / out, size=(width, height), sampling=Sampling(samples=samples))
bake(plan, progress=progress)
print(json.dumps([[str(name), place, count, new] for (name, place), (count, new) in found.items()]))
"""


def kernels(folder: Path, out: str, width: int, height: int, samples: int) -> list[list]:
    """[hash, lighting, operations, whether it was compiled] of each kernel of a bake in a process of its own, with the
    kernel cache of `folder`; of two lightings in three fogs.
    """
    (folder / "street.usda").write_text(street(lamp=True))
    arguments = [sys.executable, "-c", BAKE, str(folder), out, *map(str, (width, height, samples))]
    done = subprocess.run(
        arguments, capture_output=True, text=True, env={**os.environ, "HOME": str(folder)}, timeout=500
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    if found is None:
        pytest.skip("no LLVM here")
    return found


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    """A folder with a stage and a cache, and the kernels of its first bake, of both lightings."""
    folder = tmp_path_factory.mktemp("kernels")
    return folder, kernels(folder, "a", *SIZE)


@pytest.mark.slow
def test_a_lighting_has_three_large_kernels(first):
    """Clear air, surfaces in fog, light scattered in fog: for three fogs, the metered frame and the picture alike."""
    found = first[1]
    large = {(place, name) for name, place, count, _ in found if count > LARGE}
    for lighting in ("sky", "active"):
        assert 2 <= len([name for place, name in large if place == lighting]) <= 3, large
    assert any(new for *_, new in found)  # the cache was empty


@pytest.mark.slow
def test_another_size_compiles_no_large_kernel(first):
    """Half as large again, of the same shape, with more samples: the size is not in a kernel's text."""
    again = kernels(first[0], "c", 48, 27, 20)
    assert not [row for row in again if row[3] and row[2] > LARGE]
