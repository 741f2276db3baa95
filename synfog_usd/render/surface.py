"""UsdPreviewSurface as a BSDF of Mitsuba's: Lambert's matte under a dielectric reflection, metal, and a clear coat.

Mitsuba's own `principled` has Disney's matte part, which glows where a rough surface is seen or lit flat.  In a
`SceneDict` it is

    {'type': 'preview_surface', 'base_color': colour, 'roughness': 0 to 1, 'eta': index of refraction,
     'specular': colour at normal incidence, in the place of what eta says,
     'metallic': 0 to 1, 'clearcoat': 0 to 1, 'clearcoat_roughness': 0 to 1}

with numbers, or textures in their place; eta is a number, 1.5 where nothing is said.  A surface need not have more
than the first two, and one that has no roughness is matt and mirrors nothing; a coat has both of its inputs.  Let c be
the coat, m the metal and rho the base colour.  Let G be a GGX lobe of alpha = roughness^2, and E what it reflects in
all of a direction v.  Then

    f = c G_coat + (1 - c E_coat(v)) (m rho G_metal + (1 - m) (G_dielectric + (1 - E_dielectric(v)) rho / pi))

A lobe reflects as Fresnel's equations say of the index, or by Schlick's rule from `specular` to white; metal reflects
rho at any angle.  So are the parts put together in MaterialX's definition of UsdPreviewSurface
(bxdf/usd_preview_surface.mtlx), and in Cycles, which has Fresnel's curve too where MaterialX has Schlick's.  Storm's
previewSurface.glslfx has 1 - F(v . h) for 1 - E(v), by which white surfaces give back more than they get.
Both sides of a face look alike.

Surfaces that have the same inputs can be drawn as one (`together`), if only the base colour is a picture.  It reads its
numbers and finds its picture by the face.  Dr.Jit records a BSDF's code once for each object and runs it for each that
16 paths meet, and a street has a hundred surfaces of a few kinds.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np

from synfog_usd.base.arrays import Array, Indices
from synfog_usd.render import backend
from synfog_usd.scene import mean_colour, texels

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float, UInt32
    from mitsuba import (
        BSDFContext,
        BSDFSample3f,
        Color3f,
        Point2f,
        Point3f,
        Properties,
        SurfaceInteraction3f,
        TraversalCallback,
        Vector2f,
        Vector3f,
        Vector4f,
    )

TYPE = "preview_surface"

MIN_ALPHA = 1e-3
"""Width of the sharpest lobe: single precision holds nothing sharper."""

LENS_M = 0.1
"""Radius [m] of the glass of a lamp that is a point, in surfaces that mirror it: about that of a headlight."""

MOST_SPREAD = 0.15
"""Roughness [rad] up to which a path's own spread widens what the first path of a pixel shows in a mirror, see `blur`.

RMS error of the crossing at dusk at MOR 150, 64 samples: 26 %, without blur 59 %.
"""

COAT = 40.0
"""Times more often that a coat is drawn than it reflects, where images of lamps alone are looked for.

Shadow rays find all other light as well.
"""

MATTE = 0.2
"""Reflectance that a matte part is taken to have where a lobe is chosen: colours must not change how paths go on, see
`spectra.bsdfs`.
"""

NODES = 32
"""Rows of `lobe_albedo`'s table by the cosine, and by the roughness."""

STEPS, MOST = 20, 0.995
"""Tables of `lobe_albedo` by the amplitude that a dielectric reflects, from 0 to 1, and the largest amplitude."""

GOLDEN = 0.5 * (5.0**0.5 - 1.0)

_INPUTS = ("roughness", "metallic", "clearcoat", "clearcoat_roughness")
_ROW = 8
"""Numbers of a surface that is drawn with others: its colour, or the width and height of its picture [texels] and none;
its `_INPUTS`; and none.
"""

