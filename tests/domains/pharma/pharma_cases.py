"""Pharma cases as files, and processes with closed forms in place of a flowsheet."""

import copy
import tomllib
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

import snapo
from snapo.domains.pharma.case import resolve
from snapo.domains.pharma.flowsheet.case import PharmaCase
from snapo.domains.pharma.flowsheet.inputs import pharma_inputs

TEMPLATE = Path(snapo.__file__).parent / "domains" / "pharma" / "template" / "case.toml"


def template(**changes) -> PharmaCase:
    """The template, with tables of the file replaced or (a table for a table) changed."""
    data = tomllib.loads(TEMPLATE.read_text(encoding="utf-8"))
    for name, value in changes.items():
        known = data.get(name)
        data[name] = {**known, **value} if isinstance(known, dict) and value else value
    return resolve(TEMPLATE, copy.deepcopy({k: v for k, v in data.items() if v is not None}))


class Batch(NamedTuple):
    values: np.ndarray
    jacobian: np.ndarray | None
    ok: np.ndarray


class Polynomial:
    """Attributes a + b . x + x . C x of the moved entries x, about the case's nominal numbers.

    `slope` {(input, entry): [Q]}, `curve` the same for squares; it has the methods of a process
    that statistics need.
    """

    def __init__(self, case, constant, slope, curve=None):
        self.case, self.constant = case, np.asarray(constant, float)
        self.slope, self.curve = slope, curve or {}
        self.inputs = {k: np.array(v.value) for k, v in pharma_inputs(case).items()}
        self.calls = 0

    def batch(self, entries, draws, sensitivities=(), chunk=512):
        self.calls += len(draws)
        values = np.tile(self.constant, (len(draws), 1))
        for (name, entry), column in zip(entries, np.asarray(draws).T):
            x = (column - self.inputs[name][entry])[:, None]
            values = values + x * self.slope.get((name, entry), 0.0)
            values = values + x**2 * self.curve.get((name, entry), 0.0)
        return Batch(values, None, np.isfinite(values).all(1))


class FirstOrder:
    """One reaction c' = -k exp(-E / R / T) c, c(0) = 0.33: what a fit needs of a process."""

    def __init__(self, case):
        self.case = case
        self.inputs = {k: np.array(v.value) for k, v in pharma_inputs(case).items()}

    def shifted(self, changes, entries, inputs):
        found = dict(inputs)
        for i, (name, entry) in enumerate(entries):
            found[name] = jnp.asarray(found[name]).at[entry].set(changes[i])
        return found

    def observe(self, inputs, unit, states, times):
        k = inputs["kinetics.prefactor"][0]
        energy = inputs["kinetics.activation"][0]
        rate = k * jnp.exp(-energy / 8.314 / inputs["reactor.temperature"][0])
        return 0.33 * jnp.exp(-rate * 0.33 * jnp.asarray(times))
