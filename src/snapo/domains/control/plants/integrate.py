"""One explicit step of a differential equation."""

from collections.abc import Callable, Mapping

from jaxtyping import Array

StateVector = Mapping[str, Array]


def runge_kutta(
    slopes: Callable[[StateVector], StateVector], state: StateVector, dt
) -> dict[str, Array]:
    """The state after `dt`, by the classical method of order 4."""

    def ahead(by: StateVector, share) -> dict[str, Array]:
        return {name: state[name] + share * dt * by[name] for name in by}

    first = slopes(state)
    second = slopes(ahead(first, 0.5))
    third = slopes(ahead(second, 0.5))
    fourth = slopes(ahead(third, 1.0))
    mean = {n: (first[n] + 2 * second[n] + 2 * third[n] + fourth[n]) / 6 for n in first}
    return ahead(mean, 1.0)
