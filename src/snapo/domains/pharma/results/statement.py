"""The statement of a case, as plain data: model and equations, parameters, limits, assumptions."""

from typing import Any

from ..derivatives.sensitivities import entry_name
from ..flowsheet.case import PharmaCase
from ..flowsheet.inputs import pharma_inputs
from ..flowsheet.network import Network
from ..given import Entry, every_given
from ..quality.design_space import owners
from ..quality.draws import entries, nominal
from ..quality.records import Distribution

ASSUMPTIONS = (
    "Concentrations refer to the volume of the stream, which mixing, reaction and crystallisation "
    "leave as it is.",
    "Units are ideally mixed and hold their temperature profile, unless a heat balance is theirs.",
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
        "assumptions": [*ASSUMPTIONS, *_of_units(case), *case.assumptions],
        "symbols": _symbols(case),
        "reactions": [_reaction(case.network, i) for i in range(len(case.network.reactions))],
        "units": [
            {"name": unit.name, "type": unit.title, "equations": unit.equations()}
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


def _of_units(case: PharmaCase) -> list[str]:
    """The assumptions of all units, each once."""
    return list(dict.fromkeys(text for unit in case.units for text in unit.assumptions))


def _symbols(case: PharmaCase) -> str:
    """The meaning of the symbols of all equations, each once."""
    known = dict(pair for unit in case.units for pair in unit.symbols)
    return "; ".join(f"{symbol}: {words}" for symbol, words in known.items())


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
