"""Each light on a matt card: irradiance by closed form, measured with the renderer's own emitters."""

import math

import numpy as np
import pytest
from pxr import UsdGeom, UsdLux
from support.looks import fill, write

from synfog_usd.render import backend
from synfog_usd.render.load import to_mitsuba
from synfog_usd.translate import translate

RED, GREEN = 0, 1


def irradiance(stage, position, normal, samples=1 << 18):
    """(3,) irradiance [lx] at a point, by the emitters' own sampling; relative standard error."""
    return irradiance_of(loaded_of(stage), position, normal, samples)


def loaded_of(stage):
    """The scene of a stage, loaded."""
    backend.start("auto")
    return to_mitsuba(translate(stage, resolution=(8, 8)))


def irradiance_of(loaded, position, normal, samples=1 << 18):
    """`irradiance` in a scene that is loaded."""
    mi = backend.mitsuba()
    import drjit as dr

    scene, loaded = loaded.source, loaded.scene
    si = dr.zeros(mi.SurfaceInteraction3f, samples)
    si.p, si.n = (
        mi.Point3f((np.asarray(position) - scene.origin_m).tolist()),
        mi.Normal3f(np.asarray(normal, dtype=float).tolist()),
    )
    dr.make_opaque(si.p, si.n)  # else each place would have a kernel of its own
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(7, samples)
    sent, weight = loaded.sample_emitter_direction(si, sampler.next_2d(), False)
    light = np.array(
        weight * dr.maximum(dr.dot(sent.d, mi.Vector3f(np.asarray(normal, dtype=float).tolist())), 0.0)
    ).reshape(3, -1)
    mean = light.mean(axis=1)
    return mean, float((light.std(axis=1) / np.maximum(mean, 1e-30)).max() / math.sqrt(samples)) if light.shape[
        1
    ] > 1 else 0.0


def quadrant(a, b, d):
    """View factor from a small card to the corner of a parallel a x b rectangle at distance d."""
    x, y = a / d, b / d
    return (
        x / math.hypot(1, x) * math.atan(y / math.hypot(1, x)) + y / math.hypot(1, y) * math.atan(x / math.hypot(1, y))
    ) / (2 * math.pi)


def cylinder_side(radius, length, d):
    """Irradiance of a side of radiance 1, by midpoints: axis along x, at height d above a card that looks at it."""
    u, x = (np.arange(2000) + 0.5) / 2000 * 2 * np.pi, ((np.arange(500) + 0.5) / 500 - 0.5) * length
    outward = np.stack([np.zeros_like(u), np.cos(u), np.sin(u)], axis=1)
    place = radius * outward[:, None] + np.stack([x, np.zeros_like(x), np.full_like(x, d)], axis=1)
    square = (place**2).sum(axis=2)
    leaving = np.maximum(-np.einsum("uxi,ui->ux", place, outward), 0.0)
    return float((leaving * place[..., 2] / square**2).sum() * (2 * np.pi * radius / 2000) * (length / 500))


@pytest.mark.parametrize("kind, size, wanted", [
    ("SphereLight", {"radius": 0.5}, math.pi * (0.5 / 2.0) ** 2),
    ("DiskLight", {"radius": 0.5}, math.pi * 0.25 / (0.25 + 4.0)),
    ("RectLight", {"width": 1.0, "height": 3.0}, math.pi * 4 * quadrant(0.5, 1.5, 2.0)),
    ("CylinderLight", {"radius": 0.3, "length": 2.0}, cylinder_side(0.3, 2.0, 2.0)),
    ("DistantLight", {"angle": 2.0}, math.pi * math.sin(math.radians(1.0)) ** 2),
    ("DomeLight", {}, math.pi),
])  # fmt: skip
def test_a_card_under_each_light(empty, kind, size, wanted):
    """Radiance 100 two metres above: sphere (r / d)^2, coaxial disk, parallel rectangle, a cylinder by quadrature, sun
    sin^2, sky 1; all times pi L.
    """
    stage = empty()
    prim = stage.DefinePrim("/Lamp", kind)
    UsdLux.LightAPI(prim).CreateIntensityAttr(100.0)
    for name, value in size.items():
        prim.GetAttribute(f"inputs:{name}").Set(value)
    if kind != "DomeLight":
        UsdGeom.Xformable(prim).AddTranslateOp().Set((0, 5, 2))
    found, error = irradiance(stage, (0, 5, 0), (0, 0, 1), samples=1 << 21)
    assert 4 * error < 0.005
    np.testing.assert_allclose(found, 100.0 * wanted, rtol=0.005)  # four standard errors of the sampling at most


