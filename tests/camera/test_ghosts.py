"""Ghosts: near the axis they are where exact rays go, and no light is made or lost."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from synfog_usd.base.errors import ParameterError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import ghosts as op
from synfog_usd.camera.ghosts import ghosts
from synfog_usd.camera.paraxial import Drawing
from synfog_usd.camera.profiles import load_lens

LENS = load_lens("automotive_6mm")
FACES = (LENS.radius_mm, LENS.thickness_mm, LENS.index, LENS.clear_mm)


def traced(height, slope, mirrors=()):
    """(faces met, heights there, height at the sensor) of an exact ray: spheres are met, Snell's law is obeyed."""
    z = np.concatenate([[0.0], np.cumsum(LENS.thickness_mm)[:-1]])
    behind = np.array(LENS.index)
    before = np.concatenate([[1.0], behind[:-1]])
    place, heights = np.array([-1.0, height - slope]), []
    way = np.array([math.cos(math.atan(slope)), math.sin(math.atan(slope))])
    first, second = mirrors or (len(z), len(z))
    last = len(z) - 1
    order = (
        [*range(second + 1), *range(second - 1, first - 1, -1), *range(first + 1, last + 1)]
        if mirrors
        else range(last + 1)
    )
    for number, face in enumerate(order):
        mirror = bool(mirrors) and number in (second, 2 * second - first)
        if radius := LENS.radius_mm[face]:
            middle = np.array([z[face] + radius, 0.0])
            half = float(way @ (place - middle))
            root = math.sqrt(half**2 - float((place - middle) @ (place - middle)) + radius**2)
            place = place + way * min((-half - root, -half + root), key=lambda t: abs((place + way * t)[0] - z[face]))
            normal = (place - middle) / radius
        else:
            place = place + way * (z[face] - place[0]) / way[0]
            normal = np.array([1.0, 0.0])
        heights.append(float(place[1]))
        normal = normal if normal @ way < 0.0 else -normal
        if mirror:
            way = way - 2.0 * (way @ normal) * normal
        else:
            ratio = (before[face] / behind[face]) if way[0] > 0.0 else (behind[face] / before[face])
            cosine = -float(normal @ way)
            way = ratio * way + (ratio * cosine - math.sqrt(1.0 - ratio**2 * (1.0 - cosine**2))) * normal
    sensor = z[-1] + Drawing(*FACES).focus_mm
    return list(order), np.array(heights), float((place + way * (sensor - place[0]) / way[0])[1])


def test_the_focus_is_where_exact_rays_meet():
    """Of a ray 1 um off the axis, and of one that comes in by 1 urad through the middle of the first face."""
    drawing = Drawing(*FACES)
    assert traced(1e-3, 0.0)[2] == pytest.approx(0.0, abs=1e-9)
    assert traced(0.0, 1e-6)[2] == pytest.approx(1e-6 * drawing.focal_length_mm, rel=1e-6)
    assert drawing.focal_length_mm == pytest.approx(6.0, rel=1e-3)


def test_every_ghost_is_where_exact_rays_end(f_number=2.0):
    """Middle and edge of the beam that its narrowest face lets through, for each pair of faces; exact rays within 10 nm
    of the axis say both.
    """
    step = 1e-5
    free = 0.5 * np.array(LENS.clear_mm)
    free[5] = 6.0003740 / f_number / 2.0 * traced(step, 0.0)[1][5] / step
    left = Drawing(*FACES).ghosts(f_number, 0.0045)
    faces = [face for face in range(11) if face != 5]
    for first, second in itertools.combinations(faces, 2):
        met, high, high_end = traced(step, 0.0, (first, second))
        _, turned, turned_end = traced(0.0, step, (first, second))
        edges = free[met] / np.abs(high / step)
        edge = int(np.argmin(edges))
        diameter = 2.0 * abs(high_end / step) * edges[edge]
        place = (turned_end - high_end * turned[edge] / high[edge]) / step / 6.0003740
        ghost = min(left, key=lambda one, p=place, d=diameter: abs(one.place - p) + abs(abs(one.diameter_mm) - d))
        left.remove(ghost)
        assert ghost.place == pytest.approx(place, rel=1e-4, abs=1e-5)
        assert abs(ghost.diameter_mm) == pytest.approx(diameter, rel=1e-4, abs=1e-6)
    assert left == []


