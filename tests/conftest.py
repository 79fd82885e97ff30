"""For all tests: the same property examples every time, and compiled code kept and given back."""

import os
from pathlib import Path

# Modules give their code back (below) and often compile what another one has compiled: from the
# disk it comes in a tenth of the time. Processes that tests start read these variables too.
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(Path(__file__).parents[1] / ".cache"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.3")

import jax
import pytest
from hypothesis import settings

# The same examples every time: a test that fails today failed yesterday.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")


@pytest.fixture(scope="module", autouse=True)
def compiled_code_is_given_back():
    """XLA's code lies in many small memory maps, of which a process may have 65,530."""
    yield
    jax.clear_caches()
