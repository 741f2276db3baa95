"""Where the renderer's compiler is found."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys

import pytest
import typer
from support.cli import run

from synfog_usd.cli.main import app
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


def test_cuda_without_a_driver_says_what_is_missing():
    """One line in our words, with what to do; and at once, before a stage is read."""
    if backend.has_cuda_driver():
        pytest.skip("there is a driver here")
    done = run("info", "--variant", "cuda")
    assert done.returncode == 2 and done.stderr == (
        f"synfog-usd: --variant cuda: no NVIDIA driver on this machine ({backend.CUDA_DRIVER} is not found): install "
        "one. Leave it out to render with what is here\n"
    )


DRIVER = """
#include <stdlib.h>
#include <string.h>
static int seen(void) {
    const char *shown = getenv("CUDA_VISIBLE_DEVICES"), *order = getenv("CUDA_DEVICE_ORDER");
    if (!shown) return 2;
    return order && !strcmp(order, "PCI_BUS_ID") && (!strcmp(shown, "0") || !strcmp(shown, "1"));
}
int cuInit(unsigned flags) { return BROKEN ? 803 : seen() ? 0 : 100; }
int cuDeviceGetCount(int *count) { *count = seen(); return 0; }
int cuGetErrorString(int code, const char **text) { *text = "system has unsupported display driver"; return 0; }
"""
"""The driver's three functions as cuda.h has them, of a machine with two GPUs."""


@pytest.fixture
def driver(tmp_path, monkeypatch):
    """Puts a driver before all others, which starts or does not."""
    if sys.platform != "linux" or not (compiler := shutil.which("gcc") or shutil.which("cc")):
        pytest.skip("a driver is compiled here, for Linux")

    def put(broken=0):
        (tmp_path / "driver.c").write_text(DRIVER)
        words = [compiler, "-shared", "-fPIC", f"-DBROKEN={broken}", tmp_path / "driver.c"]
        subprocess.run([*words, "-o", tmp_path / "libcuda.so.1"], check=True)
        monkeypatch.setenv("LD_LIBRARY_PATH", str(tmp_path))
        monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
        backend._chosen.cache_clear()

    yield put
    backend._chosen.cache_clear()


@pytest.mark.parametrize(
    "words, told",
    [
        (("--gpu", "7"), "--gpu 7: there is no GPU 7: this machine has 2 GPUs, 0 to 1 (nvidia-smi -L lists them)"),
        (("--gpu", "1"), "--gpu 1: the NVIDIA driver is here without OptiX (libnvoptix.so.1)"),
        (("--variant", "cuda"), "--variant cuda: the NVIDIA driver is here without OptiX (libnvoptix.so.1)"),
        (("--variant", "llvm", "--gpu", "1"), "--gpu 1: --variant llvm renders on no GPU; leave one of them out"),
        (("--variant", "llvm:1"), "--variant llvm:1: not known; it takes auto, cuda, llvm or scalar, and cuda:1"),
    ],
)
def test_which_gpu_is_asked_for_and_is_not_there_is_one_line(driver, words, told):
    """A machine with two GPUs whose driver lacks OptiX, so that GPU 1 is found, and no other is missing by mistake."""
    driver()
    done = run("info", *words)
    assert done.returncode == 2 and done.stderr.startswith(f"synfog-usd: {told}") and done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    "hidden, told",
    [
        (None, "the NVIDIA driver does not start (system has unsupported display driver, 803; see nvidia-smi)"),
        ("", "the NVIDIA driver shows no GPU (CUDA_VISIBLE_DEVICES is '')"),
    ],
)
def test_a_driver_that_shows_nothing_is_one_line(driver, monkeypatch, hidden, told):
    driver(broken=int(hidden is None))
    if hidden is not None:
        monkeypatch.setenv("CUDA_VISIBLE_DEVICES", hidden)
    done = run("info", "--variant", "cuda")
    assert done.returncode == 2 and done.stderr.startswith(f"synfog-usd: --variant cuda: {told}")


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


def test_every_verb_with_a_variant_takes_a_gpu():
    def commands(group):
        for one in group.commands.values():
            yield from commands(one) if hasattr(one, "commands") else [one]

    found = [{parameter.name for parameter in one.params} for one in commands(typer.main.get_command(app))]
    assert sum("variant" in names for names in found) > 6
    assert all("gpu" in names for names in found if "variant" in names)
