"""`python -m benchmarks`: the cost of gradients by domain, of the native engine and of checks.

It writes the figures that README and docs quote into these pages (`benchmarks/figures.py`)."""

from . import checking, figures, gas_storage, native, pension, pharma
from .machine import machine

SMALLER = ("small", "medium")


if __name__ == "__main__":
    print(machine())
    # The large fund is left out: its bumps take minutes (`python -m benchmarks.pension`).
    tables = {
        "gas_storage": gas_storage.table(),
        "native": native.table(),
        "pension": pension.table(SMALLER),
        "pharma": pharma.table(),
        "checking": checking.table(),
    }
    for name, table in tables.items():
        print()
        lines = []
        for line in table:
            print(line, flush=True)
            lines.append(line)
        if name in figures.TAKEN:
            figures.record(name, "make bench", figures.taken(name, lines))
    figures.fill()
