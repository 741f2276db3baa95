"""Lamps: files whose candelas add up to their lumens, beams that keep to the regulations, lights on a stage."""

import itertools
import warnings
from pathlib import Path

import colour
import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdLux
from scipy.interpolate import RegularGridInterpolator

from assets.builders import lamps as beams
from synfog_usd.base.errors import ParameterError
from synfog_usd.translate import light, lightgroup
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.world import lamps
from synfog_usd.world.shapes import shift, turn

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = ROOT / "assets" / "lamps"
BEAMS = [name for name, lamp in lamps.LAMPS.items() if lamp.ies]
STREET = [name for name in BEAMS if name.startswith("street")]
LOW = [name for name in BEAMS if name.startswith("low_beam")]


def read_ies(path):
    """(verticals, horizontals, (H, V) candelas, header numbers) of an LM-63 file, read after the standard's text."""
    text = path.read_bytes().decode("ascii")
    assert all(len(line) <= 256 for line in text.split("\r\n")), "LM-63-2002 lets a line hold 256 characters"
    assert "\n" not in text.replace("\r\n", ""), "every line ends in CR LF"
    head, _, body = text.partition("TILT=NONE")
    assert head.startswith("IESNA:LM-63-2002\r\n")
    assert all(line.startswith("[") for line in head.strip().split("\r\n")[1:])
    numbers = np.array(body.split(), dtype=float)
    count_v, count_h = int(numbers[3]), int(numbers[4])
    assert len(numbers) == 13 + count_v + count_h + count_v * count_h
    v, h, table = np.split(numbers[13:], [count_v, count_v + count_h])
    return v, h, table.reshape(count_h, count_v) * numbers[2], numbers[:13]


def sampler(path):
    """I(vertical, horizontal) [deg], linear between the file's angles, with the symmetry that its last angle says."""
    v, h, table, _ = read_ies(path)
    if h[-1] == 180.0:
        h, table = np.concatenate([h, 360 - h[-2::-1]]), np.concatenate([table, table[-2::-1]])
    if len(h) == 1:
        h, table = np.array([0.0, 360.0]), np.concatenate([table, table])
    look = RegularGridInterpolator((h, v), table)
    return lambda vertical, horizontal: look(
        np.stack(np.broadcast_arrays(np.mod(horizontal, 360.0), vertical), axis=-1)
    )


def ahead(path):
    """I(right, up) [deg] of a lamp that looks along its -Z: the goniometer's angles of UN Regulation 112."""
    look = sampler(path)

    def at(right, up):
        r, u = np.deg2rad(np.broadcast_arrays(np.asarray(right, float), np.asarray(up, float)))
        x, y, z = np.cos(u) * np.sin(r), np.sin(u), np.cos(u) * np.cos(r)
        return look(np.degrees(np.arccos(np.clip(z, -1, 1))), np.degrees(np.arctan2(y, x)))

    return at


@pytest.mark.parametrize("name", BEAMS)
def test_candelas_over_the_sphere_are_the_stated_lumens(name):
    """1 %: the file's own steps, integrated by Gauss-Legendre between its vertical angles."""
    look = sampler(SHIPPED / f"{name}.ies")
    v, _, _, numbers = read_ies(SHIPPED / f"{name}.ies")
    nodes, weights = np.polynomial.legendre.leggauss(3)
    azimuth = np.arange(0.25, 360.0, 0.5)
    flux = 0.0
    for low, high in itertools.pairwise(v):
        angle = (low + high) / 2 + (high - low) / 2 * nodes
        ring = look(angle[:, None], azimuth[None, :]).mean(axis=1) * 2 * np.pi
        flux += float(np.sum(weights * ring * np.sin(np.deg2rad(angle)))) * np.deg2rad(high - low) / 2
    lamp = lamps.LAMPS[name]
    assert flux == pytest.approx(lamp.flux_lm, rel=0.01)
    assert numbers[12] == lamp.watts
    assert lamp.lamp_lm == -1 or 0.5 * lamp.lamp_lm < lamp.flux_lm < 0.95 * lamp.lamp_lm  # a lantern keeps some of it


LIMITS = {  # right, up [deg]: least, greatest [cd]; UN Regulation 112 class B, right-hand traffic
    "B50L": (-3.43, 0.57, 0, 350),
    "BR": (2.5, 1.0, 0, 1750),
    "75R": (1.15, -0.57, 10100, np.inf),
    "75L": (-3.43, -0.57, 0, 10600),
    "50L": (-3.43, -0.86, 0, 13200),
    "50R": (1.72, -0.86, 10100, np.inf),
    "50V": (0.0, -0.86, 5100, np.inf),
    "25L": (-9.0, -1.72, 1700, np.inf),
    "25R": (9.0, -1.72, 1700, np.inf),
    "HV": (0.0, 0.0, 0, 625),
}


@pytest.mark.parametrize("name", LOW)
def test_a_low_beam_keeps_to_the_points_of_the_regulation(name):
    at = ahead(SHIPPED / f"{name}.ies")
    for point, (right, up, least, greatest) in LIMITS.items():
        assert least <= at(right, up) <= greatest, point
    assert at(*np.meshgrid(np.linspace(-8, 0, 17), np.linspace(0.2, 6, 30))).max() <= 625  # zone III, left of the kink
    assert at(np.linspace(-5.15, 5.15, 11), np.full(11, -1.3)).min() >= 2500  # zone IV
    assert at(*np.meshgrid(np.linspace(-9, 9, 37), np.linspace(-6, -1.8, 20))).max() <= 2 * at(1.72, -0.86)  # zone I
    assert 20_000 <= at(*np.meshgrid(np.linspace(-3, 4, 29), np.linspace(-3, 0, 31))).max() <= 30_000


