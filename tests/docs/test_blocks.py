"""Every block of code in the pages does what it says: Python runs, YAML and USD load, commands are read by the parser
that reads them, and those that are quick run.

A block that is not meant to run is marked by a comment in the line before it, `<!-- pattern: why -->`; one that is no
code has the word `text`.  YAML that begins with a comment of a file's name is written under that name for the blocks
of its page.  What a reader has, a stage or a picture of their own, is made by `furnish`.
"""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
import pytest
import typer
from PIL import Image as Picture
from pxr import Sdf
from support.cli import run
from support.stages import street

from synfog_usd import camera
from synfog_usd.base import yamlio
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import writers
from synfog_usd.camera.profiles import load_lens, load_sensor
from synfog_usd.cli.main import app
from synfog_usd.dataset.sets import index, layout
from synfog_usd.dataset.sets.load import load_set
from synfog_usd.world import compose

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
LANGUAGES = ("sh", "python", "yaml", "usda", "text")
OURS = ("synfog-usd", ".venv/bin/synfog-usd")
QUICK = ("graph",)
"""Groups of commands that are run, and not only parsed."""


@dataclass(frozen=True)
class Block:
    """A fenced block: its page, the line of its fence, what stands behind the fence, whether it is marked, its text."""

    page: Path
    line: int
    language: str
    pattern: bool
    text: str

    def __str__(self) -> str:
        return f"{self.page.name}:{self.line}"

    @property
    def file(self) -> str:
        """The name that its first line gives it, or one of its own."""
        named = re.match(r"# ([\w./-]+\.yaml)\n", self.text)
        return named[1] if named else f"block_{self.line}.yaml"


def blocks_of(page: Path) -> list[Block]:
    found, lines = [], page.read_text(encoding="utf-8").splitlines(keepends=True)
    begin = None
    for number, line in enumerate(lines):
        if begin is None and line.startswith("```"):
            begin = number
        elif begin is not None and line.rstrip() == "```":
            marked = begin > 0 and re.match(r"<!-- pattern: \S.* -->$", lines[begin - 1].rstrip()) is not None
            text = "".join(lines[begin + 1 : number])
            found.append(Block(page, begin + 1, lines[begin][3:].strip(), marked, text))
            begin = None
    assert begin is None, f"{page.name}:{(begin or 0) + 1}: a fence that does not end"
    return found


BLOCKS = [block for page in PAGES for block in blocks_of(page)]


LONG = re.compile(r"^\s*(sf\.bake|done = sf\.make_set)\(", re.MULTILINE)
"""What makes a block slow: whole bakes and sets."""


def in_language(*languages: str) -> pytest.MarkDecorator:
    chosen = [block for block in BLOCKS if block.language in languages and not block.pattern]
    marked = [pytest.param(one, marks=pytest.mark.slow) if LONG.search(one.text) else one for one in chosen]
    return pytest.mark.parametrize("block", marked, ids=str)


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Path], Path]:
    """A page -> the folder in which its blocks work, with its files, and with what a reader has."""
    made: dict[Path, Path] = {}

    def folder_of(page: Path) -> Path:
        if page not in made:
            folder = made[page] = tmp_path_factory.mktemp(page.stem)
            for name in ("stages", "pipeline", "assets"):
                (folder / name).symlink_to(ROOT / name)
            furnish(folder)
            for block in blocks_of(page):
                if block.language == "yaml" and not block.pattern:
                    (folder / block.file).write_text(block.text, encoding="utf-8")
                for words, file in commands(block) if block.language == "sh" and not block.pattern else ():
                    if file and words[0] in OURS:
                        (folder / file).write_text(ran(words[1:], folder), encoding="utf-8")
        return made[page]

    return folder_of


def furnish(folder: Path) -> None:
    """Pictures, a stage, a recipe and networks of a reader's own; those that only are there are empty."""
    rng = np.random.default_rng(1)
    for name in ("shot", "foggy", "clear"):
        pixels = rng.uniform(50.0, 500.0, (24, 32, 3)).astype(np.float32)
        seen = Image(pixels, ("R", "G", "B"), Quantity.RADIANCE, provenance={"fov_x_deg": 60.0})
        writers.write_output(f"{name}.exr", seen, folder)
    (folder / "my_street.usda").write_text(street())
    (folder / "worlds").mkdir()
    (folder / "worlds" / "own.usd").write_text(street())
    (folder / "own.yaml").write_bytes((ROOT / "stages/recipes/rural.yaml").read_bytes())
    for name in ("mine.onnx", "ours.pt2", "run.py", "raw.py"):
        (folder / name).touch()


