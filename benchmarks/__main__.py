"""`python -m benchmarks`: what gradients cost here, domain by domain; the native engine; checks.

The figures that README and docs quote are written into them (`benchmarks/figures.py`)."""

from . import checking, figures, gas_storage, native, pension, pharma
from .machine import machine

SMALLER = ("small", "medium")


if __name__ == "__main__":
    print(machine())
    # Of the large fund bumps alone take minutes: `python -m benchmarks.pension` has it.
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
