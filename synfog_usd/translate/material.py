"""Materials: UsdPreviewSurface, and the constants of a few others, as BSDFs.

Takes bound materials; gives one 'mat_*' entry per material, what it emits and
which texture coordinates it reads.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from pxr import Gf, Sdf, Tf, Usd, UsdShade

from synfog_usd.base.arrays import Array
from synfog_usd.base.colour import LUMINANCE
from synfog_usd.scene import mean_colour
from synfog_usd.translate import spectrum
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.finite import ROUNDED, tell_inputs
from synfog_usd.translate.misfits import tell_misfits
from synfog_usd.translate.native import (
    FIRST_SQUARE,
    VERTEX_COLOR,
    RefusedError,
    is_surface,
    is_textured,
    native,
    reads_vertices,
)
from synfog_usd.translate.networks import fed_by, omni_texture
from synfog_usd.translate.nodes import READERS
from synfog_usd.translate.primvars import Given
from synfog_usd.translate.shading import (
    GREY,
    MATERIALX,
    OMNI_PBR,
    OMNI_SURFACE,
    OMNI_SURFACES,
    PREVIEW,
    InputNames,
)
from synfog_usd.translate.texture import (
    ImageReader,
    TextureNode,
    UvSource,
    fitted,
    linear,
    normals,
    numbers_in,
    producer,
    sampled,
    shader_id,
    value_of,
)
from synfog_usd.translate.wrap import MODES

DISPLAY = "displayColor"
"""The primvar of a shape's own colours."""

_MIN_IOR, _UNUSUAL_IOR = 1.001, 10.0
_CUT_OUT = 0.1
"""Alpha of a card's picture below which nothing is drawn.  Source: OpenUSD's imaging of draw modes."""

_UNREADABLE = (ArithmeticError, TypeError, ValueError, LookupError, AttributeError)
"""What an opinion raises that no shader can mean; the rest of the stage is drawn all the same."""

_EARLIEST = Usd.TimeCode.EarliestTime()

_PLAIN = (type(None), bool, int, float, str, Gf.Vec2f, Gf.Vec3f, Gf.Vec4f, Gf.Vec3d)
"""Values that are equal where they mean the same."""

_OF_EVERY_SURFACE = frozenset({"type", "base_color", "roughness", "eta"})
"""What a surface has that is neither metal nor coated; where it reflects nothing, it is Lambert's."""


@dataclass(frozen=True)
class Finish:
    """What a material gives to the shapes that wear it.

    Attributes:
        key: its BSDF in the scene.
        emission: Mitsuba radiance [cd m-2] as 'rgb' or 'bitmap', or None.
        emission_nits: luminance of the emission, averaged.
        uv: texture coordinates that it reads, or None.
        plain: key of the same material for shapes without such coordinates, or None.
        colored: whether it reads the vertices' 'vertex_color'.
        reads: the primvar that this is.
        fallback: what it is for shapes without that primvar, where the material says so.
        unsaid: whether its textures are black beyond their square because no wrap mode is authored.
        empty: whether the material has no output at all, as Blender writes volumes.
        unknown: whether its surface is not known, so that its shapes are drawn as if they had none.
    """

    key: str
    emission: dict[str, Any] | None = None
    emission_nits: float = 0.0
    uv: UvSource | None = None
    plain: str | None = None
    colored: bool = False
    reads: str = DISPLAY
    fallback: tuple[float, float, float] | None = None
    unsaid: bool = False
    empty: bool = False
    unknown: bool = False


Look: TypeAlias = Callable[[str], Given | None]
"""From the name of a primvar to what it gives to a shape."""

Refusal: TypeAlias = Callable[[Mapping[str, Any]], str]
"""Why the renderer does not draw a BSDF; '' where it does."""


@dataclass(frozen=True)
class Asked:
    """A primvar that a material reads.

    Attributes:
        name: of the primvar.
        input: what it goes to.
        colour: whether it has to be a colour, or else a number.
        needed: whether its reader has no fallback for a shape without it.
    """

    name: str
    input: str
    colour: bool
    needed: bool


