"""Batches that differ: capability, design space, proven ranges, estimation.

All vary the numbers that `batches.varied` lists, on draws of `draws`, so that one compiled function
serves every question.
"""
