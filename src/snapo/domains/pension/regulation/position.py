"""The regulatory position of a fund: required own funds, policy ratio, and recovery.

Required own funds follow the standard model: S1 rates, S2 shares and property, S3 currencies, S4
commodities, S5 credit, S6 insurance, S10 active management; S7 to S9 are zero by law. Annex 3 of
the Regeling Pensioenwet, article 2.
"""

from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from snapo.problem.record.either import with_numpy

from ..market.assets.asset_class import by_kind, ratios
from ..market.assets.swaps import swap_gains
from ..market.bonds.payments import curve_prices
from ..records.case import PensionCase
from ..records.regulation import MARKETS, Regulation, Rules
from .bases import Due, due


@dataclass(frozen=True)
class Losses:
    """Losses of own funds by risk, in money; `falling`: whether falling rates are the worse
    case."""

    rates: float
    equity: float
    currencies: float
    commodities: float
    credit: float
    insurance: float
    active: float
    falling: bool


def total(rules: Rules, losses: Losses) -> float:
    """The required own funds: the square root of the sum of squared losses and of their products,
    weighted by correlations."""
    available = rules.correlations
    falling = 1.0 if losses.falling else 0.0
    s1, s2, s5 = losses.rates, losses.equity, losses.credit
    squares = sum(item**2 for item in astuple(losses)[:7])
    crossed = falling * (available["rates_equity"] * s1 * s2 + available["rates_credit"] * s1 * s5)
    return float(np.sqrt(squares + 2 * (crossed + available["equity_credit"] * s2 * s5)))


def correlated(parts: Sequence[float], correlation: float) -> float:
    """The square root of the sum of the squares of `parts` and of their products, which all have
    the same correlation."""
    values = np.asarray(parts, float)
    squares = float(np.sum(values**2))
    return float(np.sqrt(squares + correlation * (values.sum() ** 2 - squares)))


def equity_loss(rules: Rules, held: dict[str, float]) -> float:
    """S2 for the market values {group: money} of shares and property; a group that is sold short
    has no loss, and its gain offsets no other loss."""
    names = ("developed", "emerging", "unlisted", "unlisted-property")
    parts = [rules.falls[name] * max(held.get(name, 0.0), 0.0) for name in names]
    return correlated(parts, rules.correlations["equity"])


def currency_loss(rules: Rules, exposed: Sequence[float], emerging: Sequence[bool]) -> float:
    """S3 for unhedged exposures, in money, each to a different currency."""
    sides = []
    for market, late in zip(MARKETS, (False, True)):
        local = [item for item, is_late in zip(exposed, emerging) if is_late == late]
        within = rules.correlations[f"currencies_{market}"]
        sides.append(rules.currencies[market] * correlated(local, within))
    return correlated(sides, rules.correlations["currencies"])


def shifted_discount(
    rules: Rules, factors: str, years: np.ndarray, discount: np.ndarray
) -> np.ndarray:
    """Discount factors after all annual zero rates were multiplied by the factors of the rules that
    have the name `factors`."""
    due = np.where(years > 0, years, 1.0)
    rate = discount ** (-1 / due) - 1
    factor = np.interp(years, rules.term, rules.factors[factors])
    return np.where(years > 0, (1 + rate * factor) ** -due, discount)


ROUNDS = 200  # of the standard model on the assets that its last result asks for
CLOSE = 1e-12  # of the liability


@dataclass(frozen=True)
class Stand:
    """The `losses` on the required assets; the `required` and `minimum` own funds, in money; the
    ratios `required_ratio`, `minimum_ratio` and `policy_ratio` to the liability; the date and the
    source of the rules."""

    losses: Losses
    required: float
    minimum: float
    required_ratio: float
    minimum_ratio: float
    policy_ratio: float
    since: str
    source: str


@dataclass(frozen=True)
class RecoveryCourse:
    """For each year up to the end of the recovery period or of the horizon: the `share` of paths
    whose policy ratio is at least today's required ratio, and the `median` of the policy ratio;
    `allowed`: the years that a recovery plan may take."""

    years: tuple[int, ...] = ()
    share: tuple[float | None, ...] = ()
    median: tuple[float | None, ...] = ()
    allowed: float = 0.0


class Shocked(NamedTuple):
    """Changes under one move of rates: of the liability, money, and of each class and swap per unit
    held, [n] and [b]."""

    liability: float
    classes: np.ndarray
    swaps: np.ndarray


def stand(case: PensionCase, inputs: dict[str, Any]) -> Stand:
    """The result of the standard model with the present mix. The invested assets are the liability
    plus the required funds, iterated until both agree (annex 3, article 2); swaps keep their share
    of the assets."""
    regulation, case = regulation_of(case), replace(case, scenarios=None)
    paid = due(case, inputs)
    moves = [shocked(case, inputs, paid, name) for name in ("rise", "fall")]
    liability, assets = float(paid.flow @ paid.discount), float(case.assets.amount.used())
    required = 0.0
    for _ in range(ROUNDS):
        losses = losses_on(case, moves, assets, liability)
        required, before = total(regulation.rules, losses), required
        assets = liability + required
        if abs(required - before) <= CLOSE * liability:
            break
    ratios = regulation.ratios or (float(case.assets.amount.used()) / liability,)
    minimum = regulation.rules.minimum * liability
    return Stand(
        losses=losses_on(case, moves, assets, liability),
        required=required,
        minimum=minimum,
        required_ratio=1 + required / liability,
        minimum_ratio=1 + regulation.rules.minimum,
        policy_ratio=float(np.mean(ratios)),
        since=regulation.rules.since,
        source=regulation.rules.source,
    )


