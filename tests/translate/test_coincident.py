"""Coincident faces: what counts as such, and that no shipped stage has any."""

from pathlib import Path

import numpy as np
import pytest

from synfog_usd import stage as usd
from synfog_usd.scene import Camera, Instance, SceneDict
from synfog_usd.translate import coincident as faces
from synfog_usd.translate import translate
from synfog_usd.translate.coincident import coincident

ROOT = Path(__file__).resolve().parents[2]
QUICK = ("bridge",)
STAGES = sorted((ROOT / "stages").glob("*.usda")) + sorted((ROOT / "stages" / "bench").glob("*.usda"))


def square(material, *, at=(0.0, 0.0, 0.0), turned=False, size=1.0):
    """A square of side `size` [m] in the plane z = at[2], facing up, or down where `turned`."""
    corners = size * np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], dtype=np.float32) + np.float32(at)
    faces = np.array([(0, 1, 2), (0, 2, 3)], dtype=np.uint32)
    return {
        "type": "mesh",
        "positions": corners,
        "faces": faces[:, ::-1] if turned else faces,
        "bsdf": {"type": "ref", "id": material},
    }


def scene(*meshes):
    world = {f"shape_{index}": mesh for index, mesh in enumerate(meshes)}
    camera = Camera("/Eye", np.eye(4), 4, 4, 60.0)
    instances = tuple(Instance(index + 1, f"/Part{index}", "unlabeled") for index in range(len(meshes)))
    return SceneDict(
        {"type": "scene", **world},
        camera,
        instances=instances,
        instance_of={(key,): index + 1 for index, key in enumerate(world)},
    )


def test_overlapping_faces_of_two_materials_are_found_with_their_prims_and_place():
    (one,) = coincident(scene(square("a"), square("b", at=(0.5, 0.25, 0.0))))
    assert (one.one, one.other) == ("/Part0", "/Part1") and one.faces >= 2
    assert np.all(np.array(one.place) >= -1e-6) and np.all(np.array(one.place) <= 1.0)


@pytest.mark.parametrize(
    "other",
    [
        square("b", at=(0.0, 0.0, 1e-3)),
        square("a", at=(0.5, 0.0, 0.0)),
        square("b", at=(1.0, 0.0, 0.0)),
        square("b", at=(0.5, 0.0, 0.0), turned=True),
        square("b", at=(0.999, 0.0, 0.0)),
    ],
    ids=["a millimetre above", "the same material", "a shared edge", "back to back", "an edge's width"],
)
def test_what_no_ray_can_mistake_is_no_finding(other):
    assert coincident(scene(square("a"), other)) == []


def leaning(material, slope, *, at=(0.0, 0.0, 0.0)):
    """A square whose height grows by `slope` along x."""
    mesh = square(material, at=at)
    mesh["positions"][:, 2] += np.float32(slope) * mesh["positions"][:, 0]
    return mesh


def test_planes_that_cross_are_not_in_one_another():
    """Two that lean by 1/100 and meet along a line; and the same, if they lean alike."""
    assert coincident(scene(square("a"), leaning("b", 0.01, at=(-0.5, 0.0, 0.0)))) == []
    assert len(coincident(scene(leaning("a", 0.01), leaning("b", 0.01, at=(-0.5, 0.0, 0.0))))) == 1


@pytest.mark.parametrize("away, found", [(1.0, 1), (4.0, 1), (6.0, 0), (50.0, 0)])
def test_a_strip_under_a_milliradian_is_no_finding(away, found):
    """Two squares that share 5 mm, which is a milliradian at 5 m."""
    one, other = square("a", at=(-0.995, 0.0, away)), square("b", at=(0.0, 0.0, away))
    assert len(coincident(scene(one, other))) == found


@pytest.mark.parametrize("tilt", [0.0, 0.3, 1.1])
@pytest.mark.parametrize("away", [0.0, 12.6, 37.13])
def test_neither_slant_nor_distance_hides_them(tilt, away):
    """Planes at any angle and up to 40 m from the origin, where single precision has steps of 4 um."""
    c, s = np.cos(tilt), np.sin(tilt)
    turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    one, other = square("a"), square("b", at=(0.3, 0.2, 0.0), size=0.5)
    for mesh in (one, other):
        mesh["positions"] = ((mesh["positions"] + np.float32([away, -away / 2, away / 3])) @ turn.T).astype(np.float32)
    assert len(coincident(scene(one, other))) == 1


def test_instances_are_looked_at_in_their_places(monkeypatch):
    """Two squares of a group, mirrored onto each other by their instances: back to back as they are modelled,
    coincident as they stand; not looked at where a scene has too many instances.
    """
    mirror = np.diag([1.0, 1.0, -1.0, 1.0])
    groups = {f"group_{name}": {"type": "shapegroup", "shape": square(name)} for name in "ab"}
    places = {
        f"instance_{index}": {"type": "instance", "group": {"type": "ref", "id": f"group_{name}"}, "to_world": matrix}
        for index, (name, matrix) in enumerate((("a", np.eye(4)), ("b", mirror)))
    }
    stood = SceneDict({"type": "scene", **groups, **places}, Camera("/Eye", np.eye(4), 4, 4, 60.0))
    assert coincident(stood) == []
    places["instance_1"]["to_world"] = mirror @ np.diag([-1.0, 1.0, 1.0, 1.0]) @ np.diag([-1.0, 1.0, -1.0, 1.0])
    assert len(coincident(SceneDict({"type": "scene", **groups, **places}, Camera("/Eye", np.eye(4), 4, 4, 60.0)))) == 1
    monkeypatch.setattr(faces, "MOST_PLACED", 1)
    assert coincident(SceneDict({"type": "scene", **groups, **places}, Camera("/Eye", np.eye(4), 4, 4, 60.0))) == []


@pytest.mark.parametrize(
    "stage", [pytest.param(path, marks=[pytest.mark.slow] * (path.stem not in QUICK), id=path.stem) for path in STAGES]
)
def test_no_shipped_stage_has_coincident_faces(stage):
    """Where there are any, coherent and incoherent rays choose differently: a block of the crossing differed by 19
    %.
    """
    assert coincident(translate(usd.open_stage(stage))) == []
