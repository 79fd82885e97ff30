"""The native engine: a step and its transpose, compiled into one kernel for blocks of paths.

The compiler is `snapo.lanes`; here is the part that knows a rollout. In the order in which a
simulator passes through it:

    given, functions    trees that paths share; the phases as functions of arrays
    rollout             the phases traced and cut
    kernel/             rows of memory, and all functions of a kernel:
      layouts, context    the rows; the kernel under construction
      phases, sweep, forward, reverse    the two sweeps of each phase
      noise, draw         noise inside the kernel
      shared, driver      the tables that all paths share; the loop over blocks of paths
    call, runtime       trees into rows and back; memory and threads
    engine, explain     `values` and `adjoint`; every stage as text, and reasons
"""

from snapo.lanes.unsupported import Unsupported as Unsupported

from .available import unavailable as unavailable
from .engine import Native as Native
from .explain import Explanation as Explanation
from .explain import explain as explain
from .explain import unsupported as unsupported
