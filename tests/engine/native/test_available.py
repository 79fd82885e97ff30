"""Where nothing can be compiled everything runs on XLA, and the reason is told."""

import subprocess
import sys

import pytest
from tests.engine.native.problems import Store, Tanh

from snapo.engine import native
from snapo.engine.choose import choose
from snapo.lanes import jax_private
from snapo.lanes.machine import pipeline
from snapo.problem.objective import Mean
from snapo.problem.problem import Problem

BLOCKED = """
import sys
sys.modules["llvmlite"] = None  # importing it now fails as where it is not installed
sys.path.insert(0, ".")
import numpy as np
from snapo.engine import Native, Unsupported, choose
from snapo.engine.native import unsupported
from snapo.problem.objective import Mean
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import Exact
from tests.engine.native.problems import Store, Tanh

WHY = "llvmlite is not installed (pip install 'snapo[native]')"
store, policy = Store(), Tanh((4, 14, 2))
schedule, problem = store.prepare(None), Problem(store, None, Mean("cash"))
engines = choose("auto", problem, policy)
assert engines.name == "xla" and engines.reason.startswith("XLA on "), engines
assert engines.reason.endswith(f", because {WHY}"), engines.reason
draws = Pseudo(0).draws(np.arange(4), store)
assert engines.evaluate.values(store, policy, schedule, draws, Exact()).totals["cash"].size == 4
assert unsupported(store, schedule, policy, Exact()) == WHY
for call in (
    lambda: choose("native", problem, policy),
    lambda: Native().values(store, policy, schedule, draws, Exact()),
):
    try:
        call()
    except (ValueError, Unsupported) as error:
        assert WHY in str(error), error
        print(type(error).__name__)
"""


@pytest.mark.prove
def test_without_llvmlite_all_runs_on_xla():
    done = subprocess.run([sys.executable, "-c", BLOCKED], capture_output=True, text=True)
    assert done.stdout == "ValueError\nUnsupported\n", done.stderr


def test_importing_the_engines_imports_no_llvmlite():
    code = "import sys, snapo, snapo.engine; assert 'llvmlite' not in sys.modules; snapo.solve"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_an_untested_jax_is_a_reason(monkeypatch):
    problem, policy = Problem(Store(), None, Mean("cash")), Tanh((4, 14, 2))
    monkeypatch.setattr(jax_private, "TESTED", ((0, 1), (0, 2)))
    engines = choose("auto", problem, policy)
    assert engines.name == "xla" and "0.1 to below 0.2" in engines.reason
    with pytest.raises(ValueError, match=r"native cannot run here, because jax .* not among"):
        choose("native", problem, policy)


def test_an_old_or_broken_llvmlite_is_a_reason(monkeypatch):
    monkeypatch.setattr(pipeline, "OLDEST", (99, 0))
    assert "is older than 99.0 (pip install" in (native.unavailable() or "")

    def broken():
        raise OSError("libstdc++ is missing")

    monkeypatch.setattr(pipeline, "OLDEST", (0, 1))
    monkeypatch.setattr(pipeline, "binding", broken)
    assert "cannot be loaded: libstdc++ is missing" in (native.unavailable() or "")
