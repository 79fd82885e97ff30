"""Reads the TOML tables and CSV files of a case into records."""
