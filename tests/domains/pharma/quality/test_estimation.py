"""Estimation against closed forms."""

import numpy as np
import pytest
from tests.domains.pharma.pharma_cases import FirstOrder, template

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


@pytest.mark.slow
def test_intervals_cover():
    """200 noisy repeats: a 95 % interval holds the truth in 95 % of them, give or take 3 errors."""
    held = 0
    for seed in range(200):
        process, asked = closed_form((PREFACTOR,), (1e3,), (1e6,), (True,), 1e-3, seed)
        found = estimation.fit(process, asked)
        held += bool(found.low[0] <= 2.654e4 <= found.high[0])
    assert abs(held / 200 - 0.95) <= 3 * np.sqrt(0.95 * 0.05 / 200)
