"""Reads the decisions in closed loop."""
