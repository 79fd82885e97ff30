"""One item: its records and its simulator."""
