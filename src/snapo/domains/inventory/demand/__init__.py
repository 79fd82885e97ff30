"""Demand of a period: one file for each kind, found by `registry`.

A new one is a `base.Demand`, or a `counts.CountDemand` if it is in whole units, with its table.
"""
