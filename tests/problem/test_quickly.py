"""Programs that are compiled quickly: the same answers, and no option that this XLA does not know."""

import jax.numpy as jnp
import numpy as np
import pytest

from snapo.problem import quickly
from snapo.problem.quickly import compiled_at_once, compiled_sooner


@pytest.mark.parametrize("compiled", [compiled_sooner, compiled_at_once])
def test_the_answer_is_that_of_the_function(compiled):
    """Arrays are traced, all else is given to the compiler, as with `eqx.filter_jit`."""
    traced = []

    def f(x, power, name):
        traced.append(name)
        return {name: jnp.sum(jnp.exp(-x) ** power)}

    x = np.linspace(0, 1, 7, dtype=np.float32)
    found = compiled(f)
    for _ in range(2):
        assert found(x, 2, "y")["y"] == pytest.approx(np.sum(np.exp(-x) ** 2), rel=1e-6)
    assert traced == ["y"]
    found(x, 2, "z")
    assert traced == ["y", "z"]


def test_an_option_that_xla_does_not_know_is_left_out(monkeypatch):
    monkeypatch.setattr(quickly, "EMITTERS", "xla_no_such_option")
    assert quickly._options.__wrapped__(1) == {quickly.LEVEL: 1}


def test_other_devices_have_no_such_options(monkeypatch):
    monkeypatch.setattr(quickly.jax, "default_backend", lambda: "gpu")
    assert quickly._options.__wrapped__(1) is None
