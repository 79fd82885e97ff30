"""Traded products, and the methods of a desk: rolling intrinsic, least-squares Monte Carlo."""
