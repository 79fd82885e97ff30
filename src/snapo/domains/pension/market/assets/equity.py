"""Equity: listed and private shares, infrastructure."""

from dataclasses import dataclass
from typing import ClassVar

from .asset_class import register
from .priced import Priced


@register
@dataclass(frozen=True)
class Equity(Priced):
    """Shares, lognormal with a separate shock."""

    kind: ClassVar[str] = "equity"
    description: ClassVar[str] = (
        "shares, listed or private, and infrastructure; lognormal with a separate shock"
    )
    risk: ClassVar[str] = "developed"
