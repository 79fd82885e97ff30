"""Funds of personal pots built by hand."""

from dataclasses import replace

import numpy as np
from tests.domains.pension import market_cases, people_cases
from tests.domains.pension.people_cases import members

from snapo.case.given import CaseInput
from snapo.domains.pension.market.assets.bond import Bond
from snapo.domains.pension.records.pots import PotRules, Pots

STEPS = 24
RULES = PotRules("2023-07-01", "by hand", 0.15, 0.1, 0.1)


def pots(case, protection, exposure, **changes):
    """Allocations by cohort [C], the same in all steps."""

    def by_cohort(name, values):
        index = np.broadcast_to(np.arange(len(values)), (case.steps, len(values)))
        return CaseInput(name, np.array(values, float), tuple(map(str, values)), "1", index)

    usual = {"reserve": 0.1, "fill_contribution": 0.1, "fill_return": 0.1, "release": 0.2}
    numbers = usual | {"largest": 0.15} | changes
    return Pots(
        RULES,
        **{k: market_cases.given(f"reserve_{k}", v) for k, v in numbers.items()},
        protection=by_cohort("pot_protection", protection),
        exposure=by_cohort("pot_exposure", exposure),
    )


def fund(steps=STEPS, step=1 / 12, people=None, rate=0.01, equity=0.2, timing="arrears", **changes):
    """Cohorts with stochastic rates, equity and a bond."""
    classes = [market_cases.CASH, market_cases.EQUITY, Bond("Bond", maturity=round(10 / step))]
    held = market_cases.assets(
        steps, classes, mean=[0.03], volatility=[equity], weight=[0.2, 0.5, 0.3], amount=8000.0,
        cost=[0.0, 0.001, 0.0005],
    )  # fmt: skip
    plan = market_cases.plan(
        timing, contribution=market_cases.no_contribution("fixed", rate=0.2),
        expenses=market_cases.given("expenses", 5.0),
    )  # fmt: skip
    people = members() if people is None else people
    fields = {
        "step": step, "cash_flows": None, "members": people, "mortality": people_cases.mortality(),
        "rates": market_cases.rates(steps, s=rate), "plan": plan,
        "observation": ("time", "funding_ratio", "rates", "weights"),
    }  # fmt: skip
    case = market_cases.case(steps, held_assets=held)
    case = replace(case, **fields)
    count = len(people.names)
    return replace(case, **({"pots": pots(case, [0.5] * count, [1.0] * count)} | changes))
