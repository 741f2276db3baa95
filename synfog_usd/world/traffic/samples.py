"""Time samples and cut meshes in a layer: what authors of anything that moves share.

Takes a layer, paths and values at frames; writes them.  Knows nothing of vehicles, people or signals.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeVar

from pxr import Gf, Sdf, Usd, UsdShade, Vt

from synfog_usd.base.arrays import Array, Flags
from synfog_usd.world import authoring, library
from synfog_usd.world.components import author_mesh
from synfog_usd.world.lamps import tint
from synfog_usd.world.shapes import Part
from synfog_usd.world.spec import Placement

PARTS = "Parts"
"""Cut meshes of each model that moves, for reference; abstract, so that nobody sees them."""
DARK = Gf.Vec3f(0.0)
KINDS = Sdf.ValueTypeNames
Value = TypeVar("Value")


def sample(layer: Sdf.Layer, path: Sdf.Path, codes: Array, values: Sequence[Value]) -> None:
    """Values of an attribute at time codes; only those between which something changes, none where nothing does."""
    if all(value == values[0] for value in values):
        return
    last = len(values) - 1
    for k, (code, value) in enumerate(zip(codes, values, strict=True)):
        if value != values[max(k - 1, 0)] or value != values[min(k + 1, last)]:
            layer.SetTimeSample(path, float(code), value)


def attribute(prim: Sdf.PrimSpec, name: str, kind: Sdf.ValueTypeName, default: Value | None = None) -> Sdf.Path:
    """An attribute of a prim in a layer, made where there is none."""
    spec = prim.attributes.get(name)
    if spec is None:
        spec = Sdf.AttributeSpec(prim, name, kind, declaresCustom=name == authoring.VELOCITY)
        if default is not None:
            spec.default = default
    return spec.path


def order(prim: Sdf.PrimSpec, names: Sequence[str]) -> None:
    """Set the order of a prim's transforms."""
    spec = prim.attributes.get("xformOpOrder")
    spec = spec or Sdf.AttributeSpec(prim, "xformOpOrder", KINDS.TokenArray, Sdf.VariabilityUniform)
    spec.default = Vt.TokenArray(names)


# -- meshes


def geometry(p: Placement) -> tuple[Path, str]:
    """The layer of meshes that a placement shows, and where parts of them stand in the stage."""
    individual = p.variants.get("individual", "a")
    names = [p.asset] + [individual] * (individual != "a") + ["low"] * (p.variants.get("lod") == "low")
    path = library.model(p.asset).path.with_name(f"{'.'.join(names)}.geo.usdc")
    return path, f"/World/{p.group}/{PARTS}/{'_'.join(names)}"


def refer(prim: Sdf.PrimSpec, parts: str) -> None:
    """Add parts to a placement; its prims can have opinions then, so that it is no instance."""
    prim.referenceList.prependedItems = [Sdf.Reference("", parts), *prim.referenceList.prependedItems]
    prim.instanceable = False


def begin(path: str) -> Usd.Stage:
    """A stage of its own with an abstract prim."""
    scratch = Usd.Stage.CreateInMemory()
    scratch.CreateClassPrim(path)
    return scratch


def bound(scratch: Usd.Stage, path: str, part: Part, material: str) -> None:
    """A part as a mesh, with a material that is elsewhere."""
    prim = author_mesh(scratch, Sdf.Path(path), part).GetPrim()
    UsdShade.MaterialBindingAPI.Apply(prim).GetDirectBindingRel().SetTargets([material])


def keep(layer: Sdf.Layer, scratch: Usd.Stage, path: str) -> None:
    """Take an abstract prim over into a layer."""
    Sdf.CreatePrimInLayer(layer, Sdf.Path(path).GetParentPath()).specifier = Sdf.SpecifierClass
    Sdf.CopySpec(scratch.GetRootLayer(), path, layer, path)


# -- light


def author_emission(
    layer: Sdf.Layer, path: Sdf.Path, lit: Flags, colours: tuple[Gf.Vec3f, Gf.Vec3f], codes: Array
) -> None:
    """Emission of a shader: one colour where it is lit, another where it is not."""
    over = Sdf.CreatePrimInLayer(layer, path)
    name = attribute(over, "inputs:emissiveColor", KINDS.Color3f, colours[0 if lit[1] else 1])
    sample(layer, name, codes, [colours[0 if item else 1] for item in lit])


def emissions(asset: str, choice: str) -> Mapping[str, Gf.Vec3f]:
    """Emission of a model's materials by a choice of its lamps; empty where it has no such choice."""
    layer = Sdf.Layer.FindOrOpen(str(library.model(asset).path))
    materials = layer.GetPrimAtPath(
        Sdf.Path(f"/{layer.defaultPrim}").AppendVariantSelection("lamps", choice).AppendPath("Materials")
    )
    result = {}
    for material in materials.nameChildren if materials else ():
        surface = material.nameChildren.get("Surface")
        if surface and "inputs:emissiveColor" in surface.attributes:
            result[material.name] = surface.attributes["inputs:emissiveColor"].default
    return result


def amber(nits: float) -> Gf.Vec3f:
    """Light of amber LEDs."""
    return Gf.Vec3f(*(round(nits * part, 1) for part in tint("indicator_rear")))
