"""The process in closed loop: open loop it is the process; feedback beats the best recipe."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.pharma.process_cases import (
    attribute,
    batch_reactor,
    case,
    chain,
    crystalliser,
    feed,
    flagship,
    linear,
    parameter,
    spread,
)

from snapo.domains.pharma.control.closed_loop import (
    best_recipe,
    closed_loop,
    nominal_recipe,
    objective,
    stages_of,
)
from snapo.domains.pharma.control.records import Control, Manipulated, Measurement
from snapo.domains.pharma.flowsheet.inputs import pharma_inputs
from snapo.domains.pharma.flowsheet.process import PharmaProcess
from snapo.domains.pharma.quality.records import Distribution
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


HEATED = batch_reactor(temperature=linear("reactor.temperature", [300.0, 320.0]))


def disturbed(unit, charge, measures, measured):
    """One batch of a unit whose linear temperature is decided and varies at every node by 2 K:
    the case, the nodes of this batch, its `measures` after the recipe as decisions, and the
    readings of `measured` at the start and after every decision."""
    name, nodes = unit.name, unit.temperature.value.values
    vary = Distribution("normal", 2.0)
    parts = [parameter(f"T{i}", f"{name}.temperature", i, 250, 350) for i in range(len(nodes))]
    control = Control(
        (Manipulated(f"{name}.temperature", 250.0, 350.0, None),),
        (Measurement(f"{name}.{measured}", 0.0, 0.0, 1.0),), ((name, 6),), 256, None,
    )  # fmt: skip
    found = case(
        (charge,), (unit,), chain("charge", name), [attribute(m, f"{name}.{m}") for m in measures],
        [replace(each, distribution=vary) for each in parts], control=control,
    )  # fmt: skip
    z = np.array([1.0, -0.5, 0.3, -1.2])[: len(nodes)]
    with jax.enable_x64(True):
        (stage,), inputs = stages_of(found), pharma_inputs(found)
        schedule = stage.prepare({name: item.value for name, item in inputs.items()})
        recipe = nominal_recipe(found, [stage], inputs)

        def batch(schedule):
            noise = jnp.append(jnp.asarray(z), 0.0)
            state, seen = stage.initial(schedule.constants, noise), []
            for row, action in enumerate(recipe):
                seen.append(state["seen"][0])
                now = {name: item[row] for name, item in schedule.steps.items()}
                state, _ = stage.step(schedule.constants, now, state, action, noise, Exact())
            seen.append(state["seen"][0])
            return stage.leave(schedule.constants, state)["measures"], jnp.stack(seen)

        results, seen = jax.jit(batch)(schedule)
    closed = [float(results[f"{name}.{m}"]) for m in measures]
    return found, nodes + 2.0 * z, closed, np.asarray(seen)


def test_a_decision_has_its_disturbance_from_the_start_to_the_end():
    """The first reading and the product are those of the batch, as all readings between them."""
    _, nodes, closed, seen = disturbed(HEATED, feed(), ["temperature"], "temperature")
    assert seen == pytest.approx(np.linspace(nodes[0], nodes[-1], 7), rel=1e-12)
    assert closed == pytest.approx(nodes[-1:], rel=1e-12)


@pytest.mark.prove
@pytest.mark.parametrize(
    ("unit", "charge", "measures"),
    [
        (HEATED, feed(), ["temperature", "concentration.C"]),
        # The supersaturation depends on the temperature at the end.
        (crystalliser(), feed((0.0, 0.0, 0.13, 0.0)), ["supersaturation", "concentration"]),
    ],
)
def test_one_batch_is_the_same_in_open_and_in_closed_loop(unit, charge, measures):
    """The recipe as decisions is the recipe, with the same disturbance."""
    found, nodes, closed, _ = disturbed(unit, charge, measures, measures[1])
    moved = PharmaProcess(found).values({f"{unit.name}.temperature": nodes})
    assert closed == pytest.approx(moved, rel=1e-4)


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
