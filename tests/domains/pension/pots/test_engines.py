"""A fund of personal pots in both engines, and its adjoint against differences."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.domains.pension.pots_cases import fund, pots

from snapo.domains.pension.pots.simulator import PotSimulator
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.engine import Xla
from snapo.engine.native import Native
from snapo.problem.objective import Mean
from snapo.problem.policies.rules import Constant
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Pseudo, Sources
from snapo.problem.smooth import Exact
from snapo.solver.certificate import bump_check, nudged

pytestmark = pytest.mark.study  # 40 s of processor time, nearly all of it compiling


def test_both_engines_agree_and_the_adjoint_is_that_of_differences():
    """Pensions of the horizon by every number of every input, decisions of the policy held."""
    case = fund(steps=3, step=1.0)
    case = replace(case, pots=pots(case, [0.2, 0.6, 0.4, 0.9, 1.0], [1.5, 1.0, 1.2, 0.5, 0.3]))
    simulator: Any = PotSimulator.of(case)
    source = Pseudo(1)
    problem = nudged(
        Problem(simulator, pension_inputs(case), Mean("pension"), Sources(source, source, source))
    )
    policy = Constant(np.array([0.2, 0.5, 0.3]))
    found = bump_check(problem, policy, paths=16, every=True, engine=Native("float64"))
    assert {"reserve_reserve", "pot_protection", "pot_exposure"} <= {each.input for each in found}
    assert all(each.passed for each in found)
    draws = source.draws(np.arange(16), simulator)
    totals = [
        engine("float64").bind(problem).values(policy, draws, Exact()).totals
        for engine in (Xla, Native)
    ]
    for name, one in totals[0].items():
        assert np.asarray(one) == pytest.approx(np.asarray(totals[1][name]), rel=1e-9, abs=1e-12)
