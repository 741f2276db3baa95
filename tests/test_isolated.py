"""What the program starts sees nothing of the current folder, and nothing of what a stranger's variables name."""

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from support.stages import street

from synfog_usd.base import isolated
from synfog_usd.cli.main import app
from synfog_usd.render import backend

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "synfog_usd"

TRAPS = (
    *("numpy", "mitsuba", "drjit", "yaml", "typer", "OpenImageIO", "pxr", "synfog_usd", "sitecustomize"),
    *("usercustomize", "scipy", "PIL", "tifffile", "rich", "distributed", "pyarrow", "torch", "matplotlib", "json"),
)
SET = """\
synfog: set/1
scenes: 1
stages: ['street.usda']
lightings: [sky]
fogs: [clear, 150]
size: [64, 36]
quality: {word: reference, samples: 2, model: single}
"""
BOX = """\
v 0 0 0
v 4 0 0
v 4 2 0
v 0 2 0
v 0 0 1
v 4 0 1
v 4 2 1
v 0 2 1
f 1 4 3 2
f 5 6 7 8
f 1 2 6 5
f 2 3 7 6
f 3 4 8 7
f 4 1 5 8
"""
RECIPE = str(ROOT / "stages" / "recipes" / "residential.yaml")
GRAPH = str(ROOT / "pipeline" / "synfog.yaml")
SMALL = ("--resolution", "24x14", "--samples", "2")
ONE = ("--lighting", "sky", "--fog")

VERBS = {
    "check": ["street.usda"],
    "bake": ["street.usda", "-o", "out", *SMALL, *ONE, "clear,mor150"],
    "preview": ["street.usda", "-o", "seen", *SMALL, *ONE, "clear"],
    "chart": ["street.usda", "-o", "chart", "--resolution", "16x9", "--samples", "4", "--models", "single"],
    "compose": [RECIPE, "--seed", "1", "-o", "road.usda"],
    "info": [],
    "plugin-path": ["--blender", "fog.zip"],
    "selftest": ["--quick"],
    "graph check": [GRAPH],
    "graph show": [GRAPH],
    "graph run": [GRAPH, "--in", "out/sky/mor150/radiance.exr", "-o", "developed"],
    "graph explain": ["sensor.gain"],
    "graph schema": [],
    "graph profile": ["sensor"],
    "asset import": ["box.obj", "--class", "car", "--length", "4", "-o", "models"],
    "dataset plan": ["tiny.yaml"],
    "dataset run": ["tiny.yaml", "-o", "set", "--quiet"],
    "dataset offers": [],
    "dataset status": ["set"],
    "dataset verify": ["set"],
    "dataset retry": ["set", "--quiet"],
    "dataset unit": ["set", "0", "sky"],
    "dataset export": ["set", "--as", "coco"],
    "dataset gallery": ["set"],
    "dataset stats": ["set"],
}
"""Every verb with words for a small piece of work in the folder of traps."""

MAKES = {"out": "bake", "set": "dataset run"}
"""Folders that verbs take, and the verb that makes them."""

QUICK = ("check",)
LONG_S = {"selftest": 15}
"""Verbs that are ended after so many seconds: all is imported by then."""


