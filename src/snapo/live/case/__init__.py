"""The case behind a run: its files, and where its inputs stand in them."""
