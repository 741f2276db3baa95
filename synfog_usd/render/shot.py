"""One shot: radiance with its variance, and the layers that need no samples."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from synfog_usd.errors import ParameterError
from synfog_usd.image import Image, Quantity
from synfog_usd.progress import Progress, silent
from synfog_usd.render import film, layers, models
from synfog_usd.render.load import Loaded, to_mitsuba
from synfog_usd.scene import SceneDict

PROBE_PX = (64, 36)


@dataclass(frozen=True)
class Rendered:
    """What one shot gives.

    Attributes:
        radiance: (H, W, 3) linear Rec.709 in cd m-2, with the variance of its mean.
        layers: what the pixel-centre rays met.
        model, why: which model it was, and why that one.
        relative_error: median over the pixels of standard error / mean luminance.
        warnings: what went wrong on the way, in words.
    """

    radiance: Image
    layers: layers.Layers
    relative_error: float
    model: str
    why: str
    warnings: tuple[str, ...]


def render(
    scene: SceneDict, *, model: str = models.AUTO, samples: int = 64, seed: int = 0, size: tuple[int, int] | None = None, progress: Progress = silent
) -> Rendered:
    """Transport light through one scene.

    Args:
        scene: what `translate` made.
        model: a name of `models.MODELS`, or 'auto'.
        samples: paths per pixel, 2 to 1 048 576.
        seed: the same gives the same bytes in the same variant.
        size: (width, height) in pixels instead of the camera's own.
        progress: told after each pass.

    Raises:
        ParameterError: a model that is unknown or does not hold, or a number of samples out of range.
        StageError: the renderer refuses a part of the scene.
    """
    model, why = models.choose(model, scene)
    if not 2 <= samples <= 1 << 20:
        raise ParameterError(f"--samples {samples}: outside 2 to {1 << 20}; 64 is a draft, 1024 is clean in dense fog")
    loaded = load(scene, size=size, boundaries=models.MODELS[model].boundaries)
    mean, variance, broken = film.expose(loaded, models.MODELS[model].make(loaded), samples=samples, seed=seed, progress=progress)
    warnings = []
    if broken:
        warnings.append(f"{broken} of {mean.shape[0] * mean.shape[1] * samples} samples were not finite and count as black")
    camera = loaded.source.camera
    radiance = Image(
        mean.astype(np.float32),
        ("R", "G", "B"),
        Quantity.RADIANCE,
        variance=variance.astype(np.float32),
        provenance={"fov_x_deg": camera.fov_x_deg, "shift_x": camera.shift[0], "shift_y": camera.shift[1], "model": model, "samples": samples, "seed": seed},
    )
    luminance, noise = mean.mean(axis=2), np.sqrt(variance.mean(axis=2))
    lit = luminance > 0.0
    error = float(np.median(noise[lit] / luminance[lit])) if lit.any() else 0.0
    return Rendered(radiance, layers.measure(loaded), error, model, why, tuple(warnings))


def load(scene: SceneDict, *, size: tuple[int, int] | None = None, boundaries: bool = True) -> Loaded:
    """The scene in Mitsuba, with the near plane moved to the lens where it hides nothing.

    Mitsuba starts a camera ray at the near plane and forgets the fog before it;
    0.1 m of MOR 150 are 0.2 %.  An authored near plane is kept only where something
    stands before it (a camera inside a car body).
    """
    close = replace(scene.camera, near_m=min(scene.camera.near_m, 1e-3))
    loaded = to_mitsuba(replace(scene, camera=close), size=size, boundaries=boundaries)
    if scene.camera.near_m <= close.near_m:
        return loaded
    probe = replace(loaded, source=replace(loaded.source, camera=replace(close, width_px=PROBE_PX[0], height_px=PROBE_PX[1])))
    if not np.any(layers.measure(probe).depth_m < scene.camera.near_m):
        return loaded
    return to_mitsuba(scene, size=size, boundaries=boundaries)
