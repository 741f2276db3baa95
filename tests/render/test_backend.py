"""Where the renderer's compiler is found."""

from __future__ import annotations

import json
import random
import subprocess
import sys

import pytest
from support.cli import run

from synfog_usd.render import backend


@pytest.fixture
def no_llvm(monkeypatch, tmp_path):
    """A machine without libLLVM; gives the folder of an environment's packages."""
    monkeypatch.setattr(backend, "LLVM_FOLDERS", ())
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    packages = tmp_path / "lib" / "python3" / "site-packages"
    packages.mkdir(parents=True)
    monkeypatch.setattr(sys, "path", [str(packages)])
    return packages


def install(packages, name="libLLVM.so.23.1"):
    """As pip leaves the package: the library in the environment's lib, its record beside the other packages."""
    library = packages.parent.parent / name
    library.write_bytes(b"")
    record = packages / "karellen_llvm_core-23.1.4.dist-info"
    record.mkdir()
    (record / "METADATA").write_text("Metadata-Version: 2.1\nName: karellen-llvm-core\nVersion: 23.1.4\n")
    (record / "RECORD").write_text(f"../../{name},,\n../../libLLVM-gone.so,,\n../../libRemarks.so,,\n")
    return library


def test_the_compiler_of_the_package_index_is_found(no_llvm):
    """Without one on the system: that of the package, by its record; files that are not there, or other libraries, do
    not count.
    """
    assert backend.find_llvm() == ([], [])
    library = install(no_llvm)
    assert backend.find_llvm() == ([(23, library.resolve())], [])


def test_the_newest_compiler_is_tried_first(no_llvm, monkeypatch, tmp_path):
    """The system's and the package's compete by their version."""
    system = tmp_path / "usr"
    system.mkdir()
    for number in (15, 19):
        (system / f"libLLVM-{number}.so").write_bytes(b"")
    monkeypatch.setattr(backend, "LLVM_FOLDERS", (str(system),))
    library = install(no_llvm)
    usable, old = backend.find_llvm()
    assert usable == [(23, library.resolve()), (19, system / "libLLVM-19.so")] and [number for number, _ in old] == [15]


@pytest.mark.slow
def test_the_package_renders_where_the_system_has_no_compiler():
    """A process of its own that looks for libLLVM nowhere else; skipped where the extra is not installed."""
    if not backend._of_package():
        pytest.skip("the extra llvm is not installed")
    code = (
        "from synfog_usd.render import backend as b; b.LLVM_FOLDERS = (); found = b.choose('llvm'); print(found.name, "
        "found.llvm_library)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    assert done.stdout.split() == ["llvm", str(backend._of_package()[0])], done.stderr


def test_info_tells_what_is_not_installed(monkeypatch):
    """A library without a record, as one that was unpacked by hand: its name, and the others' versions."""
    import importlib.metadata

    version = importlib.metadata.version

    def without_scipy(name):
        if name == "scipy":
            raise importlib.metadata.PackageNotFoundError(name)
        return version(name)

    monkeypatch.setattr(importlib.metadata, "version", without_scipy)
    versions = json.loads(run("info", "--json").stdout)["versions"]
    assert versions.pop("scipy") == "not installed" and versions["numpy"] == version("numpy")


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux bounds a process's memory so")
def test_a_variant_is_proved_without_the_limits_under_which_a_stage_is_read():
    """400 MB, which the renderer's libraries alone exceed: CUDA maps more than a machine has, and was taken for
    missing where its proof began while a stage was read.
    """
    code = (
        "import resource as r; from synfog_usd.render import backend as b; "
        "r.setrlimit(r.RLIMIT_AS, (400 << 20, r.getrlimit(r.RLIMIT_AS)[1])); print([b._prove('scalar_rgb')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.stdout.strip() == "['']", done.stdout + done.stderr


def test_seconds_of_compiling_are_told_once():
    """A kernel that this process never had: more than nothing, then nothing; the same again takes what is compiled."""
    mi = backend.mitsuba()
    if backend.is_scalar():
        pytest.skip("no kernels here")
    import drjit as dr

    number = random.random()  # within the kernel's text, so that no cache on disk has it

    def launch() -> None:
        dr.eval(dr.arange(mi.Float, 100) * number)

    before = dr.flag(dr.JitFlag.KernelHistory)
    with backend.compiling_timed() as seconds:
        launch()
        assert 0.0 < seconds() < 60.0
        assert seconds() == 0.0
        launch()
        assert seconds() == 0.0
    assert dr.flag(dr.JitFlag.KernelHistory) == before and not dr.kernel_history()
