"""The model library: every model opens, stands on the ground, has the size of what it is, and looks as its variants
say.
"""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pxr import Sdf, Usd, UsdGeom, UsdLux, UsdMedia, UsdShade, UsdUtils, UsdValidation

from assets.builders import homesteads, roadside, solids
from synfog_usd.base import cityscapes
from synfog_usd.base.errors import StageError
from synfog_usd.translate import ies
from synfog_usd.world import lod, sheet
from synfog_usd.world.components import Component, write_component
from synfog_usd.world.library import SIZES, library, model, of_group, read
from synfog_usd.world.shapes import Part, ball, box, face_normals

ROOT = Path(__file__).resolve().parents[2]
NAMES = [name for name, m in library().items() if m.group != "ground"]
ROOTED = {"bare_tree", "lime_tree", "maple_tree", "park_tree"}
"""Trees of the crossing whose trunks begin up to 9 cm below the ground."""
NOT_ON_GROUND = {"rider"}
"""Sits on the model `bicycle`, at the same place."""
NEW = [
    "city_car",
    "taxi",
    "crossover",
    "box_truck",
    "coach",
    "minibus",
    "wheelchair_user",
    "woman_pram",
    "worker",
    "jogger",
    "schoolgirl",
    "motorcyclist",
    "cyclist",
    "lamp_mast_double",
    "lamp_post_top",
    "bus_shelter",
    "guard_rail",
    "fence",
    "noise_wall",
    "sign_direction",
    "sign_warning",
    "sign_chevron",
    "birch_tree",
    "conifer",
    "terrace_house",
    "farmhouse",
    "office_block",
    "warehouse",
    "filling_station",
]


def shown(name: str, **variants: str) -> Usd.Stage:
    """A stage that refers to the model, with variants chosen."""
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    prim = UsdGeom.Xform.Define(stage, "/Model").GetPrim()
    prim.GetReferences().AddReference(str(library()[name].path))
    for set_name, choice in variants.items():
        assert prim.GetVariantSets().GetVariantSet(set_name).SetVariantSelection(choice)
    return stage


def meshes(stage: Usd.Stage) -> dict[str, Part]:
    """Triangles by name of the mesh."""
    found = {}
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.Mesh):
            mesh = UsdGeom.Mesh(prim)
            points = np.array(mesh.GetPointsAttr().Get(), dtype=np.float64)
            found[prim.GetName()] = Part(
                points, np.array(mesh.GetFaceVertexIndicesAttr().Get(), dtype=np.int64).reshape(-1, 3), prim.GetName()
            )
    return found


def first_hit(origin: np.ndarray, direction: np.ndarray, triangles: np.ndarray) -> float:
    """Distance along a ray to the nearest of (N, 3, 3) triangles, inf for none (Moller and Trumbore 1997)."""
    a, u, v = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    p = np.cross(direction, v)
    det = np.einsum("ij,ij->i", u, p)
    ok = np.abs(det) > 1e-12
    inv = 1 / np.where(ok, det, 1.0)
    s = origin - a
    q = np.cross(s, u)
    b, c, t = np.einsum("ij,ij->i", s, p) * inv, q @ direction * inv, np.einsum("ij,ij->i", v, q) * inv
    hit = ok & (b >= 0) & (c >= 0) & (b + c <= 1) & (t > 1e-6)
    return float(t[hit].min(initial=np.inf))


def test_library_has_what_streets_and_roads_need():
    """Twelve vehicles over seven body types, twelve people, riders, three lamps, several plants and buildings."""
    assert set(NEW) <= set(library())
    powered = [m for m in of_group("vehicle") if m.label in ("car", "truck", "bus")]
    assert len(powered) >= 12
    assert len({m.label for m in powered}) == 3
    assert len(of_group("person")) >= 12
    assert len(of_group("rider")) >= 3
    assert {m.name for m in of_group("lamp")} == {"street_lamp", "lamp_mast_double", "lamp_post_top"}
    assert len(of_group("plant")) >= 7
    assert len(of_group("building")) >= 15


@pytest.mark.parametrize("name", NAMES)
def test_model_stands_on_the_ground_and_has_the_size_of_its_class(name):
    """Least z within 2 cm of 0, the origin inside the footprint, extents within the limits of the class."""
    m = library()[name]
    stage = Usd.Stage.Open(str(m.path))
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert m.label in cityscapes.LABELS
    if name not in NOT_ON_GROUND:
        assert abs(m.low[2]) <= (0.09 if name in ROOTED else 0.02)
    assert m.low[0] <= 0 <= m.high[0]
    assert m.low[1] <= 0 <= m.high[1]
    for extent, (least, most) in zip((m.length, m.width, m.height), SIZES[m.label], strict=True):
        assert least <= extent <= most
    stated = re.search(r"([\d.]+) m long", m.about)
    if stated:  # 3 %: rounded corners take a few centimetres, mirrors and plates give some
        assert m.length == pytest.approx(float(stated[1]), rel=0.03)


