"""Exact and classical answers for a storage contract, in plain NumPy and SciPy (float64).

`intrinsic` is for fixed prices, `lattice` for one or two price factors; both use the decision day
in `day_terms`.
"""
