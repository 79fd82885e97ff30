"""The chapters of results that only a pension fund has, each with its section of the report."""