def furnish_mini(folder: Path) -> None:
    """The index and the pictures of a set out/mini: two scenes in clear air and in fog, 16 x 12 pixels of chance."""
    pytest.importorskip("pyarrow")
    rng, rows = np.random.default_rng(1), []
    for scene in range(2):
        for fog, mor_m in (("clear", None), ("mor150", 150.0)):
            shot = f"{layout.unit_folder(scene, 'sky')}/{fog}"
            named = {
                "scene": scene,
                "split": "train",
                "source": "rural",
                "seed": scene,
                "lighting": "sky",
                "camera": "",
            }
            named |= {"fog": fog, "mor_m": mor_m, "pipeline": "synfog", "width_px": 16, "height_px": 12}
            rows.append(
                {**named, "bake": shot.rpartition("/")[0], "shot": shot, "developed": shot, "outputs": ["srgb.png"]}
            )
            place = folder / "out" / "mini" / shot
            place.mkdir(parents=True)
            Picture.fromarray(rng.integers(0, 256, (12, 16, 3), dtype=np.uint8)).save(place / "srgb.png")
    index.write_part(folder / "out" / "mini", 0, rows)


def with_bake(folder: Path) -> Path:
    """The folder, with a bake of a small street in out."""
    if not (folder / "out" / "bake.json").exists():
        words = ("my_street.usda", "-o", "out", "--lighting", "sky", "--fog", "clear,mor150", "--resolution", "24x14")
        ran(["bake", *words, "--samples", "2", "--quality", "reference"], folder)
    return folder


def looked_at(words: list[str], folder: Path) -> None:
    """Run OpenImageIO's tool, which comes with its package; it writes the file that it is told to."""
    start = "import sys, OpenImageIO; sys.argv[0] = 'oiiotool'; sys.exit(OpenImageIO._command_line())"
    command = [sys.executable, "-c", start, *words]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "-o" not in words or (folder / words[words.index("-o") + 1]).stat().st_size > 0


def commands(block: Block) -> list[tuple[list[str], str]]:
    """The words of each line and the file that it is sent to, or ''; without comments and the cores that it may use."""
    found = []
    for line in block.text.splitlines():
        words = shlex.split(line, comments=True)
        if not words:
            continue
        file = words[words.index(">") + 1] if ">" in words else ""
        words = words[: words.index(">")] if ">" in words else words
        found.append((words[3:] if words[:2] == ["taskset", "-c"] else words, file))
    return found


def parsed(words: list[str]) -> None:
    """Read by the parser of the command line, without doing anything.

    Raises:
        click.ClickException: what the command would refuse before it begins.
    """
    command, name = typer.main.get_command(app), "synfog-usd"
    while hasattr(command, "commands"):
        name, *words = words
        command = command.commands[name]
    command.make_context(name, list(words))


def ran(words: list[str], folder: Path) -> str:
    done = run(*words, cwd=folder)
    assert done.returncode == 0, f"{shlex.join(words)}: {done.stderr}"
    return done.stdout


def test_every_block_says_what_it_is():
    """A language that is run here, or `text`; a mark stands before code alone, and no text hides a command."""
    assert {str(block): block.language for block in BLOCKS if block.language not in LANGUAGES} == {}
    for block in BLOCKS:
        if block.language == "text":
            assert not block.pattern, block
            assert not re.search(r"^(\S*/)?synfog-usd \w+ ", block.text, flags=re.MULTILINE), block
    marks = sum(page.read_text(encoding="utf-8").count("<!-- pattern:") for page in PAGES)
    assert marks == sum(block.pattern for block in BLOCKS)
    assert {block.language for block in BLOCKS if not block.pattern} == set(LANGUAGES)


