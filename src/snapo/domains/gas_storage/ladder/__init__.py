"""Traded products, and the methods of a trading desk: rolling intrinsic and least-squares Monte
Carlo."""
