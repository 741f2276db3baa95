"""On an NVIDIA GPU: the light is that of the processor, and so is what the denoiser makes of it.

python -m pytest -m gpu
"""

import json
import subprocess
import sys

import numpy as np
import pytest
from support.stages import street
from support.stats import assert_agree

from synfog_usd.base.errors import SynfogError
from synfog_usd.base.image import Quantity
from synfog_usd.camera import writers
from synfog_usd.render import backend, denoise

SIZE = "32x18"


@pytest.fixture(scope="module")
def cuda():
    """A device that renders, in this process."""
    try:
        return backend.start("cuda")
    except SynfogError as error:
        pytest.skip(str(error))


@pytest.mark.gpu
@pytest.mark.parametrize("fog", ["clear", "mor150"])
def test_a_bake_there_has_the_light_of_the_processor(cuda, tmp_path, fog):
    """By day, before a wall: mean of the picture of `path` against that of LLVM's, or of Mitsuba's `volpath` where
    there is no libLLVM, within 2 % and five standard errors.
    """
    (tmp_path / "street.usda").write_text(street(lamp=True))
    means = []
    for variant in ("cuda", "llvm" if backend.find_llvm()[0] else "scalar"):
        means.append([])
        for seed in range(4):
            out = tmp_path / f"{variant}{seed}"
            options = {"variant": variant, "seed": seed, "resolution": SIZE, "samples": 256, "quality": "reference"}
            words = f"'street.usda', {str(out)!r}, lighting='sky', fog={fog!r}, **{options}"
            script = f"import synfog_usd as sf; sf.bake({words})"
            subprocess.run([sys.executable, "-c", script], cwd=tmp_path, check=True, timeout=300)
            assert json.loads((out / "bake.json").read_text())["plan"]["variant"].startswith(variant)
            radiance = writers.read_exr(out / "sky" / fog / "radiance.exr", quantity=Quantity.RADIANCE)
            means[-1].append(radiance.pixels.mean())
    assert_agree(*means, resolves=0.02)


@pytest.mark.gpu
@pytest.mark.parametrize("guided", [True, False])
def test_the_denoiser_there_makes_the_same_picture(cuda, monkeypatch, guided):
    """Of noise over two flat halves, with guides and without: to 0.02 of light of 1 and 3."""
    random = np.random.default_rng(0)
    shape = (90, 160, 3)
    truth = np.where(np.arange(shape[1])[:, None] < 80, 1.0, 3.0) * np.ones(shape)
    image = (truth * random.gamma(1.0, 1.0, size=shape)).astype(np.float32)
    guides = denoise._known(truth / 4.0, np.zeros(shape)) if guided else None
    there = denoise._clean(image, guides)
    monkeypatch.setattr(backend, "is_cuda", lambda: False)
    np.testing.assert_allclose(there, denoise._clean(image, guides), atol=0.02)
    assert np.abs(there - truth).mean() < 0.2 * np.abs(image - truth).mean()
