"""The runs of a case: each has its own folder in `runs`, and `run` points to the latest."""
