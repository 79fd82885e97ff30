"""A writer of LLVM IR for vectors of lanes.

Rules and bodies write through `values.EmittedValues`, which records the place of each array of a
program (`storage`); `code` writes the instructions, loops and memory accesses, and `module` the
text.
"""
