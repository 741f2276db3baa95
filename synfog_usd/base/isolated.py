"""How a Python that the program starts is begun: apart from whatever lies in the current folder.

`python -m` puts the current folder before all others, and a stage may have been downloaded into it with a file named
numpy.py beside it.  So a child is isolated (`python -I`): it sees neither the current folder nor PYTHONPATH, the user's
own packages or usercustomize.  It begins in this file, which takes our package from where this file lies.  Plugins and
libraries that variables name are not loaded either.  Nothing of the package is imported here.
"""

from __future__ import annotations

import os
import re
import runpy
import site
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

FOREIGN = re.compile(
    r"PXR_\w*PATH\w*"  # OpenUSD: plugins, shaders, files that have no folder, DLLs
    r"|OIIO_LIBRARY_PATH|OPENIMAGEIO_(PLUGIN_PATH|OPTIONS|PYTHON_LOAD_DLLS_FROM_PATH)"
    r"|MATERIALX_SEARCH_PATH"
    r"|DRJIT_LIB(CUDA|OPTIX)_PATH|(NVTX|CUDA)_INJECTION(32|64)_PATH"
)
"""Variables by which libraries load other people's code, or look for files elsewhere."""

SEARCHED = ("PATH", "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH", "DYLD_FALLBACK_LIBRARY_PATH")
"""Variables of folders in which the system looks for programs and libraries; an empty one is the current folder."""

MARK = "SYNFOG_USD_WORKER"
"""Variable that tells a child of the command line its parent's number."""

PROJECT = Path(__file__).parents[1].name


def command(module: str, *words: str) -> list[str]:
    """The command line of a Python that runs one of our modules, or of a library's, as `python -m` does."""
    return [*python(), "-m", module, *words]


def python() -> list[str]:
    """What stands in the place of `python` in a command line with -m."""
    return [sys.executable, "-I", *_flags(), __file__]


def _flags() -> list[str]:
    """What -I would forget of how this Python was begun, as far as it is no place of code."""
    flags = ["-B"] * sys.dont_write_bytecode + ["-O"] * sys.flags.optimize
    flags += ["-u"] if os.environ.get("PYTHONUNBUFFERED") else []
    flags += [f"-Xutf8={sys.flags.utf8_mode}"] + ["-Xdev"] * sys.flags.dev_mode
    return flags + [f"-W{option}" for option in sys.warnoptions]


def environment(**more: str) -> dict[str, str]:
    """Variables of a child: this process's, but for those by which it would load what is not ours, and more."""
    variables = {name: value for name, value in os.environ.items() if not FOREIGN.fullmatch(name)}
    for name in SEARCHED:
        folders = [*filter(os.path.isabs, variables.pop(name, "").split(os.pathsep))]
        variables |= {name: os.pathsep.join(folders)} if folders else {}
    return {**variables, **more}


def forget_foreign() -> None:
    """In the command itself: those variables, before a library looks at them."""
    for name in [*filter(FOREIGN.fullmatch, os.environ)]:
        del os.environ[name]


def answer(arguments: Sequence[str], text: str) -> list[str]:
    """The lines that another command line prints in a child process, which reads `text`; however it ends."""
    done = subprocess.run(
        command("synfog_usd.cli.main", *arguments),
        input=text,
        env=environment(**{MARK: str(os.getpid())}),
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        encoding="utf-8",
        check=False,
    )
    return done.stdout.splitlines()


def _packages() -> list[str]:
    """Where our package lies, and the user's own packages where it is installed among them."""
    package = Path(__file__).absolute().parents[2]
    users = Path(site.getusersitepackages())
    installed = sys.prefix == sys.base_prefix and any(users.glob(f"{PROJECT}-*.dist-info"))
    return [str(package), *([str(users)] if installed else [])]


def _begin() -> None:
    """In the child: `-m MODULE WORDS` as Python takes them."""
    package, *libraries = _packages()
    sys.path.insert(0, package)  # another copy of ours may be installed
    __import__(PROJECT)
    del sys.path[0]
    sys.path += [folder for folder in (package, *libraries) if folder not in sys.path]
    if sys.platform == "win32":
        import ctypes

        ctypes.windll.kernel32.SetDllDirectoryW("")  # LoadLibrary leaves out the current folder
    if coding := os.environ.get("PYTHONIOENCODING"):
        name, _, errors = coding.partition(":")
        for stream in (sys.stdin, sys.stdout, sys.stderr):
            if stream is not None:
                stream.reconfigure(encoding=name or None, errors=errors or None)  # type: ignore[union-attr]
    _, dash_m, module, *words = sys.argv
    assert dash_m == "-m"
    sys.argv = [module, *words]
    try:
        runpy.run_module(module, run_name="__main__", alter_sys=True)
    except ImportError as error:
        if not os.environ.get("PYTHONPATH") or "No module named" not in str(error):
            raise
        where = "what synfog-usd starts does not look into PYTHONPATH; install it where synfog-usd is installed"
        print(f"synfog-usd: {error}: {where}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    _begin()
