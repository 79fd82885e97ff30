"""A model of the short rate: Gaussian factors that are fitted exactly to the initial curve.

r = phi(t) + sum of F factors, dx_i = -a_i x_i dt + s_i(t) (dW_i + lambda_i dt), x_i(0) = 0; lambda
counts under "P" only, and a negative one is a positive premium of long bonds. A model is a
subclass in a file of its own in this folder that names its factors; the names are those under
which a case correlates them.
"""

from dataclasses import dataclass
from typing import ClassVar, Self, TypeVar

import numpy as np

from snapo.case.given import CaseInput
from snapo.case.table import CaseTable

from ...read.cells import TableReader, TimeGrid, listed, per_factor, side_by_side, stepwise
from ...records.said import number, quiet_volatility

MEAN_REVERSION = number(
    "mean reversion of a factor of the short rate; the curve is fitted again", "model", "1/year"
)
VOLATILITY = quiet_volatility("volatility of a factor of the short rate; the curve is fitted again")
PRICE_OF_RISK = number(
    "held while the curve moves; higher is a lower premium of long bonds",
    "premium",
    "1/sqrt(year)",
)


@dataclass(frozen=True, eq=False)
class ShortRate:
    """The numbers of a model with F factors.

    - `mean_reversion`: index [F], above zero. `volatility`: index [T, F], constant in a step.
    - `price_of_risk`: index [F], 1/sqrt(year).

    A model sets `kind`, the word in the table; `factors`, their names; and `description` for the
    report.
    """

    kind: ClassVar[str]
    factors: ClassVar[tuple[str, ...]]
    description: ClassVar[str]

    mean_reversion: CaseInput
    volatility: CaseInput
    price_of_risk: CaseInput

    @classmethod
    def count(cls) -> int:
        """The number F of factors."""
        return len(cls.factors)

    @classmethod
    def labels(cls) -> tuple[str, ...]:
        """Their labels in a table of sensitivities; a single one needs none."""
        return cls.factors if len(cls.factors) > 1 else ("",)

    @classmethod
    def read(cls, section: TableReader, table: CaseTable, grid: TimeGrid) -> Self:
        """The numbers of `[rates]`: lists have one per factor; volatilities may change in time."""
        labels = cls.labels()
        names = ("volatility", "mean_reversion", "price_of_risk")
        volatility, reversion, price = (per_factor(section, table, n, cls.count()) for n in names)
        moving = [stepwise(section, "volatility", item, grid) for item in volatility]
        return cls(
            mean_reversion=listed("rate_mean_reversion", reversion, labels, MEAN_REVERSION),
            volatility=side_by_side("rate_volatility", moving, labels, VOLATILITY),
            price_of_risk=section.input(
                table, "price_of_risk", listed("rate_price_of_risk", price, labels, PRICE_OF_RISK)
            ),
        )

    @classmethod
    def at_rest(cls, steps: int) -> Self:
        """Factors that stand still, for ready-made scenarios, which need no model."""
        labels, count = cls.labels(), cls.count()
        index = np.broadcast_to(np.arange(count), (steps, count))
        return cls(
            listed("rate_mean_reversion", [0.1] * count, labels, MEAN_REVERSION),
            VOLATILITY.input("rate_volatility", [0.0] * count, labels, index),
            listed("rate_price_of_risk", [0.0] * count, labels, PRICE_OF_RISK),
        )


MODELS: dict[str, type[ShortRate]] = {}
AnyModel = TypeVar("AnyModel", bound=type[ShortRate])


def register(model: AnyModel) -> AnyModel:
    """Makes a model known by its word; one that is incomplete or known already is an error."""
    missing = [
        name for name in ("kind", "factors", "description") if not getattr(model, name, None)
    ]
    if missing:
        raise TypeError(f"{model.__name__}: a model of the short rate needs {', '.join(missing)}.")
    if model.kind in MODELS:
        raise TypeError(f"{model.__name__}: there is a model {model.kind!r} already.")
    MODELS[model.kind] = model
    return model
