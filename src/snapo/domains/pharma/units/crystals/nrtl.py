"""Solubility of a pure crystal in a solvent by NRTL (Renon and Prausnitz 1968).

Solid and liquid are in equilibrium where ln(x gamma) = -dH_m / R (1/T - 1/T_m) + dcp / R (T_m / T -
1 - ln(T_m / T)), x being the solute's share by mole. With solvents 1 and 2 and the solute 0,

    ln gamma_0 = sum_j tau_j0 G_j0 x_j / S_0
        + sum_j x_j G_0j / S_j (tau_0j - sum_m x_m tau_mj G_mj / S_j),

S_j = sum_k G_kj x_k, tau_ij = a_ij + b_ij / T, G_ij = exp(-alpha_ij tau_ij). x is computed by
bisection of ln x, and its derivatives by two further steps with the slope held, as for a loop.
"""

from dataclasses import dataclass
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float
from pydantic import Field

from snapo.case.given import CaseInput, FilePosition, NoPosition
from snapo.case.quantity import quantity_of

from ...flowsheet.network import GAS_CONSTANT
from ...given import fixed, use
from ...read.declared import (
    ABSOLUTE,
    CONCENTRATION,
    ENERGY,
    MOLAR_MASS,
    TableRecord,
    UnitQuantity,
    values,
)
from ...read.fields import Texts
from ...read.numbers import POSITIVE, SHARE, case_input, listed, position
from ...read.reader import Reader

ROUNDS = 60  # of bisection: to round-off
MINIMUM = -60.0  # ln x below which nothing is searched


def activity(x: Float[Array, " n"], tau: Float[Array, "n n"], alpha) -> Float[Array, " n"]:
    """[n] ln gamma at shares by mole x; `tau` and `alpha` [n, n], alpha symmetric."""
    g = jnp.exp(-alpha * tau)
    below = x @ g  # S_j
    first = (x @ (tau * g)) / below
    return first + (g / below * (tau - first)) @ x


def ideal(temperature, melting, fusion, capacity: ArrayLike = 0.0) -> Array:
    """ln of the activity of the pure crystal: `melting` K, `fusion` J/mol, `capacity` J/mol/K."""
    ratio = melting / temperature
    heat = fusion / GAS_CONSTANT * (1 / temperature - 1 / melting)
    return -heat + capacity / GAS_CONSTANT * (ratio - 1 - jnp.log(ratio))


def share(requested, liquid: Float[Array, " n-1"], tau, alpha) -> Array:
    """x of the solute with ln(x gamma) = `wanted`; `liquid`: the solvents' shares without it."""

    def gap(u, target, liquid, tau, alpha):
        x = jnp.exp(u)
        shares = jnp.concatenate([x[None], (1 - x) * liquid])
        return u + activity(shares, tau, alpha)[0] - target

    still = jax.lax.stop_gradient
    fixed = still((requested, liquid, tau, alpha))

    def halved(endpoints, _):
        low, high = endpoints
        middle = (low + high) / 2
        above = gap(middle, *fixed) > 0
        return (jnp.where(above, low, middle), jnp.where(above, middle, high)), None

    start = jnp.full_like(fixed[0], MINIMUM), jnp.full_like(fixed[0], -1e-9)
    (low, high), _ = jax.lax.scan(halved, start, length=ROUNDS)
    u = still((low + high) / 2)
    slope = still(jax.grad(lambda v: gap(v, *fixed))(u))
    for _ in range(2):
        u = u - gap(u, requested, liquid, tau, alpha) / slope
    return jnp.exp(u)


def _matrix(text: str, default: Any = ...) -> Any:
    return Field(default, description=f"{text}, rows i, the solute first")


