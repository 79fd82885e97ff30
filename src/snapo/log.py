"""Callbacks that write files while a policy is trained: `from snapo.log import CSV`."""

from .solver.learning.log import CSV as CSV
from .solver.learning.log import TensorBoard as TensorBoard

__all__ = ["CSV", "TensorBoard"]
