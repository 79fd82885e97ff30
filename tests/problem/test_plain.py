"""Modules of one's own as policies: layers of Equinox, classes of two arguments, both engines."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.problem.reservoir import Reservoir, inputs

import snapo
from snapo.problem.policies.composed import as_policy
from snapo.solver.learning.starts import others

SHORT = snapo.Training(steps=6, paths=64)
FEW = snapo.Evaluation(256, 0, 0, 0, search_paths=0)


class Share(eqx.Module):
    """A rule with two numbers that are learnt."""

    slope: jax.Array
    level: jax.Array

    def __call__(self, observation, smooth):
        return jax.nn.sigmoid(self.slope * observation[1:2] + self.level)


class Normed(snapo.Policy):
    """A policy of snapo's with layers of Equinox in it."""

    norm: eqx.nn.LayerNorm
    layers: eqx.nn.MLP
    action: snapo.Box

    def __call__(self, observation, smooth):
        return self.action.squash(self.layers(self.norm(observation)), smooth)


def modules() -> dict[str, eqx.Module]:
    layers = eqx.nn.MLP(3, 1, 8, 1, activation=jnp.tanh, key=jax.random.key(1))
    return {
        "layers of Equinox": layers,
        "two arguments": Share(jnp.ones(1), jnp.zeros(1)),
        "policy": Normed(eqx.nn.LayerNorm(3), layers, snapo.Box(0.0, 1.0)),
    }


@pytest.mark.prove
@pytest.mark.parametrize("name", modules())
def test_any_module_is_trained_by_both_engines(name):
    values = []
    for engine in ("native", "xla"):
        found = snapo.solve(
            Reservoir(), inputs, modules()[name], objective=snapo.Mean("cash"), training=SHORT,
            evaluation=FEW, engine=engine,
        )  # fmt: skip
        assert found.history[-1].step == 6
        values.append(found.value)
        before, after = (
            np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(eqx.filter(each, eqx.is_inexact_array))])
            for each in (modules()[name], found.policy)
        )  # fmt: skip
        assert np.any(before != after)
    assert values[0] == pytest.approx(values[1], rel=1e-4)


def test_sizes_that_do_not_fit_are_told():
    wide = eqx.nn.MLP(3, 2, 8, 1, key=jax.random.key(1))
    with pytest.raises(
        ValueError, match=r"MLP returns an array of shape \(2,\) .* the shape of the action, \(1,\)"
    ):
        snapo.solve(Reservoir(), inputs, wide, objective=snapo.Mean("cash"))
    narrow = eqx.nn.MLP(4, 1, 8, 1, key=jax.random.key(1))
    with pytest.raises(ValueError, match="MLP does not take an observation of 3 numbers"):
        snapo.solve(Reservoir(), inputs, narrow, objective=snapo.Mean("cash"))


def test_all_else_is_refused_with_what_is_allowed():
    class Three(eqx.Module):
        def __call__(self, a, b, c):
            return a

    for wrong in (lambda x: x, "mlp", Three()):
        with pytest.raises(TypeError, match="policy\\(observation, smooth\\)"):
            as_policy(wrong)


def test_starts_draw_the_weights_of_layers_and_keep_biases():
    first, second, third = others(as_policy(modules()["layers of Equinox"]), 3, 0)
    for one, other in ((first, second), (second, third)):
        a, b = one.module.layers[0], other.module.layers[0]  # pyright: ignore
        assert np.all(a.weight != b.weight) and np.all(a.bias == b.bias)
        assert float(np.std(b.weight)) == pytest.approx(float(np.std(a.weight)), rel=0.7)
    with pytest.raises(ValueError, match="starts is 2"):
        others(as_policy(modules()["two arguments"]), 2, 0)


class ByDefault(eqx.Module):
    """A module of the user's own whose smoothing has a default."""

    gain: jax.Array

    def __call__(self, observation, smooth=snapo.EXACT):
        return smooth.clip(self.gain @ observation, 0.0, 1.0)


def test_a_module_that_is_exact_by_default_is_a_policy_and_no_network():
    made = as_policy(ByDefault(jnp.ones((1, 3))))
    assert not made.raw
    assert made([0.1, 0.2, 0.3]).tolist() == pytest.approx([0.6])
    assert made(jnp.full(3, 0.3), snapo.Smooth(0.5))[0] < 0.9
