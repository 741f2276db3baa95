"""RAW as networks take it: a plane for each filter of the 2 x 2 mosaic."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from synfog_usd.base.arrays import FloatArray
from synfog_usd.base.errors import ParameterError


def filter_planes(path: Path) -> FloatArray:
    """(4, H / 2, W / 2) of a RAW file: R, the G of its rows, the other G and B, black 0 and white 1.

    Each is divided by what the file says a white surface has (`AsShotNeutral`), and not cut off: noise goes below 0,
    and highlights of R and B beyond 1.

    Raises:
        ImageError: it cannot be read.
        ParameterError: an odd size.

    Source: the planes of Chen, Chen, Xu and Koltun, Learning to See in the Dark (2018).
    """
    from synfog_usd.camera import writers

    image = writers.read_raw(path)
    provenance = image.provenance
    mosaic = image.pixels[:, :, 0]
    if mosaic.shape[0] % 2 or mosaic.shape[1] % 2:
        raise ParameterError(f"{path}: {mosaic.shape[1]} x {mosaic.shape[0]} pixels; planes need an even size")
    black, white = float(provenance["black_level_dn"]), float(provenance["white_level_dn"])
    pattern, neutral = str(provenance["cfa_pattern"]), provenance["as_shot_neutral"]
    linear = (mosaic - black) / (white - black)
    red, blue = pattern.index("R"), pattern.index("B")
    greens = (red ^ 1, blue ^ 1)  # beside R, and beside B, in its row
    planes = []
    for place, channel in ((red, 0), (greens[0], 1), (greens[1], 1), (blue, 2)):
        planes.append(linear[place // 2 :: 2, place % 2 :: 2] / float(neutral[channel]))
    return np.stack(planes).astype(np.float32)
