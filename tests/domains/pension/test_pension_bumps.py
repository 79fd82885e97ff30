"""All 290 inputs of the medium fund: one adjoint pass against central bumps of every number.

The same 64 paths over all 240 months, in float64. Round numbers tie (bounds, caps, a fund just at
its target), so inputs are nudged first; a path that meets a kink within a bump is counted.
"""

from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import snapo.domains.pension
from snapo.domains.pension.case import read_case
from snapo.domains.pension.run import make_problem
from snapo.engine.native import Native
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import Smooth
from snapo.solver.certificate import Bump, bump_check, nudged

pytestmark = pytest.mark.slow

HOME = Path(snapo.domains.pension.__file__).parent
PATHS, INPUTS = 64, 290
BUMP, LEAST = 1e-4, 0.01  # of the largest number of an input, which counts as at least LEAST


@pytest.fixture(scope="module")
def problem():
    return make_problem(read_case(HOME / "template_medium"), 0, "native")


def checked(problem, inputs, smooth) -> list[Bump]:
    """Every number of every input bumped by itself."""
    given = (problem.simulator, inputs, problem.policy, problem.objective, Pseudo(1), PATHS)
    found = bump_check(*given, smooth=smooth, every=True, engine=Native("float64"))
    assert len(found) == INPUTS
    return found


def test_every_number_through_the_policy(problem):
    """Corners are rounded so widely that no bump need be forgiven: all agree to a millionth of the
    largest derivative of their input, and nearly all to a millionth of themselves. The few others
    are hundreds of times smaller than their neighbours, and meet the difference's own error."""
    inputs = {
        name: replace(entry, bump=BUMP * max(LEAST, float(np.abs(entry.value).max())))
        for name, entry in nudged(problem.inputs).items()
    }
    found = checked(problem, inputs, Smooth(jnp.asarray(0.5)))
    for name in inputs:
        own = [each for each in found if each.input == name]
        largest = max(abs(each.adjoint) for each in own)
        assert largest > 0, name
        assert max(abs(each.adjoint - each.central) for each in own) < 1e-6 * largest, name
    itself = [abs(each.adjoint - each.central) < 1e-6 * abs(each.adjoint) for each in found]
    assert np.mean(itself) > 0.95


def test_every_number_with_decisions_held_in_the_exact_fund(problem):
    """Costs, caps and floors have corners: a bump moves some paths across one of thousands. The
    adjoint then is compared on the others, or with the side that it belongs to."""
    found = checked(problem, nudged(problem.inputs), None)
    assert all(each.passed for each in found)
    assert np.mean([each.crossing > 0 for each in found]) < 0.2
