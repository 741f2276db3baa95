"""What differs between systems: the package without what Windows has not, and paths as it writes them.

A child hides `fcntl`, `resource`, `termios` and the signals and functions of `os` that Windows lacks.  Its `msvcrt` is
one of our own that locks as the documentation of `msvcrt.locking` says, so that this way is walked; Windows itself is
not asked here.
"""

import ntpath
import subprocess
import sys
import textwrap
from pathlib import Path, PureWindowsPath

import pytest
from support.stages import street

from synfog_usd.base import fence, system
from synfog_usd.base.errors import OutputError, ParameterError
from synfog_usd.dataset.plan import BakePlan, shots

HIDDEN = """
    import errno, fcntl, os, signal, subprocess, sys, threading, types
    import tempfile, shutil, multiprocessing, concurrent.futures, ctypes, platform  # these ask the same

    held = fcntl
    msvcrt = types.ModuleType("msvcrt")
    msvcrt.LK_NBLCK = 2

    def locking(handle, mode, count):
        assert mode == 2 and count == 1
        held.lockf(handle, held.LOCK_EX | held.LOCK_NB, count)

    msvcrt.locking = locking
    sys.modules["msvcrt"] = msvcrt
    for name in ("fcntl", "resource", "termios", "tty", "pty", "grp", "pwd"):
        sys.modules[name] = None
    for name in ("SIGALRM", "SIGKILL", "SIGXCPU", "SIGBUS", "alarm", "setitimer"):
        delattr(signal, name)
    for name in ("O_DIRECTORY", "sysconf", "getuid", "fork", "getpgid", "killpg", "setsid"):
        delattr(os, name)
"""


def child(code, *arguments):
    """A program in such a Python, to its end."""
    text = textwrap.dedent(HIDDEN) + textwrap.dedent(code)
    return subprocess.run(
        [sys.executable, "-c", text, *map(str, arguments)], capture_output=True, text=True, timeout=120
    )