@pytest.mark.parametrize(
    ("name", "least", "greatest"), [("street_sodium_150w", 1.0, 1.75), ("street_led_60w", 1.75, 2.75)]
)
def test_street_lanterns_are_of_the_type_they_state(name, least, greatest):
    """IES types II and III, medium: the peak lands 2.25 to 3.75 mounting heights along the road, its half-peak trace 1
    to 1.75 or to 2.75 across.
    """
    look = sampler(SHIPPED / f"{name}.ies")
    across, along = np.meshgrid(np.arange(-3, 5, 0.02), np.arange(0, 8, 0.02), indexing="ij")
    grid = look(np.degrees(np.arctan(np.hypot(across, along))), np.degrees(np.arctan2(along, across)))
    peak = np.unravel_index(grid.argmax(), grid.shape)
    assert 2.25 <= along[peak] < 3.75
    medium = (along >= 2.25) & (along < 3.75) & (grid >= grid.max() / 2)
    assert least < across[medium].max() <= greatest


@pytest.mark.parametrize("name", BEAMS)
def test_the_translation_draws_a_lamp_as_bright_as_its_table_and_has_no_remark(name):
    """Flux to 3 %: the translation steps 5 degrees about the axis, which is coarse for a low beam."""
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    prim = lamps.author_lamp(stage, "/Lamp", name, np.eye(4), lamps=str(SHIPPED)).GetPrim()
    notes = Diagnostics()
    drawn = light.lamp(prim, prim.GetTypeName(), np.eye(4), Usd.TimeCode.Default(), notes, None, metres_per_unit=1.0)
    assert drawn.flux_lm == pytest.approx(lamps.LAMPS[name].flux_lm, rel=0.03)
    assert not notes.closed()


def test_tints_have_the_luminance_and_the_colour_of_their_spectra():
    """Against colour-science's own integration; red and amber lie outside Rec.709, so only their hue can be kept."""
    cmfs = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    for name, lamp in lamps.LAMPS.items():
        rgb = np.array(lamps.tint(name))
        assert rgb @ [0.2126, 0.7152, 0.0722] == pytest.approx(1.0, abs=2e-3)  # ITU-R BT.709
        assert rgb.min() >= 0
        if lamp.spectrum in colour.SDS_ILLUMINANTS and lamp.spectrum != "HP1":
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # it says that it brings tables to one step
                xy = colour.XYZ_to_xy(colour.sd_to_XYZ(colour.SDS_ILLUMINANTS[lamp.spectrum], cmfs))
            mine = colour.XYZ_to_xy(colour.RGB_to_XYZ(rgb, "ITU-R BT.709", apply_cctf_decoding=False))
            np.testing.assert_allclose(mine, xy, atol=2e-3)  # 1 nm against 5 nm steps
    assert lamps.tint("tail")[0] > 4.5 and lamps.tint("tail")[2] == 0


@pytest.mark.parametrize("name", list(lamps.LAMPS))
def test_a_lamp_on_a_stage_has_its_candelas_its_group_and_its_file(name, tmp_path):
    """A ball of luminance x file and of projected area pi r^2, seen from any side; a disk seen from ahead."""
    (tmp_path / "stages").mkdir()
    stage = Usd.Stage.CreateNew(str(tmp_path / "stages" / "one.usda"))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    place = shift(1.0, 2.0, 3.0) @ turn(90.0, "x")
    lit = lamps.author_lamp(stage, "/Lamp", name, place, lamps=str(SHIPPED))
    prim, lamp = lit.GetPrim(), lamps.LAMPS[name]
    area = np.pi * lit.GetRadiusAttr().Get() ** 2
    nits = lit.GetIntensityAttr().Get()
    shaping = UsdLux.ShapingAPI(prim)
    if lamp.ies:
        file = shaping.GetShapingIesFileAttr().Get()
        _, _, table, _ = read_ies(Path(file.resolvedPath))
        assert nits * area * table.max() == pytest.approx(lamp.candela, rel=0.01)
        assert prim.IsA(UsdLux.SphereLight) and not shaping.GetShapingIesNormalizeAttr().Get()
    else:
        assert prim.IsA(UsdLux.DiskLight) and nits * area == pytest.approx(lamp.candela, rel=1e-3)
    assert lightgroup.authored_group(prim) == (lightgroup.STREET_LAMPS if name in STREET else lightgroup.HEADLIGHTS)
    matrix = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
    assert np.allclose(matrix.Transform((0, 0, -1)), (1.0, 3.0, 3.0), atol=1e-6)  # looks along +Y from its place
    assert prim.GetAttribute("synfog:spectrum:emission").Get() == lamp.spectrum


def test_wrong_names_are_answered_with_the_right_ones():
    with pytest.raises(ParameterError, match="Did you mean 'brake'"):
        lamps.lamp_of("brakes")
    with pytest.raises(ParameterError, match="has no IES file"):
        beams.ies_text("tail")
