"""Workers of a batch system, and of a scheduler that runs already."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from support.cli import process
from support.stages import street

from synfog_usd.base.errors import SetError
from synfog_usd.dataset.sets import cluster

pytest.importorskip("dask_jobqueue")

SLURM = """\
system: slurm
jobs: 20
cores: 4
memory: 8GB
walltime: "12:00:00"
queue: long
interface: lo
job_script_prologue: ["source /opt/synfog/bin/activate"]
job_extra_directives: ["--exclusive=user"]
"""
SCRIPT = """
import sys
from pathlib import Path
from synfog_usd.dataset.sets.cluster import batch_cluster
with batch_cluster(Path(sys.argv[1])) as (found, jobs):
    print(jobs)
    print(found.job_script())
"""


def test_a_job_of_slurm_is_a_worker_of_one_unit_at_a_time(tmp_path):
    """The script that sbatch would get: the file's own words, one worker, and the settings that count tries."""
    (tmp_path / "slurm.yaml").write_text(SLURM)
    words = [sys.executable, "-c", SCRIPT, str(tmp_path / "slurm.yaml")]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    jobs, _, script = done.stdout.partition("\n")
    assert jobs == "20"
    for line in ("#SBATCH -p long", "#SBATCH --cpus-per-task=4", "#SBATCH -t 12:00:00", "#SBATCH --exclusive=user"):
        assert line in script.splitlines()
    assert "source /opt/synfog/bin/activate" in script.splitlines()
    assert re.search(r"dask_worker tcp://127\.0\.0\.1:\d+ .*--nthreads (\d+)", script)[1] == "1"  # the last one counts


@pytest.mark.parametrize(
    "text, told",
    [
        ("jobs: 3", r"x.yaml:1:1: a cluster has a 'system': one of slurm, pbs, lsf"),
        ("system: slum", r"x.yaml:1:9: system is 'slum'.* Did you mean 'slurm'\?"),
        ("system: slurm\njobs: many", r"x.yaml:2:7: jobs is 'many'; it takes a whole number"),
        (
            "system: slurm\ncores: 1\nmemory: 1GB\ncoffee: 2",
            r"x.yaml:4:1: a cluster of slurm has no 'coffee'; .*walltime",
        ),
        ("[1, 2", r"x.yaml:1:\d+: not valid YAML"),
    ],
)
def test_a_mistake_in_the_file_is_told_with_its_place(tmp_path, text, told):
    (tmp_path / "x.yaml").write_text(text)
    with pytest.raises(SetError, match=told), cluster.batch_cluster(tmp_path / "x.yaml"):
        pass


@pytest.mark.slow
def test_a_scheduler_that_does_not_answer_is_one_line(tmp_path):
    (tmp_path / "one.usda").write_text(street())
    (tmp_path / "tiny.yaml").write_text("synfog: set/1\nscenes: 1\nstages: ['*.usda']\n")
    done = process("dataset", "run", tmp_path / "tiny.yaml", "-o", tmp_path / "out", "--scheduler", "tcp://127.0.0.1:9")
    assert done.returncode == 2 and done.stderr.startswith(
        "synfog-usd: --scheduler tcp://127.0.0.1:9: no Dask scheduler"
    )
    assert done.stderr.count("\n") == 1


@pytest.mark.slow
def test_a_running_scheduler_is_joined_and_its_end_is_told(tmp_path):
    """Its worker makes the set; where it is killed, the run says how to go on, and local workers do."""
    import time

    words = "synfog: set/1\nscenes: 2\nstages: ['*.usda']\nlightings: [sky]\nfogs: [150]\nsize: [24, 14]\n"
    for number in range(2):
        (tmp_path / f"{number}.usda").write_text(street())
    (tmp_path / "tiny.yaml").write_text(words + "quality: {word: reference, samples: 2, model: single}\n")
    place = tmp_path / "scheduler.json"
    dask = [sys.executable, "-m", "dask"]
    options = ["--scheduler-file", str(place)]
    scheduler = subprocess.Popen(
        [*dask, "scheduler", *options, "--port", "0", "--no-dashboard"], stderr=subprocess.DEVNULL
    )
    worker = subprocess.Popen(
        [*dask, "worker", *options, "--nthreads", "1", "--no-dashboard"], stderr=subprocess.DEVNULL
    )
    try:
        while not place.exists():
            time.sleep(0.1)
        address = json.loads(place.read_text())["address"]
        set_words = ["dataset", "run", tmp_path / "tiny.yaml", "-o"]
        deadline = time.monotonic() + 60
        while True:
            done = process(*set_words, tmp_path / "joined", "--scheduler", address)
            if "it has no workers" not in done.stderr or time.monotonic() > deadline:
                break
        assert done.returncode == 0, done.stderr
        from support.cli import command

        child = subprocess.Popen(
            command(*set_words, tmp_path / "killed", "--scheduler", address), stderr=subprocess.PIPE, text=True
        )
        while not (tmp_path / "killed/.run/locks").exists():
            assert child.poll() is None, child.stderr.read()
            time.sleep(0.05)
        scheduler.kill()
        _, told = child.communicate(timeout=120)
        assert child.returncode == 2 and "the scheduler went away" in told and "goes on from there" in told
        assert "Traceback" not in told
    finally:
        for one in (scheduler, worker):
            one.kill()
            one.wait()
    assert process(*set_words, tmp_path / "killed", "--workers", "1").returncode == 0
    one, other = (
        {
            path.relative_to(folder): path.read_bytes()
            for path in folder.rglob("*")
            if path.is_file() and ".run" not in path.parts
        }
        for folder in (Path(tmp_path / "joined"), Path(tmp_path / "killed"))
    )
    assert one == other
