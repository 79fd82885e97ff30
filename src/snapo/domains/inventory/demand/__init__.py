"""Demand of a period: one file for each kind, which `registry` collects. A new kind is a
`base.Demand`, or a `counts.CountDemand` if it is in whole units, with its table.
"""
