"""`import synfog_usd as sf`: what is there, and that it is what the command does."""

import ast
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from support.cli import run
from support.stages import street

import synfog_usd as sf
from synfog_usd.base.image import Quantity
from synfog_usd.camera import writers

HEAVY = ("mitsuba", "drjit", "pxr", "OpenImageIO", "numpy", "scipy", "pyarrow", "distributed")
VIEW = ("--lighting", "sky", "--fog", "clear,mor150", "--resolution", "48x27", "--quality", "draft", "--seed", "3")
SAME = {"lighting": "sky", "resolution": (48, 27)}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A street, and in `command` its bake by the command line."""
    folder = tmp_path_factory.mktemp("door")
    (folder / "street.usda").write_text(street(lamp=True))
    done = run("bake", "street.usda", "-o", "command", *VIEW, cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="module")
def scene(folder):
    return sf.load(folder / "street.usda", fog=150, **SAME)


@pytest.fixture(scope="module")
def frame(scene):
    return sf.render(scene, quality="draft", seed=3)


FRESH = """
import sys
{what}
heavy = sorted({{name.partition(".")[0] for name in sys.modules}} & {{*{heavy}}})
print(*heavy)
"""


@pytest.mark.parametrize(
    "what",
    [
        "import synfog_usd as sf; dir(sf); sf.__version__",
        "import synfog_usd as sf; sf.SynfogError",
        "import contextlib, io, synfog_usd.cli.main as line\n"
        "with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit): line.main(['--help'])",
    ],
    ids=["import", "error", "help"],
)
def test_nothing_heavy_is_imported_before_it_is_used(what):
    done = subprocess.run(
        [sys.executable, "-c", FRESH.format(what=what, heavy=HEAVY)], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == []


def test_type_checkers_see_the_names_that_there_are():
    """Below TYPE_CHECKING the same names are imported from the places that are looked up."""
    tree = ast.parse(Path(sf.__file__).read_text(encoding="utf-8"))
    (block,) = [node for node in tree.body if isinstance(node, ast.If)]
    seen = {alias.asname: (line.module, alias.name) for line in block.body for alias in line.names}
    assert seen == {name: (module, name) for name, module in sf._places.items()}
    assert sorted(sf.__all__) == sorted(seen) and {*dir(sf)} == {*seen, "__version__"}
    for name in seen:
        assert getattr(sf, name).__doc__, name


def test_the_function_stays_where_a_package_has_its_name():
    """Python puts `synfog_usd.render` beside the door's names when it is imported."""
    words = "import synfog_usd as sf, synfog_usd.render.backend, synfog_usd.fog; assert callable(sf.render), sf.render"
    subprocess.run([sys.executable, "-W", "error", "-c", words], check=True)


def test_a_citation_is_of_this_version():
    """CITATION.cff has the version of the package, and the licence of pyproject.toml."""
    root = Path(__file__).resolve().parents[1]
    cited = yaml.safe_load((root / "CITATION.cff").read_text(encoding="utf-8"))
    assert cited["version"] == sf.__version__
    assert f'license = "{cited["license"]}"' in (root / "pyproject.toml").read_text(encoding="utf-8")


def test_other_names_are_not_there():
    with pytest.raises(AttributeError, match=r"no attribute 'rendr'; it has load"):
        sf.rendr  # noqa: B018


