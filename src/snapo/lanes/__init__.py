"""A compiler from jaxprs to machine code for vectors of paths, independent of snapo.

The input is a function of one path, as JAX traces it; the output is code that runs it, and its
transpose, for a block of paths at once, one path per lane of a vector. The packages, in the order
in which a function passes through them (imports go from the later to the earlier):

    program     straight-line programs: tracing, cutting, flattening, rewriting, the two sweeps
    emit        a writer of LLVM IR: vectors, loops, memory; which array lies where
    curves      exp, tanh, erf, sin … as polynomials on vectors
    rules       one rule per kind of primitive: elementwise, rearranging, dot products, gathers
    body        the order of a program's operations, and the loops that they share
    gradients   sums over paths and steps, for arrays that all paths share
    machine     this processor, machine code and its cache on disk, aligned memory, threads

Without llvmlite all packages except `machine` can be imported, and used if they need no processor.
"""


class Unsupported(Exception):
    """An operation that cannot be compiled, with the primitive and the line of user code."""


# An error while an operation is emitted is a reason to take another engine, no accident.
ACCIDENTS = (LookupError, AssertionError, TypeError, ValueError, NotImplementedError)
