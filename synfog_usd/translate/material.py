"""Materials: UsdPreviewSurface, and the constants of a few others, as BSDFs.

Takes bound materials; gives one 'mat_*' entry per material, what it emits and
which texture coordinates it reads.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from pxr import Usd, UsdShade

from synfog_usd.translate.notes import Notebook
from synfog_usd.translate.texture import ImageReader, TextureNode, UvSource, linear, producer, sampled, shader_id, texture_node, value_of

GREY = (0.18, 0.18, 0.18)
LUMINANCE = np.array([0.2126729, 0.7151522, 0.0721750])
"""Rec.709 luminance of linear RGB."""

_MIN_IOR = 1.001


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
        empty: whether the material has no output at all, as Blender writes volumes.
    """

    key: str
    emission: dict[str, Any] | None = None
    emission_nits: float = 0.0
    uv: UvSource | None = None
    plain: str | None = None
    colored: bool = False
    empty: bool = False


class Materials:
    """All materials of a scene, each made once.

    Attributes:
        bsdfs: 'mat_*' -> BSDF, in the order in which they were made.
    """

    def __init__(self, time: Usd.TimeCode, notes: Notebook, images: ImageReader) -> None:
        self.time, self.notes, self.images = time, notes, images
        self.bsdfs: dict[str, dict[str, Any]] = {}
        self._by_path: dict[str, Finish] = {}
        self._by_word: dict[str, str] = {}
        self._by_color: dict[tuple[float, ...] | str, str] = {}

    def finish(self, material: UsdShade.Material) -> Finish:
        """The finish of a USD material."""
        path = str(material.GetPath())
        if path not in self._by_path:
            self._by_path[path] = self._made(material)
        return self._by_path[path]

    def colored(self, color: tuple[float, ...]) -> Finish:
        """A matte finish of one colour, for shapes without a material."""
        if color not in self._by_color:
            value = [min(max(float(c), 0.0), 1.0) for c in color]
            self._by_color[color] = self._add({"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": _rgb(value)}})
        return Finish(self._by_color[color])

    def vertex_colored(self) -> Finish:
        """A matte finish that takes its colour from the vertices."""
        if "vertex" not in self._by_color:
            self._by_color["vertex"] = self._add({"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": _VERTEX_COLOR}})
        return Finish(self._by_color["vertex"], colored=True)

    def black(self) -> Finish:
        """A finish that reflects nothing, for the faces of lamps."""
        if "black" not in self._by_color:
            self._by_color["black"] = self._add({"type": "diffuse", "reflectance": _rgb([0.0, 0.0, 0.0])})
        return Finish(self._by_color["black"])

    def _add(self, bsdf: dict[str, Any]) -> str:
        """Key of a BSDF; an equal one that is there already is used again."""
        word = repr(_told(bsdf))
        if word not in self._by_word:
            self._by_word[word] = f"mat_{len(self.bsdfs)}"
            self.bsdfs[self._by_word[word]] = bsdf
        return self._by_word[word]

    def _made(self, material: UsdShade.Material) -> Finish:
        path = material.GetPath()
        sources = [material.ComputeSurfaceSource(context)[0] for context in ("", "mtlx", "mdl")]
        shader = next((source for source in sources if source), None)
        if not shader:
            outputs = [o for o in material.GetOutputs() if o.HasConnectedSource()]
            if outputs and not all(o.GetBaseName() == "volume" for o in outputs):
                self.notes.warn(path, "material's outputs lead to no shader that is known; its shapes take displayColor or grey")
            return Finish(self.colored(GREY).key, empty=not outputs or all(o.GetBaseName() == "volume" for o in outputs))
        kind = shader_id(shader.GetPrim())
        if kind == "UsdPreviewSurface" or kind.startswith("ND_UsdPreviewSurface"):
            return self._surface(shader, _PREVIEW, path)
        if kind.startswith(("ND_standard_surface", "ND_open_pbr")):
            self.notes.warn(path, f"{kind} is drawn as a preview surface with its base colour, roughness, metalness and emission")
            return self._surface(shader, _STANDARD_SURFACE, path)
        mdl = shader.GetPrim().GetAttribute("info:mdl:sourceAsset:subIdentifier")
        if mdl and str(mdl.Get()).startswith("OmniPBR"):
            self.notes.warn(path, "OmniPBR is drawn as a preview surface with its constants")
            return self._surface(shader, _OMNI_PBR, path)
        self.notes.warn(path, f"shader {kind or (mdl and mdl.Get()) or 'of an unknown type'} is not known; the material is grey")
        return self.colored(GREY)

    def _surface(self, shader: UsdShade.Shader, names: _Names, path: object) -> Finish:
        inputs = _Inputs(self, shader, names)
        color = inputs.color("diffuseColor", GREY)
        roughness, metallic = inputs.number("roughness", 0.5), inputs.number("metallic", 0.0)
        ior = inputs.constant("ior", 1.5)
        bsdf: dict[str, Any] = {"type": "principled", "base_color": color, "roughness": roughness}
        if inputs.constant("useSpecularWorkflow", 0.0):
            specular = inputs.constant_color("specularColor", (0.0, 0.0, 0.0))
            f0 = min(float(np.mean(specular)), 0.99)
            ior = (1.0 + f0**0.5) / (1.0 - f0**0.5)
            self.notes.info(path, f"specular workflow is drawn with an index of refraction of {ior:.2f} for the mean of its specularColor")
        elif metallic != 0.0:
            bsdf["metallic"] = metallic
        bsdf["eta"] = max(float(ior), _MIN_IOR)
        clearcoat = inputs.number("clearcoat", 0.0)
        if clearcoat != 0.0:
            gloss = 1.0 - float(inputs.constant("clearcoatRoughness", 0.01))
            bsdf |= {"clearcoat": clearcoat, "clearcoat_gloss": min(max(gloss, 0.0), 1.0)}
        bsdf = self._bumped(bsdf, inputs, path)
        bsdf = {"type": "twosided", "bsdf": bsdf}
        opacity = inputs.opacity()
        if opacity is not None:
            bsdf = {"type": "mask", "opacity": opacity, "bsdf": bsdf}
            if not isinstance(opacity, dict) and str(inputs.constant("opacityMode", "transparent")) == "transparent":
                self.notes.info(path, f"opacity {opacity:.2f} lets light through straight and takes its share of the reflection too; no refraction")
        emission, nits = inputs.emission()
        if inputs.producer("displacement"):
            self.notes.warn(path, "displacement is not drawn")
        key = self._add(bsdf)
        plain = self._add(_without_textures(bsdf)) if inputs.uv is not None else None
        return Finish(key, emission, nits, inputs.uv, plain, inputs.vertex_color)

    def _bumped(self, bsdf: dict[str, Any], inputs: _Inputs, path: object) -> dict[str, Any]:
        node = inputs.texture("normal")
        if node is None:
            return bsdf
        pixels = self.images.read(node.file, node.path) if node.file else None
        if pixels is None or pixels.shape[2] < 3:
            return bsdf
        usual = np.allclose(node.scale[:3], 2.0) and np.allclose(node.bias[:3], -1.0)
        untouched = np.allclose(node.scale[:3], 1.0) and np.allclose(node.bias[:3], 0.0)
        if not (usual or untouched):
            self.notes.warn(path, "normal map with an unusual scale and bias is left out; (2, 2, 2) and (-1, -1, -1) are known")
            return bsdf
        values = linear(pixels[..., :3], srgb=False)
        if untouched and pixels.dtype != np.uint8:
            values = values * 0.5 + 0.5
        inputs.read_uv(node)
        return {"type": "normalmap", "normalmap": _bitmap(values, node, raw=True), "bsdf": bsdf}


