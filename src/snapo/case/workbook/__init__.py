"""A case as a workbook: a sheet for each table of the TOML file, and one for each CSV beside it."""
