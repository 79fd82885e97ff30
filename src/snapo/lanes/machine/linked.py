"""Machine code as functions of this process."""

import ctypes
import itertools
import threading
from collections.abc import Mapping
from functools import cache
from typing import Any

from .llvm import binding
from .pipeline import PIPELINE


class Linked:
    """The functions of one piece of machine code. It keeps the memory of the code alive.

    `entries` are the functions' names, each with the number of its 64-bit integers; all take an
    address before them and return nothing.
    """

    def __init__(self, data: bytes, entries: Mapping[str, int]):
        builder = binding().JITLibraryBuilder().add_object_img(data).add_current_process()
        for name in entries:
            builder.export_symbol(name)
        with _linking:
            self._tracker = builder.link(_linker(), f"kernel{next(_numbers)}")
        self.addresses = {name: self._tracker[name] for name in entries}
        self.functions = {
            name: ctypes.CFUNCTYPE(None, ctypes.c_void_p, *[ctypes.c_int64] * integers)(
                self.addresses[name]
            )
            for name, integers in entries.items()
        }


_linking = threading.Lock()
_numbers = itertools.count()


@cache
def _linker() -> Any:
    """One linker for the process; libraries in it live as long as their `Linked`."""
    return binding().create_lljit_compiler(PIPELINE.target(), use_jit_link=True)