class Materials:
    """All materials of a scene, each made once.

    Args:
        refusal: what a renderer says to Mitsuba's own materials; None believes them.

    Attributes:
        bsdfs: 'mat_*' -> BSDF, in the order in which they were made.
        reflectance_of: 'mat_*' -> spectrum, of those that have one; see `SceneDict`.
    """

    def __init__(
        self, time: Usd.TimeCode, notes: Diagnostics, images: ImageReader, refusal: Refusal | None = None
    ) -> None:
        self.time, self.notes, self.images, self.refusal = time, notes, images, refusal
        self.bsdfs: dict[str, dict[str, Any]] = {}
        self.reflectance_of: dict[str, Array] = {}
        self._asked: dict[Any, dict[Asked, None]] = {}
        self._by_path: dict[tuple[str, tuple[Given | None, ...]], Finish] = {}
        self._by_said: dict[tuple[Any, ...], Finish] = {}
        self._known_said: dict[str, tuple[Any, ...] | None] = {}
        self._by_word: dict[str, str] = {}
        self._by_color: dict[tuple[Any, ...], str] = {}

    def finish(self, material: UsdShade.Material, look: Look = lambda _: None, shape: str = "") -> Finish:
        """The finish of a USD material on a shape.

        Args:
            look: at the shape's primvars.
            shape: its path, for notes.
        """
        path = str(material.GetPath())
        if path not in self._known_said:
            self._known_said[path] = self._said(material.GetPrim())
        said = self._known_said[path]
        asked = self._asked.setdefault(path if said is None else said, {})
        given = tuple(look(one.name) for one in asked)
        if (path, given) not in self._by_path:
            told = self.notes.told
            made = self._by_said.get((said, given)) if said is not None else None
            if made is None:
                tell_inputs(material.GetPrim(), self.time, self.notes)
                tell_misfits(material.GetPrim(), self.time, self.notes)
                try:
                    made = self._measured(material, self._made(material, look, asked))
                except (
                    Tf.ErrorException,
                    ArithmeticError,
                    TypeError,
                    ValueError,
                    LookupError,
                    AttributeError,
                ) as problem:
                    reason = str(problem).strip().splitlines()[-1:] or [type(problem).__name__]
                    self.notes.warn(path, f"cannot be read ({reason[0][:120]}); its shapes take displayColor or grey")
                    made = replace(self.colored(GREY), unknown=True)
                given = tuple(look(one.name) for one in asked)
                if said is not None and self.notes.told == told:  # notes name the material
                    self._by_said[said, given] = made
            self._by_path[path, given] = made
        self._tell(asked, given, shape)
        return self._by_path[path, given]

    def _tell(self, asked: Mapping[Asked, None], given: tuple[Given | None, ...], shape: str) -> None:
        """What a shape's primvars cannot give to its material."""
        for one, value in zip(asked, given, strict=True):
            if value is None:
                if one.needed and one.name != DISPLAY:
                    self.notes.warn(
                        shape, f"has no value of primvar {one.name}, and the reader of {one.input} no fallback"
                    )
                continue
            fits = (value.colour if one.colour else value.number) is not None
            if not fits:
                kind = "colour" if one.colour else "number"
                self.notes.warn(
                    shape, f"primvar {one.name} {value.what}, and is no {kind}; {one.input} takes the reader's fallback"
                )
            elif value.varies and one.input != "diffuseColor":
                self.notes.warn(
                    shape, f"primvar {one.name!r} varies over it; {one.input}, which reads that, is drawn as its mean"
                )
            elif not one.colour and len(value.value) > 1:
                self.notes.info(shape, f"primvar {one.name} {value.what}; {one.input} takes their mean")

    def _said(self, material: Usd.Prim) -> tuple[Any, ...] | None:
        """All that stands on a material and below it, by which instances of a model are known to wear the same; None
        where something stands elsewhere, or is more than a few numbers, a word or a file.
        """
        path, found = str(material.GetPath()), list[Any]()
        for prim in Usd.PrimRange(material):
            found.append((str(prim.GetPath())[len(path) :], prim.GetTypeName()))
            for attribute in prim.GetAuthoredAttributes():
                value = attribute.Get(self.time)
                if value is None:  # as `value_of` has it
                    value = attribute.Get(_EARLIEST)
                said: tuple[Any, ...] = (attribute.GetName(), type(value), value)
                if isinstance(value, Sdf.AssetPath):
                    if "<UDIM>" in value.path:
                        return None
                    said = (*said[:2], value.path, value.resolvedPath, attribute.GetColorSpace())
                elif not isinstance(value, _PLAIN):
                    return None
                if attribute.HasAuthoredConnections():
                    sources = [str(source) for source in attribute.GetConnections()]
                    if not all(source.startswith(f"{path}/") for source in sources):
                        return None
                    said += tuple(source[len(path) :] for source in sources)
                found.append(said)
        return tuple(found)

    def _measured(self, material: UsdShade.Material, made: Finish) -> Finish:
        """The finish with the reflectance spectrum that stands on its material, or as it is."""
        curve = spectrum.reflectance(material.GetPrim(), self.bsdfs[made.key], self.time, self.notes, self._mean)
        if curve is None:
            return made
        key = self._add(self.bsdfs[made.key], curve)
        return replace(
            made, key=key, plain=self._add(self.bsdfs[made.plain], curve) if made.plain is not None else None
        )

    def _mean(self, colour: Mapping[str, Any]) -> tuple[float, float, float]:
        """`mean_colour`, of a picture once."""
        if colour["type"] == "rgb":
            return mean_colour(colour)
        mean: tuple[float, float, float] = self.images.once(_mean_of, colour["bitmap"], bool(colour.get("raw", False)))
        return mean

    def colored(self, color: tuple[float, ...], opacity: float = 1.0) -> Finish:
        """A matte finish of one colour, for shapes without a material."""
        known = self._by_color.get((*color, opacity))
        if known is not None:
            return Finish(known)
        value = [min(max(float(c), 0.0), 1.0) for c in color]
        return self._matte((*color, opacity), _rgb(value), opacity)

    def vertex_colored(self, opacity: float = 1.0) -> Finish:
        """A matte finish that takes its colour from the vertices."""
        return replace(self._matte(("vertex", opacity), dict(_VERTEX_COLOR), opacity), colored=True)

    def _matte(self, key: tuple[Any, ...], reflectance: dict[str, Any], opacity: float) -> Finish:
        if key not in self._by_color:
            bsdf: dict[str, Any] = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}
            self._by_color[key] = self._add(
                bsdf if opacity >= 1.0 else {"type": "mask", "opacity": opacity, "bsdf": bsdf}
            )
        return Finish(self._by_color[key])

    def card(self, picture: str, path: str, color: tuple[float, float, float]) -> Finish:
        """A matte finish with a picture, cut out where its alpha is below a tenth; of one colour where it has none."""
        if not picture:
            return self.colored(color)
        node = TextureNode(
            path, picture, picture, "rgb", "auto", "clamp", (1.0,) * 4, (0.0,) * 4, (*color, 1.0), UvSource("st")
        )
        seen = sampled(node, self.images, channels=3)
        cut = sampled(replace(node, channel="a"), self.images, channels=1)
        if isinstance(seen, tuple):
            reflectance = _rgb([min(max(float(c), 0.0), 1.0) for c in seen])
        else:
            reflectance = {"type": "bitmap", "bitmap": _limited(seen), "raw": False, "wrap_mode": "clamp"}
        bsdf: dict[str, Any] = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}
        if not isinstance(cut, tuple) and (cut < _CUT_OUT).any():
            shape = (cut >= _CUT_OUT).astype(np.float32)
            opacity = {"type": "bitmap", "bitmap": shape, "raw": True, "wrap_mode": "clamp"}
            bsdf = {"type": "mask", "opacity": opacity, "bsdf": bsdf}
        return Finish(self._add(bsdf), uv=None if isinstance(seen, tuple) and isinstance(cut, tuple) else node.uv)

    def black(self) -> Finish:
        """A finish that reflects nothing, for the faces of lamps."""
        if ("black",) not in self._by_color:
            self._by_color["black",] = self._add({"type": "diffuse", "reflectance": _rgb([0.0, 0.0, 0.0])})
        return Finish(self._by_color["black",])

    def _add(self, bsdf: dict[str, Any], curve: Array | None = None) -> str:
        """Key of a BSDF and its spectrum; equal ones that are there already are used again."""
        word = repr(self._told(bsdf) if curve is None else (self._told(bsdf), self._told(curve)))
        if word not in self._by_word:
            self._by_word[word] = f"mat_{len(self.bsdfs)}"
            self.bsdfs[self._by_word[word]] = bsdf
            if curve is not None:
                self.reflectance_of[self._by_word[word]] = curve
        return self._by_word[word]

    def _told(self, part: Any) -> Any:
        """A BSDF in words, with pictures by their content: equal words, equal BSDFs."""
        if isinstance(part, dict):
            return {name: self._told(value) for name, value in part.items()}
        return self.images.once(_content, part) if isinstance(part, np.ndarray) else part

    def _made(self, material: UsdShade.Material, look: Look, asked: dict[Asked, None]) -> Finish:
        path = material.GetPath()
        own = material.ComputeSurfaceSource("mitsuba")[0]
        if own and shader_id(own.GetPrim()).startswith("mitsuba_"):
            try:
                return self._native(own)
            except RefusedError as error:
                self.notes.warn(path, f"outputs:mitsuba:surface is not drawn: {error}")
        sources = [material.ComputeSurfaceSource(context)[0] for context in _CONTEXTS]
        shader = next((source for source in sources if source), None)
        if not shader:
            empty = is_empty(material)
            if not empty:
                self.notes.warn(
                    path, "material's outputs lead to no shader that is known; its shapes take displayColor or grey"
                )
            return Finish(self.colored(GREY).key, empty=empty, unknown=not empty)
        kind = shader_id(shader.GetPrim())
        if kind == "UsdPreviewSurface" or kind.startswith("ND_UsdPreviewSurface"):
            return self._surface(shader, PREVIEW, path, look, asked)
        for beginning, names in MATERIALX.items():
            if kind.startswith(beginning):
                self.notes.info(
                    path,
                    f"{kind} is drawn by its base, roughness, metalness, specular, transmission, subsurface, coat, "
                    f"emission, opacity and normal map",
                )
                return self._surface(shader, names, path, look, asked)
        mdl = shader.GetPrim().GetAttribute("info:mdl:sourceAsset:subIdentifier")
        if mdl and str(mdl.Get()).startswith("OmniPBR"):
            self.notes.info(
                path,
                "OmniPBR is drawn by constants and textures of its base, roughness, metalness, specular level, "
                "opacity, emission and normals, and by constants of its clear coat",
            )
            if value_of(shader, "enable_clearcoat", self.time, False):
                if getattr(value_of(shader, "clearcoat_normalmap_texture", self.time), "path", ""):
                    self.notes.warn(path, "clearcoat_normalmap_texture is not drawn")
                if value_of(shader, "clearcoat_transparency", self.time, 1.0) != 1.0:
                    self.notes.warn(path, "clearcoat_transparency is drawn as 1")
            return self._surface(shader, OMNI_PBR, path, look, asked)
        if mdl and str(mdl.Get()).startswith("OmniGlass"):
            return self._glass(shader, path)
        if mdl and str(mdl.Get()) in OMNI_SURFACES:
            return self._omni_surface(shader, path, look, asked)
        self.notes.warn(
            path,
            f"shader {kind or (mdl and mdl.Get()) or 'of an unknown type'} is not known; its shapes take "
            f"displayColor or grey",
        )
        return replace(self.colored(GREY), unknown=True)

    def _native(self, shader: UsdShade.Shader) -> Finish:
        """One of Mitsuba's own materials.

        Raises:
            RefusedError: it is none that can be drawn.
        """
        bsdf = native(shader, self.time, self.images, self.notes)
        if not is_surface(bsdf):
            raise RefusedError(f"{shader.GetPath()}: {bsdf['type']} is a texture and no surface")
        colored = reads_vertices(bsdf)
        if self.refusal is not None and (why := self.refusal(bsdf)):
            raise RefusedError(f"{shader.GetPath()}: {why}")
        textured = is_textured(bsdf)
        return Finish(
            self._add(bsdf),
            uv=UvSource("st") if textured else None,
            plain=self._add(_without_textures(bsdf)) if textured else None,
            colored=colored,
        )

    def _omni_surface(self, shader: UsdShade.Shader, path: object, look: Look, asked: dict[Asked, None]) -> Finish:
        """An OmniSurface shader by its constants."""
        self.notes.info(
            path,
            "OmniSurface is drawn by constants of its base, roughness, metalness, specular, transmission, subsurface, "
            "coat, emission and opacity",
        )
        for name in sorted(one.GetBaseName() for one in shader.GetInputs()):
            if getattr(value_of(shader, name, self.time), "path", ""):
                self.notes.warn(path, f"{name} of OmniSurface is not drawn; its constant is")
        preset = "specular_reflection_ior_preset"
        if str(value_of(shader, preset, self.time, "ior_custom")) not in ("ior_custom", "99"):
            self.notes.warn(path, f"{preset} is not drawn; its specular_reflection_ior is")
        return self._surface(shader, OMNI_SURFACE, path, look, asked)

    def _glass(self, shader: UsdShade.Shader, path: object) -> Finish:
        """The glass of an OmniGlass shader: its index, colour, frosting and cutout."""

        def number(name: str, default: float) -> float:
            return float(value_of(shader, name, self.time, default))

        tint = tuple(float(c) for c in value_of(shader, "glass_color", self.time, (1.0, 1.0, 1.0)))
        thin = bool(value_of(shader, "thin_walled", self.time, False))
        made = _clear(number("glass_ior", 1.491), number("frosting_roughness", 0.0), tint, thin=thin)
        for name in ("glass_color_texture", "roughness_texture", "normal_map_texture", "cutout_opacity_texture"):
            if getattr(value_of(shader, name, self.time), "path", ""):
                self.notes.warn(path, f"{name} of OmniGlass is not drawn; its constant is")
        if value_of(shader, "enable_opacity", self.time, False) and (opacity := number("cutout_opacity", 1.0)) < 1.0:
            made = {"type": "mask", "opacity": max(opacity, 0.0), "bsdf": made}
        self.notes.info(path, f"OmniGlass is drawn as {'a thin pane' if thin else 'a solid that refracts'}")
        return Finish(self._add(made))

    def _surface(
        self, shader: UsdShade.Shader, names: InputNames, path: object, look: Look, asked: dict[Asked, None]
    ) -> Finish:
        inputs = _ShaderInputs(self, shader, names, look, asked)
        color = inputs.color("diffuseColor", names.color)
        roughness, metallic = inputs.number("roughness", names.roughness), inputs.number("metallic", names.metallic)
        solid = inputs.index("ior", 1.5)
        bsdf: dict[str, Any] = {"type": "preview_surface", "base_color": color, "roughness": roughness}
        if inputs.constant("useSpecularWorkflow", 0.0):
            bsdf["specular"] = inputs.color("specularColor", (0.0, 0.0, 0.0))
        elif metallic != 0.0:
            bsdf["metallic"] = metallic
        bsdf["eta"] = max(_reflecting(solid, self._specular(inputs, path)), _MIN_IOR)
        self._subsurface(bsdf, inputs, path)
        clearcoat = inputs.number("clearcoat", names.coat if inputs.has("clearcoat") else 0.0)
        if clearcoat != 0.0:
            coat_roughness = inputs.number("clearcoatRoughness", names.coat_roughness)
            bsdf |= {"clearcoat": clearcoat, "clearcoat_roughness": coat_roughness}
        clear = self._transmitting(bsdf, inputs, inputs.index("clearIor", solid), path)
        if clear is None and bsdf["eta"] <= _MIN_IOR and not bsdf.keys() - _OF_EVERY_SURFACE:
            bsdf = {"type": "diffuse", "reflectance": bsdf["base_color"]}
        bsdf = {"type": "twosided", "bsdf": self._bumped(bsdf, inputs, path)}
        if clear is not None:
            share, glass = clear
            glass = self._bumped(glass, inputs, path)
            bsdf = glass if share == 1.0 else {"type": "blendbsdf", "weight": share, "bsdf_0": bsdf, "bsdf_1": glass}
        opacity, straight = inputs.opacity(), inputs.lets_straight_through()
        if opacity is not None:
            bsdf = {"type": "mask", "opacity": opacity, "bsdf": bsdf}
            if not isinstance(opacity, dict) and straight:
                self.notes.info(
                    path,
                    f"opacity {opacity:.2f} lets light through straight and takes its share of the reflection too; no "
                    f"refraction",
                )
        emission, nits = inputs.emission()
        if inputs.has("displacement") and (inputs.producer("displacement") or inputs.constant("displacement", 0.0)):
            self.notes.warn(path, "displacement is not drawn")
        if inputs.has("normal") and not inputs.producer("normal"):
            normal = inputs.constant("normal", None)
            if isinstance(normal, (Gf.Vec3f, Gf.Vec3d)) and tuple(normal) not in ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)):
                self.notes.warn(path, "a normal without a picture is not drawn")
        for name in names.left_out:
            if np.any(value_of(shader, name, self.time, 0.0)) or producer(shader, name) is not None:
                self.notes.warn(path, f"{name} is not drawn")
        for name in names.white:
            value = value_of(shader, name, self.time, (1.0, 1.0, 1.0))
            if name == "clearcoat_tint" and clearcoat == 0.0:
                continue
            if any(float(c) != 1.0 for c in value) or producer(shader, name) is not None:
                self.notes.warn(path, f"{name} is drawn as white")
        key = self._add(bsdf)
        plain = self._add(_without_textures(bsdf)) if inputs.uv is not None else None
        return Finish(
            key, emission, nits, inputs.uv, plain, inputs.vertex_color, inputs.reads, inputs.fallback, inputs.unsaid
        )

    def _specular(self, inputs: _ShaderInputs, path: object) -> float:
        """By what the reflection at normal incidence is multiplied; a tint by its luminance."""
        tint = inputs.constant_color("specularTint", (1.0, 1.0, 1.0))
        if max(tint) - min(tint) > 1e-4:
            self.notes.warn(path, "the tint of its specular reflection is drawn as grey of the same luminance")
        grey = float(LUMINANCE @ tint) / float(LUMINANCE.sum())
        weight = float(inputs.constant("specularWeight", inputs.names.specular)) / inputs.names.specular
        return max(weight * (tint[0] if min(tint) == max(tint) else grey), 0.0)

    def _subsurface(self, bsdf: dict[str, Any], inputs: _ShaderInputs, path: object) -> None:
        """Light that goes below the surface as a matte share of its own colour."""
        share = min(max(float(inputs.constant("subsurface", 0.0)), 0.0), 1.0)
        if not share:
            return
        base = bsdf["base_color"]
        if base["type"] != "rgb":
            self.notes.warn(path, "subsurface scattering is drawn as the base colour, which is a picture")
            return
        below = inputs.constant_color("subsurfaceColor", inputs.names.below)
        bsdf["base_color"] = _rgb(
            [min(max((1.0 - share) * a + share * b, 0.0), 1.0) for a, b in zip(base["value"], below, strict=True)]
        )
        self.notes.info(path, "subsurface scattering is drawn as a matte surface of its colour")

    def _transmitting(
        self, bsdf: dict[str, Any], inputs: _ShaderInputs, ior: float, path: object
    ) -> tuple[Any, dict[str, Any]] | None:
        """The clear share of a surface and its glass, or None where it is opaque; metal lets nothing through."""
        share, metal = inputs.number("transmission", 0.0), bsdf.get("metallic", 0.0)
        if share == 0.0:
            return None
        if isinstance(metal, dict):
            self.notes.warn(path, "a picture of metalness is not drawn where the surface is transparent too")
        elif not isinstance(share, dict):
            share *= 1.0 - metal
            if share == 0.0:
                return None
        roughness = bsdf["roughness"] if inputs.names.clear_roughness is None else inputs.names.clear_roughness
        if isinstance(roughness, dict):
            self.notes.warn(path, "a picture of roughness is drawn as its mean where the surface is transparent")
            roughness = float(roughness["bitmap"].mean())
        tint = tuple(inputs.shares("transmissionColor", inputs.constant_color("transmissionColor", (1.0, 1.0, 1.0))))
        if float(inputs.constant("transmissionDepth", 0.0)) > 0.0:
            self.notes.info(path, "transmission_depth is not drawn: what passes two faces has the transmission colour")
            tint = tuple(max(float(c), 0.0) ** 0.5 for c in tint)
        thin = bool(inputs.constant("thin", False))
        if "thickness" in inputs.names.of:
            thin = not float(inputs.constant("thickness", 0.0)) > 0.0
        self.notes.info(path, f"transmission is drawn as {'a thin pane' if thin else 'a solid that refracts'}")
        return share, _clear(ior, roughness, tint, thin=thin)

    def _bumped(self, bsdf: dict[str, Any], inputs: _ShaderInputs, path: object) -> dict[str, Any]:
        node = inputs.texture("normal")
        if node is None or not (node.file or node.tiles):
            return bsdf
        scale, bias = np.asarray(node.scale[:3], dtype=np.float64), np.asarray(node.bias[:3], dtype=np.float64)
        untouched = np.allclose(np.abs(scale), 1.0) and np.allclose(bias, (scale < 0.0) * 1.0)
        if untouched:  # codes of 0 to 1, some turned about
            scale, bias = 2.0 * scale, -scale
        if not np.allclose(bias, -0.5 * scale) or not np.isclose(scale[2], 2.0) or not np.all(np.abs(scale) > 0.0):
            self.notes.warn(
                path,
                "normal map with an unusual scale and bias is left out; (2, 2, 2) and (-1, -1, -1) are known, red and "
                "green also turned or weaker",
            )
            return bsdf
        values = normals(node, self.images, scale, bias, untouched=bool(untouched))
        if values is None:
            return bsdf
        along_u, along_v = (
            "clamp" if mode == "black" else mode for mode in self.images.wraps(node)
        )  # no normal is black
        node = replace(node, wrap=along_u, wrap_v=along_v)
        return {"type": "normalmap", "normalmap": inputs.bitmap(values, node, raw=True), "bsdf": bsdf}


