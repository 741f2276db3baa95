"""Draw modes: cards, bounds and origin stand for a model, where UsdGeomModelAPI says so."""

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from support.looks import fill, write

from synfog_usd.translate import translate


@pytest.fixture
def house(empty):
    """A stage with a component of 2 x 4 x 6 m around (10, 20, 30), and a function that sets its draw mode."""
    stage = empty()
    Usd.ModelAPI(UsdGeom.Xform.Define(stage, "/Town").GetPrim()).SetKind("group")
    prim = UsdGeom.Xform.Define(stage, "/Town/House").GetPrim()
    UsdGeom.XformCommonAPI(prim).SetTranslate((10, 20, 30))
    Usd.ModelAPI(prim).SetKind("component")
    cube = UsdGeom.Cube.Define(stage, "/Town/House/Body")
    cube.AddScaleOp().Set((1, 2, 3))

    def draw(path="/Town/House", **said):
        model = UsdGeom.ModelAPI.Apply(stage.GetPrimAtPath(path))
        for name, value in said.items():
            attribute = getattr(model, f"Create{name[0].upper()}{name[1:]}Attr")()
            attribute.Set(value)
        scene = translate(stage)
        return scene, [part for key, part in scene.world.items() if key.startswith("shape_")]

    return stage, draw


def box(shapes, scene):
    """Corners of the box around shapes, on the stage."""
    points = np.concatenate([shape["positions"] for shape in shapes]).astype(np.float64) + scene.origin_m
    return np.array([points.min(axis=0), points.max(axis=0)])


def test_bounds_are_the_edges_of_the_box(house):
    """Twelve bars, whose middle lines are the box's edges; in the draw mode's colour."""
    _, draw = house
    scene, (shape,) = draw(modelDrawMode="bounds", modelDrawModeColor=(0.1, 0.2, 0.3))
    assert len(shape["faces"]) == 12 * 12
    width = np.sqrt(2**2 + 4**2 + 6**2) / 200
    np.testing.assert_allclose(
        box([shape], scene), [np.array([9, 18, 27]) - width / 2, np.array([11, 22, 33]) + width / 2], atol=1e-5
    )
    np.testing.assert_allclose(scene.world[shape["bsdf"]["id"]]["bsdf"]["reflectance"]["value"], [0.1, 0.2, 0.3])


@pytest.mark.parametrize("kind, apart", [("cross", 0.0), ("box", 1.0)])
def test_cards_cross_the_model_or_lie_on_its_box(house, kind, apart):
    """Six quads of the size of its faces, and all of one colour where there is no picture."""
    _, draw = house
    scene, shapes = draw(modelDrawMode="cards", modelCardGeometry=kind)
    assert len(shapes) == 6
    for number, shape in enumerate(shapes):
        axis, sign = number // 2, 1 - 2 * (number % 2)
        low, high = box([shape], scene)
        size = np.array([2.0, 4.0, 6.0])
        middle = np.array([10.0, 20.0, 30.0])
        middle[axis] += sign * apart * size[axis] / 2
        size[axis] = 0.0
        np.testing.assert_allclose((low + high) / 2, middle, atol=1e-3)
        np.testing.assert_allclose(high - low, size, atol=1e-3)
        a, b, c = shape["positions"][shape["faces"][0]].astype(np.float64)
        assert np.sign(np.cross(b - a, c - a)[axis]) == sign


def test_a_picture_stands_upright_and_is_seen_through_from_behind(house, tmp_path):
    """A picture for -Y alone: its left edge is at small x on both sides, its top at large z."""
    _, draw = house
    codes = np.zeros((2, 2, 4), dtype=np.uint8)
    codes[..., 3] = [[255, 255], [255, 0]]
    codes[..., 0] = [[10, 20], [30, 40]]
    write(tmp_path / "card.png", codes)
    scene, shapes = draw(modelDrawMode="cards", modelCardTextureYNeg=str(tmp_path / "card.png"))
    assert len(shapes) == 2
    for shape in shapes:
        place = shape["positions"].astype(np.float64) + scene.origin_m
        np.testing.assert_allclose(shape["texcoords"][:, 0], (place[:, 0] - 9) / 2, atol=1e-5)
        np.testing.assert_allclose(shape["texcoords"][:, 1], (place[:, 2] - 27) / 6, atol=1e-5)
    bsdf = scene.world[shapes[0]["bsdf"]["id"]]
    np.testing.assert_array_equal(bsdf["opacity"]["bitmap"][..., 0], [[1, 1], [1, 0]])
    np.testing.assert_array_equal(bsdf["bsdf"]["bsdf"]["reflectance"]["bitmap"], codes[..., :3])


def test_a_mode_is_inherited_and_applied_where_it_is_asked_for(house):
    """By components that say nothing, by groups that apply it; 'default' goes back to the model."""
    stage, draw = house

    def kinds(shapes):
        return [len(shape["faces"]) for shape in shapes]

    assert kinds(draw("/Town", modelDrawMode="bounds")[1]) == [144]
    assert kinds(draw("/Town/House", modelDrawMode="default")[1]) == [12]
    assert kinds(draw("/Town/House", modelDrawMode="inherited", modelApplyDrawMode=False)[1]) == [12]
    assert kinds(draw("/Town", modelApplyDrawMode=True)[1]) == [144]
    Usd.ModelAPI(stage.GetPrimAtPath("/Town")).SetKind("")
    assert kinds(draw("/Town")[1]) == [12]


def test_instances_are_replaced_too(house):
    """A native instance that is a component, and the prototype of an instancer."""
    stage, draw = house
    Usd.ModelAPI(stage.DefinePrim("/Town/Copy", "Xform")).SetKind("component")
    copy = stage.GetPrimAtPath("/Town/Copy")
    copy.GetReferences().AddInternalReference("/Town/House")
    copy.SetInstanceable(True)
    many = UsdGeom.PointInstancer.Define(stage, "/Town/Many")
    many.CreatePrototypesRel().SetTargets(["/Town/House"])
    fill(many, protoIndices=[0, 0], positions=[(0, 0, 0), (5, 0, 0)])
    Usd.ModelAPI(many.GetPrim()).SetKind("group")
    scene, shapes = draw("/Town", modelDrawMode="bounds")
    assert [len(shape["faces"]) for shape in shapes] == [144, 144]
    (group,) = [part for key, part in scene.world.items() if key.startswith("group_")]
    assert len(group["shape_0"]["faces"]) == 144
