"""One item: its records, and one path of it."""
