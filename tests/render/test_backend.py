"""Where the renderer's compiler is found."""

from __future__ import annotations

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


def test_cuda_without_a_driver_says_what_is_missing():
    """One line in our words, with what to do; and at once, before a stage is read."""
    if backend.has_cuda_driver():
        pytest.skip("there is a driver here")
    done = run("info", "--variant", "cuda")
    assert done.returncode == 2 and done.stderr == (
        f"synfog-usd: --variant cuda: no NVIDIA driver on this machine ({backend.CUDA_DRIVER} is not found): install "
        "one. Leave it out to render with what is here\n"
    )


def test_the_gpu_that_is_named_is_the_only_one_that_the_renderer_sees():
    """Before its libraries are loaded, in the number of nvidia-smi; the proof is asked for that GPU too."""
    code = """if True:
        import os, sys, types
        from synfog_usd.render import backend
        asked = []
        backend._prove = lambda variant, **before: asked.append((variant, before)) or ""
        class Mitsuba(types.ModuleType):
            def file_resolver(self): return ["here", "own"]
            def variant(self): return None
            def set_variant(self, name):
                print(name, *map(os.environ.get, ("CUDA_DEVICE_ORDER", "CUDA_VISIBLE_DEVICES")))
        sys.modules["mitsuba"] = Mitsuba("mitsuba")
        print(backend.start("cuda:1").name, asked)
    """
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    first, second = done.stdout.splitlines()
    before = {"CUDA_DEVICE_ORDER": "PCI_BUS_ID", "CUDA_VISIBLE_DEVICES": "1"}
    assert first == "cuda_ad_rgb PCI_BUS_ID 1" and second == f"cuda:1 {[('cuda_ad_rgb', before)]}"
