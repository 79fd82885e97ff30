"""Reactions of order zero stop when what they use has run out."""

import numpy as np
import pytest
from tests.domains.pharma.process_cases import (
    Connection,
    attribute,
    batch_reactor,
    case,
    chain,
    constant,
    feed,
    network,
    series,
)

from snapo.domains.pharma.chapters.verification import balances
from snapo.domains.pharma.derivatives.jacobian import matrix
from snapo.domains.pharma.flowsheet.process import PharmaProcess
from snapo.domains.pharma.time.dynamics import Numerics

RATE = 1e-3  # kmol/m3/s
PLAIN = Numerics("mesh", 320, 1e-8, 100_000, True, stiff="measured")


def zero_order(start=(1.0, 1.0), seconds=3000.0, dose=None):
    """A + B -> C at a rate that depends on neither, in a batch, or with A dosed."""
    found = network(
        species=("A", "B", "C"),
        molar_mass=np.array([100.0, 50.0, 150.0]),
        reactions=("main",),
        stoichiometry=np.array([[-1.0, -1.0, 1.0]]),
        order=np.zeros((1, 3)),
        prefactor=series("kinetics.prefactor", [RATE], "kmol/m3/s"),
        activation=series("kinetics.activation", [0.0], "J/mol"),
        heat=series("kinetics.heat", [0.0], "J/mol"),
    )
    feeds, ports, fields = [feed((*start, 0.0), volume=1.0)], chain("charge", "reactor"), {}
    if dose is not None:
        feeds.append(feed((dose, 0.0, 0.0), volume=0.1, name="drops"))
        ports += (Connection("drops", "", "reactor", "dose"),)
        fields = {"kind": "semi-batch", "dosing": constant("reactor.dosing", 1e-4, "m3/s")}
    wanted = [attribute(s, f"reactor.concentration.{s}") for s in "ABC"]
    unit = batch_reactor(seconds, **fields)
    return PharmaProcess(case(tuple(feeds), (unit,), ports, wanted, network=found, numerics=PLAIN))


@pytest.mark.prove
@pytest.mark.parametrize("start", [(1.0, 1.0), (1.4, 1.0)])
def test_what_has_run_out_stays_at_zero(start):
    """c = max(c_0 - k t, 0): before the end, at four fifths of it, and long after."""
    process = zero_order(start)
    for seconds in (500.0, 800.0, 3000.0):
        used = min(RATE * seconds, *start)
        moved = {"reactor.duration": np.array([seconds])}
        run = process.run(moved)
        assert run.status == "ok"
        expected = [start[0] - used, start[1] - used, used]
        np.testing.assert_allclose(list(run.attributes.values()), expected, atol=2e-8)
        assert max(abs(row.relative) for row in balances(process, moved)) < 1e-10
    slope = matrix(
        process, {"reactor.duration": np.array([500.0])}, entries=(("kinetics.prefactor", 0),)
    )
    np.testing.assert_allclose(slope.jacobian[:, 0], [-500.0, -500.0, 500.0], rtol=1e-6)


@pytest.mark.prove
def test_batches_side_by_side_stop_as_well():
    """One that runs out among those that do not, in both engines."""
    process, entry = zero_order((1.0, 1.4), 900.0), (("kinetics.prefactor", 0),)
    rates = np.array([0.5e-3, 1e-3, 4e-3])
    expected = np.maximum(1 - 900 * rates, 0.0)
    for engine in ("native", "xla"):
        found = process.batch(entry, rates[:, None], engine=engine)
        assert found.ok.all()
        np.testing.assert_allclose(found.values[:, 0], expected, atol=2e-8)


def test_what_is_dosed_is_used_as_it_comes():
    """0.1 kmol of A over 1000 s into a tank without any, which could use ten times as much."""
    found = zero_order((0.0, 1.0), 1000.0, dose=1.0).values()
    assert found[0] == pytest.approx(0.0, abs=1e-6)
    assert found[2] * 1.1 == pytest.approx(0.1, abs=1e-6)
