"""Statistics of batches that differ: capability, design space, proven ranges, estimation.

All analyses vary the numbers in `batches.varied`, drawn by `draws`, so that they share
one compiled function.
"""
