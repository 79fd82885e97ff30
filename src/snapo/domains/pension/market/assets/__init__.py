"""Asset classes, found by `market.registry`; returns of a step are in `market.dynamics`.

A new one is an `asset_class.AssetClass`: the columns of its row, and its return over a step.
"""
