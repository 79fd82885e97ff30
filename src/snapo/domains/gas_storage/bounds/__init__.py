"""Fitted value iteration for Gaussian price factors, and the store of known prices: the bound."""
