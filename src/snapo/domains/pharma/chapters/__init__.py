"""The questions to a process: the measure, its record, and its section of the report."""
