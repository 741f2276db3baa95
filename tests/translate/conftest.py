import pytest
from pxr import Gf, Usd, UsdGeom


@pytest.fixture
def empty():
    """Make a stage in metres, Z up, with a camera at (0, 0, 0) that looks along +Y."""

    def make(*, up="Z", metres_per_unit=1.0):
        stage = Usd.Stage.CreateInMemory()
        UsdGeom.SetStageUpAxis(stage, up)
        UsdGeom.SetStageMetersPerUnit(stage, metres_per_unit)
        camera = UsdGeom.Camera.Define(stage, "/Camera")
        if up == "Z":
            camera.AddTransformOp().Set(Gf.Matrix4d().SetRotate(Gf.Rotation((1, 0, 0), 90.0)))
        return stage

    return make


@pytest.fixture
def polygon_mesh():
    """Define a polygon mesh, subdivision 'none'."""

    def define(stage, path, points, counts, indices):
        mesh = UsdGeom.Mesh.Define(stage, path)
        mesh.CreatePointsAttr(points)
        mesh.CreateFaceVertexCountsAttr(counts)
        mesh.CreateFaceVertexIndicesAttr(indices)
        mesh.CreateSubdivisionSchemeAttr("none")
        return mesh

    return define


@pytest.fixture
def only_shape():
    """The one shape of a scene."""

    def get(scene):
        shapes = [part for key, part in scene.world.items() if key.startswith("shape_")]
        assert len(shapes) == 1
        return shapes[0]

    return get
