"""What was made last, by what it was made from."""

from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

T = TypeVar("T")


class Recent(Generic[T]):
    """The results of the last few different calls; safe between threads.

    A page that moves a curve, or a table of sensitivities that moves one input after another, asks
    for the same ones again and again.
    """

    def __init__(self, most: int):
        self._most = most
        self._known: tuple[tuple[Hashable, T], ...] = ()

    def of(self, key: Hashable, make: Callable[[], T]) -> T:
        """The result for this key, made where it is not among the last."""
        others = tuple(each for each in self._known if each[0] != key)
        found = next((result for known, result in self._known if known == key), None)
        if found is None:
            found = make()
        self._known = ((key, found), *others)[: self._most]
        return found

    def clear(self) -> None:
        """Forgets all."""
        self._known = ()
