"""The text of a kernel's module, and typed references to the results of its instructions."""

import platform
from dataclasses import dataclass

import numpy as np

from ..program.program import TYPES, number, stored


@dataclass(frozen=True)
class Ref:
    """A result: its text in the IR, element type (NumPy's name) and number of lanes."""

    text: str
    dtype: str
    lanes: int
    value: object = None  # where it is a known scalar

    @property
    def type(self) -> str:
        return f"<{self.lanes} x {TYPES[self.dtype]}>"

    @property
    def floating(self) -> bool:
        return self.dtype.startswith("float")

    @property
    def unsigned(self) -> bool:
        return self.dtype.startswith("uint") or self.dtype == "bool"


class Module:
    """Functions and declarations of one kernel."""

    def __init__(self, lanes: int, register: int):
        self.lanes = lanes
        self.register = register  # bytes in one vector register
        self.functions: list[str] = []
        self.declared: dict[str, None] = {}
        self.instances: dict[str, None] = {}
        self.tables: list[str] = []

    @property
    def x86(self) -> bool:
        """Whether the processor understands LLVM's names for instructions of x86."""
        return platform.machine().lower() in ("x86_64", "amd64")

    @property
    def few(self) -> bool:
        """Whether the processor has 16 vector registers only: x86 before AVX-512."""
        return self.register < 64 and self.x86

    def declare(self, text: str) -> None:
        self.declared[text] = None

    def first(self, name: str) -> bool:
        """Whether a function is requested for the first time; its text is then written."""
        new = name not in self.instances
        self.instances[name] = None
        return new

    def write(self, text: str) -> None:
        """Appends the text of a function."""
        self.functions.append(text)

    def table(self, array: np.ndarray) -> str:
        """A constant array of the kernel; returns its address."""
        name = f"@table{len(self.tables)}"
        kind = "i8" if array.dtype == np.bool_ else TYPES[array.dtype.name]
        dtype = stored(array.dtype.name)
        items = ", ".join(
            f"{kind} {number(x, dtype)}" for x in np.asarray(array).astype(dtype).flat
        )
        self.tables.append(f"{name} = private constant [{array.size} x {kind}] [{items}], align 64")
        return name

    def text(self) -> str:
        bits = 8 * self.register
        width = f'"prefer-vector-width"="{bits}" "min-legal-vector-width"="{bits}"'
        tail = [f"attributes #0 = {{ {width} }}", "!0 = !{}", ""]
        return "\n".join([*self.tables, *self.declared, "", *self.functions, "", *tail])
