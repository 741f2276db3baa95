"""A user's model in the library: unit, axes, place, colour and label, and what is refused."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import colour
import numpy as np
import pytest
import trimesh
from pxr import Sdf, Usd, UsdGeom, UsdShade, UsdValidation
from support import cli
from support.looks import fill

from synfog_usd.base.errors import OutputError, ParameterError, StageError
from synfog_usd.world import meshfiles
from synfog_usd.world.importer import import_asset
from synfog_usd.world.library import library

LENGTH, WIDTH, HEIGHT = 4.4, 1.8, 1.5
AXES = {"up": "+Z", "front": "+Y"}
"""Of `car`."""


def car() -> trimesh.Trimesh:
    """A body with a cabin 0.35 m behind its middle, along +Y, Z up, in metres."""
    body = trimesh.creation.box(extents=(WIDTH, LENGTH, 0.8))
    body.apply_translation((0, 0, 0.4))
    cabin = trimesh.creation.box(extents=(1.5, 2.0, 0.7))
    cabin.apply_translation((0, -0.35, 1.15))
    return trimesh.util.concatenate([body, cabin])


def turned(mesh: trimesh.Trimesh, up: str, front: str, factor: float, offset=(3.0, 2.0, 1.0)) -> trimesh.Trimesh:
    """The car in a file of other axes and unit, away from the origin."""
    y, z = (np.eye(3)["XYZ".index(a[1])] * (-1 if a[0] == "-" else 1) for a in (front, up))
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([np.cross(y, z), y, z]).T * factor
    matrix[:3, 3] = np.array(offset) * factor
    copy = mesh.copy()
    copy.apply_transform(matrix)
    return copy


def points_of(path: Path) -> np.ndarray:
    stage = Usd.Stage.Open(str(path))
    return np.concatenate(
        [np.array(UsdGeom.Mesh(p).GetPointsAttr().Get()) for p in stage.Traverse() if p.IsA(UsdGeom.Mesh)]
    )


def as_usd(mesh: trimesh.Trimesh, path: Path, *, up: str, metres: float) -> Path:
    layer = Sdf.Layer.CreateNew(str(path))
    stage = Usd.Stage.Open(layer)
    UsdGeom.SetStageUpAxis(stage, up)
    UsdGeom.SetStageMetersPerUnit(stage, metres)
    prim = UsdGeom.Mesh.Define(stage, "/Car")
    fill(prim, points=mesh.vertices.tolist(), faceVertexCounts=[3] * len(mesh.faces))
    fill(prim, faceVertexIndices=mesh.faces.ravel().tolist(), displayColor=[(0.1, 0.2, 0.3)])
    layer.Save()
    return path


@pytest.mark.parametrize("suffix, up, front, factor, hints", [
    ("glb", "+Y", "+Z", 1.0, {}),  # as glTF 2.0 says
    ("glb", "+Y", "-X", 1.0, {"front": "-X"}),
    ("glb", "+Z", "+Y", 1.0, {"up": "+Z", "front": "+Y"}),  # against its format
    ("obj", "+Y", "-Z", 100.0, {"unit": "cm", "front": "-Z"}),
    ("obj", "+Z", "-Y", 1000.0, {"unit": "mm", "up": "+Z"}),
    ("ply", "+Z", "+X", 1 / 0.0254, {"unit": "in", "up": "+Z", "front": "+X"}),
    ("usda", "+Z", "+Y", 1.0, {"front": "+Y"}),
    ("usdc", "+Y", "+Z", 100.0, {}),
])  # fmt: skip
def test_unit_up_and_front_are_kept_to_and_the_model_stands_at_the_origin(tmp_path, suffix, up, front, factor, hints):
    """Whatever the axes and unit of the file, the same car results: cabin behind, wheels down, metres."""
    mesh, file = turned(car(), up, front, factor), tmp_path / f"My Car.{suffix}"
    if suffix.startswith("usd"):
        as_usd(mesh, file, up=up[1], metres=1 / factor)
    else:
        mesh.export(file)
    made = import_asset(file, "car", out=tmp_path / "lib", **hints)
    model = made.model
    assert (model.name, model.label, model.group) == ("my_car", "car", "vehicle")
    # OBJ of trimesh has eight decimals, USD five
    np.testing.assert_allclose(model.low, (-WIDTH / 2, -LENGTH / 2, 0), atol=2e-4)
    np.testing.assert_allclose(model.high, (WIDTH / 2, LENGTH / 2, HEIGHT), atol=2e-4)
    points = points_of(model.path)
    roof = points[points[:, 2] > HEIGHT - 0.01]
    assert roof[:, 1].mean() == pytest.approx(-0.35, abs=1e-3)
    assert abs(roof[:, 0].mean()) < 1e-3
    assert all(any(n.startswith(f"{name}:") for n in made.notes) for name in ("unit", "up", "front"))
    assert dict(library(tmp_path / "lib")).keys() == {"my_car"}
    assert sorted(f.name for f in model.path.parent.iterdir()) == ["my_car.geo.usdc", "my_car.mtl.usda", "my_car.usda"]
    stage = Usd.Stage.Open(str(model.path))
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    errors = UsdValidation.ValidationContext(validators).Validate(stage)
    assert [e.GetMessage() for e in errors] == []


def test_what_is_said_goes_before_what_is_guessed(tmp_path):
    """Up, front and length given: the cabin comes to lie in front, and the length is the one asked for."""
    file = tmp_path / "car.ply"
    car().export(file)
    made = import_asset(file, "car", out=tmp_path / "lib", up="+Z", front="-Y", length_m=3.3)
    points = points_of(made.model.path)
    assert points[points[:, 2] > 0.99 * points[:, 2].max()][:, 1].mean() == pytest.approx(0.35 * 0.75, abs=1e-3)
    assert made.model.length == pytest.approx(3.3, abs=1e-4)
    assert made.model.width == pytest.approx(WIDTH * 0.75, abs=1e-4)


def test_picture_and_factor_of_gltf_are_kept_and_colours_of_obj_become_linear(tmp_path):
    """A factor of glTF is linear already; an OBJ's Kd is meant for the screen (IEC 61966-2-1, by colour-science)."""
    from PIL import Image

    box = turned(car(), "+Y", "+Z", 1.0)
    picture = Image.new("RGB", (8, 4), (200, 30, 40))
    uv = np.random.default_rng(1).random((len(box.vertices), 2))
    look = trimesh.visual.material.PBRMaterial(
        name="paint", baseColorTexture=picture, roughnessFactor=0.25, metallicFactor=0.5
    )
    box.visual = trimesh.visual.TextureVisuals(uv=uv, material=look)
    box.export(tmp_path / "car.glb")
    model = import_asset(tmp_path / "car.glb", "car", out=tmp_path / "lib").model
    stage = Usd.Stage.Open(str(model.path))
    image = UsdShade.Shader(stage.GetPrimAtPath("/car/Materials/paint/Colour")).GetInput("file").Get()
    with Image.open(image.resolvedPath) as kept:
        assert kept.size == (8, 4)
        assert kept.getpixel((3, 2)) == (200, 30, 40)
    assert Path(image.resolvedPath).is_relative_to(model.path.parent)
    surface = UsdShade.Shader(stage.GetPrimAtPath("/car/Materials/paint/Surface"))
    assert surface.GetInput("roughness").Get() == pytest.approx(0.25)
    assert surface.GetInput("metallic").Get() == pytest.approx(0.5)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/car/Geometry/paint"))
    st = np.array(UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st").Get())
    assert st.shape == (len(mesh.GetPointsAttr().Get()), 2)
    # glTF counts v downward, trimesh and USD upward: the same corner has the same coordinates again
    gaps = np.linalg.norm(st[:, None] - uv[None], axis=-1)
    assert max(gaps.min(axis=0).max(), gaps.min(axis=1).max()) < 1e-4  # files keep four decimals

    (tmp_path / "kd.mtl").write_text("newmtl red\nKd 0.5 0.1 0.05\n")
    text = trimesh.exchange.obj.export_obj(car(), include_normals=False)
    (tmp_path / "kd.obj").write_text(
        "mtllib kd.mtl\nusemtl red\n" + "\n".join(line for line in text.splitlines() if line[:2] in ("v ", "f ")) + "\n"
    )
    model = import_asset(tmp_path / "kd.obj", "car", out=tmp_path / "lib", **AXES).model
    stage = Usd.Stage.Open(str(model.path))
    shaders = [UsdShade.Shader(p) for p in stage.Traverse() if p.IsA(UsdShade.Shader)]
    expected = colour.models.eotf_sRGB(np.round(np.array([0.5, 0.1, 0.05]) * 255) / 255)
    np.testing.assert_allclose(shaders[0].GetInput("diffuseColor").Get(), expected, atol=0.01)  # trimesh keeps 8 bits


@pytest.mark.parametrize("factor, up", [(100.0, "+Y"), (1.0, "+Z")])
def test_a_size_that_no_car_has_is_refused_with_the_options_that_mend_it(tmp_path, factor, up):
    """Centimetres taken for metres, and a car that stands on its nose."""
    turned(car(), up, "-Y" if up == "+Z" else "+Z", factor).export(tmp_path / "car.obj")
    with pytest.raises(ParameterError, match=r"no usual size of a car .* Give --unit.*--up or --front") as error:
        import_asset(tmp_path / "car.obj", "car", out=tmp_path / "lib")
    assert "\n" not in str(error.value) and not (tmp_path / "lib").exists()


def test_double_and_empty_triangles_go_and_many_triangles_get_a_low_level(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.8)  # 20 480 triangles
    faces = np.vstack([ball.faces, ball.faces[:100], [[0, 0, 1]] * 7])
    trimesh.Trimesh(ball.vertices, faces, process=False).export(tmp_path / "stone.ply")
    made = import_asset(tmp_path / "stone.ply", "static", out=tmp_path)
    full, low = made.triangles
    assert full == 20480
    assert 0 < low < 0.75 * full
    assert made.model.variants["lod"] == ("full", "low")
    assert any("107 of 20587" in note for note in made.notes)


def glb(scene: dict, binary: bytes = b"") -> bytes:
    """A GLB of a JSON scene and its buffer (glTF 2.0, section 4.4)."""
    text = json.dumps(scene).encode()
    text += b" " * (-len(text) % 4)
    chunks = (
        struct.pack("<I4s", len(text), b"JSON")
        + text
        + (struct.pack("<I4s", len(binary), b"BIN\0") + binary if binary else b"")
    )
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def many(count: int) -> bytes:
    """A GLB whose triangles' buffer is not there."""
    mesh = {"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}
    accessors = [
        {"count": 3, "componentType": 5126, "type": "VEC3"},
        {"count": 3 * count, "componentType": 5125, "type": "SCALAR"},
    ]
    return glb({"asset": {"version": "2.0"}, "meshes": [mesh], "accessors": accessors, "nodes": [{"mesh": 0}]})


PLY = b"ply\nformat ascii 1.0\nelement vertex "
AWAY = b'{"asset": {"version": "2.0"}, "buffers": [{"uri": "../../secret.bin", "byteLength": 4}]}'
RING = {"asset": {"version": "2.0"}, "nodes": [{"children": [0]}], "scenes": [{"nodes": [0]}], "scene": 0}
BEYOND = b"point3f[] points = [(0,0,0)]\nint[] faceVertexCounts = [3]\nint[] faceVertexIndices = [0, 1, 2]"


@pytest.mark.parametrize("name, data, said", [
    ("noise.glb", bytes(range(256)) * 8, "cannot be read"),
    ("text.gltf", b"{not json", "cannot be read"),
    ("cut.glb", many(10)[:-20], "cannot be read"),
    ("no_buffer.glb", many(10), "cannot be read"),
    ("ring.glb", glb(RING), "cannot be read|no triangles"),
    ("away.gltf", AWAY, "outside its own folder|cannot be read|no triangles"),
    ("claims.ply", PLY + b"99999999\nproperty float x\nend_header\n", "cannot be read"),
    ("points.ply", PLY + b"1\n" + b"".join(b"property float %c\n" % c for c in b"xyz") + b"end_header\n0 0 0\n", "no"),
    ("index.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "cannot be read"),
    ("nan.obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not finite|cannot be read"),
    ("flat.obj", b"v 0 0 0\nv 0 0 0\nv 0 0 0\nf 1 2 3\n", "without area|no triangles"),
    ("text.usda", b"#usda 1.0\ndef Xform 'A' {", "not a USD file|cannot be read"),
    ("index.usda", b'#usda 1.0\ndef Mesh "A" {\n' + BEYOND + b"\n}\n", "do not fit"),
    ("car.fbx", b"Kaydara", "not a kind of file"),
])  # fmt: skip
def test_hostile_files_are_one_line_and_leave_nothing(tmp_path, name, data, said):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(StageError, match=said) as error:
        import_asset(tmp_path / name, "car", out=tmp_path / "lib")
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 400 + len(str(tmp_path))
    assert not (tmp_path / "lib").exists()


def test_a_damaged_or_huge_picture_is_one_line(tmp_path, monkeypatch):
    """The pixels of a PNG inside a GLB are noise; and one of 32 pixels where 31 are allowed."""
    from PIL import Image

    mesh = turned(car(), "+Y", "+Z", 1.0)
    look = trimesh.visual.material.PBRMaterial(
        name="paint", baseColorTexture=Image.effect_noise((64, 64), 80).convert("RGB")
    )
    mesh.visual = trimesh.visual.TextureVisuals(uv=np.zeros((len(mesh.vertices), 2)), material=look)
    data = trimesh.exchange.gltf.export_glb(trimesh.Scene(mesh))
    at = data.index(b"IDAT") + 40
    (tmp_path / "noise.glb").write_bytes(data[:at] + bytes(200) + data[at + 200 :])
    (tmp_path / "sound.glb").write_bytes(data)
    with pytest.raises(StageError, match="cannot be read"):
        import_asset(tmp_path / "noise.glb", "car", out=tmp_path / "lib")
    monkeypatch.setattr(meshfiles, "MOST_PICTURE_PX", 64 * 64 - 1)
    with pytest.raises(StageError, match="64 x 64 pixels, more than the 4,095"):
        import_asset(tmp_path / "sound.glb", "car", out=tmp_path / "lib")
    assert not (tmp_path / "lib").exists()
    monkeypatch.setattr(meshfiles, "MOST_PICTURE_PX", 64 * 64)
    assert import_asset(tmp_path / "sound.glb", "car", out=tmp_path / "lib").model.label == "car"


def test_wrong_wishes_are_told_with_what_is_allowed(tmp_path):
    file = tmp_path / "car.ply"
    car().export(file)
    wishes: list[tuple[dict, str]] = [
        ({"label": "caar"}, "Did you mean 'car'"),
        ({"label": "spaceship"}, "allowed are car, truck"),
        ({"label": "building", "unit": None}, "no usual size"),
        ({"unit": "mile"}, "allowed are m, cm"),
        ({"up": "Z"}, r"allowed are \+X"),
        ({"up": "+Z", "front": "-Z"}, "same axis"),
        ({"length_m": -1.0}, "above 0"),
        ({"length_m": float("nan")}, "above 0"),
        ({"length_m": 4.0, "unit": "m"}, "one of them"),
        ({"name": "no/slash"}, "not a prim name"),
        ({"name": "../up"}, "not a prim name"),
    ]
    flat = trimesh.creation.box(extents=(1.0, 40.0, 0.001))
    flat.export(tmp_path / "flat.ply")
    for wish, said in wishes:
        source = tmp_path / "flat.ply" if wish.get("label") == "building" else file
        with pytest.raises(ParameterError, match=said):
            import_asset(source, **{"label": "car", **wish}, out=tmp_path / "lib")
    assert not (tmp_path / "lib").exists()


def test_a_taken_name_is_not_written_over(tmp_path):
    file = tmp_path / "car.ply"
    car().export(file)
    first = import_asset(file, "car", out=tmp_path / "lib", **AXES).model.path.read_bytes()
    with pytest.raises(OutputError, match="already"):
        import_asset(file, "car", out=tmp_path / "lib", unit="m")
    again = import_asset(file, "car", out=tmp_path / "other", **AXES).model.path.read_bytes()
    assert first == again


def test_the_command_says_what_it_made_and_one_line_of_error(tmp_path):
    file = tmp_path / "car.ply"
    car().export(file)
    command = ["asset", "import", file, "-o", tmp_path / "lib", "--up", "+Z", "--front", "+Y", "--class"]
    done = cli.run(*command, "car", "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert (told["class"], told["length_m"]) == ("car", LENGTH)
    assert Path(told["path"]).is_file()
    failed = cli.run(*command, "cra")
    assert failed.returncode == 2
    assert failed.stderr.count("\n") == 1
    assert "Did you mean 'car'" in failed.stderr


def test_the_command_reads_no_layer_from_elsewhere(tmp_path):
    """A car that refers to a file beside its folder is refused, and so is one that would unfold to 2^30 prims."""
    (tmp_path / "secret.usda").write_text('#usda 1.0\n(defaultPrim = "A")\ndef Mesh "A" {}\n')
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "reach.usda").write_text(
        '#usda 1.0\n(defaultPrim = "A")\ndef Xform "A" (references = @../secret.usda@) {}\n'
    )
    levels = "".join(
        f'class "L{n}" {{\ndef "a" (references = </L{n + 1}>) {{\n}}\ndef "b" (references = </L{n + 1}>) {{\n}}\n}}\n'
        for n in range(30)
    )
    (tmp_path / "in" / "bomb.usda").write_text(
        f'#usda 1.0\n(defaultPrim = "A")\ndef Xform "A" (references = </L0>) {{}}\n{levels}class "L30" {{}}\n'
    )
    for name, said in (("reach", "secret.usda"), ("bomb", "prims")):
        done = cli.run("asset", "import", tmp_path / "in" / f"{name}.usda", "-o", tmp_path / "lib", "--class", "car")
        assert done.returncode == 2 and said in done.stderr and len(done.stderr.splitlines()) == 1, done.stderr
        assert not (tmp_path / "lib").exists()
