"""Asset classes, which `market.registry` collects; returns of a step are in `market.dynamics`.

A new class is a subclass of `asset_class.AssetClass`: it has the columns of its row and its return
over a step.
"""
