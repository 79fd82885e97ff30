"""The flagship chain: values, the matrix, structural zeros, batches, second order, by unit."""

import numpy as np
import pytest
from tests.domains.pharma.process_cases import Numerics, flagship, reactor_alone

from snapo.domains.pharma.chapters.attribution import with_nodes
from snapo.domains.pharma.chapters.verification import balances
from snapo.domains.pharma.derivatives.convergence import convergence
from snapo.domains.pharma.derivatives.jacobian import gradient, matrix, second
from snapo.domains.pharma.derivatives.local import local
from snapo.domains.pharma.flowsheet.process import PharmaProcess

# Computed independently to tight tolerances (SUNDIALS and LSODA).
VALUES = [27.870059, 87.956431, 0.0465257, 504.75205, 81.223311, 194.163947]
YIELD = [2.312240e-1, -3.92862e-4, -2.062228e-3, -5.757553e-1, 0.0, 0.0]
SIZE = [2.293898e-1, 1.2508247, 5.420183e-2, -4.376860e-1, 0.0, 0.0]
ZEROS = [(0, 4), (0, 5), (1, 4), (1, 5), (2, 1), (2, 2), (2, 3), (2, 5), (3, 4), (4, 4), (4, 5)]
ZEROS += [(5, 4), (5, 5)]


@pytest.fixture(scope="module")
def process():
    return PharmaProcess(flagship())


@pytest.fixture(scope="module")
def forward(process):
    return matrix(process)


@pytest.mark.prove
def test_values(process):
    np.testing.assert_allclose(process.values(), VALUES, rtol=1e-6)


@pytest.mark.prove
def test_matrix_against_published_rows(forward):
    """1e-5 of the row's largest, or half a unit of the last digit printed."""
    assert forward.mode == "forward" and "6.6 forward passes" in forward.reason
    np.testing.assert_allclose(forward.jacobian[0], YIELD, atol=1e-5 * 0.58)
    np.testing.assert_allclose(forward.jacobian[1], SIZE, atol=1e-5 * 1.26)


@pytest.mark.prove
def test_structural_zeros_are_exactly_zero(forward):
    assert {tuple(each) for each in np.argwhere(forward.jacobian == 0.0)} == set(ZEROS)


@pytest.mark.prove
def test_adjoint_is_forward(process, forward):
    adjoint = matrix(process, mode="adjoint")
    largest = np.abs(forward.jacobian).max(1, keepdims=True)
    assert np.max(np.abs(adjoint.jacobian - forward.jacobian) / largest) < 1e-12
    assert {tuple(each) for each in np.argwhere(adjoint.jacobian == 0.0)} == set(ZEROS)


@pytest.mark.prove
def test_one_adjoint_pass_gives_a_row(process, forward):
    whole = gradient(process, "mean size")
    found = [whole[name][entry] for name, entry in process.entries]
    np.testing.assert_allclose(found, forward.jacobian[1], atol=1e-12)


@pytest.mark.prove
def test_batch_is_a_loop_of_single_runs(process, forward):
    entries = (("kinetics.prefactor", 0), ("crystalliser.growth", 0))
    nominal = process.at(entries)
    draws = nominal * np.array([[1.0, 1.0], [1.1, 0.9], [0.9, 1.2]])
    batch = process.batch(entries, draws, process.entries, chunk=2)
    np.testing.assert_allclose(batch.values[0], process.values(), rtol=1e-12)
    np.testing.assert_allclose(batch.jacobian[0], forward.jacobian, atol=1e-9)
    single = {"kinetics.prefactor": process.inputs["kinetics.prefactor"].copy()}
    single["kinetics.prefactor"][0] = draws[2, 0]
    single["crystalliser.growth"] = draws[2, 1:]
    np.testing.assert_allclose(batch.values[2], process.values(single), rtol=1e-12)
    assert batch.ok.all()


@pytest.mark.prove
def test_second_call_does_not_trace_again(process):
    process.values()
    before = process.traces
    process.values({"filter.wash_ratio": np.array([3.0])})
    assert process.traces == before


@pytest.mark.prove
def test_second_derivatives_against_differences(process):
    pair = (("crystalliser.temperature", 3), ("crystalliser.temperature", 1))
    found = second(process, (pair,))[0]
    rows, step = [], 0.02
    for sign in (1, -1):
        moved = process.inputs["crystalliser.temperature"].copy()
        moved[3] += sign * step
        rows.append(matrix(process, {"crystalliser.temperature": moved}).jacobian[:, 1])
    np.testing.assert_allclose(
        found, (rows[0] - rows[1]) / (2 * step), atol=2e-5 * np.abs(rows[0]).max()
    )


