"""A description of the case, which is written before any computation and read by all sections."""

from dataclasses import dataclass, field, fields
from typing import Any

from snapo.report.folder import RunFiles

from ..item.simulator import AVERAGES, OUTPUTS
from ..network.records import NetworkCase
from ..network.simulator import AVERAGES as NETWORK_AVERAGES
from ..network.simulator import OUTPUTS as NETWORK_OUTPUTS
from ..setup import AnyCase


@dataclass(frozen=True)
class CaseSummary:
    """The entries in the `about` of a run that the sections of its report read.

    - `item_unit`, `step`, `currency`: names of units, "piece", "week", "EUR"; `units`: the units of
      outputs.
    - `horizon`: the number of all periods; `warm_up`: the number of periods at the start that do
      not count.
    - `lead_time`: the lead time of an item; None for a `network`.
    - `other_leads`: whether other lead times are trained; `lost`: whether unmet demand is lost.
    """

    item_unit: str = ""
    step: str = "period"
    currency: str = ""
    units: dict[str, str] = field(default_factory=dict)
    horizon: int = 0
    warm_up: int = 0
    lead_time: int | None = None
    lost: bool = False
    network: bool = False
    other_leads: bool = True
    demand: str = ""
    objective: str = "the objective"

    @classmethod
    def of(cls, run: RunFiles) -> "CaseSummary":
        """The description in a run; a missing entry has its default."""
        entries = {entry.name: run.get(entry.name) for entry in fields(cls)}
        return cls(**{name: value for name, value in entries.items() if value is not None})

    @property
    def counted(self) -> int:
        """The number of periods that count, which excludes the warm-up."""
        return self.horizon - self.warm_up


def about(case: AnyCase) -> dict[str, Any]:
    """Title, units, periods, the objective as text; the lead time of an item."""
    per = f" of a {case.period}" if case.discount == 1 else ", discounted"
    unit = case.value_unit if case.objective.keeps_unit else ""
    entries = {
        "title": case.title,
        "unit": unit,
        "value_unit": unit,
        "units": units_of(case),
        "currency": case.currency,
        "item_unit": case.unit,
        "step": case.period,
        "horizon": case.horizon,
        "warm_up": case.warm_up,
        "objective": f"{case.objective.kind} of the result{per}; the result is minus the sum of "
        f"all costs",
        "objective_output": "result",
        "notes": list(case.notes),
        "other_leads": case.other_leads,
    }
    if isinstance(case, NetworkCase):
        sellers = [case.network.sites[i].name for i in case.network.sellers]
        demands = [f"{name}: {x.describe()}" for name, x in zip(sellers, case.demands)]
        return entries | {"network": True, "lost": case.network.lost, "demand": "; ".join(demands)}
    item = {
        "lead_time": case.item.lead_time,
        "lost": case.item.lost,
        "demand": case.demand.describe(),
        "names": _arrivals(case.item.lead_time - 1, case.period),
    }
    return entries | item


def _arrivals(count: int, period: str) -> dict[str, str]:
    """{number of the state: its name in a report} for the outstanding orders, by time of
    arrival."""
    keys = ["coming"] if count == 1 else [f"coming.{i}" for i in range(count)]
    return {
        key: f"Order that arrives in {i} {period}{'s' * (i > 1)}" for i, key in enumerate(keys, 1)
    }


def units_of(case: AnyCase) -> dict[str, str]:
    """The units of states, action and outputs."""
    states = dict.fromkeys(("stock", "coming", "action"), case.unit)
    outputs, averages = OUTPUTS, AVERAGES
    counts = ["orders", "cycles", "cycles_met"]
    if isinstance(case, NetworkCase):
        names = [site.name for site in case.network.sites]
        ways = (*NETWORK_AVERAGES, "sent", "received")
        averages = (*NETWORK_AVERAGES, *(f"{path}_{name}" for path in ways for name in names))
        outputs, counts = NETWORK_OUTPUTS, ["orders", *(f"orders_{name}" for name in names)]
        states.pop("stock")  # "stock" is an output of a network
    money = dict.fromkeys(outputs, case.value_unit)
    amounts = dict.fromkeys(averages, f"{case.unit}/{case.period}")
    return money | amounts | states | {"short": ""} | dict.fromkeys(counts, f"1/{case.period}")
