"""For all tests: the same property examples every time, and compiled code given back."""

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
