"""The house rules: which room may import what, one name for each class, and what help loads."""

import ast
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parent.parent / "synfog_usd"

BELOW = {
    "base": set(),
    "fog": set(),
    "scene": {"fog"},
    "world": {"fog"},
    "stage": {"fog"},
    "translate": {"fog", "scene", "stage"},
    "render": {"fog", "scene"},
    "camera/graph": set(),
    "camera/writers": set(),
    "camera": {"camera/graph"},
}
"""Room -> the rooms that it may import, beside itself and the base."""

BELOW["dataset"] = set(BELOW)
BELOW["dataset/sets"] = BELOW["dataset/exports"] = {*BELOW["dataset"], "dataset", "dataset/sets", "dataset/exports"}
BELOW["lab"] = {*BELOW["dataset/sets"], "lab"}
BELOW["cli"] = BELOW["lab"]

HEAVY = {
    "pxr": {"stage", "translate", "world"},
    "MaterialX": {"stage/materialx.py"},
    "mitsuba": {"render"},
    "drjit": {"render"},
    "OpenImageIO": {"camera", "camera/writers", "lab", "translate/texture.py", "world"},
    "matplotlib": {"lab"},
    "pyoidn": {"render"},
    "tifffile": {"camera/writers"},
    "imagecodecs": {"camera/writers"},
    "rawpy": {"camera/writers"},
    "pyarrow": {"dataset/sets"},
    "assets": set(),
}
"""Library -> where it may be imported; the workshop of what ships nowhere."""


def room_of(parts):
    """Room of a file or module: its folder, or the inner one where that is a room of its own."""
    inner = "/".join(parts[:2])
    return inner if inner in BELOW else parts[0]


def imports(path):
    """(module, line) of every import of a file, in functions too."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            assert node.level == 0, f"{path}:{node.lineno}: relative import"
            if node.module == "synfog_usd":
                yield from ((f"synfog_usd.{alias.name}", node.lineno) for alias in node.names)
            else:
                yield node.module, node.lineno


FILES = sorted(PACKAGE.rglob("*.py"))


@pytest.mark.parametrize("path", FILES, ids=[str(path.relative_to(PACKAGE)) for path in FILES])
def test_imports_follow_the_direction_of_the_data(path):
    """A room imports only the base and the rooms before it; heavy libraries stay in their rooms."""
    inside = path.relative_to(PACKAGE)
    if len(inside.parts) == 1:
        return
    room = room_of(inside.parts)
    for module, line in imports(path):
        first, *parts = module.split(".")
        if first == "synfog_usd" and parts:
            assert room_of(parts) in {room, "base", *BELOW[room]}, f"{inside}:{line}: {room} may not import {module}"
        elif first in HEAVY:
            allowed = HEAVY[first]
            assert room in allowed or inside.as_posix() in allowed, (
                f"{inside}:{line}: {first} may not be imported in {room}"
            )


def test_every_room_is_ruled():
    """A new folder needs a line in the table above, and no module stands beside the rooms."""
    rooms = {path.name for path in PACKAGE.iterdir() if path.is_dir() and path.name not in {"__pycache__", "data"}}
    assert rooms == {room.split("/")[0] for room in BELOW}
    assert [path.name for path in PACKAGE.glob("*.py")] == ["__init__.py"]


def test_no_two_classes_have_one_name():
    """One concept, one name: a reader who meets a class's name need not ask which of them is meant."""
    places = defaultdict(list)
    for path in FILES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                places[node.name].append(f"{path.relative_to(PACKAGE)}:{node.lineno}")
    assert len(places) > 100
    assert {name: where for name, where in places.items() if len(where) > 1} == {}


HELP = """
import sys
from synfog_usd.cli.main import main
for arguments in ["--help"], ["bake", "--help"], ["chart", "--help"], ["compose", "--help"], ["graph", "--help"], ["dataset", "--help"], ["--version"]:
    try:
        main(arguments)
    except SystemExit as end:
        assert not end.code, arguments
    print("LOADED", *sorted(sys.modules))
"""  # noqa: E501


def test_help_imports_nothing_heavy():
    """What help costs is what it loads: of this package the command line alone, and no library that draws, computes or
    knows USD.

    All in one process, so that what one page of help loads is seen at each that follows.
    """
    child = subprocess.run([sys.executable, "-c", HELP], capture_output=True, text=True)
    assert child.returncode == 0, child.stderr
    loaded = [set(line.split()[1:]) for line in child.stdout.splitlines() if line.startswith("LOADED ")]
    assert len(loaded) == 7
    ours = {name for name in loaded[-1] if name.split(".")[0] == "synfog_usd"}
    base = {f"base.{name}" for name in ("door", "errors", "isolated", "numbers", "system", "version")}
    line = {f"cli.{name}" for name in ("main", "options", "worker", "dataset")}
    assert ours == {"synfog_usd", *(f"synfog_usd.{name}" for name in {"base", "cli", *base, *line})}
    assert not loaded[-1] & {*HEAVY, "numpy", "scipy", "colour", "trimesh", "pymeshlab", "PIL", "yaml", "rich"}
