"""The wheel: what is in it, and that it bakes where there is no checkout."""

import email
import importlib.util
import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from support.stages import street

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = ("assets", "stages", "pipeline", "integrations")


def files_below(folder):
    """Names of all files, relative to the project's root; no caches."""
    return {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The built wheel; one second, without network."""
    if importlib.util.find_spec("hatchling") is None:
        pytest.skip("hatchling is not installed: pip install -e '.[dev]'")
    out = tmp_path_factory.mktemp("dist")
    built = subprocess.run(
        [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(out), str(ROOT)],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert built.returncode == 0, built.stdout + built.stderr
    (path,) = out.iterdir()
    return path


@pytest.fixture(scope="module")
def content(wheel):
    """Name -> bytes of every file in the wheel."""
    with zipfile.ZipFile(wheel) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def test_every_module_and_data_file_is_in_it_unchanged(content):
    """Package, assets, stages and pipelines: what the checkout has, byte for byte, the last three below
    synfog_usd/data; the workshop stays away.
    """
    expected = {name: name for name in files_below("synfog_usd")}
    expected |= {
        f"synfog_usd/data/{name}": name
        for folder in SHIPPED
        for name in files_below(folder)
        if not name.startswith("assets/builders/")
    }
    packed = {name for name in content if name.startswith("synfog_usd/")}
    assert packed == set(expected)
    assert not [name for name, source in expected.items() if content[name] != (ROOT / source).read_bytes()]


def test_nothing_else_is_in_it(content):
    """Beside the package only its metadata: no tests, docs, images or settings."""
    tops = {name.split("/")[0] for name in content}
    (metadata,) = tops - {"synfog_usd"}
    assert metadata.startswith("synfog_usd-") and metadata.endswith(".dist-info")
    assert not [
        name for name in content if "test" in Path(name).stem.split("_") or name.endswith((".pyc", ".png.aux", "~"))
    ]


def test_shipped_files_do_not_look_out_of_their_folder(content):
    """No stage or pipeline names a path of the machine that it was made on."""
    texts = {
        name: data
        for name, data in content.items()
        if name.startswith("synfog_usd/data/") and name.endswith((".usda", ".yaml"))
    }
    assert len(texts) > 50
    assert not [
        name
        for name, data in texts.items()
        if any(mark in data for mark in (b"@/", b"file:/", b"/home/", b"/tmp/", str(ROOT).encode()))
    ]


def test_its_metadata_says_what_pyproject_says(content):
    """One command, pure Python, version, licence, Python range."""
    by_name = {name.rpartition("/")[2]: data.decode() for name, data in content.items() if ".dist-info/" in name}
    from synfog_usd import __version__

    assert by_name["entry_points.txt"].split() == ["[console_scripts]", "synfog-usd", "=", "synfog_usd.cli.main:main"]
    assert "Root-Is-Purelib: true" in by_name["WHEEL"] and "Tag: py3-none-any" in by_name["WHEEL"]
    metadata = email.message_from_string(by_name["METADATA"])
    assert (
        metadata["Name"] == "synfog-usd"
        and metadata["Version"] == __version__
        and metadata["License-Expression"] == "Apache-2.0"
    )
    assert set(metadata["Requires-Python"].split(",")) == {">=3.10", "<3.14"}
    assert "Apache License" in by_name["LICENSE"]
    assert "](docs/" not in metadata.get_payload(), "a link of README that leads nowhere from a package index"


def test_the_same_checkout_gives_the_same_wheel(wheel, tmp_path):
    """Byte for byte: no times and no order of a directory in it."""
    again = subprocess.run(
        [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(tmp_path), str(ROOT)],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert again.returncode == 0, again.stderr
    assert (tmp_path / wheel.name).read_bytes() == wheel.read_bytes()


@pytest.fixture(scope="module")
def away(wheel, tmp_path_factory):
    """Runs Python in an empty folder, with the unpacked wheel before everything else: (site folder, empty folder,
    run).
    """
    site, empty = tmp_path_factory.mktemp("site"), tmp_path_factory.mktemp("away")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    environment = {**os.environ, "PYTHONPATH": str(site), "PYTHONDONTWRITEBYTECODE": "1"}

    def run(*arguments):
        done = subprocess.run(
            [sys.executable, *map(str, arguments)], cwd=empty, env=environment, capture_output=True, text=True,
            timeout=300,
        )  # fmt: skip
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout.strip()

    assert run("-c", "from synfog_usd.base import resources; print(resources.folder('stages'))") == str(
        site / "synfog_usd" / "data" / "stages"
    )
    return site, empty, run


def test_the_shipped_stage_finds_all_its_assets_in_the_wheel(away):
    """Every layer and texture that the crossing composes lies in the unpacked wheel; none is missing."""
    site, _, run = away
    ask = """if True:
        import json
        from pxr import UsdUtils
        from synfog_usd.base import resources
        layers, assets, missing = UsdUtils.ComputeAllDependencies(str(resources.folder("stages") / "crossroads.usda"))
        print(json.dumps([[layer.realPath for layer in layers], list(assets), list(missing)]))
    """
    layers, assets, missing = json.loads(run("-c", ask))
    assert missing == []
    assert len(layers) > 50 and len(assets) > 5
    assert not [path for path in layers + assets if not Path(path).is_relative_to(site)]


def test_the_wheel_bakes_where_there_is_no_checkout(away, content):
    """Fog schema, default pipeline, sensor and lens come from the unpacked wheel."""
    site, empty, run = away
    (empty / "street.usda").write_text(street())
    run(
        "-m", "synfog_usd.cli.main", "bake", "street.usda", "-o", "out", "--resolution", "32x18", "--samples", "4",
        "--fog", "mor150", "--lighting", "sky",
    )  # fmt: skip
    assert {path.name for path in (empty / "out" / "sky" / "mor150").iterdir()} == {
        "radiance.exr", "layers.exr", "raw.dng", "srgb.png", "instances.json",
    }  # fmt: skip
    assert {path.relative_to(site).as_posix() for path in site.rglob("*") if path.is_file()} == set(content)
