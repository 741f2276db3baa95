"""Run by a Python that has USD and nothing of ours: what stands in a file, as JSON.  Argument: the file."""

import json
import sys

from pxr import Gf, Plug, Usd, UsdGeom, UsdLux


def rows(prim, cache):
    matrix = cache.GetLocalToWorldTransform(prim).GetTranspose()  # as Blender has it: points are columns
    return [[matrix[i][j] for j in range(4)] for i in range(4)]


def main(path):
    stage = Usd.Stage.Open(path)
    cache = UsdGeom.XformCache(0.0)
    found = {"cameras": {}, "lights": [], "instances": [], "points": 0, "fog": {}, "fog_attributes": {}}
    for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
        schemas = prim.GetPrimTypeInfo().GetAppliedAPISchemas()
        if prim.IsA(UsdGeom.Camera):
            angle = UsdGeom.Camera(prim).GetCamera(0.0).GetFieldOfView(Gf.Camera.FOVHorizontal)
            found["cameras"][prim.GetName()] = {"matrix": rows(prim, cache), "fov_x_deg": angle}
        elif prim.HasAPI(UsdLux.LightAPI) and prim.GetTypeName() not in ("DomeLight", "DomeLight_1"):
            found["lights"].append([row[3] for row in rows(prim, cache)[:3]])
        elif prim.IsA(UsdGeom.PointInstancer):
            found["points"] += len(UsdGeom.PointInstancer(prim).GetProtoIndicesAttr().Get())
        if prim.IsInstance() and not prim.IsInstanceProxy():
            found["instances"].append(rows(prim, cache))
        if "SynFogMediumAPI" in schemas:
            half = UsdGeom.Cube(prim).GetSizeAttr().Get() / 2.0
            matrix = cache.GetLocalToWorldTransform(prim)
            corners = [
                matrix.Transform(Gf.Vec3d(x, y, z)) for x in (-half, half) for y in (-half, half) for z in (-half, half)
            ]
            found["fog"][prim.GetName()] = [[min(axis), max(axis)] for axis in zip(*corners, strict=True)]
            found["fog_attributes"][prim.GetName()] = {
                name: prim.GetAttribute(name).Get()
                for name in prim.GetAuthoredPropertyNames()
                if name.startswith("synfog:fog:") and prim.GetAttribute(name)
            }
    found["errors"] = [str(error) for error in stage.GetCompositionErrors()]
    found["ours"] = [name for name in sys.modules if name.startswith("synfog")] + [
        one.name for one in Plug.Registry().GetAllPlugins() if "synfog" in one.name.lower()
    ]
    print(json.dumps(found, default=str))


if __name__ == "__main__":
    main(sys.argv[1])
