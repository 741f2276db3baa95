"""Skies: standard luminances, the table, the shipped pictures against both, domes on a stage."""

import math
from pathlib import Path

import colour
import numpy as np
import OpenImageIO
import pytest
from pxr import Usd, UsdGeom

from assets.builders import daylight
from assets.builders import skies as sky
from synfog_usd.base.errors import ParameterError
from synfog_usd.world import skies

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = ROOT / "assets" / "skies"
NAMES = list(sky.SKIES)
ROWS, COLUMNS = 640, 1280
REC709 = np.array([0.2126, 0.7152, 0.0722])  # ITU-R BT.709

STANDARD = """
1 4.0 -0.70 0 -1.0 0      2 4.0 -0.70 2 -1.5 0.15    3 1.1 -0.8 0 -1.0 0
4 1.1 -0.8 2 -1.5 0.15    5 0 -1.0 0 -1.0 0          6 0 -1.0 2 -1.5 0.15
7 0 -1.0 5 -2.5 0.30      8 0 -1.0 10 -3.0 0.45      9 -1.0 -0.55 2 -1.5 0.15
10 -1.0 -0.55 5 -2.5 0.30 11 -1.0 -0.55 10 -3.0 0.45 12 -1.0 -0.32 10 -3.0 0.45
13 -1.0 -0.32 16 -3.0 0.30 14 -1.0 -0.15 16 -3.0 0.30 15 -1.0 -0.15 24 -2.8 0.15
"""  # type, a, b, c, d, e of CIE S 011/E:2003, typed once more


def standard(kind, height, azimuth, sun_height):
    """L / Lz of a standard sky in one direction [rad], in scalars, from the standard's text."""
    words = [float(w) for w in STANDARD.split()]
    a, b, c, d, e = next(words[i + 1 : i + 6] for i in range(0, len(words), 6) if words[i] == kind)
    cos_chi = math.sin(height) * math.sin(sun_height) + math.cos(height) * math.cos(sun_height) * math.cos(azimuth)

    def f(x):
        return 1 + c * (math.exp(d * x) - math.exp(d * math.pi / 2)) + e * math.cos(x) ** 2

    def phi(h):
        return 1 + a * math.exp(b / math.sin(h)) if h > 0 else 1.0

    return f(math.acos(max(-1.0, min(1.0, cos_chi)))) * phi(height) / (f(math.pi / 2 - sun_height) * phi(math.pi / 2))


def picture(name):
    buffer = OpenImageIO.ImageBuf(str(SHIPPED / f"{name}.exr"))
    return np.asarray(buffer.get_pixels(OpenImageIO.FLOAT), dtype=np.float64), buffer.spec()


def directions(rows):
    """Heights (rows,) and azimuths (2 rows,) of a lat-long picture's pixels [rad]."""
    return np.pi / 2 - (np.arange(rows) + 0.5) / rows * np.pi, (np.arange(2 * rows) + 0.5) / rows * np.pi


