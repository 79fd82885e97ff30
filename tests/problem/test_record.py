"""Records: dataclasses without JAX that are its trees once it is loaded, as modules of Equinox."""

import dataclasses
import pickle
import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from snapo.problem.process import Schwartz
from snapo.problem.record import AbstractVar, Input, Schedule, TreeRecord, field
from snapo.problem.record.arrays import custom_jvp


class Pair(TreeRecord):
    """A number of an array, and the text of the structure."""

    first: np.ndarray = field(converter=np.asarray)
    name: str = eqx.field(static=True, default="a")  # as users of `snapo.Process` write it


class Checked(Pair):
    """With an `__init__` of its own, as Equinox allows it."""

    sign: float

    def __init__(self, first, name="a"):
        self.first, self.name, self.sign = first, name, 1.0

    def __check_init__(self):
        if np.any(self.first < 0):
            raise ValueError("below 0")


def test_a_record_is_a_tree_of_its_fields():
    pair = Pair([1.0, 2.0], "b")
    leaves, structure = jax.tree.flatten(pair)
    assert len(leaves) == 1 and leaves[0] is pair.first
    assert structure != jax.tree.structure(Pair([1.0, 2.0]))  # another static field
    paths = jax.tree_util.tree_flatten_with_path(pair)[0]
    assert [jax.tree_util.keystr(path) for path, _ in paths] == [".first"]
    twice = jax.tree.map(lambda x: 2 * x, pair)
    assert type(twice) is Pair and twice.name == "b" and twice.first.tolist() == [2.0, 4.0]
    assert jax.tree.map(lambda x: None, pair).first is None  # neither converted nor checked


def test_a_record_is_differentiated_and_compiled_as_a_module():
    def total(pair):
        return jnp.sum(pair.first**2) * len(pair.name)

    slope = jax.jit(jax.grad(total))(Pair(np.array([1.0, 3.0]), "ab"))
    assert slope.first.tolist() == [4.0, 12.0]


def test_a_record_is_frozen_after_its_init():
    checked = Checked([1, 2])
    assert checked.first.tolist() == [1, 2] and checked.sign == 1.0
    for change in (lambda: setattr(checked, "name", "b"), lambda: delattr(checked, "name")):
        with pytest.raises(dataclasses.FrozenInstanceError):
            change()
    with pytest.raises(ValueError, match="below 0"):
        Checked([-1])
    assert dataclasses.replace(Pair([1]), name="c").name == "c"
    assert pickle.loads(pickle.dumps(checked)).first.tolist() == [1, 2]
    assert checked == Checked([1, 2]) != Checked([1, 3])


def test_what_a_class_leaves_open_must_be_there():
    class Open(TreeRecord):
        size: AbstractVar[int]
        kind: eqx.AbstractClassVar[str]

    class Half(Open):
        kind = "half"

    class Whole(Half):
        size: int = field(static=True, default=3)

    with pytest.raises(TypeError, match="without size"):
        Half()
    assert Open.__abstractvars__ == {"size", "kind"} and Whole().size == 3
    assert [x.name for x in dataclasses.fields(Whole)] == ["size"]


def test_records_that_were_made_before_jax_are_its_trees():
    code = (
        "import sys; from snapo.problem.record import Input; x = Input([1.0, 2.0], 'EUR')\n"
        "assert not {'jax', 'equinox', 'jaxtyping'} & sys.modules.keys()\n"
        "import jax; from snapo.problem.inputs import plain\n"
        "assert plain({'x': x})['x'].tolist() == [1, 2]; assert len(jax.tree.leaves(x)) == 1"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_an_input_is_as_before():
    made = Input([[1, 2], [3, 4]], "EUR", labels=range(4))
    assert made.value.dtype == np.float64 and made.labels == ("0", "1", "2", "3")
    assert (
        repr(Schwartz(range(3))) == "Schwartz(times=(0.0, 1.0, 2.0), time_scale=1.0, noise_size=1)"
    )
    with pytest.raises(ValueError, match="3 labels for 4 numbers"):
        Input([[1, 2], [3, 4]], labels="abc")


def test_a_rule_of_derivatives_is_used():
    def tangent(scale, primals, tangents):
        (x,), (dx,) = primals, tangents
        return double(scale, x), 7.0 * dx

    @custom_jvp(tangent, fixed=(0,))
    def double(scale, x):
        return scale * x

    assert double(2.0, 3.0) == 6.0 and jax.grad(lambda x: double(2.0, x))(3.0) == 7.0


def test_inputs_are_compared_by_their_fields():
    one = Input([1.0, 2.0], "EUR", labels=("a", "b"))
    assert one == Input([1.0, 2.0], "EUR", labels=("a", "b")) and hash(one) == hash(Input([3.0]))
    assert one != Input([1.0, 2.5], "EUR", labels=("a", "b"))
    assert one != Input([1.0, 2.0], "USD", labels=("a", "b")) and one != Input([1.0], "EUR")
    assert Schedule({"a": np.ones(2)}) == Schedule({"a": np.ones(2)}) != Schedule({"b": np.ones(2)})
    assert Schedule((np.ones(2), 1)) != Schedule((np.ones(3), 1)) and one != 1
