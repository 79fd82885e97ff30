"""Solubility of a pure crystal in a solvent by NRTL (Renon and Prausnitz 1968).

Solid and liquid are in equilibrium where ln(x gamma) = -dH_m / R (1/T - 1/T_m) + dcp / R (T_m / T -
1 - ln(T_m / T)), x being the solute's share by mole. With solvents 1 and 2 and the solute 0,

    ln gamma_0 = sum_j tau_j0 G_j0 x_j / S_0
        + sum_j x_j G_0j / S_j (tau_0j - sum_m x_m tau_mj G_mj / S_j),

S_j = sum_k G_kj x_k, tau_ij = a_ij + b_ij / T, G_ij = exp(-alpha_ij tau_ij). x is found by
bisection of ln x, and its derivatives by two steps more with the slope held, as a loop's are.
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float
from pydantic import Field

from snapo.case.given import CaseInput
from snapo.case.table import CaseTable

from ...flowsheet.network import GAS_CONSTANT
from ...given import fixed, use
from ...read.fields import TextKey, Texts, quantity
from ...read.numbers import POSITIVE, SHARE, case_input, listed
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


class NrtlTable(CaseTable):
    """`[units.NAME.solubility.nrtl]`"""

    solute: TextKey | None = Field(
        None, description='a name that chemicals knows, as "paracetamol"'
    )
    molar_mass: Any = quantity('"151.16 g/mol"', None, meaning="molar mass of the solute")
    melting: Any = quantity('"443.6 K"', None, meaning="melting point of the crystals")
    fusion: Any = quantity('"27.1 kJ/mol"', None, meaning="enthalpy of fusion")
    heat_capacity_change: Any = quantity(
        '"0 J/mol/K"', "0 J/mol/K", meaning="heat capacity of the melt less that of the crystals"
    )
    solvents: Texts = Field(description='names of the solvents, such as ["ethanol", "water"]')
    solvent_masses: Any = Field(None, description='their molar masses, such as ["46.07 g/mol"]')
    composition: Any = Field(None, description="their shares by mole, such as [0.8, 0.2]")
    density: Any = quantity('"789 kg/m^3"', meaning="solvent per volume of solution")
    a: list[list[float]] | None = Field(
        None, description="numbers a_ij of tau, rows i, the solute first"
    )
    b: list[list[float]] = Field(description="numbers b_ij of tau in K, rows i, the solute first")
    alpha: list[list[float]] = Field(description="non-randomness, rows i, the solute first")


@dataclass(frozen=True, eq=False)
class Mixture:
    """A solute, number 0, in n - 1 solvents.

    - `melting`: K; `fusion`: J/mol; `capacity`: J/mol/K; `density`: kg of solvent per m3 of
      solution; each index []. `a` and `alpha`: "1", `b`: K; index [n (n - 1)], off the diagonals
      row by row. `liquid`: [n - 1] shares by mole; `ratio`: molar mass of the solute over theirs.
    """

    melting: CaseInput
    fusion: CaseInput
    capacity: CaseInput
    density: CaseInput
    a: CaseInput
    b: CaseInput
    alpha: CaseInput
    liquid: np.ndarray
    ratio: float


def read_mixture(read: Reader) -> Mixture:
    """Constants that are not given are those of `chemicals` by name."""
    table, count = read.table, len(read.table.solvents) + 1
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

    def parameter(key: str, unit: str, which: str) -> CaseInput:
        if getattr(table, key) is not None:
            return read.number(key, unit, POSITIVE)
        if table.solute is None:
            raise read.section.error(key, None, "without the name of a solute this key is needed")
        value = np.array([constant(read, "solute", table.solute, which)])
        return case_input(f"{read.name}.{key}", value, ("",), unit, np.array(0), read.meaning(key))

    solute = parameter("molar_mass", "kg/kmol", "MW")
    names = ["solute", *table.solvents]
    labels = [f"{names[i]}-{names[j]}" for i, j in zip(*_apart(count))]

    def matrix(key: str, unit: str) -> CaseInput:
        raw = getattr(table, key)
        rows = np.zeros((count, count)) if raw is None else raw
        if len(rows) != count or any(len(row) != count for row in rows):
            raise read.section.error(key, raw, f"allowed are {count} rows of {count} numbers")
        values = np.array(rows, float)[_apart(count)]
        return case_input(f"{read.name}.{key}", values, labels, unit, meaning=f"{key} of NRTL")

    return Mixture(
        melting=parameter("melting", "K", "Tm"),
        fusion=parameter("fusion", "J/mol", "Hfus"),
        capacity=read.number("heat_capacity_change", "J/mol/K"),
        density=read.number("density", "kg/m3", POSITIVE),
        a=matrix("a", "1"),
        b=matrix("b", "K"),
        alpha=matrix("alpha", "1"),
        liquid=liquid,
        ratio=float(solute.used()) / float(liquid @ masses),
    )


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
