"""A clip as an animated GIF, for pages that play no video.

python -m docs.studies.clip FOLDER docs/images/clip.gif

FOLDER is a bake of frames, as `make clip` leaves it; its first lighting and fog are shown.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from synfog_usd.base import files
from synfog_usd.dataset.exports.frames import pictures

WIDTH_PX = 320
COLOURS = 256
"""Of each frame."""


def animated(out: Path, target: Path) -> int:
    """Write the GIF.

    Returns:
        how many frames it has.

    Raises:
        ParameterError, OutputError: no clip lies there, or the file cannot be written.
    """
    from PIL import Image

    per_s = json.loads((out / "sequence.json").read_bytes())["frames_per_s"]
    every = list(pictures(out))
    small = []
    for picture in [one for one in every if one.sequence == every[0].sequence]:
        with Image.open(picture.screen) as full:
            size = WIDTH_PX, round(WIDTH_PX * full.height / full.width)
            small.append(full.convert("RGB").resize(size, Image.Resampling.LANCZOS, reducing_gap=3.0))
    method = Image.Quantize.MAXCOVERAGE  # which keeps what is small and colourful
    first, *rest = (frame.quantize(COLOURS, method=method, kmeans=1) for frame in small)
    how = {"save_all": True, "append_images": rest, "duration": round(1000 / per_s), "loop": 0, "optimize": False}
    files.write_whole(target, lambda path: first.save(path, format="GIF", **how))
    return len(small)


if __name__ == "__main__":
    print(animated(Path(sys.argv[1]), Path(sys.argv[2])), "frames")
