"""Stiff units: chosen by measured stiffness, the same in both engines, refused with unit and time."""

from dataclasses import replace

import numpy as np
import pytest
from tests.domains.pharma.pharma_cases import fast
from tests.domains.pharma.process_cases import (
    attribute,
    batch_reactor,
    case,
    chain,
    feed,
    linear,
    network,
    series,
    steps,
)

from snapo.domains.pharma.derivatives.jacobian import matrix
from snapo.domains.pharma.flowsheet.network import fastest_rate
from snapo.domains.pharma.flowsheet.process import PharmaProcess
from snapo.domains.pharma.time import integrate


@pytest.fixture(scope="module")
def quick():
    return PharmaProcess(fast())


@pytest.mark.prove
def test_a_fast_reaction_by_default(quick):
    """c = exp(-k t): explicit steps gave 9.6e28 (and 1.10 mol/L at 0.2476 1/s), with status "ok"."""
    assert len(quick.case.numerics.held["reactor"]) < 100
    run = quick.run()
    assert run.status == "ok" and run.errors["reactor"] < 1e-8
    assert run.attributes["A left"] == pytest.approx(np.exp(-3600 * 0.26), abs=1e-12)
    border = PharmaProcess(fast(0.2476)).run()
    assert border.status == "ok"
    assert border.attributes["A left"] == pytest.approx(np.exp(-3600 * 0.2476), abs=1e-12)


@pytest.mark.prove
def test_a_run_of_its_own(quick):
    """Ten seconds in place of an hour: the held steps, shares of the duration, are refused."""
    short = {"reactor.duration": np.array([10.0])}
    slope = matrix(quick, short, mode="adjoint")
    assert slope.values[0] == pytest.approx(np.exp(-2.6), rel=1e-7)
    assert slope.jacobian[0, 0] == pytest.approx(-10 * np.exp(-2.6), rel=1e-6)


def test_slow_reactions_take_explicit_steps():
    """By the bound alone: nothing is compiled, and the mesh is the one that it was."""
    process = PharmaProcess(fast(0.1))
    assert not process.case.numerics.held
    assert not PharmaProcess(fast(method="mesh")).case.numerics.held


@pytest.mark.prove
def test_a_refused_run_says_unit_and_time(quick, monkeypatch):
    """Batches far from the nominal one get steps of their own; where no steps do, they are refused."""
    assert quick.run({"kinetics.prefactor": np.array([26.0])}).status == "ok"
    entry = (("kinetics.prefactor", 0),)
    assert quick.batch(entry, np.array([[26.0], [0.2]]), engine="xla").ok.all()
    monkeypatch.setattr(integrate, "limit_of", lambda tolerance: tolerance / 1000)
    found = PharmaProcess(fast()).run()
    assert found.status.startswith("reactor: did not converge at ")
    assert "estimated error of one step" in found.status and np.isnan(found.attributes["A left"])
    explicit = PharmaProcess(fast(method="mesh")).run()
    assert explicit.status.startswith("reactor: the time steps are too long from 0 s on")


def test_bound_on_the_fastest_rate():
    """Above the norms of d r / d x at random compositions, for second and third order."""
    found = network(
        order=np.array([[1.0, 2, 0, 0], [1, 0, 1, 0]]),
        prefactor=series("kinetics.prefactor", [2.654e4, 5.3e2], "m3/kmol/s"),
    )
    most = np.array([0.3, 0.5, 0.2, 0.1])
    bound = fastest_rate(found, np.array([300.0, 320.0]), most)
    nu, random = found.stoichiometry, np.random.default_rng(0)
    k = found.prefactor.values * np.exp(-found.activation.values / 8.314 / 320.0)
    for c in random.random((20, 4)) * most:
        slope = np.array(
            [
                [k[0] * c[1] ** 2, 2 * k[0] * c[0] * c[1], 0, 0],
                [k[1] * c[2], 0, k[1] * c[0], 0],
            ]
        )
        assert np.abs(np.linalg.eigvals(slope @ nu.T)).max() <= bound
    assert fastest_rate(network(order=np.full((2, 4), 0.5)), np.array([300.0]), most) == np.inf


