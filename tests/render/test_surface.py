"""UsdPreviewSurface's BSDF against its formula, written here once more, and against what no surface may do."""

import math

import drjit as dr
import numpy as np
import pytest
from PIL import Image
from support.parts import bulb, glow, matte, rgb, squares
from support.stats import assert_draws

from synfog_usd.base import resources
from synfog_usd.render import backend, surface
from synfog_usd.render.load import make_bsdf
from synfog_usd.render.shot import render
from synfog_usd.scene.testing import scene
from synfog_usd.world.materials import PALETTE
from synfog_usd.world.roads.asphalt import ALBEDO, Asphalt, looks

PARTS = {
    "plain": {"roughness": 0.5},
    "rough": {"roughness": 1.0, "eta": 1.33},
    "glossy": {"roughness": 0.25, "eta": 1.8},
    "metal": {"roughness": 0.4, "metallic": 1.0},
    "half metal": {"roughness": 0.5, "metallic": 0.4},
    "coated": {"roughness": 0.6, "clearcoat": 0.8, "clearcoat_roughness": 0.3},
    "tinted": {"roughness": 0.5, "specular": rgb(0.5, 0.2, 0.1)},
    "matt": {},
}
BASE = np.array([0.6, 0.3, 0.1])


def _slow(name, quick):
    return pytest.param(name, marks=() if name in quick else pytest.mark.slow)


@pytest.fixture(autouse=True)
def mi():
    module = backend.mitsuba()
    if backend.is_scalar():
        pytest.skip("the scalar variant draws a stand-in")
    surface.register()
    return module


def made(base=BASE, **part):
    return make_bsdf({"type": surface.TYPE, "base_color": {"type": "rgb", "value": list(base)}, **part})


def seen_from(cosine, count, turn=0.7, side=1.0):
    """Interactions whose eye is at this cosine."""
    mi, sine = backend.mitsuba(), np.sqrt(1.0 - cosine**2)
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.n = mi.Normal3f(0.0, 0.0, 1.0)
    si.sh_frame = mi.Frame3f(si.n)
    si.wi = mi.Vector3f(*(float(c) for c in (sine * np.cos(turn), sine * np.sin(turn), side * cosine)))
    return si


def along(*axes):
    return backend.mitsuba().Vector3f(*(np.asarray(axis, dtype=np.float32) for axis in axes))


def grid(rows, columns):
    """(3, rows x columns) directions of the upper side, even in the square of the sine and in the angle, and the share
    of the projected hemisphere, pi, that each has.
    """
    squared, around = np.meshgrid((np.arange(rows) + 0.5) / rows, (np.arange(columns) + 0.5) / columns * 2.0 * np.pi)
    squared, around = squared.ravel(), around.ravel()
    sine = np.sqrt(squared)
    return np.stack([sine * np.cos(around), sine * np.sin(around), np.sqrt(1.0 - squared)]), np.pi / squared.size


def lobe(v, light, alpha, reflection):
    """(3, N) GGX of Walter et al. 2007 by tangents, with Smith's masking of height-correlated slopes [1/sr]."""
    h = v[:, None] + light
    h /= np.linalg.norm(h, axis=0)
    tangent2 = (1.0 - h[2] ** 2) / h[2] ** 2
    normals = 1.0 / (np.pi * alpha**2 * h[2] ** 4 * (1.0 + tangent2 / alpha**2) ** 2)

    def smith(w):
        tangent = np.sqrt(1.0 - w[2] ** 2) / w[2]
        return (-1.0 + np.sqrt(1.0 + (alpha * tangent) ** 2)) / 2.0

    masked = 1.0 / (1.0 + smith(v[:, None]) + smith(light))
    return reflection((v[:, None] * h).sum(axis=0)) * normals * masked / (4.0 * v[2] * light[2])


