"""Exact and classical answers for a storage contract, in plain NumPy and SciPy (float64).

`intrinsic` knows the prices, `lattice` has one or two price factors; `day_terms` states a decision
day for both.
"""