_CONTEXTS = ("", "mtlx", "mdl")
"""Renderers whose outputs are followed."""


def is_empty(material: UsdShade.Material) -> bool:
    """Whether a material has no surface at all, known or not."""
    outputs = [output for output in material.GetOutputs() if output.HasConnectedSource()]
    return all(output.GetBaseName() == "volume" for output in outputs) and not any(
        material.ComputeSurfaceSource(context)[0] for context in ("mitsuba", *_CONTEXTS)
    )


_VERTEX_COLOR = {"type": "mesh_attribute", "name": VERTEX_COLOR}


@dataclass(frozen=True)
class Read:
    """What a reader of a primvar gives.

    Attributes:
        name: of the primvar.
        given: by the shape, or else the reader's fallback; None where there is neither.
        fallback: of the reader.
    """

    name: str
    given: Given | None
    fallback: Given | None

    @property
    def colour(self) -> tuple[float, float, float] | None:
        """The colour that is given; None where none is."""
        return self.given.colour if self.given is not None else None


def _given(value: Any) -> Given | None:
    """A reader's fallback; None where it has none, or one that is no number."""
    try:
        numbers = np.asarray(value, dtype=np.float64).reshape(-1)
    except (ValueError, TypeError):
        return None
    return Given(tuple(numbers.tolist())) if value is not None and len(numbers) else None