@dataclass(frozen=True)
class _Names:
    """What the inputs of a preview surface are called elsewhere; '' where there is no such input."""

    of: dict[str, str]

    def __getitem__(self, name: str) -> str:
        return self.of.get(name, "") if self.of else name


_PREVIEW = _Names({})
_STANDARD_SURFACE = _Names(
    {"diffuseColor": "base_color", "roughness": "specular_roughness", "metallic": "metalness", "ior": "specular_IOR", "emissiveColor": "emission_color"}
)
_OMNI_PBR = _Names(
    {"diffuseColor": "diffuse_color_constant", "roughness": "reflection_roughness_constant", "metallic": "metallic_constant", "opacity": "opacity_constant"}
)
_VERTEX_COLOR = {"type": "mesh_attribute", "name": "vertex_color"}


class _Inputs:
    """The inputs of one surface shader, and the one set of texture coordinates that they read."""

    def __init__(self, materials: Materials, shader: UsdShade.Shader, names: _Names) -> None:
        self.materials, self.shader, self.names = materials, shader, names
        self.time, self.notes, self.images = materials.time, materials.notes, materials.images
        self.uv: UvSource | None = None
        self.vertex_color = False

    def producer(self, name: str) -> Usd.Attribute | None:
        return producer(self.shader, self.names[name]) if self.names[name] else None

    def constant(self, name: str, default: Any) -> Any:
        if not self.names[name]:
            return default
        if producer(self.shader, self.names[name]) is not None:
            self.notes.warn(self.shader.GetPath(), f"a texture on {name} is not drawn; {default} is used")
            return default
        return value_of(self.shader, self.names[name], self.time, default)

    def constant_color(self, name: str, default: tuple[float, ...]) -> tuple[float, ...]:
        node = self.texture(name)
        if node is not None:
            value = sampled(node, self.images, channels=3)
            return value if isinstance(value, tuple) else tuple(float(c) for c in linear(value, srgb=value.dtype == np.uint8).mean(axis=(0, 1)))
        value = value_of(self.shader, self.names[name], self.time, default) if self.names[name] else default
        return tuple(float(c) for c in value)

    def texture(self, name: str) -> TextureNode | None:
        output = self.producer(name)
        if output is None:
            return None
        kind = shader_id(output.GetPrim())
        if kind == "UsdUVTexture":
            return texture_node(output, self.time, self.notes)
        self.notes.warn(self.shader.GetPath(), f"{name} is fed by {kind or 'an unknown node'}, which is not known; its default is used")
        return None

    def read_uv(self, node: TextureNode) -> None:
        if node.uv is None:
            return
        if self.uv is None:
            self.uv = node.uv
        elif self.uv != node.uv:
            self.notes.warn(self.shader.GetPath(), f"textures with different coordinates; all are drawn with {self.uv.primvar!r} as the first one is")

    def color(self, name: str, default: tuple[float, ...]) -> dict[str, Any]:
        output = self.producer(name)
        if output is not None and shader_id(output.GetPrim()).startswith("UsdPrimvarReader"):
            reader = UsdShade.Shader(output.GetPrim())
            if str(value_of(reader, "varname", self.time, "")) == "displayColor":
                self.vertex_color = True
                return dict(_VERTEX_COLOR)
        node = self.texture(name)
        if node is None:
            return _rgb([min(max(c, 0.0), 1.0) for c in self.constant_color(name, default)]) if output is None else _rgb(list(default))
        value = sampled(node, self.images, channels=3)
        if isinstance(value, tuple):
            return _rgb([min(max(c, 0.0), 1.0) for c in value])
        self.read_uv(node)
        return _bitmap(value if value.dtype == np.uint8 else np.clip(value, 0.0, 1.0), node, raw=False)

    def number(self, name: str, default: float) -> Any:
        node = self.texture(name)
        if node is None:
            value = default if self.producer(name) is not None or not self.names[name] else value_of(self.shader, self.names[name], self.time, default)
            return min(max(float(value), 0.0), 1.0)
        value = sampled(node, self.images, channels=1)
        if isinstance(value, tuple):
            return min(max(value[0], 0.0), 1.0)
        self.read_uv(node)
        return _bitmap(np.clip(value, 0.0, 1.0), node, raw=True)

    def opacity(self) -> Any:
        """Opacity as a number or bitmap, or None where the surface is opaque."""
        value = self.number("opacity", 1.0)
        threshold = float(self.constant("opacityThreshold", 0.0))
        if isinstance(value, dict):
            if threshold > 0.0:
                value["bitmap"] = (value["bitmap"] >= threshold).astype(np.float32)
            return value
        if threshold > 0.0:
            value = 1.0 if value >= threshold else 0.0
        return None if value >= 1.0 else value

    def emission(self) -> tuple[dict[str, Any] | None, float]:
        """Radiance and its mean luminance, or (None, 0) for a dark surface."""
        if not self.names["emissiveColor"]:
            return None, 0.0
        node = self.texture("emissiveColor")
        value: Any = self.constant_color("emissiveColor", (0.0, 0.0, 0.0)) if node is None else sampled(node, self.images, channels=3)
        if isinstance(value, tuple):
            strength = [max(float(c), 0.0) for c in value]
            return (_rgb(strength), float(LUMINANCE @ strength)) if max(strength) > 0.0 else (None, 0.0)
        assert node is not None
        self.read_uv(node)
        decoded = np.maximum(linear(value, srgb=value.dtype == np.uint8), 0.0)
        if not decoded.any():
            return None, 0.0
        return _bitmap(decoded, node, raw=True), float(LUMINANCE @ decoded.mean(axis=(0, 1)))


