"""Appraised classes: in 32 bits while training, then in 64 bits for the value, in one process."""

import numpy as np
import pytest
from tests.domains.pension.market_cases import full

from snapo.domains.pension.fund.simulator import PensionSimulator
from snapo.domains.pension.policies.classical import ConstantMix
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.engine import Xla
from snapo.engine.native import Native
from snapo.problem.problem import prepare
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import Exact


@pytest.mark.prove
@pytest.mark.parametrize("engine", [Xla, Native])
def test_a_smoothed_class_is_simulated_in_both_precisions(engine):
    """The positions of the appraised classes are an array of the case, which JAX remembers."""
    one = full(2)
    assert len(one.assets.smoothed)
    simulator = PensionSimulator.of(one)
    schedule = prepare(simulator, pension_inputs(one))
    draws = Pseudo(1).draws(np.arange(8), simulator)
    policy, totals = ConstantMix(one), []
    for precision in ("float32", "float64"):
        made = engine(precision).values(simulator, policy, schedule, draws, Exact())
        totals.append(np.asarray(made.totals["funding_ratio"], np.float64))
    assert totals[0] == pytest.approx(totals[1], rel=1e-4)