class _ShaderInputs:
    """The inputs of one surface shader, and the one set of texture coordinates that they read."""

    def __init__(
        self, materials: Materials, shader: UsdShade.Shader, names: InputNames, look: Look, asked: dict[Asked, None]
    ) -> None:
        self.materials, self.shader, self.names, self.look, self.asked = materials, shader, names, look, asked
        self.time, self.notes, self.images = materials.time, materials.notes, materials.images
        self.uv: UvSource | None = None
        self.vertex_color = False
        self.reads = DISPLAY
        self.fallback: tuple[float, float, float] | None = None
        self.unsaid = False

    def has(self, name: str) -> bool:
        """Whether the shader has such an input, and it is not switched off."""
        switch = self.names.switches.get(name)
        return bool(self.names[name]) and (switch is None or bool(value_of(self.shader, switch, self.time, False)))

    def producer(self, name: str) -> Usd.Attribute | None:
        return producer(self.shader, self.names[name]) if self.has(name) else None

    def read(self, name: str, *, colour: bool) -> Read | None:
        """What a reader of a primvar gives to an input that it feeds; None where none does."""
        output = None if self.names.omni else self.producer(name)
        return None if output is None else self.read_by(output, name, colour=colour)

    def read_by(self, output: Usd.Attribute, name: str, *, colour: bool) -> Read | None:
        """What a reader of a primvar gives; None where the output is of another shader."""
        if not (kind := shader_id(output.GetPrim())).startswith(READERS):
            return None
        reader = UsdShade.Shader(output.GetPrim())
        is_materialx = kind.startswith("ND_geom")
        varname = str(value_of(reader, "geomprop" if is_materialx else "varname", self.time, ""))
        primvar = varname.removeprefix("primvars:") or DISPLAY
        fallback = _given(value_of(reader, "default" if is_materialx else "fallback", self.time))
        self.asked[Asked(primvar, name, colour, fallback is None)] = None
        found = self.look(primvar)
        fits = found is not None and (found.colour if colour else found.number) is not None
        return Read(primvar, found if fits else fallback, fallback)

    def weight(self, name: str) -> float:
        """What an input is multiplied by."""
        times = 1.0
        for other, default in self.names.weights.get(name, {}).items():
            output = producer(self.shader, other)
            times *= float(
                value_of(self.shader, other, self.time, default) if output is None else self.fed(output, other, default)
            )
        if name == "emissiveColor" and self.names.in_lux and self.mode(self.names.in_lux, ("emission_lx", 0)):
            times /= np.pi  # of a surface that is equally bright from everywhere
        return times

    def mode(self, name: str, wanted: tuple[str, int]) -> bool:
        """Whether a choice by word or number, 0 where nothing is authored, is this one."""
        given = value_of(self.shader, name, self.time)
        return str(0 if given is None else given) in (wanted[0], str(wanted[1]))

    def constant(self, name: str, default: Any) -> Any:
        if not self.has(name):
            return default
        output = producer(self.shader, self.names[name])
        if output is None:
            return value_of(self.shader, self.names[name], self.time, default)
        return fitted(self.fed(output, name, default), default)

    def fed(self, output: Usd.Attribute, name: str, default: Any) -> Any:
        """The number that other shaders give, a picture's in the mean; `default` where they give none."""
        if (read := self.read_by(output, name, colour=False)) is not None:
            number = read.given.number if read.given is not None else None
            return default if number is None else number
        node = self.behind(output, name)
        if node is None:
            return default
        value = sampled(node, self.images, channels=1)
        if isinstance(value, tuple):
            return value[0]
        self.notes.warn(self.shader.GetPath(), f"a picture of {name} is drawn as its mean")
        return float(linear(value, srgb=value.dtype == np.uint8).mean())

    def behind(self, output: Usd.Attribute, name: str) -> TextureNode | None:
        """`fed_by`, with the primvars of the shape in it."""

        def of_shape(reader: Usd.Attribute) -> tuple[float, ...] | None:
            read = self.read_by(reader, f"a node behind {name}", colour=True)
            given = read.given if read is not None else None
            return None if given is None or isinstance(given.value, str) or given.colour is None else given.value

        return fed_by(output, name, self.time, self.notes, self.shader.GetPath(), self.images, of_shape)

    def constant_color(self, name: str, default: tuple[float, ...]) -> tuple[float, ...]:
        weight = self.weight(name)
        if (read := self.read(name, colour=True)) is not None:
            return tuple(c * weight for c in read.colour or (0.0, 0.0, 0.0))
        node = self.texture(name)
        if node is not None:
            value = sampled(node, self.images, channels=3)
            return (
                value
                if isinstance(value, tuple)
                else tuple(float(c) for c in linear(value, srgb=value.dtype == np.uint8).mean(axis=(0, 1)))
            )
        value = value_of(self.shader, self.names[name], self.time, default) if self.has(name) else default
        tint = value_of(self.shader, self.names.tints.get(name, ""), self.time, (1.0, 1.0, 1.0))
        return tuple(float(c) * float(t) * weight for c, t in zip(value, tint, strict=True))

    def texture(self, name: str) -> TextureNode | None:
        if self.names.omni:
            return omni_texture(self.shader, name, self.time, self.notes, self.images)
        output = self.producer(name)
        if output is None or (name != "normal" and shader_id(output.GetPrim()).startswith(READERS)):
            return None
        node = self.behind(output, name)
        weight = self.weight(name) if node is not None else 1.0
        if node is not None and weight != 1.0:
            scale, bias = (tuple(c * weight for c in values[:3]) for values in (node.scale, node.bias))
            node = replace(node, scale=(*scale, node.scale[3]), bias=(*bias, node.bias[3]))
        if node is not None and name in self.names.inverted:
            node = replace(
                node,
                scale=tuple(-c for c in node.scale),
                bias=tuple(1.0 - c for c in node.bias),
                fallback=tuple(1.0 - c for c in node.fallback),
            )
        return node

    def bitmap(self, pixels: Any, node: TextureNode, *, raw: bool) -> dict[str, Any]:
        """A picture as Mitsuba's texture, looked up where the node says.

        A shape carries the coordinates of the first texture; those of another one
        are reached from there by an affine map.
        """
        shown = self.images.wrapped(pixels, node)
        self.unsaid |= any(
            given not in MODES and mode == "black"
            for given, mode in zip((node.wrap, node.wrap_v or node.wrap), self.images.wraps(node), strict=True)
        )
        made = {"type": "bitmap", "bitmap": shown.pixels, "raw": raw, "wrap_mode": shown.mode}
        if node.uv is None:
            return made
        onto = np.array([[shown.scale[0], 0.0, shown.shift[0]], [0.0, shown.scale[1], shown.shift[1]], [0.0, 0.0, 1.0]])
        if self.uv is None:
            self.uv = node.uv
        first, this = (np.vstack([np.array(uv.matrix), [0.0, 0.0, 1.0]]) for uv in (self.uv, node.uv))
        if self.uv.primvar != node.uv.primvar or abs(np.linalg.det(first)) < 1e-12:
            self.notes.warn(
                self.shader.GetPath(),
                f"textures with different coordinates; all are drawn with {self.uv.primvar!r} as the first one is",
            )
            this = first
        between = onto if self.uv == node.uv or this is first else onto @ this @ np.linalg.inv(first)
        return made if (between == np.eye(3)).all() else made | {"to_uv": between}

    def shares(self, name: str, values: Sequence[float]) -> list[float]:
        """What of a colour or number is from 0 to 1; what is not is told."""
        taken = [min(max(float(c), 0.0), 1.0) for c in values]
        if any(abs(one - other) > ROUNDED for one, other in zip(taken, values, strict=True)):
            given, drawn = (", ".join(f"{c:.4g}" for c in numbers) for numbers in (values, taken))
            self.notes.warn(
                self.shader.GetPath(), f"{self.names[name]} is {given}, and 0 to 1 can be drawn; {drawn} is taken"
            )
        return taken

    def limited(self, name: str, pixels: Any) -> Any:
        """Likewise of a picture."""
        taken = self.images.once(_limited, pixels)
        if taken is not pixels and np.abs(taken - pixels).max() > ROUNDED:
            self.notes.warn(
                self.shader.GetPath(),
                f"the picture of {self.names[name]} has values from {pixels.min():.4g} to {pixels.max():.4g}, and 0 to "
                f"1 can be drawn; what is outside is taken as 0 or 1",
            )
        return taken

    def index(self, name: str, default: float) -> float:
        """An index of refraction; below that of vacuum there is none, and one that no glass has is told."""
        given = float(self.constant(name, default))
        said = f"{self.names[name]} is {given:g}"
        if given < 1.0:
            self.notes.warn(self.shader.GetPath(), f"{said}, and an index of refraction is 1 or more; 1 is taken")
        elif given > _UNUSUAL_IOR:
            self.notes.warn(
                self.shader.GetPath(), f"{said}, and nothing clear has more than 5; it is drawn as it stands"
            )
        return max(given, _MIN_IOR)

    def lets_straight_through(self) -> bool:
        """Whether what is not opaque is clear, rather than not there; a mode of another name is told."""
        known = ("transparent", "presence")
        given = self.constant("opacityMode", known[0])
        if not isinstance(given, str):  # which is told with all values of another kind
            return True
        return self.notes.token(self.shader.GetPath(), "opacityMode", given, known, known[0]) == known[0]

    def color(self, name: str, default: tuple[float, ...]) -> dict[str, Any]:
        output = self.producer(name)
        if (read := self.read(name, colour=True)) is not None:
            weight = self.weight(name)
            varies = read.given is not None and read.given.varies and name == "diffuseColor"
            if varies and weight != 1.0:
                self.notes.warn(self.shader.GetPath(), f"{name} varies and has a weight; it is drawn as its mean")
            elif varies:
                self.reads, self.fallback = read.name, read.fallback.colour if read.fallback is not None else None
                self.vertex_color = True
                return dict(_VERTEX_COLOR)
            unknown = GREY if read.name == DISPLAY else (0.0, 0.0, 0.0)
            return _rgb(self.shares(name, [c * weight for c in read.colour or unknown]))
        node = self.texture(name)
        if node is None:
            return (
                _rgb(self.shares(name, self.constant_color(name, default))) if output is None else _rgb(list(default))
            )
        value = sampled(node, self.images, channels=3)
        if isinstance(value, tuple):
            return _rgb(self.shares(name, value))
        return self.bitmap(self.limited(name, value), node, raw=False)

    def number(self, name: str, default: float) -> Any:
        if (read := self.read(name, colour=False)) is not None:
            number = read.given.number if read.given is not None else None
            (given,) = self.shares(name, [0.0 if number is None else number])
            return 1.0 - given if name in self.names.inverted else given
        node = self.texture(name)
        if node is None:
            value = None
            if self.producer(name) is None and self.has(name):
                value = value_of(self.shader, self.names[name], self.time)
            if value is None or numbers_in(value) is None:
                return default
            (given,) = self.shares(name, [float(fitted(value, default))])
            return 1.0 - given if name in self.names.inverted else given
        value = sampled(node, self.images, channels=1)
        if isinstance(value, tuple):
            return self.shares(name, value[:1])[0]
        return self.bitmap(self.limited(name, value), node, raw=True)

    def opacity(self) -> Any:
        """Opacity as a number or bitmap, or None where the surface is opaque."""
        value = self.number("opacity", 1.0)
        threshold = float(self.constant("opacityThreshold", self.names.cutoff))
        if self.names.masks and not self.mode(self.names.masks, ("MASK", 1)):
            threshold = 0.0
        elif self.names.masks and threshold <= 0.0:
            return None
        if isinstance(value, dict):
            if threshold > 0.0:
                value["bitmap"] = self.images.once(_cut, value["bitmap"], threshold)
            return value
        if threshold > 0.0:
            value = 1.0 if value >= threshold else 0.0
        return None if value >= 1.0 else value

    def emission(self) -> tuple[dict[str, Any] | None, float]:
        """Radiance and its mean luminance, or (None, 0) for a dark surface."""
        if not self.has("emissiveColor"):
            return None, 0.0
        node = self.texture("emissiveColor")
        dark = self.names.glow if self.names.weights else (0.0, 0.0, 0.0)  # where a weight switches it on
        value: Any = (
            self.constant_color("emissiveColor", dark) if node is None else sampled(node, self.images, channels=3)
        )
        if isinstance(value, tuple):
            strength = [max(float(c), 0.0) for c in value]
            if min(value) < -ROUNDED:
                self.notes.warn(
                    self.shader.GetPath(), f"{self.names['emissiveColor']} is below 0, where nothing shines; 0 is taken"
                )
            return (_rgb(strength), float(LUMINANCE @ strength)) if max(strength) > 0.0 else (None, 0.0)
        assert node is not None
        decoded, luminance = self.images.once(_shining, value)
        return (None, 0.0) if decoded is None else (self.bitmap(decoded, node, raw=True), luminance)


