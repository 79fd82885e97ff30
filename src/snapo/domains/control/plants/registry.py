"""The list of plants."""

from .cart_pole import CartPole
from .double_integrator import DoubleIntegrator
from .linear import LinearQuadratic
from .mountain_car import MountainCar
from .pendulum import Pendulum
from .plant import Plant
from .quadrotor import Quadrotor
from .two_tanks import TwoTanks

PLANTS = (
    Pendulum,
    MountainCar,
    CartPole,
    DoubleIntegrator,
    LinearQuadratic,
    TwoTanks,
    Quadrotor,
)

SAID = ("type", "words", "parameters", "weights", "states", "actions", "steps")


def catalogue(plants: tuple[type[Plant], ...]) -> dict[str, type[Plant]]:
    """{type: class}.

    **Raises:** `TypeError` where a class is not complete, or two have the same type.
    """
    found: dict[str, type[Plant]] = {}
    for each in plants:
        missing = sorted(getattr(each, "__abstractmethods__", ()))
        missing += [name for name in SAID if not hasattr(each, name)]
        if missing:
            raise TypeError(f"The plant {each.__name__} lacks {', '.join(missing)}.")
        if each.type in found:
            raise TypeError(f'Two plants are of type "{each.type}".')
        found[each.type] = each
    return found


TYPES = catalogue(PLANTS)