@pytest.mark.parametrize("name", NEW)
def test_every_validator_of_usd_is_content_with_a_model(name):
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    stage = Usd.Stage.Open(str(library()[name].path))
    assert [e.GetMessage() for e in UsdValidation.ValidationContext(validators).Validate(stage)] == []


def kinds_in(layer: Sdf.Layer) -> set[str]:
    """Types of the prims that a layer defines, within variants too."""
    found = set()

    def visit(path: Sdf.Path) -> None:
        if path.IsPrimPath() or path.IsPrimVariantSelectionPath():
            spec = layer.GetPrimAtPath(path)
            found.update({spec.typeName} if spec and spec.specifier == Sdf.SpecifierDef else ())

    layer.Traverse(Sdf.Path.absoluteRootPath, visit)
    return found - {""}


@pytest.mark.parametrize("name", sorted(library()))
def test_a_model_is_divided_as_the_working_group_advises(name):
    """Meshes in payloads, materials in a layer of their own, neither in the interface; unloaded, a model has all its
    variants and no mesh.
    """
    path = library()[name].path
    interface, materials = Sdf.Layer.FindOrOpen(str(path)), Sdf.Layer.FindOrOpen(str(path.with_suffix(".mtl.usda")))
    assert kinds_in(interface).isdisjoint({"Mesh", "Material", "Shader"})
    assert kinds_in(materials) == {"Xform", "Scope", "Material", "Shader"}
    payloads = sorted(path.parent.glob("*.geo.usdc"))
    assert payloads
    for file in payloads:
        assert kinds_in(Sdf.Layer.FindOrOpen(str(file))) == {"Scope", "Mesh"}
    assert {f.name for f in path.parent.glob("*.usd*")} == {path.name, f"{name}.mtl.usda", *(f.name for f in payloads)}
    layers, _, missing = UsdUtils.ComputeAllDependencies(Sdf.AssetPath(str(path)))
    assert {Path(layer.realPath) for layer in layers} == set(path.parent.glob("*.usd*"))  # every file is reached
    assert missing == []
    unloaded = Usd.Stage.Open(str(path), Usd.Stage.LoadNone)
    sets = unloaded.GetDefaultPrim().GetVariantSets()
    assert {key: tuple(sets.GetVariantSet(key).GetVariantNames()) for key in sets.GetNames()} == library()[
        name
    ].variants
    assert not meshes(unloaded)
    unloaded.Load()
    assert meshes(unloaded)


def test_every_model_has_a_small_picture_of_itself():
    """128 x 128 pixels of at most 64 colours, named in the model, unlike any other, with source and licence; all
    together under 1 MB.
    """
    seen, size = set(), 0
    for name, m in library().items():
        stage = Usd.Stage.Open(str(m.path), Usd.Stage.LoadNone)
        picture = Path(
            UsdMedia.AssetPreviewsAPI(stage.GetDefaultPrim()).GetDefaultThumbnails().defaultImage.resolvedPath
        )
        assert picture == m.path.parent / "thumbnails" / f"{name}.png"
        with Image.open(picture) as image:
            assert image.size == (128, 128)
            assert len(image.getcolors(256)) <= 64
            assert image.text == {"Description": "made by synfog_usd.world, licence CC0-1.0"}
            values = np.asarray(image.convert("RGB"), dtype=np.float64)
        away = np.abs(values - values[-1, 0]).max(axis=2) > 16  # than the plain in a corner
        assert 0.004 < away.mean() < 0.9, name  # a double lamp mast is a thin thing
        seen.add(picture.read_bytes())
        size += picture.stat().st_size
    assert len(seen) == len(library())
    assert size < 1_000_000


@pytest.mark.parametrize("name", NAMES)
def test_every_variant_composes_and_every_mesh_wears_a_material(name):
    for set_name, choices in library()[name].variants.items():
        seen = set()
        for choice in choices:
            stage = shown(name, **{set_name: choice})
            assert stage.GetCompositionErrors() == []
            worn = []
            for prim in stage.Traverse():
                if prim.IsA(UsdGeom.Mesh):
                    material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
                    assert material, f"{prim.GetPath()} wears nothing"
                    worn.append(
                        (
                            prim.GetName(),
                            material.GetPrim().GetName(),
                            len(UsdGeom.Mesh(prim).GetFaceVertexCountsAttr().Get()),
                        )
                    )
                if prim.IsA(UsdShade.Shader):
                    worn += [
                        (str(prim.GetPath()), i.GetBaseName(), str(i.Get())) for i in UsdShade.Shader(prim).GetInputs()
                    ]
                if prim.HasAPI(UsdLux.LightAPI):
                    worn.append((prim.GetName(), "light", 0))
            assert worn
            seen.add(tuple(worn))
        assert len(seen) == len(choices), f"{set_name}: two of {choices} look the same"


