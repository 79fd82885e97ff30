"""Commodities."""

from dataclasses import dataclass
from typing import ClassVar

from .asset_class import register
from .priced import Priced


@register
@dataclass(frozen=True)
class Commodity(Priced):
    """Commodities, lognormal with a separate shock."""

    kind: ClassVar[str] = "commodity"
    description: ClassVar[str] = "commodities; lognormal with a separate shock"
    risk: ClassVar[str] = "commodity"