def fresnel(eta):
    """Of light that is not polarised, by the angles on both sides of the face."""

    def reflection(cosine):
        outside = np.arccos(np.clip(cosine, 0.0, 1.0))
        inside = np.arcsin(np.sin(outside) / eta)
        across = (np.cos(outside) - eta * np.cos(inside)) / (np.cos(outside) + eta * np.cos(inside))
        along = (eta * np.cos(outside) - np.cos(inside)) / (eta * np.cos(outside) + np.cos(inside))
        return np.broadcast_to((across**2 + along**2) / 2.0, (3, *np.shape(cosine)))

    return reflection


def schlick(colour):
    return lambda cosine: colour[:, None] + (1.0 - colour[:, None]) * (1.0 - cosine) ** 5


def formula(part, v, light, base=BASE):
    """(3, N) the BSDF [1/sr]; what the lobes reflect in all is summed over a grid of directions."""
    if "roughness" not in part:
        return np.broadcast_to((base / np.pi)[:, None], light.shape)
    everywhere, share = grid(600, 400)
    glass = fresnel(part.get("eta", 1.5))
    gloss = schlick(np.array(part["specular"]["value"])) if "specular" in part else glass
    alpha, metal, coat = part["roughness"] ** 2, part.get("metallic", 0.0), part.get("clearcoat", 0.0)
    under = 1.0 - lobe(v, everywhere, alpha, gloss).sum(axis=1) * share
    dielectric = lobe(v, light, alpha, gloss) + (under * base / np.pi)[:, None]
    value = metal * base[:, None] * lobe(v, light, alpha, schlick(np.ones(3))) + (1.0 - metal) * dielectric
    if coat:
        sharp = part["clearcoat_roughness"] ** 2
        value *= 1.0 - coat * (lobe(v, everywhere, sharp, glass).sum(axis=1) * share)[:, None]
        value += coat * lobe(v, light, sharp, glass)
    return value


@pytest.mark.parametrize("name", ["half metal", "matt"])
def test_surfaces_that_are_drawn_together_answer_as_each_does_by_itself(mi, name):
    """Value, density, draws and colour of three in turn, by the face, are those of their own objects."""
    part = {"type": surface.TYPE, **PARTS[name]}
    others = [part | {"base_color": rgb(0.2 * n, 0.5, 0.1)} for n in range(3)]
    if "roughness" in part:
        others = [one | {"roughness": 0.3 + 0.2 * n} for n, one in enumerate(others)]
    assert len({surface.kind_of(one) for one in others}) == 1
    number = np.array([2, 0, 1])
    both = make_bsdf(surface.together(others, number))
    si = seen_from(0.6, len(number))
    si.prim_index = backend.numbers(np.arange(len(number)))
    wo = along(*(np.full(len(number), c) for c in (0.48, 0.36, 0.8)))
    u, uv = backend.floats(np.linspace(0.05, 0.9, 3)), mi.Point2f(0.3, 0.6)

    def told(bsdf):
        value, pdf = bsdf.eval_pdf(mi.BSDFContext(), si, wo)
        drawn, weight = bsdf.sample(mi.BSDFContext(), si, u, uv)
        colour = bsdf.eval_diffuse_reflectance(si)
        return np.concatenate(
            [np.broadcast_to(np.array(one), (3, 3)) for one in (value, pdf, drawn.wo, drawn.pdf, weight, colour)]
        )

    own = [told(make_bsdf(one)) for one in others]
    np.testing.assert_allclose(
        told(both), np.stack([own[n][:, face] for face, n in enumerate(number)], axis=1), rtol=1e-6
    )


