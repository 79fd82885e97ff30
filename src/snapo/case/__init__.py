"""A case as a user writes it: tables of TOML with CSV files next to it, or a workbook.

`load` reads the files. A domain declares its tables in `table` and their numbers in `quantity`; the
tables that all cases have are in `settings`. Every mistake is a `CaseError`, which names the file
and the remedy.
"""