@pytest.mark.prove
def test_run_and_observe(process):
    run = process.run()
    assert run.status == "ok"
    np.testing.assert_allclose(list(run.attributes.values()), VALUES, rtol=1e-6)
    track = run.trajectories["crystalliser"]
    assert track["time"][-1] == 7200 and np.all(np.diff(track["time"]) >= 0)
    np.testing.assert_allclose(track["d43"][-1], VALUES[1] * 1e-6, rtol=1e-7)
    assert run.measures["filter.resistance"] == pytest.approx(2.0967e8, rel=1e-4)
    assert run.measures["crystalliser.crystals"] == pytest.approx(13.8157, rel=1e-5)


@pytest.mark.prove
def test_balances_close(process):
    rows = balances(process)
    assert {row.unit for row in rows} == {"reactor", "crystalliser", "filter", "dryer", "process"}
    assert max(abs(row.relative) for row in rows) < 1e-10


@pytest.mark.prove
def test_observe_interpolates():
    """Batch reactor at times between mesh points, against values printed to nine digits."""
    process = PharmaProcess(reactor_alone())
    states = ("concentration.A", "concentration.C", "concentration.D")
    times = np.array([600.0, 1800.0, 1800.0])
    call = process.compiled(
        "observed", lambda: lambda inputs: process.observe(inputs, "reactor", states, times)
    )
    published = [0.118582315, 0.125771639, 0.090949095]
    np.testing.assert_allclose(call(process.nominal_inputs()), published, atol=1e-7)


@pytest.mark.prove
def test_more_nodes_same_profile(process):
    finer = PharmaProcess(with_nodes(process.case, "crystalliser.temperature", 10))
    assert len(finer.inputs["crystalliser.temperature"]) == 10
    np.testing.assert_allclose(finer.values(), process.values(), rtol=1e-5)


@pytest.mark.prove
def test_paths_add_up_to_the_matrix(process, forward):
    """d43 by reactor temperature: crystalliser's measure by its feed, times the feed by T_R."""
    blocks = local(process).units
    reactor, crystals = blocks["reactor"], blocks["crystalliser"]
    by_temperature = reactor.stream_by_entry[0][
        :, reactor.entries.index(("reactor.temperature", 0))
    ]
    size = crystals.measure[crystals.measures.index("crystalliser.d43"), 0] @ by_temperature
    assert 1e6 * size == pytest.approx(forward.jacobian[1, 0], rel=1e-10)


@pytest.mark.prove
def test_matrix_against_differences_of_the_adaptive_solution(forward):
    """1e-5 of the row's largest, every entry, against central differences of a solution to 1e-11:
    of fourth order, since the curvature of those of second order alone is 3e-5 at steps that keep
    the solver's noise below 1e-6."""
    process = PharmaProcess(flagship(numerics=Numerics("adaptive", 320, 1e-11, 100_000, True)))
    np.testing.assert_allclose(process.values(), VALUES, rtol=1e-6)
    columns = []
    for name, entry in process.entries:
        step, found = (0.02 if name == "filter.wash_ratio" else 0.1), []
        for count in (-2, -1, 1, 2):
            moved = process.inputs[name].copy()
            moved[entry] += count * step
            found.append(process.values({name: moved}))
        far, near = found[3] - found[0], found[2] - found[1]
        columns.append((8 * near - far) / (12 * step))
    largest = np.abs(forward.jacobian).max(1)
    gap = np.abs(np.array(columns).T - forward.jacobian).max(1) / largest
    assert gap.max() < 1e-5


@pytest.mark.study
def test_convergence_of_values_and_gradients(process):
    found = convergence(process)
    assert found.passed and len(found.rows) == 6 * 7


@pytest.mark.prove
def test_too_few_steps_are_a_status_with_unit_and_time():
    process = PharmaProcess(reactor_alone(numerics=Numerics("adaptive", 320, 1e-10, 10, True)))
    status = process.run().status
    assert status.startswith("reactor: did not converge at ") and status.endswith(" s")
    reached = float(status.split()[-2])
    assert 0 < reached < 3600
