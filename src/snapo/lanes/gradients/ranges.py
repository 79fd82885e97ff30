"""Tiles of equal size, and the rest."""

from collections.abc import Callable

from ..emit.code import Code


def ranges(
    code: Code, size: int, tile: int, body: Callable[[str, int], None], apart: bool = False
) -> None:
    """Calls `body` for every tile, the last one `apart` from the loop where it is special."""
    complete, rest = divmod(size, tile)
    if apart and not rest and complete:
        complete, rest = complete - 1, tile
    if complete == 1:
        body("0", tile)
    elif complete:
        with code.loop(complete) as loop:
            body(code.index(f"mul nsw i64 {loop.i}, {tile}"), tile)
    if rest:
        body(str(size - rest), rest)
