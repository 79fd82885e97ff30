"""What was made last, by what it was made from."""

from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

T = TypeVar("T")


class Recent(Generic[T]):
    """The results of the last few different calls; safe between threads.

    A page that moves a curve, or a table of sensitivities that moves one input after another, asks
    for the same ones again and again.
    """

    def __init__(self, maximum: int):
        self._most = maximum
        self._known: tuple[tuple[Hashable, T], ...] = ()

    def of(self, key: Hashable, make: Callable[[], T]) -> T:
        """The result for this key, made where it is not among the last."""
        others = tuple(item for item in self._known if item[0] != key)
        results = next((result for available, result in self._known if available == key), None)
        if results is None:
            results = make()
        self._known = ((key, results), *others)[: self._most]
        return results

    def clear(self) -> None:
        """Forgets all."""
        self._known = ()
