"""Estimation against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import t as student
from tests.domains.pharma.pharma_cases import FirstOrder, fast, template

from snapo.domains.pharma.chapters.estimation import validate
from snapo.domains.pharma.flowsheet.process import PharmaProcess
from snapo.domains.pharma.quality import estimation
from snapo.domains.pharma.quality.records import Estimation, Experiment


def closed_form(which, low, high, logarithm, noise=0.0, seed=0, temperatures=(313.15, 303.15)):
    """c = 0.33 exp(-0.33 k exp(-E/RT) t): rows at two temperatures, with errors of 1e-3."""
    case = template(pairs=None)
    process = FirstOrder(case)
    times = np.linspace(200, 3600, 9)
    rng = np.random.default_rng(seed)
    experiments = []
    for temperature in temperatures:
        rate = 2.654e4 * np.exp(-4e4 / 8.314 / temperature)
        value = 0.33 * np.exp(-rate * 0.33 * times) + noise * rng.standard_normal(9)
        settings = (("reactor.temperature", 0, temperature),)
        states = ("reactor.concentration.A",) * 9
        experiments.append(Experiment("made up", settings, times, states, value, np.full(9, 1e-3)))
    names, entries = zip(*which)
    asked = Estimation(names, entries, logarithm, low, high, tuple(experiments), 0.95)
    return process, asked


PREFACTOR, ACTIVATION = ("kinetics.prefactor", 0), ("kinetics.activation", 0)


def test_both_kinetic_numbers_from_two_temperatures():
    process, asked = closed_form((PREFACTOR, ACTIVATION), (1e2, 2e4), (1e8, 8e4), (True, False))
    process.inputs["kinetics.prefactor"] = np.array([1e4, 530.0])
    process.inputs["kinetics.activation"] = np.array([3.8e4, 3e4])
    found = estimation.fit(process, asked)
    assert found.converged
    assert found.values == pytest.approx([2.654e4, 4e4], rel=1e-6)
    assert found.correlation[0, 1] > 0.99  # as prefactor and activation always are


def test_one_temperature_does_not_identify_both():
    process, asked = closed_form(
        (PREFACTOR, ACTIVATION), (1e2, 2e4), (1e8, 8e4), (True, False), temperatures=(313.15,)
    )
    found = estimation.fit(process, asked)
    assert len(found.unidentified) == 1 and "activation" in found.unidentified[0]
    assert np.isnan(found.low).any()


@pytest.mark.study
def test_intervals_cover():
    """200 noisy repeats: a 95 % interval holds the truth in 95 % of them, give or take 3 errors."""
    held = 0
    for seed in range(200):
        process, asked = closed_form((PREFACTOR,), (1e3,), (1e6,), (True,), 1e-3, seed)
        found = estimation.fit(process, asked)
        held += bool(found.low[0] <= 2.654e4 <= found.high[0])
    assert abs(held / 200 - 0.95) <= 3 * np.sqrt(0.95 * 0.05 / 200)


@pytest.mark.prove
def test_a_batch_held_out_is_predicted_with_its_interval():
    """By hand: c = 0.33 exp(-k a t), so d c / d ln k = -c k a t, and the variance of ln k is one over
    the sum of their squares over those of the errors. Then a batch that the model does not describe."""
    process, asked = closed_form((PREFACTOR,), (1e3,), (1e6,), (True,), 1e-3, 3)
    fresh = closed_form((PREFACTOR,), (1e3,), (1e6,), (True,), 1e-3, 4, (308.15, 318.15))[1]
    good, other = fresh.experiments
    wrong = replace(other, name="wrong", value=other.value + 0.01)
    asked = replace(asked, held_out=(good, wrong))
    found = estimation.fit(process, asked)
    checked = validate(process, asked, found)
    assert checked is not None

    def model(experiment):
        rate = found.values[0] * np.exp(-4e4 / 8.314 / experiment.settings[0][2]) * 0.33
        c = 0.33 * np.exp(-rate * experiment.time)
        return c, -c * rate * experiment.time

    slopes = np.concatenate([model(each)[1] for each in asked.experiments])
    variance = 1e-6 / (slopes @ slopes)
    c, slope = (np.concatenate(each) for each in zip(model(good), model(wrong)))
    np.testing.assert_allclose(checked.predicted, c, rtol=1e-10)
    np.testing.assert_allclose(checked.deviation, np.abs(slope) * np.sqrt(variance), rtol=1e-6)
    half = student.ppf(0.975, 17) * np.sqrt(slope**2 * variance + 1e-6)
    np.testing.assert_allclose(checked.half, half, rtol=1e-6)
    off = good.value - c[:9]
    # (D + v s s^T)^-1 by Sherman and Morrison.
    weighted = slope[:9] @ off / 1e-6
    size = off @ off / 1e-6 - variance * weighted**2 / (1 + variance * slope[:9] @ slope[:9] / 1e-6)
    first, second = checked.batches
    assert first.chi2 == pytest.approx(size, rel=1e-6) and first.tail > 0.01
    assert first.inside >= 8 and second.inside <= 1 and second.tail < 1e-6
    assert checked.coverage == (first.inside + second.inside) / 18
    assert validate(process, replace(asked, held_out=()), found) is None


@pytest.mark.prove
@pytest.mark.parametrize("method", ("mesh", "adaptive"))
def test_a_fit_with_either_method_of_integration(method):
    """c = exp(-k t): with measurements of k = 0.02 1/s, d c / d ln k = -c k t, and the variance of
    ln k is one over the sum of their squares over those of the errors. The steps of a mesh have
    relative errors of about 1e-5."""
    process, times = PharmaProcess(fast(0.025, method=method)), np.array([30.0, 60.0, 120.0])
    states = ("reactor.concentration.A",) * 3
    c = np.exp(-0.02 * times)
    batch = Experiment("b", (), times, states, c, np.full(3, 2e-3))
    requested = Estimation(
        ("kinetics.prefactor",), (0,), (True,), (1e-3,), (1e-1,), (batch,), 0.95,
        held_out=(replace(batch, name="again"),), starts=1,
    )  # fmt: skip
    result = estimation.fit(process, requested)
    assert process.case.numerics.method == method
    assert result.converged and result.values == pytest.approx([0.02], rel=5e-5)
    slope = -c * 0.02 * times / 2e-3
    assert result.covariance[0, 0] == pytest.approx(1 / (slope @ slope), rel=2e-4)
    tests = validate(process, requested, result)
    assert tests is not None
    deviation = np.abs(slope) * 2e-3 / np.sqrt(slope @ slope)
    np.testing.assert_allclose(tests.deviation, deviation, rtol=2e-4)
    np.testing.assert_allclose(tests.predicted, c, rtol=1e-4)
