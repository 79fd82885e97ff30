"""Seed: the crystals with which a crystalliser starts."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from snapo.case.given import CaseInput
from snapo.case.table import doc
from snapo.problem.record.arrays import Array, Float, jax, jnp

from ...flowsheet.stream import MOMENTS
from ...given import fixed, use
from ...read.declared import CONCENTRATION, LENGTH, TableRecord, UnitQuantity
from ...read.numbers import POSITIVE, case_input, position, quantity
from ...read.reader import Reader
from .population import NUMBER, SIZE, cell_powers

ROUNDED = 0.01  # moments of crystals of one size, each rounded to three digits, miss 0 by less


@dataclass(frozen=True, eq=False)
class Seed(TableRecord):
    """Crystals at the start: `loading` with `size`, or `moments`, index [6], in m^k/m3 for k = 0 to
    5; the other is None. `size` is the mean by number of a lognormal distribution, and `spread` its
    standard deviation as a share of the mean; None if all crystals have one size.
    """

    loading: CaseInput | None = CONCENTRATION("seed per volume", None, example="0.02 kg/m^3")
    size: CaseInput | None = LENGTH("mean size of the seed, by number", None)
    moments: CaseInput | None = None
    spread: CaseInput | None = UnitQuantity(range=POSITIVE, example="0.3")(
        "standard deviation of the size of the seed, as a share of its mean", None
    )

    heading = "`[units.NAME.seed]`"
    more_keys: ClassVar = {
        "moments": (
            list[Any] | None,
            doc(
                "moments of the seed, instead of loading and size",
                None,
                "six quantities, m^k/m^3 for k = 0 to 5",
            ),
        )
    }

    @classmethod
    def read(cls, read):
        """A loading and a size, or six moments."""
        table = read.table
        if (table.moments is None) == (table.loading is None):
            message = "a seed needs either a loading and a size, or its six moments"
            raise read.section.error("moments", table.moments, message)
        if table.moments is None:
            if table.size is None:
                raise read.section.error("size", None, "a seed with a loading needs this key")
            return super().read(read)
        for key in ("size", "spread"):
            if getattr(table, key) is not None:
                message = "a seed with moments has no such key"
                raise read.section.error(key, read.raw[key], message)
        return cls(moments=_read_moments(read))


def seed_moments(seed: Seed, inputs: dict[str, Any], shape, density) -> Float[Array, " 6"]:
    """The moments of the seed in m^k/m3: as in the case, or for `loading` kg/m3 of crystals of
    mean `size`.

    Lognormal with standard deviation `spread` times the mean: mu_k = N size^k s^(k (k - 1) / 2),
    s = 1 + spread^2. Without spread all crystals have one size.
    """
    if seed.moments is not None:
        return use(inputs, seed.moments)
    assert seed.loading is not None and seed.size is not None
    size, wider = use(inputs, seed.size), jnp.ones(())
    if seed.spread is not None:
        wider = 1 + use(inputs, seed.spread) ** 2
    number = use(inputs, seed.loading) / (density * shape * size**3 * wider**3)
    return number * jnp.stack([size**k * wider ** (k * (k - 1) / 2) for k in range(MOMENTS)])


def seed_numbers(seed: Seed, inputs, shape, density, edges: np.ndarray) -> Float[Array, " N"]:
    """The number of crystals of a lognormal seed in each cell; together they have the mass of its
    loading. `size` is the mean by number, and `spread` the standard deviation as a share of the
    mean.
    """
    assert seed.loading is not None and seed.size is not None and seed.spread is not None
    variance = jnp.log1p(use(inputs, seed.spread) ** 2)
    median = jnp.log(use(inputs, seed.size) / SIZE) - variance / 2
    # The logarithm of an edge at 0 would be infinite, and its derivative undefined.
    share = jax.scipy.special.ndtr(
        (fixed(np.log(np.maximum(edges, 1e-9))) - median) / jnp.sqrt(variance)
    )
    numbers = jnp.diff(share)
    weight = density * shape * NUMBER * SIZE**3
    mass = weight * jnp.sum(fixed(cell_powers(edges)[3]) * numbers)
    return numbers * (use(inputs, seed.loading) / mass)


def _read_moments(read: Reader) -> CaseInput:
    """[6] moments that some distribution of sizes has."""
    table, units = read.table, ["1/m3", *(f"m^{k}/m3" for k in range(1, 6))]
    if len(table.moments) != 6:
        raise read.section.error("moments", table.moments, "it must be six moments, 0 to 5")
    values = [
        quantity(read.section, f"moments[{k}]", raw, unit, POSITIVE)
        for k, (raw, unit) in enumerate(zip(table.moments, units))
    ]
    if not _possible(np.array(values)):
        message = (
            "these moments are impossible: the mean square of a size is at least the square of "
            "its mean, mu0 mu2 >= mu1^2, and so on up to mu5"
        )
        raise read.section.error("moments", table.moments, message)
    labels = tuple(f"mu{k}" for k in range(6))
    where = tuple(position(read.section, f"moments[{k}]", unit) for k, unit in enumerate(units))
    return case_input(
        f"{read.name}.moments", np.array(values), labels, "m^k/m3", meaning="moment of the seed",
        positions=where,
    )  # fmt: skip


def _possible(moments: np.ndarray) -> bool:
    """Whether some distribution of sizes has them: the Hankel matrices of mu_0 to mu_4 and of mu_1
    to mu_5 have no eigenvalue below 0 (Stieltjes), scaled to a diagonal of 1."""
    k = np.arange(3)
    for first in (0, 1):
        matrix = moments[first + k[:, None] + k]
        size = np.sqrt(np.diag(matrix))
        if np.linalg.eigvalsh(matrix / np.outer(size, size)).min() < -ROUNDED:
            return False
    return True
