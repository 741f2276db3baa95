"""Clips to look at: AV1 in MP4, by PyAV's SVT-AV1.

Takes pictures of 8 bits; gives a file that browsers play.  For measuring there are the frames' own files.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np
import numpy.typing as npt

from synfog_usd.base import system
from synfog_usd.base.errors import OutputError
from synfog_usd.base.files import write_whole

INSTALL = "pip install av"

QUALITY = 30
"""SVT-AV1's constant rate factor, 0 to 63; noise is kept as far as one sees it."""

PRESET = 8
"""SVT-AV1's speed, 0 to 13."""


def available() -> str:
    """'' where clips can be written, else why not."""
    try:
        import av
    except ImportError:
        return f"no PyAV; {INSTALL}"
    return "" if "libsvtav1" in av.codecs_available else "this PyAV has no SVT-AV1"


def pictures(paths: Iterable[Path]) -> Iterator[npt.NDArray[np.uint8]]:
    """(H, W, 3) of 8 bits, of each of some PNG or JPEG files."""
    import OpenImageIO

    for path in paths:
        pixels = np.asarray(OpenImageIO.ImageBuf(str(path)).get_pixels(OpenImageIO.UINT8))
        yield np.broadcast_to(pixels[..., :3], (*pixels.shape[:2], 3))


def write_clip(path: Path, pictures: Iterable[npt.NDArray[np.uint8]], *, per_s: float) -> None:
    """Write a clip.

    Args:
        path: where to.
        pictures: (H, W, 3) coded as sRGB, all of one size; an odd last row or column is left out.
        per_s: pictures a second.

    Raises:
        OutputError: no PyAV, pictures of different sizes or below 16 pixels, or it cannot be written.
    """
    if problem := available():
        raise OutputError(f"{path}: {problem}")
    write_whole(path, lambda temporary: _encode(temporary, path, pictures, per_s))


def _encode(temporary: Path, path: Path, pictures: Iterable[npt.NDArray[np.uint8]], per_s: float) -> None:
    import av

    os.environ.setdefault("SVT_LOG", "1")  # errors alone, instead of a page about its settings
    size: tuple[int, int] | None = None
    with system.as_urgent_as_before(), av.open(str(temporary), "w", format="mp4") as container:
        stream = container.add_stream("libsvtav1", rate=Fraction(per_s).limit_denominator(1001))
        stream.options = {"crf": str(QUALITY), "preset": str(PRESET), "svtav1-params": "lp=1"}
        stream.pix_fmt = "yuv420p"
        context = stream.codec_context
        context.color_range, context.colorspace = 1, 1  # limited range, Rec.709
        context.color_primaries, context.color_trc = 1, 13  # Rec.709, sRGB
        for picture in pictures:
            height, width = (side // 2 * 2 for side in picture.shape[:2])
            if size is None:
                size = height, width
                stream.width, stream.height = width, height
                if min(size) < 16:
                    raise OutputError(f"{path}: AV1 takes pictures of 16 pixels and more; these are {width} x {height}")
            if size != (height, width):
                raise OutputError(f"{path}: pictures of {width} x {height} and {size[1]} x {size[0]} in one clip")
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture[:height, :width]), format="rgb24")
            container.mux(stream.encode(frame.reformat(format="yuv420p", dst_colorspace="ITU709")))
        container.mux(stream.encode(None))
