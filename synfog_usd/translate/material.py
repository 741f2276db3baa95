"""Materials of a stage, each made once.

Takes bound materials; gives one 'mat_*' entry per material, what it emits and
which texture coordinates it reads.  What a surface shader becomes stands in `surface`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from pxr import Gf, Sdf, Tf, Usd, UsdShade

from synfog_usd.base.arrays import Array, Pixels
from synfog_usd.scene import mean_colour
from synfog_usd.translate import spectrum
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.finite import tell_inputs
from synfog_usd.translate.inputs import DISPLAY, VERTEX_COLOR, Bsdf, Lookup, PrimvarUse, SurfaceInputs, rgb
from synfog_usd.translate.lasting import Lasting, Signature
from synfog_usd.translate.primvars import PrimvarValue
from synfog_usd.translate.shader import file_of, flag_of, number_of, shader_id
from synfog_usd.translate.shading import GREY, MATERIALX, OMNI_PBR, PREVIEW, InputNames
from synfog_usd.translate.surface import surface
from synfog_usd.translate.texture import ImageReader, UvSource, linear

_EARLIEST = Usd.TimeCode.EarliestTime()

_PLAIN = (type(None), bool, int, float, str, Gf.Vec2f, Gf.Vec3f, Gf.Vec4f, Gf.Vec3d)
"""Types of values that are equal where they mean the same."""

_CONTEXTS = ("", "mtlx", "mdl")
"""Renderers whose outputs are followed."""

_UNREADABLE = (Tf.ErrorException, ArithmeticError, TypeError, ValueError, LookupError, AttributeError)
"""What is raised for an opinion that no shader can mean; the rest of the stage is drawn all the same."""

Values: TypeAlias = tuple[PrimvarValue | None, ...]
"""What a shape gives for each primvar that its material reads."""


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
        fallback: colour for shapes without that primvar, where the material has one.
        unwrapped: whether its textures are black beyond their square because no wrap mode is authored.
        empty: whether the material has no output at all, as Blender writes volumes.
        unknown: whether its surface is not known, so that its shapes are drawn as if they had none.
    """

    key: str
    emission: Bsdf | None = None
    emission_nits: float = 0.0
    uv: UvSource | None = None
    plain: str | None = None
    colored: bool = False
    reads: str = DISPLAY
    fallback: tuple[float, float, float] | None = None
    unwrapped: bool = False
    empty: bool = False
    unknown: bool = False