def regulation_of(case: PensionCase) -> Regulation:
    """The regulation of a case that has one."""
    assert case.regulation is not None
    return case.regulation


def losses_on(case: PensionCase, moves: list[Shocked], assets: float, liability: float) -> Losses:
    """Losses by risk if all `assets` (money) are in the present mix."""
    regulation = regulation_of(case)
    rules, held = regulation.rules, assets * case.assets.weight.used()
    notional = np.zeros(0)
    if case.overlay is not None:
        notional = case.overlay.notional.used() * assets / float(case.assets.amount.used())
    rates = [
        move.liability - float(held @ move.classes) - float(notional @ move.swaps) for move in moves
    ]
    groups: dict[str, float] = {}
    for item, word in zip(held, case.assets.risk, strict=True):
        groups[word] = groups.get(word, 0.0) + float(item)
    return Losses(
        rates=max(*rates, 0.0),
        equity=equity_loss(rules, groups),
        currencies=currency_loss(rules, _unhedged(case, held), case.currencies.emerging),
        commodities=rules.falls["commodity"] * max(groups.get("commodity", 0.0), 0.0),
        credit=_credit(case, held),
        insurance=regulation.insurance_risk * liability,
        active=regulation.active_risk * assets,
        falling=rates[1] >= rates[0],
    )


def shocked(case: PensionCase, inputs: dict[str, Any], paid: Due, name: str) -> Shocked:
    """The changes of liability, classes and swaps after one move of rates, in which every payment
    has the factor of its term."""
    rules, after = regulation_of(case).rules, paid.discount
    if case.liability.basis != "fixed":
        after = shifted_discount(rules, name, paid.years, paid.discount)

    before = _prices(case, inputs)

    def shifted(steps: np.ndarray, linked: bool) -> np.ndarray:
        factors = f"real_{name}" if linked else name
        return shifted_discount(rules, factors, steps * case.step, before(steps, linked))

    classes = with_numpy(ratios)(case, before, shifted) - 1
    swaps = np.zeros(0)
    if case.overlay is not None:
        swaps = with_numpy(swap_gains)(case, before, shifted)
    return Shocked(float(paid.flow @ (after - paid.discount)), classes, swaps)


def _prices(case: PensionCase, inputs: dict[str, Any]) -> Callable[[np.ndarray, bool], np.ndarray]:
    """Today's prices of payments, in NumPy."""

    return with_numpy(curve_prices(case, inputs))


def _unhedged(case: PensionCase, held: np.ndarray) -> list[float]:
    """[X] net exposure to each currency, in money."""
    hedged = case.currencies.hedge_ratio
    share = 1 - (hedged.used() if hedged.values.size else np.zeros(len(case.currencies.names)))
    exposed = np.zeros(len(case.currencies.names))
    for item, one in zip(held, case.assets.classes):
        if one.currency >= 0:
            exposed[one.currency] += item * share[one.currency]
    return exposed.tolist()


def _credit(case: PensionCase, held: np.ndarray) -> float:
    """S5: bonds with a rating lose the rise of the spread of this rating, over the time until
    payment."""
    rules, lost, before = regulation_of(case).rules, 0.0, _prices(case, {})
    for kind, positions in by_kind(case):
        for position, rating in zip(positions, kind.ratings(case, positions)):
            if rating >= 0:
                rise = rules.spreads.get(case.credit.names[rating], rules.spreads["other"])

                def wider(steps: np.ndarray, linked: bool, rise=rise) -> np.ndarray:
                    return before(steps, linked) * np.exp(-rise * steps * case.step)

                left = with_numpy(kind.ratio)(case, [position], before, wider)
                lost += float(held[position]) * (1 - float(left[0]))
    return max(lost, 0.0)


def recovery(case: PensionCase, funding: np.ndarray, required_ratio: float) -> RecoveryCourse:
    """The recovery of the policy ratio.

    **Arguments:**

    - `funding`: [T + 1, N] funding ratios; months before time 0 are the regulation's `ratios`.
    """
    regulation, item = regulation_of(case), round(1 / case.step)
    months = max(1, round(regulation.rules.averaging_months * item / 12))
    before = np.array(regulation.ratios[-months:] or (funding[0, 0],))
    last = min(round(regulation.rules.recovery_years), (len(funding) - 1) // item)
    past = np.repeat(before[:, None], funding.shape[1], 1)
    # The newest of the last months is today's, at which the paths begin.
    complete = np.concatenate([past[:-1], funding])
    endpoints = (np.arange(last + 1) * item) + len(past) - 1
    policy = np.array([complete[max(end - months + 1, 0) : end + 1].mean(0) for end in endpoints])
    return RecoveryCourse(
        tuple(range(last + 1)),
        tuple((policy >= required_ratio).mean(1).tolist()),
        tuple(np.median(policy, 1).tolist()),
        regulation.rules.recovery_years,
    )
