"""G2++: two correlated factors (D. Brigo, F. Mercurio, Interest Rate Models, section 4.2)."""

from typing import ClassVar

from .short_rate import ShortRate, register


@register
class G2(ShortRate):
    """Two factors."""

    kind: ClassVar[str] = "g2++"
    factors: ClassVar[tuple[str, ...]] = ("rate", "rate 2")
    description: ClassVar[str] = "G2++, two factors"
