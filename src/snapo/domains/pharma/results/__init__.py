"""Tables of a run as plain data."""
