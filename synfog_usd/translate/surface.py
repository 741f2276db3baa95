"""What a surface shader becomes: a BSDF in the scene's words.

Takes the inputs of a shader under the names of a preview surface.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pxr import Gf, Sdf

from synfog_usd.base.colour import LUMINANCE
from synfog_usd.translate.inputs import Bsdf, SurfaceInputs, rgb
from synfog_usd.translate.shader import numbers_in, numbers_of, producer, value_of
from synfog_usd.translate.texture import normals

_MIN_IOR = 1.001

_SMOOTH = 0.03
"""Roughness below which glass is drawn as quite smooth; its lobe is less than a tenth of a degree wide."""

_OF_EVERY_SURFACE = frozenset({"type", "base_color", "roughness", "eta"})
"""Parameters of a surface that is neither metal nor coated; where it reflects nothing, it is Lambert's."""


def surface(inputs: SurfaceInputs, path: Sdf.Path) -> Bsdf:
    """The BSDF of a shader.

    Args:
        inputs: of the shader.
        path: of its material, for notes.
    """
    bsdf = _reflecting_part(inputs, path)
    clear = _transmitting(bsdf, inputs, inputs.index("ior", 1.5), path)
    _tell_what_is_left_out(inputs, path, coated="clearcoat" in bsdf)
    if clear is None and bsdf["eta"] <= _MIN_IOR and not bsdf.keys() - _OF_EVERY_SURFACE:
        bsdf = {"type": "diffuse", "reflectance": bsdf["base_color"]}
    bsdf = {"type": "twosided", "bsdf": _bumped(bsdf, inputs, path)}
    if clear is not None:
        share, glass = clear
        glass = _bumped(glass, inputs, path)
        bsdf = glass if share == 1.0 else {"type": "blendbsdf", "weight": share, "bsdf_0": bsdf, "bsdf_1": glass}
    opacity, straight = inputs.opacity(), inputs.lets_straight_through()
    if opacity is None:
        return bsdf
    if not isinstance(opacity, dict) and straight:
        inputs.notes.info(
            path,
            f"opacity {opacity:.2f} lets light through straight and takes its share of the reflection too; no "
            f"refraction",
        )
    return {"type": "mask", "opacity": opacity, "bsdf": bsdf}


def _reflecting_part(inputs: SurfaceInputs, path: Sdf.Path) -> Bsdf:
    """The surface without what it lets through: base, metal, specular reflection, subsurface and coat."""
    names = inputs.names
    bsdf: Bsdf = {"type": "preview_surface", "base_color": inputs.color("diffuseColor", names.color)}
    bsdf["roughness"] = inputs.number("roughness", names.roughness)
    metallic = inputs.number("metallic", names.metallic)
    if inputs.constant("useSpecularWorkflow", 0.0):
        bsdf["specular"] = inputs.color("specularColor", (0.0, 0.0, 0.0))
    elif metallic != 0.0:
        bsdf["metallic"] = metallic
    bsdf["eta"] = max(_reflecting(inputs.index("ior", 1.5), _specular(inputs, path)), _MIN_IOR)
    _subsurface(bsdf, inputs, path)
    clearcoat = inputs.number("clearcoat", names.coat if inputs.has("clearcoat") else 0.0)
    if clearcoat != 0.0:
        coat_roughness = inputs.number("clearcoatRoughness", names.coat_roughness)
        bsdf |= {"clearcoat": clearcoat, "clearcoat_roughness": coat_roughness}
    return bsdf


def _tell_what_is_left_out(inputs: SurfaceInputs, path: Sdf.Path, *, coated: bool) -> None:
    """Note what is authored on a shader and not drawn."""
    shader, names, time, notes = inputs.shader, inputs.names, inputs.time, inputs.notes
    if inputs.has("displacement") and (inputs.producer("displacement") or inputs.constant("displacement", 0.0)):
        notes.warn(path, "displacement is not drawn")
    if inputs.has("normal") and not inputs.producer("normal"):
        normal = value_of(shader, names["normal"], time)
        if isinstance(normal, (Gf.Vec3f, Gf.Vec3d)) and tuple(normal) not in ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)):
            notes.warn(path, "a normal without a picture is not drawn")
    for name in names.left_out:
        if any(numbers_in(value_of(shader, name, time)) or ()) or producer(shader, name) is not None:
            notes.warn(path, f"{name} is not drawn")
    for name in names.white:
        if name == "clearcoat_tint" and not coated:
            continue
        tint = numbers_of(shader, name, time, (1.0, 1.0, 1.0))
        if tint != (1.0, 1.0, 1.0) or producer(shader, name) is not None:
            notes.warn(path, f"{name} is drawn as white")


def _specular(inputs: SurfaceInputs, path: Sdf.Path) -> float:
    """Factor on the reflection at normal incidence; a tint counts by its luminance."""
    tint = inputs.constant_color("specularTint", (1.0, 1.0, 1.0))
    if max(tint) - min(tint) > 1e-4:
        inputs.notes.warn(path, "the tint of its specular reflection is drawn as grey of the same luminance")
    grey = float(LUMINANCE @ tint) / float(LUMINANCE.sum())
    weight = inputs.constant("specularWeight", inputs.names.specular) / inputs.names.specular
    return max(weight * (tint[0] if min(tint) == max(tint) else grey), 0.0)


