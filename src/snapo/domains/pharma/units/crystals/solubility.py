"""Solubility as a function of temperature and anti-solvent, or of a pure crystal in a solvent by
NRTL.

In the NRTL model (Renon and Prausnitz 1968) solid and liquid are in equilibrium where ln(x gamma) =
-dH_m / R (1/T - 1/T_m) + dcp / R (T_m / T - 1 - ln(T_m / T)), where x is the solute's share by
mole. With solvents 1 and 2 and the solute 0,

    ln gamma_0 = sum_j tau_j0 G_j0 x_j / S_0
        + sum_j x_j G_0j / S_j (tau_0j - sum_m x_m tau_mj G_mj / S_j),

S_j = sum_k G_kj x_k, tau_ij = a_ij + b_ij / T, G_ij = exp(-alpha_ij tau_ij). x is computed by
bisection of ln x, and its derivatives by two further steps with the slope held, as for a loop.
"""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from snapo.case.given import CaseInput, FilePosition, NoPosition
from snapo.case.quantity import quantity_of
from snapo.case.table import doc
from snapo.problem.record.arrays import Array, Float, jnp
from snapo.problem.record.either import derivative, over, scan, updated, with_numpy, xp
from snapo.problem.record.either import fixed as still

from ...flowsheet.network import GAS_CONSTANT
from ...given import fixed, use
from ...read.declared import (
    ABSOLUTE,
    CONCENTRATION,
    ENERGY,
    MOLAR_MASS,
    TableRecord,
    UnitQuantity,
    inner,
    values,
)
from ...read.numbers import (
    POSITIVE,
    SHARE,
    ZERO_CELSIUS,
    absent,
    case_input,
    listed,
    position,
    several,
    with_units,
)
from ...read.quantities import UnitError, conversion
from ...read.reader import Reader, TextKey, Texts

ROUNDS = 60  # of bisection: to round-off
MINIMUM = -60.0  # ln x below which nothing is searched


def activity(x: Float[Array, " n"], tau: Float[Array, "n n"], alpha) -> Float[Array, " n"]:
    """[n] ln gamma at shares by mole x; `tau` and `alpha` [n, n], alpha symmetric."""
    g = xp.exp(-alpha * tau)
    below = x @ g  # S_j
    first = (x @ (tau * g)) / below
    return first + (g / below * (tau - first)) @ x


def ideal(temperature, melting, fusion, capacity: Array | float = 0.0) -> Array:
    """ln of the activity of the pure crystal: `melting` K, `fusion` J/mol, `capacity` J/mol/K."""
    ratio = melting / temperature
    heat = fusion / GAS_CONSTANT * (1 / temperature - 1 / melting)
    return -heat + capacity / GAS_CONSTANT * (ratio - 1 - xp.log(ratio))


def share(requested, liquid: Float[Array, " n-1"], tau, alpha) -> Array:
    """x of the solute with ln(x gamma) = `wanted`; `liquid`: the solvents' shares without it."""

    def gap(u, target, liquid, tau, alpha):
        x = xp.exp(u)
        shares = xp.concatenate([x[None], (1 - x) * liquid])
        return u + activity(shares, tau, alpha)[0] - target

    constant_parts = tuple(map(still, (requested, liquid, tau, alpha)))

    def halved(endpoints, _):
        low, high = endpoints
        middle = (low + high) / 2
        above = gap(middle, *constant_parts) > 0
        return (xp.where(above, low, middle), xp.where(above, middle, high)), None

    start = xp.full_like(constant_parts[0], MINIMUM), xp.full_like(constant_parts[0], -1e-9)
    (low, high), _ = scan(halved, start, None, ROUNDS)
    u = still((low + high) / 2)
    slope = still(derivative(lambda v: gap(v, *constant_parts))(u))
    for _ in range(2):
        u = u - gap(u, requested, liquid, tau, alpha) / slope
    return xp.exp(u)


def _matrix(meaning: str, text: str, default: Any = ...) -> Any:
    return doc(meaning, default, f"{text}, rows i, the solute first")


