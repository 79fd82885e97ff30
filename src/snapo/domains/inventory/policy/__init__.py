"""Rules that order: the trained one, and the classical ones."""
