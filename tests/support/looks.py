"""Pictures as files, and materials of a few shaders, for stages that tests author in memory."""

from __future__ import annotations

import os

import numpy as np
import OpenImageIO
from pxr import Sdf, UsdGeom, UsdShade

TYPES = Sdf.ValueTypeNames
SQUARE = [(0, 5, 0), (1, 5, 0), (1, 5, 1), (0, 5, 1)]
"""A unit square in x and z, 5 m ahead of a camera at the origin that looks along +Y."""

KINDS = {bool: TYPES.Bool, int: TYPES.Int, float: TYPES.Float, str: TYPES.Token, Sdf.AssetPath: TYPES.Asset}


def write(path, pixels, **attributes):
    """Write (H, W, C) pixels of any type; alpha stays as it is given."""
    kind = {"float32": "float", "float16": "half"}.get(str(pixels.dtype), str(pixels.dtype))
    spec = OpenImageIO.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], kind)
    for name, value in {"oiio:UnassociatedAlpha": 1, **attributes}.items():
        spec.attribute(name, value)
    path.parent.mkdir(exist_ok=True, parents=True)
    out = OpenImageIO.ImageOutput.create(str(path))
    assert out.open(str(path), spec) and out.write_image(np.ascontiguousarray(pixels))
    out.close()


def linear(codes):
    """Light of sRGB codes from 0 to 255, by IEC 61966-2-1."""
    v = np.asarray(codes) / 255
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


def fill(schema, **values):
    """Author attributes of a schema: fill(light, radius=0.5) is light.CreateRadiusAttr(0.5); gives the schema."""
    for name, value in values.items():
        getattr(schema, f"Create{name[0].upper()}{name[1:]}Attr")(value)
    return schema


def put(shader, name, value):
    """An input of a shader: a number, a word, a path, a tuple of 2 to 4 numbers, or the output of another shader."""
    if isinstance(value, UsdShade.Output):
        shader.CreateInput(name, value.GetTypeName()).ConnectToSource(value)
    elif isinstance(value, os.PathLike):
        shader.CreateInput(name, TYPES.Asset).Set(str(value))
    elif isinstance(value, tuple):
        shader.CreateInput(name, {2: TYPES.Float2, 3: TYPES.Color3f, 4: TYPES.Float4}[len(value)]).Set(value)
    else:
        shader.CreateInput(name, KINDS[type(value)]).Set(value)


def shade(stage, path, kind, output="out", gives=TYPES.Token, **inputs):
    """Define a shader with its inputs, as `put` takes them; gives one of its outputs."""
    made = UsdShade.Shader.Define(stage, path)
    if kind:
        made.CreateIdAttr(kind)
    for name, value in inputs.items():
        put(made, name, value)
    return made.CreateOutput(output, gives)


def dress(prim, surface, path="/Material", context=""):
    """Bind a prim to a material with this surface."""
    material = UsdShade.Material.Define(prim.GetStage(), path)
    material.CreateSurfaceOutput(context).ConnectToSource(surface)
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(material)
    return material


def painted(prim, path="/Material", **inputs):
    """Bind a prim to a preview surface with these inputs."""
    stage = prim.GetStage()
    return dress(prim, shade(stage, f"{path}/Surface", "UsdPreviewSurface", "surface", **inputs), path)


def picture_of(stage, file, varname="st", path="/Material", **inputs):
    """Colour of a picture that is looked up by a primvar."""
    st = shade(stage, f"{path}/Reader", "UsdPrimvarReader_float2", "result", TYPES.Float2, varname=varname)
    return shade(stage, f"{path}/Picture", "UsdUVTexture", "rgb", TYPES.Float3, file=file, st=st, **inputs)


def with_st(mesh, values=((0, 0), (1, 0), (1, 1), (0, 1)), name="st", interpolation="vertex"):
    """Give a mesh texture coordinates."""
    UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(name, TYPES.TexCoord2fArray, interpolation).Set(list(values))
    return mesh
