"""How light it is outdoors against closed forms, days that were read as night, and pictures that would be black."""

import math

import numpy as np
import pytest
from pxr import Gf, Sdf, UsdGeom, UsdLux
from support.looks import fill, write

from synfog_usd.translate import outdoors, translate, why_black


def sun(stage, lux, *, name="Sun", tilt=0.0):
    """A distant light of `lux` across its rays, `tilt` degrees from straight down."""
    light = fill(UsdLux.DistantLight.Define(stage, f"/{name}"), intensity=lux, normalize=True)
    light.AddRotateXOp().Set(tilt)
    return light


def sky(stage, nits, *, name="Sky"):
    light = fill(UsdLux.DomeLight.Define(stage, f"/{name}"), intensity=nits)
    return light


def test_illuminance_of_open_ground_is_that_of_sky_and_slanting_sun(empty):
    """pi L of an even sky, and E cos of a sun at 60 degrees; ground of albedo 0.2 gives back E / pi of that, and fills
    half the view.
    """
    stage = empty()
    sun(stage, 50_000.0, tilt=60.0)
    sky(stage, 4000.0)
    light = outdoors(translate(stage))
    assert light.sun_lux == pytest.approx(50_000.0)
    assert light.ground_lux == pytest.approx(math.pi * 4000.0 + 25_000.0, rel=1e-6)
    assert light.view_cd_m2 == pytest.approx((4000.0 + 0.2 * light.ground_lux / math.pi) / 2, rel=1e-6)
    assert str(light).startswith("as bright as a day in full sun: sun and sky give 37600 lux on open ground, and an")
    assert "noon" not in str(light)


@pytest.mark.parametrize("nits, words, option", [
    (1.0, "deep twilight", "--light-scale 6000"),
    (0.08, "a night of full moon", "--light-scale 80000"),
    (0.0008, "a clear night without a moon", "--light-scale 8000000"),
    (300.0, "an overcast day", None),
    (5000.0, "full daylight without the sun", None),
])  # fmt: skip
def test_a_dome_is_told_in_words_and_the_night_with_the_factor_that_makes_it_noon(empty, nits, words, option):
    """USD's default dome of 1 nit gives pi lux.  Full moon is 0.25 lux, a moonless sky 0.002, an overcast noon 1000 to
    2000 by the tables of illuminances; the factor brings the ground to 20 000 lux, of one figure.
    """
    stage = empty()
    sky(stage, nits)
    text = str(outdoors(translate(stage)))
    assert text.startswith(f"as bright as {words}")
    assert (f"; {option} makes it noon" in text) if option else ("noon" not in text)
    if option:
        factor = float(option.split()[1])
        assert 1.8e4 < outdoors(translate(stage, light_scale=factor)).ground_lux < 2.6e4


def test_a_sky_map_counts_by_the_cosine_of_its_upper_half(empty, tmp_path):
    """1000 nits above and 1e6 below the horizon: pi 1000 lux, the lower half's light falls on no ground."""
    pixels = np.full((64, 128, 3), 1000.0, dtype=np.float32)
    pixels[32:] = 1e6
    write(tmp_path / "sky.exr", pixels)
    stage = empty()
    dome = sky(stage, 1.0)
    dome.CreateTextureFileAttr(Sdf.AssetPath(str(tmp_path / "sky.exr")))
    dome.AddRotateXOp().Set(90.0)  # its top to the stage's Z
    light = outdoors(translate(stage))
    assert light.ground_lux == pytest.approx(
        math.pi * 1000.0, rel=1e-3
    )  # 64 rows: the midpoint rule in cos sin is off by (pi / 64)^2 / 6
    assert light.view_cd_m2 == pytest.approx((1000.0 + 0.2 * 1000.0) / 2, rel=1e-3)


def test_all_lights_are_multiplied_alike(empty, polygon_mesh):
    """Sun, sky, a lamp, a point and a glowing mesh: each number times 2.5."""
    stage = empty()
    sun(stage, 4.0)
    sky(stage, 2.0)
    fill(UsdLux.SphereLight.Define(stage, "/Lamp"), intensity=8.0)
    fill(UsdLux.SphereLight.Define(stage, "/Point"), treatAsPoint=True)
    quad = polygon_mesh(stage, "/Glow", [(0, 5, 0), (1, 5, 0), (1, 5, 1), (0, 5, 1)], [4], [0, 1, 2, 3])
    UsdLux.MeshLightAPI.Apply(quad.GetPrim())

    def numbers(scene):
        found = [part.get("emitter", part) for part in scene.world.values() if isinstance(part, dict)]
        kinds = ("radiance", "irradiance", "intensity")
        return np.array([np.mean(part[name]["value"]) for part in found for name in kinds if name in part])

    plain = numbers(translate(stage))
    assert len(plain) == 5
    np.testing.assert_allclose(numbers(translate(stage, light_scale=2.5)), 2.5 * plain, rtol=1e-12)
    assert "all lights are multiplied by 2.5" in [note.text for note in translate(stage, light_scale=2.5).notes]


def cube(stage, path, place, size):
    shape = fill(UsdGeom.Cube.Define(stage, path), size=size)
    shape.AddTranslateOp().Set(Gf.Vec3d(*place))
    return shape


def test_no_light_at_all_is_why_a_picture_is_black(empty):
    stage = empty()
    cube(stage, "/Wall", (0, 9, 0), 2.0)
    assert "has no light that shines" in why_black(translate(stage))
    sun(stage, 1000.0)
    assert why_black(translate(stage)) is None


def test_nothing_before_the_camera_is_why_a_picture_is_black(empty):
    """Only without a sky, which would be seen."""
    stage = empty()
    sun(stage, 1000.0)
    cube(stage, "/Wall", (0, -9, 0), 2.0)
    assert "everything lies behind the camera" in why_black(translate(stage))
    sky(stage, 1.0)
    assert why_black(translate(stage)) is None
