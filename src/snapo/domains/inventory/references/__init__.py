"""Costs that are known by other means."""
