"""Models of the short rate: Gaussian factors that are fitted exactly to the initial curve.

r = phi(t) + sum of F factors, dx_i = -a_i x_i dt + s_i(t) (dW_i + lambda_i dt), x_i(0) = 0. lambda
is used under "P" only; a negative lambda is a positive premium of long bonds. A model is a
subclass, here or in a separate file of this folder, that names its factors; a case uses these names
for correlations.
"""

from collections.abc import Sequence
from typing import ClassVar, Self, TypeVar

from snapo.case.given import CaseInput
from snapo.case.table import CaseTable
from snapo.problem.record import TreeRecord

from ...quantities import on_steps, side_by_side
from ...read.cells import TableReader, TimeGrid


class ShortRate(TreeRecord):
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
        """The labels of the factors in a table of sensitivities; a single factor needs none."""
        return cls.factors if len(cls.factors) > 1 else ("",)

    @classmethod
    def read(cls, section: TableReader, table: CaseTable, grid: TimeGrid) -> Self:
        """The numbers of `[rates]`: lists have one number per factor; volatilities may change over
        time."""

        def of_factors(key: str) -> CaseInput:
            parts = [on_steps(x, grid) if key == "volatility" else x for x in part_of(key)]
            return side_by_side(f"rate_{key}", parts, cls.labels())

        def part_of(key: str) -> Sequence[CaseInput]:
            parts, count = getattr(table, key), cls.count()
            if [part.written for part in parts] == [0.0]:  # one 0 for all factors
                return parts * count
            if len(parts) != count:
                stated = [part.written for part in parts]
                message = f'kind "{cls.kind}" needs one number for each factor: {count}'
                raise section.error(key, stated[0] if len(stated) == 1 else stated, message)
            return parts

        volatility, reversion = of_factors("volatility"), of_factors("mean_reversion")
        price = section.input(table, "price_of_risk", of_factors("price_of_risk"))
        return cls(reversion, volatility, price)


MODELS: dict[str, type[ShortRate]] = {}
AnyModel = TypeVar("AnyModel", bound=type[ShortRate])


def register(model: AnyModel) -> AnyModel:
    """Registers a model by its keyword; an incomplete or a duplicate model is an error."""
    missing = [
        name for name in ("kind", "factors", "description") if not getattr(model, name, None)
    ]
    if missing:
        raise TypeError(f"{model.__name__}: a model of the short rate needs {', '.join(missing)}.")
    if model.kind in MODELS:
        raise TypeError(f"{model.__name__}: there is a model {model.kind!r} already.")
    MODELS[model.kind] = model
    return model


@register
class G2(ShortRate):
    """Two correlated factors (D. Brigo, F. Mercurio, Interest Rate Models, section 4.2)."""

    kind: ClassVar[str] = "g2++"
    factors: ClassVar[tuple[str, ...]] = ("rate", "rate 2")
    description: ClassVar[str] = "G2++, two factors"


@register
class HullWhite(ShortRate):
    """One factor: Vasicek's model with a drift that fits the curve (RFS 3, 1990)."""

    kind: ClassVar[str] = "hull-white"
    factors: ClassVar[tuple[str, ...]] = ("rate",)
    description: ClassVar[str] = "Hull-White, one factor"
