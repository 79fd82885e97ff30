"""Policies other than the network and the classical rules: with a memory, by stage,
user-defined."""
