"""Thousands of shapes in one place are not drawn, and what is told of them."""

from pxr import Gf, Sdf, UsdGeom, Vt
from support.looks import fill

from synfog_usd.translate import translate
from synfog_usd.translate.twins import MOST


def cubes(stage, places):
    for number, place in enumerate(places):
        UsdGeom.Cube.Define(stage, f"/Cube{number}").AddTranslateOp().Set(Gf.Vec3d(*place))


def drawn(scene, kind="shape_"):
    return [part for key, part in scene.world.items() if key.startswith(kind)]


def told(scene):
    return [note for note in scene.notes if "lie exactly on" in note.text]


def test_cubes_in_one_place_are_drawn_up_to_a_number(empty):
    """Forty in one place, two in each of forty others, and forty that lie a tenth of a millimetre apart."""
    stage = empty()
    apart = [(x, 20.0, 0.0) for x in range(40)]
    close = [(x * 1e-4, 40.0, 0.0) for x in range(40)]
    cubes(stage, [(0.0, 10.0, 0.0)] * 40 + apart + apart + close)
    scene = translate(stage)
    assert len(drawn(scene)) == MOST + 80 + 40
    (note,) = told(scene)
    assert note.severity == "warning" and note.path == f"/Cube{MOST}" and note.text.startswith(f"{40 - MOST} prims")


def test_instances_in_one_place_are_drawn_up_to_a_number(empty):
    stage = empty()
    instancer = UsdGeom.PointInstancer.Define(stage, "/Many")
    UsdGeom.Cube.Define(stage, "/Many/Cube")
    instancer.CreatePrototypesRel().SetTargets([Sdf.Path("/Many/Cube")])
    fill(instancer, protoIndices=[0] * 60, positions=Vt.Vec3fArray([(0, 10, 0)] * 50 + [(x, 20, 0) for x in range(10)]))
    scene = translate(stage)
    assert len(drawn(scene, "instance_")) == MOST + 10
    assert [note.text.split()[0] for note in told(scene)] == [str(50 - MOST)]
