"""The artists' page: a sky of one's own stands upright and is as bright as its page says."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest

import synfog_usd.stage as usd
from synfog_usd.translate import translate
from synfog_usd.translate.daylight import outdoors

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "artists.md").read_text(encoding="utf-8")
STAGE = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Z"
)
def Xform "World"
{
    def Camera "Camera" { double3 xformOp:translate = (0, -5, 1.5)
        float3 xformOp:rotateXYZ = (90, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]
    }
    def Sphere "Ball" {
    }
SKY
}
"""


def lux(folder: Path, block: str, pixels: np.ndarray) -> float:
    """Illuminance of open ground that the program tells of a stage with the page's lights."""
    writer = OpenImageIO.ImageOutput.create(str(folder / "my_sky.exr"))
    writer.open(str(folder / "my_sky.exr"), OpenImageIO.ImageSpec(pixels.shape[1], pixels.shape[0], 3, "float"))
    writer.write_image(np.ascontiguousarray(pixels, dtype=np.float32))
    writer.close()
    (folder / "s.usda").write_text(STAGE.replace("SKY", block))
    return outdoors(translate(usd.open_stage(folder / "s.usda"))).ground_lux


def test_the_sky_of_the_page_stands_upright(tmp_path):
    """Nits L of the upper half are pi L lux, of the lower half none; the sun adds E cos 50.  Rows at the horizon
    are blended.
    """
    (block,) = [text for text in re.findall(r"```usda\n(.*?)```", PAGE, flags=re.DOTALL) if "my_sky.exr" in text]
    sky, _, sun = block.partition("def DistantLight")
    sun = "def DistantLight" + sun
    upper = np.zeros((32, 64, 3))
    upper[:16] = 1000.0
    assert lux(tmp_path, sky, upper) == pytest.approx(1000.0 * math.pi, rel=0.005)
    assert lux(tmp_path, sky, upper[::-1]) == 0.0
    both = 1000.0 * math.pi + 60000.0 * math.cos(math.radians(50.0))
    assert lux(tmp_path, sky + sun, upper) == pytest.approx(both, rel=0.005)
