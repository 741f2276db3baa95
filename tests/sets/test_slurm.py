"""A set made by jobs of a real Slurm: one controller, one node, two jobs at a time, on this machine.

`pytest -m slurm tests/sets` after `apt-get install slurmctld slurmd slurm-client munge`, as root.
"""

import json
import os
import shutil
import socket
import subprocess
import tempfile
import time
from pathlib import Path

import pytest
from support.cli import command, process
from support.stages import street

pytest.importorskip("dask_jobqueue")
NEEDED = ("munged", "slurmctld", "slurmd", "sbatch", "scancel", "squeue")
pytestmark = [
    pytest.mark.slurm,
    pytest.mark.slow,
    pytest.mark.skipif(any(shutil.which(name) is None for name in NEEDED) or os.geteuid() != 0, reason="no Slurm"),
]

CONF = """\
ClusterName=synfog
SlurmctldHost={host}(127.0.0.1)
AuthType=auth/munge
AuthInfo=socket={here}/munge.socket
SlurmUser=root
SlurmdUser=root
SlurmctldPort={port}
SlurmdPort={other}
StateSaveLocation={here}/state
SlurmdSpoolDir={here}/spool
SlurmctldPidFile={here}/slurmctld.pid
SlurmdPidFile={here}/slurmd.pid
SlurmctldLogFile={here}/slurmctld.log
SlurmdLogFile={here}/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SchedulerType=sched/builtin
MpiDefault=none
JobAcctGatherType=jobacct_gather/none
ReturnToService=2
NodeName={host} NodeAddr=127.0.0.1 CPUs=2 RealMemory=2000
PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""
SET = """\
synfog: set/1
scenes: 3
stages: ["*.usda"]
fogs: [clear, 150]
size: [24, 14]
quality: {word: reference, samples: 2, model: single}
"""


def free_port():
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


@pytest.fixture
def slurm(monkeypatch):
    """Controller and node; their files lie in a folder with a short name, as a socket asks."""
    here = Path(tempfile.mkdtemp(prefix="slurm-"))
    for name in ("state", "spool"):
        (here / name).mkdir()
    (here / "munge.key").write_bytes(os.urandom(1024))
    (here / "munge.key").chmod(0o400)
    conf = here / "slurm.conf"
    conf.write_text(CONF.format(host=socket.gethostname(), here=here, port=free_port(), other=free_port()))
    monkeypatch.setenv("SLURM_CONF", str(conf))
    files = {"socket": "socket", "key-file": "key", "pid-file": "pid", "log-file": "log", "seed-file": "seed"}
    options = [f"--{option}={here}/munge.{suffix}" for option, suffix in files.items()]
    subprocess.run(["munged", "--force", *options], check=True)
    try:
        subprocess.run(["slurmctld", "-c"], check=True)
        subprocess.run(["slurmd"], check=True)
        ends = time.monotonic() + 30
        while "idle" not in subprocess.run(["sinfo", "-h", "-o", "%T"], capture_output=True, text=True).stdout:
            assert time.monotonic() < ends, (here / "slurmctld.log").read_text()
            time.sleep(0.2)
        yield here
    finally:
        for name in ("slurmd", "slurmctld", "munge"):
            if (here / f"{name}.pid").exists():
                os.kill(int((here / f"{name}.pid").read_text()), 15)
        time.sleep(1.0)
        shutil.rmtree(here, ignore_errors=True)


def jobs():
    """Jobs that run."""
    told = subprocess.run(["squeue", "-h", "-t", "R", "-o", "%i"], capture_output=True, text=True, check=True).stdout
    return told.split()


def test_jobs_of_slurm_make_a_set_and_one_that_is_cancelled_is_begun_again(slurm, tmp_path):
    """Its unit is tried again, another job takes its place, and the bytes are those of local workers."""
    for number in range(3):
        (tmp_path / f"{number}.usda").write_text(street(lamp=True, sky=1.0 + number))
    (tmp_path / "tiny.yaml").write_text(SET)
    cluster = {"system": "slurm", "jobs": 2, "cores": 1, "memory": "900MB", "walltime": "00:30:00", "interface": "lo"}
    cluster["log_directory"] = str(slurm)
    (tmp_path / "slurm.yaml").write_text(json.dumps(cluster))
    words = ("dataset", "run", tmp_path / "tiny.yaml", "-o")
    child = subprocess.Popen(
        command(*words, tmp_path / "slurm", "--cluster", tmp_path / "slurm.yaml"), stderr=subprocess.PIPE, text=True
    )
    ends = time.monotonic() + 120
    while len(list(tmp_path.glob("slurm/scenes/000/*/*/labels.json"))) < 2:
        assert child.poll() is None and time.monotonic() < ends, child.stderr.read()
        time.sleep(0.05)
    first = set(jobs())
    subprocess.run(["scancel", min(first, key=int)], check=True)
    while not set(jobs()) - first and child.poll() is None:
        time.sleep(0.1)
    _, told = child.communicate(timeout=300)
    assert child.returncode == 0, told
    assert "its worker died; it is tried again" in told
    assert max(map(int, (path.stem.split("-")[-1] for path in slurm.glob("dask-worker-*.err")))) > max(map(int, first))
    assert process(*words, tmp_path / "local", "--workers", "2").returncode == 0
    one, other = (
        {
            path.relative_to(tmp_path / name): path.read_bytes()
            for path in sorted((tmp_path / name).rglob("*"))
            if path.is_file() and ".run" not in path.parts
        }
        for name in ("slurm", "local")
    )
    assert one == other