def around(h):
    return 1 + math.sin(h) / 2 + math.cos(h) / 4


def test_a_luminaire_sends_what_its_file_says(empty, tmp_path):
    """I(v, h) = (1000 - 5 v)(1 + sin(h) / 2 + cos(h) / 4) cd, axis straight down, h from +X to +Y: E = I / d^2 on a
    card that looks at the lamp.
    """
    vertical, horizontal = np.arange(0, 91, 5), np.arange(0, 361, 10)
    rows = "\n".join(" ".join(f"{(1000 - 5 * v) * around(math.radians(h)):.3f}" for v in vertical) for h in horizontal)
    numbers = (
        f"1 1000 1 {len(vertical)} {len(horizontal)} 1 2 0 0 0\n1 1 "
        f"50\n{' '.join(map(str, vertical))}\n{' '.join(map(str, horizontal))}\n{rows}\n"
    )
    (tmp_path / "lamp.ies").write_text(f"IESNA:LM-63-2002\nTILT=NONE\n{numbers}")
    stage = empty()
    lamp = fill(UsdLux.SphereLight.Define(stage, "/Lamp"), radius=0.05)
    lamp.CreateIntensityAttr(4.0)  # normalized: a quarter of it, in candela
    lamp.CreateNormalizeAttr(True)
    lamp.AddTranslateOp().Set((0, 5, 6))
    UsdLux.ShapingAPI.Apply(lamp.GetPrim()).CreateShapingIesFileAttr(str(tmp_path / "lamp.ies"))
    loaded = loaded_of(stage)
    for off_axis, turn in ((10.0, 0.0), (20.0, 90.0), (50.0, 200.0), (70.0, 90.0)):
        v, h = math.radians(off_axis), math.radians(turn)
        way = direction(v, h)
        found, _ = irradiance_of(loaded, (0, 5, 6) + 3.0 * way, -way, samples=1)
        np.testing.assert_allclose(found, (1000 - 5 * off_axis) * around(h) / 9.0, rtol=0.01)


def direction(v, h):
    """Away from a lamp, by angles from straight down and about the vertical [rad]."""
    return np.array([math.sin(v) * math.cos(h), math.sin(v) * math.sin(h), -math.cos(v)])


PROFILE = "IESNA:LM-63-2002\nTILT=NONE\n1 1000 1 {v} {h} 1 2 0 0 0\n1 1 50\n{verticals}\n{horizontals}\n{rows}\n"


def written(file, vertical, candela):
    """An IES file that is the same all around."""
    rows = " ".join(f"{value:.4f}" for value in candela)
    file.write_text(
        PROFILE.format(v=len(vertical), h=1, verticals=" ".join(map(str, vertical)), horizontals="0", rows=rows)
    )
    return str(file)


FAR_M = 12.0
AREA_M2 = {  # seen from `way`, a unit vector in the light's frame
    "SphereLight": ({"radius": 0.05}, lambda way: math.pi * 0.05**2),
    "DiskLight": ({"radius": 0.05}, lambda way: math.pi * 0.05**2 * max(-way[2], 0.0)),
    "RectLight": ({"width": 0.04, "height": 0.1}, lambda way: 0.004 * max(-way[2], 0.0)),
    "CylinderLight": ({"radius": 0.02, "length": 0.1}, lambda way: 2 * 0.02 * 0.1 * math.hypot(way[1], way[2])),
}


def smoothstep(low, high, x):
    t = min(max((x - low) / (high - low), 0.0), 1.0)
    return t * t * (3 - 2 * t)


