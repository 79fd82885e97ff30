"""A program's operations in the order in which they are emitted."""