@in_language("python")
def test_python_runs(block, folders):
    """By itself, in a Python of its own, in its page's folder."""
    folder = folders(block.page)
    if "torch" in block.text:
        pytest.importorskip("torch", reason="torch is not installed")
    if "out/mini" in block.text and not (folder / "out" / "mini").exists():
        furnish_mini(folder)
    if re.search(r'"out/(labels|sky)', block.text):
        with_bake(folder)
    done = subprocess.run([sys.executable, "-c", block.text], cwd=folder, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr


@in_language("yaml")
def test_yaml_loads(block, folders, monkeypatch):
    """By the loader of what its first key says; the nodes that a graph includes, by that graph."""
    folder = folders(block.page)
    monkeypatch.chdir(folder)
    path, fields = Path(block.file), yamlio.load_text(block.text).plain()
    kind = str(fields.get("synfog"))
    if kind == "graph/1" and not {"extends", "inputs"} & set(fields):
        assert any(f"include: {block.file}" in other.text for other in BLOCKS if other.page == block.page)
    elif kind == "graph/1":
        assert camera.load_graph(path).nodes
    elif kind == "set/1":
        assert load_set(path).scenes > 0
    elif kind == "recipe/1":
        compose.draw(compose.load(path), seed=1)
    elif kind in ("sensor/1", "lens/1"):
        (load_sensor if kind == "sensor/1" else load_lens)(str(path))
    else:
        pytest.fail(f"{block}: no loader takes it; give it its first key, or mark it as a pattern")


@in_language("usda")
def test_usd_is_a_layer(block, tmp_path):
    """Behind the line with which each layer begins; fog is baked, beside a sky and a camera, by our own model."""
    text = f"#usda 1.0\n{block.text}"
    assert Sdf.Layer.CreateAnonymous(".usda").ImportFromString(text)
    if "SynFogMediumAPI" in text:
        (tmp_path / "fog.usda").write_text(f'{text}\ndef Camera "Eye"\n{{\n}}\ndef DomeLight "Sky"\n{{\n}}\n')
        words = ("--fog", "authored,rain10+mor300", "--resolution", "24x14", "--samples", "2", "-o", "out")
        ran(["bake", "fog.usda", *words, "--quality", "reference"], tmp_path)
        shots = json.loads((tmp_path / "out" / "bake.json").read_text())["shots"]
        assert [shot["model"]["name"] for shot in shots] == ["path", "path"]


@in_language("sh")
def test_commands_are_right(block, folders):
    """Each line: ours are parsed, and the quick ones run; of others, the files, targets and packages are there."""
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), flags=re.MULTILINE))
    for words, _ in commands(block):
        program, rest = words[0], words[1:]
        if program in OURS:
            try:
                parsed(rest)
            except (click.ClickException, KeyError) as problem:
                pytest.fail(f"{block}: {shlex.join(words)}: {problem}")
            if rest[0] in QUICK:
                ran(rest, folders(block.page))
        elif program == "oiiotool":
            looked_at(rest, with_bake(folders(block.page)))
        elif program == "make":
            assert set(rest) <= targets
        elif program == "pip":
            assert rest[0] == "install" and installable(rest[1:]), words
        elif program.endswith("python") and rest[:2] != ["-m", "pytest"]:
            assert rest[0] == "-m" and (ROOT / rest[1].replace(".", "/")).with_suffix(".py").is_file(), words
        elif program.endswith(("pytest", "python")):
            assert all((ROOT / word).exists() for word in rest if word.startswith("tests/")), words
        else:
            assert program in ("cp", "dask", "sbatch"), f"{block}: {words}: nobody knows that program here"


def installable(words: list[str]) -> bool:
    """Whether pip would find it: this folder with a known extra, or packages that pyproject.toml names."""
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    extras = re.findall(r"^(\w+) = \[", text.split("[project.optional-dependencies]")[1].split("\n[")[0], re.MULTILINE)
    named = {name.lower() for name in re.findall(r'"([A-Za-z][\w.-]*)(?:\[[\w,]+\])?[><=~!]', text)}
    words = [word for word in words if word not in ("-e", "-q")]
    own = [match[1] for word in words if (match := re.fullmatch(r"\.\[(\w+)\]", word))]
    return set(own) <= set(extras) and {word.lower() for word in words if not word.startswith(".[")} <= named


def test_no_advice_names_a_package_that_no_index_has():
    """This program is in no package index: neither pages nor messages tell to install it or its extras from one."""
    files = [*PAGES, *(ROOT / "synfog_usd").rglob("*.py"), *(ROOT / "integrations").rglob("*.py")]
    assert [str(file) for file in files if re.search(r"synfog-usd\[\w", file.read_text(encoding="utf-8"))] == []