def test_a_plate_before_the_lens_reflects_into_the_same_picture():
    """Two parallel planes before a thin lens: their ghost is the picture itself, at place 1 and as sharp, with R^2."""
    thin = Drawing((0.0, 0.0, 0.0, 50.0, 0.0), (1.0, 3.0, 0.0, 0.0, 1.0), (1.5, 1.0, 1.0, 1.5, 1.0), (90.0,) * 5)
    assert thin.focal_length_mm == pytest.approx(100.0)
    plate = [one for one in thin.ghosts(8.0, 0.04) if abs(one.place - 1.0) < 1e-9 and abs(one.diameter_mm) < 1e-9]
    assert [one.fraction for one in plate] == pytest.approx([0.04**2])


def picture(size, at, light):
    plane = np.full(size, 1.0, dtype=np.float32)
    plane[at] += light
    return Image(np.repeat(plane[..., None], 3, axis=2), ("R", "G", "B"), Quantity.IRRADIANCE)


def test_a_ghost_is_a_disc_where_it_belongs(monkeypatch):
    """1.2 mm wide at -0.5 times the offset, pixels of 10 um; the axis 0.05 widths right, 0.1 heights up."""
    monkeypatch.setattr(op.Drawing, "ghosts", lambda *_: [op.Ghost(-0.5, 1.2, 0.01)])
    image = picture((301, 961), (100, 300), 1e7)
    out = ghosts(image.with_metadata(shift_x=0.05, shift_y=0.1), lens=LENS, f_number=2.0, pixel_pitch_um=10.0)
    added = out.pixels[..., 1].astype(np.float64) - 1.0
    added[100, 300] = 0.0
    axis = (150.0 - 30.1, 480.0 + 48.05)
    y, x = np.mgrid[:301, :961]
    middle = (np.sum(added * y) / added.sum(), np.sum(added * x) / added.sum())
    np.testing.assert_allclose(middle, (1.5 * axis[0] - 50, 1.5 * axis[1] - 150), atol=0.6)  # blocks are 2 pixels wide
    assert added.sum() == pytest.approx(1e5, rel=1e-3)
    r = np.hypot(y - middle[0], x - middle[1])
    np.testing.assert_allclose(added[r < 56.0], 1e5 / (math.pi * 60.0**2), rtol=0.1)
    assert added[r > 66.0].max() < 1e-3 * added.max()


def test_no_light_is_made_or_lost():
    """A lamp near the middle of a picture so wide that all twelve ghosts lie in it."""
    image = picture((901, 901), (440, 460), 1e7)
    out = ghosts(image, lens=LENS, f_number=2.0, pixel_pitch_um=12.0)
    assert len(out.provenance["ghost_fractions"]) == 12
    np.testing.assert_allclose(
        out.pixels.sum(axis=(0, 1), dtype=float), image.pixels.sum(axis=(0, 1), dtype=float), rtol=1e-4
    )
    assert out.pixels[440, 460, 1] == pytest.approx(1e7 * (1.0 - sum(out.provenance["ghost_fractions"])), rel=1e-5)


@pytest.mark.parametrize(
    "faces, told",
    [
        (((1.0,), *FACES[1:]), "lists of 1 and 11 numbers"),
        (((-50.0, 0.0, 0.0), (0.0, 1.0, 1.0), (1.5, 1.0, 1.0), (9.0,) * 3), "does not gather"),
    ],
)
def test_a_drawing_of_no_lens_is_refused(faces, told):
    with pytest.raises(ValueError, match=told):
        Drawing(*faces)


def test_a_profile_whose_drawing_has_another_focal_length_is_refused(tmp_path):
    from synfog_usd.base import resources

    text = (resources.folder("assets") / "lenses" / "automotive_6mm.yaml").read_text()
    (tmp_path / "lens.yaml").write_text(text.replace("{value: 6.0, ", "{value: 8.0, "))
    with pytest.raises(ParameterError, match="the drawing has a focal length of 6 mm, and focal_length_mm is 8"):
        load_lens("lens.yaml", tmp_path)
