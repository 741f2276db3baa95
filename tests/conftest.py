"""Processes that test beside each other share the processors: Dr.Jit's threads would wait for each other, busily."""

import gc
import os

import pytest


def pytest_configure() -> None:
    beside = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    if beside > 1:
        import drjit as dr

        dr.set_thread_count(max(1, dr.thread_count() // beside))


def pytest_unconfigure() -> None:
    gc.unfreeze()


@pytest.fixture(autouse=True, scope="module")
def _what_stays_is_not_searched() -> None:
    """Loading a scene looks for unused objects twice, which takes 0.2 s each in a process that knows all tests."""
    gc.collect()
    gc.freeze()
