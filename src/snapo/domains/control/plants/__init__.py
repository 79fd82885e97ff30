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

MEMBERS = ("type", "description", "parameters", "weights", "states", "actions", "steps")


def catalogue(plants: tuple[type[Plant], ...]) -> dict[str, type[Plant]]:
    """{type: class}.

    **Raises:** `TypeError` if a class is not complete, or two classes have the same type.
    """
    table: dict[str, type[Plant]] = {}
    for plant in plants:
        missing = sorted(getattr(plant, "__abstractmethods__", ()))
        missing += [name for name in MEMBERS if not hasattr(plant, name)]
        if missing:
            raise TypeError(f"The plant {plant.__name__} has no {', '.join(missing)}.")
        if plant.type in table:
            raise TypeError(f'Two plants are of type "{plant.type}".')
        table[plant.type] = plant
    return table


TYPES = catalogue(PLANTS)
