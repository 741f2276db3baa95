"""Workers: of this machine, of a scheduler that runs already, or of a batch system, all by Dask.

Dask is imported here and in `run` alone, when a set is made.
"""

from __future__ import annotations

import contextlib
import inspect
import logging
import os
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from synfog_usd.base import isolated, system
from synfog_usd.base.errors import SetError, did_you_mean
from synfog_usd.base.yamlio import load_file
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
SYSTEMS = {
    "slurm": "SLURMCluster",
    "pbs": "PBSCluster",
    "lsf": "LSFCluster",
    "sge": "SGECluster",
    "moab": "MoabCluster",
    "oar": "OARCluster",
    "htcondor": "HTCondorCluster",
}
JOBS = 10
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
        dashboard: its address, or ''.
        here: whether they are threads of this process.
    """

    client: Any
    count: int
    cores: int
    dashboard: str
    here: bool = False


def fitting(peak_mb: float | None) -> int:
    """How many units fit this machine at a time.

    Args:
        peak_mb: the most memory that a unit was seen to take.
    """
    return max(1, min(cores(), int(SHARE * system.free_memory() / 2**20 // (peak_mb or PEAK_MB))))


def gpus() -> tuple[str, ...]:
    """Numbers of this machine's CUDA devices, as CUDA_VISIBLE_DEVICES names them."""
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    if visible is not None:
        return tuple(name.strip() for name in visible.split(",") if name.strip())
    listed = Path("/proc/driver/nvidia/gpus")
    return tuple(str(number) for number in range(len(list(listed.iterdir())))) if listed.is_dir() else ()


def cores() -> int:
    """How many this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


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
        yield Workers(client, count, max(1, cores() // count), _dashboard(client), here=True)


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
            yield Workers(client, threads, 0, _dashboard(client))


@contextlib.contextmanager
def batch(path: Path) -> Iterator[Workers]:
    """Workers that a batch system starts as jobs.

    Raises:
        SetError: the file is not right, with its place.
    """
    _, distributed = _dask()
    with batch_cluster(path) as (cluster, count):
        cluster.adapt(minimum=count, maximum=count, interval="5s")  # a job that ends is begun again
        with distributed.Client(cluster) as client:
            yield Workers(client, count, 0, _dashboard(client))


@contextlib.contextmanager
def batch_cluster(path: Path) -> Iterator[tuple[Any, int]]:
    """The cluster of a file, with how many workers it is to have, one unit at a time each; none is started yet.

    Raises:
        SetError: the file is not right, with its place.
    """
    dask, _ = _dask()
    try:
        import dask_jobqueue
    except ImportError as error:
        raise SetError("--cluster needs dask-jobqueue: pip install dask-jobqueue") from error
    root = load_file(path, error=SetError)
    items = root.value
    if not isinstance(items, dict) or "system" not in items:
        raise SetError(f"{root.place}: a cluster has a 'system': one of {', '.join(SYSTEMS)}")
    settings: Mapping[str, Any] = root.plain()
    if settings["system"] not in SYSTEMS:
        raise SetError(
            f"{items['system'].place}: system is {settings['system']!r}; it takes one of "
            f"{', '.join(SYSTEMS)}.{did_you_mean(str(settings['system']), SYSTEMS)}"
        )
    jobs = settings.get("jobs", JOBS)
    if not isinstance(jobs, int) or isinstance(jobs, bool) or not 1 <= jobs <= 100_000:
        raise SetError(f"{items['jobs'].place}: jobs is {jobs!r}; it takes a whole number from 1 to 100000")
    options = {"processes": 1, **{key: value for key, value in settings.items() if key not in ("system", "jobs")}}
    options["worker_extra_args"] = [*options.get("worker_extra_args", []), "--nthreads", "1"]  # of units, not of a unit
    python = shlex.join(isolated.python())  # a job begins by python -m, in whatever folder it was asked for
    named = options.get("python") or dask.config.get(f"jobqueue.{settings['system']}.python", None)
    options["python"] = f"{named} -I" if named else python
    kind = getattr(dask_jobqueue, SYSTEMS[settings["system"]])
    allowed = _options(kind)
    for key in options:
        if key not in allowed:
            raise SetError(
                f"{items[key].key_place}: a cluster of {settings['system']} has no {key!r}; it takes "
                f"{', '.join(allowed)}.{did_you_mean(key, allowed)}"
            )
    with dask.config.set(SETTINGS):
        try:
            cluster = kind(**options)
        except (TypeError, ValueError) as error:
            raise SetError(
                f"{path}: {SYSTEMS[settings['system']]} of dask-jobqueue does not take that: {error}"
            ) from error
        with cluster:
            yield cluster, jobs * options["processes"]


def _options(kind: Any) -> list[str]:
    """Options of a cluster of dask-jobqueue and its jobs, `processes` and `worker_extra_args` among it."""
    makers = [kind.__init__, *(maker.__init__ for maker in (*kind.__mro__, *kind.job_cls.__mro__))]
    names = {
        name
        for maker in makers
        for name, parameter in inspect.signature(maker).parameters.items()
        if parameter.kind in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY)
    }
    return sorted(
        names - {"self", "n_workers", "job_cls", "loop", "asynchronous", "scheduler", "name", "workers", "worker"}
    )


def _dask() -> tuple[Any, Any]:
    try:
        import dask
        import distributed
    except ImportError as error:
        raise SetError("data sets are made by Dask: pip install distributed pyarrow") from error
    return dask, distributed


def _has_dashboard() -> bool:
    from importlib.util import find_spec

    return find_spec("bokeh") is not None


def _dashboard(client: Any) -> str:
    return str(client.dashboard_link) if _has_dashboard() else ""
