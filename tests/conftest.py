"""Processes that test beside each other share the processors: Dr.Jit's threads would wait for each other, busily."""

import os


def pytest_configure() -> None:
    beside = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    if beside > 1:
        import drjit as dr

        dr.set_thread_count(max(1, dr.thread_count() // beside))
