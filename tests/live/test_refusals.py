"""Numbers that cannot be valued: the page hears which input it was, and whose mistake."""

import shutil
import sys
import types

import numpy as np
import pytest

from snapo.case.error import CaseError
from snapo.live.rollout import PathCounts
from snapo.live.terms import no_value, stopped
from snapo.live.valuation import Valuation
from snapo.live.worker import in_words, open_run
from snapo.problem.inputs import Input

POINTS = Input(0.1, "1", display_unit="points", display_factor=100)
FLOWS = Input([4.0, 5.0, 6.0], "hm3", labels=("Mon", "Tue", "Wed"))


def test_a_refusal_names_the_input_in_the_units_of_its_field():
    words = str(no_value({"swing": np.array(-1e4)}, {"swing": POINTS}, 510, 512))
    assert words == (
        "swing: got −1,000,000 points; it must be a number with which the simulator can calculate, "
        "such as the run's 10 points: here 510 of the 512 paths have no finite total, so "
        "there is no value."
    )
    new = FLOWS.value + np.array([0.0, -1e30, 0.0])
    words = str(no_value({"inflow": new}, {"inflow": FLOWS}, 8, 8))
    assert words.startswith("inflow, Tue: got −1\u00a0×\u00a010³⁰ hm³;")
    assert "the run's 5 hm³: here all of the 8 paths" in words
    assert "choice" in str(no_value({}, {}, 8, 8))


def stop(module: str) -> Exception:
    """What a function in a module of this name raises."""
    made = types.ModuleType(module)
    code = "\n\ndef step(x):\n    raise ValueError('the tank has no size.')\n"
    exec(compile(code, f"/tmp/somewhere/{module}.py", "exec"), made.__dict__)
    with pytest.raises(ValueError) as caught:
        made.step(1)
    return caught.value


def test_a_mistake_of_the_users_code_is_told_as_theirs_and_ours_as_ours():
    words = stopped(stop("mine"), ["capacity"], "mine")
    assert words == (
        "Your simulator stopped with capacity moved (mine.py, line 4, step): "
        "ValueError: the tank has no size."
    )
    for module in (None, "other", "min"):
        assert stopped(stop("mine"), [], module).startswith(
            "snapo could not calculate this, because"
        )


@pytest.fixture
def valuation(solved, tmp_path):
    shutil.copytree(solved("own") / "run", tmp_path / "run")
    found = open_run(tmp_path / "run", ("simulator", "Reservoir"), "auto", PathCounts.of(64))
    yield found
    sys.modules.pop("simulator", None)


@pytest.mark.prove
def test_an_absurd_number_of_an_own_simulator_is_refused_by_its_name(valuation):
    assert isinstance(valuation, Valuation)
    next(valuation.stages({}))
    moved = {
        "price_volatility": np.array([-1e6]),
        "water": valuation.inputs_by_name["water"].value + 1,
        "price": valuation.inputs_by_name["price"].value * 1.01,
    }
    for values in ({"price_volatility": moved["price_volatility"]}, moved):
        with pytest.raises(CaseError) as caught:
            next(valuation.stages(values))
        words = in_words(caught.value)
        assert words.startswith("price_volatility: got −100,000,000 points; it must be a number")
        assert "water" not in words and "\n" not in words
    assert np.isfinite(next(valuation.stages({"water": moved["water"]}))[1]["value"])


@pytest.mark.prove
def test_the_users_own_refusal_is_heard_in_its_words(solved, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(solved("own") / "run", run)
    code = run / "case" / "simulator.py"
    check = """
    @classmethod
    def from_case(cls, tables, folder):
        if tables["inputs"]["capacity"]["value"] <= 0:
            raise ValueError("a reservoir needs a size")
        return cls()
"""
    text = code.read_text()
    code.write_text(text.replace("    horizon = WEEKS", check + "\n    horizon = WEEKS", 1))
    found = open_run(run, ("simulator", "Reservoir"), "auto", PathCounts.of(64))
    with pytest.raises(CaseError) as caught:
        next(found.stages({"capacity": np.array([-1e6])}))
    words = in_words(caught.value)
    assert words.startswith("simulator.py, line ") and "a reservoir needs a size" in words
    sys.modules.pop("simulator", None)