def _reflecting(ior: float, times: float) -> float:
    """The index of refraction whose reflection at normal incidence is `times` that of `ior`.

    >>> _reflecting(1.5, 1.0), _reflecting(1.5, 0.0)
    (1.5, 1.0)
    """
    if times == 1.0:
        return ior
    f0 = min(times * ((ior - 1.0) / (ior + 1.0)) ** 2, 0.99)
    return (1.0 + f0**0.5) / (1.0 - f0**0.5)


_SMOOTH = 0.03
"""Roughness below which glass is drawn as quite smooth; its lobe is less than a tenth of a degree wide."""


def _clear(ior: float, roughness: float, tint: tuple[float, ...], *, thin: bool) -> dict[str, Any]:
    """Glass of one kind: a solid's face, or a pane without thickness, which is smooth whatever its roughness."""
    color = [min(max(float(c), 0.0), 1.0) for c in tint]
    made: dict[str, Any] = {"type": "thindielectric" if thin else "dielectric", "int_ior": max(float(ior), _MIN_IOR)}
    if not thin and roughness > _SMOOTH:
        made |= {"type": "roughdielectric", "distribution": "ggx", "alpha": min(roughness, 1.0) ** 2}
    return made if min(color) == 1.0 else made | {"specular_transmittance": _rgb(color)}