def verbs(group, before=""):
    """Names of all verbs, as they are typed."""
    for name, one in group.commands.items():
        if hasattr(one, "commands"):
            yield from verbs(one, f"{before}{name} ")
        else:
            yield f"{before}{name}"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder as a stranger may send it: a stage, and files with the names of modules, each of which tells in the
    folder beside it when it is imported; and Mitsuba's plugins, which are no libraries.
    """
    place = tmp_path_factory.mktemp("sent")
    told = tmp_path_factory.mktemp("told")
    for name in TRAPS:
        text = f"open({str(told / name)!r}, 'a').write(repr(__import__('sys').orig_argv))\n"
        (place / f"{name}.py").write_text(text)
    (place / "plugins").mkdir()
    (place / "plugInfo.json").write_text('{"Plugins": [{"Type": "library", "Name": "evil", "Root": ".", "Info": 7}]}')
    for name in ("sphere", "path", "preview_surface"):
        (place / "plugins" / f"{name}.so").write_bytes(b"no library")
    (place / "street.usda").write_text(street())
    (place / "box.obj").write_text(BOX)
    (place / "tiny.yaml").write_text(SET)
    return place, told


def strangers(place):
    """Variables that name a folder by which libraries load code."""
    names = ("PYTHONPATH", "PXR_PLUGINPATH_NAME", "PXR_USD_WINDOWS_DLL_PATH", "OIIO_LIBRARY_PATH", "LD_LIBRARY_PATH")
    return {**os.environ, **dict.fromkeys(names, str(place)), "PYTHONSTARTUP": str(place / "numpy.py")}


def started(place, verb, limit_s=300):
    """A verb, begun as its console script is in a Python that itself sees no PYTHONPATH; None if it was ended."""
    for word in VERBS[verb]:
        if MAKES.get(first := Path(word).parts[0], verb) != verb and not (place / first).exists():
            started(place, MAKES[first])
    words = [sys.executable, "-I", "-c", f"import sys; sys.path.append({str(ROOT)!r})\n{MAIN}", *verb.split()]
    with subprocess.Popen(
        [*words, *VERBS[verb]],
        cwd=place,
        env=strangers(place),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as child:
        try:
            out, err = child.communicate(timeout=LONG_S.get(verb, limit_s))
        except subprocess.TimeoutExpired:
            child.kill()
            return None
    return subprocess.CompletedProcess(words, child.returncode, out, err)


MAIN = "from synfog_usd.cli.main import main; main()"


def test_every_verb_is_tried():
    assert set(verbs(typer.main.get_command(app))) == set(VERBS)


def test_the_traps_are_sprung_by_a_plain_python(folder):
    """So the tests below could have failed: python -m, and PYTHONPATH."""
    place, told = folder
    subprocess.run([sys.executable, "-m", "numpy"], cwd=place, capture_output=True, check=False)
    subprocess.run([sys.executable, "-c", "import yaml"], cwd="/", env=strangers(place), check=False)
    assert {"numpy", "yaml", "sitecustomize"} <= {path.name for path in told.iterdir()}
    for path in told.iterdir():
        path.unlink()


@pytest.mark.parametrize(
    "verb", [pytest.param(verb, marks=[] if verb in QUICK else pytest.mark.slow) for verb in VERBS]
)
def test_a_verb_runs_nothing_of_the_folder_that_it_is_started_in(folder, verb):
    """Nor of those that variables name: no file of the folder is imported, by the verb or by what it starts."""
    place, told = folder
    done = started(place, verb)
    assert not sorted(path.name for path in told.iterdir())
    if done is not None:
        assert "plugInfo.json" not in done.stderr, done.stderr
        assert done.returncode == 0, done.stderr


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux shows what a process has loaded")
def test_mitsuba_loads_no_plugin_of_the_current_folder(tmp_path):
    """Shared libraries that could be loaded, under the names of a plugin of Mitsuba's, of one of ours, and of none."""
    (tmp_path / "plugins").mkdir()
    import mitsuba

    library = Path(mitsuba.__file__).parent / "plugins" / "constant.so"
    for name in ("sphere", "path", "preview_surface", "photometric", "merge"):
        shutil.copy(library, tmp_path / "plugins" / f"{name}.so")
    code = f"""if True:
        from pathlib import Path
        from synfog_usd.render import backend, load
        from synfog_usd.render import surface
        {"backend.start('scalar')" if backend.is_scalar() else "backend.start('llvm')"}
        surface.register()
        load.make_bsdf({{"type": "preview_surface", "base_color": {{"type": "rgb", "value": [0.1, 0.2, 0.3]}}}})
        backend.mitsuba().load_dict({{"type": "scene", "a": {{"type": "sphere"}}}})
        print([line for line in Path("/proc/self/maps").read_text().splitlines() if {str(tmp_path)!r} in line])
    """
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=with_us(), capture_output=True, text=True)
    assert done.stdout == "[]\n", done.stdout + done.stderr


def with_us(**more):
    """An environment in which a plain Python finds our package."""
    return {**os.environ, "PYTHONPATH": str(ROOT), **more}


