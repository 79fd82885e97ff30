"""The native engine: a step and its transpose, compiled into one kernel for blocks of paths.

The stages, each in its own module, in the order in which a simulator passes through them:

    rollout, trace   what JAX sees of `initial`, `step` and `terminal`, cut by what varies
    program          the pieces as straight-line programs
    passes           rewriting, sharing, dropping; what is stored and what is computed again
    schedule         the order, and which operations share a loop
    body, arrays, dots, …   LLVM IR of each kind of operation; math, angles: curves
    kernel           memory layouts and the functions of a kernel
    compiler         machine code, and its cache on disk
    runtime          memory and threads
"""

from .engine import Native as Native
from .explain import Explanation as Explanation
from .explain import explain as explain
from .explain import unsupported as unsupported
from .program import Unsupported as Unsupported