def test_every_module_is_imported_without_what_windows_has_not():
    """All modules of the package; none asks for fcntl and the like before it is called."""
    done = child(
        """
        import importlib, pkgutil, synfog_usd
        names = [one.name for one in pkgutil.walk_packages(synfog_usd.__path__, "synfog_usd.")]
        for name in names:
            importlib.import_module(name)
        print(len(names))
        """
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 150


def test_a_stage_is_checked_and_a_folder_held_without_them(tmp_path):
    """Opening, limits, translation, findings and the output folder's lock."""
    path, out = tmp_path / "street.usda", tmp_path / "out"
    path.write_text(street(lamp=True), encoding="utf-8")
    done = child(
        """
        from pathlib import Path
        from synfog_usd.base import system
        from synfog_usd.cli import worker
        from synfog_usd.dataset import check
        from synfog_usd.base.errors import OutputError

        stage, out = map(Path, sys.argv[1:])
        with worker.reading_limits():
            found, notes, light = check.look(stage)
        assert light and not [one for one in found if one.severity == "error"]
        with system.only_writer(out):
            # a lock of lockf is a process's: another one must be refused
            code = "import fcntl, sys; fcntl.lockf(open(sys.argv[1], 'r+b'), fcntl.LOCK_EX | fcntl.LOCK_NB, 1)"
            other = subprocess.run([sys.executable, "-c", code, out / system.LOCK], capture_output=True, text=True)
            assert other.returncode == 1 and "BlockingIOError" in other.stderr
        assert list(out.iterdir()) == []
        print("done")
        """,
        path,
        out,
    )
    assert done.stdout == "done\n", done.stderr


@pytest.mark.slow
def test_a_bake_goes_through_without_them(tmp_path):
    """One shot to its last file, by the function that the command line calls."""
    path, out = tmp_path / "street.usda", tmp_path / "out"
    path.write_text(street(lamp=True), encoding="utf-8")
    done = child(
        """
        from pathlib import Path
        from synfog_usd.cli import worker
        from synfog_usd.dataset import bake, plan

        choice = dict(size=(32, 18), sampling=plan.Sampling(samples=2), fog=("mor150",), lighting=("sky",))
        bake.bake(plan.BakePlan(Path(sys.argv[1]), Path(sys.argv[2]), **choice), reading=worker.reading_limits)
        """,
        path,
        out,
    )
    assert done.returncode == 0, done.stderr
    assert (out / "sky" / "mor150" / "srgb.png").is_file() and not (out / system.LOCK).exists()


@pytest.mark.parametrize("what, code", [("cpu_s", system.OVER_CPU), ("wall_s", system.OVER_WALL)])
def test_without_signals_a_thread_ends_what_takes_too_long(what, code):
    """A loop that ends never is ended by its limit of processor or of wall time, and by no other."""
    done = child(
        f"""
        from synfog_usd.base import system
        with system.limits(**{{"cpu_s": 60.0, "wall_s": 60.0, "{what}": 0.2}}):
            while True:
                pass
        """
    )
    assert done.returncode == code & 0xFF  # of which Linux keeps eight bits, and Windows all


def test_limits_leave_nothing_behind():
    """A second after the limits are left, the process still lives, with and without signals."""
    code = (
        "import time; from synfog_usd.base import system\n"
        "with system.limits(cpu_s=600, wall_s=1): pass\ntime.sleep(1.2)"
    )
    here = subprocess.Popen([sys.executable, "-c", code])
    assert child(code.replace("wall_s=1", "wall_s=0.3")).returncode == 0
    assert here.wait() == 0


def test_codes_of_windows_are_told_as_causes():
    """An access violation as `subprocess` gives it there is a death with a cause; 2 and 130 are exit codes."""
    assert [system.died(code) for code in (0, 2, 130, -11)] == [0, 2, 130, -11]
    assert system.died(0xC0000005) < 0
    assert system.cause(system.died(0xC0000005)) == ("status 0xC0000005", system.cause(-11)[1])
    assert "than it may: 600 s to read" in system.cause(system.OVER_CPU)[1] == system.cause(-24)[1]
    assert "more than 3600 s" in system.cause(-14)[1]
    assert system.died(system.OVER_WALL & 0xFFFFFFFF) == system.OVER_WALL


def test_a_folder_is_held_once(tmp_path):
    """Here and in another process; free again afterwards."""
    code = (
        "import sys, pathlib; from synfog_usd.base import system\n"
        "system.only_writer(pathlib.Path(sys.argv[1])).__enter__()"
    )
    with system.only_writer(tmp_path):
        with pytest.raises(OutputError, match="another bake"), system.only_writer(tmp_path):
            pass
        other = subprocess.run([sys.executable, "-c", code, tmp_path], capture_output=True, text=True)
        assert "another bake" in other.stderr
    with system.only_writer(tmp_path):
        assert list(tmp_path.iterdir()) == []


def test_a_file_on_another_drive_is_refused_in_one_line(monkeypatch):
    """By the functions that `os.path` has on Windows: no folder is common to C: and D:."""
    monkeypatch.setattr(fence.os.path, "commonpath", ntpath.commonpath)
    inside = fence.Fence((PureWindowsPath("C:/stages/town"),))
    assert inside._shared(PureWindowsPath("D:/textures/wall.png")) == PureWindowsPath("D:/textures")
    assert fence._inside(PureWindowsPath("c:/STAGES/Town/wall.png"), PureWindowsPath("C:/stages/town"))
    assert not fence._inside(PureWindowsPath("C:/stages/townhall/wall.png"), PureWindowsPath("C:/stages/town"))


def test_a_folder_by_another_name_is_the_same_folder(tmp_path):
    """Where case does not count, two spellings are one folder; here a link stands for the other spelling."""
    (tmp_path / "Town").mkdir()
    (tmp_path / "town").symlink_to(tmp_path / "Town")
    (tmp_path / "Town" / "wall.png").touch()
    assert fence._inside(tmp_path / "town" / "wall.png", tmp_path / "Town")
    assert not fence._inside(tmp_path / "elsewhere" / "town" / "wall.png", tmp_path / "Town")


def test_variants_that_differ_by_case_alone_are_refused():
    """They would lie in one folder; one of them alone is baked."""
    plan = BakePlan(Path("street.usda"), Path("out"))
    with pytest.raises(ParameterError, match=r"authored/Dense and authored/dense differ by case"):
        shots(plan, {"fog": ["Dense", "dense"]})
    assert len(shots(BakePlan(Path("a.usda"), Path("out"), fog=("dense",)), {"fog": ["Dense", "dense"]})) == 1


def test_files_that_a_container_keeps_do_not_count_as_used(tmp_path):
    """A limit of 8 GB, 7 GB in use, 5 of them pages of files: 6 are free.  Without a limit there is no number."""
    for name, text in (
        ("memory.max", "8000000000\n"),
        ("memory.current", "7000000000\n"),
        ("memory.stat", "anon 2000000000\nfile 5500000000\nshmem 500000000\nactive_file 1000000000\n"),
    ):
        (tmp_path / name).write_text(text, encoding="ascii")
    with (tmp_path / "memory.stat").open("a", encoding="ascii") as file:
        file.write("inactive_file 4000000000\n")
    assert system._free_in_container(tmp_path) == 6_000_000_000
    (tmp_path / "memory.max").write_text("max\n", encoding="ascii")
    with pytest.raises(ValueError, match="max"):
        system._free_in_container(tmp_path)