def asked(expression, *, place, env=None, begun_with=()):
    """What an isolated child, which runs Python's own module `code`, says of itself; begun by a Python in a folder."""
    code = f"""if True:
        import subprocess, sys
        from synfog_usd.base import isolated
        ask = "import os, sys; print('SAID', {expression}, flush=True)\\n"
        words, env = isolated.command("code"), isolated.environment()
        done = subprocess.run(words, env=env, input=ask, capture_output=True, text=True)
        print(done.stdout.partition("SAID ")[2].splitlines()[0])
    """
    words = [sys.executable, *begun_with, "-c", code]
    done = subprocess.run(words, cwd=place, env=env or with_us(), capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_a_child_runs_the_code_that_its_parent_runs(tmp_path):
    """Another copy of the package, as in a clone: its child is of that copy, though ours may be installed."""
    copy = tmp_path / "clone" / "synfog_usd"
    (copy / "base").mkdir(parents=True)
    (copy / "__init__.py").write_text("")
    shutil.copy(PACKAGE / "base" / "isolated.py", copy / "base")
    where = "__import__('synfog_usd').__file__"
    assert asked(where, place=tmp_path, env=with_us(PYTHONPATH=str(copy.parent))) == str(copy / "__init__.py")
    assert asked(where, place=tmp_path) == str(PACKAGE / "__init__.py")


def test_a_child_has_neither_the_current_folder_nor_pythonpath(tmp_path):
    """Of what lies outside the installation it has our package's folder, at the end."""
    env = with_us(PYTHONPATH=os.pathsep.join((str(ROOT), "", str(tmp_path / "there"))))
    folders = ast.literal_eval(asked("sys.path", place=tmp_path, env=env))
    assert str(ROOT) in folders and str(tmp_path) not in folders and str(tmp_path / "there") not in folders
    assert all(map(os.path.isabs, folders)) and str(PACKAGE) not in folders


def test_what_only_pythonpath_has_is_told_in_a_line(tmp_path):
    """A child that misses a package which its parent would find there; without the variable it is a plain error."""
    (tmp_path / "only_there.py").write_text("")
    words = isolated.command("only_there")
    done = subprocess.run(words, env=with_us(PYTHONPATH=str(tmp_path)), capture_output=True, text=True, check=False)
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert "No module named only_there" in done.stderr and "PYTHONPATH" in done.stderr
    plain = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(words, env=plain, capture_output=True, text=True, check=False)
    assert done.returncode == 1 and "Traceback" in done.stderr


@pytest.mark.parametrize("variable, value, flags, asks, said", [
    ("PYTHONDONTWRITEBYTECODE", "1", (), "sys.dont_write_bytecode", "True"),
    ("PYTHONUNBUFFERED", "1", (), "'-u' in sys.orig_argv", "True"),
    ("PYTHONUTF8", "1", (), "sys.flags.utf8_mode", "1"),
    ("PYTHONIOENCODING", "latin-1", (), "sys.stdout.encoding", "latin-1"),
    ("PYTHONWARNINGS", "error", (), "sys.warnoptions", "['error']"),
    ("PYTHONOPTIMIZE", "", ("-O",), "sys.flags.optimize", "1"),
])  # fmt: skip
def test_a_child_is_begun_with_its_parents_settings(tmp_path, variable, value, flags, asks, said):
    """What -I would drop of variables and flags, but for places of code and PYTHONHASHSEED."""
    assert asked(asks, place=tmp_path, env=with_us(**{variable: value}), begun_with=flags) == said


def test_variables_that_name_code_are_not_handed_on(monkeypatch):
    """Those of OpenUSD, OpenImageIO, MaterialX and CUDA."""
    foreign = (
        *("PXR_PLUGINPATH_NAME", "PXR_AR_DEFAULT_SEARCH_PATH", "PXR_MTLX_STDLIB_SEARCH_PATHS"),
        *("PXR_SDR_FS_PLUGIN_SEARCH_PATHS", "PXR_USD_WINDOWS_DLL_PATH", "OIIO_LIBRARY_PATH", "OPENIMAGEIO_OPTIONS"),
        *("MATERIALX_SEARCH_PATH", "DRJIT_LIBOPTIX_PATH", "CUDA_INJECTION64_PATH"),
    )
    for name in foreign:
        monkeypatch.setenv(name, "/there")
    there = os.path.abspath("there")  # noqa: PTH100 - not resolved
    monkeypatch.setenv("LD_LIBRARY_PATH", os.pathsep.join(("", there, ".", "lib")))
    monkeypatch.setenv("DYLD_LIBRARY_PATH", os.pathsep)
    monkeypatch.setenv("PXR_WORK_THREAD_LIMIT", "2")
    found = isolated.environment(MARK="7")
    assert not set(foreign) & set(found) and "DYLD_LIBRARY_PATH" not in found
    assert (found["LD_LIBRARY_PATH"], found["PXR_WORK_THREAD_LIMIT"], found["MARK"]) == (there, "2", "7")
    isolated.forget_foreign()
    assert not set(foreign) & set(os.environ)


def begins(tree):
    """(line, what) of everything by which a module begins a Python or another program."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            name = f"{node.value.id}.{node.attr}"
            if name in ("sys.executable", "sys._base_executable", "os.system", "os.popen") or (
                node.value.id == "os" and node.attr.startswith(("exec", "spawn", "posix_spawn"))
            ):
                yield node.lineno, name
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            names = [alias.name for alias in node.names] + [getattr(node, "module", "") or ""]
            if any(
                name.split(".")[0] in ("multiprocessing", "pty") or name.endswith("ProcessPoolExecutor")
                for name in names
            ):
                yield node.lineno, f"import of {', '.join(filter(None, names))}"
        if isinstance(node, ast.Constant) and node.value == "-m":
            yield node.lineno, "'-m'"


def test_one_place_begins_a_python():
    """`sys.executable` and -m stand in `isolated` alone, and no module forks or spawns by itself."""
    found = {
        path.relative_to(PACKAGE).as_posix(): list(begins(ast.parse(path.read_text(encoding="utf-8"))))
        for path in PACKAGE.rglob("*.py")
        if "data" not in path.relative_to(PACKAGE).parts
    }
    assert found.pop("base/isolated.py")
    assert not {name: lines for name, lines in found.items() if lines}
