"""What ships is drawn as it was meant: its translation has nothing to tell."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom

from synfog_usd.stage import open_stage, select, variants
from synfog_usd.translate import translate
from synfog_usd.world.components import author_mesh
from synfog_usd.world.compose import compose
from synfog_usd.world.shapes import Part

ROOT = Path(__file__).resolve().parents[2]
RECIPES = sorted(path.stem for path in (ROOT / "stages" / "recipes").glob("*.yaml"))


def told(path: Path, fog: str) -> set[str]:
    """All notes of a stage in one of its fogs."""
    stage = open_stage(path, allow=[ROOT / "assets"])
    select(stage, fog=fog)
    return {f"{note.path}: {note.text}" for note in translate(stage).notes}


@pytest.mark.slow
def test_the_crossing_is_translated_without_a_remark():
    """A model that says less than what is drawn of it (a pane, a normal without length) would be told of."""
    assert told(ROOT / "stages" / "crossroads.usda", "mor150") == set()


@pytest.mark.slow
@pytest.mark.parametrize("name", RECIPES)
def test_a_world_of_a_shipped_recipe_is_translated_without_a_remark(name, tmp_path):
    """In its thickest fog, as `synfog-usd compose stages/recipes/NAME.yaml --seed 5` draws it."""
    path = tmp_path / f"{name}.usda"
    compose(ROOT / "stages" / "recipes" / f"{name}.yaml", path, seed=5)
    fogs = [fog for fog in variants(open_stage(path, allow=[ROOT / "assets"]))["fog"] if fog != "clear"]
    assert told(path, min(fogs, key=lambda fog: float(fog.removeprefix("mor")))) == set()


@pytest.mark.slow
def test_every_point_of_a_model_is_of_a_face_and_every_normal_has_a_length():
    """All levels of detail, all individuals: also those that no recipe happens to place."""
    files = sorted((ROOT / "assets" / "models").rglob("*.geo.usdc"))
    assert len(files) > 60
    for file in files:
        stage = Usd.Stage.Open(str(file))
        for mesh in (UsdGeom.Mesh(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)):
            place = f"{file.name} {mesh.GetPath()}"
            faces, points = mesh.GetFaceVertexIndicesAttr().Get(), mesh.GetPointsAttr().Get()
            assert len(np.unique(np.asarray(faces))) == len(points), place
            normals = mesh.GetNormalsAttr().Get()
            assert normals is None or np.asarray(normals).any(axis=1).all(), place


def test_a_part_of_which_no_face_is_left_is_a_mesh_without_points():
    """Parts smaller than a tenth of a millimetre become that when they are thinned."""
    part = Part(np.zeros((2, 3)), np.array([[0, 0, 1]]), "paint", normals=np.zeros((2, 3)))
    stage = Usd.Stage.CreateInMemory()
    mesh = author_mesh(stage, Sdf.Path("/Dot"), part)
    assert len(mesh.GetPointsAttr().Get()) == len(mesh.GetFaceVertexCountsAttr().Get()) == 0
