"""Price processes of the spot: one file each, found by `registry`.

A new one is a `process.PriceProcess` in a file of its own, with the table of its `[model]`.
"""
