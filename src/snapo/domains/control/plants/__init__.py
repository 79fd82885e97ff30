"""The plants: a file each, found by `registry`."""
