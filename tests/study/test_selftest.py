"""The self-test as a user runs it."""

import subprocess
import sys


def test_every_known_answer_is_met_on_this_machine():
    """`synfog-usd selftest` ends with 0, and every case could have seen a bias of 5 %."""
    done = subprocess.run([sys.executable, "-m", "synfog_usd.cli.main", "selftest"], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    backend, *cases = done.stdout.splitlines()
    assert backend.startswith("backend: ")
    assert len(cases) == 6
    for case in cases:
        assert case.startswith("ok "), case
        assert float(case.split("resolves")[1].split("%")[0]) < 5.0, case