class Materials:
    """All materials of a scene, each made once.

    Attributes:
        bsdfs: 'mat_*' -> BSDF, in the order in which they were made.
        reflectance_of: 'mat_*' -> spectrum, for materials with one; see `SceneDict`.
    """

    def __init__(self, time: Usd.TimeCode, notes: Diagnostics, images: ImageReader, lasting: Lasting) -> None:
        self.time, self.notes, self.images, self.lasting = time, notes, images, lasting
        self.bsdfs: dict[str, Bsdf] = {}
        self.reflectance_of: dict[str, Array] = {}
        self._uses: dict[str | Signature, dict[PrimvarUse, None]] = {}
        self._by_path: dict[tuple[str, Values], Finish] = {}
        self._by_signature: dict[tuple[Signature, Values], Finish] = {}
        self._signatures: dict[str, Signature | None] = {}
        self._by_content: dict[str, str] = {}
        self._by_color: dict[tuple[Any, ...], str] = {}

    def finish(self, material: UsdShade.Material, lookup: Lookup = lambda _: None, shape: str = "") -> Finish:
        """The finish of a USD material on a shape.

        Args:
            lookup: from the name of a primvar to the shape's value.
            shape: its path, for notes.
        """
        path = str(material.GetPath())
        if path not in self._signatures:
            self._signatures[path] = self._signature(material.GetPrim())
        signature = self._signatures[path]
        uses = self._uses.setdefault(path if signature is None else signature, {})
        values = tuple(lookup(use.name) for use in uses)
        if (path, values) not in self._by_path:
            before = self.notes.count
            finish = self._by_signature.get((signature, values)) if signature is not None else None
            if finish is None:
                tell_inputs(material.GetPrim(), self.time, self.notes)
                finish = self._read(material, lookup, uses)
                values = tuple(lookup(use.name) for use in uses)
                if signature is not None and self.notes.count == before:  # notes name the material
                    self._by_signature[signature, values] = finish
            self._by_path[path, values] = finish
        self._tell(uses, values, shape)
        return self._by_path[path, values]

    def _read(self, material: UsdShade.Material, lookup: Lookup, uses: dict[PrimvarUse, None]) -> Finish:
        """The finish of a material, with the reflectance spectrum that is authored on it; grey where it cannot be
        read.
        """
        try:
            finish = self._drawn(material, lookup, uses)
            bsdf = self.bsdfs[finish.key]
            curve = spectrum.reflectance(material.GetPrim(), bsdf, self.time, self.notes, self._mean)
            if curve is None:
                return finish
            key = self._add(bsdf, curve)
            return replace(
                finish, key=key, plain=None if finish.plain is None else self._add(self.bsdfs[finish.plain], curve)
            )
        except _UNREADABLE as problem:
            reason = str(problem).strip().splitlines()[-1:] or [type(problem).__name__]
            self.notes.warn(
                material.GetPath(), f"cannot be read ({reason[0][:120]}); its shapes take displayColor or grey"
            )
            return replace(self.colored(GREY), unknown=True)

    def _tell(self, uses: Mapping[PrimvarUse, None], values: Values, shape: str) -> None:
        """Note what a shape's primvars cannot give to its material."""
        for use, value in zip(uses, values, strict=True):
            if value is None:
                if use.needed and use.name != DISPLAY:
                    self.notes.warn(
                        shape, f"has no value of primvar {use.name}, and the reader of {use.input} no fallback"
                    )
            elif (value.colour if use.colour else value.number) is None:
                kind = "colour" if use.colour else "number"
                self.notes.warn(
                    shape, f"primvar {use.name} {value.what}, and is no {kind}; {use.input} takes the reader's fallback"
                )
            elif value.varies and use.input != "diffuseColor":
                self.notes.warn(
                    shape, f"primvar {use.name!r} varies over it; {use.input}, which reads that, is drawn as its mean"
                )
            elif not use.colour and len(value.value) > 1:
                self.notes.info(shape, f"primvar {use.name} {value.what}; {use.input} takes their mean")

    def _signature(self, material: Usd.Prim) -> Signature | None:
        """All that is authored on a material and below it, equal for instances of a model with the same material; None
        where a source lies elsewhere, or a value is more than a few numbers, a word or a file.
        """
        path, entries, varies = str(material.GetPath()), list[Signature](), False
        if path in self.lasting.signatures:
            return self.lasting.signatures[path]
        for prim in Usd.PrimRange(material):
            entries.append((str(prim.GetPath())[len(path) :], prim.GetTypeName()))
            for attribute in prim.GetAuthoredAttributes():
                value = attribute.Get(self.time)
                varies |= attribute.ValueMightBeTimeVarying()
                if value is None:  # as `shader.value_of` has it
                    value = attribute.Get(_EARLIEST)
                entry: Signature = (attribute.GetName(), type(value).__name__, value)
                if isinstance(value, Sdf.AssetPath):
                    if "<UDIM>" in value.path:
                        return None
                    entry = (*entry[:2], value.path, value.resolvedPath, attribute.GetColorSpace())
                elif not isinstance(value, _PLAIN):
                    return None
                if attribute.HasAuthoredConnections():
                    sources = [str(source) for source in attribute.GetConnections()]
                    if not all(source.startswith(f"{path}/") for source in sources):
                        return None
                    entry += tuple(source[len(path) :] for source in sources)
                entries.append(entry)
        if not varies:
            self.lasting.signatures[path] = tuple(entries)
        return tuple(entries)

    def is_empty(self, material: UsdShade.Material) -> bool:
        """Whether a material has no surface at all, known or not."""
        path = str(material.GetPath())
        if path not in self.lasting.empty:
            self.lasting.empty[path] = _is_empty(material)
        return self.lasting.empty[path]

    def _mean(self, colour: Mapping[str, Any]) -> tuple[float, float, float]:
        """`mean_colour`; that of a picture is computed once."""
        if colour["type"] == "rgb":
            return mean_colour(colour)
        return self.images.once(_mean_of, colour["bitmap"], bool(colour.get("raw", False)))

    def colored(self, color: tuple[float, ...], opacity: float = 1.0) -> Finish:
        """A matte finish of one colour, for shapes without a material."""
        return self._matte((*color, opacity), rgb([min(max(float(c), 0.0), 1.0) for c in color]), opacity)

    def vertex_colored(self, opacity: float = 1.0) -> Finish:
        """A matte finish that takes its colour from the vertices."""
        return replace(self._matte(("vertex", opacity), dict(VERTEX_COLOR), opacity), colored=True)

    def _matte(self, key: tuple[Any, ...], reflectance: Bsdf, opacity: float) -> Finish:
        if key not in self._by_color:
            bsdf: Bsdf = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}
            self._by_color[key] = self._add(
                bsdf if opacity >= 1.0 else {"type": "mask", "opacity": opacity, "bsdf": bsdf}
            )
        return Finish(self._by_color[key])

    def black(self) -> Finish:
        """A finish that reflects nothing, for the faces of lamps."""
        if ("black",) not in self._by_color:
            self._by_color["black",] = self._add({"type": "diffuse", "reflectance": rgb([0.0, 0.0, 0.0])})
        return Finish(self._by_color["black",])

    def _add(self, bsdf: Bsdf, curve: Array | None = None) -> str:
        """Key of a BSDF and its spectrum; equal ones share it."""
        content = repr(self._content(bsdf) if curve is None else self._content({"bsdf": bsdf, "curve": curve}))
        if content not in self._by_content:
            self._by_content[content] = f"mat_{len(self.bsdfs)}"
            self.bsdfs[self._by_content[content]] = bsdf
            if curve is not None:
                self.reflectance_of[self._by_content[content]] = curve
        return self._by_content[content]

    def _content(self, part: Bsdf) -> Bsdf:
        """A BSDF with hashes instead of its pictures: equal content, equal BSDFs."""
        content: Bsdf = {}
        for name, value in part.items():
            if isinstance(value, dict):
                content[name] = self._content(value)
            else:
                content[name] = self.images.once(_hash_of, value) if isinstance(value, np.ndarray) else value
        return content

    def _drawn(self, material: UsdShade.Material, lookup: Lookup, uses: dict[PrimvarUse, None]) -> Finish:
        """The finish of a material by the kind of its surface shader."""
        path = material.GetPath()
        sources = [material.ComputeSurfaceSource(context)[0] for context in _CONTEXTS]
        shader = next((source for source in sources if source), None)
        if not shader:
            empty = self.is_empty(material)
            if not empty:
                self.notes.warn(
                    path, "material's outputs lead to no shader that is known; its shapes take displayColor or grey"
                )
            return Finish(self.colored(GREY).key, empty=empty, unknown=not empty)
        kind = shader_id(shader.GetPrim())
        mdl = shader.GetPrim().GetAttribute("info:mdl:sourceAsset:subIdentifier")
        names = self._names_of(shader, kind, str(mdl.Get() or "") if mdl else "", path)
        if names is None:
            what = kind or (mdl and mdl.Get()) or "of an unknown type"
            self.notes.warn(path, f"shader {what} is not known; its shapes take displayColor or grey")
            return replace(self.colored(GREY), unknown=True)
        inputs = SurfaceInputs(shader, names, self.time, self.notes, self.images, lookup, uses)
        bsdf = surface(inputs, path)
        emission, nits = inputs.emission()
        return Finish(
            self._add(bsdf),
            emission,
            nits,
            inputs.uv,
            None if inputs.uv is None else self._add(_without_textures(bsdf)),
            inputs.vertex_color,
            inputs.reads,
            inputs.fallback,
            inputs.unwrapped,
        )

    def _names_of(self, shader: UsdShade.Shader, kind: str, mdl: str, path: Sdf.Path) -> InputNames | None:
        """Names of a shader's inputs, with notes on what its model is drawn by; None for a model that is not known."""
        if kind == "UsdPreviewSurface" or kind.startswith("ND_UsdPreviewSurface"):
            return PREVIEW
        for beginning, names in MATERIALX.items():
            if kind.startswith(beginning):
                self.notes.info(
                    path,
                    f"{kind} is drawn by its base, roughness, metalness, specular, transmission, subsurface, coat, "
                    f"emission, opacity and normal map",
                )
                return names
        if not mdl.startswith("OmniPBR"):
            return None
        self.notes.info(
            path,
            "OmniPBR is drawn by constants and textures of its base, roughness, metalness, specular level, "
            "opacity, emission and normals, and by constants of its clear coat",
        )
        if flag_of(shader, "enable_clearcoat", self.time):
            if file_of(shader, "clearcoat_normalmap_texture", self.time)[0]:
                self.notes.warn(path, "clearcoat_normalmap_texture is not drawn")
            if number_of(shader, "clearcoat_transparency", self.time, 1.0) != 1.0:
                self.notes.warn(path, "clearcoat_transparency is drawn as 1")
        return OMNI_PBR


