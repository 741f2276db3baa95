"""How far a picture is from the one without fog.

Takes two pictures (H, W, 3) uint8, coded as sRGB; gives a number.  Each metric is a kept library's where there is one.
"""

from __future__ import annotations

import functools
import importlib.util
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from synfog_usd.base.errors import ParameterError
from synfog_usd.base.science import colour_science

Picture = npt.NDArray[np.uint8]

LPIPS_WANTING = "lpips: not measured; its network's weights are in no installable package"

PACKAGES = {"flip_evaluator": "flip-evaluator", "skimage": "scikit-image"}
"""What brings a metric's library; the licence of the first is for research, so it is in no extra."""


SSIM_WINDOW_PX = 11
"""Side of the window of SSIM, 3.5 standard deviations to each side."""


@dataclass(frozen=True)
class Metric:
    """A distance or a likeness.

    Attributes:
        title: for tables.
        measure: (picture, truth) -> number.
        higher: whether more is better.
        decimals: for tables.
        source: paper or standard.
        module: import name of the library that it needs.
    """

    title: str
    measure: Callable[[Picture, Picture], float]
    higher: bool
    decimals: int
    source: str
    module: str = ""


def psnr(picture: Picture, truth: Picture) -> float:
    """Peak signal-to-noise ratio of all channels together [dB]; 100 for equal pictures, so that means stay finite."""
    error = float(np.mean((picture.astype(np.float64) - truth) ** 2))
    return min(100.0, 10.0 * math.log10(255.0**2 / error)) if error > 0.0 else 100.0


def ssim(picture: Picture, truth: Picture) -> float:
    """Structural similarity, mean over R, G and B, with the paper's Gaussian window of 1.5 pixels; nan for a picture
    that is smaller than the window.
    """
    from skimage.metrics import structural_similarity

    if min(picture.shape[:2]) < SSIM_WINDOW_PX:
        return math.nan
    return float(
        structural_similarity(  # type: ignore[no-untyped-call]
            picture,
            truth,
            channel_axis=2,
            data_range=255,
            gaussian_weights=True,
            sigma=1.5,
            use_sample_covariance=False,
        )
    )


def flip(picture: Picture, truth: Picture) -> float:
    """Mean of FLIP's map: what an eye sees when the two are shown in turn, at 67 pixels a degree."""
    import flip_evaluator

    reference, test = (image.astype(np.float32) / 255.0 for image in (truth, picture))
    _, mean, _ = flip_evaluator.evaluate(reference, test, "LDR")
    return float(mean)


def delta_e(picture: Picture, truth: Picture) -> float:
    """Mean CIEDE2000 over the pixels, under D65."""
    first, second = (_lab(image) for image in (picture, truth))
    return float(np.mean(colour_science().delta_E(first, second, method="CIE 2000")))


def _lab(picture: Picture) -> npt.NDArray[np.float64]:
    colour = colour_science()
    codes, place = np.unique(picture @ np.array([65536, 256, 1]), return_inverse=True)  # each colour once
    levels = np.stack([codes >> 16, codes >> 8 & 255, codes & 255], axis=1)
    linear = colour.cctf_decoding(levels / 255.0, function="sRGB")
    xyz = linear @ np.asarray(colour.RGB_COLOURSPACES["sRGB"].matrix_RGB_to_XYZ).T
    white = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
    return np.asarray(colour.XYZ_to_Lab(xyz, white))[place].reshape(picture.shape)


METRICS = {
    "psnr": Metric("PSNR [dB]", psnr, True, 2, "10 log10(255^2 / MSE)"),
    "ssim": Metric("SSIM", ssim, True, 3, "Wang, Bovik, Sheikh and Simoncelli 2004", "skimage"),
    "flip": Metric("FLIP", flip, False, 3, "Andersson et al. 2020", "flip_evaluator"),
    "de2000": Metric("CIEDE2000", delta_e, False, 2, "CIE 142-2001"),
}
"""Name -> metric, in the order of tables; the first decides ranks."""


@functools.cache
def usable() -> tuple[str, ...]:
    """Names of the metrics whose libraries are installed."""
    return tuple(
        name for name, metric in METRICS.items() if not metric.module or importlib.util.find_spec(metric.module)
    )


def measure(picture: Picture, truth: Picture) -> dict[str, float]:
    """All usable metrics of one picture; one that is no number for it is left out.

    Args:
        picture, truth: (H, W, 3) uint8.

    Raises:
        ParameterError: sizes differ.
    """
    if picture.shape != truth.shape:
        raise ParameterError(
            f"a picture of {_size(picture)} cannot be compared with one of {_size(truth)}; a method gives "
            f"the size it got"
        )
    distances = {name: METRICS[name].measure(picture, truth) for name in usable()}
    return {name: value for name, value in distances.items() if math.isfinite(value)}


def _size(picture: Picture) -> str:
    return f"{picture.shape[1]} x {picture.shape[0]}"
