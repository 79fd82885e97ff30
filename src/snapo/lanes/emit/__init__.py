"""A writer of LLVM IR for vectors of lanes.

Rules and bodies write through `values.EmittedValues`, which knows where each array of a program
lies (`storage`); `code` writes the instructions, loops and memory accesses, and `module` the text.
"""
