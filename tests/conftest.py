"""For all tests: quick compiling, caches of their own, the same examples every time, solved cases."""

import gc
import os
import time
from importlib.metadata import version
from pathlib import Path

# Most of the time of a test run is XLA's compiling, which takes three fifths of the processor time
# without the emitters of fusions. (Level 0 would take a third, but rounds a number that is computed
# twice in two ways: the derivative of a maximum, which compares the two, is then wrong or NaN.)
# SNAPO_TEST_XLA=full compiles as users do, and tests/engine/test_xla_level.py compares the two.
# Processes that tests start read the flags too.
LOW = "--xla_backend_optimization_level=1"
if tuple(map(int, version("jaxlib").split(".")[:2])) < (0, 11):
    # Later ones end the process: unknown flags. One module of code for each program, not one for
    # each core, saves a sixth of what large programs take: all cores have tests to run.
    LOW += " --xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1"
LEVEL = os.environ.setdefault("SNAPO_TEST_XLA", "low")
if LEVEL == "low":
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {LOW}".strip()

# Compiled code is kept between runs, by version and level, under the user's cache folder. (JAX's
# own keys hold both too; a folder of its own can be removed when its version is gone.) All of it:
# tests compile thousands of small programs, many of them several times in one run, and to read one
# takes a tenth of the time.
ROOT = Path(__file__).parent
CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "snapo" / "tests"
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(CACHE / f"jax-{version('jaxlib')}-{LEVEL}"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")

import jax
import pytest
from hypothesis import settings
from tests.miniatures import FURTHER, MINIATURES

from snapo.lanes.machine import disk, pipeline
from snapo.report import drawing
from snapo.testing.miniature import once

# The same examples every time: a test that fails today failed yesterday.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")


QUICK = pipeline.Pipeline(speed_level=0, code_level=0)
FULL = pipeline.PIPELINE
# Whose proofs do without LLVM's passes, which change rounding (`engine/native/test_runtime.py`):
# simulators whose code takes longer to be made than to run. All others make the code that users
# run, and so does the kind "own", whose run is compared with that of another process.
WIDE = tuple(
    f"domains/{room}"
    for room in ("pension", "pharma", "control", "inventory", "energy", "test_every", "test_round")
)


def pytest_configure(config):
    """All of the native engine's code is made in the process of the tests."""
    disk.HERE = 10**6
    # Tracing makes many objects that are all still needed: to look for cycles among them after
    # every 700, as Python does, is a tenth of the processor time.
    gc.set_threshold(20_000, 20, 20)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    """Quick tests, and proofs of wide simulators, compile the native engine's code without LLVM's
    passes, in a quarter of the time."""
    proof = item.get_closest_marker("prove") or item.get_closest_marker("study")
    wide = item.path.relative_to(ROOT).as_posix().startswith(WIDE) and "[own" not in item.name
    wide = wide or "[pension" in item.name
    disk.PIPELINE = pipeline.PIPELINE = QUICK if LEVEL == "low" and (wide or not proof) else FULL


@pytest.fixture
def sketched(monkeypatch):
    """Charts are painted but neither laid out nor written, which is what takes the time."""

    def sketch(paint, size, grid, face="none"):
        from matplotlib.figure import Figure

        paint(*Figure().subplots(**grid, squeeze=False).ravel())
        return '<svg viewBox="0 0 1 1"></svg>'

    monkeypatch.setattr(drawing, "_svg", sketch)


MOST_MAPS = 30_000
MOST_DAYS = 14  # that compiled code is kept unused


def pytest_sessionfinish(session):
    """Old entries of the cache of compiled code go; workers leave that to the first process.

    What is alive after a search for cycles stays: pytest searches ten times more before the end.
    """
    gc.collect()
    gc.freeze()
    if "PYTEST_XDIST_WORKER" in os.environ:
        return
    for each in CACHE.glob("*/*"):
        if time.time() - each.stat().st_atime > MOST_DAYS * 86_400:
            each.unlink(missing_ok=True)


@pytest.fixture(scope="module", autouse=True)
def compiled_code_is_given_back():
    """XLA's code lies in many small memory maps, of which a process may have 65,530.

    One module adds up to 7,000. Until they are many the code stays: the next module of the same
    domain uses much of it again.
    """
    yield
    maps = Path("/proc/self/maps")
    if maps.exists() and maps.read_text().count("\n") > MOST_MAPS:
        jax.clear_caches()


@pytest.fixture(scope="session")
def solved(tmp_path_factory):
    """`solved(name)`: the folder with `case` and `run` of a solved miniature, named by its kind.

    It is solved once in a session, by the worker that asks first. Tests only read it.
    """
    base = tmp_path_factory.getbasetemp()
    shared = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    cases = MINIATURES | FURTHER
    return lambda kind: once(shared / f"solved-{kind}", cases[kind].solve)
