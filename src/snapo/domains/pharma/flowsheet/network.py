"""Mass action: the reactions of a case, and their rates at a temperature and composition."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np

from snapo.case.given import CaseInput
from snapo.problem.record.arrays import Array, Float, jnp

from ..given import use

GAS_CONSTANT = 8.314  # J/mol/K, as the published kinetics use it
# kmol/m3 of a reactant of order 0: the reaction has its full rate above twenty of them (to the last
# digit), and stops at 0.
SPENT = 1e-6


@dataclass(frozen=True, eq=False)
class FlowNetwork:
    """Mass-action reactions: r_i = k_i exp(-E_i / (R T)) prod_s c_s^order_is, in kmol/m3/s.

    With a reference temperature the rate constant is k_i exp(-E_i / R (1/T - 1/T_ref)), so that k_i
    is the constant at T_ref. R = 8.314 J/mol/K, as the published kinetics use it. A reactant of
    order 0 can run out: the rate has the factor tanh(c / SPENT), or the smallest of these factors
    if there are several such reactants.

    - `species`, `reactions`: [S], [R] names. `molar_mass`: [S] kg/kmol (the same as g/mol).
    - `stoichiometry`: [R, S], negative if used; `molar_mass` times a row adds up to zero.
    - `order`: [R, S] exponents, not negative; by default those of the reactants.
    - `prefactor`: "kinetics.prefactor", index [R], labels are the reactions, (m3/kmol)^(n-1)/s
      with n the reaction's total order; `activation`: "kinetics.activation", [R], J/mol.
    - `heat`: "kinetics.heat", [R], J/mol of reaction extent, negative where heat is released.
    - `reference`: T_ref in K; None for plain Arrhenius.
    """

    species: tuple[str, ...]
    molar_mass: np.ndarray
    reactions: tuple[str, ...]
    stoichiometry: np.ndarray
    order: np.ndarray
    prefactor: CaseInput
    activation: CaseInput
    heat: CaseInput
    reference: float | None

    @property
    def runs_out(self) -> np.ndarray:
        """[R, S] True where a reaction uses a species on which its rate does not depend."""
        return (self.stoichiometry < 0) & (self.order == 0)


def rate_constants(
    network: FlowNetwork, inputs: dict[str, Any], temperature
) -> Float[Array, "... R"]:
    """k_i exp(-E_i / R (1/T - 1/T_ref)), in (m3/kmol)^(n-1)/s; 1/T_ref is 0 for plain Arrhenius."""
    inverse = 1 / jnp.asarray(temperature)[..., None]
    if network.reference is not None:
        inverse = inverse - 1 / network.reference
    energy = use(inputs, network.activation) / GAS_CONSTANT
    return use(inputs, network.prefactor) * jnp.exp(-energy * inverse)


def rates(network: FlowNetwork, constants: Array, concentration: Sequence[Array]) -> list[Array]:
    """[R] rates in kmol/m3/s from `constants` [..., R] and kmol/m3 of each species.

    The formula is written out reaction by reaction: species of order 0 appear only in the factor
    that stops the reaction, so 0^0 never occurs.
    """
    results = []
    for i in range(len(network.reactions)):
        rate = constants[..., i]
        for s, order in enumerate(network.order[i]):
            if order:
                rate = rate * _power(concentration[s], float(order))
        left = [
            jnp.tanh(concentration[s] / SPENT) for s in np.flatnonzero(network.runs_out[i]).tolist()
        ]
        if left:
            rate = rate * reduce(jnp.minimum, left)
        results.append(rate)
    return results


def fastest_rate(network: FlowNetwork, temperature: np.ndarray, maximum: np.ndarray) -> float:
    """1/s: a bound on the norm of d r / d extents below concentrations `maximum` [S] in kmol/m3, at
    these temperatures in K; infinite if an order lies between 0 and 1."""
    if ((network.order > 0) & (network.order < 1)).any():
        return np.inf
    inverse = 1 / temperature[:, None] - (1 / network.reference if network.reference else 0.0)
    energy = network.activation.used() / GAS_CONSTANT
    constants = (network.prefactor.used() * np.exp(-energy * inverse)).max(0)
    slope = np.zeros(network.order.shape)
    for i, order in enumerate(network.order):
        for s in np.flatnonzero(order):
            left = order - (np.arange(len(order)) == s)
            slope[i, s] = constants[i] * order[s] * np.prod(maximum**left)
        slope[i] += network.runs_out[i] * constants[i] * np.prod(maximum**order) / SPENT
    size = np.abs(slope) @ np.abs(network.stoichiometry).T
    return float(min(size.sum(0).max(), size.sum(1).max()))


def _power(c: Array, order: float) -> Array:
    """c^order; a fractional power of a number that is negative by round-off is 0."""
    if order.is_integer():
        return c ** int(order)
    present = c > 0
    return jnp.where(present, jnp.where(present, c, 1.0) ** order, 0.0)
