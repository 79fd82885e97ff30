"""Price processes of the spot: one file each, found by `registry`.

A new process is a `process.PriceProcess` in a separate file, with its table `[model]`.
"""
