"""The runs of a case: each has a folder in `runs`, and the link `run` points to the latest run."""
