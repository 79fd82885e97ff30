"""Flow along a tube: elements in series, with one or more points in each.

The equation u_t = -u_z is solved by collocation at the points of Radau IIA in every element; the
element upstream supplies the value at the inlet (a discontinuous Galerkin method). With one point
an element is a stirred tank, and the tube is a series of tanks. With four, a steady tube is
integrated along its length by an implicit Runge-Kutta method of order seven: over eight elements
exp(-7) is accurate to 2e-6. For any number of points, each element conserves mass: its gain is
inflow minus outflow.
"""

from typing import NamedTuple

import numpy as np

from snapo.problem.record.arrays import Array, Float, jnp

from ...given import fixed

ELEMENTS, POINTS = 8, 4  # of plug flow
# By points, times the elements: 2.78 over the longest step by which powers of the classical
# Runge-Kutta method stay bounded, in passages of the tube (computed: 2.0 and 6.4 at most).
FASTEST = {1: 2.0, 4: 6.5}


class Along(NamedTuple):
    """The n = elements x points along the tube. `positions`: [n] from 0 to 1; `weights`: [n]
    shares of the volume; `slopes`: [points, points], with which slopes @ (u - upstream) is u_z
    times the length of an element."""

    elements: int
    positions: Float[np.ndarray, " n"]
    weights: Float[np.ndarray, " n"]
    slopes: Float[np.ndarray, "points points"]

    @classmethod
    def of(cls, elements: int, points: int) -> "Along":
        nodes, integrals = radau(points)
        positions = (np.arange(elements)[:, None] + nodes).ravel() / elements
        weights = np.tile(integrals[-1], elements) / elements
        return cls(elements, positions, weights, np.linalg.inv(integrals))

    @property
    def fastest(self) -> float:
        """A bound on the rates that explicit steps must resolve, per passage through the tube."""
        return FASTEST[len(self.slopes)] * self.elements

    def carried(self, u: Float[Array, "n k"], entering: Float[Array, " k"]) -> Float[Array, "n k"]:
        """u_t due to flow only, per passage through the tube; `entering` is u upstream."""
        points = len(self.slopes)
        inside = u.reshape(self.elements, points, -1)
        before = jnp.concatenate([entering[None], inside[:-1, -1]])
        gap = inside - before[:, None]
        slopes = fixed(self.slopes)
        change = jnp.zeros_like(inside)
        for j in range(points):
            change = change + slopes[:, j, None] * gap[:, j, None]
        return (-self.elements * change).reshape(u.shape)

    def mean(self, u: Float[Array, "n ..."]) -> Array:
        """The mean over the volume."""
        return jnp.tensordot(fixed(self.weights), u, 1)


def radau(points: int) -> tuple[Float[np.ndarray, " s"], Float[np.ndarray, "s s"]]:
    """The points of Radau IIA between 0 and 1, of which the last is 1; and the integrals, from 0 to
    each point, of the polynomials that are 1 at one point and 0 at the others. The last row has the
    weights of the points."""
    legendre = np.zeros(points + 1)
    legendre[-2:] = -1.0, 1.0
    nodes = (np.sort(np.polynomial.legendre.legroots(legendre).real) + 1) / 2
    nodes[-1] = 1.0
    power = np.arange(points)
    integrals = nodes[:, None] ** (power + 1) / (power + 1)
    return nodes, integrals @ np.linalg.inv(nodes[:, None] ** power)