@dataclass(frozen=True, eq=False, kw_only=True)
class Mixture(TableRecord):
    """A solute, number 0, in n - 1 solvents.

    - `density`: the density of solvent per volume of solution. `a` and `alpha` in "1", `b` in K:
      index [n (n - 1)], the entries off the diagonal row by row. `liquid`: [n - 1] shares of the
      solvents by mole; `ratio`: molar mass of the solute divided by that of the solvents.
    """

    melting: CaseInput = ABSOLUTE("melting point of the crystals", None, example="443.6 K")
    fusion: CaseInput = ENERGY("enthalpy of fusion", None, range=POSITIVE, example="27.1 kJ/mol")
    capacity: CaseInput = UnitQuantity("J/mol/K", example="0 J/mol/K")(
        "heat capacity of the melt minus that of the crystals",
        "0 J/mol/K",
        alias="heat_capacity_change",
    )
    density: CaseInput = CONCENTRATION("mass of solvent per volume", example="789 kg/m^3")
    a: CaseInput
    b: CaseInput
    alpha: CaseInput
    liquid: np.ndarray
    ratio: float

    heading = "`[units.NAME.solubility.nrtl]`"
    more_keys: ClassVar = {
        "solute": (
            str | None,
            doc(
                "solute, whose melting point and enthalpy of fusion are looked up",
                None,
                'a name that chemicals knows, such as "paracetamol"',
                min_length=1,
            ),
        ),
        "molar_mass": (CaseInput | None, MOLAR_MASS.field("molar mass of the solute", None)),
        "solvents": (
            Texts,
            doc("solvents", allowed='names of the solvents, such as ["ethanol", "water"]'),
        ),
        "solvent_masses": (
            Any,
            doc("molar masses of the solvents", None, 'quantities, such as ["46.07 g/mol"]'),
        ),
        "composition": (
            Any,
            doc("composition of the solvents", None, "their shares by mole, such as [0.8, 0.2]"),
        ),
        "a": (
            list[list[float]] | None,
            _matrix("constant part of NRTL's parameter tau", "numbers a_ij of tau", None),
        ),
        "b": (
            list[list[float]],
            _matrix("part of tau that falls with temperature, in K", "numbers b_ij of tau in K"),
        ),
        "alpha": (list[list[float]], _matrix("non-randomness alpha of NRTL", "non-randomness")),
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
                message = "this key is required if there is no `solute`"
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
                raise read.section.error(key, raw, f"it must be {count} rows of {count} numbers")
            numbers = np.array(rows, float)[apart]
            where: tuple[FilePosition, ...] = tuple(
                (*read.section.keys, key, int(i), int(j)) for i, j in zip(*apart)
            )
            if raw is None:
                where = (NoPosition(f"the case has no {key}, so it is 0"),) * len(numbers)
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
        message = f"it must be {count - 1} shares that add up to 1"
        raise read.section.error("composition", shares, message)
    if table.solvent_masses is None:
        masses = [constant(read, "solvents", solvent, "MW") for solvent in table.solvents]
    else:
        masses = listed(read.section, "solvent_masses", table.solvent_masses, "kg/kmol", POSITIVE)
    if len(masses) != count - 1:
        raise read.section.error("solvent_masses", table.solvent_masses, "one for each solvent")
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
    """The row and column numbers of all entries off the diagonal, row by row."""
    rows, columns = np.nonzero(~np.eye(count, dtype=bool))
    return rows, columns


def dissolved(record: Mixture, inputs: dict[str, Any], temperature) -> Array:
    """c* in kg/m3 at temperatures of any shape, x / (1 - x) times the solvent."""
    count, (rows, columns) = len(record.liquid) + 1, _apart(len(record.liquid) + 1)

    def square(item: CaseInput) -> Array:
        return updated(xp.zeros((count, count)), (rows, columns), use(inputs, item))

    a, b, alpha = square(record.a), square(record.b), square(record.alpha)
    numbers = (use(inputs, entry) for entry in (record.melting, record.fusion, record.capacity))
    melting, fusion, capacity = numbers
    liquid = fixed(record.liquid)

    def one(t):
        x = share(ideal(t, melting, fusion, capacity), liquid, a + b / t, alpha)
        return x / (1 - x) * record.ratio * use(inputs, record.density)

    warm = xp.asarray(temperature, float)
    return over(one)(warm.ravel()).reshape(warm.shape)


SolubilityKind = Literal["polynomial", "exponential", "van-t-hoff", "nrtl"]


@dataclass(frozen=True, eq=False)
class Solubility(TableRecord):
    """c*(T, w) in kg/m3.

    - "polynomial": sum_k a_k t^k; "exponential": exp(sum_k a_k t^k); t is T in K minus `zero`
      (273.15 for coefficients in Celsius). `coefficients`: a_k, index [n], labels "t^0", ….
    - "van-t-hoff": `value` exp(-`enthalpy` / R (1/T - 1/`reference`)).
    - "nrtl": the solubility in a `mixture` in equilibrium with the pure crystal.
    - `antisolvent`: (b1, b2), index [2] or [0]: b1 w + b2 w^2 is added to ln c*, where w is the
      mass fraction of anti-solvent in the liquid without solute.
    """

    kind: SolubilityKind
    coefficients: CaseInput
    zero: float
    antisolvent: CaseInput
    value: CaseInput | None = CONCENTRATION("solubility at the reference", None)
    enthalpy: CaseInput | None = ENERGY("enthalpy of dissolution", None, example="25 kJ/mol")
    reference: float | None = ABSOLUTE.number("temperature of the reference", None)
    mixture: Mixture | None = inner("NRTL model of the solution", Mixture, None, "nrtl")

    heading = "`[units.NAME.solubility]`"
    more_keys: ClassVar = {
        "kind": (SolubilityKind, doc("form of the solubility", "polynomial")),
        "coefficients": (
            list[float] | None,
            doc(
                "coefficients of the polynomial",
                None,
                "a list of numbers, of rising powers of the temperature",
                min_length=1,
            ),
        ),
        "unit": (TextKey, doc("unit of the solubility", "kg/m^3", 'a unit such as "kg/m^3"')),
        "scale": (Literal["K", "degC"], doc("temperature scale of the coefficients", "K")),
        "antisolvent": (
            list[float] | None,
            doc(
                "b1 and b2: b1 w + b2 w^2 is added to ln c* at the mass fraction w of anti-solvent",
                None,
                "two numbers",
                min_length=2,
                max_length=2,
            ),
        ),
    }

    @classmethod
    def read(cls, read):
        """The solubility with coefficients for kg/m3, from coefficients in the case's unit."""
        table = read.table
        read.only(("polynomial", "exponential"), ("coefficients",), needed=True)
        read.only(("van-t-hoff",), ("value", "enthalpy", "reference"), needed=True)
        read.only(("nrtl",), ("nrtl",), needed=True)
        coefficients = absent(read.name, "1")
        if table.coefficients is not None:
            coefficients = _read_coefficients(read)
        extra = absent(f"{read.name}.antisolvent", "1")
        if table.antisolvent is not None:
            extra = several(
                read.section, extra.name, "antisolvent", table.antisolvent, "1", ("w", "w^2")
            )
        zero = 0.0 if table.scale == "K" or table.coefficients is None else ZERO_CELSIUS
        return cls(table.kind, coefficients, zero, extra, **values(cls, read))


def _read_coefficients(read: Reader) -> CaseInput:
    table = read.table
    try:
        scale = conversion(table.unit, "kg/m3").scale
    except UnitError as error:
        raise read.section.error("unit", table.unit, str(error)) from None
    numbers = np.array(table.coefficients)
    if table.kind == "polynomial":
        numbers = numbers * scale
    else:  # the unit is a factor of the whole, which the logarithm adds
        numbers[0] += np.log(scale)
    units = {} if scale == 1 else {"unit": "kg/m^3"}
    where = with_units(read.section, "coefficients", len(numbers), units)
    unit = "kg/m3/K^k" if table.kind == "polynomial" else "1/K^k"
    labels = tuple(f"t^{k}" for k in range(len(numbers)))
    text = "coefficient of solubility"
    return case_input(read.name, numbers, labels, unit, meaning=text, positions=where)


def solubility(record: Solubility, inputs: dict[str, Any], temperature) -> Float[Array, "..."]:
    """c*(T) in kg/m3 without anti-solvent."""
    if record.kind == "van-t-hoff":
        assert record.value and record.enthalpy and record.reference
        inverse = 1 / jnp.asarray(temperature) - 1 / record.reference
        energy = use(inputs, record.enthalpy) / GAS_CONSTANT
        return use(inputs, record.value) * jnp.exp(-energy * inverse)
    if record.mixture is not None:
        return dissolved(record.mixture, inputs, temperature)
    t = jnp.asarray(temperature) - record.zero
    coefficients = use(inputs, record.coefficients)
    total = jnp.broadcast_to(coefficients[-1], jnp.shape(t))
    for k in range(coefficients.shape[0] - 2, -1, -1):
        total = total * t + coefficients[k]
    return jnp.exp(total) if record.kind == "exponential" else total


def nominal_solubility(record: Solubility, temperature: np.ndarray) -> np.ndarray:
    """c*(T) in kg/m3 from the case's coefficients, without anti-solvent."""
    if record.kind == "van-t-hoff":
        assert record.value and record.enthalpy and record.reference
        energy = record.enthalpy.used() / GAS_CONSTANT
        return record.value.used() * np.exp(-energy * (1 / temperature - 1 / record.reference))
    if record.mixture is not None:
        return with_numpy(dissolved)(record.mixture, {}, temperature)
    polyval = np.polyval(record.coefficients.values[::-1], temperature - record.zero)
    return np.exp(polyval) if record.kind == "exponential" else polyval


def antisolvent_factor(record: Solubility, inputs: dict[str, Any], other, solvent) -> Array:
    """exp(b1 w + b2 w^2) at the mass fraction w of the solute-free liquid, which is `other` kg of
    anti-solvent and `solvent` kg; 1 if the case has no b1 and b2."""
    if not record.antisolvent.index.size:
        return jnp.ones(())
    b1, b2 = use(inputs, record.antisolvent)
    total = other + solvent
    fraction = other / jnp.where(total > 0, total, 1.0)
    return jnp.exp(b1 * fraction + b2 * fraction**2)