def on_the_ground(pixels):
    """Horizontal illuminance per channel: each row's band of the sphere exactly, its luminance as constant."""
    rows = len(pixels)
    edges = np.pi / 2 - np.arange(rows // 2 + 1) / rows * np.pi
    band = (np.sin(edges[:-1]) ** 2 - np.sin(edges[1:]) ** 2) / 2
    return 2 * np.pi * band @ pixels[: rows // 2].mean(axis=1)


@pytest.mark.parametrize("kind", range(1, 16))
def test_standard_skies_follow_the_standard(kind):
    """Against the formula in scalars: luminance in scattered directions, illuminance by Gauss-Legendre."""
    sun = math.radians(35.0)
    rng = np.random.default_rng(kind)
    for height, azimuth in zip(rng.uniform(0.02, 1.55, 12), rng.uniform(0, 6.28, 12), strict=True):
        chi = math.acos(math.sin(height) * math.sin(sun) + math.cos(height) * math.cos(sun) * math.cos(azimuth))
        mine = daylight.relative_luminance(kind, math.pi / 2 - height, chi, math.pi / 2 - sun)
        assert float(mine) == pytest.approx(standard(kind, height, azimuth, sun), rel=1e-9)
    x, w = np.polynomial.legendre.leggauss(40)
    nodes = list(zip(x, w, strict=True))
    points = [(wi * wj, (xi + 1) * math.pi / 4, (xj + 1) * math.pi) for xi, wi in nodes for xj, wj in nodes]
    total = sum(wij * standard(kind, high, round_, sun) * math.sin(2 * high) for wij, high, round_ in points)
    total *= math.pi**2 / 8
    assert daylight.illuminance_per_zenith(kind, 35.0) == pytest.approx(total, rel=2e-3)


def test_a_picture_that_says_nothing_of_itself_is_no_sky_in_nits(tmp_path):
    """The crossing's two are relative; a file that is no picture is none either."""
    assert list(skies.skies()) == sorted(NAMES, key=lambda name: (-sky.SKIES[name].illuminance_lx, name))
    assert skies.read(SHIPPED / "overcast.exr") is None
    (tmp_path / "no.exr").write_bytes(b"no picture")
    assert skies.read(tmp_path / "no.exr") is None


@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_sky_gives_the_tabulated_light(name):
    """Illuminance to 1 % (steps of 0.4 %, half floats); CCT to 3 %, by another method than it was made with; zenith to
    12 %: clouds pass there.
    """
    one = sky.SKIES[name]
    pixels, spec = picture(name)
    assert (spec.height, spec.width, spec.nchannels, str(spec.format)) == (ROWS, COLUMNS, 3, "half")
    assert (SHIPPED / f"{name}.exr").stat().st_size < 1_200_000
    assert np.isfinite(pixels).all() and pixels.min() >= 0
    light = on_the_ground(pixels)
    assert light @ REC709 == pytest.approx(one.illuminance_lx, rel=0.01)
    xyz = colour.RGB_to_XYZ(light / light.max(), "ITU-R BT.709", apply_cctf_decoding=False)
    cct, _ = colour.temperature.XYZ_to_CCT_Ohno2013(xyz)
    assert float(cct) == pytest.approx(one.cct_k, rel=0.03)
    cap = pixels[: ROWS // 9] @ REC709  # 20 degrees about the zenith
    weight = np.cos(directions(ROWS)[0][: ROWS // 9])
    assert (cap.mean(axis=1) @ weight) / weight.sum() == pytest.approx(one.zenith_nits, rel=0.12)


@pytest.mark.parametrize("heading", [0.0, 120.0])
def test_a_dome_shows_the_bright_side_where_the_sun_is(heading):
    """The picture's place on the sphere as UsdLux has it (centre +Z, a quarter from the left +X, top +Y), moved by the
    light's own matrix.
    """
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    one = sky.SKIES["bright_overcast"]
    light = skies.author_dome(stage, "/World/Sky", "bright_overcast", skies=str(SHIPPED), heading_deg=heading)
    pixels, _ = picture("bright_overcast")
    row, column = np.unravel_index((pixels @ REC709).argmax(), (ROWS, COLUMNS))
    u, h = (column + 0.5) / COLUMNS, math.pi / 2 - (row + 0.5) / ROWS * math.pi
    local = (math.sin(2 * math.pi * u) * math.cos(h), math.sin(h), -math.cos(2 * math.pi * u) * math.cos(h))
    x, y, z = UsdGeom.Xformable(light).ComputeLocalToWorldTransform(Usd.TimeCode.Default()).TransformDir(local)
    assert math.degrees(math.atan2(x, y)) % 360 == pytest.approx((one.sun_azimuth_deg + heading) % 360, abs=15)
    assert math.degrees(math.asin(z)) == pytest.approx(one.sun_height_deg, abs=15)
    assert light.GetIntensityAttr().Get() == 1.0  # the picture is in nits
    assert Path(light.GetTextureFileAttr().Get().resolvedPath) == SHIPPED / "bright_overcast.exr"


def test_a_wrong_name_is_answered():
    with pytest.raises(ParameterError, match="Did you mean 'night_glow'"):
        skies.sky_of("night_glo")
