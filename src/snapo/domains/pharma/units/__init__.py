"""The unit operations: a file each, found by `registry`."""
