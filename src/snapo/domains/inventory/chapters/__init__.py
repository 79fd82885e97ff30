"""The chapters of a run of an item or of a network, with their sections of the report.

`about` summarises the case for the other chapters; `levels` is for an item only, `places` for a
network.
"""
