"""Workers: of this machine, or of a scheduler that runs already, by Dask.

Dask is imported here and in `run` alone, when a set is made.
"""

from __future__ import annotations

import contextlib
import importlib
import logging
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from synfog_usd.base import system
from synfog_usd.base.errors import SetError
from synfog_usd.dataset.sets.work import ending_children

SETTINGS = {
    "distributed.scheduler.allowed-failures": 0,  # a worker that dies is a try of its unit; `run` counts them
    "distributed.scheduler.worker-ttl": "2 minutes",
    "distributed.admin.large-graph-warning-threshold": "100MB",
    # a unit takes minutes: what Dask looks at 100 and 50 times a second takes more of a core than all else that it does
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "5s",
}
PEAK_MB = 3000.0
"""Memory of a unit where none was measured: of a drawn street at 1280 x 720."""
SHARE = 0.8
"""Of the free memory that units may take."""


@dataclass(frozen=True)
class Workers:
    """Workers at hand.

    Attributes:
        client: Dask's.
        count: of units at a time.
        cores: of each worker's child, 0 where it has all.
        here: whether they are threads of this process.
    """

    client: Any
    count: int
    cores: int
    here: bool = False


def fitting(peak_mb: float | None) -> int:
    """How many units fit this machine at a time.

    Args:
        peak_mb: the most memory that a unit was seen to take.
    """
    return max(1, min(system.cores(), int(SHARE * system.free_memory() / 2**20 // (peak_mb or PEAK_MB))))


def gpus() -> tuple[str, ...]:
    """Numbers of this machine's CUDA devices, as CUDA_VISIBLE_DEVICES names them."""
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    if visible is not None:
        return tuple(name.strip() for name in visible.split(",") if name.strip())
    listed = Path("/proc/driver/nvidia/gpus")
    return tuple(str(number) for number in range(len(list(listed.iterdir())))) if listed.is_dir() else ()


@contextlib.contextmanager
def local(count: int) -> Iterator[Workers]:
    """Workers of this machine, each with its share of the cores.

    They are threads: all that one does is wait for its child, and a process would take half a second of processor time
    to begin and 100 MB.
    """
    dask, distributed = _dask()
    with dask.config.set(SETTINGS):
        cluster = distributed.LocalCluster(
            n_workers=count,
            threads_per_worker=1,
            memory_limit=0,
            processes=False,
            dashboard_address=":0",  # another run may have the usual port
            silence_logs=logging.CRITICAL,
            local_directory=None,
        )
    with ending_children(cluster), distributed.Client(cluster) as client:
        yield Workers(client, count, max(1, system.cores() // count), here=True)


@contextlib.contextmanager
def joined(address: str) -> Iterator[Workers]:
    """The workers of a scheduler that runs already.

    Raises:
        SetError: nobody answers, or it has no worker.
    """
    dask, distributed = _dask()
    for name in ("asyncio", "tornado", *logging.root.manager.loggerDict):
        if name.split(".")[0] in (
            "asyncio",
            "tornado",
            "distributed",
        ):  # our own line reports a lost scheduler
            logging.getLogger(name).setLevel(logging.CRITICAL)
    with dask.config.set(SETTINGS):
        try:
            client = distributed.Client(address, timeout=10)
        except (OSError, ValueError, TypeError) as error:
            raise SetError(f"--scheduler {address}: no Dask scheduler answers ({error})") from error
        with client:
            threads = sum(client.nthreads().values())
            if not threads:
                raise SetError(
                    f"--scheduler {address}: it has no workers; start some with dask worker {address} --nthreads 1"
                )
            yield Workers(client, threads, 0)


def need_libraries() -> None:
    """Refuse to begin where a library of the extra `sets` is missing.

    Raises:
        SetError: with what to install.
    """
    try:
        for name in ("distributed", "pyarrow"):
            importlib.import_module(name)
    except ImportError as error:
        raise SetError("data sets need Dask and Arrow: pip install distributed pyarrow") from error


def _dask() -> tuple[ModuleType, ModuleType]:
    import dask
    import distributed

    return dask, distributed
