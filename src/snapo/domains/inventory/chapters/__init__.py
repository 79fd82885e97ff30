"""The questions to a run of an item or of a network, with their sections of the report.

`about` summarises the case for all others; `levels` is of an item only, `places` of a network.
"""
