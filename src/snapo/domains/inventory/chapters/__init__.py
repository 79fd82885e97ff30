"""Chapters of a run of an item or of a network, and of its report."""