def _rgb(value: list[float]) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(c) for c in value]}


def _bitmap(pixels: Any, node: TextureNode, *, raw: bool) -> dict[str, Any]:
    return {"type": "bitmap", "bitmap": pixels, "raw": raw, "wrap_mode": node.wrap}


def _told(part: Any) -> Any:
    """A BSDF in words, with pictures by their content: equal words, equal BSDFs."""
    if isinstance(part, dict):
        return {name: _told(value) for name, value in part.items()}
    if isinstance(part, np.ndarray):
        return part.shape, str(part.dtype), hashlib.sha256(np.ascontiguousarray(part)).hexdigest()
    return part


def _without_textures(part: dict[str, Any]) -> dict[str, Any]:
    """The same BSDF with each texture replaced by its texel at (0, 0): what a reader's default of st gives."""
    if part["type"] == "normalmap":
        return _without_textures(part["bsdf"])
    result: dict[str, Any] = {}
    for name, value in part.items():
        if isinstance(value, dict) and value["type"] == "bitmap":
            texel = linear(value["bitmap"][-1:, :1], srgb=value["bitmap"].dtype == np.uint8).reshape(-1)
            result[name] = float(texel[0]) if value["raw"] else _rgb([float(c) for c in texel])
        else:
            result[name] = _without_textures(value) if isinstance(value, dict) and "type" in value else value
    return result
