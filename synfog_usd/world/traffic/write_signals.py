"""Signals that change as time samples: colour and light of their lenses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pxr import Gf, Sdf

from synfog_usd.base.arrays import Array, Flags
from synfog_usd.world import library
from synfog_usd.world.spec import Placement
from synfog_usd.world.traffic.samples import DARK, KINDS, amber, attribute, author_emission, emissions, sample

LENSES = {"red": "lens_top", "amber": "lens_middle", "green": "lens_bottom"}
LOOKS = {"red": "signal_red", "amber": "signal_dark", "green": "signal_green"}
"""Mesh of each lens, and the material of the model that it takes where signals change."""
AMBER_NITS = 1900.0
"""Luminance of the amber lens [cd m-2], that of the red one; its LEDs are those of indicators."""


@dataclass(frozen=True)
class Lens:
    """How a lens looks without its own light."""

    colour: Gf.Vec3f
    roughness: float


AMBER = Lens(Gf.Vec3f(0.6, 0.25, 0.01), 0.3)


def author_signal(layer: Sdf.Layer, p: Placement, lenses: Mapping[str, Flags], codes: Array) -> None:
    """A signal whose lenses change between lit and dark; each lens gets a material of its own."""
    prim = layer.GetPrimAtPath(f"/World/{p.group}/{p.name}")
    prim.instanceable = False
    dark = _lens(p.asset, LOOKS["amber"])
    bright = emissions(p.asset, "on")
    for lens, lit in lenses.items():
        name = LOOKS[lens]
        look = AMBER if lens == "amber" else _lens(p.asset, name)
        geometry = Sdf.CreatePrimInLayer(layer, prim.path.AppendPath(f"Geometry/{LENSES[lens]}"))
        binding = Sdf.RelationshipSpec(geometry, "material:binding", custom=False)
        binding.targetPathList.explicitItems = [prim.path.AppendPath(f"Materials/{name}")]
        surface = Sdf.CreatePrimInLayer(layer, prim.path.AppendPath(f"Materials/{name}/Surface"))
        shown = [look if on else dark for on in lit]
        colour = attribute(surface, "inputs:diffuseColor", KINDS.Color3f, shown[1].colour)
        sample(layer, colour, codes, [item.colour for item in shown])
        roughness = attribute(surface, "inputs:roughness", KINDS.Float, shown[1].roughness)
        sample(layer, roughness, codes, [item.roughness for item in shown])
        path = Sdf.Path("/World").AppendVariantSelection("lighting", "active")
        path = path.AppendPath(surface.path.MakeRelativePath("/World"))
        light = amber(AMBER_NITS) if lens == "amber" else bright[name]
        author_emission(layer, path, lit, (light, DARK), codes)


def _lens(asset: str, material: str) -> Lens:
    """The look of a model's material."""
    layer = Sdf.Layer.FindOrOpen(str(library.model(asset).path.with_suffix(".mtl.usda")))
    surface = layer.GetPrimAtPath(f"/{layer.defaultPrim}/Materials/{material}/Surface")
    return Lens(surface.attributes["inputs:diffuseColor"].default, surface.attributes["inputs:roughness"].default)
