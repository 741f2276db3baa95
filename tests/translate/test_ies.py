"""IES files: candela where the format says, flux by closed forms."""

import math

import numpy as np
import pytest

from synfog_usd.base.errors import StageError
from synfog_usd.translate.ies import parse


def file(vertical, horizontal, candela, *, multiplier=1.0, ballast=1.0, kind=1, tilt="NONE"):
    """A file of LM-63-2002 with candela (H, V)."""
    rows = "\n".join(" ".join(f"{c:.6f}" for c in row) for row in candela)
    return f"""IESNA:LM-63-2002
[TEST] none
[MANUFAC] none
TILT={tilt}
1 1000 {multiplier} {len(vertical)} {len(horizontal)} {kind} 2 0.1 0.1 0
{ballast} 1.0 50
{" ".join(map(str, vertical))}
{" ".join(map(str, horizontal))}
{rows}
""".encode()


def test_an_even_lamp_has_four_pi_of_flux():
    """250 cd in all directions, doubled by the multiplier and halved by the ballast."""
    made = parse(file([0, 90, 180], [0], [[250, 250, 250]], multiplier=2.0, ballast=0.5), "a.ies")
    assert made.flux_lm() == pytest.approx(4 * math.pi * 250, rel=1e-9)
    assert made.at(123.0, 77.0) == pytest.approx(250)


def test_a_lambertian_lamp_has_pi_of_flux():
    """I = 100 cos v below the horizon, nothing above it, sampled each degree: pi x 100 within the error of straight
    lines, (pi / 180)^2 / 12.
    """
    vertical = np.arange(0, 91)
    made = parse(file(vertical, [0], [100 * np.cos(np.radians(vertical))]), "a.ies")
    assert made.flux_lm() == pytest.approx(math.pi * 100, rel=5e-5)
    assert made.at(90.5, 0.0) == 0.0


@pytest.mark.parametrize("horizontal, of", [
    ([0, 45, 90], lambda h: min(h % 180, 180 - h % 180)),
    ([0, 90, 180], lambda h: min(h % 360, 360 - h % 360)),
    ([0, 90, 180, 270, 360], lambda h: h % 360),
    ([90, 180, 270], lambda h: 180 - h % 360 if h % 360 < 90 else 540 - h % 360 if h % 360 > 270 else h % 360),
])  # fmt: skip
def test_symmetry_fills_the_circle(horizontal, of):
    """Candela that grow with the horizontal angle: by quadrants, by halves, about the plane of 90 to 270, or all
    around.
    """
    made = parse(file([0, 90], horizontal, [[h, h] for h in horizontal]), "a.ies")
    for h in (0.0, 10.0, 100.0, 170.0, 190.0, 260.0, 300.0, 359.0, 400.0, -30.0):
        assert made.at(45.0, h) == pytest.approx(of(h)), h


def test_tilted_files_are_read():
    """TILT=INCLUDE puts angles and factors before the lamp's numbers."""
    data = file([0, 90], [0], [[10, 20]], tilt="INCLUDE").replace(
        b"TILT=INCLUDE\n", b"TILT=INCLUDE\n1\n3\n0 45 90\n1.0 0.95 0.9\n"
    )
    assert parse(data, "a.ies").at(45.0, 0.0) == pytest.approx(15.0)


@pytest.mark.parametrize("data, said", [
    (b"IESNA:LM-63-2002\n", "no line 'TILT='"),
    (file([0, 90], [0], [[1, 1]], kind=3), "only type C"),
    (file([0, 90], [0], [[1, 1]]).replace(b" 2 1 1 ", b" 9 1 1 "), "do not fit"),
    (file([90, 0], [0], [[1, 1]]), "do not rise"),
    (b"TILT=NONE\n1 2 three", "numbers only"),
    (b"TILT=NONE\n" + b"9" * 400, "numbers after"),
    (b"TILT=NONE\n" + b"1e999 " * 20, "numbers after"),
    (b"x" * (5 << 20), "at most"),
])  # fmt: skip
def test_broken_files_are_refused(data, said):
    with pytest.raises(StageError, match=said):
        parse(data, "a.ies")
