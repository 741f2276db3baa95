"""RAW pairs of clear air and fog: one exposure and one specimen of the sensor, noise of their own."""

import numpy as np

from synfog_usd import camera
from synfog_usd.base import resources
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import writers
from synfog_usd.camera.exposure import Exposure

SHAPE = (48, 64)
FRAMES = 12


def pattern(tmp_path, graph, light_cd_m2, seeds, exposure):
    """Mean of the DNG files of a flat picture: what of each pixel stays, as a share of its colour's mean."""
    flat = Image(np.full((*SHAPE, 3), light_cd_m2, np.float32), ("R", "G", "B"), Quantity.RADIANCE)
    node, frames = graph.outputs["raw.dng"], []
    for seed in seeds:
        made = camera.develop(graph, {"radiance": flat}, seed=seed, exposure=exposure, keep=[node])
        writers.write_output("raw.dng", made[node], tmp_path, options=graph.options_of("raw.dng"))
        frames.append(writers.read_raw(tmp_path / "raw.dng").pixels[..., 0])
    mean = np.mean(frames, axis=0, dtype=float)
    cells = mean.reshape(SHAPE[0] // 2, 2, SHAPE[1] // 2, 2)
    return (cells / cells.mean(axis=(0, 2), keepdims=True) - 1.0).ravel()


def test_a_clear_and_a_foggy_raw_share_the_fixed_pattern(tmp_path):
    """Of two levels of light with other seeds, what stays of each pixel correlates; of another serial it does not.

    PRNU of 0.7 % beside what 12 frames leave of shot noise; 3072 independent pixels give 0.018 by chance.
    """
    graph = camera.load_graph(resources.folder("pipeline") / "phone.yaml").with_overrides(
        {"irradiance.falloff": "none"}
    )
    other = graph.with_overrides({"prnu.serial": "another", "dsnu.serial": "another"})
    exposure = Exposure(exposure_s=1 / 500, iso=55.0)
    clear = pattern(tmp_path, graph, 900.0, range(FRAMES), exposure)
    foggy = pattern(tmp_path, graph, 1300.0, range(100, 100 + FRAMES), exposure)
    elsewhere = pattern(tmp_path, other, 1300.0, range(100, 100 + FRAMES), exposure)
    assert np.corrcoef(clear, foggy)[0, 1] > 0.3
    assert abs(np.corrcoef(clear, elsewhere)[0, 1]) < 0.1
