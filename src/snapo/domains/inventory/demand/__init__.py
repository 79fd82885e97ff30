"""Demand of a period: one kind a file."""
