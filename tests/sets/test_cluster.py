"""Workers of a batch system, and of a scheduler that runs already."""

import re
import subprocess
import sys

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
        (
            "system: slurm\ncores: 1\nmemory: 1GB\ncoffee: 2",
            r"x.yaml:4:1: a cluster of slurm has no 'coffee'; .*walltime",
        ),
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
