"""The process in closed loop: open loop it is the process; feedback beats the best recipe."""

import numpy as np
import pytest
from tests.domains.pharma.process_cases import flagship, spread

from snapo.domains.pharma.control.closed_loop import best_recipe, closed_loop, objective
from snapo.domains.pharma.control.records import Control, Manipulated, Measurement
from snapo.domains.pharma.flowsheet.process import PharmaProcess
from snapo.engine import Engines, Xla
from snapo.problem.problem import Problem
from snapo.problem.scenarios import EVALUATE, Pseudo, Sources, stream
from snapo.problem.smooth import Exact
from snapo.solver.train import Training, initial_progress, train

CONTROL = Control(
    (
        Manipulated("reactor.temperature", 303.0, 323.0, None),
        Manipulated("crystalliser.temperature", 273.0, 313.15, 0.01),
        Manipulated("filter.wash_ratio", 1.0, 4.0, None),
        Manipulated("dryer.temperature", 313.0, 333.0, None),
    ),
    (
        Measurement("reactor.concentration.C", 0.001, 0.125, 0.02),
        Measurement("reactor.concentration.D", 0.001, 0.10, 0.02),
        Measurement("crystalliser.concentration", 0.05, 12.0, 5.0),
        Measurement("crystalliser.d43", 1e-6, 6e-5, 3e-5),
    ),
    (("reactor", 2), ("crystalliser", 12)),
    64,
    None,
)


@pytest.mark.study
def test_open_loop_is_the_process():
    """The stages' coarser steps lose less than 1e-3 of the distance to the nearest limit."""
    case = flagship(control=CONTROL)
    loop = closed_loop(case)
    draws = Pseudo(0).draws(np.arange(2), loop.simulator)
    problem = Problem(loop.simulator, loop.inputs, objective(case))
    totals = Xla("float64").bind(problem).values(loop.baseline, draws, Exact()).totals
    values = PharmaProcess(case).values()
    for each, name, value in zip(case.attributes, loop.outputs, values):
        distance = min(abs(value - limit) for limit in (each.low, each.high) if limit is not None)
        assert abs(totals[name][0] - value) < 1e-3 * distance
    assert totals["success"][0] == 1.0 and totals["violation"][0] == 0.0


@pytest.mark.study
def test_feedback_beats_the_best_fixed_recipe():
    """10 % lognormal spread of both rate constants, growth and both nucleation constants; 10,000
    fresh batches, the same for both; the difference is more than 3 of its standard errors.

    The recipe is trained from three starts and the best of them once more; the policy starts
    from the same best one, with as many steps as that: the recipe has had twice as many in all.
    """
    case = flagship(control=CONTROL, uncertainty=spread())
    loop = closed_loop(case)
    problem = Problem(loop.simulator, loop.inputs, objective(case), Sources.of(None, 0))
    plan = Training(
        steps=80, paths=64, learning_rate=0.05, warmup=5, temperature_start=1.0,
        temperature_end=0.1, validation_paths=1024, validation_every=20,
    )  # fmt: skip
    engines = Engines(Xla("float32"), Xla("float64"), "xla", "as the test says")
    first, recipe = best_recipe(problem, loop.baseline, plan, engines, print)
    climbed = train(problem, initial_progress(first.closed(), plan), plan, engines.train)
    bound = engines.train.bind(problem)
    fresh = Pseudo(1, stream=stream(EVALUATE)).draws(np.arange(10_000), loop.simulator)
    met = [
        bound.values(each, fresh, Exact()).totals["success"]
        for each in (first, recipe, climbed.best)
    ]
    start, fixed, policy = (np.asarray(each, float) for each in met)
    difference = policy - fixed
    print(start.mean(), fixed.mean(), policy.mean(), difference.mean(), difference.std() / 100)
    assert fixed.mean() >= start.mean() - 3 * (fixed - start).std() / 100
    assert difference.mean() > 3 * difference.std() / 100
