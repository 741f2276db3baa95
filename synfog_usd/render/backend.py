"""Which Mitsuba variant runs here: CUDA if there is a device, else LLVM, else scalar.

The one place that imports Mitsuba for everybody and sets its variant, once.  A
variant is proved in a child process first: Mitsuba 3.9 with libLLVM 14 or 15 does
not raise, it aborts the whole process ("Cannot select: fminimum"), so nothing in
this process may be the first to try.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import importlib.metadata
import os
import re
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal, cast

from synfog_usd.base import isolated, system
from synfog_usd.base.errors import BackendError

if TYPE_CHECKING:
    import numpy.typing as npt
    from drjit.auto.ad import Float, UInt32
    from mitsuba import BSDFPtr, Color3f, EmitterPtr, Point3f, ShapePtr, Spectrum

    from synfog_usd.base.arrays import Array

VariantName = Literal["auto", "cuda", "llvm", "scalar"]
"""Or cuda:1, and so on, for one of several GPUs, as nvidia-smi counts them."""

VARIANTS: dict[str, str] = {"cuda": "cuda_ad_rgb", "llvm": "llvm_ad_rgb", "scalar": "scalar_rgb"}
MIN_LLVM = 16
LLVM_FOLDERS = (
    "/usr/lib/*-linux-gnu",
    "/usr/lib/llvm-*/lib",
    "/usr/lib64",
    "/usr/lib",
    "/usr/local/lib",
    "/opt/homebrew/opt/llvm*/lib",
    "/usr/local/opt/llvm*/lib",
)

LLVM_DISTRIBUTION = "karellen-llvm-core"
"""Package of the index that brings libLLVM for x86-64 Linux; the extra `llvm`."""

INSTALL_LLVM = (
    "install libLLVM (Debian and Ubuntu: apt install libllvm19; without root, on x86-64 Linux: pip install "
    f"{LLVM_DISTRIBUTION})"
)

SCALAR_COST = f"scalar takes about twice as long for the same noise, and 10 s for the labels of 640x360; {INSTALL_LLVM}"
"""Measured in the shipped crossing, MOR 150, two cores: `volpath` in scalar against `path` in LLVM."""

CUDA_DRIVER = "nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1"

ALIGNMENT = 64
"""Bytes that Dr.Jit's widest vectors want memory to be aligned to."""


@dataclass(frozen=True)
class Backend:
    """A variant that was proved on this machine.

    Attributes:
        name: 'cuda', 'cuda:<number>', 'llvm' or 'scalar'.
        variant: Mitsuba's name of it.
        why: what was found and what was ruled out, one line each.
        llvm_library: path of libLLVM, or '' where none is used.
        gpu: number of the GPU that was asked for, or ''.
    """

    name: str
    variant: str
    why: tuple[str, ...]
    llvm_library: str = ""
    gpu: str = ""


def find_llvm() -> tuple[list[tuple[int, Path]], list[tuple[int, Path]]]:
    """(usable, too old) libLLVM shared libraries as (major version, path), newest first."""
    libraries: dict[Path, int] = {}
    named = os.environ.get("DRJIT_LIBLLVM_PATH")
    if named:
        libraries[Path(named)] = _llvm_major(Path(named)) or MIN_LLVM
    for library in _of_package():
        libraries[library] = _llvm_major(library) or MIN_LLVM
    official = Path(os.environ.get("PROGRAMFILES", "")) / "LLVM" / "bin" / "LLVM-C.dll"  # Windows; names no version
    if sys.platform == "win32" and official.is_file():
        libraries[official] = MIN_LLVM
    for pattern in LLVM_FOLDERS:
        root, _, rest = pattern.partition("*")
        folders = (
            [Path(pattern)]
            if not rest and "*" not in pattern
            else Path(root).parent.glob(Path(pattern).relative_to(Path(root).parent).as_posix())
        )
        for folder in folders:
            for library in [*folder.glob("libLLVM*.so*"), *folder.glob("libLLVM*.dylib")]:
                major = _llvm_major(library.resolve()) or _llvm_major(library)
                if major and library.resolve() not in {path.resolve() for path in libraries}:
                    libraries[library] = major
    ranked = sorted(((major, path) for path, major in libraries.items()), key=lambda item: (-item[0], str(item[1])))
    return [item for item in ranked if item[0] >= MIN_LLVM], [item for item in ranked if item[0] < MIN_LLVM]


def _of_package() -> list[Path]:
    """Shared libraries of `LLVM_DISTRIBUTION`, where it is installed."""
    try:
        listed = importlib.metadata.files(LLVM_DISTRIBUTION) or []
    except importlib.metadata.PackageNotFoundError:
        return []
    return [
        library
        for file in listed
        if file.name.startswith("libLLVM") and (library := Path(str(file.locate())).resolve()).is_file()
    ]


def _llvm_major(path: Path) -> int | None:
    match = re.search(r"libLLVM[-.](?:so\.)?(\d+)", path.name) or re.search(r"llvm[-@](\d+)", str(path))
    return int(match.group(1)) if match else None


