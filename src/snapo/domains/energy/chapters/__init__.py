"""The questions to a run: each file has its measure, its result and its section."""
