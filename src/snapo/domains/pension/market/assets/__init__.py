"""Asset classes: one kind a file, found by `market.registry`; `returns` has those of a step together.

A new one is an `asset_class.AssetClass`: the columns of its row, and its return over a step.
"""