def contents(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_bake_has_the_bytes_of_the_command(folder):
    """All files, and nothing else; a second call keeps both shots."""
    out = folder / "python"
    words = {"fog": ["clear", sf.Fog(150)], "quality": "draft", "seed": 3}
    assert set(sf.bake(folder / "street.usda", out=out, **SAME, **words).seconds) == {"sky/clear", "sky/mor150"}
    assert contents(out) == contents(folder / "command")
    assert sf.bake(folder / "street.usda", out=str(out), **SAME, **words).kept == ("sky/clear", "sky/mor150")


def test_a_frame_has_the_numbers_of_a_bake(folder, frame):
    """radiance.exr, labels.exr and layers.exr, bit for bit."""
    shot = folder / "command/sky/mor150"

    def channels(path, *names):
        return writers.read_exr(path, quantity=Quantity.DATA, channels=names).pixels

    def equal(array, path, *names):
        wanted = channels(path, *names)
        np.testing.assert_array_equal(array if array.ndim == 3 else array[:, :, None], wanted)

    equal(frame.radiance, shot / "radiance.exr", "R", "G", "B")
    labels, layers = folder / "command/labels.exr", shot / "layers.exr"
    equal(frame.depth_m, labels, "depth.Z")
    equal(frame.distance_m, labels, "distance.Z")
    equal(frame.normal, labels, "N.X", "N.Y", "N.Z")
    equal(frame.instance_id, labels, "instance.ID")
    equal(frame.class_id, labels, "semantic.ID")
    equal(frame.transmittance, layers, "transmittance.Y")
    equal(frame.error, layers, "error.Y")
    equal(frame.variance, layers, "variance.R", "variance.G", "variance.B")
    for name, light in frame.layers.items():
        equal(light, layers, *(f"{name}.{channel}" for channel in "RGB"))
    named = {one.id: one.label for one in frame.instances}
    assert named[int(frame.instance_id[13, 24])] == "wall"


def test_a_photo_has_the_bytes_of_a_bake(folder, frame):
    """Metered on the clear frame, as a bake's; what is saved, and the arrays beside the files."""
    photo, shot = sf.develop(frame, camera="phone"), folder / "command/sky/mor150"
    for name in ("raw.dng", "srgb.png"):
        assert photo.save(folder / name).read_bytes() == (shot / name).read_bytes()
    raw = writers.read_raw(shot / "raw.dng")
    np.testing.assert_array_equal(photo.raw, raw.pixels[:, :, 0])
    from PIL import Image

    np.testing.assert_array_equal(photo.srgb, np.asarray(Image.open(shot / "srgb.png")))
    np.testing.assert_array_equal(
        writers.read_exr(photo.save(folder / "street.exr"), quantity=Quantity.LINEAR_RGB).pixels, photo.linear
    )
    assert frame.save(folder / "light.exr").exists()


def test_other_fogs_share_what_is_loaded(scene, frame):
    """Each as if it were loaded alone, and the first again the same."""
    dense = sf.render(scene.in_fog("mor40"), quality="draft", seed=3)
    alone = sf.render(sf.load(scene.stage, fog=40.0, **SAME), quality="draft", seed=3)
    np.testing.assert_array_equal(dense.radiance, alone.radiance)
    assert dense.transmittance.mean() < frame.transmittance.mean()
    np.testing.assert_array_equal(sf.render(scene, quality="draft", seed=3).radiance, frame.radiance)
    assert (sf.render(scene.in_fog("clear"), quality="draft").transmittance == 1.0).all()


def test_a_fog_s_own_words_reach_the_medium(scene):
    """Fog that absorbs is darker; a phase function of its own is drawn; the transmittance is Koschmieder's."""
    white, grey = (sf.render(scene.in_fog(sf.Fog(30, albedo=albedo)), quality="draft") for albedo in (1.0, 0.5))
    assert grey.radiance.mean() < 0.8 * white.radiance.mean()
    seen = np.isfinite(white.distance_m)
    np.testing.assert_allclose(white.transmittance[seen], 0.05 ** (white.distance_m[seen] / 30.0), rtol=1e-4)
    drops = sf.render(scene.in_fog(sf.Fog(30, phase="droplets", droplet_diameter_um=8)), quality="draft")
    assert not np.array_equal(drops.radiance, white.radiance)


def test_any_array_is_developed():
    """Integers, doubles and lists; with depth where a graph asks for it; the seed counts."""
    grey = np.full((20, 32, 3), 300)
    one, other = sf.develop(grey), sf.develop(grey.astype(np.float64).tolist(), camera="phone", seed=1)
    assert one.raw.shape == (20, 32) and one.raw.dtype == np.uint16 and one.srgb.shape == (20, 32, 3)
    assert not np.array_equal(one.raw, other.raw)
    brighter = sf.develop(grey, meter=grey * 4, ev=2)
    assert brighter.exposure.exposure_s == pytest.approx(one.exposure.exposure_s, rel=1e-3)
    fixed = sf.develop(grey, "dashcam", exposure="1/200", iso=200)
    assert fixed.exposure is None and fixed.outputs["raw.dng"].provenance["iso"] == 200
    nodes = [{"name": "gain", "iso": 400}]
    words = sf.develop(grey, {"extends": "phone", "nodes": nodes, "outputs": {"linear.exr": "colour"}}, seed=7)
    changed = sf.develop(grey, "phone", change={"gain.iso": 400}, seed=7)
    np.testing.assert_array_equal(words.raw, changed.raw)
    np.testing.assert_array_equal(words.outputs["linear.exr"].pixels, words.linear)


STREET = object()
"""Stands for the folder's stage."""

WRONG = [
    (sf.load, ["gone.usda"], {}, "gone.usda"),
    (sf.load, [STREET], {"fog": -3}, "--fog -3"),
    (sf.load, [STREET], {"fog": ["clear", 150]}, "one fog"),
    (sf.load, [STREET], {"lighting": "noon"}, "active, sky"),
    (sf.load, [STREET], {"lighting": ["sky", "active"]}, "load takes one"),
    (sf.load, [STREET], {"camera": "phone"}, "--camera phone"),
    (sf.load, [STREET], {"resolution": (0, 27)}, "--resolution 0x27"),
    (sf.load, [STREET], {"quality": "draft"}, "no option 'quality'"),
    (sf.render, ["street.usda"], {}, "takes a scene of load"),
    (sf.bake, [STREET, "out"], {"quality": "foo"}, "--quality foo"),
    (sf.bake, [STREET, "out"], {"samples": "many"}, "--samples 'many'"),
    (sf.bake, [STREET, "out"], {"sample": 4}, "Did you mean 'samples'"),
    (sf.bake, [STREET, "out"], {"seed": None, "strict": "no"}, "--strict 'no'"),
    (sf.develop, [np.zeros((4, 4))], {}, "shape"),
    (sf.develop, [np.full((4, 4, 3), -1.0)], {}, "negative"),
    (sf.develop, [np.ones((4, 4, 3))], {"camera": "fone"}, "Did you mean 'phone'"),
    (sf.develop, [np.ones((4, 4, 3))], {"exposure": "long"}, "--exposure long"),
    (sf.develop, ["gone.exr"], {}, "gone.exr"),
    (sf.compose, ["residental", "x.usda"], {"seed": 1}, "Did you mean 'residential'"),
    (sf.check, ["gone.usda"], {}, "gone.usda"),
    (sf.make_set, ["minni", "out"], {}, "Did you mean 'mini'"),
    (sf.make_set, [{"scenes": 0}, "out"], {}, "scenes"),
]


@pytest.mark.parametrize("call, given, words, told", WRONG, ids=[f"{row[0].__name__}-{row[3]}" for row in WRONG])
def test_what_is_wrong_is_told_in_the_command_s_words(call, given, words, told, folder, monkeypatch):
    """By one kind of error, before anything is written."""
    monkeypatch.chdir(folder)
    with pytest.raises(sf.SynfogError) as caught:
        call(*("street.usda" if one is STREET else one for one in given), **words)
    assert told in str(caught.value)
    assert not (folder / "out").exists()


@pytest.mark.parametrize(
    "words, told", [({"quality": "foo"}, "foo"), ({"fog": 3}, "no option 'fog'"), ({"seed": "x"}, "'x'")]
)
def test_a_render_tells_what_is_wrong_too(scene, words, told):
    with pytest.raises(sf.SynfogError, match=told):
        sf.render(scene, **words)


def test_a_stranger_s_stage_without_anything(tmp_path):
    """No variants, no fog, no label: as authored; without a camera the sentence names what to do."""
    plain = """#usda 1.0
( metersPerUnit = 1
  upAxis = "Z" )
def Cube "Box" { double3 xformOp:translate = (0, 0, -8)
 uniform token[] xformOpOrder = ["xformOp:translate"]
}
def DomeLight "Sky"
{ float inputs:intensity = 500
}
"""
    path = tmp_path / "plain.usda"
    path.write_text(plain + 'def Camera "Eye" { }\n')
    seen = sf.load(path, resolution=(32, 18))
    assert (seen.lighting, seen.fog, seen.camera) == ("authored", "authored", "/Eye")
    clear, foggy = (sf.render(one, quality="draft") for one in (seen, seen.in_fog(20)))
    assert (clear.transmittance == 1.0).all() and foggy.transmittance.min() < 0.5
    assert sf.develop(foggy).srgb.shape == (18, 32, 3)
    path.write_text(plain)
    with pytest.raises(sf.SynfogError, match="camera"):
        sf.load(path)


def test_check_reads_as_the_command_prints_it(folder):
    found = sf.check(folder / "street.usda")
    assert found.errors == () and f"{found}\n" == run("check", folder / "street.usda").stdout


def test_a_set_is_made_from_python(folder, monkeypatch):
    """Words as in the file; the units are made by the command line's own children, and a second call keeps them."""
    pytest.importorskip("pyarrow")
    pytest.importorskip("distributed")
    monkeypatch.chdir(folder)
    words = {"scenes": 1, "stages": ["street.usda"], "lightings": ["sky"], "fogs": ["clear", 150], "size": [32, 18]}
    words |= {"quality": "draft", "pipelines": ["phone"]}
    done = sf.make_set(words, "set", workers=1)
    assert (done.made, done.aside) == (1, {})
    found = list(sf.pictures("set"))
    assert [(one.fog, one.mor_m) for one in found] == [("clear", None), ("mor150", 150.0)]
    assert all(one.files["srgb.png"].is_file() for one in found)
    assert sf.make_set(None, out="set").kept == 1