def robertson(duration=100.0, temperature=None, **numerics):
    """A -> B, 2 B -> C + B, B + C -> A + C; see tests/domains/pharma/time/test_rosenbrock.py."""
    tank = batch_reactor(duration, temperature)
    kinetics = network(
        species=("A", "B", "C"),
        molar_mass=np.full(3, 100.0),
        reactions=("slow", "fast", "back"),
        stoichiometry=np.array([[-1.0, 1, 0], [0, -1, 1], [1, -1, 0]]),
        order=np.array([[1.0, 0, 0], [0, 2, 0], [0, 1, 1]]),
        prefactor=series("kinetics.prefactor", [0.04, 3e7, 1e4]),
        activation=series("kinetics.activation", [0.0, 0.0, 2e3], "J/mol"),
        heat=series("kinetics.heat", [0.0] * 3, "J/mol"),
        reference=313.15,
    )
    found = tuple(attribute(s, f"reactor.concentration.{s}") for s in "ABC")
    made = case(
        (feed((1.0, 0.0, 0.0)),), (tank,), chain("charge", "reactor"), found, network=kinetics
    )
    return replace(made, numerics=replace(made.numerics, stiff="measured", **numerics))


@pytest.fixture(scope="module")
def stiff():
    return PharmaProcess(robertson())


@pytest.mark.prove
def test_robertson_as_a_reactor(stiff):
    """At t = 100 s by the driver of MEBDF's authors for the test set: 13 digits."""
    end = [0.6172348823960878, 0.6153591274639123e-5, 0.3827589640126376]
    np.testing.assert_allclose(stiff.values(), end, rtol=1e-6)
    assert stiff.run().errors["reactor"] <= 1e-8


@pytest.mark.prove
def test_both_engines_are_one(stiff):
    """Also where the temperature moves: values, and derivatives by every constant. B is a difference
    of extents 1e5 times as large, so that their round-off of 1e-16 is 1e-11 of it, and grows."""
    moving = PharmaProcess(robertson(10.0, linear("reactor.temperature", [313.15, 320.0, 305.0])))
    for process in (stiff, moving):
        by = (*(("kinetics.prefactor", i) for i in range(3)), ("reactor.temperature", 0))
        here = process.at(by)
        draws = here * (1 + 1e-2 * np.random.default_rng(0).normal(size=(5, 4)))
        native = process.batch(by, draws, by, chunk=5, engine="native")
        xla = process.batch(by, draws, by, chunk=5, engine="xla")
        assert native.ok.all() and xla.ok.all()
        np.testing.assert_allclose(native.values, xla.values, rtol=1e-9)
        largest = np.abs(xla.jacobian).max((0, 2))[None, :, None]
        np.testing.assert_allclose(native.jacobian / largest, xla.jacobian / largest, atol=1e-8)


@pytest.mark.prove
@pytest.mark.parametrize("shape", [linear, steps])
def test_controls_that_move(shape):
    """Against the adaptive solver, with a temperature that goes straight or jumps."""
    profile = shape("reactor.temperature", [313.15, 330.0, 303.15])
    made = robertson(10.0, profile)
    other = replace(made, numerics=replace(made.numerics, method="adaptive", tolerance=1e-11))
    process = PharmaProcess(made)
    assert process.case.numerics.held
    np.testing.assert_allclose(process.values(), PharmaProcess(other).values(), rtol=1e-6)
    run = process.run()
    assert run.trajectories["reactor"]["temperature"][-1] == 303.15
    assert run.trajectories["reactor"]["time"][-1] == 10.0


@pytest.mark.prove
def test_adjoint(stiff):
    """By all numbers that act, to 1e-6 of central differences on the steps that are held."""
    by = [("kinetics.prefactor", i) for i in range(3)] + [("charge.concentration", 0)]
    here = stiff.at(by)
    found = matrix(stiff, entries=tuple(by), mode="adjoint").jacobian * here
    step = 1e-3
    moves = [here * (1 + k * step * e) for e in np.eye(4) for k in (-2, -1, 1, 2)]
    values = stiff.batch(by, np.array(moves), chunk=16, engine="xla").values.reshape(4, 4, 3)
    far_low, low, high, far_high = np.moveaxis(values, 1, 0)
    differences = ((8 * (high - low) - (far_high - far_low)) / (12 * step)).T
    largest = np.abs(found).max(1, keepdims=True)
    np.testing.assert_allclose(differences / largest, found / largest, atol=1e-6)
