"""Inputs of USD's own shaders that hold another kind of value than the specification has, or lead nowhere.

Takes a material; tells of each such input.  What of its value fits is drawn, see `texture.fitted`.
Source: UsdPreviewSurface specification, version 2.6.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from pxr import Usd, UsdShade

from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.texture import numbers_in, producer, shader_id

_NUMBERS: Mapping[str, Mapping[str, int]] = MappingProxyType(
    {
        "UsdPreviewSurface": {
            **dict.fromkeys(("diffuseColor", "emissiveColor", "specularColor", "normal"), 3),
            **dict.fromkeys(("useSpecularWorkflow", "metallic", "roughness", "clearcoat", "clearcoatRoughness"), 1),
            **dict.fromkeys(("opacity", "opacityThreshold", "ior", "displacement", "occlusion"), 1),
        },
        "UsdUVTexture": dict.fromkeys(("scale", "bias", "fallback"), 4) | {"st": 2},
        "UsdTransform2d": {"in": 2, "rotation": 1, "scale": 2, "translation": 2},
    }
)
"""How many numbers an input holds."""

_WORDS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "UsdPreviewSurface": ("opacityMode",),
        "UsdUVTexture": ("wrapS", "wrapT", "sourceColorSpace"),
        "UsdPrimvarReader": ("varname",),
    }
)
"""Inputs that hold a word."""

_FOLLOWED: Mapping[str, str] = MappingProxyType(
    {
        **{"UsdUVTexture": "st", "UsdTransform2d": "in", "UsdPrimvarReader": "", "geompropvalue": ""},
        **dict.fromkeys(("image", "tiledimage", "place2d"), "texcoord"),
    }
)
"""The one input of a shader, '' for none, that other shaders may feed here; its other inputs are constants."""


def tell_misfits(material: Usd.Prim, time: Usd.TimeCode, notes: Diagnostics) -> None:
    """Tell of each input of a material's shaders whose value does not fit, or whose connection gives nothing."""
    for prim in Usd.PrimRange(material):
        kind = shader_id(prim).removeprefix("ND_").partition("_")[0]
        if not any(kind in table for table in (_NUMBERS, _WORDS, _FOLLOWED)):
            continue
        wanted, words = _NUMBERS.get(kind, {}), _WORDS.get(kind, ())
        for one in UsdShade.Shader(prim).GetInputs():
            name, attribute = one.GetBaseName(), one.GetAttr()
            if attribute.HasAuthoredConnections():
                if not UsdShade.Utils.GetValueProducingAttributes(one):
                    notes.warn(prim.GetPath(), f"the connection of {name} gives nothing; its default is taken")
                elif name != _FOLLOWED.get(kind, name) and producer(UsdShade.Shader(prim), name) is not None:
                    notes.warn(prim.GetPath(), f"what other shaders give to {name} is not drawn; its default is taken")
                continue
            value = attribute.Get(time)
            value = attribute.Get(Usd.TimeCode.EarliestTime()) if value is None else value
            if value is None:
                continue
            if name in words and not isinstance(value, str):
                notes.warn(prim.GetPath(), f"{name} is {str(value)[:40]}, and a word is wanted; its default is taken")
            elif name in wanted and (count := len(numbers_in(value) or ())) != wanted[name]:
                notes.warn(
                    prim.GetPath(),
                    f"{name} holds {count or 'no'} number{'s' * (count != 1)}, and {wanted[name]} "
                    f"{'is' if wanted[name] == 1 else 'are'} wanted; what fits of it is taken, else its default",
                )
