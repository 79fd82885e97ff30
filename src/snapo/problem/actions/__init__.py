"""Sets of actions: where a decision lies, and how a network's unbounded numbers get there."""

from .discrete import Choice as Choice
from .discrete import Stop as Stop
from .product import Product as Product
from .product import contains as contains
from .sets import Actions as Actions
from .sets import Box as Box
from .sets import Integers as Integers
from .sets import Simplex as Simplex
