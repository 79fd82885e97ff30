"""Hull-White: Vasicek's model with a drift that fits the curve (RFS 3, 1990)."""

from typing import ClassVar

from .short_rate import ShortRate, register


@register
class HullWhite(ShortRate):
    """One factor."""

    kind: ClassVar[str] = "hull-white"
    factors: ClassVar[tuple[str, ...]] = ("rate",)
    description: ClassVar[str] = "Hull-White, one factor"
