"""A fit is judged: against its errors, at its bounds, and against other minima; by closed forms."""

from dataclasses import replace
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import t as student

from snapo.domains.pharma.chapters.estimation import not_handed_on
from snapo.domains.pharma.chapters.headline import reservations
from snapo.domains.pharma.quality import estimation
from snapo.domains.pharma.quality.records import Estimation, Experiment

TIMES = np.array([0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0])


class Curve:
    """What a fit needs of a process: c(k, t) in closed form, k being the case's numbers."""

    def __init__(self, curve, start):
        self.curve, self.inputs = curve, {"kinetics.prefactor": np.array(start, float)}
        labels = tuple(f"k{i + 1}" for i in range(len(start)))
        given = SimpleNamespace(name="kinetics.prefactor", labels=labels, unit="1/s")
        numerics = SimpleNamespace(method="mesh")
        self.case = SimpleNamespace(network=None, given=given, numerics=numerics)

    def shifted(self, changes, entries, inputs):
        found = dict(inputs)
        for i, (name, entry) in enumerate(entries):
            found[name] = jnp.asarray(found[name]).at[entry].set(changes[i])
        return found

    def observe(self, inputs, unit, states, times):
        return self.curve(inputs["kinetics.prefactor"], jnp.asarray(times))


def first_order(k, t):
    return jnp.exp(-k[0] * t)


def intermediate(k, t):
    """C of A -> B -> C: the same whichever step is the slow one."""
    k1, k2 = k[0], jnp.where(jnp.abs(k[1] - k[0]) < 1e-6, k[0] + 1e-6, k[1])
    return 1 - (k2 * jnp.exp(-k1 * t) - k1 * jnp.exp(-k2 * t)) / (k2 - k1)


def fitted(curve, start, low, high, value, error, monkeypatch, **more):
    monkeypatch.setattr(estimation, "entry_name", lambda case, name, i: case.given.labels[i])
    states = ("reactor.concentration.A",) * len(TIMES)
    batch = Experiment("made up", (), TIMES, states, value, np.full(len(TIMES), error))
    count = len(start)
    asked = Estimation(
        ("kinetics.prefactor",) * count, tuple(range(count)), (False,) * count, low, high, (batch,),
        0.95, **more,
    )  # fmt: skip
    return estimation.fit(Curve(curve, start), asked)


def test_first_order_fitted_to_second_order_is_refused(monkeypatch):
    """1/(1 + t) is no exponential: chi² is far too large, and the covariance is as wide as that."""
    value = 1 / (1 + TIMES)
    found = fitted(first_order, (1.0,), (0.1,), (10.0,), value, 0.01, monkeypatch)
    k, slope = found.values[0], -TIMES * np.exp(-found.values[0] * TIMES)
    rest = (np.exp(-k * TIMES) - value) / 0.01
    assert abs(rest @ slope) < 1e-6  # the minimum
    assert found.chi2 == pytest.approx(rest @ rest, rel=1e-9) and found.freedom == 7
    assert found.tail < 1e-90 and found.scale == pytest.approx(found.chi2 / 7)
    variance = 1e-4 / (slope @ slope)
    assert found.covariance[0, 0] == pytest.approx(variance * found.chi2 / 7, rel=1e-6)
    half = student.ppf(0.975, 7) * np.sqrt(found.covariance[0, 0])
    assert found.high[0] - found.low[0] == pytest.approx(2 * half, rel=1e-9)
    said = reservations(found)
    assert said.startswith("the fit does not describe its data: chi² ")
    assert "at 7 degrees of freedom" in said
    assert reservations(replace(found, tail=np.nan)) == ""


def test_errors_that_are_relative_alone_scale_the_covariance_both_ways(monkeypatch):
    """With errors ten times too large the covariance is the same: the residuals say how large."""
    noise = 1e-3 * np.array([1, -1, 1, 1, -1, -1, 1, -1])
    value = np.exp(-0.5 * TIMES) + noise
    known, small, large = (
        fitted(first_order, (1.0,), (0.1,), (10.0,), value, error, monkeypatch, errors=errors)
        for errors, error in (("known", 1e-2), ("relative", 1e-3), ("relative", 1e-2))
    )
    assert known.scale == 1 and known.tail > 0.999
    np.testing.assert_allclose(small.covariance, large.covariance, rtol=1e-9)
    assert np.isnan(small.tail) and large.scale == pytest.approx(small.scale / 100)
    assert known.covariance[0, 0] > 10 * large.covariance[0, 0]


def test_a_number_at_its_bound_is_named_with_a_one_sided_interval(monkeypatch):
    """exp(-0.5 t) with k at least 0.6: on the bound, up to where chi² has risen by t²."""
    found = fitted(first_order, (1.0,), (0.6,), (10.0,), np.exp(-0.5 * TIMES), 0.05, monkeypatch)
    assert found.values[0] == pytest.approx(0.6, rel=1e-6) and found.at_bound == ("low",)
    slope = -TIMES * np.exp(-0.6 * TIMES) / 0.05
    rest = (np.exp(-0.6 * TIMES) - np.exp(-0.5 * TIMES)) / 0.05
    gradient, curve, most = slope @ rest, slope @ slope, student.ppf(0.95, 7) ** 2
    far = brentq(lambda d: 2 * gradient * d + curve * d**2 - most, 0, 10)
    assert found.low[0] == pytest.approx(0.6, rel=1e-6)
    assert found.high[0] == pytest.approx(0.6 + far, rel=1e-4)
    assert "k1 is at its lower bound" in " ".join(not_handed_on(found))


def test_both_of_two_equal_minima_are_named(monkeypatch):
    """Only C of A -> B -> C is measured: k1 and k2 change places, and nothing tells them apart."""
    value = 1 - (2.0 * np.exp(-0.4 * TIMES) - 0.4 * np.exp(-2.0 * TIMES)) / 1.6
    ends = (0.05, 0.05), (10.0, 10.0)
    found = fitted(intermediate, (0.3, 3.0), *ends, value, 0.01, monkeypatch)
    assert found.chi2 < 1e-12
    assert found.values == pytest.approx([0.4, 2.0], rel=1e-5)  # as ordered where it began
    assert found.minima.shape == (1, 2)
    np.testing.assert_allclose(found.minima[0], found.values[::-1], rtol=1e-4)
    assert "fit as well" in " ".join(not_handed_on(found))
    alone = fitted(intermediate, (0.3, 3.0), *ends, value, 0.01, monkeypatch, starts=1)
    assert alone.minima.shape == (0, 2)


def test_a_worse_minimum_is_left_by_another_start(monkeypatch):
    """cos(k t), k = 3, from 7: the fit that begins there ends in a minimum of its own."""
    value = np.cos(3.0 * TIMES)

    def wave(k, t):
        return jnp.cos(k[0] * t)

    bounds = (1.0,), (9.0,)
    alone = fitted(wave, (7.0,), *bounds, value, 0.01, monkeypatch, starts=1)
    several = fitted(wave, (7.0,), *bounds, value, 0.01, monkeypatch, starts=32)
    assert alone.chi2 > 1e3 and several.chi2 < 1e-9
    assert several.values[0] == pytest.approx(3.0, rel=1e-9)


class Run(dict):
    """Tables by dotted paths, as `status` reads them."""

    def get(self, path, default=None):
        found = dict(self)
        for key in path.split("."):
            if not isinstance(found, dict) or key not in found:
                return default
            found = found[key]
        return found
