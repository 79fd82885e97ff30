"""Reads what is decided in closed loop."""