@pytest.mark.parametrize("name", [n for n in NAMES if "lod" in library()[n].variants])
def test_low_level_has_fewer_triangles_and_the_same_silhouette(name):
    """No point of a solid mesh moves by more than 2 cm; leaves keep the area that they cover within 5 %."""
    full, low = meshes(shown(name, lod="full")), meshes(shown(name, lod="low"))
    assert set(full) - set(low) <= set(lod.INSIDE)  # behind glass that is dark in the distance
    assert set(low) <= set(full)
    assert sum(len(p.faces) for p in low.values()) < 0.75 * sum(len(p.faces) for p in full.values())
    for key in low:
        if key.startswith(lod.LEAVES):
            area = [
                0.5 * np.linalg.norm(np.cross(*np.diff(p.points[p.faces], axis=1).swapaxes(0, 1)), axis=1).sum()
                for p in (full[key], low[key])
            ]
            assert area[1] == pytest.approx(area[0], rel=0.05)
        else:
            assert lod.distance(full[key], low[key], samples=2000) <= 0.02 + 1e-4  # files keep five decimals


@pytest.mark.slow
@pytest.mark.parametrize("name", [n for n in NAMES if "far" in library()[n].variants.get("lod", ())])
def test_far_level_of_a_tree_covers_as_much_as_the_near_one(name):
    """Seen from four sides on a grid of 10 cm: the leaves' mean share of covered cells within 15 %, no wider and no
    higher by more than 40 cm; at most 6 000 triangles.
    """
    for which in library()[name].variants.get("individual", ("",)):
        chosen = {"individual": which} if which else {}
        full, far, distant = (meshes(shown(name, lod=level, **chosen)) for level in ("full", "far", "distant"))
        assert sum(len(p.faces) for p in far.values()) <= 6000
        assert sum(len(p.faces) for p in distant.values()) <= 2200
        covered = []
        for parts in (full, far):
            leaves = [p for key, p in parts.items() if key.startswith(lod.LEAVES)]
            corners = np.concatenate([p.points[p.faces] for p in leaves])
            rng = np.random.Generator(np.random.PCG64(3))
            area = 0.5 * np.linalg.norm(np.cross(*np.diff(corners, axis=1).swapaxes(0, 1)), axis=1)
            chosen_faces = rng.choice(len(corners), 200_000, p=area / area.sum())
            u = np.sort(rng.random((200_000, 2)), axis=1)
            weights = np.stack([u[:, 0], u[:, 1] - u[:, 0], 1 - u[:, 1]], axis=1)
            places = np.einsum("nk,nkj->nj", weights, corners[chosen_faces])
            cells = 0
            for angle in (0.0, 0.7, 1.6, 2.4):
                across = places[:, 0] * np.cos(angle) + places[:, 1] * np.sin(angle)
                cells += len(np.unique(np.floor(np.c_[across, places[:, 2]] / 0.1), axis=0))
            covered.append((cells, np.ptp(np.percentile(places, [1, 99], axis=0), axis=0)))
        (near_cells, near_size), (far_cells, far_size) = covered
        assert far_cells == pytest.approx(near_cells, rel=0.15)
        np.testing.assert_allclose(far_size, near_size, atol=0.4)


def test_distance_between_surfaces_is_that_of_two_balls():
    """Balls of radius 1.00 and 1.03 about one point are 3 cm apart; the same two bodies the other way round too."""
    one, other = (ball((0, 0, 0), (r, r, r), "m", sides=96) for r in (1.0, 1.03))
    assert lod.distance(one, other) == pytest.approx(0.03, abs=1.5e-3)  # facets of 96 sides sag by 0.5 mm
    assert lod.distance(other, one) == lod.distance(one, other)


def test_a_model_without_triangles_to_spare_has_one_level():
    assert lod.with_low(Component("crate", "static", (box((0, 0, 0), (1, 1, 1), "timber"),), "A crate.")).low == ()


@pytest.mark.parametrize(
    "name", [m.name for m in library().values() if "lamps" in m.variants and "on" in m.variants["lamps"]]
)
def test_lamps_shine_out_of_their_model(name):
    """From each light along its axis nothing of the model stands in the way; no lamp lies inside a mesh."""
    stage = shown(name, lamps="on")
    parts = meshes(stage).values()
    triangles = np.concatenate([p.points[p.faces] for p in parts])
    lights = [prim for prim in stage.Traverse() if prim.HasAPI(UsdLux.LightAPI)]
    assert lights or "traffic_light" in name
    for light in lights:
        matrix = np.array(UsdGeom.Xformable(light).ComputeLocalToWorldTransform(Usd.TimeCode.Default()))
        assert first_hit(matrix[3, :3], -matrix[2, :3], triangles) == np.inf, (
            f"{light.GetPath()} shines on its own model"
        )
        assert UsdLux.LightAPI(light).GetIntensityAttr().Get() > 0


