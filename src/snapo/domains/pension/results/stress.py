"""The fund after each scenario of its file of shocks: which inputs and prices move, and how."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..market.zero_rates import from_zero_rates, zero_rates
from ..read.stress import CURVES, PRICE, Shock
from ..records.case import PensionCase
from ..records.inputs import every_given
from ..records.market import Curve


@dataclass(frozen=True)
class Stressed:
    """A case after one scenario: numbers of the inputs that moved, and by class the price ratio.

    `values`: {input: [n]}; `price`: [classes], without the losses of bonds to rates and spreads.
    """

    scenario: str
    values: dict[str, np.ndarray]
    price: np.ndarray


def scenarios(case: PensionCase, shocks: Sequence[Shock]) -> list[Stressed]:
    """The scenarios in the order of the file."""
    names = dict.fromkeys(shock.scenario for shock in shocks)
    return [_scenario(case, name, [s for s in shocks if s.scenario == name]) for name in names]


def _scenario(case: PensionCase, name: str, shocks: Sequence[Shock]) -> Stressed:
    given = {each.name: each for each in every_given(case)}
    values: dict[str, np.ndarray] = {}
    price = np.ones(len(case.assets.classes))
    for target, curve in zip(CURVES, (case.curve, case.inflation.break_even)):
        lines = [shock for shock in shocks if shock.target == target]
        if lines:
            values[curve.rate.name] = _moved(curve, lines)
    for shock in shocks:
        if shock.target == PRICE:
            for i, each in enumerate(case.assets.classes):
                if shock.label in ("", each.name, each.kind):
                    price[i] *= 1 + shock.size
        elif shock.target not in CURVES:
            known = given[shock.target]
            now = values.get(shock.target, known.values).copy()
            chosen = np.array([shock.label in ("", label) for label in known.labels])
            now[chosen] = shock.of(now[chosen])
            values[shock.target] = now
    return Stressed(name, values, price)


def _moved(curve: Curve, lines: Sequence[Shock]) -> np.ndarray:
    """The quotes of a curve whose zero rates the lines move."""
    zero = zero_rates(curve)
    for kind in ("multiply", "add"):
        own = [line for line in lines if line.kind == kind]
        for line in own:
            if not line.label:
                zero = line.of(zero)
        known = sorted((float(line.label), line.size) for line in own if line.label)
        if known:
            tenors, sizes = np.array(known).T
            zero = own[0].of(zero, np.interp(curve.tenor, tenors, sizes))
    return from_zero_rates(curve, zero)
