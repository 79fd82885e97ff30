"""What a case says, as plain data: model and equations, parameters, limits, assumptions."""

from typing import Any

from .design_space import owners
from .draws import Entry, entries, nominal
from .inputs import every_given, pharma_inputs
from .records import Distribution, Network, PharmaCase
from .records_units import (
    Crystalliser,
    Dissolution,
    Dryer,
    Filter,
    Reactor,
    Splitter,
    Tank,
    TrayDryer,
    Unit,
)
from .sensitivities import entry_name

ASSUMPTIONS = (
    "Concentrations refer to the volume of the stream, which mixing, reaction and crystallisation "
    "leave as it is.",
    "Crystals are pure; impurities come with the liquor that the cake keeps.",
    "A stream holds one population of crystals, of one density and shape.",
    "Units are ideally mixed and hold their temperature profile, unless a heat balance is theirs.",
    "Wash liquid is clean solvent and replaces liquor one to one.",
)
SCOPE = (
    "This report supports decisions. The software is not validated in the sense of GMP, and the "
    "model has not been compared with data of this process unless an estimation below says so."
)


def statement(case: PharmaCase) -> dict[str, Any]:
    """Everything that is known before a number is computed."""
    return {
        "purpose": case.purpose,
        "scope": SCOPE,
        "assumptions": [*ASSUMPTIONS, *case.assumptions],
        "reactions": [_reaction(case.network, i) for i in range(len(case.network.reactions))],
        "units": [
            {"name": unit.name, "type": _kind(unit), "equations": equations(unit)}
            for unit in case.units
        ],
        "connections": [
            {"from": f"{c.source}.{c.outlet}".rstrip("."), "to": f"{c.target}.{c.inlet}"}
            for c in case.connections
        ],
        "attributes": [
            {
                "name": each.name, "measure": each.measure, "unit": each.unit, "low": each.low,
                "high": each.high, "citation": each.citation, "margin": each.margin,
            }
            for each in case.attributes
        ],
        "parameters": _parameters(case),
        "uncertainty": _uncertainty(case),
        "numbers": _numbers(case),
        "numerics": {
            "method": case.numerics.method, "steps": case.numerics.steps,
            "tolerance": case.numerics.tolerance,
        },
    }  # fmt: skip


def _parameters(case: PharmaCase) -> list[dict[str, Any]]:
    rows = []
    for each in case.parameters:
        here = nominal(case, [(each.input, each.entry)])[0]
        rows.append(
            {
                "name": each.name,
                "of": entry_name(case, each.input, each.entry),
                "unit": each.unit,
                "nominal": owners(each, here),
                "range": [owners(each, each.low), owners(each, each.high)],
                "normal": [owners(each, each.normal_low), owners(each, each.normal_high)],
                "distribution": _words(each.distribution, each.scale, each.unit),
                "control": each.control,
                "source": each.source,
            }
        )
    return rows


def _uncertainty(case: PharmaCase) -> list[dict[str, Any]]:
    units = {each.name: each.unit for each in every_given((case.network, case.feeds, case.units))}
    values = nominal(case, entries(case))
    return [
        {
            "of": entry_name(case, *entry),
            "nominal": value,
            "unit": units[entry[0]],
            "distribution": _words(kind, 1.0, units[entry[0]]),
            "when": when,
        }
        for entry, value, kind, when in zip(
            entries(case), values, case.uncertainty.distributions, case.uncertainty.when
        )
    ]


def _words(kind: Distribution | None, scale: float, unit: str) -> str:
    """ "normal, 0.3 K"; a pure number is a percentage."""
    if kind is None:
        return "held"
    if kind.kind == "lognormal":
        return f"lognormal, {100 * kind.spread:g} %"
    spread = f"{kind.spread / scale:.4g}" + ("" if unit == "1" else f" {unit}")
    return f"uniform, ± {spread}" if kind.kind == "uniform" else f"normal, {spread}"


def _numbers(case: PharmaCase) -> list[dict[str, Any]]:
    """Every number of the model, as it enters the computation."""
    chosen: dict[Entry, str] = {(each.input, each.entry): each.name for each in case.parameters}
    return [
        {
            "input": name, "label": label, "value": value, "unit": entry.unit,
            "parameter": chosen.get((name, i), ""),
        }
        for name, entry in pharma_inputs(case).items()
        for i, (label, value) in enumerate(zip(entry.labels, entry.value.ravel().tolist()))
    ]  # fmt: skip


