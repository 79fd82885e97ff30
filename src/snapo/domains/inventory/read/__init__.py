"""Reads the tables of an inventory case into records."""