def _limited(pixels: Any) -> Any:
    """Values from 0 to 1; the same array where they are."""
    return (
        pixels
        if pixels.dtype == np.uint8 or (pixels.min() >= 0.0 and pixels.max() <= 1.0)
        else np.clip(pixels, 0.0, 1.0)
    )


def _rgb(value: list[float]) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(c) for c in value]}


def _content(pixels: Any) -> tuple[Any, ...]:
    """Shape, type and a hash of an array."""
    return pixels.shape, str(pixels.dtype), hashlib.sha256(np.ascontiguousarray(pixels).data).hexdigest()


def _mean_of(pixels: Any, raw: bool) -> tuple[float, float, float]:
    return mean_colour({"type": "bitmap", "bitmap": pixels, "raw": raw})


def _shining(pixels: Any) -> tuple[Any, float]:
    """A picture as radiance, with its mean luminance; (None, 0) where it is dark throughout."""
    decoded = np.maximum(linear(pixels, srgb=pixels.dtype == np.uint8), 0.0)
    return (decoded, float(LUMINANCE @ decoded.mean(axis=(0, 1)))) if decoded.any() else (None, 0.0)


def _cut(pixels: Any, threshold: float) -> Any:
    """1 where a picture reaches a threshold, else 0."""
    return (pixels >= threshold).astype(np.float32)


def _without_textures(part: dict[str, Any]) -> dict[str, Any]:
    """The same BSDF with each texture replaced by its texel at (0, 0): what a reader's default of st gives."""
    if part["type"] in ("normalmap", "bumpmap"):
        return _without_textures(next(one for one in part.values() if is_surface(one)))
    result: dict[str, Any] = {}
    for name, value in part.items():
        while isinstance(value, dict) and value["type"] == "checkerboard":
            value = value.get("color0", FIRST_SQUARE)
        if isinstance(value, dict) and value["type"] == "bitmap":
            raw = bool(value.get("raw", False))
            pixels, begin = value["bitmap"], value.get("to_uv", np.eye(3))[:2, 2] + 1e-9
            column, row = (int(place * size) % size for place, size in zip(begin, pixels.shape[1::-1], strict=True))
            row = pixels.shape[0] - 1 - row
            texel = linear(
                pixels[row : row + 1, column : column + 1], srgb=pixels.dtype == np.uint8 and not raw
            ).reshape(-1)
            result[name] = float(texel[0]) if raw or len(texel) < 3 else _rgb([float(c) for c in texel[:3]])
        else:
            result[name] = _without_textures(value) if isinstance(value, dict) and "type" in value else value
    return result
