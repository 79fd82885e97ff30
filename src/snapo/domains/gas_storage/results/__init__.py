"""The figures of a run, as plain data: each file one part of the report."""
