"""Hedge funds and other alternatives."""

from dataclasses import dataclass
from typing import ClassVar

from .asset_class import register
from .priced import Priced


@register
@dataclass(frozen=True)
class HedgeFund(Priced):
    """A strategy without a market index, lognormal with a separate shock."""

    kind: ClassVar[str] = "hedge-fund"
    description: ClassVar[str] = (
        "hedge funds and other alternatives; lognormal with a separate shock"
    )
    risk: ClassVar[str] = "unlisted"
