"""Crystals in a suspension: rates, solubility, seed, and their distribution over size."""