POWERED = [n for n, m in library().items() if m.label in ("car", "truck", "bus") or n == "motorcyclist"]
RED_NITS = 0.2126  # luminance of a unit of red, ITU-R BT.709


def lens_candela(stage: Usd.Stage, mesh: str, towards: np.ndarray) -> float:
    """Intensity [cd] of one of a pair of glowing lenses (all of the mesh, if it is one) in a direction, I = L A cos."""
    part = meshes(stage)[mesh]
    corners = part.points[part.faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0) / 2
    value = UsdShade.Shader(stage.GetPrimAtPath(f"/Model/Materials/{mesh}/Surface")).GetInput("emissiveColor").Get()
    pair = 2 if np.ptp(part.points[:, 0]) > 0.5 else 1
    return float(np.dot(value, [0.2126, 0.7152, 0.0722]) * abs(area @ towards) / pair) if value else 0.0


@pytest.mark.parametrize("name", POWERED)
def test_tail_lamps_are_as_bright_as_the_regulation_has_them(name):
    """Straight back, UN Regulation 7: position lamps 4 to 12 cd, stop lamps 60 to 185 cd, a centre stop lamp 25 to 80
    cd.
    """
    assert set(library()[name].variants["lamps"]) == {"off", "glow", "on", "brake"}
    back = np.array([0.0, -1.0, 0.0])
    off, glow, on, brake = (
        lens_candela(shown(name, lamps=state), "tail_lens", back) for state in ("off", "glow", "on", "brake")
    )
    assert off == 0
    assert 4 <= glow == on <= 12
    assert 60 <= brake <= 185
    if "brake_lens" in meshes(shown(name)):
        centre = [lens_candela(shown(name, lamps=state), "brake_lens", back) for state in ("off", "on", "brake")]
        assert centre[0] == centre[1] == 0
        assert 25 <= centre[2] <= 80


@pytest.mark.parametrize("name", POWERED)
def test_headlights_do_not_blind_who_comes_towards_them(name):
    """UN Regulation 112: at most 625 cd above the cut-off and 350 cd at B50L; at least 5 100 cd on the road 50 m ahead
    (50V).

    Beam and lens together, seen by a driver 40 m ahead, 3.5 m aside, eyes at 1.15 m; the regulation's 75 cm of mounting
    are brought to each lamp's height.
    """
    stage = shown(name, lamps="on")
    lights = [p for p in stage.Traverse() if p.HasAPI(UsdLux.LightAPI)]
    assert len(lights) == (1 if name == "motorcyclist" else 2)
    for light in lights:
        matrix = np.array(UsdGeom.Xformable(light).ComputeLocalToWorldTransform(Usd.TimeCode.Default()))
        beam = UsdLux.ShapingAPI(light).GetShapingIesFileAttr().Get()
        table = ies.parse(Path(beam.resolvedPath).read_bytes(), beam.path)
        scale = UsdLux.LightAPI(light).GetIntensityAttr().Get() * np.pi * light.GetAttribute("inputs:radius").Get() ** 2

        def candela(right: float, up: float, ahead: float, matrix=matrix, table=table, scale=scale) -> float:
            way = np.array([right, ahead, up]) / np.linalg.norm([right, ahead, up])
            x, y, z = matrix[:3, :3] @ way
            return scale * float(table.at(np.degrees(np.arccos(-z)), np.degrees(np.arctan2(y, x))))

        x, _, z = matrix[3, :3]
        driver = np.array([-3.5 - x, 40.0, max(1.15 - z, 0.1)])
        assert (
            candela(driver[0], driver[2], 40.0) + lens_candela(stage, "headlamp_lens", driver / np.linalg.norm(driver))
            <= 625
        )
        assert (
            candela(-3.0, 0.5, 50.0) + lens_candela(stage, "headlamp_lens", np.array([0.0, 1.0, 0.0])) <= 350
        )  # B50L: 3.43 degrees left, 0.57 up
        assert candela(0.0, -0.75, 50.0) >= 5_100  # 50V: 0.86 degrees down


@pytest.mark.parametrize("name", [m.name for m in of_group("vehicle") if m.label == "car"])
def test_a_car_has_at_most_15000_triangles(name):
    """At full detail with its driver; far away fewer than two thirds, behind dark glass."""
    full, low = (meshes(shown(name, lod=level, driver="on")) for level in ("full", "low"))
    assert sum(len(p.faces) for p in full.values()) <= 15_000
    assert sum(len(p.faces) for p in low.values()) < 0.65 * sum(len(p.faces) for p in full.values())
    stage = shown(name, lod="low")
    glass = stage.GetPrimAtPath("/Model/Geometry/glass_clear")
    assert (
        UsdShade.MaterialBindingAPI(glass).ComputeBoundMaterial()[0].GetPrim().GetName() == "glass_car"
    )  # dark, with nothing behind it


