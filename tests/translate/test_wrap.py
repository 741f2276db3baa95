"""Wrap modes: each direction's own, as a lookup in the bare picture says."""

import numpy as np
import pytest
from support.looks import SQUARE, painted, picture_of, with_st, write

from synfog_usd.render import backend
from synfog_usd.render.load import make_bsdf
from synfog_usd.translate import translate


def texel(pixels, u, v, wraps):
    """The texel of a picture (row 0 at the top) nearest to (u, v), by the words of the specification."""
    found = []
    for place, size, wrap in zip((u, v), pixels.shape[1::-1], wraps, strict=True):
        number = int(np.floor(place * size))
        if wrap == "black" and not 0 <= number < size:
            return None
        if wrap == "repeat":
            number %= size
        elif wrap == "mirror":
            number = number % (2 * size)
            number = number if number < size else 2 * size - 1 - number
        found.append(min(max(number, 0), size - 1))
    return float(pixels[pixels.shape[0] - 1 - found[1], found[0], 0])


def stage_with(empty, polygon_mesh, file, **inputs):
    """A quad whose coordinates run from -1 to 2, with a picture."""
    stage = empty()
    mesh = with_st(polygon_mesh(stage, "/Quad", SQUARE, [4], [0, 1, 2, 3]), [(-1, -1), (2, -1), (2, 2), (-1, 2)])
    painted(mesh.GetPrim(), diffuseColor=picture_of(stage, file, **inputs))
    return stage


def corner(path, **modes):
    """Write a picture whose upper left quarter is brighter."""
    pixels = np.full((8, 8, 3), 0.5, dtype=np.float16)
    pixels[:4, :4] = 0.75
    write(path, pixels, **modes)


@pytest.mark.parametrize("modes, mode", [("periodic,periodic", "repeat"), ("mirror,mirror", "mirror"), ("", "clamp")])
def test_modes_that_nobody_authored_are_the_files_or_black(empty, polygon_mesh, tmp_path, modes, mode):
    """An EXR's own wrap modes hold; without them the picture has a black rim, two texels wide."""
    corner(tmp_path / "a.exr", **({"wrapmodes": modes} if modes else {}))
    scene = translate(stage_with(empty, polygon_mesh, tmp_path / "a.exr"))
    made = scene.world[scene.world["shape_0"]["bsdf"]["id"]]["bsdf"]["base_color"]
    assert made["wrap_mode"] == mode
    assert made["bitmap"].shape == ((8, 8, 3) if modes else (12, 12, 3))
    assert made["bitmap"][0, 0, 0] == (0.75 if modes else 0.0)
    assert any("wrapS" in note.text and note.path == "/Quad" for note in scene.notes) == (not modes)


@pytest.mark.parametrize("wraps", [("black", "black"), ("repeat", "clamp"), ("mirror", "black")])
def test_mitsuba_shows_it_so(empty, polygon_mesh, tmp_path, wraps):
    """The renderer's own texture at the mesh's coordinates, at the middles of texels beyond the square."""
    corner(tmp_path / "a.exr")
    scene = translate(stage_with(empty, polygon_mesh, tmp_path / "a.exr", wrapS=wraps[0], wrapT=wraps[1]))
    backend.start("auto")
    mi = backend.mitsuba()
    texture = make_bsdf(scene.world[scene.world["shape_0"]["bsdf"]["id"]]["bsdf"]["base_color"])
    pixels = np.full((8, 8, 1), 0.5)
    pixels[:4, :4] = 0.75
    for column, row in ((1, 1), (9, 1), (1, 6), (-4, 6), (14, -7), (3, 14), (-2, -2)):
        u, v = (column + 0.5) / 8, (row + 0.5) / 8
        si = mi.SurfaceInteraction3f()
        si.uv = mi.Point2f(u, 1.0 - v)  # its v runs down
        wanted = texel(pixels, u, v, wraps)
        shown = np.array(texture.eval_3(si)).reshape(-1)
        np.testing.assert_allclose(shown, wanted or 0.0, atol=1e-3, err_msg=f"{column}, {row}")