SHAPED = [
    (kind, shape) for kind in AREA_M2 for shape in ("cone", "focus", "ies") if (kind, shape) != ("DiskLight", "cone")
]


@pytest.mark.parametrize("kind, shape", SHAPED)
def test_each_shape_of_light_is_shaped_as_specified(empty, tmp_path, kind, shape):
    """E = L A S / d^2 with the area A that is seen from there, and S: 1 - smoothstep(30, 60), a tinted cos^3, or 900 -
    4 v candelas to 180 degrees.

    A disk with nothing but a cone is drawn as Mitsuba's own spot, see `light._spot`.  Sizes count for (0.1 / 12)^2 =
    7e-5.
    """
    size, seen = AREA_M2[kind]
    stage = empty()
    prim = stage.DefinePrim("/Lamp", kind)
    UsdLux.LightAPI(prim).CreateIntensityAttr(1e5)
    for name, value in size.items():
        prim.GetAttribute(f"inputs:{name}").Set(value)
    UsdGeom.Xformable(prim).AddTranslateOp().Set((0, 5, 30))
    shaping = UsdLux.ShapingAPI.Apply(prim)
    shaping.CreateShapingConeAngleAttr(60.0 if shape == "cone" else 180.0)
    if shape == "cone":
        shaping.CreateShapingConeSoftnessAttr(0.5)
    elif shape == "focus":
        fill(shaping, shapingFocus=3.0, shapingFocusTint=(0.5, 0.0, 0.2))
    else:
        vertical = np.arange(0, 181, 10)
        shaping.CreateShapingIesFileAttr(written(tmp_path / "a.ies", vertical, 900.0 - 4.0 * vertical))
    loaded = loaded_of(stage)
    for off_axis, turn in ((5.0, 0.0), (38.0, 40.0), (52.0, 250.0), (110.0, 130.0)):
        v, h = math.radians(off_axis), math.radians(turn)
        way, fall = direction(v, h), abs(math.cos(v)) ** 3
        factor = {"cone": 1 - smoothstep(30.0, 60.0, off_axis), "ies": 900.0 - 4.0 * off_axis}.get(
            shape, fall + (1 - fall) * np.array([0.5, 0.0, 0.2])
        )
        found, _ = irradiance_of(loaded, (0, 5, 30) + FAR_M * way, -way, samples=1)
        np.testing.assert_allclose(found, 1e5 * seen(way) * factor / FAR_M**2, rtol=0.005, atol=1e-6)


@pytest.mark.parametrize("vertical", [
    [0, 90, 180],  # the same everywhere: nothing changes
    [0, 45, 90],  # of one hemisphere, over which it is averaged
])  # fmt: skip
def test_a_normalized_profile_keeps_the_energy(empty, tmp_path, vertical):
    """Over the mean of the sphere, or of the hemisphere where the file has no more: a profile that is even changes
    nothing.
    """
    stage = empty()
    lamp = fill(UsdLux.SphereLight.Define(stage, "/Lamp"), radius=0.05)
    lamp.AddTranslateOp().Set((0, 5, 6))
    shaping = UsdLux.ShapingAPI.Apply(lamp.GetPrim())
    fill(shaping, shapingConeAngle=180.0, shapingIesFile=written(tmp_path / "a.ies", vertical, [730.0] * 3))
    fill(shaping, shapingIesNormalize=True)
    found, _ = irradiance(stage, (1.0, 5, 3.0), (0, 0, 1), samples=1)
    np.testing.assert_allclose(found, math.pi * 0.05**2 * 3.0 / 10.0**1.5, rtol=0.002)


