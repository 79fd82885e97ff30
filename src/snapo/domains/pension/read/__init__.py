"""From a case file to its records: `case.read_case` reads every table in turn.

The keys are declared in `tables` and `tables_people`; each of the other files reads a table or a
CSV.
"""