@pytest.mark.parametrize("name", [m.name for m in of_group("vehicle") if m.label == "car"])
def test_a_car_has_gaps_between_its_panels(name):
    """Dark lines 7 mm wide lie on the bonnet, on both flanks and at the back, and a fuel flap on one flank alone."""
    parts = meshes(shown(name))
    seam, paint = parts["seam"], parts["paint"]
    middle, normal = seam.points[seam.faces].mean(axis=1), face_normals(seam)
    area = 0.5 * np.linalg.norm(np.cross(*np.diff(seam.points[seam.faces], axis=1).swapaxes(0, 1)), axis=1)

    def metres(chosen: np.ndarray) -> float:
        return float(area[chosen & (area < 4e-3)].sum() / 0.007)  # the lining of wheel arches is larger

    m = library()[name]
    up, side, along = np.abs(normal[:, 2]) > 0.6, np.abs(normal[:, 0]) > 0.7, np.abs(normal[:, 1]) > 0.6
    assert metres(up & (middle[:, 1] > 0.25 * m.high[1])) > 2.0  # round the bonnet
    assert metres(along & (middle[:, 1] < 0.8 * m.low[1])) > 1.2
    high = side & (np.abs(middle[:, 0]) > 0.75 * np.abs(paint.points[:, 0]).max()) & (middle[:, 2] > 0.5)
    left, right = metres(high & (middle[:, 0] < 0)), metres(high & (middle[:, 0] > 0))
    assert left > 2.0
    assert 0.2 < right - left < 0.8  # the flap is 14 by 12 cm


