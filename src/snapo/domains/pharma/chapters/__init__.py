"""The questions to a process: what is measured, its record, and its section of the report."""
