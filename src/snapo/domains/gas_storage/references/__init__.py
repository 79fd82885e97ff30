"""Exact and classical answers for a storage contract, in plain NumPy and SciPy (float64).

`intrinsic` is for known prices, `lattice` for one or two price factors; `day_terms` has a decision
day for both.
"""