@pytest.mark.parametrize("name", POWERED)
def test_nothing_of_a_vehicle_stands_before_its_lenses(name):
    """From the middle of every triangle of a lens a ray straight ahead, or straight back, meets nothing."""
    parts = meshes(shown(name))
    triangles = np.concatenate([p.points[p.faces] for p in parts.values()])
    for lens, ahead in (("headlamp_lens", 1.0), ("tail_lens", -1.0), ("brake_lens", -1.0)):
        if lens in parts:
            middles = parts[lens].points[parts[lens].faces].mean(axis=1)
            for at in middles[:: 1 + len(middles) // 40]:
                assert first_hit(at, np.array([0.0, ahead, 0.0]), triangles) == np.inf, (lens, at)


@pytest.mark.parametrize("name", POWERED)
def test_nothing_hides_a_wheel_from_the_side(name):
    """A ray across the car at a wheel's middle, and at half its radius above it, meets the wheel first."""
    parts = meshes(shown(name))
    triangles = np.concatenate([p.points[p.faces] for p in parts.values()])
    wheels = np.concatenate([parts[kind].points[parts[kind].faces] for kind in ("tyre", "rim", "brake")])
    tyres = parts["tyre"].points[parts["tyre"].points[:, 0] > 0]
    radius = tyres[:, 2].max() / 2
    found = np.unique(np.round(tyres[tyres[:, 2] < 0.03, 1], 1))
    middles = [float(group.mean()) for group in np.split(found, np.flatnonzero(np.diff(found) > 0.4) + 1)]
    assert len(middles) >= 2
    for y in middles:
        for up in (-0.5, 0.5):
            origin, across = np.array([3.0, y + 0.07 * radius, (1 + up) * radius]), np.array([-1.0, 0.0, 0.0])
            assert first_hit(origin, across, triangles) == pytest.approx(first_hit(origin, across, wheels)), (y, up)


def test_no_two_cars_have_one_face():
    """Areas of grilles and of lamps in 24 columns of the front: any two cars differ by 15 % of what either shows."""
    cars = [m.name for m in of_group("vehicle") if m.label == "car"]
    faces = {}
    for name in cars:
        parts = meshes(shown(name))
        paint = parts["paint"].points
        half, top = np.abs(paint[:, 0]).max(), 0.62 * paint[:, 2].max()
        columns = np.zeros((2, 24))
        for row, kinds in enumerate((("seam", "gloss_black", "chrome"), ("headlamp",))):
            for part in (parts[kind] for kind in kinds):
                corners = part.points[part.faces]
                front = (corners[..., 1].mean(axis=1) > 0.8 * paint[:, 1].max()) & (corners[..., 2].max(axis=1) < top)
                area = np.abs(np.cross(*np.diff(corners[front], axis=1).swapaxes(0, 1))[:, 1]) / 2
                where = np.clip((corners[front][..., 0].mean(axis=1) / half + 1) * 12, 0, 23).astype(int)
                columns[row] += np.bincount(where, area / (half * top), minlength=24)
        faces[name] = columns
    for one, other in itertools.combinations(cars, 2):
        a, b = faces[one], faces[other]
        assert np.abs(a - b).sum() > 0.15 * (a.sum() + b.sum()), (one, other)


@pytest.mark.parametrize("name", [n for n in POWERED if n != "motorcyclist"])
def test_paint_is_dusty_near_the_road(name):
    """Dirtier is lower; of any colour dust makes black paint lighter, white paint darker, and both duller."""
    parts = meshes(shown(name))
    heights = [parts[mesh].points[:, 2].mean() for mesh in ("paint_dirty", "paint_dusty", "paint")]
    assert heights == sorted(heights)
    for paint in library()[name].variants["paint"]:
        stage = shown(name, paint=paint)
        inputs = [
            UsdShade.Shader(stage.GetPrimAtPath(f"/Model/Materials/{m}/Surface"))
            for m in ("paint", "paint_dusty", "paint_dirty")
        ]
        colours = [np.array(shader.GetInput("diffuseColor").Get()) for shader in inputs]
        dust = np.array([0.20, 0.17, 0.135])
        away = [np.abs(colour - dust).sum() for colour in colours]
        assert away == sorted(away, reverse=True)
        for key, rising in (("roughness", True), ("clearcoat", False)):
            values = [shader.GetInput(key).Get() for shader in inputs]
            assert values == sorted(values, reverse=not rising) and len(set(values)) == 3


def test_paint_is_a_clear_coat_over_a_ground_with_flakes():
    for paint, flakes in (("white", 0.0), ("silver", 0.6)):
        stage = shown("saloon", paint=paint)
        shader = UsdShade.Shader(stage.GetPrimAtPath("/Model/Materials/paint/Surface"))
        assert shader.GetInput("clearcoat").Get() == 1.0
        assert shader.GetInput("clearcoatRoughness").Get() < 0.1 < shader.GetInput("roughness").Get()
        metal = shader.GetInput("metallic")
        assert (metal.Get() if metal else 0.0) == pytest.approx(flakes)


@pytest.mark.parametrize("name", [n for n in POWERED if n != "motorcyclist"])
def test_the_driver_is_seen_through_the_windscreen(name):
    """From ahead, at the height of the head, a ray meets glass, then the driver, and nothing opaque before; without a
    driver it goes on.
    """
    on, none = meshes(shown(name, driver="on")), meshes(shown(name))
    assert set(on) - set(none) == {"driver_skin", "driver_hair", "driver_coat"}
    head = on["driver_hair"].points.mean(axis=0) - [0, 0, 0.05]
    assert head[0] < -0.2  # on the left
    eye, ahead = head + np.array([0.0, 12.0, 0.0]), np.array([0.0, -1.0, 0.0])

    def nearest(parts: dict[str, Part], *names: str) -> float:
        return first_hit(eye, ahead, np.concatenate([p.points[p.faces] for n, p in parts.items() if n in names]))

    opaque = [n for n in on if n != "glass_clear"]
    person = nearest(on, "driver_skin", "driver_hair")
    assert nearest(on, "glass_clear") < person == nearest(on, *opaque)
    assert nearest(none, *opaque) > person + 0.1


def test_clear_panes_reflect_as_glass_and_let_most_light_through():
    """A renderer that scales the reflection by the opacity gives back what both faces of a pane of index 1.52 do along
    its normal: 2 R / (1 + R), R = ((n - 1) / (n + 1))^2.
    """
    stage = shown("saloon")
    shader = UsdShade.Shader(stage.GetPrimAtPath("/Model/Materials/glass_clear/Surface"))
    opacity, index = (shader.GetInput(key).Get() for key in ("opacity", "ior"))
    face = (0.52 / 2.52) ** 2
    assert opacity * ((index - 1) / (index + 1)) ** 2 == pytest.approx(2 * face / (1 + face), rel=0.03)
    assert 0.3 <= 1 - opacity <= 0.75  # 70 % of light is the least that UN Regulation 43 asks of a windscreen


@pytest.mark.parametrize("name", ["lime_tree", "maple_tree", "bare_tree", "park_tree"])
def test_individuals_of_a_tree_differ_in_shape(name):
    """Crown breadth over height spans 15 % at least and is no one's twice; same materials; none has more triangles than
    the first.
    """
    shapes, counts = [], []
    for which in library()[name].variants["individual"]:
        parts = meshes(shown(name, individual=which))
        assert set(parts) == set(meshes(shown(name)))
        points = np.concatenate([p.points for p in parts.values()])
        low, high = np.percentile(points, [2, 98], axis=0)  # a single twig is no crown
        shapes.append((high - low)[:2].mean() / points[:, 2].max())
        counts.append(sum(len(p.faces) for p in parts.values()))
    assert len(shapes) == 3
    ratios = np.sort(shapes)
    assert (ratios[1:] / ratios[:-1] > 1.02).all()
    assert ratios[2] / ratios[0] > 1.15
    assert max(counts) <= 1.02 * counts[0]


@pytest.mark.parametrize("name", ["man_walking", "child", "woman_pram", "worker", "jogger"])
def test_people_of_a_kind_are_seen_at_different_moments(name):
    """Between any two individuals of who walks, runs or works, feet or heads stand apart by 4 cm; all stand on the
    ground and wear the same materials.
    """
    seen = []
    for which in library()[name].variants["individual"]:
        parts = meshes(shown(name, individual=which))
        assert set(parts) == set(meshes(shown(name)))
        assert min(p.points[:, 2].min() for p in parts.values()) == pytest.approx(0.0, abs=1e-4)
        shoes, hair = parts["shoes"].points, parts["hair"].points
        sides = [shoes[shoes[:, 0] * side > 0] for side in (-1, 1)]
        seen.append(np.array([*(foot[:, axis].mean() for foot in sides for axis in (1, 2)), *hair[:, 1:].mean(axis=0)]))
    assert len(seen) >= 3
    for one, other in itertools.combinations(seen, 2):
        assert np.abs(one - other).max() > 0.04


@pytest.mark.parametrize(
    "name", [m.name for m in (*of_group("person"), *of_group("rider")) if m.name != "motorcyclist"]
)
def test_eyes_look_out_of_the_face(name):
    """Eyes lie at 91 to 96 % of the height of who stands, in front of the head's middle, to both sides of the nose by
    half of 60 mm or so.
    """
    parts = meshes(shown(name))
    eyes, head = parts["eye_white"].points, parts["hair"].points
    aside = eyes - eyes.mean(axis=0)
    gap = np.linalg.norm(aside[: len(aside) // 2].mean(axis=0) - aside[len(aside) // 2 :].mean(axis=0))
    assert 0.035 <= gap <= 0.075
    assert eyes[:, 1].mean() > head[:, 1].mean() + 0.04
    skin = np.concatenate([parts[k].points[parts[k].faces] for k in ("skin", "hair")])
    for eye in np.split(eyes, 2):
        assert (
            first_hit(eye.mean(axis=0) + np.array([0, 0.5, 0]), np.array([0.0, -1.0, 0.0]), skin) > 0.5 - 0.006
        )  # not under the skin
    if name in ("man_walking", "woman_walking", "student", "woman_phone"):
        assert 0.91 <= eyes[:, 2].mean() / max(p.points[:, 2].max() for p in parts.values()) <= 0.96


def test_riders_and_what_they_ride_have_their_own_labels():
    stage = shown("motorcyclist")
    labels = {
        p.GetName(): p.GetAttribute("semantics:labels:cityscapes").Get()
        for p in stage.Traverse()
        if p.IsA(UsdGeom.Mesh)
    }
    assert list(labels["tyre"]) == list(labels["paint"]) == ["motorcycle"]
    assert labels["coat"] is None  # of the model: rider
    assert library()["motorcyclist"].label == "rider"


def test_stock_is_the_same_bytes_each_time(tmp_path):
    """The shipped files are what the code writes."""
    made = [c for c in roadside.build_roadside() if c.name in ("guard_rail", "lamp_post_top", "sign_direction")]
    made += [c for c in homesteads.build_homesteads() if c.name == "warehouse"]
    for component in made:
        path = write_component(lod.bare(lod.with_low(component)), tmp_path)
        for file in path.parent.iterdir():
            assert file.read_bytes() == (ROOT / "assets" / "models" / component.name / file.name).read_bytes(), (
                file.name
            )
    assert len(made) == 4


def test_a_skin_is_the_same_where_the_field_is_asked_near_it_alone():
    """A ball of 0.9 m on a grid of 5 cm, all of it or what a grid of 20 cm finds near."""

    def ball_field(x, y, z):
        return np.sqrt(x * x + y * y + z * z) - 0.9

    one, other = (
        solids.surface(ball_field, (-1.1,) * 3, (1.1,) * 3, step=0.05, triangles=10**6, material="paint", coarse=n)
        for n in (1, 4)
    )
    np.testing.assert_array_equal(one.points, other.points)
    np.testing.assert_array_equal(one.faces, other.faces)
    assert np.linalg.norm(one.points, axis=1) == pytest.approx(0.9, abs=1e-6)


def test_a_corner_is_filleted_by_a_parabola():
    """Of a unit square with a setback of 0.2 the curve passes 0.2 / 4 from both sides of each corner, and an edge
    shorter than twice the setback is bent from its middle.
    """
    bent = solids.filleted([(0, 0), (1, 0), (1, 1), (0, 1)], 0.2)
    assert np.abs(bent - [0.05, 0.05]).sum(axis=1).min() == pytest.approx(0.0, abs=1e-12)
    assert bent.min() == 0.0
    assert np.abs(solids.filleted([(0, 0), (1, 0), (1, 0.3), (0, 0.3)], 0.2) - [1, 0.15]).sum(axis=1).min() < 1e-12


def test_a_skin_is_the_same_whatever_was_simplified_before_it():
    """pymeshlab remembers what its last call was told; a surface made before and after another kind of thinning has the
    same points.
    """

    def slab(x, y, z):
        return np.maximum(np.maximum(np.abs(x) - 1.03, np.abs(y) - 0.63), np.abs(z + 0.2 * x) - 0.4)

    def skin() -> Part:
        return solids.surface(slab, (-1.2,) * 3, (1.2,) * 3, step=0.08, triangles=500, material="paint")

    before = skin()
    fewer = lod.collapsed(before.points, before.faces, 200)
    after = skin()
    np.testing.assert_array_equal(before.points, after.points)
    np.testing.assert_array_equal(fewer[0], lod.collapsed(after.points, after.faces, 200)[0])


def test_pieces_of_a_row_join_end_to_end():
    """A guard rail is 4 m along X with its rail towards +Y and its posts behind."""
    m = model("guard_rail")
    assert m.width == pytest.approx(4.0, abs=1e-6)
    assert m.height == pytest.approx(0.75, abs=0.005)  # top of the rail, ESP systems
    stage = shown("guard_rail")
    points = np.concatenate([p.points for p in meshes(stage).values()])
    assert points[points[:, 2] < 0.3][:, 1].max() < 0.0 < points[points[:, 2] > 0.45][:, 1].max()


def test_unknown_models_and_files_that_are_none_are_told(tmp_path):
    with pytest.raises(StageError, match=r"no model 'taksi'\. Did you mean 'taxi'"):
        model("taksi")
    for text, said in (
        ("#usda 1.0\n", "default prim"),
        ('#usda 1.0\n(defaultPrim = "A")\ndef Xform "A" {}\n', "0 Cityscapes labels"),
    ):
        path = tmp_path / f"{len(text)}.usda"
        path.write_text(text)
        with pytest.raises(StageError, match=said):
            read(path)
    empty = tmp_path / "empty.usda"
    layer = Sdf.Layer.CreateNew(str(empty))
    stage = Usd.Stage.Open(layer)
    prim = UsdGeom.Xform.Define(stage, "/A").GetPrim()
    stage.SetDefaultPrim(prim)
    prim.CreateAttribute("semantics:labels:cityscapes", Sdf.ValueTypeNames.TokenArray).Set(["car"])
    layer.Save()
    with pytest.raises(StageError, match="no geometry"):
        read(empty)


@pytest.mark.parametrize("views_deg, cell_px", [(sheet.VIEWS_DEG, sheet.CELL_PX), (sheet.VIEWS_DEG[:1], (128, 128))])
def test_on_the_sheet_every_view_of_a_model_lies_in_its_own_cell(tmp_path, views_deg, cell_px):
    """Points of the meshes, seen by the sheet's camera: no view leaves its cell, and each fills at least a third of its
    height or width.
    """
    models = sheet.ordered(
        [model(name) for name in ("bus", "jogger", "lamp_mast_double", "warehouse", "guard_rail", "taxi")]
    )
    width, height = sheet.write_stage(tmp_path / "sheet.usda", models, columns=2, views_deg=views_deg, cell_px=cell_px)
    stage = Usd.Stage.Open(str(tmp_path / "sheet.usda"))
    frustum = UsdGeom.Camera(stage.GetPrimAtPath("/World/Camera")).GetCamera().frustum
    project = np.array(frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix())
    for k, m in enumerate(models):
        row, column = divmod(k, 2)
        for view in range(len(views_deg)):
            place = np.array(
                UsdGeom.Xformable(stage.GetPrimAtPath(f"/World/{m.name}_{view}")).ComputeLocalToWorldTransform(
                    Usd.TimeCode.Default()
                )
            )
            points = np.concatenate([p.points for p in meshes(shown(m.name)).values()])
            clip = np.c_[points, np.ones(len(points))] @ place @ project
            x, y = (clip[:, 0] / clip[:, 3] + 1) / 2 * width, (1 - clip[:, 1] / clip[:, 3]) / 2 * height
            left, top = (len(views_deg) * column + view) * cell_px[0], row * cell_px[1]
            # 5 px: the camera is not endlessly far, and nearer rows look 1 % larger
            assert left - 5 <= x.min() < x.max() <= left + cell_px[0] + 5
            assert top - 5 <= y.min() < y.max() <= top + cell_px[1] + 5
            assert np.ptp(y) > cell_px[1] / 3 or np.ptp(x) > cell_px[0] / 3
