"""The native engine: a step and its transpose, compiled into one kernel for blocks of paths.

The compiler is `snapo.lanes`; this package handles rollouts. In the order of use:

    rollout             trees that paths share; the phases as functions of arrays, traced and cut
    kernel/             rows of memory, and all functions of a kernel:
      context             the kernel under construction and its rows
      sweep               a sweep of a phase while it is written
      noise               noise inside the kernel
      shared              the tables that all paths share
      kernel              the two sweeps of each phase, the loop over blocks, the module
    stored              kernels of earlier processes
    call, runtime       trees into rows and back; memory and threads
    distributed         groups of paths that other processes compute
    engine, explain     `values` and `adjoint`; every stage as text, and reasons
"""

from snapo.lanes import Unsupported as Unsupported

from .call import forget_kernels as forget_kernels
from .call import unavailable as unavailable
from .distributed import Distributed as Distributed
from .engine import Native as Native
from .explain import Explanation as Explanation
from .explain import explain as explain
from .explain import unsupported as unsupported
