"""Every documented key, word and column of a pension case: traced on both engines, and solved.

A case is trained in 32 bits and valued in 64, so that one process sees both: an array of the case
that JAX remembers in the type it met first shows as an error of types here. Nothing is compiled
in the traces, which are `prove`; whole solutions of every case on both engines are a `study`.
"""

import jax
import numpy as np
import pytest
from tests.domains.pension.every_key import CASES, written

from snapo.domains.pension.read.case import resolve
from snapo.domains.pension.results.setup import make_setup
from snapo.engine import Xla
from snapo.engine.native.explain import unsupported
from snapo.problem.smooth import Exact
from snapo.solver.solve import solve


def setup_of(name, engine, folder):
    data = {key: value for key, value in CASES[name].items() if value is not None}
    return make_setup(resolve(written(folder), data), engine)


@pytest.mark.prove
@pytest.mark.parametrize("name", CASES)
def test_a_case_is_traced_in_32_bits_and_then_in_64(name, tmp_path):
    """The whole adjoint in the native engine (32 bits in `make_setup`), the rollout in XLA."""
    problem, policy, _, _, engines, *_ = setup_of(name, "native", tmp_path)
    assert (engines.train.precision, engines.evaluate.precision) == ("float32", "float64")
    simulator, schedule = problem.simulator, problem.schedule
    assert unsupported(simulator, schedule, policy, Exact(), "float64") is None
    engine, draws = Xla("float64"), problem.sources.evaluation.draws(np.arange(2), simulator)
    with engine.numbers():
        call = engine.call(simulator, policy, schedule, draws, Exact())
        totals = jax.eval_shape(lambda: engine.traced(call).totals)
    assert {each.dtype for each in totals.values()} == {np.dtype("float64")}
    assert {each.shape for each in totals.values()} == {(2,)}


@pytest.mark.study
@pytest.mark.parametrize("engine", ["xla", "native"])
@pytest.mark.parametrize("name", CASES)
def test_a_case_is_trained_valued_and_differentiated(name, engine, tmp_path):
    """One to two minutes each: four kernels or programs of a fund with everything are compiled."""
    problem, policy, training, evaluation, engines, *_ = setup_of(name, engine, tmp_path)
    found = solve(problem, policy=policy, training=training, evaluation=evaluation, engine=engines)
    assert found.status in ("trained", "stopped early")
    assert found.standard_error >= 0
    assert not any(found.dropped.values())
    assert found.sensitivities is not None
    assert set(found.sensitivities.held) == set(problem.inputs)
    assert all(np.isfinite(each.value).all() for each in found.sensitivities.held.values())