@pytest.mark.parametrize(
    "wet, kind, low, high",
    [
        ("dry", "new", 1.35, 2.0),
        ("dry", "worn", 0.85, 1.35),
        ("dry", "old", 0.42, 0.85),
        ("dry", "chip_seal", 0.42, 0.85),
        ("damp", "worn", 3.0, 16.0),
    ],
)
def test_asphalt_shines_as_its_class_of_road_surfaces(wet, kind, low, high):
    """The specular factor S1 of CIE 144:2001, 1 degree above the road: classes II to IV, damp as wet roads of Sørensen
    and Nielsen (1974).  The luminance coefficient of light from the front at tan 2, by its cosine cubed, over that of
    light from above.
    """
    paved = Asphalt(kind, wet)
    look = looks(paved, PALETTE)[paved.lane]
    base = ALBEDO[paved.lane] * np.array(look.colour)
    with Image.open(resources.folder("assets") / "textures" / look.gloss) as picture:
        rough = np.quantile(np.asarray(picture) / 255.0, (np.arange(16) + 0.5) / 16) * look.gloss_factor
    cosine = np.array([1.0, 5.0**-0.5])
    si, light = (
        seen_from(math.sin(math.radians(1.0)), 2, turn=math.pi),
        along(np.sqrt(1.0 - cosine**2), np.zeros(2), cosine),
    )
    faces = [made(base, roughness=float(one), eta=look.ior) for one in rough]
    above, front = (
        np.mean([np.array(face.eval(backend.mitsuba().BSDFContext(), si, light))[1] for face in faces], axis=0) / cosine
    )
    assert low < front * cosine[1] ** 3 / above < high


def pictures():
    """Bytes in sRGB, fine numbers, one row, and grey, all of other sizes."""
    draw = np.random.default_rng(5)
    return [
        {"type": "bitmap", "bitmap": draw.integers(0, 256, (5, 7, 3), dtype=np.uint8), "raw": False},
        {"type": "bitmap", "bitmap": draw.uniform(0.0, 1.0, (4, 2, 3)).astype(np.float32), "wrap_mode": "repeat"},
        {"type": "bitmap", "bitmap": draw.integers(0, 256, (1, 9, 4), dtype=np.uint8), "raw": True},
        {"type": "bitmap", "bitmap": (1e-3 * draw.uniform(0.0, 1.0, (3, 3, 1))).astype(np.float32), "raw": False},
    ]


@pytest.mark.parametrize("name", ["half metal", "matt"])
def test_surfaces_with_pictures_that_are_drawn_together_show_each_its_own(mi, name):
    """Colours all over them and round their borders are those of Mitsuba's textures, to a thousandth or 1e-4."""
    surfaces = [{"type": surface.TYPE, **PARTS[name], "base_color": picture} for picture in pictures()]
    assert len({surface.kind_of(one) for one in surfaces}) == 1 and surface.kind_of(surfaces[0]) is not None
    count, kinds = 4000, len(surfaces)
    number = np.arange(count) % kinds
    both, own = make_bsdf(surface.together(surfaces, number)), [make_bsdf(one) for one in surfaces]
    si = seen_from(0.6, count)
    si.prim_index = backend.numbers(np.arange(count))
    si.uv = mi.Point2f(*(backend.floats(axis) for axis in np.random.default_rng(3).uniform(-1.5, 2.5, (2, count))))
    found = np.array(both.eval_diffuse_reflectance(si))
    for n in range(kinds):
        wanted = np.broadcast_to(np.array(own[n].eval_diffuse_reflectance(si)), (3, count))
        np.testing.assert_allclose(found[:, number == n], wanted[:, number == n], rtol=1e-3, atol=1e-4)
        assert wanted[:, number == n].std() > 1e-5
    si.uv = mi.Point2f(dr.nan, dr.inf)  # of a broken mesh: anything but a crash
    assert np.array(both.eval_diffuse_reflectance(si)).shape == (3, count)


