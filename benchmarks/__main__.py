"""`python -m benchmarks`: what gradients cost here, domain by domain, and the native engine."""

from . import gas_storage, native, pension, pharma
from .machine import machine

SMALLER = ("small", "medium")


if __name__ == "__main__":
    print(machine())
    # Of the large fund bumps alone take minutes: `python -m benchmarks.pension` has it.
    tables = (gas_storage.table(), native.table(), pension.table(SMALLER), pharma.table())
    for table in tables:
        print()
        for line in table:
            print(line, flush=True)
