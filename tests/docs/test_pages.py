"""The pages say what is there: links, images, paths and options."""

from __future__ import annotations

import ast
import fnmatch
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
TREE = [
    path.relative_to(ROOT).as_posix()
    for top in ("synfog_usd", "assets", "docs", "integrations", "pipeline", "stages", "tests")
    for path in (ROOT / top).rglob("*")
    if "__pycache__" not in path.parts
] + [path.name for path in ROOT.iterdir()]

OF_OTHERS = {"--background", "--fcd-output", "--find-links"}
"""Options in the pages that belong to other programs."""

EXAMPLES = (
    "numpy.py",
    "mitsuba.py",
    "out/",
    "OUT/",
    "models/tractor",
    ".venv",
    "~/",
    "./",
    "../",
    "cloud.",
    "mine.",
    "base.",
    "night.",
    "my_",
)
"""How names begin that a reader makes, or a bake."""

STUDIES = {
    f"--{argument.arg.replace('_', '-')}"
    for path in (ROOT / "docs" / "studies").glob("*.py")
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    if isinstance(node, ast.FunctionDef) and node.name == "main"
    for argument in node.args.args
}
"""Options of the studies beside the package."""

everywhere = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())


def spans(text: str) -> list[str]:
    """What stands in backticks within a line, blocks of code left out."""
    return re.findall(r"`([^`\n]+)`", re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE))


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub makes them."""
    heads = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return {re.sub(r"[^\w -]", "", head.lower()).strip().replace(" ", "-") for head in heads}


def exists(name: str) -> bool:
    """Whether a path of the pages is in the tree: whole, or the end of one; <name> stands for anything."""
    pattern = re.sub(r"<[^>]*>", "*", name.rstrip("/"))
    return any(fnmatch.fnmatchcase(path, pattern) or fnmatch.fnmatchcase(path, f"*/{pattern}") for path in TREE)


@everywhere
def test_links_lead_somewhere(page):
    """Every relative link and image exists, and the heading that it names."""
    broken = []
    for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if re.match(r"[a-z]+:", link):
            continue
        path, _, heading = link.partition("#")
        place = (page.parent / path).resolve() if path else page
        if not place.exists() or (heading and heading not in anchors(place)):
            broken.append(link)
    assert not broken


@everywhere
def test_options_exist(page):
    """Every option that a line names is there; whole commands are read by `test_blocks.py`."""
    text = page.read_text(encoding="utf-8")
    known = set(re.findall(r"--[a-z][a-z-]+", (ROOT / "docs/reference/cli.md").read_text(encoding="utf-8")))
    builders = (ROOT / "assets/builders/__main__.py").read_text(encoding="utf-8")
    alone = {match[0] for span in spans(text) if (match := re.match(r"--[a-z][a-z-]+", span))}
    assert {option for option in alone - known - OF_OTHERS - STUDIES if f'"{option}"' not in builders} == set()


@everywhere
def test_paths_in_backticks_exist(page):
    """A name with a folder, or of a Python file, is a file or folder of the tree, or one that its reader makes."""
    named = set()
    for span in spans(page.read_text(encoding="utf-8")):
        for word in span.split():
            if re.fullmatch(r"[\w.<>-]+(?:/[\w.<>-]+)*(?:/|\.(?:py|md|yaml|usda|json|exr|png|ies))", word) and (
                "/" in word or word.endswith(".py")
            ):
                named.add(word)
    assert {name for name in named if not name.startswith(EXAMPLES) and not exists(name)} == set()