@dataclass(frozen=True, eq=False, kw_only=True)
class Mixture(TableRecord):
    """A solute, number 0, in n - 1 solvents.

    - `density`: of solvent per volume of solution. `a` and `alpha`: "1", `b`: K; index [n (n - 1)],
      off the diagonals row by row. `liquid`: [n - 1] shares by mole; `ratio`: molar mass of the
      solute over theirs.
    """

    melting: CaseInput = ABSOLUTE("melting point of the crystals", None, example="443.6 K")
    fusion: CaseInput = ENERGY("enthalpy of fusion", None, range=POSITIVE, example="27.1 kJ/mol")
    capacity: CaseInput = UnitQuantity("J/mol/K", example="0 J/mol/K")(
        "heat capacity of the melt less that of the crystals",
        "0 J/mol/K",
        alias="heat_capacity_change",
    )
    density: CaseInput = CONCENTRATION("solvent per volume of solution", example="789 kg/m^3")
    a: CaseInput
    b: CaseInput
    alpha: CaseInput
    liquid: np.ndarray
    ratio: float

    heading = "`[units.NAME.solubility.nrtl]`"
    more_keys: ClassVar = {
        "solute": (
            str | None,
            Field(None, min_length=1, description='a name that chemicals knows, as "paracetamol"'),
        ),
        "molar_mass": (CaseInput | None, MOLAR_MASS.field("molar mass of the solute", None)),
        "solvents": (
            Texts,
            Field(description='names of the solvents, such as ["ethanol", "water"]'),
        ),
        "solvent_masses": (
            Any,
            Field(None, description='their molar masses, such as ["46.07 g/mol"]'),
        ),
        "composition": (Any, Field(None, description="their shares by mole, such as [0.8, 0.2]")),
        "a": (list[list[float]] | None, _matrix("numbers a_ij of tau", None)),
        "b": (list[list[float]], _matrix("numbers b_ij of tau in K")),
        "alpha": (list[list[float]], _matrix("non-randomness")),
    }

    @classmethod
    def read(cls, read):
        """Missing constants are taken from `chemicals` by name."""
        table, count = read.table, len(read.table.solvents) + 1
        liquid, masses = _read_liquid(read, count)

        def parameter(key: str, unit: str, which: str) -> CaseInput:
            if getattr(table, key) is not None:
                return getattr(table, key)
            if table.solute is None:
                message = "without the name of a solute this key is needed"
                raise read.section.error(key, None, message)
            value = np.array([constant(read, "solute", table.solute, which)])
            quantity = quantity_of(cls.table.model_fields[key])
            text = quantity.meaning if quantity else ""
            where = (position(read.section, key, unit),)
            name = f"{read.name}.{key}"
            return case_input(name, value, ("",), unit, np.array(0), text, positions=where)

        solute = parameter("molar_mass", "kg/kmol", "MW")
        names = ["solute", *table.solvents]
        apart = _apart(count)
        labels = [f"{names[i]}-{names[j]}" for i, j in zip(*apart)]

        def matrix(key: str, unit: str) -> CaseInput:
            raw = getattr(table, key)
            rows = np.zeros((count, count)) if raw is None else raw
            if len(rows) != count or any(len(row) != count for row in rows):
                raise read.section.error(key, raw, f"allowed are {count} rows of {count} numbers")
            numbers = np.array(rows, float)[apart]
            where: tuple[FilePosition, ...] = tuple(
                (*read.section.keys, key, int(i), int(j)) for i, j in zip(*apart)
            )
            if raw is None:
                where = (NoPosition(f"the case has no {key}, which is then 0"),) * len(numbers)
            return case_input(
                f"{read.name}.{key}", numbers, labels, unit, meaning=f"{key} of NRTL",
                positions=where,
            )  # fmt: skip

        melting = parameter("melting", "K", "Tm"), parameter("fusion", "J/mol", "Hfus")
        numbers = values(cls, read) | dict(zip(("melting", "fusion"), melting))
        return cls(
            a=matrix("a", "1"), b=matrix("b", "K"), alpha=matrix("alpha", "1"), liquid=liquid,
            ratio=float(solute.used()) / float(liquid @ masses), **numbers,
        )  # fmt: skip


def _read_liquid(read: Reader, count: int) -> tuple[np.ndarray, list[float]]:
    """Shares by mole and molar masses of the solvents."""
    table = read.table
    shares = [1.0] if table.composition is None and count == 2 else table.composition
    if shares is None:
        raise read.section.error("composition", None, "several solvents need this key")
    liquid = np.array(listed(read.section, "composition", shares, "1", SHARE))
    if len(liquid) != count - 1 or abs(liquid.sum() - 1) > 1e-6:
        message = f"allowed are {count - 1} shares that add up to 1"
        raise read.section.error("composition", shares, message)
    if table.solvent_masses is None:
        masses = [constant(read, "solvents", solvent, "MW") for solvent in table.solvents]
    else:
        masses = listed(read.section, "solvent_masses", table.solvent_masses, "kg/kmol", POSITIVE)
    if len(masses) != count - 1:
        raise read.section.error("solvent_masses", table.solvent_masses, "one of each solvent")
    return liquid, masses


def constant(read: Reader, key: str, name: str, which: str) -> float:
    """A constant of a substance by name: "MW" in kg/kmol, "Tm" in K, "Hfus" in J/mol."""
    try:
        import chemicals
    except ImportError:
        message = "constants by name need the package chemicals: pip install 'snapo[chemicals]'"
        raise read.section.error(key, name, message) from None
    try:
        number = chemicals.CAS_from_any(name)
        result = getattr(chemicals, which)(number)
    except ValueError:
        result = None
    if result is None:
        raise read.section.error(key, name, f"chemicals has no {which} of this substance")
    return float(result)


def _apart(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns off the diagonal, row by row."""
    rows, columns = np.nonzero(~np.eye(count, dtype=bool))
    return rows, columns


def dissolved(record: Mixture, inputs: dict[str, Any], temperature) -> Array:
    """c* in kg/m3 at temperatures of any shape, x / (1 - x) times the solvent."""
    count, (rows, columns) = len(record.liquid) + 1, _apart(len(record.liquid) + 1)

    def square(item: CaseInput) -> Array:
        return jnp.zeros((count, count)).at[rows, columns].set(use(inputs, item))

    a, b, alpha = square(record.a), square(record.b), square(record.alpha)
    numbers = (use(inputs, entry) for entry in (record.melting, record.fusion, record.capacity))
    melting, fusion, capacity = numbers
    liquid = fixed(record.liquid)

    def one(t):
        x = share(ideal(t, melting, fusion, capacity), liquid, a + b / t, alpha)
        return x / (1 - x) * record.ratio * use(inputs, record.density)

    warm = jnp.asarray(temperature, float)
    return jax.vmap(one)(warm.ravel()).reshape(warm.shape)
