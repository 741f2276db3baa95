"""Mitsuba for tests of kernels."""

import pytest

from synfog_usd.render import backend


@pytest.fixture
def mi():
    """Mitsuba in a variant of many lanes; the test is skipped where there is none."""
    module = backend.mitsuba()
    if backend.is_scalar():
        pytest.skip("needs LLVM or CUDA")
    return module
