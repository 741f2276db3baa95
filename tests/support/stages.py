"""Small stages as text, so that a test says what it bakes."""

from __future__ import annotations

STREET = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = {meters_per_unit}
    upAxis = "{up}"
)
def Xform "World" (
    variants = {{
        string fog = "mor150"
        string lighting = "sky"
    }}
    prepend variantSets = ["fog", "lighting"]
)
{{
    {turn}
    def Cube "Fog" (
        prepend apiSchemas = ["SynFogMediumAPI"]
    )
    {{
        uniform token purpose = "guide"
        double size = 2
        float synfog:fog:albedo = {albedo}
        double3 xformOp:translate = (0, {y_fog}, 0)
        float3 xformOp:scale = ({s_fog}, {s_fog}, {s_fog})
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
    }}
    def Mesh "Wall" (
        prepend apiSchemas = ["SemanticsLabelsAPI:cityscapes", "MaterialBindingAPI"]
    )
    {{
        token[] semantics:labels:cityscapes = ["wall"]
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(-{w}, {y_wall}, -{w}), ({w}, {y_wall}, -{w}), ({w}, {y_wall}, {w}), (-{w}, {y_wall}, {w})]
        uniform token subdivisionScheme = "none"
        rel material:binding = </World/Paint>
    }}
    def Material "Paint"
    {{
        token outputs:surface.connect = </World/Paint/Shader.outputs:surface>
        def Shader "Shader"
        {{
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor = (0, 0, 0)
            color3f inputs:emissiveColor = ({emission}, {emission}, {emission})
            float inputs:roughness = 1
            float inputs:ior = 1
            token outputs:surface
        }}
    }}
    def DomeLight "Sky"
    {{
        float inputs:intensity = {sky}
    }}
    def SphereLight "Lamp" (
        active = {lamp}
    )
    {{
        float inputs:intensity = 1000
        float inputs:radius = {r_lamp}
        double3 xformOp:translate = ({x_lamp}, {y_lamp}, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }}
    def Camera "Ego"
    {{
        float2 clippingRange = ({near}, {far})
        float focalLength = {focal}
        float horizontalAperture = {aperture}
        float verticalAperture = {aperture_v}
        float xformOp:rotateX = 90
        uniform token[] xformOpOrder = ["xformOp:rotateX"]
    }}
    variantSet "fog" = {{
        "clear" {{
            over "Fog" (
                active = false
            )
            {{
            }}
        }}
        "mor600" {{
            over "Fog"
            {{
                float synfog:fog:mor = 600
            }}
        }}
        "mor150" {{
            over "Fog"
            {{
                float synfog:fog:mor = 150
            }}
        }}
    }}
    variantSet "lighting" = {{
        "sky" {{
        }}
        "active" {{
            over "Sky"
            {{
                float inputs:exposure = -5
            }}
        }}
    }}
}}
"""


def street(
    *,
    meters_per_unit: float = 1.0,
    up: str = "Z",
    albedo: float = 1.0,
    emission: float = 0.0,
    sky: float = 1000.0,
    lamp: bool = False,
    fov_x_deg: float = 40.0,
) -> str:
    """A camera in a box of fog looks north at a wall 50 m away, under a uniform sky.

    The same world in any unit and up axis: lengths are divided by `meters_per_unit`,
    and for 'Y' everything under /World is turned.
    """
    import math

    k = 1.0 / meters_per_unit
    focal_m = 0.035
    aperture_m = 2 * focal_m * math.tan(math.radians(fov_x_deg) / 2)
    turn = 'float xformOp:rotateX = -90\n    uniform token[] xformOpOrder = ["xformOp:rotateX"]' if up == "Y" else ""
    return STREET.format(
        **dict(meters_per_unit=meters_per_unit, up=up, turn=turn, albedo=albedo, emission=emission, sky=sky),
        **dict(lamp="true" if lamp else "false", y_fog=20 * k, s_fog=200 * k, w=10 * k, y_wall=50 * k),
        **dict(r_lamp=0.5 * k, x_lamp=-5 * k, y_lamp=30 * k, near=0.1 * k, far=1000 * k),
        focal=focal_m * k * 10,  # tenths of a unit
        **dict(aperture=aperture_m * k * 10, aperture_v=aperture_m * 9 / 16 * k * 10),
    )


def rig_stage(folder, *, right=(0.5, 0.0, 0.0), turn_deg=0.0, name="rig"):
    """The street, its camera `Ego`, and beside it `Rig/Right`, moved by `right` [m] and turned about the vertical."""
    text = street(sky=300.0, emission=100.0)
    begin = text.index('    def Camera "Ego"')
    end = text.index("    variantSet", begin)
    eye = text[begin:end].replace('"Ego"', '"Right"')
    eye = eye.replace("float xformOp:rotateX = 90", f"float3 xformOp:rotateXYZ = (90, 0, {turn_deg})")
    ops = f'double3 xformOp:translate = {right}\n uniform token[] xformOpOrder = ["xformOp:translate", '
    eye = eye.replace('uniform token[] xformOpOrder = ["xformOp:rotateX"]', f'{ops}"xformOp:rotateXYZ"]')
    path = folder / f"{name}.usda"
    path.write_text(text[:end] + f'    def Xform "Rig" {{\n{eye}    }}\n' + text[end:])
    return path