_FULL = 65535.0
"""Of a texel of such a picture, which holds the roots of its R, G and B in 16 bits each, and none: as fine where it is
dark as where it is bright.
"""

_known: set[str] = set()


def register() -> None:
    """Tell Mitsuba about the BSDF, once for each variant; the scalar one draws `stand_in` in its place."""
    mi = backend.mitsuba()
    if mi.variant() not in _known and not backend.is_scalar():
        _known.add(mi.variant())
        bsdf = backend.derived(mi.BSDF, _PreviewSurface)
        mi.register_bsdf(backend.plugin_name(TYPE), lambda properties: bsdf(properties))


@functools.lru_cache(maxsize=STEPS + 1)
def lobe_albedo(step: int, points: int = 610) -> Array:
    """(3, NODES, NODES) what a GGX lobe reflects of light from one direction, by the root of its cosine and by its
    roughness, both evenly from 0 to 1.

    The first two are of Schlick's weights 1 - (1 - v . h)^5 and (1 - v . h)^5: a lobe of reflection r0 at normal
    incidence and r90 at grazing has r0 first + r90 second.  The third is of a dielectric's whose amplitude at normal
    incidence, (n - 1) / (n + 1), is `step` / STEPS.  Mean of `points` visible normals (Heitz 2018) each, evenly spread:
    the weight of one is G2 / G1.
    """
    between, shadowed, schlick = _lobe(points)
    amplitude = min(step / STEPS, MOST)
    index = (1.0 + amplitude) / (1.0 - amplitude)
    refracted = np.sqrt(index**2 - 1.0 + between**2)
    across = (refracted - between) / np.maximum(refracted + between, 1e-9)
    along = (between * (refracted + between) - 1.0) / (between * (refracted - between) + 1.0)
    dielectric = 0.5 * across**2 * (1.0 + along**2)
    return np.stack([*schlick, (shadowed * dielectric).mean(axis=-1)])


@functools.lru_cache(maxsize=1)
def _lobe(points: int) -> tuple[Array, Array, Array]:
    """Of `points` visible normals of each lobe, (NODES, NODES, points): the cosine between them and the direction, and
    their weights; and what `lobe_albedo` has of Schlick's weights.
    """
    root, roughness = (axis[..., None] for axis in np.meshgrid(*2 * [np.linspace(0.0, 1.0, NODES)], indexing="ij"))
    cosine, alpha = np.maximum(root**2, 1e-4), np.maximum(roughness**2, MIN_ALPHA)
    v = (np.arange(points) + 0.5) / points
    u = np.modf(np.arange(points) * GOLDEN)[0]
    sine = np.sqrt(1.0 - cosine**2)
    stretched = np.stack([alpha * sine + 0.0 * u, 0.0 * (alpha * sine + u), cosine + 0.0 * u])
    stretched /= np.linalg.norm(stretched, axis=0)
    z = (1.0 - v) * (1.0 + stretched[2]) - stretched[2]
    ring = np.sqrt(np.maximum(1.0 - z**2, 0.0))
    h = np.stack([ring * np.cos(2.0 * np.pi * u), ring * np.sin(2.0 * np.pi * u), z]) + stretched
    h *= np.stack([alpha, alpha, 1.0 + 0.0 * alpha])
    h /= np.linalg.norm(h, axis=0)
    between = np.clip(sine * h[0] + cosine * h[2], 0.0, 1.0)
    out = 2.0 * between * h[2] - cosine

    def stretch(c: Array) -> Array:
        return 0.5 * (np.sqrt(1.0 + alpha**2 * (1.0 / np.maximum(c, 1e-6) ** 2 - 1.0)) - 1.0)

    shadowed = np.where(out > 0.0, (1.0 + stretch(cosine)) / (1.0 + stretch(cosine) + stretch(out)), 0.0)
    grazing = (1.0 - between) ** 5
    return between, shadowed, np.stack([(shadowed * part).mean(axis=-1) for part in (1.0 - grazing, grazing)])