def _is_empty(material: UsdShade.Material) -> bool:
    outputs = [output for output in material.GetOutputs() if output.HasConnectedSource()]
    return all(output.GetBaseName() == "volume" for output in outputs) and not any(
        material.ComputeSurfaceSource(context)[0] for context in ("mitsuba", *_CONTEXTS)
    )


def _hash_of(pixels: Pixels) -> tuple[tuple[int, ...], str, str]:
    """Shape, type and SHA-256 of an array."""
    return pixels.shape, str(pixels.dtype), hashlib.sha256(np.ascontiguousarray(pixels).data).hexdigest()


def _mean_of(pixels: Pixels, raw: bool) -> tuple[float, float, float]:
    return mean_colour({"type": "bitmap", "bitmap": pixels, "raw": raw})


def _without_textures(part: Bsdf) -> Bsdf:
    """The same BSDF with each texture replaced by its texel at (0, 0): what a reader's default of st gives."""
    if part["type"] == "normalmap":
        return _without_textures(part["bsdf"])
    result: Bsdf = {}
    for name, value in part.items():
        if isinstance(value, dict) and "type" in value:
            result[name] = _texel(value) if value["type"] == "bitmap" else _without_textures(value)
        else:
            result[name] = value
    return result


def _texel(bitmap: Bsdf) -> float | Bsdf:
    """The texel of a texture at (0, 0), as a number or a colour."""
    raw, pixels = bool(bitmap.get("raw", False)), bitmap["bitmap"]
    begin = bitmap.get("to_uv", np.eye(3))[:2, 2] + 1e-9
    column, row = (int(share * size) % size for share, size in zip(begin, pixels.shape[1::-1], strict=True))
    row = pixels.shape[0] - 1 - row
    srgb = pixels.dtype == np.uint8 and not raw
    texel = linear(pixels[row : row + 1, column : column + 1], srgb=srgb).reshape(-1)
    return float(texel[0]) if raw or len(texel) < 3 else rgb([float(c) for c in texel[:3]])