def _reaction(network: Network, i: int) -> dict[str, Any]:
    sides: list[list[str]] = [[], []]
    for name, amount in zip(network.species, network.stoichiometry[i]):
        if amount:
            count = "" if abs(amount) == 1 else f"{abs(amount):g} "
            sides[int(amount > 0)].append(f"{count}{name}")
    orders = [
        f"c_{name}" + ("" if order == 1 else f"^{order:g}")
        for name, order in zip(network.species, network.order[i])
        if order
    ]
    return {
        "name": network.reactions[i],
        "equation": f"{' + '.join(sides[0])} → {' + '.join(sides[1])}",
        "rate": " ".join(["k", *orders]),
        "prefactor": float(network.prefactor.values[i]),
        "prefactor_unit": network.prefactor.unit,
        "activation": float(network.activation.values[i]),
        "heat": float(network.heat.values[i]),
        "reference": network.reference,
    }


def equations(unit: Unit) -> list[str]:
    """The unit's model, one equation a line."""
    match unit:
        case Reactor():
            return _reactor(unit)
        case Crystalliser():
            return [
                "S = (c − c*)/c*, S₊ its rounded positive part",
                "growth G = g S₊^a − d S₋^b; nucleation B = B₁ S₊^p + B₂ S₊^q (kᵥ μ₃)^r",
                _sizes(unit),
                f"solubility c*: {unit.solubility.kind} in temperature",
            ]
        case Filter():
            wash = "exp(−η W)" if unit.wash == "exponential" else "Lapidus–Amundson in W and Pe"
            return [
                "t = (μ/Δp) (α cₛ/2 (V_f/A)² + R_m V_f/A)",
                "α = 180 (1 − ε)/(ε³ d₃₂² ρₛ)" if unit.resistance is None else "α as given",
                f"liquor kept h = s ε/((1 − ε) ρₛ) per kg; share of a solute that stays: {wash}",
            ]
        case Dryer():
            return ["X' = −k X, k = k₀ exp(−E/R (1/T − 1/T₀)) (d₀/d₃₂)"]
        case TrayDryer():
            return [
                "X' = −w, w = k a max(f p_v(T) − p, 0), a = 6/(ρₛ d₃₂)",
                "f = r (1 + r⁸)^(−1/8), r = X/X_c: 1 where wet, X/X_c below critical moisture",
                "(cₛ + X c_l) m T' = U A (T_shelf − T) − m w λ; log₁₀ p_v = A − B/(C + T)",
            ]
        case Dissolution():
            return ["dissolved share 1 − (1 − D Cₛ t/(ρₛ h r))³, r = d₃₂/2, 1 once dissolved"]
        case Tank():
            return ["amounts and moments add up; temperature by volume"]
        case Splitter():
            return ["every amount divides in the same shares"]


def _kind(unit: Unit) -> str:
    return "tray dryer" if isinstance(unit, TrayDryer) else type(unit).__name__.lower()


def _sizes(unit: Crystalliser) -> str:
    if unit.edges is None:
        return "μ₀' = B, μₖ' = k G μₖ₋₁ + B L₀^k, k = 1 … 5; solute by difference of μ₃"
    low, high = 1e6 * unit.edges[[0, -1]]
    return (
        f"n_t + (G n)_L = 0, B at the smallest size; {len(unit.edges) - 1} cells from {low:.4g} to "
        f"{high:.4g} µm, limited slopes (van Albada); solute by difference of the cells' μ₃"
    )


def _reactor(unit: Reactor) -> list[str]:
    flows = {
        "batch": "c' = νᵀ r",
        "semi-batch": "n' = V νᵀ r + q c_dose, V' = q",
        "stirred": "c' = νᵀ r + (c_in − c) q/V",
        "plug-flow": f"c_j' = νᵀ r + (c_(j−1) − c_j) q/V_cell, {unit.cells} cells",
    }
    heat = "ρcₚV T' = −Σ Hᵢ rᵢ V − UA (T − T_jacket)" if unit.jacket else "temperature as given"
    return [flows[unit.kind], "rᵢ = kᵢ exp(−Eᵢ/(R T)) Π c^order, R = 8.314 J/mol/K", heat]
