"""Processes of the spot price, one file each, which `registry` collects.

A new process is a `process.PriceProcess` in a separate file, with its table `[model]`.
"""
