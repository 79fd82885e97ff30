"""Programs that are compiled quickly: the same answers, and no option that this XLA does not know."""

import jax.numpy as jnp
import numpy as np
import pytest

from snapo.problem import quickly
from snapo.problem.quickly import compiled_sooner


def test_the_answer_is_that_of_the_function():
    """Arrays are traced, all else is given to the compiler, as with `eqx.filter_jit`."""
    traced = []

    def f(x, power, name):
        traced.append(name)
        return {name: jnp.sum(jnp.exp(-x) ** power)}

    x = np.linspace(0, 1, 7, dtype=np.float32)
    found = compiled_sooner(f)
    for _ in range(2):
        assert found(x, 2, "y")["y"] == pytest.approx(np.sum(np.exp(-x) ** 2), rel=1e-6)
    assert traced == ["y"]
    found(x, 2, "z")
    assert traced == ["y", "z"]


def test_an_option_that_xla_does_not_know_is_left_out(monkeypatch):
    known = {"xla_backend_optimization_level": 1}
    monkeypatch.setattr(quickly, "OPTIONS", known | {"xla_no_such_option": True})
    monkeypatch.setattr(quickly.jax, "default_backend", lambda: "cpu")
    with quickly.jax.default_device(None):
        assert quickly._options.__wrapped__() == known


def test_other_devices_have_no_such_options(monkeypatch):
    monkeypatch.setattr(quickly.jax, "default_backend", lambda: "gpu")
    with quickly.jax.default_device(None):
        assert quickly._options.__wrapped__() is None
    with quickly.jax.default_device("cpu"):  # a GPU is there, and nothing is computed on it
        assert quickly._options.__wrapped__() is not None
