"""All 290 inputs of the medium fund: one adjoint pass against central bumps of every number.

The same 64 paths over all 240 months, in float64. Round numbers tie (bounds, caps, a fund just at
its target), so inputs are nudged first; a path that meets a kink within a bump is counted.
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.pension.miniature import TEMPLATES

from snapo.domains.pension.read.case import read_case
from snapo.domains.pension.results.setup import make_setup
from snapo.engine.native import Native
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import EXACT, Smooth
from snapo.solver.certificate import Bump, bump_check, nudged

pytestmark = pytest.mark.study

PATHS, INPUTS = 64, 290
BUMP, LEAST = 1e-4, 0.01  # of the largest number of an input, which counts as at least LEAST


@pytest.fixture(scope="module")
def setup():
    return make_setup(read_case(TEMPLATES / "medium"), "native")


def checked(setup, problem, smooth) -> list[Bump]:
    """Every number of every input bumped by itself."""
    problem = replace(problem, sources=replace(problem.sources, evaluation=Pseudo(1)))
    engine = Native("float64")
    found = bump_check(problem, setup.policy, paths=PATHS, smooth=smooth, every=True, engine=engine)
    assert len(found) == INPUTS
    return found


def test_every_number_through_the_policy(setup):
    """Corners are rounded so widely that no bump need be forgiven: all agree to a millionth of the
    largest derivative of their input, and nearly all to a millionth of themselves. The few others
    are hundreds of times smaller than their neighbours, and meet the difference's own error."""
    problem = nudged(setup.problem)
    inputs = {
        name: replace(entry, bump=BUMP * max(LEAST, float(np.abs(entry.value).max())))
        for name, entry in problem.inputs.items()
    }
    found = checked(setup, replace(problem, inputs=inputs), Smooth(jnp.asarray(0.5)))
    for name in inputs:
        own = [each for each in found if each.input == name]
        largest = max(abs(each.adjoint) for each in own)
        assert largest > 0, name
        assert max(abs(each.adjoint - each.central) for each in own) < 1e-6 * largest, name
    itself = [abs(each.adjoint - each.central) < 1e-6 * abs(each.adjoint) for each in found]
    assert np.mean(itself) > 0.95


def test_every_number_with_decisions_held_in_the_exact_fund(setup):
    """Costs, caps and floors have corners: a bump moves some paths across one of thousands. The
    adjoint then is compared on the others, or with the side that it belongs to."""
    found = checked(setup, nudged(setup.problem), EXACT)
    assert all(each.passed for each in found)
    assert np.mean([each.crossing > 0 for each in found]) < 0.2
