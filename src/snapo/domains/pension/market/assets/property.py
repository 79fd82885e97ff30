"""Property: buildings and land, often appraised."""

from dataclasses import dataclass
from typing import ClassVar

from .asset_class import register
from .priced import Priced


@register
@dataclass(frozen=True)
class Property(Priced):
    """Property, lognormal with a separate shock."""

    kind: ClassVar[str] = "property"
    description: ClassVar[str] = (
        "buildings and land; lognormal with a separate shock, appraised values with a lag"
    )
    risk: ClassVar[str] = "unlisted-property"