def albedo_of(eta: float) -> Array:
    """(NODES, NODES, 4) `lobe_albedo` of an index of refraction, between those of its steps, and 0."""
    place = min((eta - 1.0) / (eta + 1.0), MOST) * STEPS
    step = min(int(place), STEPS - 1)
    low, high = lobe_albedo(step), lobe_albedo(step + 1)
    between = low + (place - step) * (high - low)
    return np.concatenate([between, 0.0 * between[:1]]).transpose(1, 2, 0)


def for_mitsuba(part: Mapping[str, Any]) -> Mapping[str, Any]:
    """A part of a scene as Mitsuba gets it.

    Our BSDF comes without `twosided`, which would have it in a kernel twice, or as its stand-in.  Mitsuba's matt one,
    both sides alike, becomes one of ours.  Any other part stays as it is.
    """
    if backend.is_scalar():
        return stand_in(part) if part.get("type") == TYPE else part
    inside = part.get("bsdf")
    if part.get("type") != "twosided" or not isinstance(inside, Mapping):
        return part
    if inside["type"] == "diffuse" and "reflectance" in inside:
        return {"type": TYPE, "base_color": inside["reflectance"]}
    return inside if inside["type"] == TYPE else part


def kind_of(part: Mapping[str, Any]) -> tuple[Any, ...] | None:
    """What surfaces that can be drawn together have in common; None of one that must be drawn by itself."""
    part = for_mitsuba(part)
    if part.get("type") != TYPE or "specular" in part or any(isinstance(part.get(name), Mapping) for name in _INPUTS):
        return None
    colour = part["base_color"]
    repeats = colour["type"] == "bitmap" and colour.get("wrap_mode", "repeat") == "repeat" and "to_uv" not in colour
    if colour["type"] != "rgb" and not repeats:
        return None
    return TYPE, colour["type"], part.get("eta", 1.5), *(name for name in _INPUTS if name in part)


def together(parts: Sequence[Mapping[str, Any]], number: Indices) -> dict[str, Any]:
    """Surfaces of one `kind_of` as one, for a mesh of its own.

    Args:
        parts: the surfaces.
        number: (F,) which of them each face of the mesh has.
    """
    surfaces, rows = list(map(for_mitsuba, parts)), np.zeros((len(parts), _ROW), dtype=np.float32)
    pictures = [surface["base_color"] for surface in surfaces if surface["base_color"]["type"] == "bitmap"]
    for row, surface in zip(rows, surfaces, strict=True):
        colour = surface["base_color"]
        row[: 2 if pictures else 3] = colour["bitmap"].shape[1::-1] if pictures else colour["value"]
        row[3 : 3 + len(_INPUTS)] = [surface.get(name, 0.0) for name in _INPUTS]
    first = surfaces[0]
    common = {name: value for name, value in first.items() if name in ("type", "eta") or name in _INPUTS}
    row_of_face = np.zeros(max(len(number), 4), dtype=np.uint32)  # of three numbers Mitsuba would make a colour
    row_of_face[: len(number)] = number
    joined = {**common, "base_color": first["base_color"], "rows": rows, "row_of_face": row_of_face}
    if not pictures:
        return joined
    distinct = {(id(colour["bitmap"]), bool(colour.get("raw", False))): colour for colour in pictures}
    ends = np.cumsum([np.prod(colour["bitmap"].shape[:2]) for colour in distinct.values()], dtype=np.uint32)
    begin_of = dict(zip(distinct, (0, *ends), strict=False))
    begin = np.zeros(max(len(pictures), 4), dtype=np.uint32)
    begin[: len(pictures)] = [begin_of[id(colour["bitmap"]), bool(colour.get("raw", False))] for colour in pictures]
    grey = {"type": "rgb", "value": [0.5] * 3}  # Mitsuba wants a colour, and never reads it
    return {
        **joined,
        "base_color": grey,
        "begin_of_row": begin,
        "texels": np.concatenate(list(map(_packed, distinct.values()))),
    }


