"""Inputs: steps of differences, relative to each number."""

import numpy as np

from snapo.problem.inputs import Input
from snapo.solver.certificate import bump_check


def test_a_step_is_relative_to_each_number():
    np.testing.assert_allclose(Input([2.0, -3e-5, 0.0]).step(), [2e-5, 3e-10, 2e-5])
    np.testing.assert_allclose(Input(0.2 / 6000).step(), 1e-5 * 0.2 / 6000)
    # A zero with round-off is a zero.
    np.testing.assert_allclose(Input([1.0, 1e-17]).step(), [1e-5, 1e-5])


def test_where_all_numbers_are_zero_the_move_gives_the_size():
    np.testing.assert_allclose(Input(np.zeros((2, 1))).step(), np.full((2, 1), 1e-5))
    np.testing.assert_allclose(Input([0.0, 0.0], move=-1e-4).step(), [1e-7, 1e-7])


def test_a_bump_of_ones_own_is_the_step_of_every_number():
    np.testing.assert_allclose(Input([[1.0, 0.0]], bump=0.01).step(), [[0.01, 0.01]])


def test_the_certificate_bumps_small_numbers_by_small_steps():
    """The battery wears by 3e-5 a cycle: a step of 1e-5, a third of it, is no derivative.

    Both orders of size in one input: each entry alone, and all of them together.
    """
    from tests.problem.test_chain import Heat, HeatInputs

    import snapo

    inputs = HeatInputs(Input([1.5, 1.6e-6, 1.8]), Input(2e-5))
    policy = snapo.Linear(np.full((1, 1), 0.3))
    problem = snapo.Problem(Heat(), inputs, snapo.Mean("cost"))
    for every in (False, True):
        found = bump_check(problem, policy, paths=8, every=every)
        assert len(found) == (4 if every else 2)
        assert all(bump.passed for bump in found), found
        by = {(bump.input, bump.direction): bump for bump in found}
        rate = by["rate", ""]
        np.testing.assert_allclose(rate.adjoint, rate.central, rtol=1e-5)