@pytest.mark.parametrize("cosine", [0.9, -0.3])
def test_a_matt_surface_is_mitsuba_s_own(mi, cosine):
    """Value, density, draws and their weights of `twosided` and `diffuse`, from both sides; the same numbers give the
    same directions.
    """
    colour = {"type": "rgb", "value": BASE.tolist()}
    theirs = mi.load_dict({"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": colour}})
    light, _ = grid(12, 9)
    si = seen_from(abs(cosine), light.shape[1], side=np.sign(cosine))
    u, uv = mi.Float(0.5), mi.Point2f(*(mi.Float(x.astype(np.float32)) for x in 0.5 + 0.45 * light[:2]))
    for way in (light, -light):
        ours, other = (bsdf.eval_pdf_sample(mi.BSDFContext(), si, along(*way), u, uv) for bsdf in (made(), theirs))
        for one, two in zip(
            (*ours[:2], ours[2].wo, ours[2].pdf, ours[3]),
            (*other[:2], other[2].wo, other[2].pdf, other[3]),
            strict=True,
        ):
            np.testing.assert_allclose(np.array(one), np.array(two), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("name", PARTS)
@pytest.mark.parametrize("cosine", [0.95, 0.15])
def test_the_value_is_the_formulas(mi, name, cosine):
    """Lambert under a lobe that keeps E from it, metal beside it, a coat over both: to 0.5 % of the largest channel,
    which the table of E allows.
    """
    v = np.array([np.sqrt(1.0 - cosine**2), 0.0, cosine])
    light, _ = grid(12, 9)
    for side in (1.0, -1.0):
        si = seen_from(cosine, light.shape[1], turn=0.0, side=side)
        value = np.array(made(**PARTS[name]).eval(mi.BSDFContext(), si, along(*light[:2], side * light[2])))
        wanted = formula(PARTS[name], v, light) * light[2]
        np.testing.assert_allclose(value, wanted, rtol=5e-3, atol=5e-3 * wanted.max(axis=1).mean() / 10.0)
        through = made(**PARTS[name]).eval(mi.BSDFContext(), si, along(*light[:2], -side * light[2]))
        assert not np.array(through).any()


@pytest.mark.parametrize("name", [_slow(name, {"plain", "half metal", "coated"}) for name in PARTS])
def test_draws_are_spread_as_their_density_says(mi, name):
    """Chi-squared over 12 x 16 cells of the upper side, and the share of draws that end above the surface."""
    count, rows, columns, inner = 1 << 17, 12, 16, 32
    draw = np.random.default_rng(5)
    for cosine in (0.9, 0.2):
        bsdf, si = made(**PARTS[name]), seen_from(cosine, count)
        u = [mi.Float(draw.random(count).astype(np.float32)) for _ in range(3)]
        drawn, weight = bsdf.sample(mi.BSDFContext(), si, u[0], mi.Point2f(u[1], u[2]))
        wo, density = np.array(drawn.wo), np.array(drawn.pdf)
        up = density > 0.0
        assert (wo[2][up] > 0.0).all() and not np.array(weight)[:, ~up].any()
        squared, around = 1.0 - wo[2][up] ** 2, np.mod(np.arctan2(wo[1], wo[0])[up], 2.0 * np.pi)
        counts, _, _ = np.histogram2d(squared, around, [rows, columns], [(0.0, 1.0), (0.0, 2.0 * np.pi)])
        light, share = grid(rows * inner, columns * inner)
        pdf = np.array(bsdf.pdf(mi.BSDFContext(), seen_from(cosine, light.shape[1]), along(*light))) / light[2]
        mass = (pdf * share).reshape(columns * inner, rows * inner)  # meshgrid: angle first
        cells = mass.reshape(columns, inner, rows, inner).sum(axis=(1, 3)).T
        assert up.mean() == pytest.approx(cells.sum(), abs=0.01)
        assert_draws(counts, cells)
        both = bsdf.eval_pdf_sample(mi.BSDFContext(), si, drawn.wo, u[0], mi.Point2f(u[1], u[2]))
        np.testing.assert_allclose(np.array(both[1]), density, rtol=1e-5)
        np.testing.assert_allclose(
            (np.array(both[0]) / np.maximum(density, 1e-20))[:, up], np.array(weight)[:, up], rtol=1e-4
        )
        np.testing.assert_array_equal(np.array(both[2].wo), wo)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_face_says_which_side_is_seen_and_not_its_smooth_normal(mi, side):
    """The smooth normal leans 60 degrees from the face's, so an eye 45 degrees over the face is below its horizon."""
    smooth = np.array([np.sin(np.radians(60.0)), 0.0, np.cos(np.radians(60.0))])
    eye = side * np.array([-np.sin(np.radians(45.0)), 0.0, np.cos(np.radians(45.0))])
    light = side * np.stack([smooth, -smooth], axis=-1)
    assert np.dot(eye, smooth) * side < 0.0
    si = seen_from(1.0, 2)
    si.sh_frame = mi.Frame3f(along(*smooth))
    si.wi = si.to_local(along(*eye))
    bsdf = made(np.full(3, 0.5), roughness=1.0, eta=1.000001)
    value = np.array(bsdf.eval(mi.BSDFContext(), si, si.to_local(along(*light))))
    np.testing.assert_allclose(value[:, 0], 0.5 / np.pi, rtol=1e-3)
    assert np.all(value[:, 1] == 0.0)


@pytest.mark.parametrize("name", PARTS)
def test_no_surface_gives_back_more_than_it_gets(mi, name):
    """A white one in light from everywhere, by 2^17 draws of its own: never above 1.003, and a white matte under a
    reflection gives back all of it.
    """
    count = 1 << 17
    draw = np.random.default_rng(6)
    for cosine in (1.0, 0.6, 0.2, 0.03):
        u = [mi.Float(draw.random(count).astype(np.float32)) for _ in range(3)]
        si = seen_from(cosine, count)
        weight = np.array(made([1.0] * 3, **PARTS[name]).sample(mi.BSDFContext(), si, u[0], mi.Point2f(u[1], u[2]))[1])
        assert weight.mean(axis=1).max() < 1.003
        if not PARTS[name].get("metallic"):
            np.testing.assert_allclose(weight.mean(axis=1), 1.0, atol=4e-3)


@pytest.mark.parametrize("name", PARTS)
def test_channels_are_straight_lines_of_their_colour_and_draws_do_not_see_it(mi, name):
    """What `spectra.bsdfs` asks of every BSDF, so that three channels can carry a material's spectrum."""
    light, _ = grid(8, 8)
    si, wo = seen_from(0.6, light.shape[1]), along(*light)
    found = [made([base] * 3, **PARTS[name]).eval_pdf(mi.BSDFContext(), si, wo) for base in (0.0, 0.35, 1.0)]
    low, middle, high = (np.array(value) for value, _ in found)
    np.testing.assert_allclose(middle, 0.65 * low + 0.35 * high, rtol=1e-5, atol=1e-7)
    assert (np.array(found[0][1]) == np.array(found[2][1])).all()


@pytest.mark.parametrize("lamps", [1, 16])
def test_a_lamp_that_is_a_point_is_mirrored_as_bright_as_its_glass_and_gives_all_its_light(lamps):
    """A coat as smooth as they come on black, 3 m from the eye and 4 m from a lamp.

    The light of the highlight is that of the lamp's image 7 m away times Fresnel's reflectance (a fiftieth is GGX's
    tail, out of the picture), its luminance that of glass of LENS_M over the cosine.  Sixteen lamps at one place, each
    a sixteenth, are drawn in another way and look alike.
    """
    eye, turn = np.array([0.0, -3.0, 3.0]) / np.sqrt(2.0), np.eye(4)
    turn[:3, 1], turn[:3, 2], turn[:3, 3] = np.array([0.0, 1.0, 1.0]) / 2**0.5, np.array([0.0, -1.0, 1.0]) / 2**0.5, eye
    lamp = bulb(np.array([0.0, 4.0, 4.0]) / np.sqrt(2.0), 160.0 / lamps)
    coat = {"type": surface.TYPE, "base_color": rgb(0.0), "roughness": 0.03, "eta": 1.5}
    floor = squares([[-9.0, -9.0, 0.0], [9.0, -9.0, 0.0], [9.0, 9.0, 0.0], [-9.0, 9.0, 0.0]], bsdf=coat)
    world = {"shape_floor": floor, **{f"light_{number}": lamp for number in range(lamps)}}
    view = scene(world, width_px=32, height_px=32, fov_x_deg=12.0, to_world=turn)
    seen = render(view, model="path", samples=16).radiance.pixels.mean(axis=2, dtype=np.float64)
    x = (np.arange(32) + 0.5) / 16.0 - 1.0
    edge = np.tan(np.radians(6.0))
    solid_angle = (edge / 16.0) ** 2 / (1.0 + edge**2 * (x[:, None] ** 2 + x**2)) ** 1.5
    cosine, inside = np.sqrt(0.5), np.sqrt(1.0 - 0.5 / 2.25)
    across, along = (cosine - 1.5 * inside) / (cosine + 1.5 * inside), (inside - 1.5 * cosine) / (inside + 1.5 * cosine)
    fresnel = 0.5 * (across**2 + along**2)
    assert (seen * solid_angle).sum() == pytest.approx(fresnel * 160.0 / 7.0**2, rel=0.05)
    assert 0.7 < seen.max() / (fresnel * 160.0 / (np.pi * surface.LENS_M**2) / cosine) < 1.05


@pytest.mark.parametrize("lamp, others", [("point", 0), ("face", 15)])
def test_what_a_rough_surface_shows_of_a_mirrored_lamp_has_its_light_and_no_spikes(lamp, others):
    """A wall that a lamp lights by way of a mirror alone, 5.7 m away, 45 degrees off; a plate keeps its own light off.
    A point, or a face of 0.1 m that shines down; alone, or with others that hardly shine, as one of many.

    Each path meets the mirror by chance.  With lobes of 0.06 rad a sample varies by 18 times the mean, which leaves 2 %
    of noise; were they no wider than the mirror's own it would vary by 70 times or more.
    """
    turn = np.eye(4)
    forward = np.array([0.0, 3.0, -1.0]) / np.sqrt(10.0)
    turn[:3, 2], turn[:3, 0], turn[:3, 3] = -forward, (1.0, 0.0, 0.0), (0.0, 1.0, 3.0)
    turn[:3, 1] = np.cross(turn[:3, 2], turn[:3, 0])

    mirror = {"type": surface.TYPE, "base_color": rgb(0.9), "roughness": 0.03, "metallic": 1.0}
    corners = [[-0.05, -0.05, 2.0], [-0.05, 0.05, 2.0], [0.05, 0.05, 2.0], [0.05, -0.05, 2.0]]
    face = squares(corners, bsdf=matte(0.0), emitter=glow(1000.0 / (0.1**2 * np.sqrt(0.5))))
    world = {
        **({"light_bulb": bulb([0.0, 0.0, 2.0], 1000.0)} if lamp == "point" else {"shape_face": face}),
        **{f"light_{number}": bulb([0.0, 0.0, 40.0], 1e-9) for number in range(others)},
        "shape_mirror": squares([[-30, -30, 0], [30, -30, 0], [30, 30, 0], [-30, 30, 0]], bsdf=mirror),
        "shape_wall": squares([[-3, 4, 0.5], [3, 4, 0.5], [3, 4, 4], [-3, 4, 4]], bsdf=matte(0.5)),
        "shape_plate": squares([[-2, 0.3, 1.9], [2, 0.3, 1.9], [2, 0.3, 9], [-2, 0.3, 9]], bsdf=matte(0.0)),
    }
    view = scene(world, width_px=24, height_px=24, fov_x_deg=8.0, to_world=turn)
    seen = render(view, model="path", samples=1024).radiance.pixels.mean(axis=2, dtype=np.float64)
    expected = 0.5 / np.pi * 0.9 * 1000.0 * np.sqrt(0.5) / 32.0
    assert seen.mean() == pytest.approx(expected, rel=0.06)
    assert seen.std() * 1024**0.5 < 25.0 * expected
