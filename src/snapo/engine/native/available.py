"""Whether this installation can compile anything at all."""

from snapo.lanes import jax_private
from snapo.lanes.machine import llvm


def unavailable() -> str | None:
    """The reason why nothing can be compiled here, and the remedy; None where it can."""
    missing = llvm.unavailable()
    if missing is not None:
        return f"{missing} (pip install 'snapo[native]')"
    return jax_private.unavailable()