def has_cuda_driver() -> bool:
    """Whether an NVIDIA driver is installed; a device is proved later."""
    try:
        ctypes.CDLL(CUDA_DRIVER)
    except OSError:
        return False
    return True


def _prove(variant: str, **set_before: str) -> str:
    """'' if a child process renders with `variant`, else what went wrong in a few words.

    Args:
        variant: Mitsuba's name.
        set_before: variables that its libraries read when they begin.
    """
    try:
        child = _ask_proof(variant, isolated.environment(**set_before))
    except subprocess.TimeoutExpired:
        return "gave no picture within 120 s"
    if "proved" in child.stdout:
        return ""
    if missing := re.search(r"^missing: (.+)$", child.stdout, re.MULTILINE):
        return missing.group(1)
    if missing := re.search(r"(lib[\w.+-]+): cannot open shared object file", child.stderr):
        return f"the system library {missing.group(1)} is missing; `make setup libs` names its package"
    lines = [line.strip() for line in child.stderr.splitlines() if line.strip()]
    telling = [line for line in lines if re.search(r"LLVM ERROR|Error|not found|could not|unable", line)]
    return (telling or lines or [f"the trial process ended with code {child.returncode}"])[-1][:200]


def _ask_proof(question: str, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    words = isolated.command("synfog_usd.render.proof", question)
    return subprocess.run(words, env=environment, capture_output=True, text=True, timeout=120)


def _prove_cuda(gpu: str) -> str:
    """'' if CUDA renders, on the GPU of this number where one is named, else what went wrong."""
    problem = _prove(VARIANTS["cuda"], **_only(gpu))
    if not problem or not gpu:
        return problem
    everything = isolated.environment()
    everything.pop("CUDA_VISIBLE_DEVICES", None)
    count = int(_ask_proof("gpus", everything).stdout or 0)
    if int(gpu) < count or not count:
        return problem
    gpus = "one GPU, number 0" if count == 1 else f"{count} GPUs, 0 to {count - 1}"
    return f"there is no GPU {gpu}: this machine has {gpus} (nvidia-smi -L lists them)"


def _only(gpu: str) -> dict[str, str]:
    """Variables by which the driver shows this GPU alone, counted as nvidia-smi does; none for ''."""
    return {"CUDA_DEVICE_ORDER": "PCI_BUS_ID", "CUDA_VISIBLE_DEVICES": gpu} if gpu else {}


def begin(choice: VariantName = "auto") -> None:
    """Begin to `choose`, in a child that another processor runs; a later `choose` raises what went wrong."""

    def ask() -> None:
        with contextlib.suppress(BackendError, OSError):
            choose(choice)

    threading.Thread(target=ask, daemon=True).start()


def choose(choice: VariantName = "auto") -> Backend:
    """Find the best variant, or prove the one that is asked for.

    Raises:
        BackendError: the forced variant does not run here.
    """
    with _choosing:
        return _chosen(choice)


_choosing = threading.Lock()


@functools.lru_cache(maxsize=4)
def _chosen(choice: VariantName) -> Backend:
    name, numbered, gpu = choice.partition(":")
    if name not in ("auto", *VARIANTS) or (numbered and (name != "cuda" or not gpu.isdecimal())):
        raise BackendError(f"--variant {choice}: not known; it takes auto, cuda, llvm or scalar, and cuda:1 for GPU 1")
    why: list[str] = []
    if name in ("auto", "cuda"):
        forced = name == "cuda"
        problem = _prove_cuda(gpu) if forced or has_cuda_driver() else "no NVIDIA driver (libcuda) on this machine"
        why.append(f"cuda: {problem or (f'GPU {gpu} renders' if gpu else 'a device renders')}")
        if not problem:
            return Backend(choice if forced else "cuda", VARIANTS["cuda"], tuple(why), gpu=gpu)
        if forced:
            shown = f"--gpu {gpu}" if gpu else "--variant cuda"
            raise BackendError(f"{shown}: {problem}. Leave it out to render with what is here")
    if name in ("auto", "llvm"):
        usable, old = find_llvm()
        why += [
            f"llvm: {path} is LLVM {major}, which aborts with Mitsuba 3.9 (needs {MIN_LLVM} or newer)"
            for major, path in old[:1]
        ]
        for major, path in usable:
            problem = _prove(VARIANTS["llvm"], DRJIT_LIBLLVM_PATH=str(path))
            why.append(f"llvm: {path} (LLVM {major}) {'renders' if not problem else 'failed: ' + problem}")
            if not problem:
                return Backend("llvm", VARIANTS["llvm"], tuple(why), str(path))
        if not usable:
            why.append(f"llvm: no libLLVM {MIN_LLVM} or newer found")
    if name in ("auto", "scalar"):
        problem = _prove(VARIANTS["scalar"])
        why.append(f"scalar: {problem or SCALAR_COST}")
        if not problem:
            return Backend("scalar", VARIANTS["scalar"], tuple(why))
    raise BackendError(f"--variant {choice} does not run here: {'; '.join(why)}")


def start(choice: VariantName = "auto") -> Backend:
    """Choose a backend and set it for this process; later calls must agree with the first."""
    backend = choose(choice)
    if backend.llvm_library:
        os.environ["DRJIT_LIBLLVM_PATH"] = backend.llvm_library
    os.environ.update(_only(backend.gpu))  # before the driver is loaded
    import mitsuba as mi

    set_variant(mi, backend.variant)
    return backend


def set_variant(mi: ModuleType, variant: str) -> None:
    """Set Mitsuba's variant, and have it take plugins from its own folder alone.

    Mitsuba loads plugins/sphere.so of the current folder where there is one.
    """
    folders = mi.file_resolver()
    *_, mitsubas = folders
    folders.clear()
    folders.append(mitsubas)
    if mi.variant() != variant:
        mi.set_variant(variant)


def plugin_name(name: str) -> str:
    """A name under which a plugin of ours can be registered with Mitsuba: longer than any file's.

    Mitsuba loads plugins/<name>.so of the current folder, where there is one, before it asks what is registered.
    """
    return f"{name}_{'_' * 255}"


@functools.cache
def derived(base: type, methods: type) -> Callable[..., Any]:
    """A class of Mitsuba's with the methods of one of ours; a class of its own takes no second base."""
    namespace = {name: value for name, value in vars(methods).items() if name not in ("__dict__", "__weakref__")}
    return type(methods.__name__, (base,), namespace)


def let_go() -> None:
    """Give back the memory that Dr.Jit keeps for later arrays, and what the C library keeps."""
    if not is_scalar():
        import drjit as dr

        dr.flush_malloc_cache()
    system.give_back()


def mitsuba() -> ModuleType:
    """The `mitsuba` module with a variant set; the best one if none was chosen yet."""
    module: ModuleType = __import__("mitsuba")
    if module.variant() is None:
        start()
    return module


def aligned(array: npt.ArrayLike, kind: npt.DTypeLike | None = None) -> npt.NDArray[Any]:
    """The same numbers, contiguous, in memory that begins at a multiple of ALIGNMENT bytes.

    Dr.Jit takes NumPy's memory as it lies, and compiles a kernel for aligned and another for
    unaligned memory: which of them is wanted would change from run to run.

    Args:
        array: of any shape.
        kind: NumPy's type of the result; float32 if left out.
    """
    import numpy as np

    values = np.asarray(array, dtype=np.float32 if kind is None else kind)
    memory = np.empty(values.nbytes + ALIGNMENT, dtype=np.uint8)
    start = -memory.ctypes.data % ALIGNMENT
    copy = memory[start : start + values.nbytes].view(values.dtype).reshape(values.shape)
    copy[...] = values
    return copy


def numbers(array: npt.ArrayLike) -> UInt32:
    """(N,) whole numbers for a wavefront."""
    import numpy as np

    return mitsuba().UInt32(aligned(array, np.uint32))


def floats(array: npt.ArrayLike) -> Float:
    """(N,) numbers for a wavefront."""
    return mitsuba().Float(aligned(array))


def points(array: Array) -> Point3f:
    """(N, 3) places or directions for a wavefront."""
    return mitsuba().Point3f(*(floats(column) for column in array.T))


def channel_mean(colour: Color3f | Spectrum) -> Float:
    """Of R, G and B; `dr.mean` writes the number of lanes into the kernel's text, so that each number has its own."""
    r, g, b = colour
    return (r + g + b) / 3.0


def rows(vectors: Iterable[Float], kind: npt.DTypeLike | None = None) -> npt.NDArray[Any]:
    """(N, C) numbers of vectors, one row a lane.

    Taken part by part, since to interleave them is a kernel of its own for every N; computed together, since else each
    part would be computed from the start.

    Args:
        vectors: of C parts.
        kind: NumPy's type of the result; float64 if left out.
    """
    import drjit as dr
    import numpy as np

    dr.eval(*vectors)
    parts = np.broadcast_arrays(*(np.array(part, dtype=np.float64 if kind is None else kind) for part in vectors))
    return np.stack(parts, axis=1)


def indices_of(pointers: BSDFPtr | EmitterPtr | ShapePtr) -> UInt32:
    """(N,) numbers by which kernels know the objects that (N,) pointers point to; 0 of none."""
    import drjit as dr

    return cast("UInt32", dr.reinterpret_array(mitsuba().UInt32, pointers))


def index_of(pointer: BSDFPtr | EmitterPtr | ShapePtr) -> int:
    """The same of one object."""
    return int(indices_of(pointer)[0])


def is_scalar() -> bool:
    """Whether the variant in force works on single numbers."""
    return str(mitsuba().variant()).startswith("scalar")


def is_cuda() -> bool:
    """Whether the variant in force runs on a graphics processor."""
    return str(mitsuba().variant()).startswith("cuda")
