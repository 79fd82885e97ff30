"""Derivatives of quality attributes, how they split into paths, and their checks."""
