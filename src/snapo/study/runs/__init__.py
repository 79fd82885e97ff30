"""The runs of a case: every one is in a folder of its own in `runs`, `run` points to the latest."""
