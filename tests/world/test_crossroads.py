"""The demo crossing: what it holds, that it is well-formed, and that nothing floats, overlaps or changes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenImageIO
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdValidation

from assets.builders import buildings, crossing, furniture, ground, noise, skies, solids, textures
from synfog_usd.base.seeds import stream
from synfog_usd.translate import ies
from synfog_usd.world import shapes
from synfog_usd.world.components import write_component

ROOT = Path(__file__).resolve().parents[2]
STAGE = ROOT / "stages" / "crossroads.usda"
CITYSCAPES = {
    "road",
    "sidewalk",
    "building",
    "wall",
    "fence",
    "pole",
    "traffic light",
    "traffic sign",
    "vegetation",
    "terrain",
    "sky",
    "person",
    "rider",
    "car",
    "truck",
    "bus",
    "train",
    "motorcycle",
    "bicycle",
    "static",
    "dynamic",
    "ground",
}


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


def apart(a: np.ndarray, b: np.ndarray) -> float:
    """Largest gap [m] between two rectangles along their sides; negative where they overlap."""
    gaps = []
    for corners in (a, b):
        for edge in (corners[1] - corners[0], corners[3] - corners[0]):
            axis = edge / np.linalg.norm(edge)
            p, q = a @ axis, b @ axis
            gaps.append(max(q.min() - p.max(), p.min() - q.max()))
    return max(gaps)


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


def height_below(triangles: np.ndarray, x: float, y: float) -> float:
    """Highest ground under a point [m]."""
    a, b, c = (triangles[:, i] for i in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    solid = np.abs(area) > 1e-9
    a, b, c, area = a[solid], b[solid], c[solid], area[solid]
    u = ((x - a[:, 0]) * (c[:, 1] - a[:, 1]) - (y - a[:, 1]) * (c[:, 0] - a[:, 0])) / area
    v = ((b[:, 0] - a[:, 0]) * (y - a[:, 1]) - (b[:, 1] - a[:, 1]) * (x - a[:, 0])) / area
    under = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9)
    z = a[:, 2] + u * (b[:, 2] - a[:, 2]) + v * (c[:, 2] - a[:, 2])
    return float(z[under].max())


@pytest.mark.parametrize("fog, lighting", [("clear", "sky"), ("mor300", "sky"), ("mor150", "active")])
def test_stage_composes_without_errors(fog, lighting):
    assert opened(fog, lighting).GetCompositionErrors() == []


@pytest.mark.parametrize("lighting", ["sky", "active"])
def test_every_validator_of_usd_is_content(lighting):
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    errors = UsdValidation.ValidationContext(validators).Validate(opened("mor300", lighting))
    assert [e.GetMessage() for e in errors] == []


def test_every_component_has_an_official_label(day):
    components = [p for p in everything(day) if Usd.ModelAPI(p).GetKind() == "component"]
    assert len(components) > 200
    for prim in components:
        assert next(iter(prim.GetAttribute("semantics:labels:cityscapes").Get())) in CITYSCAPES, prim.GetPath()
    for prim in everything(day):
        attribute = prim.GetAttribute("semantics:labels:cityscapes")
        assert not attribute.IsValid() or set(attribute.Get()) <= CITYSCAPES, prim.GetPath()


def test_a_rider_and_the_bicycle_below_are_two_things(day):
    rider, bicycle = day.GetPrimAtPath("/World/People/Rider_1"), day.GetPrimAtPath("/World/Vehicles/Bicycle_1")
    assert list(rider.GetAttribute("semantics:labels:cityscapes").Get()) == ["rider"]
    assert list(bicycle.GetAttribute("semantics:labels:cityscapes").Get()) == ["bicycle"]
    places = [UsdGeom.Xformable(p).ComputeLocalToWorldTransform(Usd.TimeCode.Default()) for p in (rider, bicycle)]
    assert places[0] == places[1]


def test_sizes_are_those_of_real_things(day):
    """Length, width, height of vehicles and height of people [m]."""
    real = {
        "hatchback": (4.05, 1.9, 1.47),
        "saloon": (4.65, 2.0, 1.44),
        "estate": (4.7, 2.0, 1.52),
        "offroader": (4.45, 2.0, 1.66),
        "van": (5.3, 2.2, 2.3),
        "bus": (12.0, 2.8, 3.05),
        "lorry": (7.2, 2.5, 3.15),
        "bicycle": (1.8, 0.6, 1.05),
    }
    cache = UsdGeom.BBoxCache(Usd.TimeCode.Default(), ["default", "render"])
    for prim in of_group(day, "Vehicles"):
        name = prim.GetMetadata("references").prependedItems[0].assetPath.split("/")[-2]
        size = cache.ComputeUntransformedBound(prim).ComputeAlignedRange().GetSize()
        np.testing.assert_allclose(
            (size[1], size[0], size[2]), real[name], rtol=0.15, err_msg=str(prim.GetPath())
        )  # mirrors fold, aerials vary
    for prim in of_group(day, "People"):
        height = cache.ComputeUntransformedBound(prim).ComputeAlignedRange().GetSize()[2]
        assert 1.2 < height < 1.95, prim.GetPath()


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
        assert abs(lowest - height_below(triangles, x, y)) < 0.02, prim.GetPath()


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


def test_fog_holds_the_camera_and_ends_far_off_or_below_ground(dusk):
    place = UsdGeom.Xformable(dusk.GetPrimAtPath("/World/Fog/Global")).ComputeLocalToWorldTransform(
        Usd.TimeCode.Default()
    )
    low, high = np.array(place.Transform(Gf.Vec3d(-1))), np.array(place.Transform(Gf.Vec3d(1)))
    eye = np.array(
        UsdGeom.Xformable(dusk.GetPrimAtPath("/World/Ego"))
        .ComputeLocalToWorldTransform(Usd.TimeCode.Default())
        .ExtractTranslation()
    )
    assert low[2] < -1 and 80 <= high[2] <= 120
    assert (eye - low)[:2].min() > 500 and (high - eye)[:2].min() > 500  # tau > 2.5 even in MOR 600


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


def test_camera_looks_up_the_street_from_a_windscreen(day):
    camera = UsdGeom.Camera(day.GetPrimAtPath("/World/Ego"))
    lens = camera.GetCamera(Usd.TimeCode.Default())
    assert 50 <= lens.GetFieldOfView(Gf.Camera.FOVHorizontal) <= 60
    assert 1.35 <= lens.transform.ExtractTranslation()[2] <= 1.6
    assert lens.transform.TransformDir(Gf.Vec3d(0, 0, -1))[1] > 0.99
    settings = day.GetPrimAtPath(day.GetMetadata("renderSettingsPrimPath"))
    assert settings.GetRelationship("camera").GetTargets() == [Sdf.Path("/World/Ego")]
    assert tuple(settings.GetAttribute("resolution").Get()) == (1280, 720)


def test_repeated_things_are_instances(day):
    assert all(p.IsInstance() for group in ("Vehicles", "People", "Buildings") for p in of_group(day, group))
    assert len(day.GetPrototypes()) < len([p for p in day.Traverse() if p.IsInstance()]) / 2


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


def test_components_are_the_same_bytes_each_time(tmp_path):
    for component in [c for c in furniture.build_furniture() if c.name in ("street_lamp", "traffic_light")]:
        one, two = (write_component(component, tmp_path / n) for n in "ab")
        for file in sorted(one.parent.iterdir()):
            assert file.read_bytes() == (two.parent / file.name).read_bytes()
        assert one.read_bytes() == (ROOT / "assets" / "models" / component.name / one.name).read_bytes()


def test_houses_are_the_same_triangles_each_time():
    one, two = (next(c for c in buildings.build_houses() if c.name == "house_rose") for _ in range(2))
    for a, b in zip(one.parts, two.parts, strict=True):
        np.testing.assert_array_equal(a.points, b.points)


def test_overcast_sky_is_three_times_brighter_overhead_than_at_the_horizon():
    """CIE overcast sky; the tolerance is the texture of the clouds (15 %) over a ring of sky."""
    luminance = skies.overcast() @ [0.2126, 0.7152, 0.0722]
    rows = luminance.shape[0]
    zenith, horizon = luminance[: rows // 16].mean(), luminance[rows // 2 - rows // 32 : rows // 2].mean()
    assert zenith / horizon == pytest.approx(3.0, rel=0.15)
    assert zenith * crossing.OVERCAST_NITS == pytest.approx(5000, rel=0.15)


def test_albedos_are_those_of_real_surfaces():
    """Mean linear reflectance: asphalt 0.06 to 0.12, concrete slabs about 0.25, brick below 0.25."""
    assert 0.06 < ground.asphalt()[0].mean() < 0.12
    assert 0.2 < ground.paving()[0].mean() < 0.35
    assert 0.08 < textures.brick().mean() < 0.25


def test_digits_of_a_speed_limit_are_those_of_a_road_sign():
    """Strokes are a seventh of the digits' height (DIN 1451), digits are narrower than two thirds of it, and there is a
    stroke of white between them at least; measured along rows and columns of the picture.
    """
    dark = textures.signs()[:192, 192:384].max(axis=-1) < 0.2
    rows, columns = np.flatnonzero(dark.any(axis=1)), np.flatnonzero(dark.any(axis=0))
    tall = rows[-1] - rows[0] + 1
    steps = np.flatnonzero(np.diff(columns) > 1)
    assert len(steps) == 1, "two digits"
    gap = columns[steps[0] + 1] - columns[steps[0]] - 1
    assert gap > 0.12 * tall
    assert columns[-1] - columns[steps[0] + 1] + 1 < 0.66 * tall
    nought = dark[rows[0] + tall // 2, columns[steps[0] + 1] :]
    assert nought.sum() / 2 == pytest.approx(tall / 7, rel=0.12)


def test_a_cut_keeps_the_area_of_a_surface():
    """What is carved out and what is left add up, to rounding."""

    def area(part):
        a, b, c = (part.points[part.faces[:, i]] for i in range(3))
        return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2

    ball = shapes.ball((0, 0, 0), (1, 1, 1), "paint", sides=24)
    angle = np.linspace(0, 2 * np.pi, 9, endpoint=False)
    inside, rest = solids.carve(ball, solids.prism(0.4 * np.c_[np.cos(angle), np.sin(angle)], (0, 1)))
    assert area(inside) + area(rest) == pytest.approx(area(ball), rel=1e-9)
    assert 0 < area(inside) < 0.25 * area(ball)


def test_a_surface_lies_where_its_distance_is_zero():
    """Vertices of a ball of radius 1 from a grid of 0.1 m, after thinning to 400 triangles: four Newton steps leave
    under 0.1 mm.
    """
    part = solids.surface(
        lambda x, y, z: np.sqrt(x * x + y * y + z * z) - 1.0,
        (-1.2,) * 3,
        (1.2,) * 3,
        step=0.1,
        triangles=400,
        material="paint",
    )
    radius = np.linalg.norm(part.points, axis=1)
    assert len(part.faces) <= 420
    np.testing.assert_allclose(radius, 1.0, atol=1e-4)
    assert (np.einsum("ij,ij->i", shapes.face_normals(part), part.points[part.faces].mean(axis=1)) > 0).all()


def test_noise_tiles_and_has_unit_deviation():
    field = noise.noise((64, 64), 2.0, "test", int(stream(0, "test").integers(0, 9)))
    assert field.std() == pytest.approx(1.0)
    seam = np.abs(field[:, 0] - field[:, -1]).mean()
    inside = np.abs(np.diff(field, axis=1)).mean()
    assert seam < 2 * inside  # the seam is as smooth as any other step


def test_pictures_are_the_same_bytes_each_time_and_say_where_they_are_from(tmp_path):
    """Skies carry no hour of writing; every picture names its source."""
    one, two = (skies.write_skies(tmp_path / n) for n in "ab")
    for a, b in zip(one, two, strict=True):
        assert a.read_bytes() == b.read_bytes() == (ROOT / "assets" / "skies" / a.name).read_bytes()
    for path in [*(ROOT / "assets" / "textures").iterdir(), *(ROOT / "assets" / "skies").iterdir()]:
        assert OpenImageIO.ImageBuf(str(path)).spec().getattribute("ImageDescription") == textures.ORIGIN, path
