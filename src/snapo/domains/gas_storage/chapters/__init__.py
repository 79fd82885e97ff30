"""The chapters of a storage run: each file has a measurement, its result and its sections.

`run.StorageRun` is the run folder with its units of gas, from which all sections are made.
"""
