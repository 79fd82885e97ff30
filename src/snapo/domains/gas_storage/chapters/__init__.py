"""The chapters of a storage run: each file has a measurement, its result and its sections.

`run.StorageRun` is the run folder with the units of gas; all sections are made from it.
"""