def _packed(colour: Mapping[str, Any]) -> Indices:
    """(2 N,) texels of a picture, row by row from the top, as `_FULL` has them: two in 32 bits, the first below."""
    pixels = np.asarray(colour["bitmap"])
    pixels = pixels if pixels.ndim == 3 else pixels[:, :, None]
    if pixels.dtype == np.uint8:  # in few values, which are looked up
        roots = np.sqrt(texels({**colour, "bitmap": np.arange(256, dtype=np.uint8).reshape(1, 256, 1)}))[0, :, 0]
        codes = np.rint(roots * _FULL).astype(np.uint16)[pixels]
    else:
        codes = np.rint(np.sqrt(np.clip(pixels, 0.0, 1.0)) * np.float32(_FULL)).astype(np.uint16)
    packed = np.zeros((*codes.shape[:2], 4), dtype="<u2")
    packed[..., :3] = codes[..., :3] if codes.shape[2] >= 3 else codes[..., :1]
    return packed.reshape(-1, 4).view("<u4").ravel()


def blur(spread: Float, number: UInt32, most: Float) -> Float:
    """How much of what a path is spread already widens what it shows in a mirror: less of it the more paths a pixel
    has, so that its mean ends at the truth; slowly, so that spikes stay rare.  Kaplanyan and Dachsbacher 2013, "Path
    space regularization"; the power, -1/6, is a choice.

    Args:
        spread: roughness of a lobe that would spread directions as much as the path's vertices before have done; 0
            where the eye or a mirror sees it.
        number: of the path among those of its pixel, from 0 on.
        most: what the first of them is blurred at most [rad]; 0 for no blur.
    """
    return dr.minimum(spread, most * dr.rsqrt(dr.cbrt(backend.mitsuba().Float(number) + 1.0)))


def seen_from(si: SurfaceInteraction3f, spread: Float) -> SurfaceInteraction3f:
    """A point of a surface as a path sees it whose vertices before have spread its directions; it stays as it is.

    Its lobes are as wide at least as the path is spread: what an eye sees in a mirror by way of fog or a rough surface
    is blurred already, so as much again changes little.  The widened lobe reflects as much in all.

    Args:
        si: the point.
        spread: of `blur`.
    """
    return _widened(si, spread)


def lit_from(si: SurfaceInteraction3f, lamp: Point3f, is_point: Bool, spread: Float) -> SurfaceInteraction3f:
    """The same as it answers a lamp: where that is a point, its lobes are as wide at least as glass of LENS_M looks
    from there, too.

    A sharp lobe shows a point at 10^4 times the luminance of any glass, to very few paths.

    Args:
        si, spread: as in `seen_from`.
        lamp: where the lamp is.
        is_point: whether it is one; faces are drawn as they are.
    """
    lens = 0.5 * LENS_M / dr.maximum(dr.norm(lamp - si.p), LENS_M)
    return _widened(si, dr.select(is_point, dr.maximum(lens, spread), spread))


def _widened(si: SurfaceInteraction3f, width: Float) -> SurfaceInteraction3f:
    widened = type(si)(si)
    widened.duv_dx = backend.mitsuba().Vector2f(width, 0.0)
    return widened


def for_lamps(si: SurfaceInteraction3f) -> SurfaceInteraction3f:
    """A point of a surface as it draws directions in which images of lamps may be seen: by its lobes alone, and mostly
    by its coat; the point stays as it is.
    """
    marked = type(si)(si)
    marked.duv_dy = backend.mitsuba().Vector2f(1.0, 0.0)
    return marked