def test_the_angle_scale_draws_a_profile_out_from_its_top(empty, tmp_path):
    """At 60 degrees and a scale of 0.5 the file is read at (60 - 180) / 1.5 + 180 = 100 degrees."""
    stage = empty()
    lamp = fill(UsdLux.SphereLight.Define(stage, "/Lamp"), radius=0.05)
    lamp.AddTranslateOp().Set((0, 5, 6))
    shaping = UsdLux.ShapingAPI.Apply(lamp.GetPrim())
    shaping.CreateShapingConeAngleAttr(180.0)
    vertical = np.arange(0, 181, 10)
    shaping.CreateShapingIesFileAttr(written(tmp_path / "a.ies", vertical, 900.0 - 4.0 * vertical))
    shaping.CreateShapingIesAngleScaleAttr(0.5)
    way = np.array([math.sin(math.radians(60)), 0.0, -0.5])
    found, _ = irradiance(stage, (0, 5, 6) + 4.0 * way, -way, samples=1)
    np.testing.assert_allclose(found, math.pi * 0.05**2 * (900.0 - 400.0) / 16.0, rtol=0.002)


def test_the_picture_of_a_rect_light_is_upright_from_its_front(empty, tmp_path):
    """Seen from the front with +Y up, +X is at the left: the picture's left column (red) lies at +X and its top row
    (bright) at +Y.
    """
    pixels = np.zeros((2, 2, 3), dtype=np.float32)
    pixels[:, 0, RED], pixels[:, 1, GREEN] = 1.0, 1.0
    pixels[0] *= 4.0
    write(tmp_path / "a.exr", pixels)
    stage = empty()
    light = fill(UsdLux.RectLight.Define(stage, "/Lamp"), intensity=100.0, textureFile=str(tmp_path / "a.exr"))
    light.AddTranslateOp().Set((0, 5, 2))  # looks down; +X is +X, +Y is +Y of the scene
    loaded, sides = loaded_of(stage), [(x, y) for x in (-1, 1) for y in (-1, 1)]
    near = {(x, y): irradiance_of(loaded, (0.45 * x, 5 + 0.45 * y, 1.9), (0, 0, 1))[0] for x, y in sides}
    assert near[1, 1][RED] > 3 * near[1, 1][GREEN] and near[-1, 1][GREEN] > 3 * near[-1, 1][RED]
    assert near[1, 1][RED] > 2.5 * near[1, -1][RED] and near[-1, 1][GREEN] > 2.5 * near[-1, -1][GREEN]


def test_a_second_sky_adds_its_mean_colour(empty, tmp_path):
    """Irradiance on four sides is that of the larger map and pi times the other's mean over solid angles."""
    rng = np.random.default_rng(4)
    maps = {}
    for name, height in (("a", 32), ("b", 64)):
        v, u = np.mgrid[:height, : 2 * height] / height * math.pi
        waves = [1.5 + np.sin(u + p) * np.sin(v) + 0.4 * np.cos(v) for p in rng.uniform(0, 6, 3)]
        maps[name] = np.stack(waves, axis=-1).astype(np.float32)
        write(tmp_path / f"{name}.exr", maps[name])

    def stage_of(names):
        stage = empty()
        for name in names:
            fill(UsdLux.DomeLight.Define(stage, f"/Sky{name}"), textureFile=str(tmp_path / f"{name}.exr"))
        return stage

    rows = np.sin((np.arange(32) + 0.5) / 32 * math.pi)
    mean = np.average(maps["a"], axis=(0, 1), weights=np.broadcast_to(rows[:, None], (32, 64)))
    alone, both = (loaded_of(stage_of(names)) for names in ("b", "ab"))
    for normal in (*np.eye(3)[[0, 2]], *-np.eye(3)[[0, 2]]):
        first, together = (irradiance_of(loaded, (0, 0, 0), normal)[0] for loaded in (alone, both))
        np.testing.assert_allclose(together, first + math.pi * mean, rtol=0.01)


def test_shaping_that_shapes_nothing_leaves_a_panel_a_panel(empty):
    """Omniverse applies ShapingAPI to every light: at 90 degrees a flat one is as it was."""
    stage = empty()
    light = UsdLux.RectLight.Define(stage, "/Lamp")
    UsdLux.ShapingAPI.Apply(light.GetPrim())
    assert any(part["type"] == "rectangle" for key, part in translate(stage).world.items() if key.startswith("shape_"))
