"""Price processes of the spot: one file each, found by `registry`."""