def stand_in(part: Mapping[str, Any]) -> dict[str, Any]:
    """Mitsuba's `principled`, for the variant that would ask Python for each ray: with Disney's glow, a quarter of the
    coat, and grey reflections.
    """
    principled = {name: value for name, value in part.items() if name not in ("specular", "clearcoat_roughness")}
    if "specular" in part:
        f0 = min(float(np.mean(mean_colour(part["specular"]))), 0.99)
        principled["eta"] = max((1.0 + f0**0.5) / (1.0 - f0**0.5), 1.001)
    if "clearcoat" in part:
        rough = part["clearcoat_roughness"]
        principled["clearcoat_gloss"] = 1.0 - (float(np.mean(texels(rough))) if isinstance(rough, Mapping) else rough)
    return principled | {"type": "principled"}


class _Inputs:
    """Textures of a surface, and the numbers of all surfaces that are drawn as one with it; None for what it lacks."""

    def __init__(self, properties: Properties) -> None:
        mi = backend.mitsuba()

        def texture(name: str) -> Any:
            return properties.get_texture(name) if name in properties else None

        self.base_color, self.roughness = texture("base_color"), texture("roughness")
        self.metallic, self.specular = texture("metallic"), texture("specular")
        self.coat, self.coat_roughness = texture("clearcoat"), texture("clearcoat_roughness")
        arrays: Sequence[Any] = [
            properties.get(name, None) for name in ("rows", "row_of_face", "begin_of_row", "texels")
        ]
        self.rows, self.row_of_face, self.begin_of_row, self.texels = arrays
        eta: Any = properties.get("eta", 1.5)
        self.eta, self.table = dr.opaque(mi.Float, float(eta)), _albedo_table(mi.variant(), float(eta))


@functools.lru_cache(maxsize=64)
def _albedo_table(variant: str, eta: float) -> Float:
    """`albedo_of` a refractive index as an array of Mitsuba's `variant`, which is the current one."""
    albedo = backend.floats(albedo_of(eta).ravel())
    dr.make_opaque(albedo)
    return albedo


