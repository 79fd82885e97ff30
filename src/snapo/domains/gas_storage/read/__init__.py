"""Reads the TOML tables and CSV files of a case into records.

`case.read_case` is the entry point; `tables` declares every key with unit, range and meaning.
"""
