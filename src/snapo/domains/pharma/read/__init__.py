"""A case's tables as records: every mistake is reported with its file and key.

`case.read_case` is the entry point. `declared` and `quantities` turn text such as "40 degC" into
numbers; the tables of a unit are in the file of the unit.
"""
