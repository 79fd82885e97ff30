"""Sets of actions: where a decision lies, and how a network's unbounded numbers get there."""

from .base import Actions as Actions
from .box import Box as Box
from .choice import Choice as Choice
from .integers import Integers as Integers
from .product import Product as Product
from .product import contains as contains
from .simplex import Simplex as Simplex
from .stop import Stop as Stop
