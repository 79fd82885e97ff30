"""Random words from a counter.

Threefry-2x32 with 20 rounds: Salmon, Moraes, Dror and Shaw, "Parallel random numbers: as easy as
1, 2, 3" (SC 2011).
"""

from .emit.code import Code
from .emit.ref import Ref

ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))


def threefry(code: Code, key: tuple[Ref, Ref], counter: tuple[Ref, Ref]) -> tuple[Ref, Ref]:
    """Two random words per lane from a key and a counter of two words."""
    parity = code.constant(0x1BD11BDA, "uint32")
    keys = [key[0], key[1], code.op("xor", code.op("xor", key[0], key[1]), parity)]
    x, y = code.add(counter[0], keys[0]), code.add(counter[1], keys[1])
    for group in range(5):
        for turn in ROTATIONS[group % 2]:
            x = code.add(x, y)
            y = code.op("xor", _rotate(code, y, turn), x)
        x = code.add(x, keys[(group + 1) % 3])
        y = code.add(y, code.add(keys[(group + 2) % 3], code.constant(group + 1, "uint32")))
    return x, y


def _rotate(code: Code, x: Ref, turn: int) -> Ref:
    return code.call("llvm.fshl", x, x, code.constant(turn, x.dtype, x.lanes))
