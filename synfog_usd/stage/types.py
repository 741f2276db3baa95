"""Attributes of another type than their schema's: USD reads them, and whatever asks for their value falls over it.

Takes a stage; gives such attributes.  Asked only after something failed, so
that good stages do not pay for it.
"""

from __future__ import annotations

from collections.abc import Iterator

from pxr import Sdf, Sdr, Tf, Usd, UsdShade

from synfog_usd.stage.schema import API_NAME

_ALSO = ("LightAPI", "ShapingAPI", "ShadowAPI", "MeshLightAPI", "GeomModelAPI", "MotionAPI", API_NAME)
"""Schemas whose attributes count where nobody applied them."""

_PRIMVARS = {
    "primvars:displayColor": Sdf.ValueTypeNames.Color3fArray,
    "primvars:displayOpacity": Sdf.ValueTypeNames.FloatArray,
    "primvars:normals": Sdf.ValueTypeNames.Normal3fArray,
    "primvars:st": Sdf.ValueTypeNames.TexCoord2fArray,
}


def mistyped(stage: Usd.Stage) -> Iterator[str]:
    """Attributes that cannot stand for what their schemas want, as '/Lamp.inputs:width is a token[], and a float is
    wanted'.
    """
    registry = Usd.SchemaRegistry()
    applied = [schema for name in _ALSO if (schema := registry.FindAppliedAPIPrimDefinition(name)) is not None]
    for prim in _prims(stage):
        inputs = _shader_inputs(prim)
        for attribute in prim.GetAuthoredAttributes():
            name, path = attribute.GetName(), attribute.GetPath()
            kind = _authored_type(attribute)
            expected = _PRIMVARS.get(name) or inputs.get(name)
            for definition in [] if expected else [prim.GetPrimDefinition(), *applied]:
                spec = definition.GetSchemaAttributeSpec(name) or definition.GetSchemaAttributeSpec(
                    name.replace("userProperties:synfog_", "synfog:fog:")
                )
                if spec:
                    expected = spec.typeName
                    break
            if _shape(kind)[1] == "unknown":
                yield f"{path} is of a type that USD does not know, and one that it knows is wanted"
            elif isinstance(attribute.Get(Usd.TimeCode.EarliestTime()), Sdf.Path):  # parsed as a value of any type
                yield f"{path} holds a path, and a {expected or kind} is wanted"
            elif expected and _shape(kind) != _shape(expected):
                yield f"{path} is a {kind}, and a {expected} is wanted"


def _prims(stage: Usd.Stage) -> Iterator[Usd.Prim]:
    yield from Usd.PrimRange(stage.GetPseudoRoot(), Usd.PrimAllPrimsPredicate)
    for prototype in stage.GetPrototypes():
        yield from Usd.PrimRange(prototype)


def _authored_type(attribute: Usd.Attribute) -> Sdf.ValueTypeName:
    """The type where the value stands; the attribute itself always claims its schema's."""
    specs = [
        spec
        for spec in attribute.GetPropertyStack(Usd.TimeCode.EarliestTime())
        if spec.HasDefaultValue() or spec.HasInfo("timeSamples")
    ]
    return specs[0].typeName if specs else attribute.GetTypeName()


def _shader_inputs(prim: Usd.Prim) -> dict[str, Sdf.ValueTypeName]:
    """Types of the inputs of a shader that USD knows."""
    name = UsdShade.Shader(prim).GetIdAttr().Get() if prim.GetTypeName() == "Shader" else None
    node = Sdr.Registry().GetShaderNodeByIdentifier(name) if isinstance(name, str) else None
    if not node:
        return {}
    return {
        f"inputs:{name}": node.GetShaderInput(name).GetTypeAsSdfType().GetSdfType()
        for name in node.GetShaderInputNames()
    }


def _shape(kind: Sdf.ValueTypeName) -> tuple[bool, str]:
    """Array or not, and what one value is: numbers of any precision are alike, and vectors of any meaning."""
    if not kind or kind.type == Tf.Type.Unknown:  # asked for its default, such a type takes the process down
        return False, "unknown"
    name = type(kind.scalarType.defaultValue).__name__
    if name in ("bool", "int", "float"):
        return kind.isArray, "number"
    return kind.isArray, name.rstrip("dfhi") if name.startswith(("Vec", "Quat", "Matrix")) else name
