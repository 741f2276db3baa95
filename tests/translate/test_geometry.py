"""Meshes: area and winding survive triangulation, attributes stay with their corners."""

import numpy as np
import pytest
from pxr import Gf, Sdf, UsdGeom, UsdShade
from support.looks import fill, painted, picture_of, write

from synfog_usd.base.errors import StageError
from synfog_usd.stage import open_stage
from synfog_usd.translate import subdivide, translate
from synfog_usd.translate.polygons import triangulate

ONE = np.array([0])
BOX = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
QUADS = [0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3]


def shoelace(polygon):
    x, y = np.asarray(polygon, dtype=float).T
    return abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2


def area_vectors(positions, faces):
    a, b, c = (np.asarray(positions, dtype=float)[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a) / 2


def star(n, inner, rng):
    """A star-shaped polygon with every other corner pulled in: concave in half of its corners."""
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    radius = np.where(np.arange(n) % 2, inner, 1.0) * rng.uniform(0.8, 1.2, n)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def tilted(flat, rng):
    """The polygon somewhere in space, turned at random."""
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    q[:, 0] *= np.sign(np.linalg.det(q))
    return np.c_[flat, np.zeros(len(flat))] @ q.T + rng.uniform(-5, 5, 3), q[:, 2]


@pytest.mark.parametrize("n, inner", [(4, 0.15), (5, 1.0), (13, 0.4), (60, 0.15)])
def test_triangles_cover_a_polygon_once(n, inner):
    """All triangles turn the polygon's way and their areas add up to the shoelace formula's."""
    rng = np.random.default_rng(n)
    for _ in range(5):
        flat = star(n, inner, rng)
        points, normal = tilted(flat, rng)
        triangles, face_of, crossed = triangulate(points, np.array([n]), ONE, np.arange(n), np.array([True]))
        assert len(triangles) == n - 2 and not face_of.any() and not len(crossed)
        signed = area_vectors(points, triangles) @ normal
        assert (signed > -1e-12).all()
        np.testing.assert_allclose(signed.sum(), shoelace(flat), rtol=1e-12)


def test_a_polygon_with_a_bridged_hole_keeps_its_area():
    """A 4 x 4 square with a 2 x 2 hole, joined by a bridge of no width, covers 12."""
    flat = [(0, 0), (4, 0), (4, 4), (0, 4), (0, 0), (1, 1), (1, 3), (3, 3), (3, 1), (1, 1)]
    points = np.c_[np.array(flat, dtype=float), np.zeros(10)]
    triangles, _, crossed = triangulate(points, np.array([10]), ONE, np.arange(10), np.array([True]))
    signed = area_vectors(points, triangles)[:, 2]
    assert (signed > -1e-12).all() and not len(crossed)
    np.testing.assert_allclose(signed.sum(), 12.0)


def spiral(n):
    """A band that goes twenty times around."""
    turn = np.linspace(0.5, 40 * np.pi, n // 2)
    return np.concatenate([radius[:, None] * np.c_[np.cos(turn), np.sin(turn)] for radius in (turn + 2, turn)])[
        np.r_[: n // 2, n - 1 : n // 2 - 1 : -1]
    ]


def zigzag(n):
    """A thin band up and down, n / 2 times over 1 m."""
    along, high = np.linspace(0, 1, n // 2), np.arange(n // 2) % 2
    return np.r_[np.c_[along, high - 0.001], np.c_[along, high + 0.001][::-1]]


@pytest.mark.parametrize("shape", [spiral, zigzag])
def test_long_outlines_are_covered_once(shape, n=4_000):
    """An outline of thousands of corners that no fan covers."""
    flat = shape(n)
    points, normal = tilted(flat, np.random.default_rng(1))
    triangles, _, crossed = triangulate(points, np.array([len(flat)]), ONE, np.arange(len(flat)), np.array([True]))
    signed = area_vectors(points, triangles) @ normal
    size = np.ptp(flat, axis=0).prod()
    assert not len(crossed) and abs(signed.sum()) == pytest.approx(shoelace(flat), abs=1e-9 * size) == pytest.approx(
        np.abs(signed).sum(), abs=1e-9 * size
    )


@pytest.mark.parametrize("mirror", [False, True])
@pytest.mark.parametrize("left_handed", [False, True])
def test_outside_stays_outside(empty, polygon_mesh, only_shape, mirror, left_handed):
    """The divergence theorem gives a closed box a positive volume, whatever its orientation and mirror."""
    stage = empty()
    mesh = polygon_mesh(stage, "/Box", BOX, [4] * 6, QUADS[::-1] if left_handed else QUADS)
    mesh.CreateOrientationAttr("leftHanded" if left_handed else "rightHanded")
    mesh.AddTranslateOp().Set((3, 4, 5))
    mesh.AddScaleOp().Set((-2 if mirror else 2, 3, 1))
    shape = only_shape(translate(stage))
    p = shape["positions"].astype(float)
    volume = np.einsum("ij,ij->", p[shape["faces"][:, 0]], area_vectors(p, shape["faces"])) / 3
    np.testing.assert_allclose(volume, 8 * 6.0, rtol=1e-5)


@pytest.mark.parametrize("name, size, volume", [
    ("Cube", {"size": 3.0}, 27.0),
    ("Sphere", {"radius": 2.0}, 4 / 3 * np.pi * 8),
    ("Cylinder", {"radius": 1.5, "height": 4.0}, np.pi * 2.25 * 4),
    ("Cone", {"radius": 1.5, "height": 4.0}, np.pi * 2.25 * 4 / 3),
    ("Capsule", {"radius": 0.5, "height": 2.0}, np.pi * 0.25 * 2 + 4 / 3 * np.pi * 0.125),
])  # fmt: skip
@pytest.mark.parametrize("axis", ["X", "Z"])
def test_implicit_shapes_hold_their_volume(empty, only_shape, name, size, volume, axis):
    """Closed forms; 48 segments lose 2 pi^2 / (3 * 48^2) = 0.29 % of a circle's area, 24 chords of a meridian (pi /
    24)^2 / 4 = 0.43 %.
    """
    stage = empty()
    prim = stage.DefinePrim("/Shape", name)
    for key, value in size.items():
        prim.GetAttribute(key).Set(value)
    if prim.HasAttribute("axis"):
        prim.GetAttribute("axis").Set(axis)
    UsdGeom.Xformable(prim).AddScaleOp().Set((1.0, 1.0, 2.0))  # not a similarity: a sphere becomes a mesh too
    shape = only_shape(translate(stage))
    p = shape["positions"].astype(float)
    areas = area_vectors(p, shape["faces"])
    found = np.einsum("ij,ij->", p[shape["faces"][:, 0]], areas) / 3
    np.testing.assert_allclose(found, 2 * volume, rtol=7.2e-3)
    if "normals" in shape:
        assert (np.einsum("ij,ij->i", shape["normals"][shape["faces"][:, 0]], areas) > 0).all()
    if prim.HasAttribute("axis"):
        extent = np.ptp(p, axis=0) / [1, 1, 2]
        length = size["height"] + (2 * size["radius"] if name == "Capsule" else 0)
        np.testing.assert_allclose(extent["XYZ".index(axis)], length, rtol=1e-6)


@pytest.mark.parametrize("interpolation, values, indices", [
    ("faceVarying", [(0, 0), (1, 0), (1, 1), (0, 1), (5, 5), (6, 5), (6, 6), (5, 6)], None),
    ("faceVarying", [(6, 6), (0, 0), (1, 0), (1, 1), (0, 1), (5, 5), (6, 5), (5, 6)], [1, 2, 3, 4, 5, 6, 0, 7]),
    ("vertex", [(0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (2, 1)], None),
    ("varying", [(2, 1), (0, 0), (1, 0), (2, 0), (0, 1), (1, 1)], [1, 2, 3, 4, 5, 0]),
    ("uniform", [(0.25, 0.5), (0.75, 0.5)], None),
    ("constant", [(0.3, 0.7)], None),
])  # fmt: skip
def test_texture_coordinates_stay_with_their_corners(
    empty, polygon_mesh, only_shape, tmp_path, interpolation, values, indices
):
    """Each corner of each triangle finds the value that USD's own primvar rules give it."""
    stage = empty()
    corners = [0, 1, 4, 3, 1, 2, 5, 4]
    mesh = polygon_mesh(
        stage, "/Two", [(0, 5, 0), (1, 5, 0), (2, 5, 0), (0, 5, 1), (1, 5, 1), (2, 5, 1)], [4, 4], corners
    )
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("uv", Sdf.ValueTypeNames.TexCoord2fArray, interpolation)
    primvar.Set(values)
    if indices:
        primvar.SetIndices(indices)
    bind_texture(stage, mesh, tmp_path, "uv")
    shape = only_shape(translate(stage))
    flat = values if indices is None else [values[k] for k in indices]
    index = {"faceVarying": range(8), "uniform": [0] * 4 + [1] * 4, "constant": [0] * 8}.get(interpolation, corners)
    wanted = {(face, corners[4 * face + k]): flat[index[4 * face + k]] for face in range(2) for k in range(4)}
    for number, triangle in enumerate(shape["faces"]):
        for vertex in triangle:
            place = shape["positions"][vertex]
            point = next(k for k, p in enumerate(mesh.GetPointsAttr().Get()) if np.allclose(p, place))
            np.testing.assert_allclose(shape["texcoords"][vertex], wanted[number // 2, point], atol=1e-6)


def bind_texture(stage, mesh, folder, varname):
    write(folder / "checks.png", 255 * np.eye(2, dtype=np.uint8)[..., None].repeat(3, axis=2))
    painted(mesh.GetPrim(), diffuseColor=picture_of(stage, folder / "checks.png", varname))


def test_primvar_normals_win_and_face_varying_ones_split_vertices(empty, polygon_mesh, only_shape):
    stage = empty()
    points = [(0, 5, 0), (1, 5, 0), (1, 5, 1), (0, 5, 1), (2, 6, 0), (2, 6, 1)]
    mesh = polygon_mesh(stage, "/Fold", points, [4, 4], [0, 1, 2, 3, 1, 4, 5, 2])
    mesh.CreateNormalsAttr([(0, 0, 1)] * 8)
    mesh.SetNormalsInterpolation("faceVarying")
    first, second = Gf.Vec3f(0, -1, 0), Gf.Vec3f(0.7, -0.7, 0)
    UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("normals", Sdf.ValueTypeNames.Normal3fArray, "faceVarying").Set(
        [first] * 4 + [second] * 4
    )
    shape = only_shape(translate(stage))
    assert shape["face_normals"] is False
    np.testing.assert_allclose(shape["normals"][shape["faces"][0]], [[0, -1, 0]] * 3, atol=1e-6)
    np.testing.assert_allclose(shape["normals"][shape["faces"][2]], [[0.5**0.5, -(0.5**0.5), 0]] * 3, atol=1e-6)


@pytest.mark.parametrize("interpolation", ["vertex", "faceVarying"])
def test_normals_without_length_are_made_from_the_faces_around(empty, polygon_mesh, only_shape, interpolation):
    """Of a cube's corners, one has no normal: it gets the mean of its sides by area, the others keep the author's."""
    stage = empty()
    mesh = polygon_mesh(stage, "/Box", [(x, y + 5, z) for x, y, z in BOX], [4] * 6, QUADS)
    authored = np.array(BOX if interpolation == "vertex" else [BOX[k] for k in QUADS], dtype=float)
    authored[7 if interpolation == "vertex" else QUADS.index(7)] = 0.0
    mesh.CreateNormalsAttr(authored.tolist())
    mesh.SetNormalsInterpolation(interpolation)
    scene = translate(stage)
    shape = only_shape(scene)
    outward = (shape["positions"] - [0, 5, 0]) / 3**0.5
    turned = np.einsum("ij,ij->i", shape["normals"], outward)
    if interpolation == "vertex":
        np.testing.assert_allclose(
            turned, 1.0, rtol=1e-6
        )  # three equal squares: the diagonal, but for how they are cut
    else:
        changed = turned < 0.999
        np.testing.assert_allclose(shape["normals"][changed], [[1, 0, 0]], atol=1e-6)
    assert any("1 of its normals" in note.text for note in scene.notes)


def test_normals_stand_upright_under_uneven_scale(empty, polygon_mesh, only_shape):
    """On a sheared and stretched plane the normal stays at right angles to its edges."""
    stage = empty()
    mesh = polygon_mesh(stage, "/Slope", [(0, 0, 0), (1, 0, 1), (1, 1, 1), (0, 1, 0)], [4], [0, 1, 2, 3])
    mesh.CreateNormalsAttr([(-(0.5**0.5), 0, 0.5**0.5)] * 4)
    mesh.SetNormalsInterpolation("vertex")
    mesh.AddTransformOp().Set(Gf.Matrix4d(3, 0.5, 0, 0, 0, 1, 0.2, 0, 0, 0, 0.4, 0, 0, 9, 0, 1))
    shape = only_shape(translate(stage))
    p, faces = shape["positions"].astype(float), shape["faces"]
    flat = area_vectors(p, faces)[0]
    np.testing.assert_allclose(shape["normals"][faces[0, 0]], flat / np.linalg.norm(flat), atol=1e-6)


def test_a_subdivided_cube_touches_its_limit(empty, polygon_mesh, only_shape):
    """Corner of valence 3: (9 v + 4 sum(e) + sum(f)) / 24 = (9 + 4 - 1) / 24; axes: 68 / 81, from one step by hand and
    the mask of valence 4.
    """
    stage = empty()
    mesh = polygon_mesh(stage, "/Cage", BOX, [4] * 6, QUADS)
    mesh.GetSubdivisionSchemeAttr().Set("catmullClark")
    mesh.AddTranslateOp().Set((0, 5, 0))
    scene = translate(stage)
    shape = only_shape(scene)
    p = shape["positions"].astype(float) - [0, 5, 0]
    assert len(shape["faces"]) == 2 * 6 * 4**3
    np.testing.assert_allclose(np.abs(p[:8]), 0.5, rtol=1e-6)
    assert np.abs(p).max() == pytest.approx(68 / 81, rel=1e-6)
    toward = p / np.linalg.norm(p, axis=1, keepdims=True)
    assert (np.einsum("ij,ij->i", shape["normals"], toward) > 0.97).all()
    areas = area_vectors(p, shape["faces"])
    assert (np.einsum("ij,ij->i", p[shape["faces"][:, 0]], areas) > 0).all()


@pytest.mark.parametrize("fine_enough, triangles", [(subdivide.FINE_ENOUGH, 2 * 8 * 4**3), (8, 2 * 8)])
@pytest.mark.parametrize("interpolation", ["faceVarying", "vertex"])
def test_coordinates_and_holes_follow_a_subdivided_mesh(
    empty, polygon_mesh, only_shape, tmp_path, monkeypatch, interpolation, fine_enough, triangles
):
    """On a flat square u runs with x and v with z, by corners or points; a hole stays one."""
    monkeypatch.setattr(subdivide, "FINE_ENOUGH", fine_enough)
    stage = empty()
    points = [(x, 5, z) for z in range(4) for x in range(4)]
    faces = [[4 * z + x, 4 * z + x + 1, 4 * z + x + 5, 4 * z + x + 4] for z in range(3) for x in range(3)]
    indices = [k for face in faces for k in face]
    mesh = polygon_mesh(stage, "/Sheet", points, [4] * 9, indices)
    mesh.GetSubdivisionSchemeAttr().Set("catmullClark")
    mesh.CreateHoleIndicesAttr([4])
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("uv", Sdf.ValueTypeNames.TexCoord2fArray, interpolation)
    primvar.Set([(points[k][0], points[k][2]) for k in (indices if interpolation == "faceVarying" else range(16))])
    bind_texture(stage, mesh, tmp_path, "uv")
    shape = only_shape(translate(stage))
    assert len(shape["faces"]) == triangles
    np.testing.assert_allclose(shape["texcoords"], shape["positions"][:, [0, 2]], atol=1e-5)
    np.testing.assert_allclose(
        np.linalg.norm(area_vectors(shape["positions"], shape["faces"]), axis=1).sum(), 8.0, rtol=1e-5
    )


@pytest.mark.parametrize(
    "interpolation, at_the_point, at_a_middle", [("varying", 1.0, 0.25), ("vertex", 16 / 36, None)]
)
def test_varying_values_run_evenly_within_the_faces(
    empty, polygon_mesh, only_shape, interpolation, at_the_point, at_a_middle
):
    """A spike of 1 on one inner point: 'varying' keeps it, with a quarter at the middles of quads; 'vertex' smooths it
    to 16/36.
    """
    stage = empty()
    points = [(x, 5, z) for z in range(5) for x in range(5)]
    quads = [(5 * z + x, 5 * z + x + 1, 5 * z + x + 6, 5 * z + x + 5) for z in range(4) for x in range(4)]
    mesh = polygon_mesh(stage, "/Sheet", points, [4] * len(quads), [k for quad in quads for k in quad])
    mesh.GetSubdivisionSchemeAttr().Set("catmullClark")
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("displayColor", Sdf.ValueTypeNames.Color3fArray, interpolation)
    primvar.Set([(0, 0, 0), (1, 1, 1)])
    primvar.SetIndices([int(k == 12) for k in range(25)])
    shape = only_shape(translate(stage))
    x, _, z = shape["positions"].T

    def color(at):
        return shape["vertex_color"][np.argmin((x - at[0]) ** 2 + (z - at[1]) ** 2), 0]

    assert color((2, 2)) == pytest.approx(at_the_point, abs=1e-6)
    if at_a_middle is not None:
        assert color((1.5, 2)) == pytest.approx(0.5, abs=1e-6)
        assert color((1.5, 2.5)) == pytest.approx(at_a_middle, abs=1e-6)


def test_subsets_split_a_mesh_by_material(empty, polygon_mesh):
    """Faces of family materialBind, or bound directly, wear their own colour; other subsets do not split."""
    stage = empty()
    points = [(x, 5, z) for z in range(2) for x in range(5)]
    mesh = polygon_mesh(stage, "/Strip", points, [4] * 4, [k + x for k in range(4) for x in (0, 1, 6, 5)])
    materials = {
        name: painted(mesh.GetPrim(), f"/{name}", diffuseColor=color)
        for name, color in (("Red", (1, 0, 0)), ("Blue", (0, 0, 1)), ("Own", (0, 1, 0)))
    }
    for name, faces, family in (("Red", [0], "materialBind"), ("Blue", [1, 2], ""), ("Other", [3], "")):
        subset = fill(UsdGeom.Subset.Define(stage, f"/Strip/{name}Part"), elementType="face", indices=faces)
        if family:
            subset.CreateFamilyNameAttr(family)
        if name in materials:
            UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(materials[name])
    scene = translate(stage)
    found = {}
    for part in (part for key, part in scene.world.items() if key.startswith("shape_")):
        bsdf = scene.world[part["bsdf"]["id"]]
        found[tuple(bsdf["bsdf"]["base_color"]["value"])] = float(
            np.linalg.norm(area_vectors(part["positions"], part["faces"]), axis=1).sum()
        )
    assert found == {
        (1.0, 0.0, 0.0): pytest.approx(1.0),
        (0.0, 0.0, 1.0): pytest.approx(2.0),
        (0.0, 1.0, 0.0): pytest.approx(1.0),
    }
    assert len(scene.instances) == 1


@pytest.mark.parametrize("points, counts, indices", [
    ([(0, 0, 0), (1, 0, 0), (float("nan"), 0, 1)], [3], [0, 1, 2]),
    ([(0, 0, 0), (1, 0, 0), (1, 0, 1)], [3], [0, 1, 3]),
    ([(0, 0, 0), (1, 0, 0), (1, 0, 1)], [3], [0, 1, -1]),
    ([(0, 0, 0), (1, 0, 0), (1, 0, 1)], [-3], [0, 1, 2]),
    ([(0, 0, 0), (1, 0, 0), (1, 0, 1)], [1_000_000_000], [0, 1, 2]),
    ([(0, 0, 0), (1, 0, 0), (1, 0, 1)], [2, 1], [0, 1, 2]),
    ([], [3], [0, 1, 2]),
])  # fmt: skip
def test_a_broken_mesh_is_left_out_with_a_note(empty, polygon_mesh, points, counts, indices):
    stage = empty()
    polygon_mesh(stage, "/Broken", points, counts, indices)
    UsdGeom.Sphere.Define(stage, "/Fine")
    scene = translate(stage)
    assert sum(key.startswith("shape_") for key in scene.world) == 1
    assert [note.severity for note in scene.notes if note.path == "/Broken"] == ["warning"]


def test_normals_of_what_is_divided_are_not_used(empty, polygon_mesh, only_shape):
    """A cube that says it is divided is the same limit surface with and without normals of its own."""

    def drawn(*, normals, said=True):
        stage = empty()
        mesh = polygon_mesh(stage, "/Box", BOX, [4] * 6, QUADS)
        if said:
            mesh.GetSubdivisionSchemeAttr().Set("catmullClark")
        else:
            mesh.GetPrim().RemoveProperty("subdivisionScheme")
        if normals:
            mesh.CreateNormalsAttr([(0, 0, 1)] * len(QUADS))
            mesh.SetNormalsInterpolation("faceVarying")
        scene = translate(stage)
        return only_shape(scene), " ".join(note.text for note in scene.notes)

    (with_normals, told), (without, _) = drawn(normals=True), drawn(normals=False)
    assert "normals of its own are not used" in told and len(without["positions"]) > 8
    np.testing.assert_array_equal(with_normals["positions"], without["positions"])
    np.testing.assert_array_equal(with_normals["normals"], without["normals"])
    as_polygons, told = drawn(normals=True, said=False)
    assert len(as_polygons["faces"]) == 12 and "drawn as polygons" in told


SQUARE = [(0, 5, 0), (2, 5, 0), (2, 5, 2), (0, 5, 2)]


@pytest.mark.parametrize("kind", ["int[]", "double3[]", "half3[]"])
def test_points_of_any_numeric_type_are_points(tmp_path, only_shape, kind):
    """Threes, or plain numbers in threes."""
    values = SQUARE if "3" in kind else [number for point in SQUARE for number in point]
    scene = translate(opened(tmp_path, f"{kind} points = {values}"))
    np.testing.assert_array_equal(only_shape(scene)["positions"] + np.array(scene.origin_m), SQUARE)


def test_an_array_of_a_wrong_type_is_refused_in_one_line(tmp_path):
    with pytest.raises(StageError, match=r"^/M.normals is a float, and a normal3f\[\] is wanted; author it"):
        translate(opened(tmp_path, f"point3f[] points = {SQUARE}\n    float normals = 3"))


def opened(tmp_path, body):
    """A stage with one square of which some lines are given."""
    head = '#usda 1.0\n(\n    upAxis = "Z"\n    metersPerUnit = 1\n)\ndef Camera "Ego"\n{\n}\n'
    mesh = (
        'def Mesh "M"\n{\n    int[] faceVertexCounts = [4]\n    int[] faceVertexIndices = [0, 1, 2, 3]\n    uniform '
        'token subdivisionScheme = "none"\n'
    )
    (tmp_path / "a.usda").write_text(f"{head}{mesh}    {body}\n}}\n")
    return open_stage(tmp_path / "a.usda")
