"""Tiles of equal size, and the rest."""

from collections.abc import Callable

from ..emit.code import Code


def ranges(
    code: Code, size: int, tile: int, body: Callable[[str, int], None], apart: bool = False
) -> None:
    """Calls `body` for every tile, the last one `apart` from the loop where it is special."""
    whole, rest = divmod(size, tile)
    if apart and not rest and whole:
        whole, rest = whole - 1, tile
    if whole == 1:
        body("0", tile)
    elif whole:
        with code.loop(whole) as loop:
            body(code.index(f"mul nsw i64 {loop.i}, {tile}"), tile)
    if rest:
        body(str(size - rest), rest)
