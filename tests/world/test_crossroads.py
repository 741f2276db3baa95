"""The demo crossing: what it holds, that it is well-formed, and that nothing floats, overlaps or changes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux
from support.outlines import apart, assert_whole, heights

from assets.builders import crossing
from synfog_usd.base.cityscapes import LABELS
from synfog_usd.translate import ies

ROOT = Path(__file__).resolve().parents[2]
STAGE = ROOT / "stages" / "crossroads.usda"


def opened(fog: str = "clear", lighting: str = "sky") -> Usd.Stage:
    stage = Usd.Stage.Open(str(STAGE))
    stage.SetEditTarget(stage.GetSessionLayer())  # layers are shared between the stages of a process
    sets = stage.GetDefaultPrim().GetVariantSets()
    sets.GetVariantSet("fog").SetVariantSelection(fog)
    sets.GetVariantSet("lighting").SetVariantSelection(lighting)
    return stage


@pytest.fixture(scope="module")
def day() -> Usd.Stage:
    return opened()


@pytest.fixture(scope="module")
def dusk() -> Usd.Stage:
    return opened("mor150", "active")


def everything(stage: Usd.Stage) -> list[Usd.Prim]:
    return list(Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()))


def of_group(stage: Usd.Stage, group: str) -> list[Usd.Prim]:
    return list(stage.GetPrimAtPath(f"/World/{group}").GetChildren())


def footprint(prim: Usd.Prim) -> np.ndarray:
    """(4, 2) corners on the ground of the box around a prim in its own axes."""
    cache = UsdGeom.BBoxCache(Usd.TimeCode.Default(), ["default", "render"])
    bound = cache.ComputeUntransformedBound(prim).ComputeAlignedRange()
    low, high = bound.GetMin(), bound.GetMax()
    place = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
    return np.array(
        [
            tuple(place.Transform(Gf.Vec3d(x, y, 0)))[:2]
            for x, y in ((low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1]))
        ]
    )


def ground_triangles(stage: Usd.Stage) -> np.ndarray:
    """(N, 3, 3) triangles of road and pavement."""
    found = []
    for name in ("Road", "Pavement"):
        for prim in Usd.PrimRange(stage.GetPrimAtPath(f"/World/Ground/{name}")):
            if prim.IsA(UsdGeom.Mesh):
                mesh = UsdGeom.Mesh(prim)
                found.append(
                    np.array(mesh.GetPointsAttr().Get())[np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)]
                )
    return np.concatenate(found).astype(np.float64)


def test_the_stage_is_whole_labelled_and_valid(day):
    """And no label anywhere is a word of its own."""
    assert_whole(STAGE, least=200)
    labels = (prim.GetAttribute("semantics:labels:cityscapes") for prim in everything(day))
    assert {word for one in labels if one.IsValid() for word in one.Get()} <= {*LABELS}


def test_nothing_floats_or_sinks(day):
    """Lowest point of vehicles and walkers within 2 cm of the ground under it."""
    triangles = ground_triangles(day)
    cache = UsdGeom.BBoxCache(Usd.TimeCode.Default(), ["default", "render"])
    for prim in [*of_group(day, "Vehicles"), *of_group(day, "People"), *of_group(day, "Furniture")]:
        if prim.GetName().startswith("Rider"):
            continue
        x, y, _ = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default()).ExtractTranslation()
        if prim.GetTypeName() == "PointInstancer":
            continue
        lowest = cache.ComputeWorldBound(prim).ComputeAlignedRange().GetMin()[2]
        assert abs(lowest - heights(triangles, x, y)[-1]) < 0.02, prim.GetPath()


def test_vehicles_do_not_overlap(day):
    prints = {str(p.GetPath()): footprint(p) for p in of_group(day, "Vehicles")}
    names = list(prints)
    for i, one in enumerate(names):
        for other in names[i + 1 :]:
            assert apart(prints[one], prints[other]) > 0.1, (one, other)


def test_nobody_stands_in_a_vehicle_or_a_wall(day):
    solid = [(footprint(p), 0.0) for p in of_group(day, "Vehicles") if "Bicycle" not in p.GetName()]
    solid += [
        (footprint(p), -1.35) for p in of_group(day, "Buildings")
    ]  # awnings and balconies reach over the pavement
    for prim in of_group(day, "People"):
        x, y, _ = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default()).ExtractTranslation()
        body = np.array([(x - 0.2, y - 0.2), (x + 0.2, y - 0.2), (x + 0.2, y + 0.2), (x - 0.2, y + 0.2)])
        assert all(apart(body, s) > gap for s, gap in solid), prim.GetPath()


@pytest.mark.parametrize("name, mor", [("mor600", 600.0), ("mor300", 300.0), ("mor150", 150.0)])
def test_fog_variant_says_how_far_one_sees(name, mor):
    stage = opened(name)
    fog = stage.GetPrimAtPath("/World/Fog/Global")
    assert fog.GetAttribute("synfog:fog:mor").Get() == mor
    assert fog.GetAttribute("synfog:fog:g").Get() == pytest.approx(0.87)
    assert "SynFogMediumAPI" in fog.GetPrimTypeInfo().GetAppliedAPISchemas()
    assert UsdGeom.Imageable(fog).ComputePurpose() == "guide"


def test_clear_variant_has_no_fog(day):
    assert not day.GetPrimAtPath("/World/Fog").IsActive()


def test_nothing_but_the_sky_shines_by_day(day):
    assert [p.GetName() for p in everything(day) if p.HasAPI(UsdLux.LightAPI)] == ["Overcast"]
    glowing = [p.GetPath() for p in everything(day) if p.GetAttribute("inputs:emissiveColor").HasAuthoredValue()]
    assert glowing == []


def test_lamps_shine_at_dusk_and_are_few(dusk):
    """Each local light costs noise in every pixel; forty are the most that this stage allows itself."""
    lights = [p for p in everything(dusk) if p.HasAPI(UsdLux.LightAPI)]
    assert [p.GetName() for p in lights if p.IsA(UsdLux.DomeLight)] == ["Dusk"]
    local = [p for p in lights if not p.IsA(UsdLux.DomeLight)]
    assert 15 < len(local) < 40
    headlights = [p for p in local if p.GetName() in ("Left", "Right")]
    assert len(headlights) >= 12
    for prim in local:
        candela = UsdLux.LightAPI(prim).GetIntensityAttr().Get() * np.pi * prim.GetAttribute("inputs:radius").Get() ** 2
        if prim in headlights:  # a dipped beam of UN Regulation 112, which keeps below the horizon by itself
            file = UsdLux.ShapingAPI(prim).GetShapingIesFileAttr().Get()
            candela *= ies.parse(Path(file.resolvedPath).read_bytes(), file.path).candela.max()
            place = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
            assert abs(place.TransformDir(Gf.Vec3d(0, 0, -1))[2]) < 1e-3, prim.GetPath()
        assert 1_000 <= candela <= 44_000, prim.GetPath()


def test_every_file_says_where_it_is_from_and_how_it_may_be_used():
    for path in [
        STAGE,
        *sorted((ROOT / "assets" / "models").glob("*/*.usda")),
        *sorted((ROOT / "assets" / "models").glob("*/*.usdc")),
    ]:
        data = Sdf.Layer.FindOrOpen(str(path)).customLayerData
        assert data == {"source": "made by synfog_usd.world", "licence": "CC0-1.0"}, path


def test_stage_is_what_the_code_writes(tmp_path):
    """Remake with `python -m assets.builders stages`."""
    (tmp_path / "assets").symlink_to(ROOT / "assets")
    assert crossing.write_stage(tmp_path / "stages" / "crossroads.usda").read_bytes() == STAGE.read_bytes()
