"""Simulated profit and loss of a contract and its hedge."""
