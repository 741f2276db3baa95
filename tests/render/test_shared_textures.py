"""One picture in many surfaces: its file is decoded once a bake, and there is one array, and one copy of the
renderer's, of each thing that is made of it.
"""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from synfog_usd.dataset.bake import bake
from synfog_usd.dataset.plan import BakePlan
from synfog_usd.render import load, surface
from synfog_usd.scene import texels
from synfog_usd.stage import open_stage
from synfog_usd.translate import texture, translate

HEAD = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Z"
)
def Xform "World" (
    variants = {
        string lighting = "day"
    }
    prepend variantSets = "lighting"
)
{
    def Camera "Ego"
    {
        float focalLength = 24
        double3 xformOp:translate = (4, -4, 1)
        double3 xformOp:rotateXYZ = (90, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]
    }
    def DomeLight "Sky"
    {
    }
    variantSet "lighting" = {
        "day" {
            over "Sky"
            {
                float inputs:intensity = 1000
            }
        }
        "dusk" {
            over "Sky"
            {
                float inputs:intensity = 300
            }
        }
    }
"""
SURFACE = """
    def Mesh "Wall{n}" (
        prepend apiSchemas = ["MaterialBindingAPI"]
    )
    {{
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [({x}, 10, 0), ({y}, 10, 0), ({y}, 10, 2), ({x}, 10, 2)]
        texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (
            interpolation = "vertex"
        )
        uniform token subdivisionScheme = "none"
        rel material:binding = </World/Paint{n}>
    }}
    def Material "Paint{n}"
    {{
        token outputs:surface.connect = </World/Paint{n}/Surface.outputs:surface>
        def Shader "Surface"
        {{
            uniform token info:id = "UsdPreviewSurface"
            float inputs:ior = 1.4{n}
            {inputs}
            token outputs:surface
        }}
        def Shader "Picture"
        {{
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @./picture.png@
            float2 inputs:st.connect = </World/Paint{n}/Reader.outputs:result>
            float3 outputs:rgb
            float outputs:g
        }}
        def Shader "Normals"
        {{
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @./picture.png@
            token inputs:sourceColorSpace = "raw"
            float4 inputs:scale = (2, 2, 2, 1)
            float4 inputs:bias = (-1, -1, -1, 0)
            float2 inputs:st.connect = </World/Paint{n}/Reader.outputs:result>
            float3 outputs:rgb
        }}
        def Shader "Reader"
        {{
            uniform token info:id = "UsdPrimvarReader_float2"
            string inputs:varname = "st"
            float2 outputs:result
        }}
    }}
"""
INPUTS = """color3f inputs:diffuseColor.connect = </World/Paint{n}/Picture.outputs:rgb>
            color3f inputs:emissiveColor.connect = </World/Paint{n}/Picture.outputs:rgb>
            float inputs:roughness.connect = </World/Paint{n}/Picture.outputs:g>
            normal3f inputs:normal.connect = </World/Paint{n}/Normals.outputs:rgb>"""


@pytest.fixture
def stage(tmp_path) -> Path:
    """Four walls, each with a material of its own, whose colour, light, roughness and normals are one picture."""
    noise = np.random.default_rng(0).integers(40, 255, (12, 16, 3), dtype=np.uint8)
    Image.fromarray(noise).save(tmp_path / "picture.png")
    parts = [SURFACE.format(n=n, x=2 * n, y=2 * n + 2, inputs=INPUTS.format(n=n)) for n in range(4)]
    path = tmp_path / "walls.usda"
    path.write_text(HEAD + "".join(parts) + "}\n")
    return path


def textures(value):
    """Every texture of a part of a scene, by the name under which it stands."""
    for name, item in value.items():
        if isinstance(item, dict):
            if item.get("type") == "bitmap":
                yield name, item
            yield from textures(item)


def test_sixteen_uses_of_a_picture_have_four_arrays(stage):
    """One of each kind of use, whichever material asks: colours as they stand in the file, and numbers."""
    found = [(name, item["bitmap"]) for name, item in textures(translate(open_stage(stage)).world)]
    assert sorted({name for name, _ in found}) == ["base_color", "normalmap", "radiance", "roughness"]
    assert len(found) >= 16
    for name in ("base_color", "normalmap", "radiance", "roughness"):
        assert len({id(pixels) for what, pixels in found if what == name}) == 1, name


def test_sixteen_uses_of_a_picture_are_handed_to_the_renderer_four_times(stage, monkeypatch):
    """Each copy is as large as the picture in float, so sixteen of a large one fill a machine."""
    scene, handed, before = translate(open_stage(stage)), [], load._leaf
    monkeypatch.setattr(load, "_leaf", lambda mi, name, value: (handed.append(name), before(mi, name, value))[1])
    load.to_mitsuba(scene)
    assert handed.count("bitmap") == 4
    colour = next(item for name, item in textures(scene.world) if name == "base_color")
    colour["to_uv"] = np.array([[1.0, 0.0, 1e-7], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])  # another place, by a hair
    handed.clear()
    load.to_mitsuba(scene)
    assert handed.count("bitmap") == 5


def test_a_file_is_decoded_once_a_bake(stage, tmp_path, monkeypatch):
    """Each of its two lightings is translated anew."""
    decoded, before = [], texture.ImageReader._decode
    monkeypatch.setattr(texture.ImageReader, "_decode", lambda *words: (decoded.append(words[2]), before(*words))[1])
    plan = BakePlan(stage=stage, out=tmp_path / "out", size=(24, 14), samples=2, model="single", quality="reference")
    made = bake(plan)
    assert len({shot["lighting"] for shot in made.manifest["shots"]}) == 2
    assert decoded == [str(stage.parent / "picture.png")]


def test_a_picture_of_several_joined_surfaces_is_packed_once():
    """The third surface has the first's picture: its texels are those, and the second's lie between."""
    rng = np.random.default_rng(1)
    first, second = (rng.integers(0, 255, shape, dtype=np.uint8) for shape in ((5, 7, 3), (4, 3, 3)))
    colours = [{"type": "bitmap", "bitmap": pixels, "raw": False} for pixels in (first, second, first)]
    parts = [{"type": surface.TYPE, "base_color": colour, "roughness": 0.5} for colour in colours]
    made = surface.together(parts, np.zeros(8, dtype=np.uint32))
    assert made["begin_of_row"][:3].tolist() == [0, first[..., 0].size, 0]
    held = made["texels"].view("<u2").reshape(-1, 4)[:, :3]
    assert len(held) == first[..., 0].size + second[..., 0].size
    truth = np.concatenate([texels(colour).reshape(-1, 3) for colour in colours[:2]])
    np.testing.assert_allclose((held / 65535.0) ** 2, truth, atol=2.0 / 65535.0)  # half a code of the root
