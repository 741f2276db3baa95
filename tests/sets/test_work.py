"""What a worker does with its child."""

import os
import sys
from pathlib import Path

import pytest

from synfog_usd.base import isolated, system
from synfog_usd.dataset.sets import cluster, work
from synfog_usd.dataset.sets.layout import Unit
from synfog_usd.dataset.sets.work import Child, Job, do

TELL = "import json, os; print(json.dumps({}))"


@pytest.fixture(autouse=True)
def programs(monkeypatch):
    """Children run what a test writes in the place of a module's name."""
    monkeypatch.setattr(isolated, "command", lambda program, *words: [sys.executable, "-c", program, *words])


def child(expression):
    return Child((TELL.format(expression),), "MARK_OF_TEST")


def job(**more):
    return Job(Path("out"), Unit(3, "sky", "/World/Rig/Left"), 60.0, "llvm", **more)


def test_a_child_is_told_its_unit_and_its_parent(monkeypatch):
    """Folder, scene, lighting, camera; the parent's number under the mark; nothing of what it is not to see."""
    monkeypatch.setenv("PXR_PLUGINPATH_NAME", "there")
    seen = "{'ok': True, 'words': __import__('sys').argv[1:], 'env': dict(os.environ)}"
    result = do(job(repair=True), child(seen))
    words = "out 3 sky --variant llvm --camera /World/Rig/Left --repair"
    assert result["ok"] and result["words"] == words.split()
    assert result["env"]["MARK_OF_TEST"] == str(os.getpid()) and "PXR_PLUGINPATH_NAME" not in result["env"]
    assert result["seconds"] > 0.0 and result["own_cpu_s"] >= 0.0


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="no such call")
def test_workers_share_out_cores_and_gpus(monkeypatch, place=1):
    """Each child has one core and one GPU, the next worker's the next; beyond the last they begin again."""
    monkeypatch.setattr(work, "_place", lambda: place)
    seen = "{'cores': sorted(os.sched_getaffinity(0)), 'gpu': os.environ['CUDA_VISIBLE_DEVICES']}"
    waits = f"(__import__('time').sleep(0.3), {seen})[1]"
    result = do(job(cores=1, gpus=("4", "6")), child(waits))
    mine = sorted(os.sched_getaffinity(0))
    assert result["cores"] == [mine[place % len(mine)]]
    assert result["gpu"] == ("4", "6")[place % 2]


@pytest.mark.parametrize(
    "words, kind, told",
    [
        ("import os; os.kill(os.getpid(), 9)", "killed", "died of signal 9: it was killed"),
        ("raise SystemExit(3)", "crash", "exit code 3"),
        ("import os; os.kill(os.getpid(), 19)", "limit", "longer than its limit of 1 s"),  # stopped: it hangs
        ("import sys; sys.stderr.write('x' * 10**6); raise SystemExit(1)", "crash", "xxx"),
    ],
)
def test_how_a_child_ends_is_told(words, kind, told):
    """Its signal, its last words, its exit code, or that it took too long; never more than a few lines."""
    limited = Job(Path("out"), Unit(3, "sky"), 1.0 if kind == "limit" else 60.0, "llvm")
    result = do(limited, Child((words,), "MARK_OF_TEST"))
    assert not result["ok"] and result["kind"] == kind and told in result["error"]
    assert len(result["error"]) <= work.TOLD


def test_gpus_are_those_that_are_visible(monkeypatch):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "2, 5")
    assert cluster.gpus() == ("2", "5")
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")
    assert cluster.gpus() == ()


def test_workers_are_what_memory_and_cores_allow(monkeypatch):
    monkeypatch.setattr(cluster.system, "cores", lambda: 8)
    monkeypatch.setattr(system, "free_memory", lambda: 10_000 * 2**20)
    assert cluster.fitting(2_000.0) == 4 and cluster.fitting(500.0) == 8 and cluster.fitting(50_000.0) == 1
    assert cluster.fitting(None) == int(0.8 * 10_000 // cluster.PEAK_MB)
