"""Action sets, and the maps into them from a network's unbounded numbers."""

from .discrete import Choice as Choice
from .discrete import Stop as Stop
from .product import Product as Product
from .product import contains as contains
from .sets import Actions as Actions
from .sets import Box as Box
from .sets import Integers as Integers
from .sets import Simplex as Simplex
from .sets import squashed as squashed
