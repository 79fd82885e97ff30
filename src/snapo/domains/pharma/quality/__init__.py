"""Batches that differ: capability, design space, proven ranges, estimation.

All of them vary the numbers in `batches.varied`, drawn by `draws`, so that they share
one compiled function.
"""