def _subsurface(bsdf: Bsdf, inputs: SurfaceInputs, path: Sdf.Path) -> None:
    """Light that goes below the surface, as a matte share of its colour."""
    share = min(max(inputs.constant("subsurface", 0.0), 0.0), 1.0)
    if not share:
        return
    base = bsdf["base_color"]
    if base["type"] != "rgb":
        inputs.notes.warn(path, "subsurface scattering is drawn as the base colour, which is a picture")
        return
    below = inputs.constant_color("subsurfaceColor", inputs.names.below)
    bsdf["base_color"] = rgb(
        [min(max((1.0 - share) * a + share * b, 0.0), 1.0) for a, b in zip(base["value"], below, strict=True)]
    )
    inputs.notes.info(path, "subsurface scattering is drawn as a matte surface of its colour")


def _transmitting(bsdf: Bsdf, inputs: SurfaceInputs, ior: float, path: Sdf.Path) -> tuple[float | Bsdf, Bsdf] | None:
    """The clear share of a surface and its glass, or None where it is opaque; metal lets nothing through."""
    share, metal, notes = inputs.number("transmission", 0.0), bsdf.get("metallic", 0.0), inputs.notes
    if share == 0.0:
        return None
    if isinstance(metal, dict):
        notes.warn(path, "a picture of metalness is not drawn where the surface is transparent too")
    elif not isinstance(share, dict):
        share *= 1.0 - metal
        if share == 0.0:
            return None
    roughness = bsdf["roughness"]
    if isinstance(roughness, dict):
        notes.warn(path, "a picture of roughness is drawn as its mean where the surface is transparent")
        roughness = float(roughness["bitmap"].mean())
    tint = tuple(inputs.shares("transmissionColor", inputs.constant_color("transmissionColor", (1.0, 1.0, 1.0))))
    if inputs.constant("transmissionDepth", 0.0) > 0.0:
        notes.info(path, "transmission_depth is not drawn: what passes two faces has the transmission colour")
        tint = tuple(max(c, 0.0) ** 0.5 for c in tint)
    thin = bool(inputs.constant("thin", 0.0))
    if "thickness" in inputs.names.of:
        thin = not inputs.constant("thickness", 0.0) > 0.0
    notes.info(path, f"transmission is drawn as {'a thin pane' if thin else 'a solid that refracts'}")
    return share, _clear(ior, roughness, tint, thin=thin)


def _bumped(bsdf: Bsdf, inputs: SurfaceInputs, path: Sdf.Path) -> Bsdf:
    """A BSDF under the shader's normal map, where it has one."""
    node = inputs.texture("normal")
    if node is None or not (node.file or node.tiles):
        return bsdf
    scale, bias = np.asarray(node.scale[:3], dtype=np.float64), np.asarray(node.bias[:3], dtype=np.float64)
    untouched = np.allclose(np.abs(scale), 1.0) and np.allclose(bias, (scale < 0.0) * 1.0)
    if untouched:  # codes of 0 to 1, some turned about
        scale, bias = 2.0 * scale, -scale
    if not np.allclose(bias, -0.5 * scale) or not np.isclose(scale[2], 2.0) or not np.all(np.abs(scale) > 0.0):
        inputs.notes.warn(
            path,
            "normal map with an unusual scale and bias is left out; (2, 2, 2) and (-1, -1, -1) are known, red and "
            "green also turned or weaker",
        )
        return bsdf
    values = normals(node, inputs.images, scale, bias, untouched=bool(untouched))
    if values is None:
        return bsdf
    # no normal is black
    along_u, along_v = ("clamp" if mode == "black" else mode for mode in inputs.images.wraps(node))
    node = replace(node, wrap=along_u, wrap_v=along_v)
    return {"type": "normalmap", "normalmap": inputs.bitmap(values, node, raw=True), "bsdf": bsdf}


def _reflecting(ior: float, times: float) -> float:
    """The index of refraction whose reflection at normal incidence is `times` that of `ior`.

    >>> _reflecting(1.5, 1.0), _reflecting(1.5, 0.0)
    (1.5, 1.0)
    """
    if times == 1.0:
        return ior
    f0 = min(times * ((ior - 1.0) / (ior + 1.0)) ** 2, 0.99)
    return float((1.0 + f0**0.5) / (1.0 - f0**0.5))


def _clear(ior: float, roughness: float, tint: tuple[float, ...], *, thin: bool) -> Bsdf:
    """Glass of one kind: a solid's face, or a pane without thickness, which is smooth whatever its roughness."""
    color = [min(max(float(c), 0.0), 1.0) for c in tint]
    glass: Bsdf = {"type": "thindielectric" if thin else "dielectric", "int_ior": max(float(ior), _MIN_IOR)}
    if not thin and roughness > _SMOOTH:
        glass |= {"type": "roughdielectric", "distribution": "ggx", "alpha": min(roughness, 1.0) ** 2}
    return glass if min(color) == 1.0 else glass | {"specular_transmittance": rgb(color)}
