"""Exact and classical answers for a storage contract, in plain NumPy and SciPy (float64)."""