class _PreviewSurface:
    """The BSDF of the head of this file; `register` derives it from the variant's own."""

    def __init__(self, properties: Properties) -> None:
        mi = backend.mitsuba()
        mi.BSDF.__init__(self, properties)
        self.inputs = _Inputs(properties)
        sides = mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
        self.m_components = [mi.BSDFFlags.DiffuseReflection | sides]
        if self.inputs.roughness is not None:
            self.m_components.append(mi.BSDFFlags.GlossyReflection | sides)
        self.m_flags = functools.reduce(operator.or_, self.m_components)

    def sample(
        self,
        ctx: BSDFContext,
        si: SurfaceInteraction3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool = True,
    ) -> tuple[BSDFSample3f, Color3f]:
        return self._sampled(_Response(self.inputs, si, active), si, sample1, sample2, active)

    def eval(self, ctx: BSDFContext, si: SurfaceInteraction3f, wo: Vector3f, active: Bool | bool = True) -> Color3f:
        return _Response(self.inputs, si, active).reflected(wo, active)[0]

    def pdf(self, ctx: BSDFContext, si: SurfaceInteraction3f, wo: Vector3f, active: Bool | bool = True) -> Float:
        return _Response(self.inputs, si, active).reflected(wo, active)[1]

    def eval_pdf(
        self, ctx: BSDFContext, si: SurfaceInteraction3f, wo: Vector3f, active: Bool | bool = True
    ) -> tuple[Color3f, Float]:
        return _Response(self.inputs, si, active).reflected(wo, active)

    def eval_pdf_sample(
        self,
        ctx: BSDFContext,
        si: SurfaceInteraction3f,
        wo: Vector3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool = True,
    ) -> tuple[Color3f, Float, BSDFSample3f, Color3f]:
        parts = _Response(self.inputs, si, active)
        return *parts.reflected(wo, active), *self._sampled(parts, si, sample1, sample2, active)

    def eval_diffuse_reflectance(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        return _values(self.inputs, si, active)[0]

    def _sampled(
        self, parts: _Response, si: SurfaceInteraction3f, sample1: Float, sample2: Point2f, active: Bool | bool
    ) -> tuple[BSDFSample3f, Color3f]:
        mi = backend.mitsuba()
        wo = parts.direction(sample1, sample2)
        value, pdf = parts.reflected(wo, active)
        sampled = dr.zeros(mi.BSDFSample3f)
        sampled.wo, sampled.pdf, sampled.eta = wo, pdf, 1.0
        sampled.sampled_type = mi.UInt32(+self.m_components[-1])
        sampled.sampled_component = mi.UInt32(len(self.m_components) - 1)
        good = active & (pdf > 0.0)
        return sampled, dr.select(good, value / pdf, 0.0)

    def traverse(self, callback: TraversalCallback) -> None:
        for name in ("base_color", "roughness", "metallic", "coat", "coat_roughness", "specular"):
            if getattr(self.inputs, name) is not None:
                callback.put(name, getattr(self.inputs, name), backend.mitsuba().ParamFlags.Differentiable)

    def to_string(self) -> str:
        return f"PreviewSurface[{self.inputs.base_color}]"


def _values(inputs: _Inputs, si: SurfaceInteraction3f, active: Bool | bool) -> tuple[Any, ...]:
    """Colour, roughness, metal, coat and its roughness at a point; those that are not there mean nothing."""
    mi = backend.mitsuba()
    if inputs.rows is not None:
        row = dr.gather(mi.UInt32, inputs.row_of_face, si.prim_index, active)
        low, high = (dr.gather(mi.Vector4f, inputs.rows, row * (_ROW // 4) + half, active) for half in (0, 1))
        colour = mi.Color3f(low.x, low.y, low.z)
        if inputs.texels is not None:
            begin = dr.gather(mi.UInt32, inputs.begin_of_row, row, active)
            colour = _pictured(inputs.texels, si.uv, begin, mi.Vector2f(low.x, low.y), active)
        return colour, low.w, high.x, high.y, high.z
    textures = inputs.roughness, inputs.metallic, inputs.coat, inputs.coat_roughness
    return inputs.base_color.eval(si, active), *(texture and texture.eval_1(si, active) for texture in textures)


def _pictured(texels: UInt32, uv: Point2f, begin: UInt32, size: Vector2f, active: Bool | bool) -> Color3f:
    """Colour of a picture that begins at a texel, repeats, and is linear between the middles of its texels."""
    mi = backend.mitsuba()
    place = mi.Vector2f(uv - dr.floor(uv)) * size - 0.5
    low = dr.floor(place)
    share, high = place - low, low + 1.0
    last, width = mi.Vector2u(size - 1.0), mi.UInt32(size.x)
    low, high = dr.select(low < 0.0, size - 1.0, low), dr.select(high < size, high, 0.0)
    low, high = (dr.minimum(mi.Vector2u(side), last) for side in (low, high))  # where uv are no numbers, too

    def texel(x: UInt32, y: UInt32) -> Color3f:
        pair = dr.gather(mi.Vector2u, texels, begin + y * width + x, active)
        roots = mi.Color3f(mi.Float(pair.x & 0xFFFF), mi.Float(pair.x >> 16), mi.Float(pair.y)) / _FULL
        return roots * roots

    upper, lower = (dr.lerp(texel(low.x, y), texel(high.x, y), share.x) for y in (low.y, high.y))
    return dr.lerp(upper, lower, share.y)


class _Response:
    """What a surface does to light that goes to `si.wi`, mirrored to the upper side; with lobes as wide as
    `seen_from` and `lit_from` have them, that reflect as much in all as they would else.
    """

    def __init__(self, inputs: _Inputs, si: SurfaceInteraction3f, active: Bool | bool) -> None:
        mi = backend.mitsuba()
        normal = si.to_local(mi.Vector3f(si.n))
        self.below = dr.dot(si.wi, normal) * normal.z < 0.0
        self.wi = mi.Vector3f(si.wi.x, si.wi.y, dr.abs(si.wi.z))
        self.base, roughness, metal, coat, coat_roughness = _values(inputs, si, active)
        self.matt = inputs.roughness is None
        if self.matt:
            return
        self.eta, self.table = inputs.eta, inputs.table
        self.blur = si.duv_dx.x
        self.alpha, albedo, self.kept = self.lobe(roughness)
        self.specular, reflects = None, mi.Color3f(albedo.z)
        if inputs.specular is not None:
            self.specular = mi.Color3f(inputs.specular.eval(si, active))
            reflects = self.specular * albedo.x + albedo.y
        self.matte, self.gloss, self.metal, self.coat = 1.0 - reflects, mi.Float(1.0), None, None
        lobes = reflects.x if inputs.specular is None else backend.channel_mean(reflects)
        for_lamps = si.duv_dy.x  # 1 where `for_lamps` was here, 0 elsewhere
        under = (1.0 - lobes) * MATTE * (1.0 - for_lamps)
        if inputs.metallic is not None:
            self.metal = metal
            self.gloss = 1.0 - self.metal
            self.matte *= self.gloss
            lobes = lobes * self.gloss + self.metal * (albedo.x + albedo.y)
            under *= self.gloss
        self.chance_matte = under / dr.maximum(under + lobes, 1e-8)
        if inputs.coat is not None:
            self.coat = coat
            self.coat_alpha, coated, self.coat_kept = self.lobe(coat_roughness)
            reflected = self.coat * coated.z
            self.left = 1.0 - reflected
            often = reflected * (1.0 + (COAT - 1.0) * for_lamps)
            self.chance_coat = often / dr.maximum(often + self.left * (under + lobes), 1e-8)

    def lobe(self, roughness: Float) -> tuple[Float, Vector4f, tuple[Float, Float]]:
        """Width of a lobe, the shares of `lobe_albedo`, and what it reflects over what it would at this width: as
        metal and as a dielectric.
        """
        albedo, alpha = self.albedo(roughness), dr.maximum(roughness * roughness, MIN_ALPHA)
        wide = dr.sqrt(alpha * alpha + self.blur * self.blur)
        all_of_it = self.albedo(dr.sqrt(wide))
        pairs = (albedo.x + albedo.y, all_of_it.x + all_of_it.y), (albedo.z, all_of_it.z)
        metal, dielectric = (dr.select(self.blur > 0.0, sharp / dr.maximum(wider, 1e-6), 1.0) for sharp, wider in pairs)
        return wide, albedo, (metal, dielectric)

    def albedo(self, roughness: Float) -> Vector4f:
        """`lobe_albedo` of the surface's index, for light to the eye."""
        mi = backend.mitsuba()
        x = dr.clip(dr.sqrt(self.wi.z), 0.0, 1.0) * (NODES - 1)
        y = dr.clip(roughness, 0.0, 1.0) * (NODES - 1)
        row, column = dr.minimum(mi.UInt32(x), NODES - 2), dr.minimum(mi.UInt32(y), NODES - 2)
        begin, x, y = row * NODES + column, x - mi.Float(row), y - mi.Float(column)
        corners = [dr.gather(mi.Vector4f, self.table, begin + step) for step in (0, 1, NODES, NODES + 1)]
        return dr.lerp(dr.lerp(corners[0], corners[1], y), dr.lerp(corners[2], corners[3], y), x)

    def reflected(self, wo: Vector3f, active: Bool | bool) -> tuple[Color3f, Float]:
        """Value of the BSDF times the cosine, and the density with which `direction` draws it."""
        mi = backend.mitsuba()
        wi, wo = self.wi, mi.Vector3f(wo.x, wo.y, dr.select(self.below, -wo.z, wo.z))
        good = active & (wi.z > 0.0) & (wo.z > 0.0)
        matte = dr.maximum(wo.z, 0.0) * dr.inv_pi
        if self.matt:
            return dr.select(good, self.base * matte, 0.0), dr.select(good, matte, 0.0)
        h = dr.normalize(wi + wo)
        dielectric = mi.fresnel(dr.dot(wi, h), self.eta)[0]
        tint = mi.Color3f(dielectric * self.kept[1])
        if self.specular is not None:
            grazing = dr.power(dr.maximum(1.0 - dr.dot(wi, h), 0.0), 5)
            tint = (self.specular + (1.0 - self.specular) * grazing) * self.kept[0]
        gloss, density = _ggx(wi, wo, h, self.alpha)
        value = tint * (gloss * self.gloss) + self.matte * self.base * matte
        if self.metal is not None:
            value += self.metal * self.base * (gloss * self.kept[0])
        pdf = dr.lerp(density, matte, self.chance_matte)
        if self.coat is not None:
            shine, sharp = _ggx(wi, wo, h, self.coat_alpha)
            value = value * self.left + self.coat * (dielectric * shine * self.coat_kept[1])
            pdf = dr.lerp(pdf, sharp, self.chance_coat)
        return dr.select(good, value, 0.0), dr.select(good, pdf, 0.0)

    def direction(self, sample1: Float, sample2: Point2f) -> Vector3f:
        """A direction by the matte part or by one of the lobes."""
        mi = backend.mitsuba()
        wo = mi.warp.square_to_cosine_hemisphere(sample2)
        if not self.matt:
            wo = dr.select(*self.mirrored(sample1, sample2), wo)
        return mi.Vector3f(wo.x, wo.y, dr.select(self.below, -wo.z, wo.z))

    def mirrored(self, sample1: Float, sample2: Point2f) -> tuple[Bool, Vector3f]:
        """Whether a lobe was chosen, and the direction that it sends."""
        alpha, coated = self.alpha, False
        if self.coat is not None:
            coated = sample1 < self.chance_coat
            alpha = dr.select(coated, self.coat_alpha, alpha)
            sample1 = (sample1 - self.chance_coat) / dr.maximum(1.0 - self.chance_coat, 1e-8)
        return coated | (sample1 >= self.chance_matte), _mirrored(self.wi, alpha, sample2)


def _ggx(wi: Vector3f, wo: Vector3f, h: Vector3f, alpha: Float) -> tuple[Float, Float]:
    """A lobe that reflects all, times the cosine, and the density with which `_mirrored` draws it.

    Walter et al. 2007; masking and shadowing by height (Heitz 2014).
    """
    squared = alpha * alpha
    spread = h.z * h.z * (squared - 1.0) + 1.0
    normals = squared / (dr.pi * spread * spread)
    hidden_in, hidden_out = (0.5 * (dr.sqrt(1.0 + squared * (dr.rcp(w.z * w.z) - 1.0)) - 1.0) for w in (wi, wo))
    even = normals / (4.0 * wi.z)
    return even / (1.0 + hidden_in + hidden_out), even / (1.0 + hidden_in)


def _mirrored(wi: Vector3f, alpha: Float, sample: Point2f) -> Vector3f:
    """`wi` mirrored at a visible normal of GGX (Dupuy and Benyoub 2023, spherical caps)."""
    mi = backend.mitsuba()
    stretched = dr.normalize(mi.Vector3f(alpha * wi.x, alpha * wi.y, wi.z))
    sin_phi, cos_phi = dr.sincos(2.0 * dr.pi * sample.x)
    z = (1.0 - sample.y) * (1.0 + stretched.z) - stretched.z
    ring = dr.safe_sqrt(1.0 - z * z)
    cap = mi.Vector3f(ring * cos_phi, ring * sin_phi, z) + stretched
    h = dr.normalize(mi.Vector3f(alpha * cap.x, alpha * cap.y, cap.z))
    return 2.0 * dr.dot(wi, h) * h - wi
