"""The coverage-guided search, for some seconds: that it runs, that it finds what is put in its way, and that it finds
nothing else.

Needs atheris, which is no dependency (its wheels are for some Pythons and Linux only): `pip install atheris`, then
SYNFOG_FUZZ_SECONDS=900 for a long search.
"""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("atheris_fuzz.py")
SECONDS = os.environ.get("SYNFOG_FUZZ_SECONDS", "20")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        importlib.util.find_spec("atheris") is None, reason="atheris is not installed; pip install atheris"
    ),
]


def test_no_damage_ends_in_a_trace(tmp_path):
    """Hundreds of cases in 20 s; what takes the USD library down is a line to the user."""
    words = [sys.executable, str(SCRIPT), "--seconds", SECONDS, "--out", str(tmp_path)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=float(SECONDS) + 300)
    counted = re.match(r"(\d+) cases, (\d+) deaths", done.stdout)
    assert counted and int(counted[1]) > 20, done.stdout + done.stderr
    assert done.returncode == 0, done.stdout + "".join(found.read_text() for found in tmp_path.glob("finding*.txt"))


def test_a_fault_in_the_code_is_found(tmp_path):
    """With a trace put into the reading of any light, the search ends with a finding."""
    (tmp_path / "sitecustomize.py").write_text(
        "import sys\n"
        "if '--drive' in sys.argv or any('--drive' in word for word in sys.orig_argv):\n"
        "    from synfog_usd.stage import labels\n"
        "    labels.official_name = lambda label: 1 // 0\n"
    )
    words = [sys.executable, str(SCRIPT), "--seconds", "15", "--out", str(tmp_path / "out")]
    done = subprocess.run(
        words, capture_output=True, text=True, timeout=300, env={**os.environ, "PYTHONPATH": str(tmp_path)}
    )
    assert done.returncode == 1 and "ZeroDivisionError" in (tmp_path / "out" / "finding0.txt").read_text(), (
        done.stdout + done.stderr
    )
