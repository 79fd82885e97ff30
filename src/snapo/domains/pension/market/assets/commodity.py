"""Commodities."""

from dataclasses import dataclass
from typing import ClassVar

from .asset_class import register
from .priced import Priced


@register
@dataclass(frozen=True)
class Commodity(Priced):
    """Commodities, lognormal with a shock of their own."""

    kind: ClassVar[str] = "commodity"
    description: ClassVar[str] = "commodities; lognormal with a shock of their own"
    risk: ClassVar[str] = "commodity"
