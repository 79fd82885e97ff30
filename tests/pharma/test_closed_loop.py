"""The process in closed loop: open loop it is the process; feedback beats the best recipe."""

from dataclasses import replace

import numpy as np
import pytest
from process_cases import flagship, spread

from snapo.adjoint import prepare
from snapo.domains.pharma.process import Process
from snapo.domains.pharma.records import Control, Manipulated, Measurement
from snapo.domains.pharma.simulator import closed_loop, corrected
from snapo.engine import Xla
from snapo.objective import Mean
from snapo.scenarios import Pseudo
from snapo.smooth import Exact
from snapo.train import EVALUATE_STREAM, Training, begin, train

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


def test_open_loop_is_the_process():
    """The stages' coarser steps lose less than 1e-3 of the distance to the nearest limit."""
    case = flagship(control=CONTROL)
    loop = closed_loop(case)
    draws = Pseudo(0).draws(np.arange(2), loop.simulator)
    schedule = prepare(loop.simulator, loop.inputs)
    totals = Xla("float64").values(loop.simulator, loop.baseline, schedule, draws, Exact()).totals
    values = Process(case).values()
    for each, name, value in zip(case.attributes, loop.outputs, values):
        distance = min(abs(value - limit) for limit in (each.low, each.high) if limit is not None)
        assert abs(totals[name][0] - value) < 1e-3 * distance
    assert totals["success"][0] == 1.0 and totals["violation"][0] == 0.0


@pytest.mark.slow
def test_feedback_beats_the_best_fixed_recipe():
    """10 % lognormal spread of both rate constants, growth and both nucleation constants; 10,000
    fresh batches, the same for both; the difference is more than 3 of its standard errors."""
    case = flagship(control=CONTROL, uncertainty=spread())
    loop = closed_loop(case)
    schedule = prepare(loop.simulator, loop.inputs)
    goal = Mean("success") - 0.01 * Mean("violation")
    plan = Training(
        steps=80, paths=64, learning_rate=0.02, warmup=5, temperature_start=1.0,
        temperature_end=0.1, validation_paths=1024, validation_every=20,
    )  # fmt: skip
    engine = Xla("float32")

    def trained(policy, plan):
        found = train(loop.simulator, schedule, begin(policy, plan), goal, plan, engine)
        return found.best

    recipe = trained(loop.baseline, plan)
    start = corrected(loop.simulator, loop.inputs, recipe)
    policy = trained(start, replace(plan, learning_rate=0.005, steps=100))
    fresh = Pseudo(1, stream=EVALUATE_STREAM << 32).draws(np.arange(10_000), loop.simulator)
    met = [
        engine.values(loop.simulator, each, schedule, fresh, Exact()).totals["success"]
        for each in (recipe, policy)
    ]
    difference = np.asarray(met[1], float) - np.asarray(met[0], float)
    assert difference.mean() > 3 * difference.std() / 100
