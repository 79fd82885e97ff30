"""The sections of a report that only control has."""
