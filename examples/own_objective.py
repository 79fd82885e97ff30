"""An objective of one's own: the reservoir's mean profit per unit of its standard deviation.

Five lines: the names of the outputs, and one formula of the paths' totals in jax.numpy. The weights
that training needs and the standard error of the value follow from the formula.
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
