"""Whether a variant of Mitsuba renders here: `VARIANT`, in a process of its own, since a variant that does not may end
its process.  Prints 'proved', or 'missing:' and what.  `gpus` prints how many GPUs the NVIDIA driver shows.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys

from synfog_usd.render import backend

NO_DEVICE = 100
"""CUDA_ERROR_NO_DEVICE (cuda.h)."""


def main() -> None:
    """Say it on standard output."""
    _, question = sys.argv
    if question == "gpus":
        print(_gpus())
        return
    _lift_limits()
    if question.startswith("cuda") and (problem := _no_cuda()):
        print(f"missing: {problem}")
        return
    import mitsuba as mi
    import numpy as np

    backend.set_variant(mi, question)
    ball = {"type": "sphere", "bsdf": {"type": "principled"}}
    film = {"type": "hdrfilm", "width": 4, "height": 4}
    scene = {
        "type": "scene",
        "ball": ball,
        "sky": {"type": "constant"},
        "camera": {"type": "perspective", "film": film},
    }
    loaded = mi.load_dict({**scene, "integrator": {"type": "volpath", "max_depth": 4}})
    if np.isfinite(np.array(mi.render(loaded, spp=1))).all():
        print("proved")


def _lift_limits() -> None:
    """What bounds the reading of a stage, during which this may begin, is not for CUDA: it maps more memory than a
    machine has.
    """
    if sys.platform == "win32":
        return
    import resource

    for kind in (resource.RLIMIT_AS, resource.RLIMIT_CPU):
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(kind, (resource.getrlimit(kind)[1],) * 2)


def _no_cuda() -> str:
    """What CUDA lacks here, or ''."""
    try:
        driver = ctypes.CDLL(backend.CUDA_DRIVER)
    except OSError:
        return f"no NVIDIA driver on this machine ({backend.CUDA_DRIVER} is not found): install one"
    code = driver.cuInit(0)
    if code == NO_DEVICE:
        shown = os.environ.get("CUDA_VISIBLE_DEVICES")
        why = "nvidia-smi -L lists them" if shown is None else f"CUDA_VISIBLE_DEVICES is {shown!r}"
        return f"the NVIDIA driver shows no GPU ({why})"
    if code:
        text = ctypes.c_char_p()
        driver.cuGetErrorString(code, ctypes.byref(text))
        return f"the NVIDIA driver does not start ({(text.value or b'error').decode()}, {code}; see nvidia-smi)"
    if sys.platform == "linux":
        try:
            ctypes.CDLL("libnvoptix.so.1")
        except OSError:
            return (
                "the NVIDIA driver is here without OptiX (libnvoptix.so.1): install the whole driver; a container "
                "needs NVIDIA_DRIVER_CAPABILITIES=compute,graphics,utility"
            )
    return ""


def _gpus() -> int:
    with contextlib.suppress(OSError):
        driver = ctypes.CDLL(backend.CUDA_DRIVER)
        count = ctypes.c_int()
        if driver.cuInit(0) == 0 and driver.cuDeviceGetCount(ctypes.byref(count)) == 0:
            return count.value
    return 0


if __name__ == "__main__":
    main()
