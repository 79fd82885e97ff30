"""The chapters of a run: each file has a measurement, its result and its section."""
