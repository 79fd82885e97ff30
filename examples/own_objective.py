"""A user-defined objective: the mean profit of the reservoir divided by its standard deviation.

It needs two things: the names of the outputs, and a formula of the totals of the paths in
jax.numpy. The weights that training needs and the standard error of the value follow from it.
"""

from dataclasses import dataclass

import jax.numpy as jnp
from own_simulator import Reservoir, inputs

import snapo


@dataclass(frozen=True)
class Sharpe(snapo.Objective):
    outputs = ("cash",)

    def formula(self, totals):
        return jnp.mean(totals["cash"]) / jnp.std(totals["cash"])


if __name__ == "__main__":
    print(snapo.solve(Reservoir(), inputs, objective=Sharpe()))
